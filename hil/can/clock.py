"""Records of the local bus that are not frames: clock and time.

A message of a seqpacket socket is one record, or up to `MAX_RECORDS` of them if both ends understand that.

The records look like error messages of a controller (``CAN_ERR_FLAG``) of a class that SocketCAN does not use, so that a client
that does not know them skips them. They are sent only to a client that has sent a question.

======  ======================================================================
byte 0  content
======  ======================================================================
0       from a client: a question; byte 1 has bit 0 where it wants a time stamp before every frame, bit 1 where its
        SYNC shall not move the bus' clock, and bit 2 where it understands messages of several records.
        From the bus: the answer; byte 1 is 0 for lock-step and 1 for the wall clock, bytes 2 to 5 the bit rate, 0 for none,
        byte 6 is 1 where it understands messages of several records.
1       the period of a SYNC is over: bytes 2 to 5 count the SYNCs of this client.
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
_PERIOD = struct.Struct("<BxI2x")


class Question(NamedTuple):
    """A client's question when it joins.

    Attributes:
        stamps: The client wants a time stamp before every frame.
        follows: The client's SYNC shall not move the bus' clock.
        several: The sender understands messages of several records.
    """

    stamps: bool = False
    follows: bool = False
    several: bool = False


class Answer(NamedTuple):
    """The bus' answer.

    Attributes:
        clock: `LOCK_STEP` or `WALL`.
        bitrate: Bit rate in bit/s; None on a bus without bit times.
        several: The sender understands messages of several records.
    """

    clock: int
    bitrate: int | None
    several: bool = False


def question(*, stamps: bool = False, follows: bool = False, several: bool = False) -> Frame:
    """The frame of a client's question when it joins; see `Question`."""
    return Frame(CLOCK_ID, _ANSWER.pack(QUESTION, stamps * _STAMPS | follows * _FOLLOWS | several * _SEVERAL, 0, 0))


def answer(clock: int, bitrate: int | None, *, several: bool = False) -> Frame:
    """The frame of the bus' answer; see `Answer`."""
    return Frame(CLOCK_ID, _ANSWER.pack(QUESTION, clock, bitrate or 0, several))


def read_answer(data: bytes) -> Answer | None:
    """Read the bus' answer; None if it is none."""
    if len(data) != _ANSWER.size or data[0] != QUESTION:
        return None
    _, clock, bitrate, several = _ANSWER.unpack(data)
    return Answer(clock, bitrate or None, bool(several))


def read_question(data: bytes) -> Question | None:
    """Read a client's question; None if it is none."""
    if len(data) != _ANSWER.size or data[0] != QUESTION:
        return None
    flags = data[1]
    return Question(bool(flags & _STAMPS), bool(flags & _FOLLOWS), bool(flags & _SEVERAL))


def period_over(count: int) -> Frame:
    """Return the frame for the end of a client's SYNC period `count`."""
    return Frame(CLOCK_ID, _PERIOD.pack(PERIOD_OVER, count & 0xFFFF_FFFF))


def read_period_over(data: bytes) -> int | None:
    """Read the count of such a frame; None if it is another."""
    if len(data) != _PERIOD.size or data[0] != PERIOD_OVER:
        return None
    count: int = _PERIOD.unpack(data)[1]
    return count


def stamp(time_ns: int) -> Frame:
    """The frame with the time at which the next record's frame ended."""
    return Frame(CLOCK_ID, bytes((STAMP,)) + (time_ns & (1 << 56) - 1).to_bytes(7, "little"))


def read_stamp(data: bytes) -> int | None:
    """Read the time in ns of such a frame; None for another."""
    return int.from_bytes(data[1:], "little") if len(data) == 8 and data[0] == STAMP else None
