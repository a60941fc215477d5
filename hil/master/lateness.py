"""Schedule of a run by absolute deadlines, with late cycles dropped; statistics."""

import math
from bisect import bisect_left
from dataclasses import dataclass, field
from typing import Any

from hil.can.bits import frame_bits
from hil.can.frame import CAN_ERR_FLAG, Frame
from hil.master.realtime import Clock, Measure

PER_DECADE = 100
_DECADES = 9
_EDGES: tuple[float, ...] = tuple(1e-7 * 10.0 ** (i / PER_DECADE) for i in range(_DECADES * PER_DECADE + 1))
"""Edges of the bins from 100 ns to 100 s; a bin reaches from one edge, without it, to the next."""
_COARSE = PER_DECADE // 2


class Histogram:
    """Durations in bins of equal ratio.

    A run of any length takes the same memory. A percentile is never below the exact one, which is the smallest value that
    at least this fraction of all values does not exceed. From 100 ns to 100 s it exceeds the exact one by no more than
    `RELATIVE_ERROR`; below, by no more than 100 ns; beyond, it is the largest value. The largest value is exact.
    """

    RELATIVE_ERROR = 10.0 ** (1.0 / PER_DECADE) - 1.0
    """Ratio of two edges less 1: 2.4 %."""

    def __init__(self) -> None:
        self.count = 0
        self.largest_s = 0.0
        self._bins = [0] * (len(_EDGES) + 1)

    def add(self, value_s: float) -> None:
        """Count a duration; a negative one is 0."""
        self._bins[bisect_left(_EDGES, value_s)] += 1
        self.count += 1
        self.largest_s = max(self.largest_s, value_s)

    def percentile(self, fraction: float) -> float | None:
        """Return the quantile of a fraction (0 to 1), None without values."""
        if not self.count:
            return None
        rank = max(1, math.ceil(round(fraction * self.count, 6)))
        seen = 0
        for edge, number in zip(_EDGES, self._bins, strict=False):
            seen += number
            if seen >= rank:
                return min(edge, self.largest_s)
        return self.largest_s

    def bars(self) -> list[tuple[float, int]]:
        """Return bars, two per decade: upper edge and number."""
        bars = [(_EDGES[0], self._bins[0])]
        for begin in range(1, len(_EDGES), _COARSE):
            end = begin + _COARSE - 1
            bars.append((_EDGES[end], sum(self._bins[begin : end + 1])))
        bars.append((math.inf, self._bins[-1]))
        filled = [row for row, (_, number) in enumerate(bars) if number]
        return bars[filled[0] : filled[-1] + 1] if filled else []


@dataclass
class CycleSchedule:
    """Absolute deadlines of a run's cycles, with lateness statistics.

    Deadline n is t_0 + n T, so that a late cycle does not delay the next one. A cycle that is later than `limit_s` is dropped:
    its set-points belong to an instant that has passed, and the next cycle has newer ones.

    Attributes:
        limit_s: Largest lateness at which a cycle is still sent.
        cycles: Number of cycles so far, the dropped ones included.
        dropped: Number of dropped cycles, those that passed unseen included.
        late: Number of SYNCs that left beyond the limit, although they were in time at the last check.
        overdue: Number of cycles in a row, up to now, that were not sent.
        is_stopping: True while a command to stop is sent, which is never too late.
    """

    clock: Clock
    period_s: float
    limit_s: float
    lateness: Histogram = field(default_factory=Histogram)
    arrivals: Histogram = field(default_factory=Histogram)
    cycles: int = 0
    dropped: int = 0
    late: int = 0
    overdue: int = 0
    is_stopping: bool = False
    bits: int = 0
    _in_a_row: int = 0
    _number: int = 0
    _origin_s: float = 0.0
    _began_s: float = 0.0
    _sync_s: float | None = None
    _frames: list[Frame] = field(default_factory=list)

    @property
    def deadline_s(self) -> float:
        """Deadline of this cycle."""
        return self._origin_s + self._number * self.period_s

    @property
    def end_s(self) -> float:
        """Deadline of the next cycle, the end of this one."""
        return self._origin_s + (self._number + 1) * self.period_s

    def wait(self) -> None:
        """Sleep until the next deadline, which may have passed."""
        now = self.clock.now()
        if not self.cycles:
            self._origin_s = self._began_s = now
        else:
            self._number += 1
        if self.is_stopping and now >= self.end_s:  # the cycles that have passed are lost, and the stop is sent at once
            self.lateness.add(now - self.deadline_s)
            passed = int((now - self.deadline_s) / self.period_s)
            self.dropped, self.cycles = self.dropped + passed, self.cycles + passed
            self._origin_s, self._number = now, 0
        self.cycles += 1
        self.clock.sleep_until(self.deadline_s)

    def gives_up(self) -> bool:
        """True if this cycle is too late, and is counted as dropped."""
        late = self.clock.now() - self.deadline_s
        if late <= self.limit_s or self.is_stopping:
            return False
        self.lateness.add(late)
        self.dropped += 1
        self._in_a_row += 1
        self.overdue = self._in_a_row + int(late / self.period_s)
        self._sync_s = None
        return True

    def missing_now(self) -> int:
        """Return the number of unsent cycles in a row until now."""
        behind = self.clock.now() - self.end_s if self.cycles else 0.0
        return self._in_a_row + 1 + int(behind / self.period_s) if behind > self.limit_s else self.overdue

    def sync_left(self) -> float:
        """Note that SYNC has been sent; return the time."""
        self._sync_s = self.clock.now()
        late = self._sync_s - self.deadline_s
        self.lateness.add(late)
        self.late += late > self.limit_s
        self.overdue = self._in_a_row = 0
        return self._sync_s

    def answered(self) -> None:
        """Note that an answer has been taken in."""
        if self._sync_s is not None:
            self.arrivals.add(self.clock.now() - self._sync_s)

    def saw(self, frame: Frame) -> None:
        """Keep a frame that was sent or received for `count_bits`."""
        self._frames.append(frame)

    def count_bits(self) -> None:
        """Count the bits of the kept frames, between the cycles."""
        for frame in self._frames:
            if frame.can_id & CAN_ERR_FLAG:
                continue
            try:
                self.bits += frame_bits(frame)
            except ValueError:
                continue  # an adapter's own idea of a frame
        self._frames.clear()

    @property
    def duration_s(self) -> float:
        """Time from the first cycle to now."""
        return self.clock.now() - self._began_s if self.cycles else 0.0


