"""A world and its clients on a wire, where frames take time."""

import contextlib
from collections.abc import Callable

from hil.can import clock
from hil.can.frame import Frame, frames_of, pack
from plant_emulator.bus.instant import FIRST_CLIENT, HeardFrame
from plant_emulator.bus.wire import EmulatedWire
from plant_emulator.world import FREE_STEP_NS, SECOND, World

DRAIN_NS = 100_000_000
"""Longest wait of a frame outside of a SYNC cycle for a bus that others keep busy, in ns."""


_PDOS, _HEARTBEATS = range(0x180, 0x580), range(0x700, 0x780)
"""Process data and heartbeats in the predefined connection set (CiA 301, 7.3.3): no node answers them.

All of a cycle leave with its SYNC, and the cycles keep their times. For any other frame the client waits.
"""


class TimedBus:
    """Medium that is a wire, with or without bit times, sans IO.

    Times are integer nanoseconds of the world's clock.

    Args:
        world: Its nodes receive each frame at its end, and send from there.
        host_latency_ns: Time that a client's frame takes from its program to its controller.
        wall: Time follows the wall clock; SYNC does not advance it.
    """

    def __init__(self, world: World, wire: EmulatedWire, host_latency_ns: int = 0, *, wall: bool = False) -> None:
        self.world, self.wire = world, wire
        self.clock = clock.WALL if wall else clock.LOCK_STEP
        self.bitrate = wire.bitrate
        self._is_idle = True
        for node in world.node_ids:
            wire.attach(node)
        self._nodes = frozenset(world.node_ids)
        world.on_power_cycle = wire.restart
        self._latency_ns = host_latency_ns
        self._cycle_end_ns: int | None = None

    def join(self, port: int) -> None:
        """Attach a client's controller."""
        self.wire.attach(port)

    def leave(self, port: int) -> None:
        """Detach a client's controller; its queued frames are lost."""
        self.wire.detach(port)

    @property
    def due(self) -> int | None:
        """Next instant at which a frame ends, or a node wakes."""
        dues = [due for due in (self.world.due, self.wire.due) if due is not None]
        return min(dues) if dues else None

    def offer(self, port: int, frame: Frame) -> None:
        """Offer a client's frame.

        A frame that no bus can carry, or that finds its queue full, is counted and lost.
        """
        with contextlib.suppress(ValueError):
            self.wire.offer(port, frame, self.world.now + self._latency_ns)

    def run(self, until: int, stop: Callable[[], bool] | None = None) -> list[HeardFrame]:
        """Let time pass; return the received frames by their ends.

        The nodes are called when a client's frame has ended, when one of them wakes, and at the end, since no node receives
        the frames of the others.

        Args:
            until: End of the time that passes, in ns of the world's time.
            stop: Asked after each event; where it holds, time stops there.
        """
        world, wire = self.world, self.wire
        heard: list[HeardFrame] = []
        while True:
            limit, due = until, world.due
            if due is not None and due < limit:
                limit = due
            if stop is not None and (due := wire.due) is not None and due < limit:
                limit = due
            passed = wire.listen(max(limit, world.now), FIRST_CLIENT)
            instant = wire.now
            sent = world.move(instant)
            for frame, port, _, end_ns, *_ in passed:
                heard.append(HeardFrame(frame, port, end_ns))
                if port >= FIRST_CLIENT:
                    sent += world.hear(frame)
            if wire.switched:
                sent += self._switch(instant)
            for node, frame in sent:
                wire.offer(node, frame, instant)
            if stop is not None and stop():
                return heard
            if instant >= until and not sent:
                return heard

    def _switch(self, now: int) -> list[tuple[int, Frame]]:
        """Inform nodes of bus-off and recovery; return their frames."""
        sent = []
        while self.wire.switched:
            port, is_off = self.wire.switched.popleft()
            if port not in self._nodes:
                continue
            if not is_off:
                sent += self.world.bus_recovered(port)
                continue
            self.world.bus_off(port)
            restart_ns = self.world.bus_off_restart_ns(port)
            if restart_ns is not None:
                self.wire.restart(port, now + restart_ns)
        return sent

    def free(self, until: int) -> list[HeardFrame]:
        """Let time pass in steps short enough to notice limits and ramps."""
        heard: list[HeardFrame] = []
        while self.world.now < until:
            heard += self.run(min(until, self.world.now + FREE_STEP_NS))
        return heard

    def drain(self, mark: int | None = None) -> list[HeardFrame]:
        """Let time pass until all frames and answers are sent.

        Args:
            mark: Mark of the wire before the present frames were offered: these are waited for although a fault delays them.
                Frames that a fault had delayed before, and faults to come, are not waited for.
        """
        mark = self.wire.mark if mark is None else mark
        return self.run(self.world.now + DRAIN_NS, lambda: not self.wire.is_waiting(mark))

    def begin_cycles(self) -> list[HeardFrame]:
        """Advance to the next whole second; the next SYNC of the clock's holder begins a cycle."""
        self._cycle_end_ns = None
        return self.free(-(-self.world.now // SECOND) * SECOND)

    def frame(self, port: int, frame: Frame) -> list[HeardFrame]:
        """Offer a client's frame.

        In lock-step time passes until it and its answers have ended, if the client waits; else it leaves with the next SYNC.
        """
        mark = self.wire.mark
        self.offer(port, frame)
        self._is_idle = False
        return [] if frame[0] in _PDOS or frame[0] in _HEARTBEATS else self._drained(mark)

    def idle(self) -> list[HeardFrame]:
        """Let time pass until every waiting frame has been sent, answers included."""
        return self._drained(self.wire.mark)

    def _drained(self, mark: int) -> list[HeardFrame]:
        if self._is_idle or self.clock == clock.WALL:
            return []
        self._is_idle = True
        return self.drain(mark)

    def exchange(self, port: int, message: bytes) -> bytes | None:
        """Let a cycle of plain drives pass, frames and answers at their times.

        It is what `offer` of each frame and `cycle` do, to the bit, while the bus is free of errors and all nodes only follow:
        the client's frames pass one behind the other, then the answers in the order of their identifiers.

        Args:
            port: Port of the client that holds the clock.
            message: Records of its RPDOs, and of SYNC behind them.

        Returns:
            Records of the frames that the client hears; None, and nothing has happened, if the frames must go one by one.
        """
        world, wire = self.world, self.wire
        if self.clock == clock.WALL or not self._is_idle or self._latency_ns or wire.now != world.now or not wire.is_undisturbed:
            return None
        begin = world.now if self._cycle_end_ns is None else max(self._cycle_end_ns, world.now)
        passed = world.pass_cycle(message, wire.idle, begin, wire.rates.bit_ns)
        if passed is None:
            return None
        self._cycle_end_ns = until = passed.until
        if not passed.ends:
            return self._go_on(port, message, passed.sent, until)
        wire.pass_at_once(passed.ends, passed.senders, until)
        for node, frame in passed.sent:
            wire.offer(node, frame, until)
        return passed.answers

    def _go_on(self, port: int, message: bytes, sent: list[tuple[int, Frame]], until: int) -> bytes:
        """Let a message pass frame by frame whose first frames have ended in the world alone.

        Args:
            message: Records of the client's frames, offered at the time of the wire.
            sent: What the nodes send now.
            until: End of the time that passes, in ns.

        Returns:
            Records of what the client hears.
        """
        world, wire = self.world, self.wire
        for frame in frames_of(message):
            wire.offer(port, frame, wire.now)
        for frame, *_ in wire.advance(world.now):
            sent += world.hear(frame)
        for node, frame in sent:
            wire.offer(node, frame, world.now)
        return b"".join(pack(frame) for frame, sender, _ in self.run(until) if sender != port)

    def finish_cycle(self) -> list[HeardFrame]:
        """Return nothing: `exchange` lets the whole cycle pass."""
        return []

    def cycle(self, port: int, sync: Frame) -> tuple[list[HeardFrame]]:
        """Queue the clock holder's SYNC, and let a period pass.

        The cycles never wait for the bus. Frames that do not fit stay in the queues and arrive in a later period; a full
        queue refuses them.
        """
        self._is_idle = True
        begin = self.world.now if self._cycle_end_ns is None else max(self._cycle_end_ns, self.world.now)
        self.offer(port, sync)
        self._cycle_end_ns = begin + self.world.period_ns
        return (self.run(self._cycle_end_ns),)
