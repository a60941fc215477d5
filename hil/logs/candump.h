/* candump's logs, read as fast as the disk gives them: `(1.5) can0 181#0011` and `(1.5)  can0  181   [2]  00 11`.
 *
 * What is not a frame is counted, and left out.
 *
 * Source: can-utils, candump -l, candump -t a|z|A and -x; the flags of an identifier as of linux/can.h.
 */
#pragma once

#include <stdint.h>

/* Counters that are carried from chunk to chunk: bytes and lines that were read, lines that cannot be read and the first of
 * them, frames of CAN FD, the hash of the interface that is read (0: that of the first frame), frames of others. */
enum { CONSUMED, READ_LINES, UNREADABLE, FIRST_UNREADABLE, FLEXIBLE, INTERFACE, ELSEWHERE, COUNTED };

/* Frames of whole lines, each with its end; returns how many there were.
 *
 * stamps become ns (-1: none), ids identifiers with their flags, lengths and data those of the frames; all have room for room
 * frames, which is where reading ends at the latest. */
int64_t parse_candump(
    const uint8_t *text, int64_t size, int64_t *stamps, int64_t *ids, uint8_t *lengths, uint64_t *data, int64_t room,
    int64_t *counters);
