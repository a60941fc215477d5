"""Frames as the participants of a bus send and hear them."""

from typing import NamedTuple

from hil.can.frame import Frame

FIRST_CLIENT = 1000
"""Ports of clients count from here; a node's port is its node-ID."""
_PDOS, _HEARTBEATS = range(0x180, 0x580), range(0x700, 0x780)
"""Identifiers in the predefined connection set (CiA 301, 7.3.3) that no node answers."""


def awaits_answer(frame: Frame) -> bool:
    """Return True if the client that sends a frame waits for its answer.

    Process data and heartbeats wait for the next SYNC: all leave in the same cycle, and the cycles keep their times.
    """
    can_id = frame[0]
    return can_id not in _PDOS and can_id not in _HEARTBEATS


class HeardFrame(NamedTuple):
    """A frame that has ended on the wire.

    Attributes:
        frame: The frame that every participant but the sender has received.
        port: Port of the sender.
        end_ns: End of the frame, in the world's time.
    """

    frame: Frame
    port: int
    end_ns: int
