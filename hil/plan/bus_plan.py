"""Frames of a master's cycle, their duration, and the shortest SYNC period.

A cycle: the master queues its RPDOs and then SYNC, all at once and first in, first out; SYNC makes every node queue its TPDOs,
which leave by their identifiers. All bits are counted with the intermission of 3, so that frames add up.
"""

import math
import random
import struct
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

from drive_profiles.standard.cia301 import FunctionCode
from hil.can.bits import frame_bits, worst_case_bits
from hil.can.frame import Frame
from hil.plan.response_time import Message, response_ns
from hil.plan.wire import WireTiming

SAMPLES, SEED = 200, 1
MARGIN = 0.1
"""Fraction of the period to leave free for a retry after an error, an SDO transfer and the error of a clock."""

FrameKind = Literal["command", "sync", "feedback", "notch state", "load position", "acceleration"]
Range = tuple[str, float, float]
"""Format for `struct`, lowest and highest value of one object."""


@dataclass(frozen=True)
class CyclicFrame:
    """One frame of a cycle.

    Attributes:
        kind: Kind of frame: commands and SYNC come from the master, all others from the nodes once they have seen SYNC.
        contents: Ranges of its objects, in order.
        axis: Number of its axis; None: of no axis, or of several.
    """

    name: str
    kind: FrameKind
    can_id: int
    contents: tuple[Range, ...] = ()
    axis: int | None = None

    @property
    def is_answer(self) -> bool:
        """True if a node sends the frame."""
        return self.kind not in {"command", "sync"}

    @property
    def length(self) -> int:
        """Number of data bytes."""
        return sum(struct.calcsize("<" + form) for form, _, _ in self.contents)

    @property
    def nominal_bits(self) -> int:
        """Bits without any stuff bit, 47 + 8 n."""
        return frame_bits(Frame(self.can_id, bytes(self.length)), stuffed=False)

    @property
    def worst_bits(self) -> int:
        """Bits with as many stuff bits as possible, 55 + 10 n."""
        return worst_case_bits(self.length)

    @cached_property
    def typical_bits(self) -> float:
        """Mean bits over a seeded sample of contents, uniform in their ranges."""
        draw = random.Random(SEED)  # noqa: S311 - a sample that is the same every time is wanted
        return sum(frame_bits(Frame(self.can_id, self._sample(draw))) for _ in range(SAMPLES)) / SAMPLES

    def _sample(self, draw: random.Random) -> bytes:
        parts = (
            struct.pack("<" + form, draw.uniform(low, high) if form == "f" else draw.randint(int(low), int(high)))
            for form, low, high in self.contents
        )
        return b"".join(parts)


SDO_TRANSFERS_PER_S = 50.0
"""Expedited transfers to allow for, 8 bytes each way. The bench makes none in a motion."""
EMERGENCIES_PER_S = 10.0
"""Emergencies of all nodes to allow for; never two in one period."""


@dataclass(frozen=True)
class Background:
    """The frames beside the cycle while the axes move.

    Attributes:
        nodes: Nodes that send a heartbeat and may send an emergency.
    """

    nodes: tuple[int, ...]
    heartbeat_s: float = 0.1

    def messages(self, wire: WireTiming, *, is_busy: bool) -> list[Message]:
        """Return the messages beside the cycle for the analysis."""

        def message(name: str, can_id: int, length: int, per_s: float) -> Message:
            period = round(1e9 / per_s)
            return Message(name, can_id, wire.worst_ns(length), period, period)

        per_s = 1.0 / self.heartbeat_s
        messages = [message(f"heartbeat of node {node}", FunctionCode.HEARTBEAT + node, 1, per_s) for node in self.nodes]
        if is_busy:
            node = max(self.nodes)
            messages.append(message("emergency", FunctionCode.EMERGENCY + min(self.nodes), 8, EMERGENCIES_PER_S))
            messages.append(message("SDO response", FunctionCode.SDO_RESPONSE + node, 8, SDO_TRANSFERS_PER_S))
            messages.append(message("SDO request", FunctionCode.SDO_REQUEST + node, 8, SDO_TRANSFERS_PER_S))
        return messages


@dataclass(frozen=True)
class ResponseTime:
    """Latest arrival of a frame, in ns.

    From the start of the cycle; for a frame off the cycle, from its queuing.

    Attributes:
        quiet_ns: Arrival with only heartbeats beside the cycle; None if it grows without bound.
        busy_ns: Arrival with an emergency and SDO transfers as well.
        deadline_ns: Start of the next cycle, or the frame's own period.
    """

    name: str
    can_id: int
    quiet_ns: int | None
    busy_ns: int | None
    deadline_ns: int

    @property
    def is_met(self) -> bool:
        """True if the deadline is met with heartbeats beside the cycle."""
        return self.quiet_ns is not None and self.quiet_ns <= self.deadline_ns


