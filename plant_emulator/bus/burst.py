"""Frames that pass a bus one behind the other, without an error or a choice."""

from collections import Counter
from collections.abc import Sequence
from itertools import accumulate

from hil.can.frame import RECORD
from plant_emulator.bus.error_free import ErrorFreeBus
from plant_emulator.bus.rates import INTERMISSION_BITS
from plant_emulator.core import CORE


def message_bits(records: bytes) -> list[int]:
    """Count the bits of each data frame of a message, stuff bits and intermission included.

    `hil.can.bits.frame_bits` counts those of one frame.

    Args:
        records: Records of frames; the count of one that is not a data frame with an 11-bit identifier is 0.
    """
    count = len(records) // RECORD.size
    found = CORE.integers(count)
    CORE.call.frames_bits(records, count, found)
    return list(found)


class Burst:
    """Frames of one client, offered at one instant to an empty classic bus, and the answers to the last of them.

    Args:
        bus: The bus, which is empty.
        records: Records of the client's frames: data frames with 11-bit identifiers.
        begin: Time of their offer, in ns.
        bit_ns: Time of one bit.

    Attributes:
        bus: The bus.
        begin: Time of their offer.
        ends: End of each of them, in ns.
        idle: End of the last frame's intermission.
    """

    def __init__(self, bus: ErrorFreeBus, records: bytes, begin: int, bit_ns: int) -> None:
        self.bus, self.begin, self._bit_ns = bus, begin, bit_ns
        self._start = max(begin, bus.idle)
        self._bits = message_bits(records)
        self._idles = [self._start + bits * bit_ns for bits in accumulate(self._bits)]
        self.ends = [idle - INTERMISSION_BITS * bit_ns for idle in self._idles]
        self.idle = self._idles[-1]
        self._sent = len(self._bits)

    def answer(self, records: bytes, senders: Sequence[int]) -> None:
        """Let the answers pass, which the nodes offer at the end of the last frame, and count all frames.

        Args:
            records: Records of the answers, in the order in which the bus sends them.
            senders: Port of each.
        """
        answers = message_bits(records)
        longest_ns, queue = self._longest_ns(self._sent), self._sent
        if answers:
            self.idle += sum(answers) * self._bit_ns
            longest_ns = max(longest_ns, self.idle - answers[-1] * self._bit_ns - self.ends[-1])
            queue = max(queue, *Counter(senders).values())
        self.bus.pass_burst(self._start, self._bits + answers, longest_ns, queue, self.idle)

    def stop(self, ended: int) -> None:
        """Count the first frames alone.

        Args:
            ended: How many have passed.
        """
        idle = self._idles[ended - 1]
        self.bus.pass_burst(self._start, self._bits[:ended], self._longest_ns(ended), self._sent, idle)

    def _longest_ns(self, ended: int) -> int:
        """Return the wait of the last of so many frames, which has waited longest."""
        return self._idles[ended - 1] - self._bits[ended - 1] * self._bit_ns - self.begin
