"""Length of CAN frames in bits on the wire, with stuff bits.

Layout of classic frames (ISO 11898-1:2015, 10.4), most significant bit first:

- 11-bit identifier: SOF 1, identifier 11, RTR 1, IDE 1, r0 1, DLC 4, data 0 to 64, CRC 15
- 29-bit identifier: SOF 1, base identifier 11, SRR 1, IDE 1, extension 18, RTR 1, r1 1, r0 1, DLC 4, data 0 to 64, CRC 15
- not stuffed: CRC delimiter 1, ACK slot 1, ACK delimiter 1, EOF 7; then the intermission of 3 before the next frame

From SOF to the last bit of the CRC the sender inserts after five equal bits one of the other value, which itself counts for the
next five. SRR and IDE of a long frame are recessive (1), r0 and r1 dominant (0). A remote frame carries the DLC and no data.

Layout of CAN FD frames of at most 8 bytes with bit rate switching (the same clauses; sizes as in include/linux/can/length.h of
Linux):

- 11-bit identifier: SOF 1, identifier 11, RRS 1, IDE 1, FDF 1, res 1, BRS 1 | ESI 1, DLC 4, data 0 to 64
- 29-bit identifier: SOF 1, base 11, SRR 1, IDE 1, extension 18, RRS 1, FDF 1, res 1, BRS 1 | ESI 1, DLC 4, data 0 to 64
- CRC field: stuff count 4, CRC 17, and a fixed stuff bit before the first and after every fourth of these bits, so 6;
  CRC delimiter 1 |
- ACK slot 1, ACK delimiter 1, EOF 7, intermission 3

Between the bars the data bit rate holds, as BRS is recessive. It changes at the sample points of BRS and CRC delimiter. With one
sample point for both rates each of the two bits may be counted whole, BRS as a slow and the delimiter as a fast one.
Stuff bits by contents end with the data: a fixed one takes the place of one that would follow the last bit. The stuff count is
their number modulo 8 in Gray code with an even parity bit. RRS and res are dominant, FDF recessive, ESI dominant
(error-active).
"""

from functools import cache, lru_cache
from typing import Any, NamedTuple

from hil.can.frame import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_ERR_FLAG, CAN_RTR_FLAG, CAN_SFF_MASK, MAX_DATA_LENGTH, Frame

NOMINAL_BITS = 47
"""A classic frame without data and stuff bits, 11-bit identifier, with the intermission."""

CRC_POLYNOMIAL = 0x4599
"""x¹⁵ + x¹⁴ + x¹⁰ + x⁸ + x⁷ + x⁴ + x³ + 1, without its first term."""

CRC_BITS = 15
TAIL_BITS = 1 + 1 + 1 + 7 + 3
"""CRC delimiter, ACK slot and delimiter, end of frame, intermission."""

FD_CRC_BITS, FD_CRC_POLYNOMIAL = 17, 0x1685B
"""The CRC of a CAN FD frame of up to 16 bytes."""
_STUFF_COUNT_BITS = 4
_FD_CHECKED_BITS = _STUFF_COUNT_BITS + FD_CRC_BITS
_FIXED_STUFF_BITS = 1 + (_FD_CHECKED_BITS - 1) // 4
_HEADER_BITS = {False: 1 + 11 + 1 + 1 + 1 + 4, True: 1 + 11 + 1 + 1 + 18 + 1 + 1 + 1 + 4}
_STUFF_AFTER = 5


def frame_bits(frame: Frame, *, stuffed: bool = True) -> int:
    """Count a data or remote frame's bits on the bus, with intermission.

    Args:
        frame: The frame on the bus; of the data of a remote frame only the length counts.
        stuffed: Count the stuff bits; else the frame is counted as if it needed none.

    Raises:
        ValueError: The frame is an error message of the controller, which never was on the wire, has more than 8 bytes, or an
            identifier out of range.
    """
    can_id, data = frame
    known = head(can_id, len(data))
    return known.bits + known.inserted + stuffed_by(known, data) if stuffed else known.bits


