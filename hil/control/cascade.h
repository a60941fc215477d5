/* The P-PI cascade: a proportional position loop around a proportional-integral velocity loop, on the motor side only.
 *
 *     u = (K_vp + K_vi/s) (K_pp (theta_ref - theta_m) + speed_ff - v),    v = F_lp s theta_m
 *
 * Source: the paper, section 3; bilinear transform from its section 5.1.
 */
#ifndef HIL_CASCADE_H
#define HIL_CASCADE_H

#include "real.h"

/* Gains of the cascade, and the corner of F_lp, first order. */
struct cascade_config {
    real position_gain_per_s;           /* K_pp */
    real velocity_gain_nm_s_rad;        /* K_vp */
    real velocity_integral_gain_nm_rad; /* K_vi */
    real lowpass_hz;
};

/* Memory of the cascade. */
struct cascade_state {
    real motor_angle_rad; /* last angle */
    real speed_rad_s;     /* v, the low-passed speed */
    real error_rad_s;     /* last velocity error */
    real integral_nm;     /* the integrator */
};

/* Start without a step in the torque: the speed is known, and the integrator holds the torque that acts already. */
void cascade_start(struct cascade_state *state, real motor_angle, real speed_rad_s, real torque_nm);

/* Low-passed motor speed v in rad/s from the measured angle in rad; call it once per sample. */
real observe_speed(const struct cascade_config *config, struct cascade_state *state, real period_s, real motor_angle);

/* One sample of the cascade; call observe_speed first. Returns u in N m; before becomes the integrator as it was, for
 * hold_integrator. position is theta_ref in rad, velocity_offset is speed_ff in rad/s. */
real cascade_step(
    const struct cascade_config *config, struct cascade_state *state, real period_s, real position, real velocity_offset,
    real *before);

/* Anti-windup: where the torque was cut by excess_nm and the error would wind the integrator further, it stays where it was. */
void hold_integrator(struct cascade_state *state, real before, real excess_nm);

#endif
