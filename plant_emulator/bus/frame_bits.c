#include "frame_bits.h"

/* Where a record has its length and its data, and how long it is. */
enum { LENGTH_PLACE = 4, DATA_PLACE = 8, BYTES_OF_RECORD = 16 };
/* x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1, without its first term (ISO 11898-1:2015, 10.4.2.6). */
enum { POLYNOMIAL = 0x4599, CHECK_BITS = 15 };
/* CRC delimiter, ACK slot and delimiter, end of frame, intermission: they are not stuffed. */
enum { UNSTUFFED_BITS = 1 + 1 + 1 + 7 + INTERMISSION_BITS };
/* After so many equal bits the sender inserts one of the other value, which itself counts for the next. */
enum { EQUAL_BITS = 5 };

struct wire_bits {
    uint32_t last; /* value of the last bit sent */
    integer run;   /* equal bits so far, the last one included */
    integer sent;
    uint32_t check;
};

static void send_bits(struct wire_bits *w, uint32_t value, integer count)
{
    for (integer i = count - 1; i >= 0; i--) {
        const uint32_t bit = value >> i & 1u;
        const uint32_t carry = (w->check >> (CHECK_BITS - 1) & 1u) ^ bit;
        w->check = (w->check << 1 & 0x7FFFu) ^ (carry != 0 ? POLYNOMIAL : 0);
        w->run = bit == w->last ? w->run + 1 : 1;
        w->last = bit;
        w->sent++;
        if (w->run == EQUAL_BITS) {
            w->last = !bit;
            w->run = 1;
            w->sent++;
        }
    }
}

static integer frame_bits(const uint8_t *record)
{
    union {
        uint8_t bytes[4];
        uint32_t number;
    } can_id = {{record[0], record[1], record[2], record[3]}};
    const uint8_t length = record[LENGTH_PLACE];
    if (can_id.number > 0x7FF || length > 8) {
        return 0;
    }
    struct wire_bits w = {1, 0, 0, 0}; /* idle is recessive, and its bits do not count */
    send_bits(&w, can_id.number << 3, 1 + 11 + 3); /* SOF, identifier; RTR, IDE and r0 are dominant */
    send_bits(&w, length, 4);
    for (integer byte = 0; byte < length; byte++) {
        send_bits(&w, record[DATA_PLACE + byte], 8);
    }
    send_bits(&w, w.check, CHECK_BITS);
    return w.sent + UNSTUFFED_BITS;
}

void frames_end(const uint8_t *records, integer count, integer start, integer bit_ns, integer *ends)
{
    integer idle = start;
    for (integer i = 0; i < count; i++) {
        idle += frame_bits(records + BYTES_OF_RECORD * i) * bit_ns;
        ends[i] = idle - INTERMISSION_BITS * bit_ns;
    }
}
