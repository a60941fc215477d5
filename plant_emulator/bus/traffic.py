"""The traffic of a bus."""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from hil.can.frame import Frame

MAX_INTERVALS = 32768
"""Busy stretches that are remembered: more than a second of any traffic at up to 1 Mbit/s, and then the oldest go."""


class Delivered(NamedTuple):
    """A frame that all others have received.

    Attributes:
        frame: The frame that the others received.
        port: Port of the sender; the lowest, if several sent the very same frame.
        start_ns: Its SOF.
        end_ns: The end of its EOF.
    """

    frame: Frame
    port: int
    start_ns: int
    end_ns: int


Passed = tuple[Frame, int, int, int, int, int]
"""A frame that has passed, in the making: frame, port, SOF, end of EOF, bits, from when it has waited."""


class ControllerMessage(NamedTuple):
    """An error message of a port's controller, for that port alone."""

    port: int
    frame: Frame
    at_ns: int


@dataclass(slots=True)
class Statistics:
    """Counts of a wire since it was made; `Wire.statistics` is a copy.

    Attributes:
        frames: Number of delivered frames.
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


class Traffic:
    """Counts and busy stretches of a bus."""

    def __init__(self) -> None:
        self.counts = Statistics()
        self._intervals: deque[list[int]] = deque(maxlen=MAX_INTERVALS)  # from, to

    def passed(self, frames: int, bits: int, longest_ns: int) -> None:
        """Count delivered frames with bits and longest wait."""
        counts = self.counts
        counts.frames += frames
        counts.bits += bits
        counts.longest_wait_ns = max(counts.longest_wait_ns, longest_ns)

    def occupy(self, begin: int, end: int) -> None:
        """Mark the bus as busy; join stretches that touch."""
        if end <= begin:
            return
        intervals = self._intervals
        if intervals and intervals[-1][1] >= begin:
            last = intervals[-1]
            begin = last[1]
            if end <= begin:
                return
            last[1] = end
        else:
            intervals.append([begin, end])
        self.counts.busy_ns += end - begin

    def busy_ns(self, since: int, until: int) -> int:
        """Return the busy time between two instants, in ns."""
        busy = 0
        for begin, end in reversed(self._intervals):
            if end <= since:
                break
            busy += max(min(end, until) - max(begin, since), 0)
        return busy
