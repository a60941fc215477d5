#include "references.h"

real set_point_fraction(struct motion *motion)
{
    struct motion *m = motion;
    const real fraction = ((real)m->elapsed_periods + 1.0) / (real)m->periods_per_set_point;
    m->elapsed_periods += 1;
    if (fraction <= 1.0) {
        m->late_periods = 0;
        return fraction;
    }
    if (m->extrapolation_periods <= 0) {
        return 1.0;
    }
    const integer late = m->elapsed_periods - m->periods_per_set_point;
    m->late_periods = late;
    if (late > m->extrapolation_periods) {
        m->trip |= SET_POINT_LATE;
        return 1.0 + (real)m->extrapolation_periods / (real)m->periods_per_set_point;
    }
    return fraction;
}

real interpolated_counts(struct motion *motion)
{
    const real fraction = set_point_fraction(motion);
    return motion->previous_counts + (motion->target_counts - motion->previous_counts) * fraction;
}

real interpolated_speed(struct motion *motion)
{
    struct motion *m = motion;
    const real fraction = least(1.0, set_point_fraction(m));
    const real wanted =
        m->previous_speed_rad_s + (m->target_speed_rad_s - m->previous_speed_rad_s) * fraction + m->velocity_offset_rad_s;
    if (FABS(wanted) > m->max_speed_rad_s) {
        m->limited |= LIMITED_SPEED;
        return COPYSIGN(m->max_speed_rad_s, wanted);
    }
    return wanted;
}

/* The greatest speed that 607Fh and 6080h leave to a profile. */
static real greatest_speed(const struct motion *m)
{
    return least(m->max_profile_speed_rad_s, m->max_speed_rad_s);
}

/* One period of a ramp between two speeds: down while the speed falls, to 0 where it turns round, and up from there. */
static real towards(real speed, real wanted, real up, real down, real period_s)
{
    const int turns = wanted * speed < 0.0;
    const real change = (turns || FABS(wanted) < FABS(speed) ? down : up) * period_s;
    return speed + least(change, most(-change, (turns ? 0.0 : wanted) - speed));
}

void profile_position(struct motion *motion, real target_rad, real period_s)
{
    struct motion *m = motion;
    const real up = least(m->profile_acceleration_rad_s2, m->max_acceleration_rad_s2);
    const real down = least(m->profile_deceleration_rad_s2, m->max_deceleration_rad_s2);
    const real distance = target_rad - m->reference_rad;
    const real loss = down * period_s;
    const real braking = SQRT(0.25 * loss * loss + 2.0 * down * FABS(distance)) - 0.5 * loss;
    real greatest = m->profile_speed_rad_s;
    if (greatest > greatest_speed(m)) {
        greatest = greatest_speed(m);
        if (braking > greatest) {
            m->limited |= LIMITED_SPEED;
        }
    }
    const real wanted = COPYSIGN(least(greatest, braking), distance);
    m->reference_speed_rad_s = towards(m->reference_speed_rad_s, wanted, up, down, period_s);
    const real step = m->reference_speed_rad_s * period_s;
    const int arrives = FABS(distance) <= FABS(step) * (1.0 + 1e-9) || FABS(distance) < 0.5 / m->counts_per_rad;
    if (arrives && FABS(m->reference_speed_rad_s) <= 1.5 * loss) {
        m->reference_rad = target_rad;
        m->reference_speed_rad_s = 0.0;
    } else {
        m->reference_rad += step;
    }
}

real profile_velocity(struct motion *motion, real period_s)
{
    struct motion *m = motion;
    const real greatest = greatest_speed(m);
    real wanted = m->target_speed_rad_s;
    if (FABS(wanted) > greatest) {
        m->limited |= LIMITED_SPEED;
        wanted = COPYSIGN(greatest, wanted);
    }
    const real up = least(m->profile_acceleration_rad_s2, m->max_acceleration_rad_s2);
    const real down = least(m->profile_deceleration_rad_s2, m->max_deceleration_rad_s2);
    m->reference_speed_rad_s = towards(m->reference_speed_rad_s, wanted, up, down, period_s);
    return m->reference_speed_rad_s;
}

real profile_torque(const struct motion *motion, real period_s)
{
    const real change = motion->torque_slope_nm_s * period_s;
    return motion->torque_demand_nm + least(change, most(-change, motion->target_torque_nm - motion->torque_demand_nm));
}

void ramp_down(struct motion *motion, real period_s)
{
    struct motion *m = motion;
    const real drop = least(m->stop_deceleration_rad_s2, m->max_deceleration_rad_s2) * period_s;
    const real speed = m->reference_speed_rad_s;
    m->reference_speed_rad_s = COPYSIGN(most(0.0, FABS(speed) - drop), speed);
    m->reference_rad += m->reference_speed_rad_s * period_s;
    if (m->reference_speed_rad_s == 0.0) {
        m->stop_periods += 1;
    }
}
