"""Expectation of a run from those before it.

With its conditions and its own standard error:

    x_i = μ + h_i·β + e_i,   β_j ~ N(0, (s_j a)²),   e_i ~ N(0, τ² + c² σ_i²)

with h_i the conditions (`hil.passport.conditions`), a the size of the measured quantity, σ_i its own standard error, c the factor
by which that is too small, or too large for differences between runs, and τ the scatter of runs beyond it and beyond their
conditions. Nothing is known of μ and τ (for τ Jeffreys' prior, p(τ²) ∝ (Σ_j (τ² + c² σ_j²)⁻²)^½: with σ = 0 it makes the
expectation Student's t), of c that it is one of a few factors, and of β that a condition does not change a number by several
times itself. For each τ and c of a grid the expectation of run i from the runs before it is a normal distribution, by recursive
least squares. Weighted with the likelihood of τ and c by those runs, they form its predictive distribution

    F_i(x) = Σ p(τ, c | x_1 … x_{i−1}) Φ((x − m_i(τ, c)) / f_i(τ, c)).

Φ⁻¹(F_i(x_i)) is a normal score, independent of those before it, as long as nothing but the conditions has changed, whether the
σ_i are equal or not (prequential: Dawid, J. R. Stat. Soc. A 147(2), 1984; the recursion: West and Harrison, Bayesian Forecasting
and Dynamic Models, 1997, section 4).
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from hil.control.arrays import Real
from hil.passport.conditions import Design

FEWEST_BEFORE = 5
"""Runs before one that is watched: with fewer nobody knows their scatter."""
GRID_DECADES = 2.0
"""How far τ is looked for below and above the scatter of the first runs."""
SCATTER_STEP = 0.2
"""Step of ln τ for a short series; a long one knows τ to 1/√(2n), and has it finer."""
FACTORS = {0.1: 0.1, 0.25: 0.15, 0.5: 0.15, 1.0: 0.3, 1.5: 0.2, 2.25: 0.1}
"""Factors c between standard errors and what runs scatter by, with their probabilities before anything is measured.

