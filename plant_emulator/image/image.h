/* The process image of a robot: what a SYNC means for drives that only follow, in one call.
 *
 * A drive is plain while it is operational and enabled, follows the set-points of a cyclic mode, and gets and sends process data
 * that are listed here. Its dictionary keeps the values that PDOs bring in struct process, so that it does not matter who has
 * written them: this file or the slave in Python.
 */
#pragma once

#include "hil/can/frame_bits.h"
#include "plant_emulator/motion/period.h"

/* Bytes of a frame's record, of its identifier and length before them, and where its data begin: those of SocketCAN. */
enum { RECORD_BYTES = 16, HEAD_BYTES = 5, DATA_AT = 8 };

/* Bits of the status word that mode and motion add (CiA 402; for bits 12 and 13 the cyclic modes). */
enum { INTERNAL_LIMIT_BIT = 1 << 11, FOLLOWS_COMMAND_BIT = 1 << 12, FOLLOWING_ERROR_BIT = 1 << 13 };

/* Largest whole numbers that objects of 16 and 32 bits show, either sign. */
#define INT16_REACH 32767.0
#define INT32_REACH 2147483647.0

/* Process data of one drive, in its own units. */
struct process {
    /* values of the dictionary that PDOs bring */
    integer target_position;
    integer position_offset;
    integer target_torque;
    integer torque_offset;
    /* what the state machine says: written when it changes */
    integer motion;       /* mode of struct motion that the mode of operation means: POSITION or TORQUE */
    integer control_word; /* that the drive follows; another one is for the state machine */
    integer status_word;  /* without what mode and motion add */
    /* what the units mean: written when they change */
    integer is_encoder; /* positions are the encoder's own counts */
    real offset_counts;
    real units_per_count;
    real rated_torque_nm;
    real torque_quantum_nm;
};

/* Contents of an RPDO, and of a TPDO: objects that are known here. */
enum { CONTROL_WORD, TARGET_POSITION, POSITION_OFFSET, TARGET_TORQUE, TORQUE_OFFSET };
enum { STATUS_WORD, POSITION_SHOWN, TORQUE_SHOWN, FILTER_ACTIVE, FILTER_FREQUENCY, ACCELERATION };

/* An object in an RPDO or TPDO: which, of which axis (or channel), and where in the record, or in the whole answer. */
struct mapped {
    integer object;
    integer row;
    integer place;
};

/* An RPDO: identifier and length as its record begins, and its objects, count of them from first on. */
struct received {
    uint8_t head[RECORD_BYTES];
    integer first;
    integer count;
};

/* What the accelerometer's node shows of the last sample, and 1 for a channel that is not valid. */
struct tip_node {
    real range_m_s2;     /* where a channel ceases to be valid */
    real steps_per_m_s2; /* of what it shows */
    integer shown[CHANNELS];
    integer status[CHANNELS];
};

/* All of it. A count of rows is that of the axes; pointers are the owner's. */
struct image {
    struct axis *axes;
    integer count;
    real period_s; /* control period */
    const struct tip *tip;
    const real *sensed; /* what the sensor feels where it filters, or links couple the axes; null: the tip at this instant */
    struct tip_sensor *sensor;
    struct tip_node *node;
    struct process *processes;
    const integer *rows; /* of the plain drives, all that listen to SYNC */
    integer drives;
    const struct received *received;
    integer rpdos;
    const struct mapped *taken; /* objects of the RPDOs */
    const struct mapped *told;  /* objects of the TPDOs */
    integer shown;
    uint8_t *answer; /* records of all TPDOs in the order of their identifiers; heads are there */
    integer answer_bytes;
    integer is_whole; /* 1 if told has all objects of the TPDOs */
};

/* What synchronise has done: all; nothing, since a frame or a drive is not plain; nothing, since the noise is used up. */
enum { DONE, NOT_PLAIN, NO_NOISE };

/* Show a sample of the tip, in m/s^2. */
void show_sample(struct tip_node *node, const real *sample);

/* 1 if every frame is an RPDO that repeats its drive's control word, the last is SYNC, and every drive still follows; else 0. */
integer is_plain(const struct image *image, const uint8_t *message, integer records);

/* One SYNC: sample and pack the TPDOs, unpack the RPDOs, give the axes their set-points.
 *
 * message holds records of RPDOs and, last, of SYNC. What is not DONE has changed nothing. */
integer synchronise(const struct image *image, const uint8_t *message, integer records);

/* A stretch of a world's time, in ns, in which cycles need no Python. */
struct course {
    const struct image *image;
    const struct mechanics *mechanics;
    integer is_open; /* 1 while every node only follows its set-points and answers within the period, and no drive has woken */
    integer now;
    integer mechanics_now; /* control periods have passed up to then */
    integer wakes_at;      /* next instant at which a node acts by itself */
    integer control_period;
    integer period; /* that a SYNC is worth */
    integer synced; /* instant of the last SYNC */
};

/* Run a cycle of a struct course: one SYNC, as in synchronise, and the period behind it. A struct line of the master leads here.
 *
 * Returns the bytes of the answers, copied to room for them; or -1, and nothing has changed, if a node must hear the frames, or
 * acts by itself before the period is over. */
integer run_course(void *medium, const uint8_t *message, integer size, uint8_t *room);

/* Let the records of a message pass one behind the other from the instant start on, on a bus that nothing else uses; their last is
 * SYNC. Control periods pass meanwhile.
 *
 * ends becomes the end of each frame. Without effect if a node must hear the frames, acts by itself before until, or the answers may
 * not fit. If a drive wakes before SYNC, or a node must hear it, time ends there, and synced stays. */
void pass_message(struct course *course, const uint8_t *message, integer records, integer start, integer until, integer bit_ns,
                  integer *ends);

/* Let the answers to the last SYNC pass, and control periods up to until; ends as above. */
void pass_answers(struct course *course, integer until, integer bit_ns, integer *ends);
