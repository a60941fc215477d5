#include "run.h"

#include <string.h>

/* Round a number to an integer of at most bits bits; 0 if it does not fit, NaN included. */
static int round_to(integer *result, real number, int bits)
{
    const real rounded = nearest_whole(number), limit = (real)((integer)1 << (bits - 1));
    if (!(rounded >= -limit && rounded < limit)) {
        return 0;
    }
    *result = (integer)rounded;
    return 1;
}

static integer refuse(struct run *run, integer row, real value, integer reason)
{
    run->refused = row;
    run->value = value;
    return reason;
}

integer set_targets(struct run *run, const real *torque_offset_nm, integer has_additions)
{
    const integer count = run->exchange->axis_count;
    const real *reference = run->values + REFERENCE_ROW * count;
    const real *addition_rad = run->values + ADDITION_ROW * count, *addition_nm = run->values + OFFSET_ROW * count;
    for (integer row = 0; row < count; row++) {
        struct axis_run *axis = &run->axes[row];
        struct axis_data *data = &run->exchange->axes[row];
        real wanted = reference[row], torque = torque_offset_nm ? torque_offset_nm[row] : 0.0;
        if (has_additions) {
            wanted += addition_rad[row];
            torque += addition_nm[row];
            if (run->has_sent) {
                wanted = least(most(wanted, axis->sent_rad - axis->step_rad), axis->sent_rad + axis->step_rad);
            }
            axis->sent_rad = wanted;
        }
        if (!round_to(&data->target, wanted * data->counts_per_rad, 32)) {
            return refuse(run, row, wanted, POSITION_REFUSED);
        }
        if (torque != 0.0 || data->torque_offset != 0) {
            if (!(FABS(torque) <= axis->torque_limit_nm)) {
                return refuse(run, row, torque, OFFSET_BEYOND_LIMIT);
            }
            if (!round_to(&data->torque_offset, torque * data->per_mille_per_nm, 16)) {
                return refuse(run, row, torque, TORQUE_REFUSED);
            }
        }
    }
    run->has_sent = has_additions;
    return IN_ORDER;
}

void accept_positions(struct run *run, integer was_dropped)
{
    const integer count = run->exchange->axis_count;
    real *position = run->values + POSITION_ROW * count, *torque = run->values + TORQUE_ROW * count;
    for (integer row = 0; row < count; row++) {
        struct axis_data *data = &run->exchange->axes[row];
        integer *trusted = &run->axes[row].trusted_counts;
        if (!was_dropped) {
            if (guard_accepts(&run->guards[row], (real)data->position_counts * data->rad_per_count, data->missing)) {
                *trusted = data->position_counts;
            } else {
                data->position_counts = *trusted;
            }
        }
        position[row] = (real)data->position_counts * data->rad_per_count;
        torque[row] = (real)data->torque_per_mille * data->nm_per_mille;
    }
}

/* Run the control laws on the values just received; their torques are sent with the next cycle. */
static integer close_loops(struct run *run)
{
    const integer count = run->exchange->axis_count;
    real *reference = run->loop, *angle = run->loop + count;
    const real *torque = run->loop + 3 * count;
    for (integer row = 0; row < count; row++) {
        reference[row] = run->values[REFERENCE_ROW * count + row];
        angle[row] = run->values[POSITION_ROW * count + row];
    }
    bank_step(run->laws, count, run->period_s, run->loop);
    for (integer row = 0; row < count; row++) {
        struct axis_data *data = &run->exchange->axes[row];
        if (!round_to(&data->target, torque[row] * data->per_mille_per_nm, 16)) {
            return refuse(run, row, torque[row], TORQUE_REFUSED);
        }
    }
    return IN_ORDER;
}

/* Write a row of the recording, but for its time. */
static void keep(const struct run *run, real *values)
{
    const struct exchange *e = run->exchange;
    const integer count = e->axis_count;
    for (int i = 0; i < 3; i++) {
        values[1 + i] = e->tip_m_s2[i];
    }
    values[4] = (real)e->missing_answers;
    values += COMMON_COLUMNS;
    for (integer row = 0; row < count; row++) {
        values[0] = run->values[REFERENCE_ROW * count + row];
        values[1] = run->values[POSITION_ROW * count + row];
        values[2] = run->values[TORQUE_ROW * count + row];
        values[3] = run->laws ? run->loop[4 * count + row] : e->axes[row].notch_hz;
        values += AXIS_COLUMNS;
    }
    for (integer row = 0; row < e->joint_count; row++) {
        const struct joint_data *joint = &e->joints[row];
        values[row] = joint->has_answered ? (real)joint->counts * joint->rad_per_count : (real)NAN;
    }
}

