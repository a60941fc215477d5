"""Trial of designed filters on the robot.

The motion runs without the filters and with them before the filters are used.

A filter is designed on a model. On an axis that differs a little from it an order may rise, most of all if the gear is no
spring. Every order of the gear is judged, at the speeds at which it meets f_al. Filters that raise the tip's peak in any
window are not used, nor are filters that lower it in none. Runs are repeated until every rise exceeds the sensor's noise or
is excluded by it; if the largest number of runs does not decide, a rise that is still too probable counts as one. An order
whose resonance the ramp does not pass is not judged: the peak there by switching the filter counts only above the motion's
own largest peak.

A filter turns the waves of the orders, which add to each other and to the jolt of the motion's start; whether the peak of a
window rises thus depends on the motor angle at which the motion starts, and users start anywhere. So runs are compared from
several angles, those of a pair from the same one with the arm at rest, and the worst of them counts. Their spread tells
what to expect from another angle: filters are refused too if a rise there has, by Student's t distribution, a probability of
`RISK` or more.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np
import scipy

from hil.analysis import TipScale, order_window_rps
from hil.bench.bench import Bench
from hil.design.modes.ring_down import modes_of
from hil.design.notch_problem import WORSE_FRACTION, WORSE_MM
from hil.errors import NotPossibleError
from hil.experiments.cancellation.alternation import Alternation
from hil.experiments.decision import MOST_RUNS, Decision
from hil.experiments.judge import shown_rps
from hil.experiments.peaks import PeakChange
from hil.experiments.shaping import rates_of
from hil.master.motion import Motion
from hil.recording import Recording
from hil.reporter import SILENT, Reporter
from hil.results.runs import FilterTrial, FilterTrialPeak
from hil.robot_tables import ORDERS


def with_orders(scale: TipScale, orders: Collection[float]) -> TipScale:
    """Add windows of other orders to the scale of an axis."""
    more = {k: order_window_rps(scale.f_al_hz, k) for k in orders if k not in scale.windows_rps}
    return replace(scale, windows_rps={**scale.windows_rps, **more}) if scale.windows_rps else scale


def start_angles_rad() -> tuple[float, ...]:
    """Motor angles at which trials of filters start, from where the axis stands.

    From one to the next the wave of the highest order turns by a whole period and a quarter of one, so that those of lower
    orders turn as well.

    >>> [round(math.degrees(each), 1) for each in start_angles_rad()]
    [0.0, 112.5, 225.0, 337.5]
    """
    return tuple(math.tau * 1.25 * number / max(ORDERS) for number in range(4))


def starting_at(motion: Motion, start_rad: float, stands_rad: float) -> Motion:
    """Motion of one axis that starts at an angle, wherever the axis stands."""
    return replace(motion, motor_angle_rad=motion.motor_angle_rad + (start_rad - stands_rad))


def at_rest(bench: Bench, axes: Collection[int]) -> Bench:
    """Bench on which runs wait until the brake's release rings no more."""
    settle_s = bench.settle_s
    for axis in axes:
        try:
            modes = modes_of(rates_of(bench, axis, None))
        except NotPossibleError:
            continue
        decays = [math.tau * mode.frequency_hz * mode.damping for mode in modes]
        settle_s = max([settle_s, *(math.log(1.0 / WORSE_FRACTION) / decay for decay in decays if decay > 0.0)])
    return bench.model_copy(update={"settle_s": settle_s})


