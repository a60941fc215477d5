#include "image.h"

/* The nearest whole number within +-limit. */
static integer shown_whole(real value, real limit)
{
    return (integer)least(limit, most(-limit, nearest_whole(value)));
}

/* The head of SYNC, as its record begins. */
static int is_sync(const uint8_t *record)
{
    const uint32_t sync = 0x80;
    const uint8_t *identifier = (const uint8_t *)&sync;
    int same = record[4] == 0;
    for (integer i = 0; i < 4; i++) {
        same = same && record[i] == identifier[i];
    }
    return same;
}

/* The RPDO that a record is; null for any other frame. */
static const struct received *find_rpdo(const struct image *image, const uint8_t *record)
{
    for (integer i = 0; i < image->rpdos; i++) {
        const uint8_t *head = image->received[i].head;
        integer at = 0;
        while (at < HEAD_BYTES && head[at] == record[at]) {
            at++;
        }
        if (at == HEAD_BYTES) {
            return &image->received[i];
        }
    }
    return 0;
}

static integer unsigned_16(const uint8_t *data)
{
    return data[0] | (integer)data[1] << 8;
}

static integer signed_16(const uint8_t *data)
{
    const integer value = unsigned_16(data);
    return value < 0x8000 ? value : value - 0x10000;
}

static integer signed_32(const uint8_t *data)
{
    const integer value = unsigned_16(data) | unsigned_16(data + 2) << 16;
    return value < 0x80000000 ? value : value - 0x100000000;
}

static void put(uint8_t *data, integer size, uint64_t value)
{
    for (integer i = 0; i < size; i++) {
        data[i] = (uint8_t)(value >> 8 * i);
    }
}

integer is_plain(const struct image *image, const uint8_t *message, integer records)
{
    if (records < 1 || !is_sync(message + RECORD_BYTES * (records - 1))) {
        return 0;
    }
    for (integer i = 0; i < image->drives; i++) {
        const integer row = image->rows[i];
        const struct motion *m = &image->axes[row].motion;
        if (m->mode != image->processes[row].motion || (m->input_mask & (NEGATIVE_SWITCH | POSITIVE_SWITCH)) != 0) {
            return 0; /* a limit switch is watched by its drive */
        }
    }
    for (integer i = 0; i < records - 1; i++) {
        const uint8_t *record = message + RECORD_BYTES * i;
        const struct received *rpdo = find_rpdo(image, record);
        if (rpdo == 0) {
            return 0;
        }
        for (integer j = rpdo->first; j < rpdo->first + rpdo->count; j++) {
            const struct mapped *object = &image->taken[j];
            if (object->object == CONTROL_WORD
                && unsigned_16(record + DATA_AT + object->place) != image->processes[object->row].control_word) {
                return 0;
            }
        }
    }
    return 1;
}

void show_sample(struct tip_node *node, const real *sample)
{
    for (integer channel = 0; channel < CHANNELS; channel++) {
        node->shown[channel] = shown_whole(node->steps_per_m_s2 * sample[channel], INT16_REACH);
        node->status[channel] = !(-node->range_m_s2 < sample[channel] && sample[channel] < node->range_m_s2);
    }
}

/* Sample the tip as its node does, once for each SYNC. */
static void sample_node(const struct image *image)
{
    real acceleration[CHANNELS], sample[CHANNELS];
    if (image->sensed == 0) {
        tip_now(image->tip, image->axes, image->count, acceleration);
    }
    sample_tip(image->sensor, image->sensed == 0 ? acceleration : image->sensed, sample);
    show_sample(image->node, sample);
}

static integer status_word(const struct process *process, const struct motion *m)
{
    integer word = process->status_word | FOLLOWS_COMMAND_BIT;
    if (process->motion == POSITION && m->following_count > 0) {
        word |= FOLLOWING_ERROR_BIT;
    }
    return m->limited != 0 ? word | INTERNAL_LIMIT_BIT : word;
}

static integer shown_position(const struct process *process, const struct axis *axis)
{
    const real counts = axis_counts(axis) + process->offset_counts;
    return shown_whole(process->is_encoder != 0 ? counts : counts * process->units_per_count, INT32_REACH);
}

static void tell(const struct image *image, const struct mapped *object)
{
    uint8_t *data = image->answer + object->place;
    if (object->object == ACCELERATION) {
        put(data, 2, (uint64_t)image->node->shown[object->row]);
        return;
    }
    const struct axis *axis = &image->axes[object->row];
    const struct process *process = &image->processes[object->row];
    const struct notch_state *filter = &axis->law.notch_state[0];
    union {
        float number;
        uint32_t bits;
    } single;
    switch (object->object) {
    case STATUS_WORD:
        put(data, 2, (uint64_t)status_word(process, &axis->motion));
        break;
    case POSITION_SHOWN:
        put(data, 4, (uint64_t)shown_position(process, axis));
        break;
    case TORQUE_SHOWN:
        put(data, 2, (uint64_t)shown_whole(1000.0 * axis->motion.torque_nm / process->rated_torque_nm, INT16_REACH));
        break;
    case FILTER_ACTIVE:
        data[0] = (uint8_t)filter->active;
        break;
    default: /* FILTER_FREQUENCY */
        single.number = filter->active != 0 ? (float)filter->frequency_hz : 0.0F;
        put(data, 4, single.bits);
    }
}

