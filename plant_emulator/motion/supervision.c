#include "supervision.h"

void watch_limits(struct motion *motion, real speed, real counts)
{
    struct motion *m = motion;
    if (FABS(m->following_error_rad) > m->following_window_rad) {
        m->following_count += 1;
        if (m->following_count > m->following_periods) {
            m->trip |= FOLLOWING;
        }
    } else {
        m->following_count = 0;
    }
    if (FABS(speed) > m->max_speed_rad_s) {
        /* where the drive itself holds the demand to this speed, the loop's overshoot is no overspeed */
        const int is_held = m->mode == PROFILE || m->mode == VELOCITY || m->mode == PROFILE_VELOCITY;
        if (!is_held || FABS(speed) > OVERSHOOT * m->max_speed_rad_s) {
            m->trip |= OVERSPEED;
        }
    }
    if (!(m->low_counts <= counts && counts <= m->high_counts)) {
        m->trip |= OUT_OF_RANGE;
    }
}

/* Count the control periods for which a window holds; returns bit if they are enough. */
static integer counted(int holds, integer *count, integer periods, integer bit)
{
    if (!holds) {
        *count = 0;
        return 0;
    }
    const integer reached = *count >= periods ? bit : 0;
    *count += 1;
    return reached;
}

void watch_windows(struct motion *motion, real speed, real angle)
{
    struct motion *m = motion;
    const real target = m->target_counts / m->counts_per_rad;
    const int has_arrived =
        m->mode == PROFILE && m->reference_speed_rad_s == 0.0 && FABS(target - m->reference_rad) < 1e-9;
    const int in_position = has_arrived && FABS(target - angle) <= m->position_window_rad;
    const int in_speed =
        m->mode == PROFILE_VELOCITY && FABS(m->target_speed_rad_s - speed) <= m->velocity_window_rad_s;
    const int moving = FABS(speed) > m->velocity_threshold_rad_s;
    integer reached = counted(in_position, &m->position_window_count, m->position_window_periods, IN_POSITION);
    reached |= counted(in_speed, &m->velocity_window_count, m->velocity_window_periods, IN_SPEED);
    reached |= counted(moving, &m->velocity_threshold_count, m->velocity_threshold_periods, MOVING);
    m->reached = reached;
}

/* True if the motor has passed the lower end of a range on its way, the end included; `passes_high` alike for the upper. */
static int passes_low(real low, real before, real counts)
{
    return least(before, counts) < low && low <= most(before, counts);
}

static int passes_high(real high, real before, real counts)
{
    return least(before, counts) <= high && high < most(before, counts);
}

/* The end of a switch's range that the motor has passed; the present position where the switch changed by itself. */
static real boundary(real low, real high, real before, real counts)
{
    const int is_low = passes_low(low, before, counts), is_high = passes_high(high, before, counts);
    if (is_low && !is_high) {
        return low;
    }
    if (is_high && !is_low) {
        return high;
    }
    return counts;
}

/* An input: its bit, the indices of its edges, and where it is active. */
struct input {
    integer bit;
    int rising;
    int falling;
    real low;
    real high;
};

enum { INPUTS = 5 };

static void describe_inputs(const struct motion *m, struct input inputs[INPUTS])
{
    const real end = (real)INFINITY;
    inputs[0] = (struct input){NEGATIVE_SWITCH, NEGATIVE_RISING, NEGATIVE_FALLING, -end, m->negative_switch_counts};
    inputs[1] = (struct input){POSITIVE_SWITCH, POSITIVE_RISING, POSITIVE_FALLING, m->positive_switch_counts, end};
    inputs[2] = (struct input){HOME_SWITCH, HOME_RISING, HOME_FALLING, m->home_low_counts, m->home_high_counts};
    inputs[3] = (struct input){PROBE_1, PROBE_1_RISING, PROBE_1_FALLING, m->probe_1_low_counts, m->probe_1_high_counts};
    inputs[4] = (struct input){PROBE_2, PROBE_2_RISING, PROBE_2_FALLING, m->probe_2_low_counts, m->probe_2_high_counts};
}

/* Keep what an input's edge has seen, until the owner has taken it. */
static void latch(struct motion *m, const struct input *input, integer now, real counts)
{
    if (((now ^ m->inputs) & input->bit) == 0) {
        return;
    }
    const int edge = (now & input->bit) != 0 ? input->rising : input->falling;
    if ((m->edges & ((integer)1 << edge)) == 0) {
        m->edges |= (integer)1 << edge;
        m->latch_counts[edge] = boundary(input->low, input->high, m->seen_counts, counts);
    }
}

void watch_inputs(struct motion *motion, real counts)
{
    struct motion *m = motion;
    struct input inputs[INPUTS];
    integer now = m->forced_inputs;
    describe_inputs(m, inputs);
    for (int i = 0; i < INPUTS; i++) {
        if ((m->input_mask & inputs[i].bit) != 0 && inputs[i].low <= counts && counts <= inputs[i].high) {
            now |= inputs[i].bit;
        }
    }
    if (m->is_watching != 0) {
        const integer known = m->edges;
        if (now != m->inputs) {
            for (int i = 0; i < INPUTS; i++) {
                latch(m, &inputs[i], now, counts);
            }
        }
        const real turn = round_down((counts - m->index_counts) / m->counts_per_rev);
        const real before = round_down((m->seen_counts - m->index_counts) / m->counts_per_rev);
        if (turn != before && (m->edges & ((integer)1 << INDEX)) == 0) {
            m->edges |= (integer)1 << INDEX;
            m->latch_counts[INDEX] = m->index_counts + most(turn, before) * m->counts_per_rev;
        }
        m->event |= m->edges & ~known & m->edge_mask;
    }
    m->inputs = now;
    m->seen_counts = counts;
    m->is_watching = 1;
}
