#include "servo.h"

void servo_start(struct law *law, real motor_angle, real speed_rad_s, real torque_nm)
{
    cascade_start(&law->cascade_state, motor_angle, speed_rad_s, torque_nm);
    for (int column = 0; column < NOTCHES; column++) {
        struct notch_state *s = &law->notch_state[column];
        s->s1 = s->s2 = s->frequency_hz = s->zeta_rd = 0.0;
        s->active = 0;
        /* a filter that acts at this speed starts at once, on this torque */
        s->speed_rps = FABS(speed_rad_s) / (2.0 * PI);
        s->mean_nm = torque_nm;
    }
}

void servo_move_origin(struct law *law, real by_rad)
{
    law->cascade_state.motor_angle_rad -= by_rad;
}

real servo_step(
    struct law *law, real period_s, real torque_limit_nm, real position, real velocity_offset, real torque_offset,
    real motor_angle)
{
    const struct cascade_config *cascade = &law->cascade_config;
    struct cascade_state *state = &law->cascade_state;
    const real speed = observe_speed(cascade, state, period_s, motor_angle);
    real before;
    real u = cascade_step(cascade, state, period_s, position, velocity_offset, &before);
    for (int column = 0; column < NOTCHES; column++) {
        u = notch_step(&law->notch_config[column], &law->notch_state[column], period_s, speed, u);
    }
    const real wanted = u + torque_offset;
    const real torque = least(torque_limit_nm, most(-torque_limit_nm, wanted));
    if (torque != wanted) {
        hold_integrator(state, before, wanted - torque);
    }
    return torque;
}

void bank_step(struct law *laws, integer count, real period_s, real *values)
{
    const real *position = values, *angle = values + count, *limit_nm = values + 2 * count;
    real *torque = values + 3 * count, *zero_hz = values + 4 * count;
    for (integer row = 0; row < count; row++) {
        struct law *law = &laws[row];
        torque[row] = servo_step(law, period_s, limit_nm[row], position[row], 0.0, 0.0, angle[row]);
        const struct notch_state *first = &law->notch_state[0];
        zero_hz[row] = first->active != 0 ? first->frequency_hz : 0.0;
    }
}
