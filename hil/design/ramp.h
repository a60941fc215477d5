/* An axis along a motion of its motor, without a bus: the law and a linear plant with its transmission error.
 *
 * Torque limit, encoder steps and the bus are left out; friction and gravity are one constant torque.
 *
 * Source: the paper, Fig. 3, eq. (1) and (2).
 */
#ifndef HIL_RAMP_H
#define HIL_RAMP_H

#include "hil/control/servo.h"
#include "hil/control/waves.h"

/* The plant over one period of the law, from v = (theta_m, w_m, theta_l, w_l, torque, theta_sync, change of theta_sync). */
struct ramp_plant {
    real ratio;      /* N */
    real step[7][4]; /* what each of v counts in the first four of it one period later */
    real arm[7];     /* acceleration of the arm */
};

/* Run laws and plants of count axes along the same motion, sample by sample; every every-th sample is recorded.
 *
 * harmonics are the orders of each axis' error theta_sync, orders of them for each. friction_nm acts against the motors throughout,
 * gravity_nm too, through the gear: the error's slope modulates it. The laws hold both from the beginning. waiting holds, for each
 * axis, the delay torques that have been computed and do not act yet. reference is theta_ref in rad, samples of it. speed_rps and
 * arm_acceleration become, for each axis, a number for every every-th sample. */
void ramp_run(
    const struct ramp_plant *plants, const struct harmonic *harmonics, integer orders, struct law *laws, integer count,
    real period_s, real friction_nm, real gravity_nm, real *waiting, integer delay, integer every, const real *reference,
    integer samples, real *speed_rps, real *arm_acceleration);

#endif
