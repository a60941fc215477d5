/* The whole servo law of an axis: P-PI, notches on the torque command, torque limit and anti-windup. Host and drive run it. */
#ifndef HIL_SERVO_H
#define HIL_SERVO_H

#include "cascade.h"
#include "notch.h"

/* Gains and filters of one axis, and the memory of both. */
struct law {
    struct cascade_config cascade_config;
    struct cascade_state cascade_state;
    struct notch_config notch_config[NOTCHES];
    struct notch_state notch_state[NOTCHES];
};

/* Take over at this angle in rad and speed while this torque acts, without a step in the torque. */
void servo_start(struct law *law, real motor_angle, real speed_rad_s, real torque_nm);

/* Move the origin of angles by by_rad: from now on position and motor angle are given less by so much.
 *
 * In single precision an angle of 300 rad is known to 3e-5 rad; a drive that turns on and on keeps its angles small. */
void servo_move_origin(struct law *law, real by_rad);

/* One sample of the law: torque = F_n(s) u + torque_offset, within +-torque_limit_nm.
 *
 * F_n acts on the torque command, behind the PI: there it opens the loop at the anti-resonance and lets the motor give way to
 * the transmission error. position is theta_ref in rad, motor side; velocity_offset is speed_ff in rad/s; motor_angle is
 * theta_m in rad, as measured. Returns the torque command in N m. */
real servo_step(
    struct law *law, real period_s, real torque_limit_nm, real position, real velocity_offset, real torque_offset,
    real motor_angle);

/* One sample of the law of every axis.
 *
 * values has five rows of count numbers: theta_ref, theta_m and torque limit are read; torque and the zero frequency of the
 * first filter, 0 while it is out, are written. */
void bank_step(struct law *laws, integer count, real period_s, real *values);

#endif
