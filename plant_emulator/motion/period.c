#include "group.h"
#include "hil/control/cancellation.h"
#include "plant_emulator/physics/tool.h"
#include "references.h"
#include "supervision.h"
#include "transitions.h"

/* What the mode asks of the law in a period. */
struct demand {
    real position;
    real velocity_offset;
    real torque_offset;
};

/* Set law and outputs to those of a motor at rest behind a closed brake. */
static void rest(struct axis *axis, real angle)
{
    struct motion *m = &axis->motion;
    cascade_start(&axis->law.cascade_state, angle, 0.0, 0.0);
    for (int column = 0; column < NOTCHES; column++) {
        axis->law.notch_state[column].active = 0;
        axis->law.notch_state[column].speed_rps = 0.0;
        axis->law.notch_state[column].mean_nm = 0.0;
    }
    m->torque_nm = m->following_error_rad = m->cancel_fraction = 0.0;
    m->demand_rad = angle;
    m->demand_speed_rad_s = m->torque_demand_nm = 0.0;
    m->limited = m->reached = m->late_periods = 0;
}

/* The mode's demand on the law in this period. */
static struct demand find_demand(struct motion *m, real angle, real period_s)
{
    struct demand d = {angle, 0.0, m->torque_offset_nm};
    real demand_speed = 0.0;
    switch (m->mode) {
    case POSITION:
        d.position = interpolated_counts(m) / m->counts_per_rad;
        d.velocity_offset = m->velocity_offset_rad_s;
        demand_speed = (d.position - m->demand_rad) / period_s;
        break;
    case PROFILE:
        profile_position(m, m->target_counts / m->counts_per_rad, period_s);
        d.position = m->reference_rad;
        demand_speed = m->reference_speed_rad_s;
        break;
    case STOPPING:
        d.torque_offset = 0.0;
        if (m->stop_direction == 0.0) {
            ramp_down(m, period_s);
            d.position = m->reference_rad;
            demand_speed = m->reference_speed_rad_s;
        }
        break;
    case VELOCITY:
        d.velocity_offset = demand_speed = interpolated_speed(m);
        break;
    case PROFILE_VELOCITY:
        d.velocity_offset = demand_speed = profile_velocity(m, period_s);
        d.torque_offset = 0.0;
        break;
    case TORQUE:
        if (m->extrapolation_periods > 0) {
            set_point_fraction(m); /* the torque acts at once: all that counts of the interval is its end */
        }
        break;
    default:
        break;
    }
    m->demand_rad = d.position;
    m->demand_speed_rad_s = demand_speed;
    return d;
}

/* Add the drive's own cancellation of the transmission error, faded in or out. */
static void add_cancellation(struct axis *axis, real angle, real period_s, struct demand *d)
{
    struct motion *m = &axis->motion;
    const real faded = m->cancel_fraction + COPYSIGN(period_s / CANCELLATION_FADE_S, (real)m->cancel_mode - 0.5);
    m->cancel_fraction = least(1.0, most(0.0, faded));
    if (m->mode != POSITION && m->mode != PROFILE) {
        return;
    }
    const struct inner_cancellation known = {
        m->cancel_a2_rad,         m->cancel_phi2_rad,          m->cancel_a4_rad, m->cancel_phi4_rad,
        m->cancel_inertia_kg_m2,  m->cancel_damping_nm_s_rad,  m->cancel_a1_rad, m->cancel_phi1_rad,
    };
    real additions[3];
    inner_cancellation(
        &known, axis->law.cascade_config.lowpass_hz, period_s, angle, axis->law.cascade_state.speed_rad_s, additions);
    d->position += m->cancel_fraction * additions[0];
    d->velocity_offset += m->cancel_fraction * additions[1];
    d->torque_offset += m->cancel_fraction * additions[2];
}

/* The torque that the mode uses: the law's, or its own. */
static real used_torque(struct axis *axis, real period_s, real previous_integral_nm, real torque_nm)
{
    struct motion *m = &axis->motion;
    if (m->mode == TORQUE) {
        return m->target_torque_nm + m->torque_offset_nm;
    }
    if (m->mode == PROFILE_TORQUE) {
        return profile_torque(m, period_s);
    }
    if (m->mode == STOPPING && m->stop_direction != 0.0) {
        return brake_hard(axis, previous_integral_nm);
    }
    return torque_nm;
}

/* The torque within its limits; where these cut it, the integrator does not wind up. */
static real limited_torque(struct axis *axis, real previous_integral_nm, real torque_nm)
{
    struct motion *m = &axis->motion;
    if (m->torque_low_nm < torque_nm && torque_nm < m->torque_high_nm) {
        return torque_nm;
    }
    const real limited = least(m->torque_high_nm, most(m->torque_low_nm, torque_nm));
    if (torque_nm != limited) {
        hold_integrator(&axis->law.cascade_state, previous_integral_nm, torque_nm - limited);
    }
    m->limited |= LIMITED_TORQUE;
    return limited;
}

