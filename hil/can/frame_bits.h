/* Bits of CAN frames of up to 8 bytes on the wire; hil/can/bits.py has the layout. */
#pragma once

#include "hil/control/real.h"

/* Bits between two frames, and the most that a classic data frame with an 11-bit identifier takes with them: a stuff bit behind each
 * four of its bits from SOF to the CRC. */
enum { INTERMISSION_BITS = 3, MOST_FRAME_BITS = 34 + 64 + (34 + 64 - 1) / 4 + 10 + INTERMISSION_BITS };
/* Room for the bits of any frame from SOF to the CRC. */
enum { SENT_BITS = 192 };

/* Send a classic frame, its identifier with the flags of SocketCAN. Returns the number of bits from SOF to the CRC, stuff bits
 * included. sent becomes these bits, where it is not null. */
integer send_classic(uint32_t can_id, const uint8_t *data, integer length, uint8_t *sent);

/* The same of a CAN FD frame with bit rate switching. Of its bits, slow becomes the number of those up to BRS. */
integer send_fd(uint32_t identifier, integer is_extended, const uint8_t *data, integer length, uint8_t *sent, integer *slow);

/* Ends of data frames with 11-bit identifiers that pass a bus one behind the other, from their records of 16 bytes as on a socket of
 * SocketCAN: identifier in the byte order of the machine, length, three bytes of padding, data.
 *
 * start is the first bit of the first frame, bit_ns the time of a bit. ends becomes the end of frame of each of count records, after
 * which an intermission follows; what is no such frame takes no bits. */
void frames_end(const uint8_t *records, integer count, integer start, integer bit_ns, integer *ends);
