"""Estimated values with standard errors, and the error for insufficient data."""

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from hil.control.arrays import Real

PROBABILITY = 0.975
"""Probability: from which a claim counts as true."""
SIGMAS = NormalDist().inv_cdf(PROBABILITY)
"""The same as standard errors by which an estimate must meet the claim."""
FAR_SIGMAS = 3.0
"""Probability: standard errors from which a difference is hardly chance: one of 370 is so large by chance."""
SURE_SIGMAS = 4.0
"""Probability: the same for what every run checks several times: one of 16 000 is so large, so good runs hardly ever stop."""
SEEN_SIGMAS = 5.0
"""Probability: standard errors of an amplitude from which it is measured: to 20 %."""
SEARCHED_SIGMAS = 8.0
"""Probability: the same of the largest of many, or of a model that was searched for: noise reaches it in none of 10⁶ samples."""
DIFFERENCE_STEP = np.finfo(np.float64).eps ** (1.0 / 3.0)
"""Step of a central difference, 6e-6, at which rounding and curvature err alike."""
ROUNDING = math.sqrt(np.finfo(np.float64).eps)
"""Relative size, 1.5e-8, below which what is left of a difference or a product of matrices is rounding."""
EVALUATIONS = 100
"""Accuracy: evaluations of a fit from one start: a factor of 2 changes 0.003."""


class UnidentifiableError(ValueError):
    """Error: the data are too few or too poor to identify anything."""

    def __init__(self, what: str, value: float, needed: float, unit: str = "") -> None:
        """Keep the numbers."""
        self.what, self.value, self.needed, self.unit = what, value, needed, unit
        super().__init__(f"{what}: {value:.4g}{' ' + unit if unit else ''}, needed {needed:.4g}{' ' + unit if unit else ''}")


@dataclass(frozen=True)
class EstimatedParameter:
    """Number with its standard error."""

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
        antiresonance_hz: Its frequency, where the motor's response has a dip.
        resonance_hz: Peak of the motor's response above it.
        tip_part: Part of the tip's rigid motion that it carries; None without an accelerometer.
    """

    inertia_kg_m2: EstimatedParameter
    antiresonance_hz: EstimatedParameter
    damping: EstimatedParameter
    resonance_hz: EstimatedParameter
    tip_part: EstimatedParameter | None = None
