"""Records on the local bus that are no frames: which clock it has, and where that clock stands.

A message of a seqpacket socket is one record, or up to `MAX_RECORDS` of them where both ends understand that.

They look like error messages of a controller (``CAN_ERR_FLAG``) of a class that SocketCAN does not use, so that whoever does not
know them passes them over; and they are sent only to a client that has asked.

======  ======================================================================
byte 0  what follows
======  ======================================================================
0       from a client: a question; byte 1 has bit 0 where it wants a time stamp before every frame, bit 1 where its
        SYNC shall not move the bus' clock, and bit 2 where it understands messages of several records.
        From the bus: the answer; byte 1 is 0 for lock-step and 1 for the wall clock, bytes 2 to 5 the bit rate, 0 for none,
        byte 6 is 1 where it understands messages of several records.
1       the period of a SYNC is over: bytes 2 to 5 count the SYNCs of this client, bytes 6 to 7 by how much the bus
        lags behind the beats, in units of 10 µs.
2       the next record's frame ended at this time of the bus, in ns, bytes 1 to 7.
======  ======================================================================
"""

import struct
from typing import NamedTuple

from hil.can.frame import CAN_ERR_FLAG, Frame

CLOCK_ID = CAN_ERR_FLAG | 0x1000_0000
QUESTION, PERIOD_OVER, STAMP = 0, 1, 2
LOCK_STEP, WALL = 0, 1

MAX_RECORDS = 64
_STAMPS, _FOLLOWS, _SEVERAL = 1, 2, 4
_ANSWER = struct.Struct("<BBIBx")
_PERIOD = struct.Struct("<BxIH")
LAG_STEP_NS = 10_000
_MAX_LAG = 0xFFFF


class Question(NamedTuple):
    """What a client asks when it joins.

    Attributes:
        stamps: It wants a time stamp before every frame.
        follows: Its SYNC shall not move the bus' clock.
        several: It understands messages of several records.
    """

    stamps: bool = False
    follows: bool = False
    several: bool = False


class Answer(NamedTuple):
    """What the bus answers.

    Attributes:
        clock: `LOCK_STEP` or `WALL`.
        bitrate: In bit/s; None: no bit times.
        several: It understands messages of several records.
    """

    clock: int
    bitrate: int | None
    several: bool = False


def question(*, stamps: bool = False, follows: bool = False, several: bool = False) -> Frame:
    """What a client asks when it joins; see `Question`."""
    return Frame(CLOCK_ID, _ANSWER.pack(QUESTION, stamps * _STAMPS | follows * _FOLLOWS | several * _SEVERAL, 0, 0))


def answer(clock: int, bitrate: int | None, *, several: bool = False) -> Frame:
    """What the bus answers; see `Answer`."""
    return Frame(CLOCK_ID, _ANSWER.pack(QUESTION, clock, bitrate or 0, several))


def read_answer(data: bytes) -> Answer | None:
    """What the bus has answered; None where it is no answer."""
    if len(data) != _ANSWER.size or data[0] != QUESTION:
        return None
    _, clock, bitrate, several = _ANSWER.unpack(data)
    return Answer(clock, bitrate or None, bool(several))


def read_question(data: bytes) -> Question | None:
    """What a client asks; None where it is no question."""
    if len(data) != _ANSWER.size or data[0] != QUESTION:
        return None
    flags = data[1]
    return Question(bool(flags & _STAMPS), bool(flags & _FOLLOWS), bool(flags & _SEVERAL))


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
