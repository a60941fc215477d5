"""One CAN bus as a model, sans IO: who may send when, how long it takes, and what errors do to it. Integer nanoseconds.

A transmission starts with the first bit after the intermission at the earliest, and the lowest arbitration field of those that
wait at that instant wins. What is offered at that very instant takes part; so an instant is decided only when time has gone past
it, and what is received at the end of a frame may be answered in time for the next start, three bits later.

    frame: SOF … CRC, CRC delimiter, ACK slot, ACK delimiter, EOF 7 | intermission 3
    error: what was sent until then, error flag 6, echo of the others 0 to 6, error delimiter 8 | intermission 3

`Delivered.end_ns` is the end of EOF (or of the error delimiter); the bus is busy until the end of the intermission.

As long as nothing goes wrong `calm` does the same at less cost; here is what holds always.

Clauses of ISO 11898-1:2015: 10.4 (frames), 10.5 (stuffing), 10.7 (arbitration), 10.9 and 12.1.4 (errors, see `confinement`).
"""

import heapq
from collections import deque
from dataclasses import replace

from hil.can.frame import Frame
from plant_emulator.bus.attempt import DELIMITER_BITS, FLAG_BITS, Attempt, Entry, Port, check, contend, settle
from plant_emulator.bus.calm import NOBODY, Calm
from plant_emulator.bus.confinement import Controller, ErrorState
from plant_emulator.bus.faults import Event, FaultSource, Passage
from plant_emulator.bus.rates import INTERMISSION_BITS, SECOND, Rates
from plant_emulator.bus.traffic import Delivered, Passed, Report, Statistics, Traffic

__all__ = ["Delivered", "Report", "Statistics", "Wire"]

QUEUE_FRAMES = 256
"""Room of a port unless told: for the 127 frames that an SDO block transfer sends at once, and the PDOs that go meanwhile. A
SocketCAN interface has 10 unless told (txqueuelen), and lets its writer wait."""
PATIENCE_NS = 20_000_000
"""A frame that waits longer means that the bus is overloaded."""
MAX_PORTS = 1024
MAX_REPORTS = 1024

SUSPEND_BITS = 8
"""What an error-passive controller that has sent waits in addition to the intermission."""
STUCK_TOLERANCE_BITS, STUCK_STEP_BITS = 14, 8
RECOVERY_BITS = 128 * 11
"""What a restarted controller waits before it takes part again, on an idle bus."""


