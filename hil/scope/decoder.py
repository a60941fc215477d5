"""Rows of values from frames, one for each SYNC."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drive_profiles.eds.description import Description
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import FunctionCode, NmtCommand, NmtState
from drive_profiles.standard.error_codes import error_text
from hil.bench.bench import Bench
from hil.can.listening import ReceivedFrames
from hil.control.arrays import Real
from hil.logs.findings.bus import likely_bits
from hil.logs.log import Stream
from hil.scope.overhearing import Overhearing
from hil.scope.past import widened
from hil.scope.readers import TARGET, FrameReading, reading_of
from hil.scope.signals import Signal, SignalQuantity

ROWS_BEHIND = 2
"""Rows between a position set-point and the position that it asks for: one that is sent before SYNC n takes effect with it, is
reached at SYNC n + 1, and stands in the row before n."""
LONGEST_GAP = 1.5
"""Rows further apart than so many of the usual ones do not tell a speed."""


@dataclass
class AxisPast:
    """The last rows of an axis, which those to come need."""

    time_s: float = np.nan
    position: float = np.nan
    targets: Real = field(default_factory=lambda: np.full(ROWS_BEHIND, np.nan))


def derived(
    name: str, time_s: Real, found: Mapping[Signal, Real], target: Real | None, past: AxisPast
) -> dict[Signal, Real]:  # fmt: skip
    """Compute speed and following error of an axis, unless it sends them.

        v_n = (p_n − p_{n−1}) / (t_n − t_{n−1}),   e_n = p*_{n−2} − p_n.

    Times and set-points have the shape (n,), the latter in the position's unit; the axis' last rows, `past`, are replaced.
    """
    sent = {signal.quantity: signal for signal in found if signal.of == name}
    position_signal = sent.get(SignalQuantity.POSITION)
    if position_signal is None or not len(time_s):
        return {}
    position = found[position_signal]
    new: dict[Signal, Real] = {}
    if SignalQuantity.SPEED not in sent:
        steps_s = np.diff(time_s, prepend=past.time_s)
        usual = np.nanmedian(steps_s) if not np.all(np.isnan(steps_s)) else np.nan
        with np.errstate(divide="ignore", invalid="ignore"):
            speed = np.diff(position, prepend=past.position) / np.where(steps_s < LONGEST_GAP * usual, steps_s, np.nan)
        new[Signal(name, SignalQuantity.SPEED, f"{position_signal.unit}/s")] = speed
    targets = np.concatenate([past.targets, np.full(len(time_s), np.nan) if target is None else target])
    if SignalQuantity.FOLLOWING_ERROR not in sent and target is not None:
        new[Signal(name, SignalQuantity.FOLLOWING_ERROR, position_signal.unit)] = targets[: len(time_s)] - position
    past.time_s, past.position, past.targets = float(time_s[-1]), float(position[-1]), targets[-ROWS_BEHIND:]
    return new


CYCLES_WITHOUT_SYNC = 50
"""Frames of the identifier that comes most often after which they stand for SYNCs, where there are none."""
GAP_CYCLES = 5.0
"""Cycles without SYNC that are said to be a gap."""
DOWNLOADED = 0x60
"""First byte of a server's answer to a download (CiA 301, 7.2.4.3.3)."""
PDO_OBJECTS = (0x1400, 0x1BFF)
"""Indices of the objects that say what PDOs are."""
_BUS = "bus"


@dataclass(frozen=True)
class HeardEvent:
    """An event on the bus.

    Attributes:
        kind: `emcy`, `nmt` for a command of the NMT master, or `gap` for some cycles without SYNC.
        node: Node-ID; 0 for all.
    """

    time_s: float
    kind: Literal["emcy", "nmt", "gap"]
    node: int
    words: str


@dataclass(frozen=True)
class SignalRows:
    """Rows that have become whole.

    Attributes:
        time_s: Times of their SYNCs; shape (n,).
        values: A column per signal; shape (n, m).
        signals: The signals; they only ever become more, and keep their columns.
    """

    time_s: Real
    values: Real
    signals: tuple[Signal, ...]
    events: tuple[HeardEvent, ...] = ()


@dataclass
class _Open:
    """The incomplete row, and state between rows."""

    stamp_ns: int | None = None
    values: dict[object, float] = field(default_factory=dict)
    seen: set[int] = field(default_factory=set)
    bits: float = 0.0


