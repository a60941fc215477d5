"""Statistics of a rehearsal's rows: deviations in standard errors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plant_emulator.rehearsal.record import QUANTITIES
from plant_emulator.trials.rows import Row, number

FAR_Z = 4.0
"""Standard errors beyond which a deviation is not chance."""


@dataclass(frozen=True)
class QuantityStatistics:
    """Estimates of one quantity against the truth.

    Attributes:
        count: Robots of which estimate, truth and standard error are known.
        median_off: Median of the deviation: of the true value as a fraction, of an angle in degrees.
        rms_z: Root mean square of the deviations in standard errors.
        mean_z: Mean of the deviations in standard errors, which is the bias.
        far: Deviations of more than `FAR_Z` standard errors.
        worst_z: The largest of them, with its sign.
    """

    name: str
    count: int
    median_off: float | None
    median_error: float
    rms_z: float
    mean_z: float
    far: int
    worst_z: float
    worst_seed: int


def deviations(rows: Sequence[Row], name: str) -> list[tuple[int, float]]:
    """Return seeds and z of a quantity."""
    found = ((row["seed"], number(row, f"{name}_z")) for row in rows)
    return [(seed, z) for seed, z in found if z is not None and isinstance(seed, int)]


def quantities(rows: Sequence[Row], names: Sequence[str] = QUANTITIES) -> list[QuantityStatistics]:
    """Return the statistics of each quantity of any robot."""
    found = []
    for name in names:
        pairs = deviations(rows, name)
        if not pairs:
            continue
        z = np.array([each for _, each in pairs])
        worst = int(np.argmax(np.abs(z)))
        found.append(
            QuantityStatistics(
                name=name,
                count=len(z),
                median_off=_median_off(rows, name),
                median_error=_median_error(rows, name),
                rms_z=float(np.sqrt(np.mean(z**2))),
                mean_z=float(np.mean(z)),
                far=int(np.sum(np.abs(z) > FAR_Z)),
                worst_z=float(z[worst]),
                worst_seed=pairs[worst][0],
            )
        )
    return found


def _median_off(rows: Sequence[Row], name: str) -> float | None:
    """Return the median deviation, without its sign."""
    is_angle = name.endswith("_deg")
    off = []
    for row in rows:
        true, estimate = number(row, f"{name}_true"), number(row, f"{name}_estimate")
        if true is None or estimate is None:
            continue
        if is_angle:
            off.append(abs(math.remainder(estimate - true, 360.0)))
        elif true:
            off.append(abs(estimate / true - 1.0))
    return float(np.median(off)) if off else None


def _median_error(rows: Sequence[Row], name: str) -> float:
    """Return the median standard error of the robots with a deviation."""
    found = [number(row, f"{name}_error") for row in rows if number(row, f"{name}_z") is not None]
    return float(np.median([each for each in found if each is not None]))
