/* Process data of a run: what each axis is sent with a SYNC, and what the nodes answer to it.
 *
 * Source: CiA 301, 7.4.7: the bytes of a number begin with the lowest.
 */
#pragma once

#include "hil/can/line.h"

/* Content of an axis' RPDO: control word and position; and torque; and position with torque offset. */
enum { POSITION_COMMAND, TORQUE_COMMAND, OFFSET_COMMAND };

/* Process data of one axis; the newest value wins. */
struct axis_data {
    integer command;       /* content of its RPDO */
    integer control_word;  /* of the next cycle, as the two below */
    integer target;        /* set-point: counts, or per mille of the rated torque */
    integer torque_offset; /* per mille of the rated torque */
    integer status_word;   /* of the last answer, as the three below */
    integer position_counts;
    integer torque_per_mille;
    real notch_hz;       /* zero frequency of the first filter, 0 while it is out */
    integer missing;     /* cycles in a row without an answer */
    real counts_per_rad; /* with the sign of the polarity */
    real rad_per_count;
    real per_mille_per_nm;
    real nm_per_mille;
};

/* Second encoder on a joint. */
struct joint_data {
    integer counts;
    integer has_answered; /* 1 if the last cycle brought it */
    real rad_per_count;
};

/* Content of an answer: status word, position and torque of an axis; state of its filter; position of a joint; the tip. */
enum { FEEDBACK, FILTER_STATE, JOINT_POSITION, TIP_ACCELERATION };

/* An answer that every SYNC brings. */
struct answer {
    integer can_id;
    integer content;
    integer row; /* of its axis or joint */
    integer has_come;
};

/* How the tip is measured: elsewhere than on the bus, by a node, or by all encoders of the joints. */
enum { TIP_ELSEWHERE, TIP_BY_NODE, TIP_BY_JOINTS };

/* All process data, and what is counted. */
struct exchange {
    struct axis_data *axes;
    integer axis_count;
    struct joint_data *joints;
    integer joint_count;
    struct answer *answers; /* in the order of their identifiers, in which they come */
    integer answer_count;
    integer pending;   /* answers that have not come in this cycle */
    integer lowest;    /* the first of them */
    struct line *line; /* NULL if the core cannot exchange messages itself */
    real timeout_s;    /* of answers */
    uint8_t *command;  /* records of the RPDOs, and SYNC behind them */
    integer command_bytes;
    uint8_t *message; /* room for the message that comes */
    integer message_bytes;
    integer tip; /* TIP_ELSEWHERE, TIP_BY_NODE or TIP_BY_JOINTS */
    integer tip_has_come;
    real tip_scale; /* m/s^2 per step */
    real tip_m_s2[3];
    integer cycles;
    integer missed_cycles;   /* in which an answer did not come in time */
    integer missing_answers; /* of the last cycle */
    integer sensor_missed;   /* cycles without a measurement of the tip */
};

/* Write the data of each axis' RPDO to its record of the command; the records' heads remain. */
void pack_commands(const struct exchange *e);

/* Await all answers anew. */
void await_answers(struct exchange *e);

/* Take an answer; 0 if its length is wrong, and then it has not come. */
integer take_answer(struct exchange *e, integer which, const uint8_t *data, integer length);

/* Take the answers of a message that has all of them in their order, and nothing else.
 *
 * Any other message is left alone: the result is 0. A wrong length of another content than FEEDBACK counts as missing. */
integer take_message(struct exchange *e, const uint8_t *message, integer size);

/* Count a cycle with what it has brought. */
void count_answers(struct exchange *e);

/* Count a cycle that was not sent: no drive owes an answer to it. */
void count_dropped(struct exchange *e);
