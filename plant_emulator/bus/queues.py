"""Frames that wait at the ports of a bus.

They are in the ports' queues or on their way into them; the next attempt is planned here, too.
"""

import heapq
from collections.abc import Callable

from plant_emulator.bus.attempt import Attempt, Port, QueuedFrame, contend, resolve
from plant_emulator.bus.controller import ErrorState
from plant_emulator.bus.faults import BusEvent, Passage
from plant_emulator.bus.rates import Rates
from plant_emulator.bus.traffic import Statistics


class Queues:
    """All waiting frames and events of one bus.

    Attributes:
        waiting: Ports that have something to send.
        later: Frames and events that are put off, a heap by time and order.
        order: Number of the last thing that was queued or put off.
        plan: The next attempt; it holds as long as nothing changes before its start.
    """

    def __init__(
        self, ports: dict[int, Port], rates: Rates, counts: Statistics, room: int, taken_back: Callable[[], None]
    ) -> None:
        """Start empty.

        Args:
            ports: Ports of the wire, which adds and removes them.
            rates: Bit rates of the wire.
            counts: Counts of the wire.
            room: Frames that every port holds.
            taken_back: Called before a frame is queued: the error-free bus has its own queues.
        """
        self._ports, self._rates, self._counts, self._room, self._taken_back = ports, rates, counts, room, taken_back
        self.waiting: dict[int, Port] = {}
        self.later: list[tuple[int, int, QueuedFrame | BusEvent]] = []
        self.order = 0
        self.plan: Attempt | None = None

    # --- in ---

    def accept(self, port: Port, passage: Passage, at_ns: int, now: int) -> QueuedFrame | None:
        """Make a new entry in the queue or on its way.

        Returns None if there is no room.

        Args:
            port: Port of the sender.
            passage: The frame as the faults let it pass.
            at_ns: Time of the offer.
            now: The time of the bus.
        """
        late_ns = passage.delay_ns
        entry = QueuedFrame(passage.frame, port, at_ns + late_ns, self._rates, passage.destroyed, is_late=late_ns > 0)
        if port.waiting >= self._room or port.controller.state is ErrorState.OFF:
            return None
        port.waiting += 1
        self._counts.longest_queue = max(self._counts.longest_queue, port.waiting)
        self._enter(entry, now)
        return entry

    def overtake(self, port: Port, entry: QueuedFrame, now: int) -> None:
        """Queue held frames after the frame that overtakes them."""
        held, port.held = port.held, []
        for other in held:
            other.was_overtaken = True
            self._enter(QueuedFrame(other.frame, port, entry.at, self._rates, other.destroyed), now)

    def _enter(self, entry: QueuedFrame, now: int) -> None:
        if entry.at <= now and self._rates.bitrate is not None:
            self.queue(entry)
        else:
            self.put_off(entry.at, entry)

    def put_off(self, at: int, what: QueuedFrame | BusEvent) -> None:
        """Keep a frame or an event until its instant."""
        self.order += 1
        heapq.heappush(self.later, (at, self.order, what))

    def queue(self, entry: QueuedFrame) -> None:
        """Queue a frame at its port.

        A port that cannot send loses it.
        """
        self._taken_back()
        port = entry.port
        if port.is_silent:
            self.lose(port)
            return
        self.order += 1
        entry.order = self.order
        self.push(entry)

    def push(self, entry: QueuedFrame) -> None:
        """Queue a frame again without changing its order."""
        entry.port.push(entry)
        self.waiting[entry.port.number] = entry.port
        self.plan = None

    def put_back(self, entry: QueuedFrame) -> None:
        """Queue an unsent frame before all others of its port."""
        port = entry.port
        entry.destroyed = max(entry.destroyed - 1, 0)
        if entry.is_babble:
            return
        if port.is_silent:
            self.lose(port)
            return
        port.put_back(entry)
        self.waiting[port.number] = port

    def babble(self, port: Port, entry: QueuedFrame | None) -> None:
        """Start or stop a port's endless transmission of a frame."""
        port.babble = entry
        if entry is not None:
            entry.is_babble = True
            self.waiting[port.number] = port
        elif not port.queue:
            self.waiting.pop(port.number, None)

    # --- out ---

    def planned(self, idle: int) -> Attempt | None:
        """Plan the next attempt if nothing else is offered before.

        Args:
            idle: Time from which the bus is idle, in ns.
        """
        plan = contend(self.waiting.values(), idle) if self.waiting else None
        if plan is not None:
            resolve(plan, self._ports.values(), self._rates)
        self.plan = plan
        return plan

    def take(self, attempt: Attempt) -> None:
        """Remove the frames of a starting attempt from their queues."""
        self.plan = None
        for entry in attempt.senders:
            port = entry.port
            if not entry.is_babble:
                port.pop()
                if not port.queue:
                    del self.waiting[port.number]

    def lose(self, port: Port, count: int = 1) -> None:
        """Count frames that a port had accepted, and that are lost."""
        port.waiting -= count
        self._counts.lost += count

    def clear(self, port: Port) -> None:
        """Drop the queue of a port.

        Frames that are still on their way into it are dropped when they arrive.
        """
        self.lose(port, len(port.queue))
        port.queue.clear()
        self.waiting.pop(port.number, None)
        self.plan = None

    # --- what it looks like ---

    def is_waiting(self, mark: int) -> bool:
        """Return True while a frame is queued or on its way.

        A frame that a fault delayed before the mark does not count.
        """
        return bool(self.waiting) or any(
            isinstance(what, QueuedFrame) and not what.was_overtaken and (order > mark or not what.is_late)
            for _, order, what in self.later
        )

    @property
    def oldest(self) -> int | None:
        """Return the offer time of the longest-waiting frame, or None."""
        return min((entry.at for port in self.waiting.values() for entry in port.queue), default=None)
