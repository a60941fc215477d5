#include "candump.h"

/* Flags of an identifier: 29 bits long, remote frame, error frame. */
#define EXTENDED 0x80000000LL
#define REMOTE 0x40000000LL
#define ERROR_FRAME 0x20000000LL

enum { NO_FRAME, FRAME, FD_FRAME, EMPTY_LINE };

/* Value of a hexadecimal digit; -1 where it is none. */
static int digit(uint8_t c)
{
    if (c >= '0' && c <= '9') {
        return c - '0';
    }
    if (c >= 'A' && c <= 'F') {
        return c - 'A' + 10;
    }
    if (c >= 'a' && c <= 'f') {
        return c - 'a' + 10;
    }
    return -1;
}

/* Nanoseconds of `1.5` or `2026-11-23 12:00:00.5`; -1 where it is no stamp. */
static int64_t stamp_ns(const uint8_t *text, int64_t at, int64_t end)
{
    int64_t parts[6] = {0, 0, 0, 0, 0, 0};
    int64_t nanoseconds = 0, scale = 100000000;
    int number = 0, digits = 0, is_fraction = 0;
    for (int64_t position = at; position < end; position++) {
        const uint8_t c = text[position];
        if (c >= '0' && c <= '9') {
            if (++digits > 26) {
                return -1;
            }
            if (is_fraction) {
                nanoseconds += (c - '0') * scale;
                scale /= 10;
            } else if (parts[number] > 900000000000000000LL) {
                return -1;
            } else {
                parts[number] = 10 * parts[number] + (c - '0');
            }
        } else if (c == '.' && !is_fraction) {
            is_fraction = 1;
        } else if ((c == '-' || c == ':' || c == ' ') && !is_fraction && number < 5 && position > at) {
            number++;
        } else {
            return -1;
        }
    }
    if (digits == 0) {
        return -1;
    }
    if (number == 0) {
        return parts[0] > 9000000000LL ? -1 : parts[0] * 1000000000 + nanoseconds;
    }
    if (number != 5 || parts[1] < 1 || parts[1] > 12 || parts[0] < 1970 || parts[0] > 2200) {
        return -1;
    }
    for (int i = 2; i < 6; i++) {
        if (parts[i] > 1000000) {
            return -1;
        }
    }
    /* days since 1970 by the civil calendar, the year beginning in March */
    const int64_t year = parts[0] - (parts[1] <= 2 ? 1 : 0), month = (parts[1] + 9) % 12;
    const int64_t days =
        365 * year + year / 4 - year / 100 + year / 400 + (153 * month + 2) / 5 + parts[2] - 1 - 719468;
    return ((days * 24 + parts[3]) * 3600 + parts[4] * 60 + parts[5]) * 1000000000 + nanoseconds;
}

/* Position of the first character that is no blank. */
static int64_t skip_blanks(const uint8_t *text, int64_t at, int64_t end)
{
    while (at < end && (text[at] == ' ' || text[at] == '\t')) {
        at++;
    }
    return at;
}

/* Position behind the stamp, which becomes -1 where there is none; -1 where what is in brackets is no stamp. */
static int64_t skip_stamp(const uint8_t *text, int64_t at, int64_t end, int64_t *stamp)
{
    *stamp = -1;
    if (text[at] != '(') {
        return at;
    }
    int64_t close = at + 1;
    while (close < end && text[close] != ')') {
        close++;
    }
    *stamp = close < end ? stamp_ns(text, at + 1, close) : -1;
    return *stamp >= 0 ? close + 1 : -1;
}

/* Identifier that ends before mark, of three digits or of eight; -1 where there is none. */
static int64_t identifier(const uint8_t *text, int64_t at, int64_t mark)
{
    int64_t last = mark;
    while (last > at && text[last - 1] == ' ') {
        last--;
    }
    int64_t first = last;
    while (first > at && digit(text[first - 1]) >= 0) {
        first--;
    }
    if ((last - first != 3 && last - first != 8) || first == at || text[first - 1] != ' ') {
        return -1;
    }
    int64_t number = 0;
    for (int64_t position = first; position < last; position++) {
        number = 16 * number + digit(text[position]);
    }
    return last - first == 8 && (number & ERROR_FRAME) == 0 ? number | EXTENDED : number;
}

/* Length of `[8]` behind its bracket; -2 for one of CAN FD, which has two digits, -1 for none. */
static int length_of(const uint8_t *text, int64_t at, int64_t end)
{
    if (at + 1 >= end || text[at] < '0' || text[at] > '9') {
        return -1;
    }
    if (text[at + 1] >= '0' && text[at + 1] <= '9') {
        return -2;
    }
    return text[at + 1] == ']' && text[at] <= '8' ? text[at] - '0' : -1;
}

