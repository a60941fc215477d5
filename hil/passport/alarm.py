"""Alarms on a change of a repeated measurement, with a false-alarm rate.

The expected value of each run follows from the runs before it, with its conditions and its own standard error
(`hil.passport.regression`). The deviation is a normal score w, independent of all others as long as nothing but the conditions
has changed. Two tests share the rate r of each series in halves:

- a jump: |w_i| beyond the quantile of r/2, both sides together;
- a creep: the cumulative sums C⁺ = max(0, C⁺ + w − k) and C⁻ likewise (CUSUM: Page, Biometrika 41, 1954) beyond h, from the mean
  number of runs to a false alarm of each side, (e^{2kb} − 2kb − 1)/(2k²), b = h + 1.166 (Siegmund, Sequential Analysis, 1985).

An alarm remains from its first run on: later runs are not a history of the same gear.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from hil.control.arrays import Real
from hil.passport.conditions import Design, no_design
from hil.passport.regression import FEWEST_BEFORE, expected

REFERENCE = 0.5
"""k of the cumulative sums: half of the change in standard deviations that is found quickest."""
RESERVE = 0.6
"""Part of the rate that is used: the mean number of runs to a false alarm is an approximation, as the grid of τ and c is."""
OVERSHOOT = 1.166
"""Mean by which a sum of normal scores jumps beyond its limit, both ends together."""


@dataclass(frozen=True)
class AlarmLimits:
    """Limits of both tests.

    Attributes:
        rate: False alarms in one run, of all series together.
        jump: Largest |w|.
        creep: Largest cumulative sum h.
    """

    rate: float
    jump: float
    creep: float

    @classmethod
    def of(cls, rate: float, series: int) -> "AlarmLimits":
        """Return the limits for a rate of false alarms.

        Each of the series has its part of the rate.

        Raises:
            ValueError: No rate, or no series.
        """
        if not 0.0 < rate < 0.1 or series < 1:
            raise ValueError(
                f"{rate} false alarms in a run of {series} series; expected a rate above 0 and below 0.1, and at least 1 series"
            )
        part = RESERVE * 0.5 * rate / series
        jump = -float(scipy.special.ndtri(0.5 * part))

        def missing(h: float) -> float:
            b = 2.0 * REFERENCE * (h + OVERSHOOT)
            return (math.exp(b) - b - 1.0) / (2.0 * REFERENCE**2) - 2.0 / part

        return cls(rate, jump, float(scipy.optimize.brentq(missing, 0.0, 60.0)))


@dataclass(frozen=True, eq=False)
class Watched:
    """A series with its scores.

    Attributes:
        score: w of each run; NaN for the first, which have too few before them.
        creep: Larger of both cumulative sums after each run.
        low: Value below which each run would have been a jump; NaN as above.
        high: Value above which it would.
        first: Index of the run with the first alarm; None without one.
        expected: Expectation of the last run from the runs before the alarm, under its conditions; their mean if they are few.
        scatter: Standard deviation of those runs, their conditions taken out.
        explained: Fraction of their variance that each condition explains, beyond what chance would.
    """

    score: Real
    creep: Real
    low: Real
    high: Real
    first: int | None
    expected: float
    scatter: float
    explained: dict[str, float]


def watched(
    values: Real, errors: Real, limits: AlarmLimits, design: Design | None = None, size: float | None = None
) -> Watched:  # fmt: skip
    """Compare a series with its own past.

    Values and their standard errors, 0 for an unknown one, are in the order of their dates; shapes (n,). Without a design
    nothing is noted of the runs; `size` is that of what is measured, by default of the first values: conditions change a part
    of it.
    """
    x, own = np.asarray(values, dtype=np.float64), filled(errors)
    known = no_design(len(x)) if design is None else design
    found = expected(x, own, known, size)
    score = found.scores(x)
    creep = cumulative(score)
    beyond = np.flatnonzero((np.abs(np.nan_to_num(score)) > limits.jump) | (creep > limits.creep))
    first = int(beyond[0]) if len(beyond) else None
    before = x[:first]
    rest, explained = _without_conditions(before, own[:first], known.of(np.arange(len(before))), size)
    scatter = float(np.std(rest, ddof=1)) if len(rest) > 1 else math.nan
    mean = float(np.mean(before)) if len(before) else math.nan
    return Watched(score, creep, *found.limits(limits.jump), first, _last(x, own, known, first, size, mean), scatter, explained)


def _last(x: Real, own: Real, design: Design, first: int | None, size: float | None, mean: float) -> float:
    """Expected value of the last run.

    `first` is the index of the first alarm; `mean` is the expectation if there are few runs before.
    """
    rows = np.append(np.arange(len(x) - 1 if first is None else first), len(x) - 1)
    if len(rows) <= FEWEST_BEFORE:
        return mean
    found = expected(x[rows], own[rows], design.of(rows), size)
    return float(np.sum(found.weight[-1] * found.middle[-1]))


def _without_conditions(x: Real, own: Real, design: Design, size: float | None) -> tuple[Real, dict[str, float]]:
    """Return values without conditions' effects, and the fraction that each explains."""
    whole = float(np.var(x)) if len(x) else 0.0
    if not design.names or len(x) <= FEWEST_BEFORE or whole == 0.0:
        return x, {}
    effects = design.effects(expected(x, own, design, size).effects)
    explained = {}
    for name, effect in effects.items():
        free = len(x) - 1 - design.names.count(name)
        left = float(np.var(x - effect)) / whole * (len(x) - 1) / max(free, 1)
        if left < 1.0:
            explained[name] = 1.0 - left
    return np.asarray(x - sum(effects.values())), explained


def filled(errors: Real) -> Real:
    """Fill unknown standard errors (0) with the mean before; shape (n,)."""
    own = np.asarray(errors, dtype=np.float64)
    is_known = own > 0.0
    mean = np.cumsum(own) / np.maximum(1, np.cumsum(is_known))
    return np.where(is_known, own, mean)


def cumulative(score: Real) -> Real:
    """Return the larger cumulative sum after each run; shape (..., n)."""
    known = np.nan_to_num(score)
    up, down, made = np.zeros(known.shape[:-1]), np.zeros(known.shape[:-1]), np.zeros(known.shape)
    for i in range(FEWEST_BEFORE, known.shape[-1]):
        up = np.maximum(0.0, up + known[..., i] - REFERENCE)
        down = np.maximum(0.0, down - known[..., i] - REFERENCE)
        made[..., i] = np.maximum(up, down)
    return made


def unwound_deg(phases_deg: Real) -> Real:
    """Unwrap phases about the mean direction of the first runs.

    None of them then jumps by a turn; shape (n,).
    """
    angles = np.radians(np.asarray(phases_deg, dtype=np.float64))
    middle = np.angle(np.mean(np.exp(1j * angles[:FEWEST_BEFORE]))) % (2.0 * math.pi) if len(angles) else 0.0
    return np.asarray(np.degrees(middle + np.angle(np.exp(1j * (angles - middle)))))
