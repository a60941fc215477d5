"""One CAN frame, and its 16-byte record on a socket.

The record is Linux's ``struct can_frame``: the same bytes on AF_CAN and on the local bus, so one raw channel serves
both.
"""

import struct
from typing import NamedTuple

CAN_EFF_FLAG = 0x8000_0000
"""Set in ``can_id`` of a frame with a 29-bit identifier."""
CAN_RTR_FLAG = 0x4000_0000
"""Set in ``can_id`` of a remote request."""
CAN_ERR_FLAG = 0x2000_0000
"""Set in ``can_id`` of an error message of the controller, which was never on the wire."""
CAN_SFF_MASK = 0x0000_07FF
CAN_EFF_MASK = 0x1FFF_FFFF

MAX_DATA_LENGTH = 8
RECORD = struct.Struct("=IB3x8s")
"""``struct can_frame`` of <linux/can.h>: identifier with flags, length, three bytes of padding, eight of data."""


class Frame(NamedTuple):
    """A frame of the bus.

    The class checks nothing, since it is built for every frame of every cycle; `pack` checks before a frame leaves.

    Attributes:
        can_id: Identifier, with ``CAN_EFF_FLAG``, ``CAN_RTR_FLAG`` and ``CAN_ERR_FLAG`` as SocketCAN sets them.
        data: 0 to 8 bytes. Those of a remote request only give its length.
    """

    can_id: int
    data: bytes


def pack(frame: Frame) -> bytes:
    """Give the 16-byte record of a frame.

    Raises:
        ValueError: More than 8 bytes, or an identifier beyond 11 bits (29 with ``CAN_EFF_FLAG`` or ``CAN_ERR_FLAG``).
    """
    can_id, data = frame
    if not 0 <= can_id <= CAN_SFF_MASK:
        _check_flagged(can_id)
    if len(data) > MAX_DATA_LENGTH:
        raise ValueError(f"a CAN frame carries at most {MAX_DATA_LENGTH} bytes, not {len(data)}")
    return RECORD.pack(can_id, len(data), data)


def unpack(record: bytes) -> Frame | None:
    """Return the frame of a record, or None."""
    if len(record) != RECORD.size:
        return None
    can_id, length, data = RECORD.unpack(record)
    if length > MAX_DATA_LENGTH:
        return None
    return Frame(can_id, data[:length])


def frames_of(records: bytes) -> list[Frame]:
    """Return the frames of whole records; other bytes are skipped."""
    return [Frame(can_id, data[:length]) for can_id, length, data in RECORD.iter_unpack(records) if length <= MAX_DATA_LENGTH]


def _check_flagged(can_id: int) -> None:
    if not 0 <= can_id <= 0xFFFF_FFFF:
        raise ValueError(f"{can_id:#x} is not a CAN identifier")
    wide = can_id & (CAN_EFF_FLAG | CAN_ERR_FLAG)
    if not wide and can_id & CAN_EFF_MASK > CAN_SFF_MASK:
        raise ValueError(f"identifier {can_id & CAN_EFF_MASK:#x} needs 29 bits, but CAN_EFF_FLAG is not set")
