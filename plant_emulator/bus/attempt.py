"""One attempt to send on the bus.

It has senders, winners, a duration, and errors that are counted.

Clauses of ISO 11898-1:2015: 10.4 (frames), 10.7 (arbitration), 10.9 (error frames), 12.1.4 (fault confinement).
"""

import heapq
from collections import deque
from collections.abc import Iterable

from hil.can.bits import TAIL_BITS, arbitration_key, frame_bits
from hil.can.frame import Frame
from plant_emulator.bus.controller import Controller, ErrorState
from plant_emulator.bus.rates import INTERMISSION_BITS, Rates

FLAG_BITS, DELIMITER_BITS = 6, 8
AFTER_ACK_BITS = TAIL_BITS - 2
"""Bits of a frame that follow its ACK slot."""


class QueuedFrame:
    """A frame that waits at a port.

    At a port with mailboxes the lower frame goes first.
    """

    __slots__ = (
        "at", "bits", "destroyed", "fast_bits", "frame", "is_babble", "is_late", "key", "order", "port", "was_overtaken",
    )  # fmt: skip

    def __init__(self, frame: Frame, port: "Port", at: int, rates: Rates, destroyed: int = 0, *, is_late: bool = False) -> None:
        """Keep a frame.

        Args:
            frame: The frame that the others will receive.
            port: The port that sends it.
            at: Earliest start, in ns.
            rates: Bit rates of the bus.
            destroyed: Number of attempts that are to fail.
            is_late: A fault keeps it from its queue for a while.

        Raises:
            ValueError: This is not a frame that can be on the wire.
        """
        self.frame, self.port, self.at, self.destroyed, self.is_late = frame, port, at, destroyed, is_late
        slow, self.fast_bits = rates.bits(frame)
        self.bits = slow + self.fast_bits
        self.key = arbitration_key(frame.can_id)
        self.order = 0
        self.is_babble = self.was_overtaken = False

    def ns(self, rates: Rates, without: int = 0) -> int:
        """Return the time on the bus in ns, intermission included.

        `without` bits of its end are left out.
        """
        return rates.ns(self.bits - self.fast_bits - without, self.fast_bits)

    def __lt__(self, other: "QueuedFrame") -> bool:
        return (self.key, self.order) < (other.key, other.order)


class Port:
    """A participant: its queue and its controller.

    Attributes:
        held: Frames that wait for the next one to overtake them.
        babble: The frame that it sends without end instead of its queue, or None.
        not_before: Earliest start of its next frame, in ns.
        waiting: Frames accepted and neither sent nor lost: on their way into the queue, queued, being sent.
    """

    __slots__ = ("babble", "controller", "held", "is_gone", "is_muted", "not_before", "number", "queue", "waiting")

    def __init__(self, number: int, has_mailboxes: bool = False) -> None:
        """Start with nothing to send."""
        self.number = number
        self.controller = Controller()
        self.queue: deque[QueuedFrame] | list[QueuedFrame] = [] if has_mailboxes else deque()
        self.held: list[QueuedFrame] = []
        self.babble: QueuedFrame | None = None
        self.is_gone = self.is_muted = False
        self.not_before = 0
        self.waiting = 0

    @property
    def is_silent(self) -> bool:
        """True while the port neither sends nor acknowledges."""
        return self.is_muted or self.is_gone or self.controller.state is ErrorState.OFF

    @property
    def is_error_free(self) -> bool:
        """True while the port sends from a queue without errors.

        Its error counters are then 0.
        """
        if self.is_muted or self.is_gone or self.babble is not None or self.held or isinstance(self.queue, list):
            return False
        controller = self.controller
        return controller.state is ErrorState.ACTIVE and not controller.tec and not controller.rec

    def push(self, entry: QueuedFrame) -> None:
        """Queue a frame."""
        if isinstance(self.queue, list):
            heapq.heappush(self.queue, entry)
        else:
            self.queue.append(entry)

    def pop(self) -> QueuedFrame:
        """Remove and return the frame that is sent first."""
        return heapq.heappop(self.queue) if isinstance(self.queue, list) else self.queue.popleft()

    def put_back(self, entry: QueuedFrame) -> None:
        """Queue a failed frame before all others, to be sent again."""
        if isinstance(self.queue, list):
            heapq.heappush(self.queue, entry)
        else:
            self.queue.appendleft(entry)


class Attempt:
    """Attempt to send, as planned, then on the bus.

    Attributes:
        start: SOF.
        senders: Frames that start together; more than one where their identifiers are equal.
        winners: Those whose frame is delivered; none where an error frame ends it.
        failed: Those of the senders who count a transmit error.
        dropped_out: Error-passive ones that lost against an equal identifier, and whose flag no other port saw.
        end: End of EOF or of the error delimiter.
        idle: End of the intermission.
        collided: True if two sent one identifier with different contents.
    """

    __slots__ = ("collided", "dropped_out", "end", "failed", "idle", "senders", "start", "winners")

    def __init__(self, start: int, senders: tuple[QueuedFrame, ...]) -> None:
        """Start; `resolve` does the rest."""
        self.start = self.end = self.idle = start
        self.senders = self.winners = senders
        self.dropped_out: tuple[QueuedFrame, ...] = ()
        self.failed: tuple[QueuedFrame, ...] = ()
        self.collided = False

    def drop_out_bits(self, entry: QueuedFrame) -> int:
        """Return the extra bits before this sender's intermission ends.

        One that dropped out waits for six equal bits, which are those from the ACK delimiter on; its delimiter follows them.
        Without an acknowledgement they are those from the CRC delimiter on, two bits before the other sender's flag ends.
        """
        if entry not in self.dropped_out:
            return 0
        return FLAG_BITS if self.winners else -2


