/* Length of classic CAN frames in bits on the wire; hil.can.bits has the layout. */
#pragma once

#include "hil/control/real.h"

/* Bits between two frames, and the most that a data frame with an 11-bit identifier takes with them: a stuff bit behind each four of
 * its bits from SOF to the CRC. */
enum { INTERMISSION_BITS = 3, MOST_FRAME_BITS = 34 + 64 + (34 + 64 - 1) / 4 + 10 + INTERMISSION_BITS };

/* Ends of data frames with 11-bit identifiers that pass a bus one behind the other, from their records of 16 bytes as on a socket of
 * SocketCAN: identifier in the byte order of the machine, length, three bytes of padding, data.
 *
 * start is the first bit of the first frame, bit_ns the time of a bit. ends becomes the end of frame of each of count records, after
 * which an intermission follows; what is no such frame takes no bits. */
void frames_end(const uint8_t *records, integer count, integer start, integer bit_ns, integer *ends);