def try_filters(
    bench: Bench,
    scale: TipScale,
    runs: Sequence[Callable[[bool], Recording]],
    orders: Collection[float] = (),
    reporter: Reporter = SILENT,
) -> FilterTrial:
    """Try filters until every rise is seen or excluded.

    Each round runs the motion without the filters and with them.

    Args:
        runs: For each angle at which the motion starts, what runs it, with the filters or without.
        orders: Orders that the gear of a single axis is known to have, beside those of the scale.

    Raises:
        NotPossibleError: The motion does not excite the arm.
        HilError: As the runs.
    """
    scale = with_orders(scale, orders)
    judged = scale.orders_met(shown_rps(bench)) if scale.windows_rps else ()
    changes: list[PeakChange] = []
    peaks: list[PeakChange] = []
    count = 0
    for number, run in enumerate(runs, start=1):
        where = f", start {number} of {len(runs)}" if len(runs) > 1 else ""
        titles = (f"trial of the filters: untreated{where}", f"trial of the filters: with them{where}")
        here, is_decided = Alternation(bench, scale, run, titles, reporter), False
        while not is_decided and here.count < MOST_RUNS:
            here.once_more()
            seen = here.seen()
            counted = _that_count(seen, judged)
            falls = any(peak.falls.holds for peak in (*peaks, *counted))
            is_decided = counted[0].rises.holds or (counted[0].rises.fails and falls)
        count, changes, peaks = count + here.count, changes + seen, peaks + counted
        if counted[0].rises.is_risky:
            break
    return _entry(_worst_first(peaks), _worst_first(changes), count)


def _worst_first(changes: Sequence[PeakChange]) -> list[PeakChange]:
    return sorted(changes, key=lambda each: (-each.rises.probability, -each.beyond_mm))


def _that_count(changes: list[PeakChange], judged: Collection[float]) -> list[PeakChange]:
    """Select the changes that decide on the filters."""
    largest_mm = max(change.before_mm for change in changes)
    found = [change for change in changes if change.order in judged or change.after_mm > largest_mm]
    return found if any(change.order in judged for change in found) else changes


def _window(change: PeakChange) -> float:
    """Order of a window, 0 for that of a motion without any."""
    return change.order or 0.0


def rises_elsewhere(changes: Sequence[PeakChange]) -> Decision:
    """Claim that a window's peak rises from another angle, by its changes from those that were tried.

    The mean x̄ and the spread s of n changes give a further one the distribution x̄ + s √(1 + 1/n) t of n − 1 degrees of freedom.
    """
    beyond, count = [each.beyond_mm for each in changes], len(changes)
    if count < 2:
        return Decision(0.0)
    spread = max(float(np.std(beyond, ddof=1)) * math.sqrt(1.0 + 1.0 / count), np.finfo(float).tiny)
    return Decision(float(scipy.stats.t.sf(-np.mean(beyond) / spread, count - 1)))


def _entry(peaks: list[PeakChange], changes: list[PeakChange], runs: int) -> FilterTrial:
    worst, best, end = peaks[0], min(peaks, key=lambda each: each.beyond_mm), "; the motion is run without them"
    by_window = [list(group) for _, group in groupby(sorted(peaks, key=_window), key=_window)]
    open_window = max(by_window, key=lambda each: rises_elsewhere(each).probability)
    elsewhere, words = rises_elsewhere(open_window), ""
    if worst.rises.is_likely:
        words = f"the filters are refused: with them {worst.words}{end}"
    elif worst.rises.is_risky:
        rise = f"a rise by more than {worst.harmless_mm:.4f} mm has a probability of {100.0 * worst.rises.probability:.0f} %"
        words = f"the filters are refused: with them {worst.words}, and {rise}{end}"
    elif elsewhere.is_risky:
        changed = sorted(100.0 * (each.after_mm / max(each.before_mm, WORSE_MM) - 1.0) for each in open_window)
        where, harmless_mm = _window(open_window[0]), open_window[0].harmless_mm
        words = (
            f"the filters are refused: the tip's peak in the window of order {where:g} changes by {changed[0]:+.0f} to "
            f"{changed[-1]:+.0f} % with the motor angle at which the motion starts; from another one a rise by more than "
            f"{harmless_mm:.4f} mm has a probability of {100.0 * elsewhere.probability:.0f} %{end}"
        )
    elif not any(peak.falls.is_likely for peak in peaks):
        words = f"the filters are refused: they do not lower the tip's peak in any window; at best it {best.change}{end}"
    worst_of = {peak.order: peak for peak in reversed(changes)}
    entries = tuple(
        FilterTrialPeak(order=peak.order, before_mm=peak.before_mm, after_mm=peak.after_mm, error_mm=peak.error_mm)
        for peak in changes
        if peak is worst_of[peak.order]
    )
    return FilterTrial(is_good=not words, runs=runs, peaks=entries, words=words)