/* Note what is reached; check the axis against its limits, and begin a stop where one is broken. */
static void supervise(struct axis *axis, int was_stopping, real counts, real angle)
{
    struct motion *m = &axis->motion;
    const struct cascade_state *s = &axis->law.cascade_state;
    if (m->mode != POSITION && m->mode != TORQUE && m->mode != VELOCITY) {
        watch_windows(m, s->speed_rad_s, angle);
    }
    if (m->mode == STOPPING) {
        if (m->reference_speed_rad_s == 0.0 && m->stop_direction == 0.0 && FABS(s->speed_rad_s) < STOPPED_RAD_S) {
            m->stopped = 1;
        }
        return;
    }
    watch_limits(m, s->speed_rad_s, counts);
    if (m->trip != 0 && !was_stopping) {
        begin_stop(axis, m->stop_deceleration_rad_s2);
    }
}

real read_counts(const struct axis *axis)
{
    return axis_counts(axis);
}

real command(struct axis *axis, real period_s)
{
    struct motion *m = &axis->motion;
    const real counts = axis_counts(axis);
    const real angle = counts / m->counts_per_rad;
    if (m->input_mask != 0 || m->edge_mask != 0) {
        watch_inputs(m, counts);
    } else if (m->is_watching != 0) {
        m->is_watching = 0;
    }
    if (m->mode == BRAKED) {
        rest(axis, angle);
        return 0.0;
    }
    const int was_stopping = m->mode == STOPPING;
    m->limited = 0;
    struct demand d = find_demand(m, angle, period_s);
    if (m->cancel_mode != 0 || m->cancel_fraction > 0.0) {
        add_cancellation(axis, angle, period_s, &d);
    }
    const real previous_integral_nm = axis->law.cascade_state.integral_nm;
    /* the law runs in torque modes too: it keeps the speed estimate, and its torque is passed over */
    real torque = servo_step(
        &axis->law, period_s, m->torque_limit_nm, d.position, d.velocity_offset, d.torque_offset, angle);
    torque = limited_torque(axis, previous_integral_nm, used_torque(axis, period_s, previous_integral_nm, torque));
    m->torque_nm = m->torque_demand_nm = torque;
    m->following_error_rad = d.position - angle;
    supervise(axis, was_stopping, counts, angle);
    return torque;
}

void age(struct axis *axis, real period_s)
{
    go_through(&axis->change, &axis->past, &axis->plant, &axis->plant_state, axis->motion.mode == BRAKED, period_s);
    put_error(&axis->change, &axis->past, &axis->plant);
}

/* Axes feel nothing of each other: each, or some in lock-step, go through all periods alone. */
static void pass_through(integer periods, real period_s, integer substeps, const struct advancing *axes, int count)
{
    if (!advance_in_lock_step(periods, period_s, substeps, axes, count)) {
        for (int i = 0; i < count; i++) {
            advance_group(periods, period_s, substeps, &axes[i], 1);
        }
    }
}

/* Advance the axes of robots whose links do not couple them. */
static void advance_axes(const struct mechanics *const *robots, integer number, integer periods)
{
    struct advancing some[MOST_IN_STEP];
    int count = 0;
    for (integer robot = 0; robot < number; robot++) {
        const struct mechanics *m = robots[robot];
        for (integer row = 0; m->arm == 0 && row < m->count; row++) {
            some[count++] = (struct advancing){
                &m->axes[row], &m->prepared[row], m->trace != 0 ? m->trace + 3 * row : 0, 3 * m->count};
            if (count == MOST_IN_STEP) {
                pass_through(periods, m->period_s, m->substeps, some, count);
                count = 0;
            }
        }
    }
    if (count > 0) {
        pass_through(periods, robots[0]->period_s, robots[0]->substeps, some, count);
    }
}

void advance(
    integer periods, real period_s, integer substeps, struct axis *axes, struct prepared *prepared, integer count, real *trace)
{
    const struct mechanics all = {
        .axes = axes, .prepared = prepared, .count = count, .period_s = period_s, .substeps = substeps, .trace = trace};
    const struct mechanics *robot = &all;
    advance_axes(&robot, 1, periods);
}

integer single_row(const struct tip *tip, const struct axis *axes, integer count)
{
    integer found = -1, open = 0;
    for (integer row = 0; row < count; row++) {
        if (axes[row].motion.mode != BRAKED) {
            found = row;
            open++;
        }
    }
    if (count == 1 && !tip->has_chain) {
        return 0;
    }
    return open == 1 ? found : -1;
}

void tip_now(const struct tip *tip, const struct axis *axes, integer count, real *acceleration)
{
    for (integer row = 0; row < count; row++) {
        const struct plant_state *s = &axes[row].plant_state;
        tip->moved[3 * row] = s->arm_angle_rad;
        tip->moved[3 * row + 1] = s->arm_speed_rad_s;
        tip->moved[3 * row + 2] = s->arm_acceleration_rad_s2;
    }
    tip_acceleration(tip, tip->moved, count, single_row(tip, axes, count), acceleration);
}

