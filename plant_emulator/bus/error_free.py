"""Fast model of the bus while it is free of errors.

It gives the instants and counts of the attempts in `attempt` at less cost.

No port has an error to count, none is silent, all waiting frames are ready when the next one starts, and no two of them have
one identifier. As soon as one of these conditions fails, `wire` continues with attempts.
"""

from collections import deque
from collections.abc import Callable, Sequence
from heapq import heappop, heappush, heapreplace
from typing import NamedTuple

from hil.can.bits import Head, arbitration_key, fd_head, fd_stuffed_by, head, stuffed_by
from hil.can.frame import CAN_EFF_FLAG, CAN_EFF_MASK, Frame
from plant_emulator.bus.attempt import Port
from plant_emulator.bus.rates import INTERMISSION_BITS, Rates
from plant_emulator.bus.traffic import Passed, Traffic

NO_PORT = 1 << 62
"""Number above every port: it stops nothing."""
MAX_KINDS = 4096
"""Kinds of frames that are remembered."""


class _Kind(NamedTuple):
    """Properties shared by all frames of one identifier and length.

    Attributes:
        priority: See `hil.can.bits.arbitration_key`.
        bits: Bits with the intermission, but without those stuff bits that depend on the contents.
        ns: Duration of these bits.
        step_ns: Duration of one stuff bit that depends on the contents.
        counter: Function that counts the stuff bits that depend on the contents.
        head: State of the bit stuffing at the first bit of the contents.
    """

    priority: int
    bits: int
    ns: int
    step_ns: int
    counter: Callable[[Head, bytes], int]
    head: Head


_Waiting = tuple[int, int, int, Frame, _Kind]
"""A frame in a queue: arbitration key, port, time of the offer, frame, kind. The lowest goes first; no two ports are equal."""


