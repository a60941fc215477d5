"""Trial of a cancellation that follows.

It follows only if the tip is quieter with it.

In the runs with the cancellation alone the observer runs too, and shows the largest d_k by which it would have moved w_k. If
w_k stays 1 in the runs in which it may follow, both kinds of run are the same. If w_k moves, the tip has to be quieter in
some window, beyond the noise, and louder in none, by its acceleration and by its displacement. If it is not, d_k comes from
the motion itself: jolts, friction, or an arm that differs a little from the identified one. Then an order begins to follow
only from a multiple of that d_k on, so that it does not move on this motion unless the gear changes.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.analysis import TipScale, integrated_twice
from hil.bench.bench import Bench
from hil.control.following import FollowingSettings
from hil.core.library import CORE
from hil.design.estimation import SIGMAS
from hil.experiments.cancellation.alternation import Alternation
from hil.experiments.decision import MOST_RUNS
from hil.experiments.peaks import PeakChange
from hil.recording import Recording
from hil.reporter import SILENT, Reporter
from hil.results.following import FollowingBegin, FollowingEntry, FollowingPeak

LOUDER_MM = 0.001
"""Measured: harmless rise of the tip's peak: none of 13 robots was louder by more (docs/cancellation-following.md)."""
LITTLE = 0.05
"""Measured with `LOUDER_MM`: part of the largest fall up to which a rise that may be noise is taken for noise."""
MOST_BEGIN = 0.6
"""Bound: part of an order, |d|, above which an order that begins there would follow nothing that a gear does: 35°."""
TITLES = ("trial of the cancellation that follows: w_k fixed", "trial of the cancellation that follows: w_k adapts")

BeginParts = Mapping[tuple[int, float], float]
"""Part of each order, by axis and order, from which on it is followed."""


@dataclass(frozen=True)
class HeardOrder:
    """Observation of an order in a run.

    Attributes:
        left: Largest |d| by which w moved, or would have moved.
    """

    axis: int
    order: float
    left: float
    has_moved: bool


@dataclass(frozen=True)
class FollowRun:
    """Run of the trial.

    Attributes:
        watched: What the observer saw of each order.
    """

    recording: Recording
    watched: Sequence[HeardOrder]


def try_following(
    bench: Bench, scale: TipScale, run: Callable[[bool], FollowRun], reporter: Reporter = SILENT
) -> tuple[FollowingEntry, BeginParts]:
    """Try a cancellation that follows.

    Returns the entry, and the part of each order from which it is to follow.

    Raises:
        NotPossibleError: The motion does not excite the arm.
        HilError: As the runs.
    """
    seen: dict[bool, list[Sequence[HeardOrder]]] = {False: [], True: []}

    def one(follows: bool) -> Recording:
        made = run(follows)
        seen[follows].append(made.watched)
        return made.recording

    runs = Alternation(bench, scale, one, TITLES, reporter)
    changes: list[PeakChange] = []
    helps = is_louder = False
    while runs.count < MOST_RUNS:
        runs.once_more()
        changes = _changes(runs, scale)
        if not any(each.has_moved for watched in seen[True] for each in watched):
            begins = _begin_parts(seen[False] + seen[True])
            return _entry(changes, begins=begins), begins
        helps, is_louder = any(each.falls.holds for each in changes), _is_louder(changes)
        if runs.count > 1 and (not helps or not any(_rise_mm(each) > 0.0 for each in changes)):
            break
    if helps and not is_louder:
        moved = {(each.axis, each.order) for watched in seen[True] for each in watched if each.has_moved}
        begins = {key: 0.0 if key in moved else begin for key, begin in _begin_parts(seen[True]).items()}
        return _entry(changes, begins=begins), begins
    begins = _begin_parts(seen[False])
    worst = max(changes, key=lambda each: each.after_mm - each.before_mm)
    why = worst.words if is_louder else "the tip's peak does not fall in any window"
    if min(begins.values()) > MOST_BEGIN:
        return _entry(changes, f"the cancellation does not follow; in the trial of following, {why}"), begins
    return _entry(changes, begins=begins), begins


def _changes(runs: Alternation, scale: TipScale) -> list[PeakChange]:
    """Changes of the peaks by acceleration, everywhere and in the orders' rows, and displacement."""
    low, high = scale.band_hz

    def displaced(band: NDArray[np.float64]) -> NDArray[np.float64]:
        return 1e3 * integrated_twice(band, runs.period_s, low)

    # white noise between the band's ends, each frequency of it over (2π f)²
    inverse = (low**-3 - high**-3) / (3.0 * (high - low) * math.tau**4)
    return runs.seen() + runs.everywhere() + runs.everywhere(displaced, 1e3 * runs.noise_m_s2 * math.sqrt(inverse))


def _rise_mm(change: PeakChange) -> float:
    """Rise of a peak by more than is harmless."""
    return change.after_mm - change.before_mm - LOUDER_MM


def _is_louder(changes: Sequence[PeakChange]) -> bool:
    """True if a peak rises beyond noise or `LITTLE` times the fall."""
    gained = max(change.before_mm - change.after_mm for change in changes)
    return any(_rise_mm(each) > min(SIGMAS * each.error_mm, LITTLE * max(gained, 0.0)) for each in changes)


def _begin_parts(runs: Sequence[Sequence[HeardOrder]]) -> dict[tuple[int, float], float]:
    """Remainder of each order, above that of these runs, from which it follows."""
    found: dict[tuple[int, float], float] = {}
    for each in (each for watched in runs for each in watched):
        key = each.axis, each.order
        found[key] = max(found.get(key, 0.0), CORE.constants["BEGIN_MARGIN"] * each.left)
    return found


def _entry(changes: Sequence[PeakChange], words: str = "", begins: BeginParts | None = None) -> FollowingEntry:
    peaks = tuple(
        FollowingPeak(order=each.order, alone_mm=each.before_mm, following_mm=each.after_mm, error_mm=each.error_mm)
        for each in changes
    )
    least = FollowingSettings().begin_part
    held = tuple(
        FollowingBegin(axis=axis, order=order, part=part) for (axis, order), part in (begins or {}).items() if part > least
    )
    return FollowingEntry(is_used=not words, peaks=peaks, words=words, begins=held)
