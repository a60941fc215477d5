"""Trial of designed filters on the robot.

The motion runs without the filters and with them before the filters are used.

A filter is designed on a model. On an axis that differs a little from it an order may rise, most of all if the gear is no
spring. Every order of the gear is judged, at the speeds at which it meets f_al. Filters that raise the tip's peak in any
window are not used, nor are filters that lower it in none. Runs are repeated until every rise exceeds the sensor's noise or
is excluded by it; if the largest number of runs does not decide, a rise that is still too probable counts as one. An order
whose resonance the ramp does not pass is not judged: the peak there by switching the filter counts only above the motion's
own largest peak.
"""

from collections.abc import Callable, Collection
from dataclasses import replace

from hil.analysis import TipScale, order_window_rps
from hil.bench.bench import Bench
from hil.experiments.cancellation.alternation import Alternation
from hil.experiments.decision import MOST_RUNS
from hil.experiments.judge import shown_rps
from hil.experiments.peaks import PeakChange
from hil.recording import Recording
from hil.reporter import SILENT, Reporter
from hil.results.runs import FilterTrial, FilterTrialPeak


def with_orders(scale: TipScale, orders: Collection[float]) -> TipScale:
    """Add windows of other orders to the scale of an axis."""
    more = {k: order_window_rps(scale.f_al_hz, k) for k in orders if k not in scale.windows_rps}
    return replace(scale, windows_rps={**scale.windows_rps, **more}) if scale.windows_rps else scale


def try_filters(
    bench: Bench, scale: TipScale, run: Callable[[bool], Recording], orders: Collection[float] = (), reporter: Reporter = SILENT
) -> FilterTrial:
    """Try filters until every rise is seen or excluded.

    Each round runs the motion without the filters and with them.

    Args:
        bench: The bench file.
        scale: Scale of the axes that move.
        run: Runs the motion, with the filters or without.
        orders: Orders that the gear of a single axis is known to have, beside those of the scale.
        reporter: Listener of each run.

    Raises:
        NotPossibleError: The motion does not excite the arm.
        HilError: As the runs.
    """
    scale = with_orders(scale, orders)
    runs = Alternation(bench, scale, run, ("trial of the filters: untreated", "trial of the filters: with them"), reporter)
    changes: list[PeakChange] = []
    peaks: list[PeakChange] = []
    while runs.count < MOST_RUNS:
        runs.once_more()
        changes = runs.seen()
        peaks = _that_count(changes, scale.orders_met(shown_rps(bench)) if scale.windows_rps else ())
        if peaks[0].rises.holds or (peaks[0].rises.fails and any(peak.falls.holds for peak in peaks)):
            break
    return _entry(peaks, changes, runs.count)


def _that_count(changes: list[PeakChange], judged: Collection[float]) -> list[PeakChange]:
    """Select the changes that decide on the filters.

    These are the judged windows, and others in which the tip exceeds the largest peak without the filters.
    """
    largest_mm = max(change.before_mm for change in changes)
    found = [change for change in changes if change.order in judged or change.after_mm > largest_mm]
    return found if any(change.order in judged for change in found) else changes


def _entry(peaks: list[PeakChange], changes: list[PeakChange], runs: int) -> FilterTrial:
    worst, best, end = peaks[0], peaks[-1], "; the motion is run without them"
    words = ""
    if worst.rises.is_likely:
        words = f"the filters are refused: with them {worst.words}{end}"
    elif worst.rises.is_risky:
        rise = f"a rise by more than {worst.harmless_mm:.4f} mm has a probability of {100.0 * worst.rises.probability:.0f} %"
        words = f"the filters are refused: with them {worst.words}, and {rise}{end}"
    elif not any(peak.falls.is_likely for peak in peaks):
        words = f"the filters are refused: they do not lower the tip's peak in any window; at best it {best.change}{end}"
    entries = tuple(
        FilterTrialPeak(order=peak.order, before_mm=peak.before_mm, after_mm=peak.after_mm, error_mm=peak.error_mm)
        for peak in changes
    )
    return FilterTrial(is_good=not words, runs=runs, peaks=entries, words=words)
