/* Length of classic CAN frames in bits on the wire; hil.can.bits has the layout. */
#ifndef PLANT_FRAME_BITS_H
#define PLANT_FRAME_BITS_H

#include "hil/control/real.h"

/* Bits of data frames with 11-bit identifiers, stuff bits and intermission included, from their records of 16 bytes as on a socket
 * of SocketCAN: identifier in the byte order of the machine, length, three bytes of padding, data.
 *
 * bits becomes a number for each of count records; 0 for what is no such frame. */
void frames_bits(const uint8_t *records, integer count, integer *bits);

#endif
