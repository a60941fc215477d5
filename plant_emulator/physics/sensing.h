/* Path of the tip's acceleration through the accelerometer: mounting resonance, low-pass and delay at the control period.
 *
 *     mounting   (2 zeta w s + w^2)/(s^2 + 2 zeta w s + w^2)      the sensor's mass on its elastic mounting
 *     low-pass   w^2/(s^2 + sqrt(2) w s + w^2)                    Butterworth of order 2
 *
 * Both are bilinear with their own frequency kept (prewarped). The delay is exact in whole control periods; fractions are
 * interpolated by the cubic through the four samples around them.
 */
#pragma once

#include "hil/control/real.h"

enum { CHANNELS = 3, SENSOR_SECTIONS = 2 };

/* Two sections of order 2, mounting first, and the delay. */
struct sections {
    real coefficients[SENSOR_SECTIONS][5];      /* b0, b1, b2, a1, a2 */
    real memory[SENSOR_SECTIONS][CHANNELS][2];  /* of the transposed direct form II */
    real weights[4];                            /* of the four interpolated samples, the newest first */
    integer first;                              /* samples by which the newest of the four is late */
    integer newest;                             /* row of the ring that holds the newest sample */
};

/* Let some samples pass; the last output is what the sensor shows now.
 *
 * ring holds the latest size filtered samples, size at least first + 4; tip holds true accelerations, one row of CHANNELS per
 * control period; sensed becomes the output after the last of them. */
void sense(struct sections *sections, real *ring, integer size, const real *tip, integer periods, real *sensed);
