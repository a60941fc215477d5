"""The traffic of a bus."""

from dataclasses import dataclass
from typing import NamedTuple

from hil.can.frame import Frame


class Delivered(NamedTuple):
    """A frame that all others have received.

    Attributes:
        port: Port of the sender; the lowest, if several sent the very same frame.
    """

    frame: Frame
    port: int
    start_ns: int
    end_ns: int


Passed = tuple[Frame, int, int, int, int, int]
"""A frame that has passed, in the making: frame, port, SOF, end of EOF, bits, from when it has waited."""


@dataclass(slots=True)
class Statistics:
    """Counts of a wire since it was made; `Wire.statistics` is a copy.

    Attributes:
        bits: Bits of the delivered frames, intermissions included.
        busy_ns: Time in which the bus was not idle, errors included.
        errors: Attempts that ended in an error frame.
        collisions: Attempts, failed or not, in which two sent one identifier with different contents.
        merged: Frames that two ports sent bit for bit the same, so that one of them was never seen.
        refused: Offers that found no room, or a port that is bus-off.
        lost: Frames that a port had accepted, and that went with its bus-off, its mute fault or its departure.
        longest_queue: Most frames that waited at one port.
        longest_wait_ns: Longest time between an offer and the start of the attempt that succeeded.
    """

    frames: int = 0
    bits: int = 0
    busy_ns: int = 0
    errors: int = 0
    collisions: int = 0
    merged: int = 0
    refused: int = 0
    lost: int = 0
    longest_queue: int = 0
    longest_wait_ns: int = 0