@dataclass(frozen=True)
class Cycle:
    """All frames of one cycle.

    Attributes:
        frames: Frames in the order in which they are queued: commands, SYNC, answers.
    """

    frames: tuple[CyclicFrame, ...]
    period_s: float
    background: Background

    @property
    def nominal_bits(self) -> int:
        """Bits of the cycle without stuff bits."""
        return sum(frame.nominal_bits for frame in self.frames)

    @property
    def typical_bits(self) -> float:
        """Mean bits of the cycle over sampled contents."""
        return sum(frame.typical_bits for frame in self.frames)

    @property
    def worst_bits(self) -> int:
        """Bits of the cycle with as many stuff bits as possible."""
        return sum(frame.worst_bits for frame in self.frames)

    @property
    def period_ns(self) -> int:
        """The SYNC period in whole ns."""
        return round(self.period_s * 1e9)

    def of(self, kind: FrameKind) -> list[CyclicFrame]:
        """The frames of one kind."""
        return [frame for frame in self.frames if frame.kind == kind]

    def at(self, period_s: float) -> "Cycle":
        """The cycle with another SYNC period."""
        return replace(self, period_s=period_s)

    def worst_ns(self, wire: WireTiming) -> int:
        """Return the worst-case bus time of the cycle's frames in ns."""
        return sum(wire.worst_ns(frame.length) for frame in self.frames)

    def load(self, wire: WireTiming) -> float:
        """Return the bus load of the cycle, at worst.

        A fraction of the time.
        """
        return self.worst_ns(wire) / self.period_ns

    def background_load(self, wire: WireTiming) -> float:
        """Return the bus load of all other frames, at worst.

        A fraction of the time.
        """
        return sum(message.length_ns / message.period_ns for message in self.background.messages(wire, is_busy=True))

    def responses(self, wire: WireTiming) -> list[ResponseTime]:
        """Return the latest arrival of each frame.

        Of cyclic frames from the start of the cycle, of others from their queuing.
        """
        quiet, busy = (self._responses(wire, is_busy=is_busy) for is_busy in (False, True))
        deadlines = {message.name: message.deadline_ns for message in self.background.messages(wire, is_busy=True)}
        ids = {frame.name: frame.can_id for frame in self.frames}
        ids |= {message.name: message.priority for message in self.background.messages(wire, is_busy=True)}
        return [
            ResponseTime(name, ids[name], quiet.get(name, latest), latest, deadlines.get(name, self.period_ns))
            for name, latest in busy.items()
        ]

    def _responses(self, wire: WireTiming, *, is_busy: bool) -> dict[str, int | None]:
        """Return the latest arrivals by name.

        Commands and SYNC leave in turn, answers start with SYNC, other frames wait for the cycle. An emergency that has
        delayed SYNC does not come again among the answers of the same cycle; a frame of lower priority may begin in the
        gap behind SYNC once more.
        """
        others = self.background.messages(wire, is_busy=is_busy)
        arrivals: dict[str, int | None] = {}
        ahead, top, sync = 0, 0, 0
        queued = [frame for frame in self.frames if not frame.is_answer]
        sender = []
        for frame in queued:
            top = max(top, frame.can_id)
            sent = self._message(frame, wire, priority=top, ahead_ns=ahead)
            sender.append(sent)
            arrivals[frame.name] = arrival = response_ns(sent, others, wire.bit_ns)
            ahead += sent.length_ns
            sync = -1 if arrival is None else arrival
        answers = [self._message(frame, wire) for frame in self.frames if frame.is_answer]
        lower = [other for other in others if other.priority > FunctionCode.TPDO1]
        for answer in answers:
            rest = [other for other in answers if other is not answer]
            part = response_ns(answer, [*lower, *rest], wire.bit_ns)
            arrivals[answer.name] = None if part is None or sync < 0 else sync + part
        jitter = max(0, sync - sum(wire.nominal_ns(frame.length) for frame in queued))
        late = [replace(answer, jitter_ns=jitter) for answer in answers]
        plain = [replace(sent, ahead_ns=0, priority=frame.can_id) for sent, frame in zip(sender, queued, strict=True)]
        for other in others:
            rest = [message for message in others if message is not other]
            arrivals[other.name] = response_ns(other, [*plain, *late, *rest], wire.bit_ns)
        return arrivals

    def _message(self, frame: CyclicFrame, wire: WireTiming, priority: int | None = None, ahead_ns: int = 0) -> Message:
        priority = frame.can_id if priority is None else priority
        return Message(frame.name, priority, wire.worst_ns(frame.length), self.period_ns, self.period_ns, 0, ahead_ns)

    def last_answer_ns(self, wire: WireTiming, *, is_busy: bool = False) -> int | None:
        """Return the latest arrival of the drives' last TPDO in ns.

        From the start of the cycle; None if it grows without bound. The accelerometer's TPDO is part of no loop and
        comes after them. At worst it comes after the next SYNC, and one sample of it is missing.
        """
        latest = self._responses(wire, is_busy=is_busy)
        arrivals = [latest[frame.name] for frame in self.frames if frame.is_answer and frame.kind != "acceleration"]
        known = [arrival for arrival in arrivals if arrival is not None]
        return max(known, default=None) if len(known) == len(arrivals) else None

    def shortest_period_s(self, wire: WireTiming, *, margin: float = 0.0) -> float:
        """Return the shortest SYNC period in which every answer fits.

        Every answer comes before the next SYNC, whatever the contents. While a cycle fits into its period, the arrival
        of the last answer does not depend on the period, so that the arrival is the period.
        """
        arrival = self.at(1.0).last_answer_ns(wire)
        return math.inf if arrival is None else arrival * 1e-9 / (1.0 - margin)

    def delay_periods(self, wire: WireTiming | None) -> int | None:
        """Return the delay of a host-closed loop in whole periods.

        From sampling to torque; None if the bus cannot carry it at all. The answer to a SYNC becomes a torque that is
        in force from the next SYNC on: one period if it comes before the next SYNC, two if it comes in the cycle after,
        which counts as a missing answer each time.
        """
        if wire is None:
            return 1
        arrival = self.last_answer_ns(wire)
        if arrival is None or self.load(wire) >= 1.0 or arrival > 2 * self.period_ns:
            return None
        return 1 if arrival <= self.period_ns else 2