Below 1: an error may hold what is the same in every run (a direction, a lever, a shape of the arm), of which the differences of
runs show nothing. With 1 as the smallest, a gear whose errors were 5 %, and its runs alike to 0.6 %, had to wear by a fifth.
"""
VAGUE = 1e4
"""Standard deviation of μ before the first run, in units of their scatter: nothing is known of it."""
BOTTOM = 1e-9
"""Scatter of equal values without errors, over their size: that of numbers that were rounded."""
LARGEST_SCORE = 37.0


@dataclass(frozen=True, eq=False)
class Expected:
    """Expectation of each run.

    Shape (..., n, t) for values of shape (..., n) and t grid points of τ and c.

    Attributes:
        middle: m; NaN for runs with too few before them.
        spread: f.
        weight: Probability of each τ and c.
        effect: β of each column for each τ and c, after the last run; shape (..., t, p).
    """

    middle: Real
    spread: Real
    weight: Real
    effect: Real

    def scores(self, values: Real) -> Real:
        """Return normal scores of values, NaN for early runs; shape (..., n)."""
        off = (np.asarray(values, dtype=np.float64)[..., None] - self.middle) / self.spread
        sign = np.sign(np.sum(self.weight * off, axis=-1))
        tail = np.sum(self.weight * scipy.special.ndtr(-off * sign[..., None]), axis=-1)
        made: Real = sign * np.clip(-scipy.special.ndtri(np.maximum(tail, 1e-300)), -LARGEST_SCORE, LARGEST_SCORE)
        return made

    def limits(self, score: float) -> tuple[Real, Real]:
        """Return the values of scores ±`score`, by bisection; shapes (..., n)."""
        centre = np.sum(self.weight * self.middle, axis=-1)
        found = []
        for sign in (-1.0, 1.0):
            near, far = np.zeros_like(centre), np.max(np.nan_to_num(self.spread), axis=-1) * 2.0 * score
            for _ in range(60):
                at = 0.5 * (near + far)
                is_short = sign * self.scores(centre + sign * at) < score
                near, far = np.where(is_short, at, near), np.where(is_short, far, at)
            found.append(np.where(np.isfinite(centre), centre + sign * far, math.nan))
        return found[0], found[1]

    @property
    def effects(self) -> Real:
        """Expected β after the last run; shape (..., p)."""
        return np.asarray(np.sum(self.weight[..., -1, :, None] * self.effect, axis=-2))


def expected(values: Real, errors: Real, design: Design, size: float | None = None) -> Expected:
    """Expectation of each run from those before it.

    Values and their standard errors are in the order of their dates; shapes (..., n). All series have the same conditions;
    `size` is a, by default the mean size of the first values.
    """
    x, variance = np.asarray(values, dtype=np.float64), np.asarray(errors, dtype=np.float64) ** 2
    count, first = x.shape[-1], x[..., :FEWEST_BEFORE]
    zero = x[..., :1] if count else np.zeros((*x.shape[:-1], 1))
    a = np.mean(np.abs(first), axis=-1, keepdims=True) if size is None and count else np.full(zero.shape, size or 0.0)
    own = np.var(first, axis=-1, ddof=1, keepdims=True) if first.shape[-1] > 1 else np.zeros(zero.shape)
    mean = np.mean(variance[..., :FEWEST_BEFORE], axis=-1, keepdims=True) if count else zero
    scatter = np.sqrt(own + mean + (BOTTOM * np.maximum(np.abs(zero), a)) ** 2 + 1e-300)
    wide, step = GRID_DECADES * math.log(10.0), min(SCATTER_STEP, 1.0 / math.sqrt(max(1, count)))
    grid = np.exp(np.linspace(-wide, wide, 1 + 2 * math.ceil(wide / step)))
    tau2 = (scatter * np.tile(grid, len(FACTORS))) ** 2
    filter_ = _Filter(tau2, scatter, a, design)
    made = [filter_.step(x[..., i] - zero[..., 0], variance[..., i], i) for i in range(count)]
    middle, spread, weight = (np.stack([each[k] for each in made], axis=-2) if made else np.zeros((0, 1)) for k in range(3))
    middle[..., :FEWEST_BEFORE, :] = math.nan
    return Expected(middle + zero[..., None], spread, weight, filter_.m[..., 1:])


class _Filter:
    """Recursive least squares for all τ and c at once.

    Mean m and covariance s of (μ, β), and the likelihood of each τ and c.
    """

    def __init__(self, tau2: Real, scatter: Real, size: Real, design: Design) -> None:
        """Begin before the first run: shapes (..., t), (..., 1), (..., 1)."""
        self.tau2, self.size, self.design = tau2, size, design
        points = tau2.shape[-1] // len(FACTORS)
        self.factor2 = np.repeat(np.array(list(FACTORS)) ** 2, points)
        width = 1 + design.columns.shape[1]
        self.m = np.zeros((*tau2.shape, width))
        self.s = np.zeros((*tau2.shape, width, width))
        self.s[..., 0, 0] = (VAGUE * scatter) ** 2
        for j, fraction in enumerate(design.prior):
            self.s[..., 1 + j, 1 + j] = (fraction * size) ** 2
        self.log = np.zeros(tau2.shape) + np.repeat(np.log(list(FACTORS.values())), points)
        self.jeffreys = np.zeros(tau2.shape)

    def step(self, value: Real, variance: Real, i: int) -> tuple[Real, Real, Real]:
        """Predict run i, then learn it.

        Return mean, standard deviation and weights of its expectation. Values and variances have the shape (...).
        """
        h = np.concatenate(([1.0], self.design.columns[i]))
        below = self.tau2 + self.factor2 * variance[..., None] + (self.design.extra[i] * self.size) ** 2
        with np.errstate(divide="ignore"):
            log = self.log + 0.5 * np.log(self.jeffreys) + np.log(self.tau2) if i else np.zeros(self.log.shape)
        weight = np.exp(log - np.max(log, axis=-1, keepdims=True))
        weight /= np.sum(weight, axis=-1, keepdims=True)
        gain = self.s @ h
        spread2 = gain @ h + below
        middle = self.m @ h
        rest = value[..., None] - middle
        self.log = self.log - 0.5 * np.log(spread2) - 0.5 * rest**2 / spread2
        self.jeffreys = self.jeffreys + below**-2.0
        self.m = self.m + gain * (rest / spread2)[..., None]
        self.s = self.s - gain[..., :, None] * (gain / spread2[..., None])[..., None, :]
        return middle, np.sqrt(spread2), weight
