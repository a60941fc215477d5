"""One attempt to send on the bus.

Clauses of ISO 11898-1:2015: 10.4 (frames), 10.7 (arbitration), 10.9 (error frames), 12.1.4 (fault confinement).
"""

from collections import deque
from collections.abc import Iterable

from hil.can.bits import TAIL_BITS, arbitration_key
from hil.can.frame import Frame
from plant_emulator.bus.controller import Controller, ErrorState
from plant_emulator.bus.rates import INTERMISSION_BITS, Rates

FLAG_BITS, DELIMITER_BITS = 6, 8
AFTER_ACK_BITS = TAIL_BITS - 2
"""Bits of a frame that follow its ACK slot."""


class QueuedFrame:
    """A frame that waits at a port.

    Attributes:
        destroyed: Number of attempts that are to fail.
        is_late: A fault keeps it from its queue for a while.
        is_babble: Its port sends it without end.
        was_overtaken: A copy of it went behind the frame that overtook it.
    """

    destroyed = 0
    is_late = is_babble = was_overtaken = False

    def __init__(self, frame: Frame, port: "Port", at: int, rates: Rates) -> None:
        """Keep a frame.

        Args:
            frame: The frame that the others will receive.
            at: Earliest start, in ns.

        Raises:
            ValueError: This is not a frame that can be on the wire.
        """
        self.frame, self.port, self.at = frame, port, at
        self.key = arbitration_key(frame[0])
        self.slow_bits, self.fast_bits = rates.bits(frame)


class Port:
    """A participant: its queue and its controller.

    Attributes:
        held: Frames that wait for the next one to overtake them.
        babble: The frame that it sends without end instead of its queue, or None.
        not_before: Earliest start of its next frame, in ns.
        waiting: Frames accepted and neither sent nor lost: on their way into the queue, queued, being sent.
    """

    __slots__ = ("babble", "controller", "held", "is_gone", "is_muted", "not_before", "number", "queue", "waiting")

    def __init__(self, number: int) -> None:
        self.number = number
        self.controller = Controller()
        self.queue: deque[QueuedFrame] = deque()
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
        """True while the port sends from a queue, with error counters at 0."""
        return not (self.is_silent or self.babble is not None or self.controller.tec or self.controller.rec)


class Attempt:
    """Attempt to send, from its first bit on.

    Attributes:
        senders: Frames that start together; more than one where their identifiers are equal.
        winners: Those whose frame is delivered; none where an error frame ends it.
        failed: Those of the senders who count a transmit error.
        dropped_out: Error-passive ones that lost against an equal identifier, and whose flag no other port saw.
        end: End of EOF or of the error delimiter.
        idle: End of the intermission.
        collided: True if two sent one identifier with different contents.
    """

    failed: tuple[QueuedFrame, ...] = ()
    dropped_out: tuple[QueuedFrame, ...] = ()
    collided = False

    def __init__(self, start: int, senders: tuple[QueuedFrame, ...], rates: Rates) -> None:
        """Let the first of the senders win."""
        self.start, self.senders, self.winners = start, senders, senders
        self.occupy(senders[0].slow_bits - INTERMISSION_BITS, senders[0].fast_bits, rates)

    def occupy(self, slow: int, fast: int, rates: Rates) -> None:
        """Set the end of the attempt after bits at either rate."""
        if rates.is_exact:
            self.end = self.start + slow * rates.bit_ns + fast * rates.fast_bit_ns
            self.idle = self.end + INTERMISSION_BITS * rates.bit_ns
        else:
            self.end = self.start + rates.ns(slow, fast)
            self.idle = self.start + rates.ns(slow + INTERMISSION_BITS, fast)

    def disturb(self, ports: Iterable[Port], rates: Rates) -> None:
        """Let errors change what happens at its end."""
        sending = {entry.port for entry in self.senders}
        others = [port for port in ports if port not in sending and not port.is_silent]
        if len(self.senders) > 1:
            _collide(self, others, rates)
        if self.winners:
            _acknowledge(self, others, rates)
        if self.winners and self.winners[0] is not self.senders[0]:
            self.occupy(self.winners[0].slow_bits - INTERMISSION_BITS, self.winners[0].fast_bits, rates)

    def drop_out_bits(self, entry: QueuedFrame) -> int:
        """Return the extra bits before this sender's intermission ends.

        One that dropped out waits for six equal bits, which are those from the ACK delimiter on; its delimiter follows them.
        Without an acknowledgement they are those from the CRC delimiter on, two bits before the other sender's flag ends.
        """
        if entry not in self.dropped_out:
            return 0
        return FLAG_BITS if self.winners else -2


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
    _fail(attempt, (first.slow_bits - AFTER_ACK_BITS + echo, first.fast_bits), rates)


def _fail(attempt: Attempt, sent: tuple[int, int], rates: Rates) -> None:
    """End the attempt with an error frame."""
    attempt.winners = ()
    attempt.occupy(sent[0] + FLAG_BITS + DELIMITER_BITS, sent[1], rates)


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
        at = next((place for place, bits in enumerate(zip(*alive.values(), strict=False)) if len(set(bits)) > 1), None)
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
