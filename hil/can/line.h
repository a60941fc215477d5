/* A client's end of the local bus in lock-step: a cycle crosses it in one message each way.
 *
 * Frames are records of 16 bytes as on a socket of SocketCAN: identifier, length, three bytes of padding, eight bytes of data.
 *
 * Source: linux/can.h, struct can_frame; CiA 301, 7.4.7: the bytes of a number begin with the lowest.
 */
#pragma once

#include "hil/control/real.h"

/* Bytes of a record, where its length and its data begin, and the most records of a message. */
enum { RECORD_BYTES = 16, LENGTH_AT = 4, DATA_AT = 8, MOST_RECORDS = 64 };

/* The socket, or the medium of this process that carries messages; and what its user knows of the clock. */
struct line {
    integer (*carry)(void *medium, const uint8_t *records, integer size, uint8_t *room); /* null: the socket does */
    void *medium;
    integer socket;
    real timeout_s;                    /* of the socket; below 0 if it has none */
    integer syncs;                     /* that were sent */
    integer is_over;                   /* 1 if no more frames come in the period of the last SYNC */
    uint8_t period_over[RECORD_BYTES]; /* the record that says so */
};

/* How far a cycle has come: nothing is sent; a message is sent, and none received; one has come, and is not taken, or is. */
enum { NOT_SENT = -3, NOT_RECEIVED, NOT_TAKEN, TAKEN };

/* Send a message whose last record is SYNC, and receive the next one, into room for MOST_RECORDS.
 *
 * It waits for nothing but the answer, which `carry` has at once; or it returns a number below 0, and has sent nothing. Returns
 * the bytes that have come, without the record of the clock at their end; 0 after the time-out; NOT_SENT, also if the socket has
 * another time-out; NOT_RECEIVED if a signal or an error ends the waiting. */
integer exchange_message(struct line *line, const uint8_t *records, integer size, real timeout_s, uint8_t *room);