static void take(const struct image *image, const struct mapped *object, const uint8_t *data)
{
    struct process *process = &image->processes[object->row];
    struct motion *m = &image->axes[object->row].motion;
    switch (object->object) {
    case TARGET_POSITION:
        process->target_position = signed_32(data);
        break;
    case POSITION_OFFSET:
        process->position_offset = signed_32(data);
        break;
    case TARGET_TORQUE:
        process->target_torque = signed_16(data);
        m->target_torque_nm = (real)process->target_torque * process->torque_quantum_nm;
        break;
    case TORQUE_OFFSET:
        process->torque_offset = signed_16(data);
        m->torque_offset_nm = (real)process->torque_offset * process->torque_quantum_nm;
        break;
    default: /* CONTROL_WORD, which the drive follows already */
        break;
    }
}

/* Give an axis what its mode makes of the newest set-point. */
static void follow_target(const struct image *image, integer row)
{
    const struct process *process = &image->processes[row];
    struct axis *axis = &image->axes[row];
    if (process->motion == TORQUE) {
        axis->motion.elapsed_periods = 0; /* the set-point is on time */
        return;
    }
    const real target = (real)(process->target_position + process->position_offset);
    const real counts = process->is_encoder != 0 ? target : nearest_whole(target / process->units_per_count);
    set_point(axis, counts - process->offset_counts, image->period_s);
}

integer synchronise(const struct image *image, const uint8_t *message, integer records)
{
    if (image->sensor->next >= NOISE_SAMPLES) {
        return NO_NOISE;
    }
    if (!is_plain(image, message, records)) {
        return NOT_PLAIN;
    }
    sample_node(image);
    for (integer i = 0; i < image->shown; i++) {
        tell(image, &image->told[i]);
    }
    for (integer i = 0; i < records - 1; i++) {
        const uint8_t *record = message + RECORD_BYTES * i;
        const struct received *rpdo = find_rpdo(image, record);
        for (integer j = rpdo->first; j < rpdo->first + rpdo->count; j++) {
            take(image, &image->taken[j], record + DATA_AT + image->taken[j].place);
        }
    }
    for (integer i = 0; i < image->drives; i++) {
        follow_target(image, image->rows[i]);
    }
    return DONE;
}

/* Let control periods pass up to an instant; the course closes where a drive wakes. */
static void move_to(struct course *course, integer instant)
{
    const struct mechanics *mechanics = course->mechanics;
    const integer periods = (instant - course->mechanics_now) / course->control_period;
    course->now = instant;
    if (periods <= 0) {
        return;
    }
    advance_all(&mechanics, 1, periods);
    course->mechanics_now += periods * course->control_period;
    for (integer row = 0; row < mechanics->count; row++) {
        course->is_open = course->is_open && !mechanics->axes[row].motion.wake;
    }
}

integer run_course(void *medium, const uint8_t *message, integer size, uint8_t *room)
{
    struct course *course = medium;
    const struct image *image = course->image;
    const integer until = course->now + course->period;
    if (!course->is_open || !image->is_whole || course->wakes_at <= until
        || synchronise(image, message, size / RECORD_BYTES) != DONE) {
        return -1;
    }
    for (integer i = 0; i < image->answer_bytes; i++) {
        room[i] = image->answer[i];
    }
    course->synced = course->now;
    move_to(course, until);
    return image->answer_bytes;
}

void pass_message(struct course *course, const uint8_t *message, integer records, integer start, integer until, integer bit_ns,
                  integer *ends)
{
    const struct image *image = course->image;
    const integer answers = image->answer_bytes / RECORD_BYTES;
    if (!course->is_open || course->wakes_at <= until || !is_plain(image, message, records)) {
        return;
    }
    frames_end(message, records, start, bit_ns, ends);
    const integer sync = ends[records - 1];
    if (sync + (INTERMISSION_BITS + answers * MOST_FRAME_BITS) * bit_ns > until) {
        return;
    }
    for (integer i = 0; i < records && course->is_open; i++) {
        move_to(course, ends[i]);
    }
    if (course->is_open && synchronise(image, message, records) == DONE) {
        course->synced = sync;
    }
}

void pass_answers(struct course *course, integer until, integer bit_ns, integer *ends)
{
    const struct image *image = course->image;
    const integer start = course->synced + INTERMISSION_BITS * bit_ns;
    frames_end(image->answer, image->answer_bytes / RECORD_BYTES, start, bit_ns, ends);
    move_to(course, until);
}
