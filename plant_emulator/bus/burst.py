"""Frames that pass a bus one behind the other, without an error or a choice."""

from collections import Counter
from collections.abc import Sequence

from hil.can.frame import Frame
from plant_emulator.bus.error_free import ErrorFreeBus


class Burst:
    """Frames of one client, offered at one instant to an empty bus, and the answers to the last of them.

    Args:
        bus: The bus, which is empty.
        frames: The client's frames.
        begin: Time of their offer, in ns.

    Attributes:
        bus: The bus.
        frames: The client's frames.
        begin: Time of their offer.
        ends: End of each of them, in ns.
        idle: End of the last frame's intermission.
    """

    def __init__(self, bus: ErrorFreeBus, frames: Sequence[Frame], begin: int) -> None:
        self.bus, self.frames, self.begin = bus, frames, begin
        self.ends: list[int] = []
        self.idle = self._start = max(begin, bus.idle)
        self._bits: list[int] = []
        self._idles: list[int] = []
        self._longest_ns = 0
        self._longest_queue = len(frames)
        self._pass(frames, begin)

    def _pass(self, frames: Sequence[Frame], offered: int) -> None:
        """Let frames pass that were offered at an instant."""
        bus, idle = self.bus, self.idle
        for can_id, data in frames:
            self._longest_ns = max(self._longest_ns, idle - offered)
            ns, bits = bus.duration(can_id, data)
            idle += ns
            self.ends.append(idle - bus.intermission_ns)
            self._bits.append(bits)
            self._idles.append(idle)
        self.idle = idle

    def send(self, answers: Sequence[Frame], senders: Sequence[int]) -> None:
        """Let the answers pass, which the nodes offer at the end of the last frame.

        Args:
            answers: The frames, in the order in which the bus sends them.
            senders: Port of each.
        """
        if senders:
            self._longest_queue = max(self._longest_queue, *Counter(senders).values())
            self._pass(answers, self.ends[-1])

    def count(self) -> None:
        """Count all frames as passed."""
        self.bus.pass_burst(self._start, self._bits, self._longest_ns, self._longest_queue, self.idle)

    def stop(self, ended: int, port: int) -> Sequence[Frame]:
        """Count the first frames as passed, and return the others.

        Args:
            ended: How many have passed.
            port: Port of the client.
        """
        starts = [self._start, *self._idles[: ended - 1]]
        longest_ns = max(start - self.begin for start in starts)
        self.bus.pass_burst(self._start, self._bits[:ended], longest_ns, self._longest_queue, self._idles[ended - 1])
        return self.frames[ended:]