@dataclass(frozen=True)
class Percentiles:
    """Percentiles of a histogram in s, and its bars.

    Attributes:
        p50_s: 50 % of the values are not above it; None without values.
        histogram: Upper edge in s (None beyond the last) and number of each bar.
    """

    count: int
    p50_s: float | None
    p99_s: float | None
    p999_s: float | None
    max_s: float | None
    histogram: list[tuple[float | None, int]]

    @classmethod
    def of(cls, values: Histogram) -> "Percentiles":
        """The percentiles of a histogram for a result."""
        p50, p99, p999, largest = (_rounded(values.percentile(fraction)) for fraction in (0.5, 0.99, 0.999, 1.0))
        bars = [(_rounded(edge) if math.isfinite(edge) else None, number) for edge, number in values.bars()]
        return cls(values.count, p50, p99, p999, largest, bars)


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")


@dataclass(frozen=True)
class WallClockTiming:
    """Timing of a run on the wall clock, over all cycles.

    Attributes:
        limit_s: Lateness beyond which a cycle is not sent.
        cycles: Number of cycles, the dropped ones included.
        dropped: Cycles whose set-points and SYNC were not sent, since it was too late for them.
        late: Cycles whose SYNC left beyond the limit all the same.
        missed: Cycles that were sent and in which an answer did not come.
        lateness: Time from the deadline to the SYNC, or to the decision to drop the cycle.
        arrivals: Time from SYNC to the reading of an answer.
        bus_bits: Bits of all frames that the master saw and sent, stuff bits and intermission included.
        duration_s: Time over which the bits were counted.
        bitrate: Bit rate of the bus, or None if it is not known.
        bus_load: Fraction of the bus' time that the frames took, or None.
        receive_overflows: Frames lost for want of room in the channel, or None if that is not known.
        measures: Requests to the operating system and their outcome.
    """

    period_s: float
    limit_s: float
    cycles: int
    dropped: int
    late: int
    missed: int
    lateness: Percentiles
    arrivals: Percentiles
    bus_bits: int
    duration_s: float
    bitrate: int | None
    bus_load: float | None
    receive_overflows: int | None
    measures: tuple[Measure, ...]

    @classmethod
    def of(
        cls,
        schedule: CycleSchedule,
        missed: int,
        bitrate: int | None,
        receive_overflows: int | None,
        measures: tuple[Measure, ...],
    ) -> "WallClockTiming":
        """The timing of a run that has come to its end."""
        duration = schedule.duration_s
        return cls(
            period_s=schedule.period_s,
            limit_s=schedule.limit_s,
            cycles=schedule.cycles,
            dropped=schedule.dropped,
            late=schedule.late,
            missed=missed,
            lateness=Percentiles.of(schedule.lateness),
            arrivals=Percentiles.of(schedule.arrivals),
            bus_bits=schedule.bits,
            duration_s=round(duration, 6),
            bitrate=bitrate,
            bus_load=round(schedule.bits / (bitrate * duration), 4) if bitrate and duration > 0.0 else None,
            receive_overflows=receive_overflows,
            measures=measures,
        )


def timing_lines(timing: dict[str, Any]) -> list[str]:
    """A `timing` of result.json as text."""
    period = timing["period_s"]
    lines = [
        f"timing at {1e3 * period:g} ms: {timing['cycles']} cycles, {timing['dropped']} dropped, {timing['late']} late, "
        f"{timing['missed']} with an answer missing",
        f"  {'':<22}{'p50':>10}{'p99':>10}{'p99.9':>10}{'max':>10}",
    ]
    for key, label in (("lateness", "SYNC after deadline"), ("arrivals", "answers after SYNC")):
        spread = timing[key]
        cells = "".join(f"{duration_text(spread[name]):>10}" for name in ("p50_s", "p99_s", "p999_s", "max_s"))
        lines.append(f"  {label:<22}{cells}")
    load = "" if timing["bus_load"] is None else f"bus load {100.0 * timing['bus_load']:.1f} % of {timing['bitrate']:,} bit/s; "
    lost = timing["receive_overflows"]
    lines.append(f"  {load}frames lost on reception: {'not known' if lost is None else lost}")
    lines += [f"  not granted: {m['name']}: {m['detail']}" for m in timing["measures"] if not m["is_granted"]]
    return lines


def duration_text(value_s: float | None) -> str:
    """A duration in the unit that suits it."""
    if value_s is None:
        return "-"
    for unit, factor in (("s", 1.0), ("ms", 1e3), ("µs", 1e6)):
        if value_s * factor >= 1.0 or unit == "µs":
            return f"{value_s * factor:.3g} {unit}"
    return ""
