"""A world and its clients on one wire: every frame takes its time there, and is heard when it has ended."""

import contextlib
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from hil.can.frame import Frame
from plant_emulator.bus.wire import Wire
from plant_emulator.world import FREE_STEP_NS, World

FIRST_CLIENT = 1000
"""Ports of clients count from here; a node's port is its node-ID."""
SETTLE_NS = 100_000_000
"""How long a frame outside of a SYNC cycle may wait for a bus that others keep busy."""


class Heard(NamedTuple):
    """A frame that has ended on the wire.

    Attributes:
        frame: What every participant but the sender has received.
        port: Of the sender.
        end_ns: When it ended, in the world's time.
    """

    frame: Frame
    port: int
    end_ns: int


class TimedBus:
    """The bus with bit times, sans IO: integer nanoseconds of the world's clock.

    Args:
        world: Its nodes hear each frame at its end, and send from there.
        wire: The model of the bus.
        host_latency_ns: How long a client's frame takes from its program to its controller.

    Attributes:
        lag_ns: How long the oldest SYNC of the client that holds the clock has been waiting for the bus, at the last beat: above
            0 the bus carries less than it is given.
    """

    def __init__(self, world: World, wire: Wire, host_latency_ns: int = 0) -> None:
        """Join them; nothing moves."""
        self.world, self.wire = world, wire
        self.lag_ns = 0
        self._waiting: deque[int] = deque()
        for node in world.node_ids:
            wire.attach(node)
        self._nodes = frozenset(world.node_ids)
        world.on_power_cycle = wire.restart
        self._latency_ns = host_latency_ns
        self._beat_ns: int | None = None

    @property
    def due(self) -> int | None:
        """The next instant at which something happens by itself."""
        dues = [due for due in (self.world.due, self.wire.due) if due is not None]
        return min(dues) if dues else None

    def offer(self, port: int, frame: Frame) -> None:
        """A client has a frame to send; what can be on no bus, and what its queue has no room for, is counted there, and lost."""
        with contextlib.suppress(ValueError):
            self.wire.offer(port, frame, self.world.now + self._latency_ns)

    def run(self, until: int, stop: Callable[[], bool] | None = None) -> list[Heard]:
        """Let time pass; what has been heard, in the order in which it ended.

        The nodes are asked where a client's frame has ended, where one of them wakes, and at the end: none hears the others.

        Args:
            until: In the world's time.
            stop: Asked after each event; where it holds, time stops there.
        """
        world, wire = self.world, self.wire
        heard: list[Heard] = []
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
                heard.append(Heard(frame, port, end_ns))
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
        """Tell the nodes whose controllers have gone bus-off, or are back; what they say."""
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

    def free(self, until: int) -> list[Heard]:
        """Let time pass in short steps, so that drives see their limits and finished ramps in time."""
        heard: list[Heard] = []
        while self.world.now < until:
            heard += self.run(min(until, self.world.now + FREE_STEP_NS))
        return heard

    def settle(self, mark: int | None = None) -> list[Heard]:
        """Let time pass until everything that waits has been sent, answers included.

        Args:
            mark: Of the wire, before what is asked now was offered: that is waited for although a fault delays it. What a fault
                had delayed before, and a fault that is to come, are not.
        """
        mark = self.wire.mark if mark is None else mark
        return self.run(self.world.now + SETTLE_NS, lambda: not self.wire.is_waiting(mark))

    def begin_cycles(self) -> None:
        """The next SYNC of the client that holds the clock begins a beat of its own."""
        self._beat_ns, self.lag_ns = None, 0
        self._waiting.clear()

    def cycle(self, port: int, sync: Frame, period_ns: int) -> list[Heard]:
        """A SYNC of the client that holds the clock: it is queued behind what the client has queued, and a period passes.

        The beats never wait for the bus. What does not fit stays in the queues, is heard in a later period, and is refused once a
        queue is full.
        """
        beat = self.world.now if self._beat_ns is None else max(self._beat_ns, self.world.now)
        self.offer(port, sync)
        self._waiting.append(beat)
        self._beat_ns = beat + period_ns
        heard = self.run(self._beat_ns)
        for frame, sender, _ in heard:
            if sender == port and frame.can_id == sync.can_id and self._waiting:
                self._waiting.popleft()
        self.lag_ns = self._beat_ns - self._waiting[0] if self._waiting else 0
        return heard