void set_point(struct axis *axis, real target_counts, real period_s)
{
    struct motion *m = &axis->motion;
    const real span = (real)m->periods_per_set_point, elapsed = (real)m->elapsed_periods, fraction = elapsed / span;
    const real last = m->target_counts;
    /* late: the set-point has been held, or led on */
    const real way = fraction <= 1.0 ? fraction : least(fraction, 1.0 + (real)m->extrapolation_periods / span);
    const real start = m->previous_counts + (last - m->previous_counts) * way;
    const real reach = m->max_speed_rad_s * m->counts_per_rad * span * period_s;
    real target = target_counts;
    if (!(m->low_counts <= target && target <= m->high_counts)) {
        m->trip |= SET_POINT_RANGE;
        target = start;
    } else if (FABS(target - (elapsed >= span - 1.0 ? last : start)) > reach + 1.0) {
        m->trip |= SET_POINT_STEP;
        target = start;
    }
    m->previous_counts = start;
    m->target_counts = target;
    m->elapsed_periods = 0;
}

/* Run the drive of a joint, and take the joint's state from its axis. */
static void take_axis(struct axis *axis, const struct flexible *joints, integer i, real period_s)
{
    joints->commands[i] = command(axis, period_s);
    joints->brakes[i] = axis->motion.mode == BRAKED ? 1.0 : 0.0;
    joints->stages[STATE * joints->count + i] = state_of(&axis->plant_state);
}

void advance_arm(
    integer periods, real period_s, integer substeps, struct axis *axes, const struct arm *arm, real *tips, integer rows)
{
    const struct flexible *joints = &arm->joints;
    const integer count = joints->count, first = periods - rows;
    for (integer period = 0; period < periods; period++) {
        for (integer i = 0; i < count; i++) {
            take_axis(&axes[joints->links[i + 1].row], joints, i, period_s);
        }
        flexible_period(joints, period_s, substeps);
        for (integer i = 0; i < count; i++) {
            struct axis *axis = &axes[joints->links[i + 1].row];
            put_back(&axis->plant_state, &joints->stages[STATE * count + i]);
            draw_noise(&axis->encoder);
            if (axis->change.is_changing > 0.0) {
                age(axis, period_s);
                take_error(&axis->plant, &joints->joints[i], &joints->near[i]);
            }
        }
        if (period >= first) {
            flexible_rest(joints);
            tool_motion(joints->links, count, arm->tool, arm->moved);
            feel(
                joints->links, count, arm->sensor, arm->moved + 3 * TOOL_ACCELERATION, arm->room,
                tips + CHANNELS * (period - first));
        }
    }
    for (integer i = 0; i < count; i++) {
        struct axis *axis = &axes[joints->links[i + 1].row];
        axis->motion.wake = axis->motion.trip != 0 || axis->motion.event != 0;
        if (periods > 0) {
            axis->plant_state.arm_acceleration_rad_s2 = joints->stages[SLOPE * count + i].w_l;
        }
    }
}

void advance_all(const struct mechanics *const *robots, integer number, integer periods)
{
    advance_axes(robots, number, periods);
    for (integer robot = 0; robot < number; robot++) {
        const struct mechanics *m = robots[robot];
        const int filters = m->sections != 0;
        if (m->arm != 0) {
            advance_arm(
                periods, m->period_s, m->substeps, m->axes, m->arm, filters ? m->tips : m->sensed, filters ? periods : 1);
        } else if (filters) {
            tip_trace(m->tip, m->trace, periods, m->count, single_row(m->tip, m->axes, m->count), m->tips);
        }
        if (filters) {
            sense(m->sections, m->ring, m->size, m->tips, periods, m->sensed);
        }
    }
}

/* The true acceleration of the tip. */
static void true_tip(const struct mechanics *m, real *acceleration)
{
    if (m->arm == 0) {
        tip_now(m->tip, m->axes, m->count, acceleration);
        return;
    }
    for (integer channel = 0; channel < CHANNELS; channel++) {
        acceleration[channel] = m->arm->moved[CHANNELS * TOOL_ACCELERATION + channel];
    }
}

void sense_now(const struct mechanics *m, real *acceleration)
{
    if (m->sensed == 0) {
        true_tip(m, acceleration);
        return;
    }
    for (integer channel = 0; channel < CHANNELS; channel++) {
        acceleration[channel] = m->sensed[channel];
    }
}

void follow(
    const struct mechanics *const *robots, integer number, integer periods, integer samples, const integer *rows, integer moving,
    const real *set_points, real *trace, real *tips, real *sensed)
{
    for (integer i = 0; i < samples; i++) {
        for (integer robot = 0; robot < number; robot++) {
            const struct mechanics *m = robots[robot];
            const integer at = robot * samples + i;
            true_tip(m, tips + CHANNELS * at);
            sense_now(m, sensed + CHANNELS * at);
            for (integer j = 0; j < moving; j++) {
                struct axis *axis = &m->axes[rows[j]];
                real *shown = trace + TRACE_COLUMNS * (at * moving + j);
                shown[TRACE_COUNTS] = axis_counts(axis);
                shown[TRACE_ARM_ANGLE] = axis->plant_state.arm_angle_rad;
                shown[TRACE_TORQUE] = axis->motion.torque_nm;
                set_point(axis, set_points[i * moving + j], m->period_s);
            }
        }
        advance_all(robots, number, periods);
    }
}
