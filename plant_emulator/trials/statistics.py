"""Statistics of rows: fractions with their interval, and percentiles."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

CONFIDENCE = 0.95
SHOWN_PERCENT = (5, 50, 95)


@dataclass(frozen=True)
class RunFraction:
    """A fraction of the runs with Wilson's 95 % score interval."""

    count: int
    runs: int
    share: float
    low: float
    high: float


def run_fraction(count: int, runs: int) -> RunFraction:
    """Return a fraction of the runs and its Wilson interval."""
    interval = scipy.stats.binomtest(count, runs).proportion_ci(CONFIDENCE, "wilson")
    return RunFraction(count, runs, count / runs, float(interval.low), float(interval.high))


def fraction_text(count: int, whole: int) -> str:
    """Return a fraction with its interval as text.

    >>> fraction_text(95, 100), fraction_text(300, 300), fraction_text(0, 0)
    ('95 of 100, 95 % (89–98)', '300 of 300, 100 % (99–100)', '0 of 0')
    """
    if not whole:
        return "0 of 0"
    found = run_fraction(count, whole)
    low, high = (float(f"{100.0 * end:.2g}") for end in (found.low, found.high))  # 100, not 1e+02
    return f"{count} of {whole}, {100.0 * found.share:.3g} % ({low:g}–{high:g})"


def percentiles(values: Sequence[float] | NDArray[np.float64], percents: Iterable[int] = SHOWN_PERCENT) -> dict[int, float]:
    """Return percentiles, each of which is one trial's own: between infinity and a number there is nothing."""
    found = np.asarray(values, np.float64)
    return {percent: float(np.percentile(found, percent, method="nearest")) for percent in percents}