def duration_ns(frame: Frame, bitrate: int) -> int:
    """Return a frame's bus time with intermission in ns, rounded up.

    Raises:
        ValueError: The frame is one that `frame_bits` refuses.
    """
    return -(-frame_bits(frame) * 1_000_000_000 // bitrate)


@lru_cache(maxsize=4096)
def arbitration_key(can_id: int) -> int:
    """Return the arbitration field as a number: the lowest wins.

    Of frames that start together, that with the lowest number wins. Bits from the base identifier on, as both formats send
    them, most significant first: 11 bits, RTR and IDE; or 11 bits, SRR, IDE, 18 bits and RTR. So a data frame wins against
    a request for it, and a short identifier against a long one with the same first 11 bits.
    """
    identifier, remote = can_id & CAN_EFF_MASK, can_id >> 30 & 1
    if can_id & CAN_EFF_FLAG:
        return identifier >> 18 << 21 | 0b11 << 19 | (identifier & 0x3FFFF) << 1 | remote
    return identifier << 21 | remote << 20


def sent_bits(frame: Frame) -> str:
    """Return the stuffed bits from SOF to CRC; "0" is dominant.

    Raises:
        ValueError: The frame is one that `frame_bits` refuses.
    """
    bits, length = _content(frame)
    return _with_stuff_bits(f"{bits << CRC_BITS | crc15(bits, length):0{length + CRC_BITS}b}")


def _with_stuff_bits(text: str) -> str:
    sent, last, run = [], "", 0
    for bit in text:
        sent.append(bit)
        last, run = bit, run + 1 if bit == last else 1
        if run == _STUFF_AFTER:
            last, run = "1" if bit == "0" else "0", 1
            sent.append(last)
    return "".join(sent)


Row = list[Any]
"""One step of counting stuff bits: the bits inserted since the data began, and the run of equal bits so far.

The list holds the rows that follow each value of the next byte, so that a frame is counted by walking from row to row. From
`LAST` on it holds the total of stuff bits for each value of the seven last bits. It is a plain list, since a subclass takes
twice as long to index.
"""
LAST = 256


class Head(NamedTuple):
    """Counts that all frames of one identifier and length share.

    Attributes:
        bits: Bits of the frame and the intermission, without stuff bits.
        inserted: Stuff bits that come before the data.
        row: Step at which the data begin.
        register: CRC register behind the data if all of them were 0; classic frames only.
        tables: Change of that register by each value of each data byte; empty without data.
        fast_bits: Number of `bits` and `inserted` at the data bit rate; CAN FD frames only.
    """

    bits: int
    inserted: int
    row: Row
    register: int = 0
    tables: tuple[tuple[int, ...], ...] = ()
    fast_bits: int = 0


@lru_cache(maxsize=4096)
def head(can_id: int, data_length: int) -> Head:
    """Return the counts for classic frames of one identifier and length.

    The identifier has its flags.

    Raises:
        ValueError: The frame is one that `frame_bits` refuses.
    """
    bits, length = _content(Frame(can_id, bytes(data_length)))
    data_length = 0 if can_id & CAN_RTR_FLAG else data_length
    before, before_length = bits >> 8 * data_length, length - 8 * data_length
    inserted, state = _stuffed(before, before_length, _NOTHING_YET)
    return Head(length + CRC_BITS + TAIL_BITS, inserted, _rows()[state], crc15(bits, length), _crc_tables()[data_length])


def stuffed_by(known: Head, data: bytes) -> int:
    """Count the stuff bits of a classic frame's data and CRC."""
    _, _, row, register, tables, _ = known
    if len(tables) == MAX_DATA_LENGTH:  # most frames are full, and a loop takes half as long again
        a, b, c, d, e, f, g, h = data
        t, u, v, w, x, y, z, last = tables
        register ^= t[a] ^ u[b] ^ v[c] ^ w[d] ^ x[e] ^ y[f] ^ z[g] ^ last[h]
        row = row[a][b][c][d][e][f][g][h]
    else:
        for table, byte in zip(tables, data, strict=False):
            row = row[byte]
            register ^= table[byte]
    total: int = row[register >> 7][LAST + (register & 0x7F)]
    return total


@lru_cache(maxsize=4096)
def fd_head(can_id: int, data_length: int, extended: bool = False) -> Head:
    """Return the counts for CAN FD frames with bit rate switching.

    Raises:
        ValueError: It has more than 8 bytes, or an identifier out of range.
    """
    slow, slow_length, bits, length = _fd_content(can_id, bytes(data_length), extended)
    before, before_length = bits >> 8 * data_length, length - 8 * data_length
    inserted, state = _stuffed(before, before_length, _NOTHING_YET)
    if not data_length:
        inserted = stuff_bits(before >> 1, before_length - 1)  # what the last bit calls for is the first fixed one
    total = length + _FD_CHECKED_BITS + _FIXED_STUFF_BITS + TAIL_BITS
    nominal = slow_length + stuff_bits(slow >> 1, slow_length - 1) + TAIL_BITS - 1
    return Head(total, inserted, _rows()[state], fast_bits=total + inserted - nominal)


def fd_stuffed_by(known: Head, data: bytes) -> int:
    """Count the stuff bits of a CAN FD frame's data."""
    if not data:
        return 0
    row = known.row
    for byte in data[:-1]:
        row = row[byte]
    total: int = row[LAST + (data[-1] >> 1)]  # what the last bit calls for is the first fixed one
    return total


def fd_sent_bits(can_id: int, data: bytes, extended: bool = False) -> str:
    """Return the bits of a CAN FD frame as sent.

    From SOF to the last bit of the CRC, with all stuff bits; "0" is dominant.

    Raises:
        ValueError: The frame is one that `fd_head` refuses.
    """
    _, _, bits, length = _fd_content(can_id, data, extended)
    sent = _with_stuff_bits(f"{bits >> 1:0{length - 1}b}") + str(bits & 1)
    count = len(sent) - length & 7
    gray = count ^ count >> 1
    sbc = f"{gray:03b}{gray.bit_count() & 1}"
    crc = crc_fd(int(sent + sbc, 2), len(sent) + _STUFF_COUNT_BITS)
    checked = f"{sbc}{crc:0{FD_CRC_BITS}b}"
    for position in range(0, len(checked), 4):
        sent += ("1" if sent[-1] == "0" else "0") + checked[position : position + 4]
    return sent


def crc_fd(bits: int, length: int, start: int = 1 << FD_CRC_BITS - 1) -> int:
    """Return the CRC of a CAN FD frame, from SOF to the stuff count, without fixed stuff bits.

    The sequence is a number of `length` bits; the standard starts with a leading 1 in the register.
    """
    register = start
    for position in range(length - 1, -1, -1):
        feedback = (register >> FD_CRC_BITS - 1 ^ bits >> position) & 1
        register = register << 1 & (1 << FD_CRC_BITS) - 1
        register ^= FD_CRC_POLYNOMIAL if feedback else 0
    return register


def worst_case_bits(data_length: int, extended: bool = False) -> int:
    """Return the most bits that a data frame can have.

    The intermission is included. At worst the first five bits are equal, and every four after them need a further stuff bit:
    ⌊(n − 1)/4⌋ in n bits.

    Raises:
        ValueError: No length from 0 to 8.
    """
    if not 0 <= data_length <= MAX_DATA_LENGTH:
        raise ValueError(f"a CAN frame carries 0 to {MAX_DATA_LENGTH} bytes, not {data_length}")
    length = _HEADER_BITS[extended] + 8 * data_length + CRC_BITS
    return length + (length - 1) // (_STUFF_AFTER - 1) + TAIL_BITS


def crc15(bits: int, length: int) -> int:
    """Return the CRC from SOF to the last bit of the data."""
    register = 0
    # zeros ahead of the sequence leave the register at 0, so whole bytes may be taken
    for byte in bits.to_bytes((length + 7) // 8, "big"):
        register = (register << 8 & _CRC_MASK) ^ _CRC_OF[register >> 7 ^ byte]
    return register


def stuff_bits(bits: int, length: int) -> int:
    """Count the stuff bits of a sequence.

    A stuff bit counts for the next five equal bits.
    """
    whole = length // 8
    inserted, state = _stuffed(bits >> 8 * whole, length - 8 * whole, _NOTHING_YET)
    for byte in (bits & (1 << 8 * whole) - 1).to_bytes(whole, "big"):
        more, state = _STUFFED_OF[state][byte]
        inserted += more
    return inserted


def _stuffed(bits: int, length: int, state: int) -> tuple[int, int]:
    """Return the number of stuff bits, and the state after a sequence.

    The state is twice the run of equal bits so far, plus their value.
    """
    inserted, run, last = 0, state >> 1, state & 1
    for position in range(length - 1, -1, -1):
        bit = bits >> position & 1
        run, last = (run + 1 if bit == last else 1), bit
        if run == _STUFF_AFTER:
            inserted, run, last = inserted + 1, 1, 1 - bit
    return inserted, run << 1 | last


def _crc_of_byte(byte: int) -> int:
    register = byte << CRC_BITS - 8
    for _ in range(8):
        register = register << 1 ^ (CRC_POLYNOMIAL if register >> CRC_BITS - 1 & 1 else 0)
    return register & _CRC_MASK


_NOTHING_YET = 0
_CRC_MASK = (1 << CRC_BITS) - 1
_CRC_OF = tuple(_crc_of_byte(byte) for byte in range(256))
_STUFFED_OF = tuple(tuple(_stuffed(byte, 8, state) for byte in range(256)) for state in range(2 * _STUFF_AFTER))
"""Stuff bits of a byte, and the state after it."""
_MAX_INSERTED = (8 * MAX_DATA_LENGTH + CRC_BITS) // (_STUFF_AFTER - 1) + 1
"""The most stuff bits that data and CRC of a classic frame can need."""


@cache
def _rows() -> tuple[Row, ...]:
    """Build the steps through the data, by initial state of stuffing.

    On first use, in 9 ms.
    """
    states = range(2 * _STUFF_AFTER)
    ends = [[_stuffed(bits, 7, state)[0] for bits in range(128)] for state in states]
    rows: list[list[Row]] = [[[] for _ in states] for _ in range(_MAX_INSERTED + 2)]
    for inserted in range(_MAX_INSERTED):
        for state in states:
            row = rows[inserted][state]
            row += [rows[inserted + more][after] for more, after in _STUFFED_OF[state]]
            row += [inserted + more for more in ends[state]]
    return tuple(rows[0])


@cache
def _crc_tables() -> tuple[tuple[tuple[int, ...], ...], ...]:
    """Build the tables of changes of the CRC register.

    At the end of the data, by number of data bytes, place and value of a byte.
    """
    tables = [_CRC_OF]
    for _ in range(MAX_DATA_LENGTH - 1):
        tables.insert(0, tuple((register << 8 & _CRC_MASK) ^ _CRC_OF[register >> 7] for register in tables[0]))
    return tuple(tuple(tables[MAX_DATA_LENGTH - length :]) for length in range(MAX_DATA_LENGTH + 1))


def _content(frame: Frame) -> tuple[int, int]:
    """Return the bits from SOF to the last of the data.

    As a number, with their count.
    """
    can_id, data = frame
    if not 0 <= can_id <= 0xFFFF_FFFF or can_id & CAN_ERR_FLAG:
        raise ValueError(f"{can_id:#x} is not a frame on the wire")
    if len(data) > MAX_DATA_LENGTH:
        raise ValueError(f"a CAN frame carries at most {MAX_DATA_LENGTH} bytes, not {len(data)}")
    remote = int(bool(can_id & CAN_RTR_FLAG))
    identifier = can_id & CAN_EFF_MASK
    if can_id & CAN_EFF_FLAG:
        header = (identifier >> 18) << 2 | 0b11  # SOF 0, base identifier, SRR, IDE
        header = header << 18 | identifier & 0x3FFFF
        header = header << 7 | remote << 6 | len(data)  # RTR, r1, r0, DLC
    elif identifier <= CAN_SFF_MASK:
        header = identifier << 7 | remote << 6 | len(data)  # RTR, IDE, r0, DLC
    else:
        raise ValueError(f"identifier {identifier:#x} needs 29 bits, but CAN_EFF_FLAG is not set")
    length = _HEADER_BITS[bool(can_id & CAN_EFF_FLAG)]
    if remote:
        return header, length
    return header << 8 * len(data) | int.from_bytes(data, "big"), length + 8 * len(data)


def _fd_content(can_id: int, data: bytes, extended: bool) -> tuple[int, int, int, int]:
    """Return the bits to BRS, and those to the last data bit.

    Both from SOF, each as a number with its count.
    """
    if len(data) > MAX_DATA_LENGTH:
        raise ValueError(f"a CAN FD frame of {len(data)} bytes; expected at most {MAX_DATA_LENGTH} bytes")
    if not 0 <= can_id <= (CAN_EFF_MASK if extended else CAN_SFF_MASK):
        raise ValueError(f"{can_id:#x} is not an identifier of {29 if extended else 11} bits")
    if extended:
        slow = ((can_id >> 18) << 2 | 0b11) << 18 | can_id & 0x3FFFF  # SOF 0, base identifier, SRR, IDE, extension
        slow, slow_length = slow << 4 | 0b0101, 36  # RRS, FDF, res, BRS
    else:
        slow, slow_length = can_id << 5 | 0b00101, 17  # RRS, IDE, FDF, res, BRS
    bits = slow << 5 | len(data)  # ESI, DLC
    return slow, slow_length, bits << 8 * len(data) | int.from_bytes(data, "big"), slow_length + 5 + 8 * len(data)
