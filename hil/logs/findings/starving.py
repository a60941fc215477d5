"""Findings on SYNC, and on answers that frames of higher priority delay.

SYNC has gaps, jitter, or a second sender. The answers are late in the cycles in which those frames come first.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from drive_profiles.standard.cia301 import FunctionCode
from hil.counting import counted
from hil.logs.findings.finding import Finding, Said, Severity, Untold, picture_of, stamps_of
from hil.logs.trace import FEW_FRACTION, LEAST_FRAMES, Trace

HELD_UP, HELD_UP_NS = 0.1, 200_000.0
"""Fraction of the period, and ns, by which an answer is behind its usual place in a cycle in which it was held up."""
MORE = 1.5
"""Frames of one identifier that come more in such cycles than usual, from which on it is the one that holds up."""
MOST_CYCLES = 400_000
"""Cycles that are looked at: an hour is the same from minute to minute."""


def starving_findings(trace: Trace) -> Iterator[Said]:
    """Answers that wait for frames of higher priority."""
    cycles = trace.cycles
    if cycles is None:
        return
    sync = cycles.stamp_ns[:MOST_CYCLES]
    for node in trace.nodes.values():
        for pdo in node.pdos:
            stream = trace.of(pdo)
            rhythm = trace.rhythm(stream) if pdo.direction == "tpdo" else None
            if rhythm is None:
                continue
            late = np.flatnonzero(rhythm.late_ns > max(HELD_UP * cycles.period_ns, HELD_UP_NS))
            late = late[rhythm.cycle[late] < len(sync) - 1]
            if len(late) < max(LEAST_FRAMES // 2, FEW_FRACTION * min(len(rhythm.cycle), len(sync))):
                continue
            held_up = np.unique(rhythm.cycle[late])
            culprit, more = _culprit(trace, sync, pdo.can_id, held_up)
            if culprit is None:
                continue
            yield Finding(
                "starved", Severity.WARNING,
                f"{pdo.name} comes up to {np.max(rhythm.late_ns[late]) * 1e-6:.3g} ms late in {counted(len(late), 'cycle')}, "
                f"in which {culprit:03X}h is sent {more:.1f} times more than usual; its priority is higher, "
                f"and {pdo.can_id:03X}h waits",
                f"spread the frames of {culprit:03X}h (inhibit time, fewer at once), give it an identifier above "
                f"{pdo.can_id:03X}h, or raise the bit rate",
                stamps_of(stream.stamp_ns, late), len(late), node.number,
                picture_of(stream.stamp_ns * 1e-9, rhythm.late_ns * 1e-6, ("time [s]", f"{pdo.name}: off its place by [ms]")),
            )  # fmt: skip


def _culprit(trace: Trace, sync: NDArray[np.int64], own: int, held_up: NDArray[np.int32]) -> tuple[int | None, float]:
    """Find the identifier that is more frequent in late cycles.

    It has a higher priority; the second value is the difference in frames per cycle. SYNC stamps have the shape (n,), cycles in
    which `own` was held up (m,).
    """
    worst: int | None = None
    most = MORE
    others = np.ones(len(sync), bool)
    others[held_up] = False
    for can_id, stream in trace.log.streams.items():
        if can_id >= own or can_id in {FunctionCode.SYNC} or not len(stream):
            continue
        cycle = np.searchsorted(sync, stream.stamp_ns, side="right") - 1
        counts = np.bincount(cycle[(cycle >= 0) & (cycle < len(sync) - 1)], minlength=len(sync))
        more = float(np.mean(counts[held_up]) - np.mean(counts[others])) if np.any(others) else 0.0
        if more > most:
            worst, most = can_id, more
    return worst, most


GAP = 1.5
"""Periods between two SYNCs from which on one is missing."""
TOO_CLOSE = 0.5
"""Periods between two SYNCs below which one of them is too many."""
JITTER = 0.2
"""Fraction of the period by which a SYNC may be off its beat: a set-point is reached that much too early or late."""
UNEVEN_FRACTION = 0.001
"""Fraction of SYNCs that may be so: a desktop is late now and then."""


def sync_findings(trace: Trace) -> Iterator[Said]:
    """Gaps, doubles and jitter of SYNC."""
    cycles = trace.cycles
    if cycles is None:
        yield Untold("sync", f"{len(trace.sync)} SYNCs: too few to compare set-points and answers with them")
        return
    period, gaps = cycles.period_ns, np.diff(cycles.stamp_ns) / cycles.period_ns
    time_s = cycles.stamp_ns[1:] * 1e-9
    drawn = picture_of(
        time_s, gaps * period * 1e-6, ("time [s]", "interval between SYNCs [ms]"), (("one is missing", GAP * period * 1e-6),)
    )
    missing = np.flatnonzero(gaps > GAP)
    if len(missing):
        lost = int(np.sum(np.round(gaps[missing]) - 1))
        yield Finding(
            "sync-missing", Severity.FAULT,
            f"{lost} SYNCs are missing in {counted(len(missing), 'gap')}, the longest {np.max(gaps) * period * 1e-6:.3g} ms; "
            f"they otherwise come every {period * 1e-6:.4g} ms",
            "the sender of SYNC paused; give it real-time priority, fewer other programs, or a longer period",
            stamps_of(cycles.stamp_ns, missing), len(missing), None, drawn,
        )  # fmt: skip
    close = np.flatnonzero(gaps < TOO_CLOSE)
    if len(close) > UNEVEN_FRACTION * len(gaps) and len(close) >= len(missing) + 2:
        yield Finding(
            "sync-doubled", Severity.FAULT,
            f"{len(close)} SYNCs come less than {TOO_CLOSE * period * 1e-6:.3g} ms after the one before: two nodes send them",
            "let only one node send SYNC: bit 30 of 1005h is 0 in all others",
            stamps_of(cycles.stamp_ns, close), len(close), None, drawn,
        )  # fmt: skip
    rough = (gaps > 1.0 + JITTER) & (gaps <= GAP) | (gaps >= TOO_CLOSE) & (gaps < 1.0 - JITTER)
    uneven = np.flatnonzero(rough)
    if len(uneven) > max(UNEVEN_FRACTION * len(gaps), 2):
        yield Finding(
            "sync-jitter", Severity.WARNING,
            f"{len(uneven)} of {len(gaps)} SYNCs are off by more than {100 * JITTER:.0f} % of {period * 1e-6:.4g} ms; "
            f"99 of 100 lie within {np.percentile(np.abs(gaps - 1.0), 99) * period * 1e-6:.3g} ms",
            "set-points are reached too early or too late by the same time; give the sender real-time priority, or let a "
            "drive send SYNC",
            stamps_of(cycles.stamp_ns, uneven), len(uneven), None, drawn,
        )  # fmt: skip
