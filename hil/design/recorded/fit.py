"""Fit of A_k and φ_k to stretches of a recording.

The fit is made in the motor's angle.

Each stretch has a slow part of its own. Standard errors come from a block bootstrap: blocks of the residual are drawn
at random and fitted again, and the slow part's degree is chosen each time. So they include that choice and the correlation
of neighbouring samples.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hil.control.arrays import Real
from hil.design.order_map import TURNS
from hil.design.recorded.slow import DegreeChoice, degrees_for

REPEATS = 120
"""Accuracy: signals that are made of the blocks of a residual: standard errors come out to 6 %."""
DRAWN_BLOCK_TURNS = 1.0
"""Measured: revolutions in a block: on 300 recordings the rms of z is 0.97 to 1.04 (docs/recordings-method.md)."""


@dataclass(frozen=True)
class AngleSection:
    """One stretch for the fit.

    Attributes:
        angle_rad: Motor angle θ_m; shape (n,).
        signal: Signal, in rad of the joint or in the unit of a sensor; shape (n,).
        waves: Function of orders that gives the signal of A cos φ = 1 rad and of A sin φ = 1 rad for each; shape (n, 2·orders).
    """

    angle_rad: Real
    signal: Real
    waves: Callable[[Sequence[float]], Real]

    def averaged(self, most: int) -> "AngleSection":
        """Section with at most so many samples."""
        return self.averaged_by(-(-len(self.signal) // most))

    def averaged_by(self, few: int) -> "AngleSection":
        """Section with means of `few` neighbours each."""
        if few == 1:
            return self

        def mean(values: Real) -> Real:
            return np.asarray(np.add.reduceat(values, np.arange(0, len(values) - few + 1, few), axis=0) / few)

        whole = len(self.signal) // few * few
        waves = self.waves
        return AngleSection(mean(self.angle_rad[:whole]), mean(self.signal[:whole]), lambda orders: mean(waves(orders)[:whole]))

    @property
    def turns(self) -> float:
        """Revolutions of the motor."""
        return float(np.ptp(self.angle_rad)) / (2.0 * math.pi)


@dataclass(frozen=True)
class SectionFit:
    """Fit of one stretch.

    Attributes:
        unknowns: A cos φ and A sin φ of each in rad; shape (2·orders,).
        covariance: Their covariance; shape (2·orders, 2·orders).
        degree: Degree of the slow part.
        slow: Slow part of the signal; shape (n,).
        residual: What the fit leaves; shape (n,).
    """

    orders: tuple[float, ...]
    unknowns: Real
    covariance: Real
    degree: int
    slow: Real
    residual: Real


def waves_of_angle(angle_rad: Real) -> Callable[[Sequence[float]], Real]:
    """Waves of a signal that is the joint's angle itself.

    A cos(kθ + φ) = (A cos φ) cos kθ − (A sin φ) sin kθ
    """

    def waves(orders: Sequence[float]) -> Real:
        return np.column_stack([wave for k in orders for wave in (np.cos(k * angle_rad), -np.sin(k * angle_rad))])

    return waves


def least_turns(orders: Sequence[float]) -> float:
    """Least motor revolutions of a stretch that separates some orders.

    >>> least_turns((1, 2, 4))
    2.0
    """
    known = sorted(orders)
    gaps = [b - a for a, b in pairwise(known)]
    return TURNS / min([known[0], *gaps])


def fit_section(section: AngleSection, orders: Sequence[float], repeats: int = REPEATS, degree: int | None = None) -> SectionFit:
    """Fit one stretch.

    Args:
        repeats: Signals of blocks from which standard errors come; 0 for none.
        degree: Degree of the slow part; None to choose it.

    Raises:
        ValueError: The stretch is too short for the orders, or has too few samples.
    """
    orders = tuple(orders)
    waves = section.waves(orders)
    degrees = degrees_for(section.turns, min(orders)) if degree is None else (degree,)
    needed, enough = least_turns(orders), 3 * (max(degrees) + 1 + waves.shape[1])
    if section.turns < needed:
        raise ValueError(f"{section.turns:.2f} revolutions do not separate these orders; at least {needed:g} are needed")
    if len(section.signal) < enough:
        raise ValueError(f"{len(section.signal)} samples are too few for these orders; at least {enough} are needed")
    scale = float(np.std(section.signal)) or 1.0
    size = np.sqrt(np.mean(waves**2, axis=0)) + 1e-300
    choice = DegreeChoice(section.angle_rad, waves / size, degrees)
    signal = section.signal / scale
    degree = int(choice.degrees_of(signal[:, None])[0])
    solution = choice.solve(degree, signal[:, None])[:, 0]
    wave, slow = choice.parts(degree, solution)
    residual = signal - wave - slow
    if repeats == 0:
        nothing = np.zeros((2 * len(orders), 2 * len(orders)))
        return SectionFit(orders, solution[: choice.waves] * scale / size, nothing, degree, slow * scale, residual * scale)
    made = _bootstrapped(section.angle_rad, choice, wave + slow, residual, repeats)
    off = (made - solution[: choice.waves]) * scale / size
    covariance = off.T @ off / repeats
    return SectionFit(orders, solution[: choice.waves] * scale / size, covariance, degree, slow * scale, residual * scale)


def _bootstrapped(angle_rad: Real, choice: DegreeChoice, fitted: Real, residual: Real, repeats: int) -> Real:
    """Unknowns of the waves in resampled signals; shape (repeats, waves)."""
    random = np.random.default_rng(20_140_824)
    turns = float(np.ptp(angle_rad)) / (2.0 * math.pi)
    count = len(residual)
    block = max(1, min(count // 2, round(count * DRAWN_BLOCK_TURNS / turns)))
    pieces = -(-count // block)
    starts = random.integers(0, count, (repeats, pieces))
    signs = random.choice([-1.0, 1.0], (repeats, pieces))
    rows = (starts[:, :, None] + np.arange(block)) % count
    drawn = (residual[rows] * signs[:, :, None]).reshape(repeats, -1)[:, :count].T
    # what a fit has taken out of the neighbourhood of each order is put back: one of as many cells as there are revolutions
    signals = fitted[:, None] + drawn * math.sqrt(turns / max(turns - 1.0, 0.5))
    degrees = choice.degrees_of(signals)
    unknowns = np.empty((repeats, choice.waves))
    for degree in map(int, np.unique(degrees)):
        chosen = degrees == degree
        unknowns[chosen] = choice.solve(degree, signals[:, chosen])[: choice.waves].T
    return unknowns