def check(frame: Frame) -> None:
    """Refuse a frame that cannot be on the wire.

    Raises:
        ValueError: `hil.can.bits.frame_bits` refuses the frame.
    """
    frame_bits(frame, stuffed=False)


def contend(waiting: Iterable[Port], idle: int) -> Attempt | None:
    """Return the next attempt if no further frame is offered.

    The lowest arbitration field wins among the ports that are ready first.

    Args:
        waiting: Ports that have something to send.
        idle: Time from which the bus is idle, in ns.
    """
    start, best = 0, None
    equal: tuple[QueuedFrame, ...] = ()
    for port in waiting:
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
    return Attempt(start, senders)


def resolve(attempt: Attempt, ports: Iterable[Port], rates: Rates) -> None:
    """Work out the end of an attempt.

    Args:
        attempt: The attempt with its senders; all the rest is filled in.
        ports: All ports of the bus.
        rates: Bit rates of the bus.
    """
    first = attempt.senders[0]
    if len(attempt.senders) > 1 or first.destroyed or not _is_heard(first.port, ports):
        senders = {entry.port for entry in attempt.senders}
        others = [port for port in ports if port not in senders and not port.is_silent]
        _collide(attempt, others, rates)
        if attempt.winners:
            _acknowledge(attempt, others, rates)
        if not attempt.winners:
            return
        first = attempt.winners[0]
    attempt.end = attempt.start + first.ns(rates, INTERMISSION_BITS)
    attempt.idle = attempt.start + first.ns(rates)


def _is_heard(sender: Port, ports: Iterable[Port]) -> bool:
    for port in ports:  # noqa: SIM110 - a loop, since this is asked for every frame and the first other one mostly is the answer
        if port is not sender and not port.is_silent:
            return True
    return False


def _acknowledge(attempt: Attempt, others: list[Port], rates: Rates) -> None:
    """Decide whether the frame is acknowledged.

    It is if another port listens, and not all have seen a wrong CRC.

    Otherwise the sender's error flag begins with the ACK delimiter, and the listening ports answer it one bit later.
    """
    winners = attempt.winners
    if others and not any(entry.destroyed for entry in winners):
        return
    echo = any(not port.controller.is_passive for port in others)
    # 12.1.4.2 rule c, exception 1: an error-passive sender that sees no dominant bit during its flag does not count it
    attempt.failed += tuple(entry for entry in winners if echo or not entry.port.controller.is_passive)
    first = winners[0]
    _fail(attempt, (first.bits - first.fast_bits - AFTER_ACK_BITS + echo, first.fast_bits), rates)


def _fail(attempt: Attempt, sent: tuple[int, int], rates: Rates) -> None:
    """End the attempt with an error frame.

    `sent` is the number of bits at either rate, those of the echo included.
    """
    slow, fast = sent
    slow += FLAG_BITS + DELIMITER_BITS
    attempt.winners = ()
    attempt.end, attempt.idle = attempt.start + rates.ns(slow, fast), attempt.start + rates.ns(slow + INTERMISSION_BITS, fast)


def _collide(attempt: Attempt, others: list[Port], rates: Rates) -> None:
    """Resolve several frames that have one arbitration field.

    Senders of equal bits win, or an error frame ends the attempt.

    A sender of a recessive bit that sees a dominant one has a bit error. The flag of an error-active sender ends the frame
    for all: a receiver sees the sixth equal bit, a sender one of its own bits overwritten. An error-passive sender drops out
    unnoticed. In a CAN FD frame the flag is sent at the slow rate, and ports that have not seen the error yet still sample
    at the fast one.
    """
    alive = {entry: rates.sent_bits(entry.frame) for entry in attempt.senders}
    while True:
        at = _first_difference(list(alive.values()))
        if at is None:
            break
        attempt.collided = True
        losers = tuple(entry for entry, text in alive.items() if text[at] == "1")
        attempt.failed += losers
        alive = {entry: text for entry, text in alive.items() if text[at] == "0"}
        if not all(entry.port.controller.is_passive for entry in losers):
            attempt.failed += tuple(alive)
            echo = _echo(at, alive, others)
            _fail(attempt, rates.split(losers[0].frame, at + 1 + echo), rates)
            return
        attempt.dropped_out += losers
    attempt.winners = tuple(alive)


def _first_difference(texts: list[str]) -> int | None:
    for position, bits in enumerate(zip(*texts, strict=False)):
        if len(set(bits)) > 1:
            return position
    return None


def _echo(at: int, winners: dict[QueuedFrame, str], others: list[Port]) -> int:
    """Return the bits until the last port echoes the error.

    They are counted after bit `at`, where the flag begins; each port then sends a flag of its own.
    """
    own = {entry: text + "1" for entry, text in winners.items()}  # with the CRC delimiter
    echo = max((text.index("1", at + 1) - at for entry, text in own.items() if not entry.port.controller.is_passive), default=0)
    if any(not port.controller.is_passive for port in others):
        text = next(iter(own.values()))
        run = at + 1 - len(text[: at + 1].rstrip("0"))
        echo = max(echo, min(FLAG_BITS - run, len(text) - 1 - at))
    return echo