class Wire:
    """A bus and all that is attached to it.

    With a data bit rate it is a CAN FD bus: data frames carry the same 0 to 8 bytes, but these, their length and the CRC go at
    that rate. Of 8 bytes with an 11-bit identifier 29 bits and their stuff bits stay slow and 97 become fast ones, so that at
    1 and 5 Mbit/s a frame takes some 50 µs instead of 111 and more. What larger PDOs bring is another matter: nobody sends any.

    Attributes:
        now: Up to where time has passed, in ns.
        rates: Its bit rates.
        switched: Ports that went bus-off (True) or came back (False), in order, for the owner to take; the oldest are forgotten.
    """

    def __init__(
        self,
        bitrate: int | None,
        data_bitrate: int | None = None,
        *,
        queue_frames: int = QUEUE_FRAMES,
        patience_ns: int = PATIENCE_NS,
        faults: FaultSource | None = None,
        now_ns: int = 0,
    ) -> None:
        """Make an idle bus without ports.

        Args:
            bitrate: In bit/s, or None for a bus without bit times: a frame is delivered when it is offered, in order of offers.
            data_bitrate: Of the data of CAN FD frames, in bit/s; None: a classic bus.
            queue_frames: Room of every port.
            patience_ns: A frame that waits longer is an overload.
            faults: What goes wrong.
            now_ns: Where its time starts.

        Raises:
            ValueError: No bit rate, a data bit rate below it, no room, or faults that need bit times on a bus without.
        """
        self.rates = Rates(bitrate, data_bitrate)
        if queue_frames < 1:
            raise ValueError(f"a queue of {queue_frames} frames holds none")
        self._queue_frames, self._patience_ns = queue_frames, patience_ns
        self.now = self._idle = now_ns
        self._ports: dict[int, Port] = {}
        self._waiting: dict[int, Port] = {}  # those that have something to send
        self._later: list[tuple[int, int, Entry | Event]] = []  # a heap by time and order
        self._order = 0
        self._plan: Attempt | None = None  # holds as long as nothing is offered before its start
        self._flight: Attempt | None = None
        self._troubled = False  # a counter may be above 0
        self._reports: deque[Report] = deque(maxlen=MAX_REPORTS)
        self.switched: deque[tuple[int, bool]] = deque(maxlen=MAX_REPORTS)
        self._has_switched = False  # while time was let pass
        self._traffic = Traffic()
        self._counts = self._traffic.counts
        self._quiet = Calm(self._ports, self.rates, self._traffic, queue_frames) if self.rates.is_exact else None
        self._calm: Calm | None = None  # `_quiet`, while it holds the queues
        self._refused_ns: int | None = None
        self._faults = faults
        for event in faults.events if faults is not None else ():
            if bitrate is None and event.kind in {"babble", "stuck"}:
                raise ValueError(f"a bus without bit times knows no {event.kind}")
            self._put_off(event.at_ns, event)

    @property
    def bitrate(self) -> int | None:
        """In bit/s, that of the arbitration; None: no bit times."""
        return self.rates.bitrate

    # --- ports ---

    def attach(self, port: int | None = None, *, priority_queue: bool = False) -> int:
        """Give a participant its port; its number.

        Args:
            port: Any number from 0 that is free; else the lowest one that is.
            priority_queue: A controller with mailboxes, which sends its lowest identifier first, not its oldest frame.

        Raises:
            ValueError: The number is taken or negative, or there are too many ports.
        """
        if port is None:
            port = next(number for number in range(MAX_PORTS + 1) if number not in self._ports)
        if port in self._ports or port < 0 or len(self._ports) >= MAX_PORTS:
            raise ValueError(f"port {port} is not free")
        self._ports[port] = Port(port, priority_queue)
        self._plan = None
        if priority_queue:
            self._stir()
        elif self._calm is not None:
            self._calm.join(port)
        return port

    def detach(self, port: int) -> None:
        """Let a participant go; what it has queued is lost, what is on the bus goes on.

        Raises:
            ValueError: There is no such port.
        """
        participant = self._port(port)
        self._stir()
        self._clear(participant)
        participant.is_gone = True
        del self._ports[port]

    def controller(self, port: int) -> Controller:
        """The error counters and the state of a port, to look at.

        Raises:
            ValueError: There is no such port.
        """
        return self._port(port).controller

    def switch_off(self, port: int) -> None:
        """Put a port bus-off at once.

        Raises:
            ValueError: There is no such port.
        """
        participant = self._port(port)
        self._stir()
        self._report(participant, participant.controller.switch_off(), self.now)

    def restart(self, port: int, at_ns: int | None = None) -> None:
        """Bring a port back that is bus-off; it takes part again after the bits that the standard asks for. Others: no effect.

        Args:
            port: Which.
            at_ns: When; None: now.

        Raises:
            ValueError: There is no such port, or `at_ns` lies in the past.
        """
        participant = self._port(port)
        if at_ns is None:
            self._restart(participant, self.now)
        elif at_ns < self.now:
            raise ValueError(f"the bus is at {self.now} ns and restarts nobody at {at_ns} ns")
        else:
            self._put_off(at_ns, Event(at_ns, "restart", port))

    def take_reports(self) -> list[Report]:
        """The error messages since the last call, in order; the oldest are forgotten where nobody takes them."""
        reports = list(self._reports)
        self._reports.clear()
        return reports

    # --- frames ---

    def offer(self, port: int, frame: Frame, at_ns: int) -> bool:
        """Put a frame into a port's queue; whether there was room. A port that is bus-off has none.

        Raises:
            ValueError: There is no such port, `at_ns` lies in the past, or this is no frame that can be on the wire.
        """
        calm = self._calm
        if calm is not None and self._faults is None and at_ns == self.now:
            return calm.offer(port, frame, at_ns) or self._refuse()
        return self._offer(port, frame, at_ns)

    def _offer(self, port: int, frame: Frame, at_ns: int) -> bool:
        """What `offer` does, as the faults let it."""
        participant = self._port(port)
        if at_ns < self.now:
            raise ValueError(f"the bus is at {self.now} ns and takes nothing of {at_ns} ns")
        if self._faults is None:
            return self._accept(participant, Passage(frame), at_ns) is not None
        check(frame)
        passages = self._faults.apply(frame, port, at_ns)
        calm = self._calm
        if calm is not None and at_ns == self.now and len(passages) == 1 and passages[0].is_plain and not participant.held:
            return calm.offer(port, passages[0].frame, at_ns) or self._refuse()
        accepted = [self._pass(participant, passage, at_ns) for passage in passages]
        return all(accepted)

    @property
    def mark(self) -> int:
        """What `is_waiting` compares with: whatever is offered from now on."""
        return self._order

    def is_waiting(self, mark: int) -> bool:
        """Whether something is on the bus or in a queue, or on its way there.

        Args:
            mark: What a fault had delayed before that instant does not count; a fault to come does not count either.
        """
        if self._calm is not None and self._calm.due is not None:
            return True
        return bool(self._flight or self._waiting) or any(
            isinstance(what, Entry) and not what.was_overtaken and (order > mark or not what.is_late)
            for _, order, what in self._later
        )

    @property
    def due(self) -> int | None:
        """When something happens next, if nothing else is offered: mostly the end of a frame, sometimes less; None for never."""
        later = self._later[0][0] if self._later else None
        if self._calm is not None:
            end = self._calm.due
        else:
            attempt = self._flight or self._plan or self._planned()
            end = None if attempt is None else attempt.end
        return later if end is None or (later is not None and later < end) else end

    def advance(self, until_ns: int) -> list[Delivered]:
        """Let time pass; the frames whose end is not after `until_ns`, in order.

        Raises:
            ValueError: `until_ns` lies in the past.
        """
        return [Delivered(frame, port, start, end) for frame, port, start, end, *_ in self.listen(until_ns)]

    def listen(self, until_ns: int, stop_port: int = NOBODY) -> list[Passed]:
        """Let time pass, as `advance` does, but stop at the end of a frame of this port or one above; `now` tells where.

        With a `stop_port` it also stops where a port is `switched`.

        Raises:
            ValueError: `until_ns` lies in the past.
        """
        if until_ns < self.now:
            raise ValueError(f"the bus is at {self.now} ns and does not go back to {until_ns} ns")
        passed: list[Passed] = []
        calm = self._calm or self._calmed()
        if calm is not None:
            later = self._later
            limit = later[0][0] if later and later[0][0] < until_ns else until_ns
            reached = calm.advance(limit, stop_port, passed)
            if reached is not None:
                self.now = reached
                if reached < limit or not later or later[0][0] > until_ns or (passed and passed[-1][1] >= stop_port):
                    return passed
            self._stir()
        self._proceed(until_ns, stop_port, passed)
        return passed

    def _proceed(self, until_ns: int, stop_port: int, delivered: list[Passed]) -> None:
        """Let time pass by attempts."""
        later, self._has_switched = self._later, False
        while True:
            attempt = self._flight or self._plan or self._planned()
            soon = until_ns + 1 if attempt is None else attempt.end if attempt is self._flight else attempt.start + 1
            if later and later[0][0] < soon:
                at = later[0][0]
                if at > until_ns:
                    break
                self._release(delivered)
            elif soon > until_ns:
                break
            elif attempt is not None:
                if attempt is self._flight:
                    at = attempt.end
                    self._land(attempt, delivered)
                else:
                    self._take_off(attempt)
                    continue
            if delivered and delivered[-1][1] >= stop_port:
                self.now = delivered[-1][3]
                return
            if self._has_switched and stop_port != NOBODY:
                self.now = max(self.now, at)
                return
        self.now = until_ns

    def _calmed(self) -> Calm | None:
        """Hand the bus over as soon as nothing can go wrong; see `calm`."""
        calm = self._quiet
        if calm is None or self._waiting or self._flight is not None or self._troubled or len(self._ports) < 2:
            return None
        if not all(port.is_calm and port.not_before <= self.now for port in self._ports.values()):
            return None
        self._calm, self._plan = calm, None
        calm.begin(self._idle)
        return calm

    def _stir(self) -> None:
        """Take the bus back from `calm`."""
        calm = self._calm
        if calm is None:
            return
        self._calm, self._idle, flight = None, calm.idle, calm.flight
        if flight is not None:
            frame, number, start, end, _, at = flight
            entry = Entry(frame, self._ports[number], at, self.rates)
            self._flight, self._idle = Attempt(start, (entry,)), start
            self._flight.end, self._flight.idle = end, calm.idle
        for number, at, frame in calm.take():
            port = self._ports[number]
            port.push(Entry(frame, port, at, self.rates))
            self._waiting[number] = port
        self._plan = None

    # --- what it looks like ---

    @property
    def statistics(self) -> Statistics:
        """Counts since the start."""
        return replace(self._counts)

    @property
    def oldest_wait_ns(self) -> int:
        """How long the frame that has waited longest has waited for its first or next attempt; 0 where none waits."""
        if self._calm is not None:
            oldest = self._calm.oldest
            return 0 if oldest is None else self.now - oldest
        ages = [self.now - min(entry.at for entry in port.queue) for port in self._waiting.values() if port.queue]
        return max(ages, default=0)

    @property
    def is_overloaded(self) -> bool:
        """Whether a frame waits longer than it should, or one was refused within the last second."""
        refused = self._refused_ns is not None and self.now - self._refused_ns <= SECOND
        return refused or self.oldest_wait_ns > self._patience_ns

    def load(self, window_ns: int) -> float:
        """Part of the last `window_ns` in which the bus was busy, from 0 to 1; errors and intermissions count.

        Raises:
            ValueError: No window.
        """
        if window_ns <= 0:
            raise ValueError(f"no window: {window_ns} ns")
        busy_ns = self._traffic.busy_ns(self.now - window_ns, self.now)
        start = None if self._flight is None else self._flight.start
        if self._calm is not None and self._calm.flight is not None:
            start = self._calm.flight[2]
        if start is not None:
            busy_ns += self.now - max(start, self.now - window_ns)
        return busy_ns / window_ns

    # --- how it works ---

    def _port(self, number: int) -> Port:
        port = self._ports.get(number)
        if port is None:
            raise ValueError(f"there is no port {number}")
        return port

    def _restart(self, port: Port, at: int) -> None:
        if port.controller.state is ErrorState.OFF:
            self._report(port, port.controller.restart(), at)
            self._switch(port, is_off=False)
            port.not_before = at + self.rates.ns(RECOVERY_BITS)
            self._plan = None

    def _pass(self, port: Port, passage: Passage, at_ns: int) -> bool:
        """A frame as the faults let it pass; it gets those behind it that it was to overtake."""
        entry = self._accept(port, passage, at_ns)
        if entry is None:
            return False
        if passage.overtaken:
            port.held.append(entry)
        else:
            held, port.held = port.held, []
            for other in held:
                other.was_overtaken = True
                self._enter(Entry(other.frame, port, entry.at, self.rates, other.destroyed))
        return True

    def _accept(self, port: Port, passage: Passage, at_ns: int) -> Entry | None:
        """A new entry in the queue or on its way into it; None where there is no room."""
        late_ns = passage.delay_ns
        entry = Entry(passage.frame, port, at_ns + late_ns, self.rates, passage.destroyed, is_late=late_ns > 0)
        if port.waiting >= self._queue_frames or port.controller.state is ErrorState.OFF:
            self._refuse()
            return None
        port.waiting += 1
        self._counts.longest_queue = max(self._counts.longest_queue, port.waiting)
        self._enter(entry)
        return entry

    def _refuse(self) -> bool:
        self._counts.refused += 1
        self._refused_ns = self.now
        return False

    def _enter(self, entry: Entry) -> None:
        if entry.at <= self.now and self.bitrate is not None:
            self._queue(entry)
        else:
            self._put_off(entry.at, entry)

    def _put_off(self, at: int, what: Entry | Event) -> None:
        self._order += 1
        heapq.heappush(self._later, (at, self._order, what))

    def _queue(self, entry: Entry) -> None:
        self._stir()
        port = entry.port
        if port.is_muted or port.is_gone or port.controller.state is ErrorState.OFF:
            self._lose(port)
            return
        self._order += 1
        entry.order = self._order
        port.push(entry)
        self._waiting[port.number] = port
        self._plan = None

    def _lose(self, port: Port, count: int = 1) -> None:
        port.waiting -= count
        self._counts.lost += count

    def _clear(self, port: Port) -> None:
        """All that a port has queued is lost; what is still on its way into the queue is, when it gets there."""
        self._lose(port, len(port.queue))
        port.queue.clear()
        self._waiting.pop(port.number, None)
        self._plan = None

    def _planned(self) -> Attempt | None:
        """Plan the next attempt, as it is if nothing else is offered before it starts."""
        plan = contend(self._waiting.values(), self._idle) if self._waiting else None
        if plan is not None:
            settle(plan, self._ports.values(), self.rates)
        self._plan = plan
        return plan

    def _take_off(self, attempt: Attempt) -> None:
        """The first bit is sent: from now on this attempt stands."""
        self._flight, self._plan = attempt, None
        for entry in attempt.senders:
            port = entry.port
            if not entry.is_babble:
                port.pop()
                if not port.queue:
                    del self._waiting[port.number]

    def _land(self, attempt: Attempt, delivered: list[Passed]) -> None:
        """An attempt has ended: as a frame, or with an error frame."""
        self._flight, self._idle = None, attempt.idle
        self._traffic.occupy(attempt.start, attempt.idle)
        winners = attempt.winners
        if winners:
            counts, start, first = self._counts, attempt.start, winners[0]
            delivered.append((first.frame, first.port.number, start, attempt.end, first.bits, first.at))
            counts.frames += 1
            counts.bits += first.bits
            for entry in winners:
                if not entry.is_babble:
                    entry.port.waiting -= 1
                counts.longest_wait_ns = max(counts.longest_wait_ns, start - entry.at)
        if self._troubled or not winners or len(attempt.senders) > 1:
            self._confine(attempt)

    def _confine(self, attempt: Attempt) -> None:
        """Error counters after an attempt, and what has failed goes back to its queue."""
        counts = self._counts
        counts.collisions += attempt.collided
        counts.merged += max(len(attempt.winners) - 1, 0)
        counts.errors += not attempt.winners
        for entry in attempt.failed:
            self._report(entry.port, entry.port.controller.transmit_failed(), attempt.end)
        senders = {entry.port for entry in attempt.senders}
        for port in self._listeners(senders):
            change = port.controller.received() if attempt.winners else port.controller.receive_failed()
            self._report(port, change, attempt.end)
        for entry in attempt.senders:
            if entry in attempt.winners:
                self._report(entry.port, entry.port.controller.transmitted(), attempt.end)
            else:
                self._return(entry)
            if entry.port.controller.is_passive:
                entry.port.not_before = attempt.idle + self.rates.ns(SUSPEND_BITS + attempt.drop_out_bits(entry))
        self._troubled = any(port.controller.tec or port.controller.rec for port in self._ports.values())

    def _listeners(self, senders: set[Port]) -> list[Port]:
        return [port for port in self._ports.values() if port.controller.state is not ErrorState.OFF and port not in senders]

    def _return(self, entry: Entry) -> None:
        """What has not been sent is to be sent again, before all others of its port."""
        port = entry.port
        entry.destroyed = max(entry.destroyed - 1, 0)
        if entry.is_babble:
            return
        if port.is_gone or port.is_muted or port.controller.state is ErrorState.OFF:
            self._lose(port)
            return
        port.put_back(entry)
        self._waiting[port.number] = port

    def _report(self, port: Port, message: Frame | None, at: int) -> None:
        if message is None:
            return
        if port.number in self._ports:
            self._reports.append(Report(port.number, message, at))
        if port.controller.state is ErrorState.OFF:
            self._clear(port)
            self._switch(port, is_off=True)

    def _switch(self, port: Port, *, is_off: bool) -> None:
        self.switched.append((port.number, is_off))
        self._has_switched = True

    def _release(self, delivered: list[Passed]) -> None:
        """What was put off is due: an event, or a frame that gets into its queue."""
        at, _, what = heapq.heappop(self._later)
        if isinstance(what, Event):
            self._happen(what)
            return
        port = what.port
        if what.was_overtaken:
            return  # a copy of it went behind the frame that overtook it
        if what in port.held:
            port.held.remove(what)
        if self.bitrate is not None:
            self._queue(what)
        elif port.is_silent:
            self._lose(port)
        else:
            port.waiting -= 1
            self._counts.frames += 1
            delivered.append((what.frame, port.number, at, at, what.bits, at))

    def _happen(self, event: Event) -> None:
        """A fault begins or ends."""
        self._plan = None
        if event.kind == "stuck":
            self._stick(event.at_ns, event.until_ns or event.at_ns)
            return
        port = self._ports.setdefault(event.port, Port(event.port))  # a port that nobody holds is a stranger's
        match event.kind:
            case "mute" | "unmute":
                port.is_muted = event.kind == "mute"
                if port.is_muted:
                    self._clear(port)
            case "babble" if event.frame is not None:
                port.babble = Entry(event.frame, port, event.at_ns, self.rates)
                port.babble.is_babble = True
                self._waiting[port.number] = port
            case "quiet":
                port.babble = None
                if not port.queue:
                    self._waiting.pop(port.number, None)
            case "bus_off":
                self._report(port, port.controller.switch_off(), event.at_ns)
            case "restart":
                self._restart(port, event.at_ns)

    def _stick(self, at: int, until: int) -> None:
        """The bus is dominant for a while: what is being sent fails, and counters rise with every eight bits (rule f).

        All of it is counted and reported at the beginning.
        """
        attempt, self._flight = self._flight, None
        bits = (until - at) * (self.bitrate or 0) // SECOND
        senders: set[Port] = set()
        idle = until + self.rates.ns(DELIMITER_BITS + INTERMISSION_BITS)
        self._traffic.occupy(attempt.start if attempt is not None else max(at, min(self._idle, until)), idle)
        self._idle = max(self._idle, idle)
        self._counts.errors += 1
        self._troubled = True
        for entry in attempt.senders if attempt is not None else ():
            senders.add(entry.port)
            self._report(entry.port, entry.port.controller.transmit_failed(1 + stuck_steps(bits - 1)), at)
            self._return(entry)
            if entry.port.controller.is_passive:
                entry.port.not_before = self._idle + self.rates.ns(SUSPEND_BITS)
        if bits >= FLAG_BITS:  # the sixth is an error to those who listen
            for port in self._listeners(senders):
                self._report(port, port.controller.receive_failed(1 + 8 * stuck_steps(bits - FLAG_BITS)), at)


def stuck_steps(bits: int) -> int:
    """How often a counter rises again while the bus stays dominant for so many bits from the beginning of an error flag.

    After the 14th dominant bit, and after every eight more (rule f).
    """
    return 0 if bits < STUCK_TOLERANCE_BITS else 1 + (bits - STUCK_TOLERANCE_BITS) // STUCK_STEP_BITS
