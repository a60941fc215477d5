/* The master's checks of an axis while it moves: limits, and the health of its drive. */
#pragma once

#include "hil/control/real.h"

/* What is wrong with an axis: nothing; it does not answer; its drive has left operation; it turns too fast; it is beyond its
 * limits; it gives too much torque; it is too far behind its set-point. */
enum { IN_ORDER, SILENT, NOT_IN_OPERATION, TOO_FAST, BEYOND_LIMITS, TOO_MUCH_TORQUE, TOO_FAR_BEHIND };

/* Impossible positions in a row that stop a run; a single one may be a frame that was damaged unseen. */
#define WILD_LIMIT 2

/* Limits of an axis in the units of its measurements, and what is known from the cycles before. */
struct guard {
    integer missing_limit; /* missing answers in a row that stop a run */
    real period_s;
    real reach_rad; /* the largest turn within a period */
    real low_rad;
    real high_rad;
    real torque_nm;
    real window_rad;     /* following error */
    real window_s;       /* time that it may last */
    integer discarded;   /* impossible positions so far */
    integer has_last;    /* 1 if last_rad is a position */
    real last_rad;
    integer cycles;      /* since that position */
    integer may_be_late; /* positions to come that may be a period older than they seem */
    integer wild;        /* impossible positions in a row */
    real wild_rps;       /* speed by the last of them */
    real beyond_s;       /* time that the following error has lasted */
};

/* 1 if the axis can be at a position, by the motor's speed limit and the time since the last position.
 *
 * The caller ignores any other position, as if the answer were missing; WILD_LIMIT in a row are TOO_FAST to guard_check. After a
 * missing answer the next one may be the late one, and then it is a period older than it seems. missing counts cycles in a row
 * without an answer. */
integer guard_accepts(struct guard *guard, real position_rad, integer missing);

/* What is wrong with an axis after guard_accepts. Where an answer is missing, the other values are not checked. */
integer guard_check(
    struct guard *guard, integer status_word, real position_rad, real reference_rad, real torque_nm, integer missing);

/* Note a cycle without a measurement: the next position is more than a period away from the last. */
void guard_skip(struct guard *guard);
