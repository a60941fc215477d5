"""Findings on SYNC: gaps, jitter, and a second sender."""

from collections.abc import Iterator

import numpy as np

from hil.counting import counted
from hil.logs.findings.finding import Finding, Said, Severity, Untold, picture_of, stamps_of
from hil.logs.trace import Trace

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
