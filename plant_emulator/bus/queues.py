"""Frames that wait at the ports of a bus."""

import heapq

from hil.can.frame import Frame
from plant_emulator.bus.attempt import Attempt, Port, QueuedFrame
from plant_emulator.bus.controller import ErrorState
from plant_emulator.bus.faults import BusEvent
from plant_emulator.bus.rates import Rates
from plant_emulator.bus.traffic import Statistics


class Queues:
    """All waiting frames and events of one bus.

    Attributes:
        later: Frames and events that are put off, a heap by time and order.
        order: Number of the last thing that was put off.
    """

    def __init__(self, ports: dict[int, Port], rates: Rates, counts: Statistics, room: int) -> None:
        self._ports, self._rates, self._counts, self._room = ports, rates, counts, room
        self.waiting: dict[int, Port] = {}
        self.later: list[tuple[int, int, QueuedFrame | BusEvent]] = []
        self.order = 0

    # --- in ---

    def accept(
        self, port: Port, at: int, now: int, frame: Frame, delay_ns: int = 0, destroyed: int = 0, overtaken: bool = False
    ) -> bool:
        """Take a frame, into the queue or on its way; return False if full.

        Raises:
            ValueError: This is not a frame that can be on the wire.
        """
        entry = QueuedFrame(frame, port, at + delay_ns, self._rates)
        waiting = port.waiting + 1
        if waiting > self._room or port.controller.state is ErrorState.OFF:
            return False
        port.waiting = waiting
        if waiting > self._counts.longest_queue:  # noqa: PLR1730 - for every frame, and max() costs more than all of this
            self._counts.longest_queue = waiting
        if delay_ns or destroyed:
            entry.is_late, entry.destroyed = delay_ns > 0, destroyed
        self._enter(entry, now)
        if overtaken:
            port.held.append(entry)
        elif port.held:
            held, port.held = port.held, []
            for other in held:
                other.was_overtaken = True
                copy = QueuedFrame(other.frame, port, entry.at, self._rates)
                copy.destroyed = other.destroyed
                self._enter(copy, now)
        return True

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
        """Queue a frame at its port, unless that cannot send."""
        port = entry.port
        if port.is_silent:
            self.lose(port)
            return
        port.queue.append(entry)
        self.waiting[port.number] = port

    def put_back(self, entry: QueuedFrame) -> None:
        """Queue an unsent frame before all others of its port."""
        port = entry.port
        entry.destroyed = max(entry.destroyed - 1, 0)
        if entry.is_babble:
            return
        if port.is_silent:
            self.lose(port)
            return
        port.queue.appendleft(entry)
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

    def take(self, attempt: Attempt) -> None:
        """Remove the frames of a starting attempt from their queues."""
        for entry in attempt.senders:
            port = entry.port
            if not entry.is_babble:
                port.queue.popleft()
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

    # --- what it looks like ---

    def is_waiting(self, mark: int) -> bool:
        """Return True while a frame is queued or on its way.

        A frame that a fault delayed before the mark does not count.
        """
        return bool(self.waiting) or any(
            isinstance(what, QueuedFrame) and not what.was_overtaken and (order > mark or not what.is_late)
            for _, order, what in self.later
        )
