"""Fast reader of candump's logs.

Lines such as `(1.5) can0 181#0011` and `(1.5)  can0  181   [2]  00 11`. Lines that are no frame are counted and skipped.

Source: can-utils, `candump -l`, `candump -t a|z|A` and `-x`.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from hil.control.compiled import compiled

CHUNK_BYTES = 1 << 22
"""Bytes that are read at once."""
LEAST_LINE = 8
"""Bytes of the shortest line that can be a frame, its end included: bounds how many frames a chunk may hold."""
LONGEST_LINE = 1 << 16

CONSUMED, READ_LINES, UNREADABLE, FIRST_UNREADABLE, FLEXIBLE, INTERFACE, ELSEWHERE = range(7)
"""Indices of the counters that are carried from chunk to chunk: INTERFACE is the hash of the interface that is read, ELSEWHERE
the number of frames of others."""
COUNTED = 7

_EFF, _RTR, _ERR = np.int64(CAN_EFF_FLAG), np.int64(CAN_RTR_FLAG), np.int64(CAN_ERR_FLAG)

Chunk = tuple[NDArray[np.int64], NDArray[np.uint32], NDArray[np.uint8], NDArray[np.uint64]]


def chunks(path: Path, counters: NDArray[np.int64], progress: Callable[[int], None]) -> Iterator[Chunk]:
    """Yield the frames of a file in chunks.

    Stamps in ns (−1: none), identifiers, lengths and data.

    Args:
        path: The file.
        counters: Counters, which are added to; INTERFACE chooses the interface, 0 that of the first frame.
        progress: Called with the number of bytes that have been read.
    """
    most = CHUNK_BYTES // LEAST_LINE + 1
    stamp, can_id = np.empty(most, np.int64), np.empty(most, np.int64)
    length, data = np.empty(most, np.uint8), np.empty(most, np.uint64)
    with path.open("rb") as file:
        for buffer in _pieces(file):
            count = int(_parse(buffer, stamp, can_id, length, data, counters, np.empty(6, np.int64)))
            progress(int(counters[CONSUMED]))
            yield stamp[:count].copy(), can_id[:count].astype(np.uint32), length[:count].copy(), data[:count].copy()


def _pieces(file: BinaryIO) -> Iterator[NDArray[np.uint8]]:
    """Yield chunks of whole lines.

    The last line gets an end if it has none.
    """
    rest = b""
    while piece := file.read(CHUNK_BYTES - len(rest)):
        whole = rest + piece
        end = whole.rfind(b"\n") + 1
        if not end:
            if len(whole) < LONGEST_LINE:
                rest = whole
                continue
            end = len(whole)  # no line of a log is as long: it is counted as one that cannot be read
        rest = whole[end:]
        yield np.frombuffer(bytearray(whole[:end]), np.uint8)
    if rest:
        yield np.frombuffer(bytearray(rest + b"\n"), np.uint8)


@compiled
def _parse(
    text: NDArray[np.uint8],
    stamps: NDArray[np.int64],
    ids: NDArray[np.int64],
    lengths: NDArray[np.uint8],
    data: NDArray[np.uint64],
    counters: NDArray[np.int64],
    parts: NDArray[np.int64],
) -> int:
    """Frames of whole lines; returns how many there were.

    Room that is needed is given: what asks for memory cannot be kept as machine code, and would load its compiler each time.
    """
    found = 0
    at, size = 0, text.size
    while at < size:
        end = at
        while end < size and text[end] != 10:
            end += 1
        counters[1] += 1
        status = _line(text, at, end, stamps, ids, lengths, data, found, parts)
        if status == 1:
            name = _interface(text, at, end)
            if counters[5] == 0:
                counters[5] = name
            if name == counters[5]:
                found += 1
            else:
                counters[6] += 1
        elif status == 2:
            counters[4] += 1
        elif status == 0:
            counters[2] += 1
            if counters[3] == 0:
                counters[3] = counters[1]
        at = end + 1
    counters[0] += size
    return found


def hash_of(interface: str) -> int:
    """Return the hash of an interface's name (FNV-1a, 32 bits), never 0."""
    found = 2_166_136_261
    for octet in interface.encode():
        found = (found ^ octet) * 16_777_619 & 0xFFFF_FFFF
    return found | 1 << 32


@compiled
def _interface(text: NDArray[np.uint8], at: int, end: int) -> int:
    """Hash of the word behind the stamp."""
    at = _skipped(text, at, end)
    if text[at] == 40:
        while text[at] != 41:
            at += 1
        at = _skipped(text, at + 1, end)
    found = np.int64(2_166_136_261)
    while at < end and text[at] != 32:
        found = (found ^ np.int64(text[at])) * 16_777_619 & 0xFFFF_FFFF
        at += 1
    return int(found | np.int64(1) << np.int64(32))


@compiled
def _digit(character: int) -> int:
    """Value of a hexadecimal digit; −1 for any other character."""
    if 48 <= character <= 57:
        return character - 48
    if 65 <= character <= 70:
        return character - 55
    if 97 <= character <= 102:
        return character - 87
    return -1


