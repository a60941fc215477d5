/* The encoder on the motor: an error that recurs with every revolution, and noise.
 *
 *     shown = theta_m + sum over k = 1, 2 of E_k (cos(k theta_m + phi_k) - cos phi_k) + n
 *
 * The drive counts from what it saw at theta_m = 0. An error of order k is seen by the loop as if the motor were there: the motor
 * follows it the other way round, so at the arm it is a transmission error of order k and amplitude E_k / N. */
#pragma once

#include "hil/control/real.h"

struct encoder {
    real e1_rad;
    real phi1_rad;
    real e2_rad;
    real phi2_rad;
    real at_home_rad; /* E_1 cos phi_1 + E_2 cos phi_2 */
    real noise_rad;   /* standard deviation of n */
    real present_rad; /* n of this control period */
    uint64_t draws;   /* state of its generator */
};

/* What the encoder shows of a motor angle in this control period, in rad, before it is rounded to counts. */
INLINED real shown_angle(const struct encoder *e, real angle)
{
    real shown = angle + e->present_rad;
    if (e->e1_rad != 0.0 || e->e2_rad != 0.0) {
        shown += e->e1_rad * COS(angle + e->phi1_rad) + e->e2_rad * COS(2.0 * angle + e->phi2_rad) - e->at_home_rad;
    }
    return shown;
}

/* Draw the noise of the next control period, where there is any: Gaussian, white. */
void draw_noise(struct encoder *e);
