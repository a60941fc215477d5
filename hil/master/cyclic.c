#include "cyclic.h"

/* Bytes of each content. */
static const integer lengths[] = {8, 5, 4, 6};

/* An INTEGER16 and an INTEGER32 of the bus. */
static integer integer16(const uint8_t *data)
{
    const integer value = data[0] | data[1] << 8;
    return value < 0x8000 ? value : value - 0x10000;
}

static integer integer32(const uint8_t *data)
{
    const integer value = (integer)data[0] | (integer)data[1] << 8 | (integer)data[2] << 16 | (integer)data[3] << 24;
    return value < 0x80000000 ? value : value - 0x100000000;
}

/* A REAL32 of the bus. */
static real real32(const uint8_t *data)
{
    const union {
        uint32_t bits;
        float value;
    } number = {(uint32_t)data[0] | (uint32_t)data[1] << 8 | (uint32_t)data[2] << 16 | (uint32_t)data[3] << 24};
    return number.value;
}

/* Identifier of a record, in the byte order of this machine. */
static integer identifier(const uint8_t *record)
{
    const union {
        uint8_t bytes[4];
        uint32_t value;
    } number = {{record[0], record[1], record[2], record[3]}};
    return number.value;
}

/* Write the lowest bytes of a number; returns what is behind them. */
static uint8_t *put(uint8_t *data, integer value, int bytes)
{
    for (int i = 0; i < bytes; i++) {
        *data++ = (uint8_t)(value >> 8 * i & 0xFF);
    }
    return data;
}

void pack_commands(const struct exchange *e)
{
    for (integer row = 0; row < e->axis_count; row++) {
        const struct axis_data *axis = &e->axes[row];
        uint8_t *data = put(e->command + row * RECORD_BYTES + DATA_AT, axis->control_word, 2);
        data = put(data, axis->target, axis->command == TORQUE_COMMAND ? 2 : 4);
        if (axis->command == OFFSET_COMMAND) {
            put(data, axis->torque_offset, 2);
        }
    }
}

void await_answers(struct exchange *e)
{
    for (integer which = 0; which < e->answer_count; which++) {
        e->answers[which].has_come = 0;
    }
    e->pending = e->answer_count;
    e->lowest = 0;
}

integer take_answer(struct exchange *e, integer which, const uint8_t *data, integer length)
{
    struct answer *answer = &e->answers[which];
    if (length != lengths[answer->content]) {
        return 0;
    }
    switch (answer->content) {
    case FEEDBACK: {
        struct axis_data *axis = &e->axes[answer->row];
        axis->status_word = data[0] | data[1] << 8;
        axis->position_counts = integer32(data + 2);
        axis->torque_per_mille = integer16(data + 6);
        break;
    }
    case FILTER_STATE: {
        const real frequency_hz = real32(data + 1);
        e->axes[answer->row].notch_hz = data[0] != 0 && isfinite(frequency_hz) ? frequency_hz : 0.0;
        break;
    }
    case JOINT_POSITION:
        e->joints[answer->row].counts = integer32(data);
        break;
    default:
        for (int i = 0; i < 3; i++) {
            e->tip_m_s2[i] = (real)integer16(data + 2 * i) * e->tip_scale;
        }
    }
    if (!answer->has_come) {
        answer->has_come = 1;
        e->pending--;
        while (e->lowest < e->answer_count && e->answers[e->lowest].has_come) {
            e->lowest++;
        }
    }
    return 1;
}

integer take_message(struct exchange *e, const uint8_t *message, integer size)
{
    if (size != e->answer_count * RECORD_BYTES) {
        return 0;
    }
    for (integer which = 0; which < e->answer_count; which++) {
        const struct answer *answer = &e->answers[which];
        const uint8_t *record = message + which * RECORD_BYTES;
        if (identifier(record) != answer->can_id || (answer->content == FEEDBACK && record[LENGTH_AT] != lengths[FEEDBACK])) {
            return 0;
        }
    }
    await_answers(e);
    for (integer which = 0; which < e->answer_count; which++) {
        const uint8_t *record = message + which * RECORD_BYTES;
        take_answer(e, which, record + DATA_AT, record[LENGTH_AT]);
    }
    return 1;
}

void count_answers(struct exchange *e)
{
    integer joints = 0;
    for (integer which = 0; which < e->answer_count; which++) {
        const struct answer *answer = &e->answers[which];
        switch (answer->content) {
        case FEEDBACK: {
            struct axis_data *axis = &e->axes[answer->row];
            axis->missing = answer->has_come ? 0 : axis->missing + 1;
            break;
        }
        case JOINT_POSITION:
            e->joints[answer->row].has_answered = answer->has_come;
            joints += answer->has_come;
            break;
        case TIP_ACCELERATION:
            e->tip_has_come = answer->has_come;
            break;
        default:
            break;
        }
    }
    if (e->tip == TIP_BY_JOINTS) {
        e->tip_has_come = joints == e->joint_count;
    }
    e->cycles++;
    e->missed_cycles += e->pending > 0;
    e->missing_answers = e->pending;
    e->sensor_missed += !e->tip_has_come;
}

void count_dropped(struct exchange *e)
{
    for (integer row = 0; row < e->joint_count; row++) {
        e->joints[row].has_answered = 0;
    }
    e->cycles++;
    e->missing_answers = e->answer_count;
    e->sensor_missed++;
}
