"""Probing: effects of many small settings on recorded rows.

From the effects follow the settings that bring the rows to zero.

The runs of a design set every unknown high in half of the runs and low in the others, each independently of the rest, so that
every run carries information on every unknown. The columns of the design are those of a Hadamard matrix: R. L. Plackett and
J. P. Burman, The design of optimum multifactorial experiments, Biometrika 33 (1946), 305 to 325; built after R. E. A. C.
Paley, On orthogonal matrices, J. Math. Phys. 12 (1933), 311 to 320. Runs at the level, with all settings at 0, are repeated:
their scatter is the noise.

With the rows y = y_0 + Σ c_j b_j of a run with settings c, the settings with the least residual are c = −(BᵀB)⁻¹ Bᵀ y_0. The
method separates three parts. Noise, known from the scatter of equal runs, enlarges BᵀB by trace(R) (XᵀX)⁻¹, which is
subtracted; a direction of the settings in which hardly more than that remains is not seen, and stays at 0. The part that no
setting explains is the motion's own content: it is the same in every run, so no repetition shows it, and it counts as a
disturbance with its own correlation from row to row. The effects b_j are known only as well as the noise allows.
"""

import math
from dataclasses import dataclass

import numpy as np

from hil.control.arrays import Real
from hil.design.estimation import ROUNDING

MOST_SETTINGS = 128
"""Bound: settings of a design: two of each of 64 orders, more than all axes of an arm have."""
LEAST_SEEN = 1.7
"""Probability: power of what a direction of the settings does, over that of noise: a tenth of what is seen may be noise."""
BY_TURNS = 3
"""Accuracy: times that settings and the disturbance that they leave are found by turns: 2 change 0.002, and 6 change 1e-4."""
LEAST_FREEDOM = 2.0
"""Accuracy: independent samples of a fit, over its unknowns u, at least: n/(n − u), by which its variance grows, is 2 at most."""


def balanced_signs(settings: int) -> Real:
    """Signs of a design with independent settings; shape (runs, settings).

    >>> signs = balanced_signs(11)
    >>> signs.shape, bool((signs.T @ signs == 12 * np.eye(11)).all()), signs.sum(axis=0).tolist()
    ((12, 11), True, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])

    If there are as many settings as runs, the last one is high in all of them; repeated runs at the level show its effect.

    Raises:
        ValueError: There is none, or more than `MOST_SETTINGS`.
    """
    if not 1 <= settings <= MOST_SETTINGS:
        raise ValueError(f"a design of {settings} settings; expected 1 to {MOST_SETTINGS}")
    runs = 4 * math.ceil(settings / 4)
    while (matrix := _hadamard(runs)) is None:
        runs += 4
    return np.roll(matrix, -1, axis=1)[:, :settings]


