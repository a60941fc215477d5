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

from collections.abc import Sequence
from functools import lru_cache

from hil.can.frame import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_ERR_FLAG, CAN_RTR_FLAG, CAN_SFF_MASK, MAX_DATA_LENGTH, Frame
from hil.core.library import CORE

NOMINAL_BITS = 47
"""A classic frame without data and stuff bits, 11-bit identifier, with the intermission."""
CRC_BITS = 15
TAIL_BITS = 1 + 1 + 1 + 7 + 3
"""CRC delimiter, ACK slot and delimiter, end of frame, intermission."""
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
    _check(can_id, data)
    if stuffed:
        sent: int = CORE.call.send_classic(can_id, data, len(data), CORE.NULL)
        return sent + TAIL_BITS
    data_bits = 0 if can_id & CAN_RTR_FLAG else 8 * len(data)
    return _HEADER_BITS[bool(can_id & CAN_EFF_FLAG)] + data_bits + CRC_BITS + TAIL_BITS


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
    can_id, data = frame
    _check(can_id, data)
    room = CORE.bytes(CORE.call.SENT_BITS)
    return _text(room, CORE.call.send_classic(can_id, data, len(data), room))


def fd_bits(can_id: int, data: bytes, *, extended: bool = False) -> tuple[int, int]:
    """Count the bits of a CAN FD frame at the slow and at the fast rate, with intermission.

    Raises:
        ValueError: It has more than 8 bytes, or an identifier out of range.
    """
    _check_fd(can_id, data, extended=extended)
    slow = CORE.integers(1)
    sent = CORE.call.send_fd(can_id, extended, data, len(data), CORE.NULL, slow)
    return slow[0] + TAIL_BITS - 1, sent - slow[0] + 1


def fd_sent_bits(can_id: int, data: bytes, *, extended: bool = False) -> str:
    """Return the bits of a CAN FD frame as sent.

    From SOF to the last bit of the CRC, with all stuff bits; "0" is dominant.

    Raises:
        ValueError: The frame is one that `fd_bits` refuses.
    """
    _check_fd(can_id, data, extended=extended)
    room = CORE.bytes(CORE.call.SENT_BITS)
    return _text(room, CORE.call.send_fd(can_id, extended, data, len(data), room, CORE.integers(1)))


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


def _text(room: Sequence[int], count: int) -> str:
    return "".join(map(str, room[0:count]))


def _check(can_id: int, data: bytes) -> None:
    if not 0 <= can_id <= 0xFFFF_FFFF or can_id & CAN_ERR_FLAG:
        raise ValueError(f"{can_id:#x} is not a frame on the wire")
    if len(data) > MAX_DATA_LENGTH:
        raise ValueError(f"a CAN frame carries at most {MAX_DATA_LENGTH} bytes, not {len(data)}")
    if can_id & CAN_EFF_MASK > CAN_SFF_MASK and not can_id & CAN_EFF_FLAG:
        raise ValueError(f"identifier {can_id & CAN_EFF_MASK:#x} needs 29 bits, but CAN_EFF_FLAG is not set")


def _check_fd(can_id: int, data: bytes, *, extended: bool) -> None:
    if len(data) > MAX_DATA_LENGTH:
        raise ValueError(f"a CAN FD frame of {len(data)} bytes; expected at most {MAX_DATA_LENGTH} bytes")
    if not 0 <= can_id <= (CAN_EFF_MASK if extended else CAN_SFF_MASK):
        raise ValueError(f"{can_id:#x} is not an identifier of {29 if extended else 11} bits")