integer end_cycle(struct run *run, integer row, integer was_dropped)
{
    const integer count = run->exchange->axis_count;
    const real *reference = run->values + REFERENCE_ROW * count;
    const real *position = run->values + POSITION_ROW * count, *torque = run->values + TORQUE_ROW * count;
    accept_positions(run, was_dropped);
    const integer refused = run->laws ? close_loops(run) : IN_ORDER;
    if (row >= 0) {
        keep(run, run->rows + row * run->columns);
    }
    if (refused) {
        return refused;
    }
    for (integer i = 0; i < count; i++) {
        struct guard *guard = &run->guards[i];
        if (was_dropped) {
            guard_skip(guard);
            continue;
        }
        const struct axis_data *data = &run->exchange->axes[i];
        const integer reason = guard_check(guard, data->status_word, position[i], reference[i], torque[i], data->missing);
        if (reason) {
            return refuse(run, i, position[i], reason);
        }
    }
    return IN_ORDER;
}

integer take_cycle(struct exchange *e, struct run *run, integer row, const uint8_t *message, integer size)
{
    if (e->tip == TIP_ELSEWHERE || !take_message(e, message, size)) {
        return NOT_TAKEN;
    }
    count_answers(e);
    return row == NOT_ENDED ? TAKEN : end_cycle(run, row, 0);
}

integer begin_cycle(struct run *run, const struct stretch *stretch)
{
    if (!stretch->reference) {
        return IN_ORDER;
    }
    const integer count = run->exchange->axis_count, first = stretch->done * count;
    for (integer row = 0; row < count; row++) {
        run->values[REFERENCE_ROW * count + row] = stretch->reference[first + row];
    }
    if (run->cancellation) {
        for (integer i = 0; i < 2 * count; i++) {
            run->values[ADDITION_ROW * count + i] = run->values[POSITION_ROW * count + i];
        }
        cancel(run->cancellation, run->values + ADDITION_ROW * count);
    }
    const real *torque_nm = stretch->torque_offset_nm ? stretch->torque_offset_nm + first : 0;
    return run->laws ? IN_ORDER : set_targets(run, torque_nm, stretch->has_additions);
}

/* Run one cycle in one message each way. */
static integer run_cycle(struct exchange *e, struct run *run, integer row)
{
    pack_commands(e);
    if (!e->line) {
        return NOT_SENT;
    }
    const integer reached = exchange_message(e->line, e->command, e->command_bytes, e->timeout_s, e->message);
    if (reached < 0) {
        return reached;
    }
    e->message_bytes = reached;
    return take_cycle(e, run, row, e->message, reached);
}

/* Keep the records of the cycle that has ended. */
static void log_cycle(const struct exchange *e, const struct stretch *stretch)
{
    uint8_t *place = stretch->log + stretch->done * (e->command_bytes + e->message_bytes);
    memcpy(place, e->command, (size_t)e->command_bytes);
    memcpy(place + e->command_bytes, e->message, (size_t)e->message_bytes);
}

/* Run the next cycles, as run_cycles does, which spends the stretch. */
static integer run_some(struct exchange *e, struct run *run, struct stretch *stretch)
{
    const integer count = stretch->log && stretch->count > LOGGED_CYCLES ? LOGGED_CYCLES : stretch->count;
    integer found;
    stretch->done = 0;
    do {
        found = begin_cycle(run, stretch);
        if (found != IN_ORDER) {
            return found;
        }
        found = run_cycle(e, run, stretch->row < 0 ? stretch->row : stretch->row + stretch->done);
        if (found < 0) {
            return found;
        }
        if (stretch->log) {
            log_cycle(e, stretch);
        }
        stretch->now_s += stretch->period_s;
        stretch->done++;
    } while (found == IN_ORDER && stretch->done < count && stretch->now_s < stretch->until_s);
    return found;
}

integer run_cycles(struct exchange *e, struct run *run, struct stretch *stretch)
{
    const integer found = run_some(e, run, stretch);
    if (found >= 0) {
        stretch->reference = 0;
        stretch->count = 1;
        stretch->row = NOT_ENDED;
    }
    return found;
}
