"""One CAN bus as a model, sans IO.

It decides which port sends when, how long a frame takes, and what errors do to it. Times are integer nanoseconds.

A transmission starts after the intermission at the earliest. Among the frames that wait at that instant the lowest
arbitration field wins. Frames offered at that very instant take part, so an instant is decided only when time has gone past
it. A frame received at its end may be answered in time for the next start, three bits later.

    frame: SOF … CRC, CRC delimiter, ACK slot, ACK delimiter, EOF 7 | intermission 3
    error: what was sent until then, error flag 6, echo of the others 0 to 6, error delimiter 8 | intermission 3

`Delivered.end_ns` is the end of EOF (or of the error delimiter); the bus is busy until the end of the intermission.

The winner is chosen when time passes the start of frame; errors change what happens at its end. Error counters and bus-off are
`confinement`'s, what waits is in `queues`.

Clauses of ISO 11898-1:2015: 10.4 (frames), 10.5 (stuffing), 10.7 (arbitration), 10.9 and 12.1.4 (errors, see `confinement`).
"""

import heapq
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from hil.can.bits import frame_bits
from hil.can.frame import Frame
from plant_emulator.bus.attempt import DELIMITER_BITS, Attempt, Port, QueuedFrame
from plant_emulator.bus.confinement import Confinement
from plant_emulator.bus.controller import Controller
from plant_emulator.bus.faults import BusEvent, BusFaults
from plant_emulator.bus.queues import Queues
from plant_emulator.bus.rates import INTERMISSION_BITS, Rates
from plant_emulator.bus.traffic import Delivered, Passed, Statistics

QUEUE_FRAMES = 256
"""Default room of a port: for the 127 frames that an SDO block transfer sends at once, and the PDOs that go meanwhile. A
SocketCAN interface has 10 by default (txqueuelen), and lets its writer wait."""
MAX_PORTS = 1024
NO_PORT = 1 << 62
"""Number above every port: it stops nothing."""


