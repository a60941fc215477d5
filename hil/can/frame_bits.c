#include "frame_bits.h"

/* Where a record has its length and its data, and how long it is. */
enum { LENGTH_PLACE = 4, DATA_PLACE = 8, BYTES_OF_RECORD = 16 };
/* CRC delimiter, ACK slot and delimiter, end of frame, intermission: they are not stuffed. */
enum { UNSTUFFED_BITS = 1 + 1 + 1 + 7 + INTERMISSION_BITS };
/* After so many equal bits the sender inserts one of the other value, which itself counts for the next. */
enum { EQUAL_BITS = 5 };
/* The bits of a CRC, and its polynomial without the first term (ISO 11898-1:2015, 10.4.2.6): x^15 + x^14 + x^10 + x^8 + x^7 + x^4 +
 * x^3 + 1, and that of CAN FD frames of up to 16 bytes. */
enum { CRC_BITS = 15, POLYNOMIAL = 0x4599, FD_CRC_BITS = 17, FD_POLYNOMIAL = 0x1685B };
/* Flags of an identifier, as in linux/can.h. */
#define LONG_FLAG 0x80000000u
#define REMOTE_FLAG 0x40000000u

struct sender {
    uint8_t *room; /* null: the bits are only counted */
    integer sent;
    integer inserted; /* stuff bits among them */
    uint32_t last;
    integer run; /* equal bits so far, the last one included */
    integer is_fd;
    uint32_t check;
};

static void put(struct sender *s, uint32_t bit)
{
    if (s->room != 0) {
        s->room[s->sent] = (uint8_t)bit;
    }
    s->sent++;
    s->run = bit == s->last ? s->run + 1 : 1;
    s->last = bit;
}

static void check(struct sender *s, uint32_t bit)
{
    const integer bits = s->is_fd ? FD_CRC_BITS : CRC_BITS;
    const uint32_t carry = (s->check >> (bits - 1) & 1u) ^ bit;
    s->check = (s->check << 1 & ((1u << bits) - 1u)) ^ (carry != 0 ? (s->is_fd ? FD_POLYNOMIAL : POLYNOMIAL) : 0);
}

/* Insert a stuff bit where one is due. Only the CRC of CAN FD covers it. */
static void stuff(struct sender *s)
{
    if (s->run == EQUAL_BITS) {
        const uint32_t bit = !s->last;
        if (s->is_fd) {
            check(s, bit);
        }
        put(s, bit);
        s->inserted++;
    }
}

static void send(struct sender *s, uint32_t value, integer count)
{
    for (integer i = count - 1; i >= 0; i--) {
        const uint32_t bit = value >> i & 1u;
        stuff(s);
        check(s, bit);
        put(s, bit);
    }
}

/* SOF and identifier, with SRR and IDE of a long one. */
static void send_identifier(struct sender *s, uint32_t identifier, integer is_long)
{
    s->last = 1; /* idle is recessive, and its bits do not count */
    send(s, 0, 1);
    if (is_long) {
        send(s, identifier >> 18 & 0x7FFu, 11);
        send(s, 3, 2);
        send(s, identifier & 0x3FFFFu, 18);
    } else {
        send(s, identifier & 0x7FFu, 11);
    }
}

static void send_data(struct sender *s, const uint8_t *data, integer length)
{
    for (integer byte = 0; byte < length; byte++) {
        send(s, data[byte], 8);
    }
}

integer send_classic(uint32_t can_id, const uint8_t *data, integer length, uint8_t *sent)
{
    struct sender s = {.room = sent};
    const uint32_t remote = (can_id & REMOTE_FLAG) != 0;
    send_identifier(&s, can_id, (can_id & LONG_FLAG) != 0);
    send(&s, remote << 2, 3); /* RTR; r1 or IDE, and r0, are dominant */
    send(&s, (uint32_t)length, 4);
    send_data(&s, data, remote ? 0 : length);
    send(&s, s.check, CRC_BITS);
    stuff(&s);
    return s.sent;
}

integer send_fd(uint32_t identifier, integer is_extended, const uint8_t *data, integer length, uint8_t *sent, integer *slow)
{
    struct sender s = {.room = sent, .is_fd = 1, .check = 1u << (FD_CRC_BITS - 1)};
    send_identifier(&s, identifier, is_extended);
    send(&s, 5, is_extended ? 4 : 5); /* RRS, IDE of a short one, FDF 1, res, BRS 1 */
    *slow = s.sent;
    send(&s, (uint32_t)length, 5); /* ESI, DLC */
    send_data(&s, data, length);
    const uint32_t count = s.inserted & 7u, gray = count ^ count >> 1;
    const uint32_t stuff_count = gray << 1 | ((gray ^ gray >> 1 ^ gray >> 2) & 1u);
    for (integer i = 3; i >= 0; i--) {
        check(&s, stuff_count >> i & 1u);
    }
    const uint32_t checked = stuff_count << FD_CRC_BITS | s.check;
    for (integer i = 3 + FD_CRC_BITS; i >= 0; i--) {
        if (i % 4 == (3 + FD_CRC_BITS) % 4) {
            put(&s, !s.last); /* a fixed stuff bit */
        }
        put(&s, checked >> i & 1u);
    }
    return s.sent;
}

void frames_end(const uint8_t *records, integer count, integer start, integer bit_ns, integer *ends)
{
    integer idle = start;
    for (integer i = 0; i < count; i++) {
        const uint8_t *record = records + BYTES_OF_RECORD * i;
        union {
            uint8_t bytes[4];
            uint32_t number;
        } can_id = {{record[0], record[1], record[2], record[3]}};
        const uint8_t length = record[LENGTH_PLACE];
        const integer is_plain = can_id.number <= 0x7FF && length <= 8;
        idle += is_plain ? (send_classic(can_id.number, record + DATA_PLACE, length, 0) + UNSTUFFED_BITS) * bit_ns : 0;
        ends[i] = idle - INTERMISSION_BITS * bit_ns;
    }
}
