#include "cascade.h"

void cascade_start(struct cascade_state *state, real motor_angle, real speed_rad_s, real torque_nm)
{
    state->motor_angle_rad = motor_angle;
    state->speed_rad_s = speed_rad_s;
    state->error_rad_s = 0.0;
    state->integral_nm = torque_nm;
}

real observe_speed(const struct cascade_config *config, struct cascade_state *state, real period_s, real motor_angle)
{
    const real c = 2.0 / period_s;
    const real w = 2.0 * PI * config->lowpass_hz;
    state->speed_rad_s = ((c - w) * state->speed_rad_s + w * c * (motor_angle - state->motor_angle_rad)) / (c + w);
    state->motor_angle_rad = motor_angle;
    return state->speed_rad_s;
}

real cascade_step(
    const struct cascade_config *config, struct cascade_state *state, real period_s, real position, real velocity_offset,
    real *before)
{
    const real error =
        config->position_gain_per_s * (position - state->motor_angle_rad) + velocity_offset - state->speed_rad_s;
    *before = state->integral_nm;
    state->integral_nm += config->velocity_integral_gain_nm_rad * 0.5 * period_s * (error + state->error_rad_s);
    state->error_rad_s = error;
    return config->velocity_gain_nm_s_rad * error + state->integral_nm;
}

void hold_integrator(struct cascade_state *state, real before, real excess_nm)
{
    if (excess_nm * state->error_rad_s > 0.0) {
        state->integral_nm = before;
    }
}
