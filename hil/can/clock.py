"""Records on the local bus that are no frames: which clock it has, and where that clock stands.

They look like error messages of a controller (``CAN_ERR_FLAG``) of a class that SocketCAN does not use, so that whoever does not
know them passes them over; and they are sent only to a client that has asked.

======  ======================================================================
byte 0  what follows
======  ======================================================================
0       from a client: a question; byte 1 has bit 0 where it wants a time stamp before every frame, and bit 1 where its
        SYNC shall not move the bus' clock.
        From the bus: the answer; byte 1 is 0 for lock-step and 1 for the wall clock, bytes 2 to 5 the bit rate, 0 for none.
1       the period of a SYNC is over: bytes 2 to 5 count the SYNCs of this client, bytes 6 to 7 by how much the bus
        lags behind the beats, in units of 10 µs.
2       the next record's frame ended at this time of the bus, in ns, bytes 1 to 7.
======  ======================================================================
"""

import struct

from hil.can.frame import CAN_ERR_FLAG, Frame

CLOCK_ID = CAN_ERR_FLAG | 0x1000_0000
QUESTION, PERIOD_OVER, STAMP = 0, 1, 2
LOCK_STEP, WALL = 0, 1

_ANSWER = struct.Struct("<BBIxx")
_PERIOD = struct.Struct("<BxIH")
LAG_STEP_NS = 10_000
_MAX_LAG = 0xFFFF


def question(*, stamps: bool = False, follows: bool = False) -> Frame:
    """What a client asks when it joins.

    Args:
        stamps: It wants a time stamp before every frame.
        follows: Its SYNC shall not move the bus' clock.
    """
    return Frame(CLOCK_ID, _ANSWER.pack(QUESTION, stamps | follows << 1, 0))


def answer(clock: int, bitrate: int | None) -> Frame:
    """What the bus answers."""
    return Frame(CLOCK_ID, _ANSWER.pack(QUESTION, clock, bitrate or 0))


def read_answer(data: bytes) -> tuple[int, int | None] | None:
    """Clock and bit rate of an answer; None where it is none."""
    if len(data) != _ANSWER.size or data[0] != QUESTION:
        return None
    _, clock, bitrate = _ANSWER.unpack(data)
    return clock, bitrate or None


def read_question(data: bytes) -> tuple[bool, bool] | None:
    """Whether a client wants stamps, and whether it only follows the clock; None where it is no question."""
    if len(data) != _ANSWER.size or data[0] != QUESTION:
        return None
    return bool(data[1] & 1), bool(data[1] & 2)


def period_over(count: int, lag_ns: int) -> Frame:
    """The period of the count-th SYNC of a client is over."""
    return Frame(CLOCK_ID, _PERIOD.pack(PERIOD_OVER, count & 0xFFFF_FFFF, min(_MAX_LAG, lag_ns // LAG_STEP_NS)))


def read_period_over(data: bytes) -> tuple[int, int] | None:
    """Count and lag in ns; None where it is something else."""
    if len(data) != _PERIOD.size or data[0] != PERIOD_OVER:
        return None
    _, count, lag = _PERIOD.unpack(data)
    return count, lag * LAG_STEP_NS


def stamp(time_ns: int) -> Frame:
    """The time at which the next record's frame ended."""
    return Frame(CLOCK_ID, bytes((STAMP,)) + (time_ns & (1 << 56) - 1).to_bytes(7, "little"))


def read_stamp(data: bytes) -> int | None:
    """That time in ns; None where it is something else."""
    return int.from_bytes(data[1:], "little") if len(data) == 8 and data[0] == STAMP else None
