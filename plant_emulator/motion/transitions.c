#include "transitions.h"

/* Let the filters start anew on the torque that acts: they have been tracking one that was not applied. */
static void restart_filters(struct law *law, real torque_nm)
{
    for (int column = 0; column < NOTCHES; column++) {
        law->notch_state[column].active = 0;
        law->notch_state[column].mean_nm = torque_nm;
    }
}

void begin_stop(struct axis *axis, real deceleration_rad_s2)
{
    struct motion *m = &axis->motion;
    struct cascade_state *s = &axis->law.cascade_state;
    const int is_hard = isinf(deceleration_rad_s2) != 0;
    const real lag = s->speed_rad_s / most(1.0, axis->law.cascade_config.position_gain_per_s);
    m->reference_rad = is_hard ? s->motor_angle_rad : s->motor_angle_rad + lag;
    m->reference_speed_rad_s = is_hard ? 0.0 : s->speed_rad_s;
    m->stop_deceleration_rad_s2 = deceleration_rad_s2;
    m->stop_direction = is_hard && FABS(s->speed_rad_s) >= STOPPED_RAD_S ? COPYSIGN(1.0, s->speed_rad_s) : 0.0;
    m->slowest_rad_s = (real)INFINITY;
    m->stop_periods = 0;
    m->stopped = 0;
    if (m->mode == TORQUE || m->mode == PROFILE_TORQUE) {
        cascade_start(s, s->motor_angle_rad, s->speed_rad_s, is_hard ? 0.0 : m->torque_nm);
        restart_filters(&axis->law, m->torque_nm);
    } else if (m->mode == POSITION || m->mode == PROFILE || m->mode == VELOCITY) {
        /* a stop may begin twice: here when a limit breaks, and by the state machine's reaction to it */
        s->integral_nm += m->torque_offset_nm;
    }
    m->mode = STOPPING;
}

/* The distance in which a profile comes to rest from a speed, with its sign. */
static real stopping_distance_rad(const struct motion *m, real speed_rad_s)
{
    const real down = least(m->profile_deceleration_rad_s2, m->max_deceleration_rad_s2);
    return down > 0.0 ? 0.5 * speed_rad_s * FABS(speed_rad_s) / down : 0.0;
}

void begin_mode(struct axis *axis, integer mode)
{
    struct motion *m = &axis->motion;
    struct cascade_state *s = &axis->law.cascade_state;
    const struct cascade_config *c = &axis->law.cascade_config;
    const real speed = s->speed_rad_s, angle = s->motor_angle_rad, torque = m->torque_nm;
    /* in these the torque was not the law's own: its demand says nothing */
    const int is_foreign =
        m->mode == TORQUE || m->mode == PROFILE_TORQUE || (m->mode == STOPPING && m->stop_direction != 0.0);
    const real demand_speed = is_foreign ? speed : m->demand_speed_rad_s;
    real error = 0.0, torque_offset = m->torque_offset_nm;
    if (mode == POSITION) {
        m->previous_counts = m->target_counts = round_down(angle * m->counts_per_rad + 0.5);
        error = m->velocity_offset_rad_s - speed;
    } else if (mode == VELOCITY) {
        m->previous_speed_rad_s = m->target_speed_rad_s = speed - m->velocity_offset_rad_s;
    } else if (mode == PROFILE_VELOCITY) {
        m->reference_speed_rad_s = m->target_speed_rad_s = demand_speed;
        error = demand_speed - speed;
        torque_offset = 0.0;
    } else if (mode == PROFILE) {
        const int has_position = (m->mode == POSITION || m->mode == PROFILE || m->mode == STOPPING) && !is_foreign;
        m->reference_rad = has_position ? m->demand_rad : angle + speed / most(1.0, c->position_gain_per_s);
        m->reference_speed_rad_s = demand_speed;
        const real target = m->reference_rad + stopping_distance_rad(m, demand_speed);
        m->target_counts = round_down(target * m->counts_per_rad + 0.5);
        error = c->position_gain_per_s * (m->reference_rad - angle) - speed;
    } else {
        m->torque_demand_nm = torque;
        m->target_torque_nm = torque - (mode == TORQUE ? torque_offset : 0.0);
    }
    s->integral_nm = torque - torque_offset - c->velocity_gain_nm_s_rad * error;
    s->error_rad_s = error;
    if (is_foreign) {
        restart_filters(&axis->law, torque);
    }
    m->elapsed_periods = NO_SET_POINT;
    m->late_periods = 0;
    m->demand_rad = mode == PROFILE ? m->reference_rad : angle;
    m->following_count = m->position_window_count = m->velocity_window_count = m->reached = m->stopped = 0;
    m->stop_direction = 0.0;
    m->mode = mode;
}

real brake_hard(struct axis *axis, real previous_integral_nm)
{
    struct motion *m = &axis->motion;
    struct cascade_state *s = &axis->law.cascade_state;
    s->integral_nm = previous_integral_nm;
    const real speed = s->speed_rad_s * m->stop_direction;
    if (speed < m->slowest_rad_s) {
        m->slowest_rad_s = speed;
    } else {
        m->stop_periods += 1;
    }
    const real torque = m->stop_direction > 0.0 ? m->torque_low_nm : m->torque_high_nm;
    if (speed < STOPPED_RAD_S) {
        m->reference_rad = s->motor_angle_rad;
        m->stop_direction = 0.0;
        restart_filters(&axis->law, previous_integral_nm);
    }
    return torque;
}
