"""Estimated values with standard errors, and the error for insufficient data."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]


class UnidentifiableError(ValueError):
    """Error: the data are too few or too poor to identify anything.

    It names the fault, the amount of data and the amount needed.
    """

    def __init__(self, what: str, value: float, needed: float, unit: str = "") -> None:
        """Keep the numbers."""
        self.what, self.value, self.needed, self.unit = what, value, needed, unit
        super().__init__(f"{what}: {value:.4g}{' ' + unit if unit else ''}, needed {needed:.4g}{' ' + unit if unit else ''}")


@dataclass(frozen=True)
class EstimatedParameter:
    """Number with its standard error.

    The standard error is 0 only if nothing was estimated.
    """

    value: float
    standard_error: float

    @property
    def relative(self) -> float:
        """Standard error over value; infinite for a value of 0."""
        return self.standard_error / abs(self.value) if self.value else math.inf


def inverse(square: Real) -> Real:
    """Pseudo-inverse of JᵀJ for unknowns with very different units."""
    scale = np.sqrt(np.maximum(np.diag(square), 1e-300))
    return np.asarray(np.linalg.pinv(square / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale))


@dataclass(frozen=True)
class EstimatedMode:
    """Mode of an arm that has several, with the motor held.

    Attributes:
        inertia_kg_m2: Effective inertia about the joint.
        antiresonance_hz: Its frequency, where the motor's response has a dip.
        damping: Its damping ratio.
        resonance_hz: Peak of the motor's response above it.
        tip_part: Part of the tip's rigid motion that it carries; None without an accelerometer.
    """

    inertia_kg_m2: EstimatedParameter
    antiresonance_hz: EstimatedParameter
    damping: EstimatedParameter
    resonance_hz: EstimatedParameter
    tip_part: EstimatedParameter | None = None
