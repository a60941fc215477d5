"""Conditions of a passport's runs as columns of a regression.

A condition counts from the first run that notes it, so that a run added later changes nothing of those before. A number enters
as a line with a slight curvature, so that the expectation far beyond all other runs is less certain; a place of the joint enters
as its first harmonic, which is that of any eccentricity. The prior standard deviation of an effect is half a number, or a
hundredth for a kelvin; a few runs outweigh it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.control.arrays import Real

Rows = NDArray[np.int64]

WARMTH = 0.01
"""Effect of a kelvin that is nothing special, as a fraction of an amplitude, or in rad of a phase."""
WARMTH_CURVATURE = 2e-4
EFFECT = 0.5
"""Effect of load, speed, direction and place that is nothing special, likewise."""
CURVATURE = 0.1
NOT_NOTED = 0.05
"""How far a run that does not note a condition, where one before it does, may be off for that, likewise."""
METHOD = 0.05
"""Difference between what is read from the torque and beside the motor's motion that is nothing special, likewise."""


@dataclass(frozen=True)
class RunCondition:
    """Conditions of a run; None if one is not known.

    Attributes:
        direction: +1 forwards, −1 backwards, 0 both together.
        joint_deg: Middle of the joint's way.
        is_torque: True if it was read from the motor's torque, which a wrong inertia biases.
    """

    temperature_c: float | None = None
    load_kg: float | None = None
    top_rps: float | None = None
    direction: int = 0
    joint_deg: float | None = None
    is_torque: bool = False


@dataclass(frozen=True, eq=False)
class Design:
    """Columns of a regression.

    Attributes:
        columns: h; shape (n, p), without those that are 0 in all runs.
        prior: Standard deviation of the effect of each column, over the size of what is measured; shape (p,).
        extra: What each run may be off by for conditions that it does not note, likewise; shape (n,).
        names: RunCondition of each column.
    """

    columns: Real
    prior: Real
    extra: Real
    names: tuple[str, ...]

    def effects(self, by_column: Real) -> dict[str, Real]:
        """Parts that each condition has added to each run; shape (n,)."""
        made: dict[str, Real] = {}
        for j, name in enumerate(self.names):
            made[name] = made.get(name, np.zeros(len(self.columns))) + by_column[j] * self.columns[:, j]
        return made

    def of(self, rows: Rows) -> "Design":
        """Some of the runs."""
        return Design(self.columns[rows], self.prior, self.extra[rows], self.names)


def no_design(count: int) -> Design:
    """Runs of which nothing is noted."""
    return Design(np.zeros((count, 0)), np.zeros(0), np.zeros(count), ())


def design_of(conditions: Sequence[RunCondition]) -> Design:
    """Columns for the conditions of runs, in the order of their dates."""
    columns: list[Real] = []
    prior: list[float] = []
    names: list[str] = []
    extra = np.zeros(len(conditions))

    def put(name: str, made: Real, sizes: Sequence[float]) -> None:
        for column, size in zip(made.T, sizes, strict=True):
            if np.any(column):
                columns.append(column)
                prior.append(size)
                names.append(name)

    numbers: dict[str, tuple[list[float | None], Callable[[Real], Real], tuple[float, ...]]] = {
        "temperature": ([each.temperature_c for each in conditions], _warmth, (WARMTH, WARMTH_CURVATURE)),
        "load": ([each.load_kg for each in conditions], _relative, (EFFECT, CURVATURE)),
        "speed": ([each.top_rps for each in conditions], _relative, (EFFECT, CURVATURE)),
        "method": ([float(each.is_torque) for each in conditions], lambda values: (values - values[:1])[:, None], (METHOD,)),
        "direction": ([float(each.direction) for each in conditions], lambda values: values[:, None], (EFFECT,)),
        "joint angle": ([each.joint_deg for each in conditions], _turn, (EFFECT, EFFECT)),
    }
    for name, (values, columns_of, sizes) in numbers.items():
        filled, missing = _filled(values)
        extra = np.hypot(extra, NOT_NOTED * missing)
        put(name, columns_of(filled), sizes)
    made = np.stack(columns, axis=1) if columns else np.zeros((len(conditions), 0))
    return Design(made, np.array(prior), extra, tuple(names))


def _filled(values: Sequence[float | None]) -> tuple[Real, Real]:
    """Fill missing values with the first known one.

    Return them, and 1 for each missing value after the first known one.
    """
    known = [value for value in values if value is not None]
    first = known[0] if known else 0.0
    is_late = np.cumsum([value is not None for value in values]) > 0
    missing = np.array([value is None for value in values], dtype=bool) & is_late
    return np.array([first if value is None else value for value in values], dtype=np.float64), missing.astype(np.float64)


def _warmth(values: Real) -> Real:
    off = values - values[:1]
    return np.stack([off, off**2], axis=1)


def _relative(values: Real) -> Real:
    """Return relative differences from the first value, and their squares.

    In units of that value, or of the first other one if it is 0.
    """
    other = values[values != 0.0]
    off = (values - values[:1]) / (abs(float(other[0])) if len(other) else 1.0)
    return np.stack([off, off**2], axis=1)


def _turn(values: Real) -> Real:
    angles = np.radians(values)
    return np.stack([np.cos(angles) - np.cos(angles[:1]), np.sin(angles) - np.sin(angles[:1])], axis=1)