@compiled
def _stamp(text: NDArray[np.uint8], at: int, end: int, parts: NDArray[np.int64]) -> int:
    """Return the nanoseconds of a stamp, or −1.

    A stamp reads `1.5` or `2026-11-23 12:00:00.5`. `parts` has room for six numbers.
    """
    parts[:6] = 0
    number, digits, nanoseconds, is_fraction = 0, 0, np.int64(0), False
    scale = np.int64(100_000_000)
    for position in range(at, end):
        character = text[position]
        if 48 <= character <= 57:
            if is_fraction:
                nanoseconds += (character - 48) * scale
                scale //= 10
            else:
                parts[number] = 10 * parts[number] + (character - 48)
            digits += 1
        elif character == 46 and not is_fraction:
            is_fraction = True
        elif character in (45, 58, 32) and not is_fraction and number < 5 and position > at:
            number += 1
        else:
            return -1
    if digits == 0 or digits > 26:
        return -1
    if number == 0:
        return -1 if parts[0] > 9_000_000_000 else int(parts[0] * 1_000_000_000 + nanoseconds)
    if number != 5 or not 1 <= parts[1] <= 12 or not 1970 <= parts[0] <= 2200:
        return -1
    # days since 1970 by the civil calendar, the year beginning in March
    year = parts[0] - (1 if parts[1] <= 2 else 0)
    month = (parts[1] + 9) % 12
    days = 365 * year + year // 4 - year // 100 + year // 400 + (153 * month + 2) // 5 + parts[2] - 1 - 719_468
    return int(((days * 24 + parts[3]) * 3600 + parts[4] * 60 + parts[5]) * 1_000_000_000 + nanoseconds)


@compiled
def _skipped(text: NDArray[np.uint8], at: int, end: int) -> int:
    """Position of the first character that is no blank."""
    while at < end and (text[at] == 32 or text[at] == 9):
        at += 1
    return at


@compiled
def _word_end(text: NDArray[np.uint8], at: int, end: int) -> int:
    """Position of the blank that ends a word."""
    while at < end and text[at] != 32:
        at += 1
    return at


@compiled
def _begin(text: NDArray[np.uint8], at: int, end: int, stamps: NDArray[np.int64], row: int, parts: NDArray[np.int64]) -> int:
    """Return the position behind the stamp.

    The stamp is written to `row`; −1 if the text in brackets is no stamp.
    """
    stamps[row] = -1
    if text[at] != 40:
        return at
    close = at + 1
    while close < end and text[close] != 41:
        close += 1
    stamps[row] = _stamp(text, at + 1, close, parts) if close < end else -1
    return close + 1 if stamps[row] >= 0 else -1


@compiled
def _identifier(text: NDArray[np.uint8], at: int, mark: int) -> int:
    """Return the identifier that ends before `mark`, or −1.

    It has three or eight digits.
    """
    last = mark
    while last > at and text[last - 1] == 32:
        last -= 1
    first = last
    while first > at and _digit(text[first - 1]) >= 0:
        first -= 1
    if (last - first != 3 and last - first != 8) or first == at or text[first - 1] != 32:
        return -1
    number = np.int64(0)
    for position in range(first, last):
        number = 16 * number + _digit(text[position])
    return int(number | _EFF if last - first == 8 and not number & _ERR else number)


@compiled
def _length(text: NDArray[np.uint8], at: int, end: int) -> int:
    """Return the length in `[8]`, from behind its bracket.

    −2 for a length of CAN FD, which has two digits; −1 for none.
    """
    if at + 1 >= end or not 48 <= text[at] <= 57:
        return -1
    if 48 <= text[at + 1] <= 57:
        return -2
    return text[at] - 48 if text[at + 1] == 93 and text[at] <= 56 else -1


@compiled
def _octets(text: NDArray[np.uint8], at: int, end: int, data: NDArray[np.uint64], row: int) -> int:
    """Read bytes into `data`, and return their number.

    −1 for more than 8, or for an incomplete byte.
    """
    value, count = np.uint64(0), 0
    while True:
        at = _skipped(text, at, end)
        if at >= end or _digit(text[at]) < 0:
            break
        if at + 1 >= end or _digit(text[at + 1]) < 0 or count == 8:
            return -1 if count else 0
        value |= np.uint64(16 * _digit(text[at]) + _digit(text[at + 1])) << np.uint64(8 * count)
        count += 1
        at += 2
    data[row] = value
    return count


@compiled
def _line(
    text: NDArray[np.uint8],
    at: int,
    end: int,
    stamps: NDArray[np.int64],
    ids: NDArray[np.int64],
    lengths: NDArray[np.uint8],
    data: NDArray[np.uint64],
    row: int,
    parts: NDArray[np.int64],
) -> int:
    """Read one line.

    1 for a frame, which is written to `row`; 0 for none, 2 for a frame of CAN FD, 3 for an empty line.
    """
    at = _skipped(text, at, end)
    while end > at and (text[end - 1] == 32 or text[end - 1] == 13 or text[end - 1] == 9):
        end -= 1
    if at == end:
        return 3
    at = _begin(text, at, end, stamps, row, parts)
    if at < 0:
        return 0
    mark = at
    while mark < end and text[mark] != 35 and text[mark] != 91:
        mark += 1
    number = _identifier(text, at, mark) if mark < end else -1
    if number < 0:
        return 0
    is_spaced = text[mark] == 91
    told = _length(text, mark + 1, end) if is_spaced else -1
    if told == -2 or (not is_spaced and mark + 1 < end and text[mark + 1] == 35):
        return 2
    if is_spaced and told < 0:
        return 0
    begin = mark + 3 if is_spaced else mark + 1
    end = end if is_spaced else _word_end(text, begin, end)  # the flag of direction that may follow is no byte
    rest = _skipped(text, begin, end)
    if rest < end and (text[rest] == 82 or text[rest] == 114):  # R, and "remote request"
        ids[row], lengths[row], data[row] = number | _RTR, max(told, 0), 0
        return 1
    data[row] = 0
    count = _octets(text, begin, end, data, row)
    if count < 0 or (is_spaced and count != told) or (not is_spaced and 2 * count != end - begin):
        return 0
    ids[row], lengths[row] = number, count
    return 1
