"""Log with its frames, SYNCs, nodes and SDO transfers."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drive_profiles.standard.cia301 import FunctionCode
from drive_profiles.standard.cia402 import State, state_of
from hil.logs.log import Log, Stream
from hil.logs.nodes import Node, Pdo, nodes_of
from hil.logs.overheard import Event, overheard

if TYPE_CHECKING:
    from drive_profiles.eds.description import Description

MISSING_FRACTION, FEW_FRACTION = 0.0005, 0.01
"""Fractions of the cycles in which a frame may be missing: below the first nothing is said; below the second drives and
masters bear it, which is a warning."""
MOVES_COUNTS = 4
"""Counts per cycle from which on a motor is said to move: below it a position may stand still for a cycle."""
LEAST_FRAMES = 20
"""SYNCs, or frames of one identifier, below which nothing is said of a rhythm."""


FRAMES_AT_ONCE = 1 << 18
"""Frames that are calculated with at once."""


@dataclass(frozen=True)
class Cycles:
    """The cycles that SYNCs begin.

    Attributes:
        stamp_ns: Stamps of the SYNCs; shape (n,).
        period_ns: Their median distance.
    """

    stamp_ns: NDArray[np.int64]
    period_ns: float


@dataclass(frozen=True)
class Rhythm:
    """Frames of one identifier against the SYNCs.

    Attributes:
        cycle: Cycle of each frame, by the SYNC that is nearest to it but for the usual distance; shape (n,).
        late_ns: Distance of each from its usual place in the cycle, in ns; shape (n,).
        usual_ns: Usual distance from the SYNC: negative for frames that come before it.
        counts: Frames in each cycle from the first of them to the last.
        first: First of those cycles.
    """

    cycle: NDArray[np.int32]
    late_ns: NDArray[np.float32]
    usual_ns: float
    counts: NDArray[np.int64]
    first: int


def _blocks(values: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield numbers in pieces."""
    for begin in range(0, len(values), FRAMES_AT_ONCE):
        yield values[begin : begin + FRAMES_AT_ONCE]


def _set_ups(log: Log) -> list[int]:
    """Positions at which the period of a cycle is written anew, behind some SYNCs and before others."""
    periods = [0x60 | index << 8 for index in (0x1006, 0x60C2)]  # what a server answers to a download
    answers = [
        stream.position[np.isin(stream.data & np.uint64(0xFFFFFF), periods)] for stream in log.near(FunctionCode.SDO_RESPONSE)
    ]
    written = np.sort(np.concatenate([np.empty(0, np.uint32), *answers]))
    before = np.searchsorted(log.of(FunctionCode.SYNC).position, written)
    found, last = [], 0
    for position, count in zip(written.tolist(), before.tolist(), strict=True):
        if count - last >= LEAST_FRAMES and log.count(FunctionCode.SYNC) - count >= LEAST_FRAMES:
            found.append(position)
            last = count
    return found


class Trace:
    """A log that has been looked through."""

    def __init__(self, log: Log, descriptions: "Mapping[int, Description]", events: list[Event] | None = None) -> None:
        """Look through a log, or through a part of one whose SDO transfers are known."""
        self.log = log
        self.events: list[Event] = overheard(log) if events is None else events
        self.nodes: dict[int, Node] = nodes_of(log, self.events, descriptions)
        self._descriptions = descriptions

    @cached_property
    def parts(self) -> "list[Trace]":
        """Parts between which the nodes were set up anew, each with its own cycle, nodes and mapping."""
        cuts = [0, *_set_ups(self.log), len(self.log)]
        if len(cuts) == 2:
            return [self]
        pairs = itertools.pairwise(cuts)
        return [Trace(self.log.between(begin, end), self._descriptions, self.events) for begin, end in pairs]

    def of(self, pdo: Pdo) -> Stream:
        """Frames of a PDO that are as long as its mapping."""
        stream = self.log.of(pdo.can_id)
        least = max((entry.bytes for entry in pdo.entries), default=0)
        if not np.any(stream.length < least):
            return stream
        rows = stream.length >= least
        return stream.only(rows)

    def enabled_at(self, node: Node, stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_] | None:
        """True where a node's last status word up to an instant says enabled; None if the log has none.

        Frames of one lock-step cycle have the same stamp.
        """
        placed = node.pdo_with("tpdo", 0x6041)
        if placed is None or not len(stream := self.of(placed[0])):
            return None
        rows = np.searchsorted(stream.stamp_ns, stamps_ns, side="right") - 1
        words = placed[1].of(stream)[np.maximum(rows, 0)]
        return (rows >= 0) & np.array([state_of(int(word)) is State.OPERATION_ENABLED for word in words], dtype=np.bool_)

    @cached_property
    def sync(self) -> Stream:
        """The SYNCs."""
        return self.log.of(FunctionCode.SYNC)

    @cached_property
    def cycles(self) -> Cycles | None:
        """Cycles of the log; None with too few SYNCs or stamps."""
        if len(self.sync) < LEAST_FRAMES:
            return None
        period_ns = float(np.median(np.diff(self.sync.stamp_ns)))
        return Cycles(self.sync.stamp_ns, period_ns) if period_ns > 0.0 else None

    def rhythm(self, stream: Stream) -> Rhythm | None:
        """Frames against the SYNCs; None if there are too few of either.

        Their usual place in a cycle is the angle of the mean of e^{2πj t/T}, which is valid near a SYNC as well.
        """
        cycles = self.cycles
        if cycles is None or len(stream) < LEAST_FRAMES:
            return None
        pointer = 0.0j
        for stamps in _blocks(stream.stamp_ns):
            before = np.searchsorted(cycles.stamp_ns, stamps, side="right") - 1
            since = stamps - cycles.stamp_ns[np.maximum(before, 0)]
            inside = (before >= 0) & (since < 1.5 * cycles.period_ns)
            pointer += complex(np.sum(np.exp(2j * np.pi / cycles.period_ns * since[inside])))
        if not abs(pointer):
            return None
        usual = float(np.angle(pointer)) / (2.0 * np.pi) * cycles.period_ns
        centre = cycles.stamp_ns + usual
        cycle, late = np.empty(len(stream), np.int32), np.empty(len(stream), np.float32)
        begin = 0
        for stamps in _blocks(stream.stamp_ns):
            after = np.clip(np.searchsorted(centre, stamps), 1, len(centre) - 1)
            nearer = (stamps - centre[after - 1]) < (centre[after] - stamps)
            rows = slice(begin, begin + len(stamps))
            cycle[rows] = np.where(nearer, after - 1, after)
            late[rows] = stamps - centre[cycle[rows]]
            begin = rows.stop
        del centre
        first, last = int(cycle[0]), int(cycle[-1])
        counts = np.bincount(np.clip(cycle - first, 0, None), minlength=last - first + 1)
        return Rhythm(cycle, late, usual, counts, first)