class ErrorFreeBus:
    """Queues of the error-free bus, and the frame on it.

    Attributes:
        idle: Time from which the bus is idle, after the frame that is on it.
        flight: The frame on the bus, or None.
    """

    __slots__ = (
        "_counts",
        "_heads",
        "_intermission_ns",
        "_kinds",
        "_lines",
        "_ports",
        "_rates",
        "_room",
        "_start",
        "_traffic",
        "flight",
        "idle",
    )  # fmt: skip

    def __init__(self, ports: dict[int, Port], rates: Rates, traffic: Traffic, room: int) -> None:
        """Make the bus without queues: call `begin` first.

        Args:
            ports: Ports of the wire, which adds and removes them.
            rates: Bit rates of the wire; all bits take whole nanoseconds.
            traffic: Traffic of the wire.
            room: Frames that every queue holds.
        """
        self._ports, self._rates, self._traffic, self._room = ports, rates, traffic, room
        self._counts = traffic.counts
        self._intermission_ns = rates.ns(INTERMISSION_BITS)
        self._kinds: dict[tuple[int, int], _Kind] = {}
        self._lines: dict[int, deque[_Waiting]] = {}
        self._heads: list[_Waiting] = []
        self._start = self.idle = 0
        self.flight: Passed | None = None

    def begin(self, idle: int) -> None:
        """Take over a bus without waiting frames."""
        self._lines = {number: deque() for number in self._ports}
        self._heads, self.flight = [], None
        self._start = self.idle = idle

    def join(self, number: int) -> None:
        """Add a port."""
        self._lines[number] = deque()

    def offer(self, number: int, frame: Frame, now: int) -> bool:
        """Queue a frame at this instant; return False if full.

        Raises:
            ValueError: There is no such port, or this is not a frame that can be on the wire.
        """
        can_id, data = frame
        kind = self._kinds.get((can_id, len(data)))
        if kind is None:
            kind = self._learn(can_id, len(data))
        port = self._ports.get(number)
        if port is None:
            raise ValueError(f"there is no port {number}")
        waiting = port.waiting + 1
        if waiting > self._room:
            return False
        port.waiting = waiting
        if waiting > self._counts.longest_queue:  # noqa: PLR1730 - for every frame, and a call of max() costs more than all of this
            self._counts.longest_queue = waiting
        line, entry = self._lines[number], (kind[0], number, now, frame, kind)
        line.append(entry)
        if len(line) == 1:
            if not self._heads and self.flight is None:
                self._start = now if now > self.idle else self.idle
            heappush(self._heads, entry)
        return True

    @property
    def is_empty(self) -> bool:
        """True if no frame waits or is on the bus."""
        return not self._heads and self.flight is None

    def pass_burst(self, start: int, bits: Sequence[int], longest_ns: int, longest_queue: int, idle: int) -> None:
        """Count frames that have passed one behind the other.

        Args:
            start: SOF of the first, in ns.
            bits: Bits of each.
            longest_ns: The longest that one has waited for its SOF.
            longest_queue: The most that have waited at one port.
            idle: End of the last one's intermission.
        """
        self._counts.longest_queue = max(self._counts.longest_queue, longest_queue)
        self._traffic.passed(len(bits), sum(bits), longest_ns)
        self._traffic.occupy(start, idle)
        self._start = self.idle = idle

    @property
    def due(self) -> int | None:
        """End of the current or the next frame."""
        if self.flight is not None:
            return self.flight[3]
        if not self._heads:
            return None
        _, _, _, frame, kind = self._heads[0]
        return self._start + kind.ns + kind.counter(kind.head, frame[1]) * kind.step_ns - self._intermission_ns

    def advance(self, until: int, stop_port: int, passed: list[Passed]) -> int | None:
        """Let time pass; return the time reached.

        The result is None if a collision comes next, which this model does not handle.

        Args:
            until: End of the time that passes, in ns.
            stop_port: Time stops at the end of a frame of this port or one above.
            passed: The frames that have ended are appended.
        """
        heads, ports, before = self._heads, self._ports, len(passed)
        flight, idle, _intermission_ns = self.flight, self.idle, self._intermission_ns
        bits, longest_ns, busy_from, busy_to = 0, 0, idle, idle
        reached: int | None = until
        while True:
            if flight is not None:
                _, sender, start, end, length, at = flight
                if end > until:
                    break
                passed.append(flight)
                flight = None
                ports[sender].waiting -= 1
                bits += length
                longest_ns = longest_ns if start - at < longest_ns else start - at
                if start != busy_to:
                    self._traffic.occupy(busy_from, busy_to)
                    busy_from = start
                busy_to = start = idle
                if sender >= stop_port:
                    reached = end
                    break
            else:
                start = self._start
            if not heads or start >= until:
                break
            key, number, at, frame, kind = heads[0]
            if len(heads) > 1 and (heads[1][0] == key or (len(heads) > 2 and heads[2][0] == key)):
                reached = None
                break
            line = self._lines[number]
            line.popleft()
            if line:
                heapreplace(heads, line[0])
            else:
                heappop(heads)
            _, shared_bits, shared_ns, step_ns, counter, known = kind
            inserted = counter(known, frame[1])
            idle = start + shared_ns + inserted * step_ns
            flight = (frame, number, start, idle - _intermission_ns, shared_bits + inserted, at)
        self.flight, self.idle = flight, idle
        if len(passed) > before:
            self._start = idle  # of the last of them; where another one is on the bus, nobody asks
            self._traffic.passed(len(passed) - before, bits, longest_ns)
            self._traffic.occupy(busy_from, busy_to)
        return reached

    def take(self) -> list[tuple[int, int, Frame]]:
        """Hand over the waiting frames.

        Each has its port, the time of its offer, and the frame; they are in order of the ports.
        """
        entries = [(number, at, frame) for line in self._lines.values() for _, number, at, frame, _ in line]
        self.begin(self.idle)
        return entries

    @property
    def oldest(self) -> int | None:
        """Time of the offer of the longest-waiting frame."""
        return min((entry[2] for entry in self._heads), default=None)

    def _learn(self, can_id: int, length: int) -> _Kind:
        rates, known, key = self._rates, head(can_id, length), arbitration_key(can_id)
        is_fd, count, step_ns = rates.is_fd(can_id), stuffed_by, rates.bit_ns
        if is_fd:
            known = fd_head(can_id & CAN_EFF_MASK, length, bool(can_id & CAN_EFF_FLAG))
            count, step_ns = fd_stuffed_by, rates.fast_bit_ns
        bits = known.bits + known.inserted
        ns = rates.ns(bits - known.fast_bits, known.fast_bits)
        if len(self._kinds) >= MAX_KINDS:
            self._kinds.clear()
        kind = self._kinds[can_id, length] = _Kind(key, bits, ns, step_ns, count, known)
        return kind