class EmulatedWire:
    """A bus and all that is attached to it.

    With a data bit rate it is a CAN FD bus: data frames carry the same 0 to 8 bytes, but these, their length and the CRC go at
    that rate: at 1 and 5 Mbit/s a frame of 8 bytes takes some 50 µs instead of 111 and more.

    Attributes:
        now: Up to where time has passed, in ns.
        switched: Ports that went bus-off (True) or came back (False), in order, for the owner to take; the oldest are forgotten.
    """

    def __init__(
        self,
        bitrate: int | None,
        data_bitrate: int | None = None,
        *,
        queue_frames: int = QUEUE_FRAMES,
        faults: BusFaults | None = None,
        now_ns: int = 0,
    ) -> None:
        """Make an idle bus without ports.

        Args:
            bitrate: In bit/s, or None for a bus without bit times: a frame is delivered when it is offered, in order of offers.
            data_bitrate: Bit rate of the data of CAN FD frames, in bit/s; None: a classic bus.

        Raises:
            ValueError: No bit rate, a data bit rate below it, no room, or faults that need bit times on a bus without.
        """
        self.rates = Rates(bitrate, data_bitrate)
        if queue_frames < 1:
            raise ValueError(f"a queue of {queue_frames} frames; expected at least 1")
        self.now = self._idle = self._busy_until = now_ns
        self._ports: dict[int, Port] = {}
        self._flight: Attempt | None = None  # what is on the bus
        self._counts = Statistics()
        self._is_calm = True  # no port is silent, suspended or babbles, or has counted an error
        self._queues = Queues(self._ports, self.rates, self._counts, queue_frames)
        self._confinement = Confinement(self._ports, self.rates, self._counts, self._queues)
        self.switched = self._confinement.switched
        self._faults = faults
        for event in faults.events if faults is not None else ():
            if bitrate is None and event.kind in {"babble", "stuck"}:
                what = f"a bus without bit times cannot have a fault of kind {event.kind}"
                raise ValueError(f"{what}; give it a bit rate, such as @1M")
            self.schedule(event)

    @property
    def bitrate(self) -> int | None:
        """Bit rate of the arbitration, in bit/s; None: no bit times."""
        return self.rates.bitrate

    # --- ports ---

    def attach(self, port: int | None = None) -> int:
        """Give a participant its port, and return the port's number.

        Args:
            port: Any number from 0 that is free; else the lowest one that is.

        Raises:
            ValueError: The number is taken or negative, or there are too many ports.
        """
        if port is None:
            port = next(number for number in range(MAX_PORTS + 1) if number not in self._ports)
        if port in self._ports or port < 0 or len(self._ports) >= MAX_PORTS:
            raise ValueError(f"port {port} is not free")
        self._ports[port] = Port(port)
        return port

    def detach(self, port: int) -> None:
        """Detach a participant; queued frames are lost, one on the bus continues.

        Raises:
            ValueError: There is no such port.
        """
        participant = self._port(port)
        self._queues.clear(participant)
        participant.is_gone = True
        del self._ports[port]

    def controller(self, port: int) -> Controller:
        """Return the controller of a port, for inspection.

        Raises:
            ValueError: There is no such port.
        """
        return self._port(port).controller

    def switch_off(self, port: int) -> None:
        """Put a port bus-off at once.

        Raises:
            ValueError: There is no such port.
        """
        self._is_calm = False
        self._confinement.switch_off(self._port(port))

    def restart(self, port: int, at_ns: int | None = None) -> None:
        """Restart a port that is bus-off; ignore others.

        It takes part again after the bits that the standard demands.

        Args:
            at_ns: Time of the action; None: now.

        Raises:
            ValueError: There is no such port, or `at_ns` lies in the past.
        """
        participant = self._port(port)
        self._is_calm = False
        if at_ns is None:
            self._confinement.restart(participant, self.now)
        elif at_ns < self.now:
            raise ValueError(f"the bus is at {self.now} ns and cannot restart a port at {at_ns} ns")
        else:
            self.schedule(BusEvent(at_ns, "restart", port))

    def schedule(self, event: BusEvent) -> None:
        """Let a fault begin or end at its instant."""
        self._queues.put_off(event.at_ns, event)

    # --- frames ---

    def offer(self, port: int, frame: Frame, at_ns: int) -> bool:
        """Put a frame into a port's queue; False if full or bus-off.

        Raises:
            ValueError: There is no such port, `at_ns` lies in the past, or this is not a frame that can be on the wire.
        """
        participant = self._port(port)
        if at_ns < self.now:
            raise ValueError(f"the bus is at {self.now} ns and accepts no frame of {at_ns} ns")
        if self._faults is None:
            is_taken = self._queues.accept(participant, at_ns, self.now, frame)
            return is_taken or self._refuse()
        frame_bits(frame, stuffed=False)  # refuses what cannot be on the wire, before a fault meets it
        passages = self._faults.apply(frame, port, at_ns)
        accepted = [self._queues.accept(participant, at_ns, self.now, *passage) or self._refuse() for passage in passages]
        return all(accepted)

    def _refuse(self) -> bool:
        self._counts.refused += 1
        return False

    @property
    def mark(self) -> int:
        """Mark for `is_waiting`: frames offered from now on."""
        return self._queues.order

    def is_waiting(self, mark: int) -> bool:
        """Return True while a frame is queued, delayed, or on the bus.

        Args:
            mark: Instant before which a fault's delays do not count; a fault to come does not count either.
        """
        return self._flight is not None or self._queues.is_waiting(mark)

    @property
    def due(self) -> int | None:
        """Instant of the next event, or None.

        It is usually the end of a frame, if nothing else is offered; it may be earlier.
        """
        queues = self._queues
        later = queues.later[0][0] if queues.later else None
        attempt = self._flight or self._next()
        end = None if attempt is None else attempt.end
        return later if end is None or (later is not None and later < end) else end

    def advance(self, until_ns: int) -> list[Delivered]:
        """Let time pass; return the frames that have ended.

        Their ends are not after `until_ns`; they are in order.

        Raises:
            ValueError: `until_ns` lies in the past.
        """
        return [Delivered(frame, port, start, end) for frame, port, start, end, *_ in self.listen(until_ns)]

    def listen(self, until_ns: int, stop_port: int = NO_PORT) -> list[Passed]:
        """Let time pass, but stop at certain frames.

        Time stops at the end of a frame of `stop_port` or a port above; `now` tells where. The frames that have ended are
        returned, as by `advance`.

        With a `stop_port` it also stops if a port is `switched`.

        Raises:
            ValueError: `until_ns` lies in the past.
        """
        if until_ns < self.now:
            raise ValueError(f"the bus is at {self.now} ns and does not go back to {until_ns} ns")
        passed: list[Passed] = []
        queues, confinement = self._queues, self._confinement
        later, confinement.has_switched = queues.later, False
        while True:
            attempt = self._flight or self._next()
            soon = until_ns + 1 if attempt is None else attempt.end if attempt is self._flight else attempt.start + 1
            if later and later[0][0] < soon:
                at = later[0][0]
                if at > until_ns:
                    break
                self._release(passed)
            elif attempt is None or soon > until_ns:
                break
            elif attempt is self._flight:
                at = attempt.end
                self._land(attempt, passed)
            else:
                queues.take(attempt)
                self._flight = attempt  # its first bit is sent: from now on it stands
                continue
            if passed and passed[-1][1] >= stop_port:
                self.now = passed[-1][3]
                return passed
            if confinement.has_switched and stop_port != NO_PORT:
                self.now = max(self.now, at)
                return passed
        self.now = until_ns
        return passed

    # --- many frames at once ---

    @property
    def is_undisturbed(self) -> bool:
        """True if the bus is classic and empty, all its ports are error-free, and nothing but new offers can happen to it."""
        queues = self._queues
        if self._faults is not None or self._flight is not None or queues.waiting or queues.later:
            return False
        return self.rates.is_exact and self.rates.data_bitrate is None and self._is_calm and len(self._ports) > 1

    @property
    def idle(self) -> int:
        """SOF of a frame that is offered now to an empty bus, in ns."""
        return max(self.now, self._idle)

    def pass_at_once(self, ends: Sequence[int], senders: Sequence[int], until: int) -> None:
        """Let frames pass that one port has offered now, and their answers; `is_undisturbed` must be true.

        Args:
            ends: Ends of the port's frames, and of the answers, which are offered at the last of the former.
            senders: Port of each answer, in the order in which the bus sends them.
            until: Time up to which time passes, in ns.
        """
        bit_ns, counts, asked = self.rates.bit_ns, self._counts, len(ends) - len(senders)
        gap, begin, idle = INTERMISSION_BITS * bit_ns, self.idle, ends[-1] + INTERMISSION_BITS * bit_ns
        longest_ns = (ends[asked - 2] + gap if asked > 1 else begin) - self.now  # the last frame of a queue waits longest
        if senders:
            longest_ns = max(longest_ns, ends[-2] + gap - ends[asked - 1])
        if counts.longest_queue < max(asked, len(senders)):
            counts.longest_queue = max(counts.longest_queue, asked, *Counter(senders).values())
        counts.frames += len(ends)
        counts.bits += (idle - begin) // bit_ns
        counts.longest_wait_ns = max(counts.longest_wait_ns, longest_ns)
        self._occupy(begin, idle)
        self._idle, self.now = idle, until

    @property
    def statistics(self) -> Statistics:
        """Counts since the start."""
        return replace(self._counts)

    # --- how it works ---

    def _port(self, number: int) -> Port:
        port = self._ports.get(number)
        if port is None:
            raise ValueError(f"there is no port {number}")
        return port

    def _occupy(self, begin: int, end: int) -> None:
        """Count a stretch in which the bus is busy, as far as it has not been counted."""
        begin = max(begin, self._busy_until)
        if end > begin:
            self._counts.busy_ns += end - begin
            self._busy_until = end

    def _next(self) -> Attempt | None:
        """Return the next attempt if no further frame is offered.

        The lowest arbitration field wins among the ports that are ready first.
        """
        start, idle, best = 0, self._idle, None
        equal: tuple[QueuedFrame, ...] = ()
        for port in self._queues.waiting.values():
            entry = port.babble or port.queue[0]
            ready = entry.at if entry.at > idle else idle
            ready = port.not_before if port.not_before > ready else ready
            if best is None or ready < start:
                start, best, equal = ready, entry, ()
            elif ready == start:
                if entry.key < best.key:
                    best, equal = entry, ()
                elif entry.key == best.key:
                    equal += (entry,)
        if best is None:
            return None
        senders = tuple(sorted((best, *equal), key=lambda entry: entry.port.number)) if equal else (best,)
        attempt = Attempt(start, senders, self.rates)
        if equal or best.destroyed or not self._is_calm or len(self._ports) < 2:
            attempt.disturb(self._ports.values(), self.rates)
        return attempt

    def _land(self, attempt: Attempt, delivered: list[Passed]) -> None:
        """End an attempt, as a frame or with an error frame."""
        self._flight, self._idle = None, attempt.idle
        self._occupy(attempt.start, attempt.idle)
        winners = attempt.winners
        if winners:
            start, first = attempt.start, winners[0]
            bits = first.slow_bits + first.fast_bits
            delivered.append((first.frame, first.port.number, start, attempt.end, bits, first.at))
            counts = self._counts
            counts.frames += 1
            counts.bits += bits
            for entry in winners:
                if not entry.is_babble:
                    entry.port.waiting -= 1
                counts.longest_wait_ns = max(counts.longest_wait_ns, start - entry.at)
        if self._confinement.is_troubled or not winners or len(attempt.senders) > 1:
            self._confinement.judge(attempt)
            self._is_calm = False
        if not self._is_calm:
            self._is_calm = all(port.is_error_free and port.not_before <= attempt.idle for port in self._ports.values())

    def _release(self, delivered: list[Passed]) -> None:
        """Process a held event or frame that is due."""
        at, _, what = heapq.heappop(self._queues.later)
        if isinstance(what, BusEvent):
            self._happen(what)
            return
        port = what.port
        if what.was_overtaken:
            return  # a copy of it went behind the frame that overtook it
        if what in port.held:
            port.held.remove(what)
        if self.bitrate is not None:
            self._queues.queue(what)
        elif port.is_silent:
            self._queues.lose(port)
        else:
            port.waiting -= 1
            self._counts.frames += 1
            delivered.append((what.frame, port.number, at, at, what.slow_bits, at))

    def _happen(self, event: BusEvent) -> None:
        """Begin or end a fault."""
        queues = self._queues
        self._is_calm = False
        if event.kind == "stuck":
            self._stick(event.at_ns, event.until_ns or event.at_ns)
            return
        port = self._ports.setdefault(event.port, Port(event.port))  # a port that nobody holds is a stranger's
        match event.kind:
            case "mute" | "unmute":
                port.is_muted = event.kind == "mute"
                if port.is_muted:
                    queues.clear(port)
            case "babble" if event.frame is not None:
                queues.babble(port, QueuedFrame(event.frame, port, event.at_ns, self.rates))
            case "quiet":
                queues.babble(port, None)
            case "bus_off":
                self._confinement.switch_off(port)
            case "restart":
                self._confinement.restart(port, event.at_ns)

    def _stick(self, at: int, until: int) -> None:
        """Hold the bus dominant for a while.

        The frame that is being sent fails.
        """
        attempt, self._flight = self._flight, None
        idle = until + self.rates.ns(DELIMITER_BITS + INTERMISSION_BITS)
        self._occupy(attempt.start if attempt is not None else max(at, min(self._idle, until)), idle)
        self._idle = max(self._idle, idle)
        self._confinement.stick(attempt, at, until, self._idle)