def _hadamard(size: int) -> Real | None:
    """Build a Hadamard matrix whose first column is 1.

    Returns None for a size that neither primes nor doubling reach.
    """
    if size == 1:
        return np.ones((1, 1))
    prime = size - 1
    if prime % 4 == 3 and all(prime % divisor for divisor in range(2, math.isqrt(prime) + 1)):
        squares = {number * number % prime for number in range(1, prime)}
        first = np.array([-1.0, *(1.0 if number in squares else -1.0 for number in range(1, prime))])
        matrix = np.ones((size, size))
        matrix[0, 1:] = -1.0
        for row in range(prime):
            matrix[row + 1, 1:] = -np.roll(first, row)
        return matrix
    half = _hadamard(size // 2) if size % 2 == 0 else None
    return None if half is None else np.block([[half, half], [half, -half]])


@dataclass(frozen=True)
class Effects:
    """Level and effects, as runs with known settings show them.

    Attributes:
        level: Rows with all settings at 0; shape (directions, rows).
        effects: What a unit of each setting adds; shape (settings, directions, rows).
        inverse: (XᵀX)⁻¹ of the design, the level's row first; shape (settings + 1, settings + 1).
        noise: Autocovariance of what equal runs differ by, by lag in rows; shape (directions, rows).
    """

    level: Real
    effects: Real
    inverse: Real
    noise: Real

    @property
    def independent(self) -> float:
        """Number of independent samples of one run's noise, all directions together."""
        return sum(_independent(each[np.newaxis]) for each in self.noise)

    @property
    def noise_rms(self) -> float:
        """Root mean square of one run's noise, all directions together."""
        return math.sqrt(float(np.sum(self.noise[:, 0])))


@dataclass(frozen=True)
class RunScatter:
    """Difference of equal runs.

    Attributes:
        rms: Root mean square of one run's noise, all directions together.
        independent: Number of independent samples in it.
    """

    rms: float
    independent: float

    def power_error(self, rms: float) -> float:
        """Standard error of a run's mean square `rms`²."""
        return math.sqrt((4.0 * rms**2 * self.rms**2 + 2.0 * self.rms**4) / self.independent)


def scatter_of(rows: Real) -> RunScatter:
    """Difference of equal runs.

    Args:
        rows: What each run has shown; shape (runs, directions, rows).

    Raises:
        ValueError: There is one run only.
    """
    if len(rows) < 2:
        raise ValueError("one run shows no scatter; at least 2 equal runs are needed")
    noise = np.sum(autocovariance(rows - np.mean(rows, axis=0)), axis=0) / (len(rows) - 1)
    return RunScatter(math.sqrt(float(np.sum(noise[:, 0]))), max(_independent(noise), 1.0))


def effects_of(settings: Real, rows: Real) -> Effects:
    """Fit level and effects to all runs by least squares.

    Args:
        settings: Settings of each run, repeated runs at the level included; shape (runs, settings).
        rows: What each run has shown; shape (runs, directions, rows).

    Raises:
        ValueError: The runs do not separate the settings, or leave no freedom for the noise.
    """
    unknowns = np.concatenate([np.ones((len(settings), 1)), settings], axis=1)
    freedom = len(unknowns) - unknowns.shape[1]
    if np.linalg.matrix_rank(unknowns) < unknowns.shape[1] or freedom < 1:
        raise ValueError(
            f"{len(unknowns)} runs cannot separate {settings.shape[1]} settings and the noise; add runs without a setting"
        )
    inverse = np.linalg.inv(unknowns.T @ unknowns)
    solved = np.tensordot(inverse @ unknowns.T, rows, axes=1)
    left = rows - np.tensordot(unknowns, solved, axes=1)
    return Effects(solved[0], solved[1:], inverse, np.sum(autocovariance(left), axis=0) / freedom)


def autocovariance(values: Real) -> Real:
    """Autocovariance around 0 by lag, along the last axis.

    1/n Σ x(t) x(t + lag), shape of `values`
    """
    count = values.shape[-1]
    power = np.abs(np.fft.rfft(values, 2 * count, axis=-1)) ** 2
    return np.asarray(np.fft.irfft(power, 2 * count, axis=-1)[..., :count] / count)


@dataclass(frozen=True)
class ProbedStep:
    """Settings to be added, so that least of the rows is left.

    Attributes:
        settings: The settings; 0 in directions that are not seen; shape (settings,).
        covariance: Their covariance, in the directions that are seen; shape (settings, settings).
        seen: Fraction of each setting that is seen, 0 to 1; shape (settings,).
        left: What of the rows no setting explains; shape (directions, rows).
        directions: Number of directions of the settings that are seen.
    """

    settings: Real
    covariance: Real
    seen: Real
    left: Real
    directions: int

    @property
    def left_rms(self) -> float:
        """Root mean square of `left`, all directions together."""
        return math.sqrt(float(np.mean(np.sum(self.left**2, axis=0))))


def step_to_nothing(found: Effects, level: Real | None = None, spread: float | Real | None = None) -> ProbedStep:
    """Compute the settings that bring the rows to zero.

    Directions of the settings that are not seen stay at 0. The standard errors cover noise and disturbance.

    In the directions v of the settings that are seen, c = V a, D = Vᵀ(BᵀB less noise)V, and M is the covariance of z = Vᵀ
    Bᵀ y_0 by noise and disturbance: a = −D⁻¹ z. If the settings have a prior covariance P, the likeliest settings are c =
    P Lᵀ (L P Lᵀ + D⁻¹ M D⁻¹)⁻¹ a with a = L c, so that settings that are hardly seen stay near 0. M follows from the
    residual; both are found by turns.

    Args:
        found: What the runs have shown.
        level: Rows from which the settings are to lead away, of a run that is none of those; None: those at the level.
        spread: Root mean square of each setting before anything is known, or the covariance of all, shape (settings, settings);
            None: anything is as likely.

    Raises:
        ValueError: The residual has too few independent samples for so many settings.
    """
    rows = found.level if level is None else level
    noise_power = found.noise.shape[1] * float(np.sum(found.noise[:, 0]))
    flat, power = found.effects.reshape(len(found.effects), -1), _products(found.effects, found.effects)
    floor = noise_power * found.inverse[1:, 1:] + ROUNDING * np.trace(power) / len(power) * np.eye(len(power))
    wanted = flat @ rows.ravel() - (noise_power * found.inverse[1:, 0] if level is None else 0.0)
    whitening = np.linalg.inv(np.linalg.cholesky(floor))
    over_noise, turned = np.linalg.eigh(whitening @ power @ whitening.T)
    is_seen = over_noise >= LEAST_SEEN
    axes, gains = (whitening.T @ turned)[:, is_seen], over_noise[is_seen] - 1.0
    along = np.diag(1.0 / gains)
    read, shows = -along @ axes.T @ wanted, axes.T @ floor  # a, and L
    settings = axes @ read
    before = None if spread is None else np.asarray(spread) if np.ndim(spread) else np.square(spread) * np.eye(len(power))
    for _ in range(1 if before is None else BY_TURNS):
        left = rows + np.tensordot(settings, found.effects, axes=1)
        doubt = along @ axes.T @ _doubt(found, left, len(gains), is_free=before is None) @ axes @ along
        if before is None:
            covariance = axes @ doubt @ axes.T
        else:
            gain = before @ shows.T @ np.linalg.inv(shows @ before @ shows.T + doubt)
            settings, covariance = gain @ read, before - gain @ shows @ before
    left = rows + np.tensordot(settings, found.effects, axes=1)
    return ProbedStep(settings, 0.5 * (covariance + covariance.T), np.diag(axes @ axes.T @ floor), left, axes.shape[1])


def _doubt(found: Effects, left: Real, unknowns: int, *, is_free: bool) -> Real:
    """Covariance of residual and noise in Bᵀ y_0.

    Noise in the effects is included; shape (settings, settings).
    """
    correlation = autocovariance(left)
    spread = np.array([_correlated(each, correlation) for each in found.effects])
    if not is_free:  # settings that are hardly seen stay near 0, and fit nothing
        unknowns = min(unknowns, int(_independent(correlation) / LEAST_FREEDOM))
    middle = _products(spread, found.effects) * _inflation(correlation, unknowns)
    noise = sum(float(each @ _toeplitz(each, noise)) for each, noise in zip(left, found.noise, strict=True))
    return np.asarray(middle + noise * found.inverse[1:, 1:])


def _products(first: Real, second: Real) -> Real:
    return first.reshape(len(first), -1) @ second.reshape(len(second), -1).T


def _correlated(values: Real, correlation: Real) -> Real:
    """Multiply the rows of each direction by a disturbance's covariance.

    Shape (directions, rows).
    """
    return np.stack([_toeplitz(each, one) for each, one in zip(values, correlation, strict=True)])


def _toeplitz(values: Real, by_lag: Real) -> Real:
    """Multiply a covariance, given by its lags, by a column; shape (rows,)."""
    count = len(values)
    circle = np.concatenate([by_lag, [0.0], by_lag[:0:-1]])
    made = np.fft.irfft(np.fft.rfft(circle) * np.fft.rfft(values, 2 * count), 2 * count)
    return np.asarray(made[:count])


def _independent(correlation: Real) -> float:
    """Number of independent samples in correlated rows, (tr R)²/tr R²; or 0."""
    count = correlation.shape[1]
    weights = 2.0 * (count - np.arange(count))
    weights[0] = count
    squares = float(np.sum(weights * np.sum(correlation**2, axis=0)))
    return 0.0 if squares == 0.0 else (count * float(np.sum(correlation[:, 0]))) ** 2 / squares


def _inflation(correlation: Real, unknowns: int) -> float:
    """Ratio of the disturbance's power to that of the residual.

    The fit of `unknowns` unknowns takes a part of the disturbance away.
    """
    independent = _independent(correlation)
    if independent == 0.0:
        return 1.0
    if independent < LEAST_FREEDOM * unknowns:
        raise ValueError(
            f"{independent:.0f} independent samples for {unknowns} unknowns, at least "
            f"{LEAST_FREEDOM * unknowns:.0f} are needed: the motion is too short, or its band too narrow, for so "
            "many orders"
        )
    return independent / (independent - unknowns)
