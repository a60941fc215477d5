#include "line.h"

/* Let a medium of this process carry a message. */
static integer carried(struct line *line, const uint8_t *records, integer size, uint8_t *room)
{
    const integer received = line->carry(line->medium, records, size, room);
    line->syncs += received >= 0;
    return received < 0 ? NOT_SENT : received;
}

#ifdef _WIN32

/* There is no local bus on Windows, where drive-profiles alone runs. */
integer exchange_message(struct line *line, const uint8_t *records, integer size, real timeout_s, uint8_t *room)
{
    (void)timeout_s;
    return line->carry ? carried(line, records, size, room) : NOT_SENT;
}

#else

#include <errno.h>
#include <string.h>
#include <sys/socket.h>

/* Where the count of SYNCs begins in the record of the clock, and its bytes. */
enum { COUNT_AT = DATA_AT + 2, COUNT_BYTES = 4 };

integer exchange_message(struct line *line, const uint8_t *records, integer size, real timeout_s, uint8_t *room)
{
    if (line->carry) {
        return carried(line, records, size, room);
    }
    const int handle = (int)line->socket;
    if (line->timeout_s != timeout_s || send(handle, records, (size_t)size, MSG_DONTWAIT) < 0) {
        return NOT_SENT;
    }
    line->syncs++;
    line->is_over = 0;
    integer received = recv(handle, room, MOST_RECORDS * RECORD_BYTES, 0);
    if (received <= 0) {
        return received < 0 && (errno == EAGAIN || errno == EWOULDBLOCK) ? 0 : NOT_RECEIVED;
    }
    if (received >= RECORD_BYTES) {
        for (int i = 0; i < COUNT_BYTES; i++) {
            line->period_over[COUNT_AT + i] = (uint8_t)(line->syncs >> 8 * i & 0xFF);
        }
        line->is_over = !memcmp(room + received - RECORD_BYTES, line->period_over, RECORD_BYTES);
        received -= line->is_over ? RECORD_BYTES : 0;
    }
    return received;
}

#endif