class SignalDecoder:
    """Rows of a bus, from its frames.

    Args:
        bitrate: Bit rate in bit/s; None if it is not known, and the load is in kbit/s.
    """

    def __init__(self, bench: Bench | None, descriptions: Mapping[int, Description], bitrate: int | None) -> None:
        self._bench, self._bitrate = bench, bitrate
        self._overhearing = Overhearing(bench, descriptions)
        self._reading = FrameReading((), {}, ())
        self.signals: list[Signal] = []
        self._open = _Open()
        self._past: dict[str, AxisPast] = {}
        self._usual_s = math.nan
        self._begin_id: int | None = None
        self._counts: dict[int, int] = {}
        self._operational: dict[int, bool] = {}
        self._speakers: set[int] = set()
        axes = () if bench is None else bench.axis.values()
        self._fault_texts = {axis.node_id: Profile.load(axis.profile).fault_texts for axis in axes}

    def feed(self, heard: ReceivedFrames) -> SignalRows:
        """Return the rows that these frames complete."""
        is_answer = (heard["can_id"] & ~np.uint32(0x7F)) == FunctionCode.SDO_RESPONSE
        index = heard["data"] >> np.uint64(8) & np.uint64(0xFFFF)
        is_written = (
            is_answer & (heard["data"] & np.uint64(0xFF) == DOWNLOADED) & (index >= PDO_OBJECTS[0]) & (index <= PDO_OBJECTS[1])
        )
        writes = np.flatnonzero(is_written)
        # writes between which nothing but SDOs came are looked at together: nothing is read by a mapping that is half written
        others = np.cumsum(~is_answer & ((heard["can_id"] & ~np.uint32(0x7F)) != FunctionCode.SDO_REQUEST))[writes]
        parts = [self._feed(part) for part in np.split(heard, writes[np.diff(others, prepend=-1) > 0])]
        width = len(self.signals)
        return SignalRows(
            np.concatenate([part.time_s for part in parts]),
            np.concatenate([widened(part.values, width) for part in parts]),
            tuple(self.signals),
            tuple(event for part in parts for event in part.events),
        )

    def _feed(self, heard: ReceivedFrames) -> SignalRows:
        if self._overhearing.take(heard):
            self._reading = reading_of(self._overhearing.nodes, self._bench)
            self._speakers &= set(self._reading.expected)
        events = tuple(self._events(heard))
        self._choose_begin(heard)
        begins = np.flatnonzero(heard["can_id"] == (-1 if self._begin_id is None else self._begin_id))
        if self._begin_id is None:
            return SignalRows(np.empty(0), np.empty((0, len(self.signals))), tuple(self.signals), events)
        # row 0 is the one that is open; row k begins with the k-th SYNC
        row_of = np.searchsorted(begins, np.arange(len(heard)), side="right")
        stamps = np.concatenate([[-1 if self._open.stamp_ns is None else self._open.stamp_ns], heard["stamp_ns"][begins]])
        columns, missed, bits = self._columns(heard, row_of, len(stamps))
        whole = slice(0 if self._open.stamp_ns is not None else 1, len(stamps) - 1)
        rows = self._finish(stamps, columns, missed, bits, whole)
        events += tuple(self._gaps(stamps[whole.start :] * 1e-9))
        if len(begins):
            self._open.stamp_ns = int(stamps[-1])
        self._open.values = {key: float(column[-1]) for key, column in columns.items()}
        self._open.bits = float(bits[-1])
        return SignalRows(*rows, tuple(self.signals), events)

    def _choose_begin(self, heard: ReceivedFrames) -> None:
        """SYNC, or the most frequent identifier without SYNC."""
        if self._begin_id == FunctionCode.SYNC:
            return
        for can_id, count in zip(*np.unique(heard["can_id"], return_counts=True), strict=True):
            self._counts[int(can_id)] = self._counts.get(int(can_id), 0) + int(count)
        if self._counts.get(FunctionCode.SYNC):
            self._begin_id, self._open = int(FunctionCode.SYNC), _Open()
        elif self._begin_id is None:
            ids = {reader.can_id for reader in self._reading.readers}
            often = max(ids, key=lambda each: self._counts.get(each, 0), default=None)
            if often is not None and self._counts.get(often, 0) >= CYCLES_WITHOUT_SYNC:
                self._begin_id = often

    def _columns(self, heard: ReceivedFrames, row_of: NDArray[np.intp], count: int) -> tuple[dict[object, Real], Real, Real]:
        """Values, missed answers and bits of each row."""
        columns: dict[object, Real] = {}
        carried = self._open.values
        streams: dict[int, tuple[Stream, NDArray[np.intp]]] = {}
        for can_id in {reader.can_id for reader in self._reading.readers} | set(self._reading.expected):
            rows = np.flatnonzero(heard["can_id"] == can_id)
            own = heard[rows]
            streams[can_id] = (
                Stream(can_id, rows.astype(np.uint32), own["stamp_ns"], own["length"], own["data"]),
                row_of[rows],
            )
        for reader in self._reading.readers:
            column = np.full(count, np.nan)
            column[0] = carried.get(reader.key, np.nan)
            stream, rows = streams[reader.can_id]
            if len(stream):
                long_enough = stream.length >= reader.least
                column[rows[long_enough]] = reader.decode(stream.only(long_enough))
            columns[reader.key] = column
        for key, value in carried.items():
            if key not in columns and not math.isnan(value):  # its mapping has gone since, in the row that is open
                columns[key] = np.concatenate([[value], np.full(count - 1, np.nan)])
        missed = self._missed(streams, count)
        bits = np.bincount(row_of, weights=likely_bits(heard["can_id"], heard["length"]), minlength=count).astype(np.float64)
        bits[0] += self._open.bits
        return columns, missed, bits

    def _missed(self, streams: Mapping[int, tuple[Stream, NDArray[np.intp]]], count: int) -> Real:
        """Count missing answers of operational nodes in each row."""
        missed = np.zeros(count)
        seen_in_open: set[int] = set()
        for can_id, node in self._reading.expected.items():
            _, rows = streams[can_id]
            there = np.bincount(rows, minlength=count) > 0
            there[0] |= can_id in self._open.seen
            began = 0 if can_id in self._speakers else int(np.argmax(there)) if there.any() else count
            if there.any():
                self._speakers.add(can_id)
            if there[-1]:
                seen_in_open.add(can_id)
            if self._operational.get(node, True):
                missed[began:] += ~there[began:]
            else:
                self._speakers.discard(can_id)
        self._open.seen = seen_in_open
        return missed

    def _finish(
        self, stamps: NDArray[np.int64], columns: dict[object, Real], missed: Real, bits: Real, whole: slice
    ) -> tuple[Real, Real]:
        """Return times and values of the complete rows, with the derived signals."""
        time_s = np.asarray(stamps[whole] * 1e-9, np.float64)
        if not len(time_s):
            return time_s, np.empty((0, len(self.signals)))
        steps_s = np.diff(stamps)[whole] * 1e-9
        found: dict[Signal, Real] = {key: column[whole] for key, column in columns.items() if isinstance(key, Signal)}
        for name in self._reading.axes:
            target = columns.get((TARGET, name))
            past = self._past.setdefault(name, AxisPast())
            found |= derived(name, time_s, found, None if target is None else target[whole], past)
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = np.where(steps_s > 0.0, bits[whole] / steps_s, np.nan)
        load = Signal(_BUS, SignalQuantity.BUS_LOAD, "kbit/s" if self._bitrate is None else "%")
        found[load] = rate * (1e-3 if self._bitrate is None else 100.0 / self._bitrate)
        found[Signal(_BUS, SignalQuantity.MISSES, "")] = missed[whole]
        found[Signal(_BUS, SignalQuantity.SYNC_DISTANCE, "ms")] = steps_s * 1e3
        known = set(self.signals)
        self.signals += [signal for signal in found if signal not in known]
        nothing = np.full(len(time_s), np.nan)
        return time_s, np.column_stack([found.get(signal, nothing) for signal in self.signals])

    def _events(self, heard: ReceivedFrames) -> list[HeardEvent]:
        """Emergencies and NMT states, in words; they are rare."""
        ids = heard["can_id"]
        base = ids & ~np.uint32(0x7F)
        is_emergency = (base == FunctionCode.EMERGENCY) & (ids != FunctionCode.SYNC)
        is_state = (base == FunctionCode.HEARTBEAT) & (heard["length"] == 1)
        found: list[HeardEvent] = []
        for one in heard[is_emergency | is_state | ((ids == 0) & (heard["length"] >= 2))]:
            time_s, node, data = int(one["stamp_ns"]) * 1e-9, int(one["can_id"]) & 0x7F, int(one["data"])
            if int(one["can_id"]) == 0:
                found += self._commanded(time_s, data & 0xFF, data >> 8 & 0xFF)
            elif int(one["can_id"]) & ~0x7F == FunctionCode.HEARTBEAT:
                self._operational[node] = data & 0x7F == NmtState.OPERATIONAL
            else:
                code = data & 0xFFFF
                found.append(
                    HeardEvent(time_s, "emcy", node, f"emergency {code:04X}h: {error_text(code, self._fault_texts.get(node))}")
                )
        return found

    def _gaps(self, time_s: Real) -> list[HeardEvent]:
        """Find stretches without SYNC, sent or received."""
        steps_s = np.diff(time_s)
        found = [
            HeardEvent(float(time_s[row]), "gap", 0, f"nothing heard for {1e3 * steps_s[row]:.3g} ms")
            for row in np.flatnonzero(steps_s > GAP_CYCLES * self._usual_s)
        ]
        if len(steps_s):
            self._usual_s = float(np.nanmedian([self._usual_s, *steps_s]))
        return found

    def _commanded(self, time_s: float, command: int, node: int) -> list[HeardEvent]:
        names = {int(each): each.name.lower().replace("_", " ") for each in NmtCommand}
        for number in [node] if node else list(self._overhearing.nodes):
            self._operational[number] = command == NmtCommand.START
        return [HeardEvent(time_s, "nmt", node, f"NMT: {names.get(command, f'{command:02X}h')}")]
