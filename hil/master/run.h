/* A cycle of a run: set-points before the exchange, and the checks, the host's loops and the recording after it. */
#pragma once

#include "cyclic.h"
#include "guard.h"
#include "hil/control/cancellation.h"
#include "hil/control/servo.h"

/* Set-points that are refused, beside what is wrong with an axis: a position or a torque that its object cannot hold, and a
 * torque offset beyond the limit of its axis. */
enum { POSITION_REFUSED = 100, TORQUE_REFUSED, OFFSET_BEYOND_LIMIT };

/* Values of a row of the recording before those of the axes, and of each axis: time, X, Y and Z of the tip, missing answers;
 * reference, position, torque, notch frequency. */
enum { COMMON_COLUMNS = 5, AXIS_COLUMNS = 4 };

/* Rows of the values of all axes: the motion's set-points, additions to them in rad and N m, measured positions and torques. */
enum { REFERENCE_ROW, ADDITION_ROW, OFFSET_ROW, POSITION_ROW, TORQUE_ROW, VALUE_ROWS };

/* What a run knows of an axis beside its guard. */
struct axis_run {
    real torque_limit_nm;   /* of torque offsets */
    real step_rad;          /* the largest step of a set-point with additions */
    real sent_rad;          /* the last one, before it was rounded */
    integer trusted_counts; /* the last position that can be */
};

/* All axes of a run. */
struct run {
    struct exchange *exchange;
    struct guard *guards;
    struct axis_run *axes;
    real *values;     /* VALUE_ROWS rows of a value per axis */
    integer has_sent; /* 1 if sent_rad holds a set-point */
    struct law *laws; /* of loops that the host closes; NULL if the drives close them */
    real *loop;       /* values of bank_step */
    real period_s;
    real *rows; /* of the recording */
    integer columns;
    const struct cancellation *cancellation; /* whose additions belong to the set-points; null without one */
    integer refused;                         /* index of the axis with which something is wrong */
    real value;      /* what is refused of it */
};

/* Set the targets of the next cycle, drive-closed: the motion's set-points, with additions where has_additions is 1.
 *
 * torque_offset_nm has the motion's torque offsets, or is NULL. Set-points with additions step by step_rad at most; the next
 * cycles make up for the rest. Numbers are rounded to the nearest integer, halves to even. Returns IN_ORDER, or why a set-point
 * is refused: nothing may be sent then. */
integer set_targets(struct run *run, const real *torque_offset_nm, integer has_additions);

/* Take the positions that the axes can have; others are replaced by the last such one, as if no answer had come.
 *
 * was_dropped is 1 after a cycle that was not sent, in which nothing is checked. */
void accept_positions(struct run *run, integer was_dropped);

/* End a cycle: accept positions, close the host's loops, record a row unless it is -1, and check all axes.
 *
 * Returns IN_ORDER, or what is wrong with the first axis that is not in order. */
integer end_cycle(struct run *run, integer row, integer was_dropped);

/* In place of a row: the cycle is not ended, as while drives are enabled or disabled. */
enum { NOT_ENDED = -2 };

/* Take a message with all answers of a cycle, count the cycle, and end it unless the row is NOT_ENDED.
 *
 * Returns NOT_TAKEN if the message is another, or the tip is measured elsewhere; else TAKEN, or what end_cycle returns. */
integer take_cycle(struct exchange *e, struct run *run, integer row, const uint8_t *message, integer size);

/* Most cycles of a stretch that is logged. */
enum { LOGGED_CYCLES = 256 };

/* Cycles to come, and how far they have come. */
struct stretch {
    integer count;         /* of cycles */
    integer row;           /* of the recording, in which the first ends; -1 without one; NOT_ENDED */
    const real *reference; /* a row of set-points for each cycle; null: the targets are set */
    const real *torque_offset_nm; /* a row of torque offsets for each; null: none */
    integer has_additions; /* 1 if set-points have additions: those of one cycle, unless the run's cancellation makes them */
    real now_s;            /* the bench's time */
    real period_s;         /* that a cycle is worth */
    real until_s;          /* no second cycle begins from then on */
    integer done;          /* cycles that have ended */
    uint8_t *log;          /* room for the records of LOGGED_CYCLES: of each, what was sent and what has come; null without a log */
};

/* Set the targets of the next cycle of a stretch. The host's loops, where it closes them, set them at the end of the last cycle.
 *
 * Returns what set_targets returns. */
integer begin_cycle(struct run *run, const struct stretch *stretch);

/* Run the next cycles, each in one message each way, as far as that goes: see begin_cycle, exchange_message and take_cycle.
 *
 * Returns IN_ORDER after a last cycle in order; what begin_cycle refuses, or end_cycle has found, after which no cycle
 * follows; or a number below 0: how far the cycle behind those that are done has come. Unless it is below 0, the stretch is one cycle
 * then, which is not ended. */
integer run_cycles(struct exchange *e, struct run *run, struct stretch *stretch);