/* Bytes from here on, into value; returns how many, -1 for more than 8 or for one that is cut. */
static int octets(const uint8_t *text, int64_t at, int64_t end, uint64_t *value)
{
    int count = 0;
    *value = 0;
    for (;;) {
        at = skip_blanks(text, at, end);
        if (at >= end || digit(text[at]) < 0) {
            return count;
        }
        if (at + 1 >= end || digit(text[at + 1]) < 0 || count == 8) {
            return count != 0 ? -1 : 0;
        }
        *value |= (uint64_t)(16 * digit(text[at]) + digit(text[at + 1])) << (8 * count);
        count++;
        at += 2;
    }
}

/* A frame of the line, written to row 0 of the arrays, or what the line is instead. */
static int read_line(
    const uint8_t *text, int64_t at, int64_t end, int64_t *stamp, int64_t *id, uint8_t *length, uint64_t *data)
{
    at = skip_blanks(text, at, end);
    while (end > at && (text[end - 1] == ' ' || text[end - 1] == '\r' || text[end - 1] == '\t')) {
        end--;
    }
    if (at == end) {
        return EMPTY_LINE;
    }
    at = skip_stamp(text, at, end, stamp);
    if (at < 0) {
        return NO_FRAME;
    }
    int64_t mark = at;
    while (mark < end && text[mark] != '#' && text[mark] != '[') {
        mark++;
    }
    const int64_t number = mark < end ? identifier(text, at, mark) : -1;
    if (number < 0) {
        return NO_FRAME;
    }
    const int is_spaced = text[mark] == '[';
    const int told = is_spaced ? length_of(text, mark + 1, end) : -1;
    if (told == -2 || (!is_spaced && mark + 1 < end && text[mark + 1] == '#')) {
        return FD_FRAME;
    }
    if (is_spaced && told < 0) {
        return NO_FRAME;
    }
    const int64_t begin = is_spaced ? mark + 3 : mark + 1;
    if (!is_spaced) { /* the flag of direction that may follow is no byte */
        int64_t word = begin;
        while (word < end && text[word] != ' ') {
            word++;
        }
        end = word;
    }
    const int64_t first = skip_blanks(text, begin, end);
    if (first < end && (text[first] == 'R' || text[first] == 'r')) { /* R, and "remote request" */
        *id = number | REMOTE;
        *length = (uint8_t)(told > 0 ? told : 0);
        *data = 0;
        return FRAME;
    }
    const int count = octets(text, begin, end, data);
    if (count < 0 || (is_spaced && count != told) || (!is_spaced && 2 * count != end - begin)) {
        return NO_FRAME;
    }
    *id = number;
    *length = (uint8_t)count;
    return FRAME;
}

/* FNV-1a hash, with bit 32 set, of the word behind the stamp of a line that holds a frame. */
static int64_t interface_hash(const uint8_t *text, int64_t at, int64_t end)
{
    at = skip_blanks(text, at, end);
    if (text[at] == '(') {
        while (text[at] != ')') {
            at++;
        }
        at = skip_blanks(text, at + 1, end);
    }
    uint32_t found = 2166136261u;
    while (at < end && text[at] != ' ') {
        found = (found ^ text[at]) * 16777619u;
        at++;
    }
    return (int64_t)found | ((int64_t)1 << 32);
}

int64_t parse_candump(
    const uint8_t *text, int64_t size, int64_t *stamps, int64_t *ids, uint8_t *lengths, uint64_t *data, int64_t room,
    int64_t *counters)
{
    int64_t found = 0, at = 0;
    while (at < size && found < room) {
        int64_t end = at;
        while (end < size && text[end] != '\n') {
            end++;
        }
        counters[READ_LINES]++;
        switch (read_line(text, at, end, &stamps[found], &ids[found], &lengths[found], &data[found])) {
        case FRAME: {
            const int64_t name = interface_hash(text, at, end);
            if (counters[INTERFACE] == 0) {
                counters[INTERFACE] = name;
            }
            if (name == counters[INTERFACE]) {
                found++;
            } else {
                counters[ELSEWHERE]++;
            }
            break;
        }
        case FD_FRAME:
            counters[FLEXIBLE]++;
            break;
        case NO_FRAME:
            counters[UNREADABLE]++;
            if (counters[FIRST_UNREADABLE] == 0) {
                counters[FIRST_UNREADABLE] = counters[READ_LINES];
            }
            break;
        default:
            break;
        }
        at = end + 1;
    }
    counters[CONSUMED] += size;
    return found;
}
