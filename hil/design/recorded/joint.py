"""Joint fit of all stretches of a recording."""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from hil.control.angles import ARCSEC
from hil.control.arrays import Real
from hil.design.recorded.fit import SectionFit

DRIFTS_BELOW = 0.001
"""Probability: of the differences of an order between stretches, were it the same in all, below which it has changed."""


@dataclass(frozen=True)
class RecordedValue:
    """One order of a transmission error.

    Attributes:
        phi_deg: Phase φ_k, from 0 to 360°.
        phi_error_deg: Standard error of φ_k; 180 at most.
    """

    a_arcsec: float
    phi_deg: float
    a_error_arcsec: float
    phi_error_deg: float


@dataclass(frozen=True)
class Change:
    """An order in several stretches against itself.

    Attributes:
        probability: Probability of the differences, were they noise alone.
        widened: Factor by which the standard errors were widened for them.
        phi_span_deg: Largest difference of two of its phases.
    """

    order: float
    probability: float
    widened: float
    phi_span_deg: float

    @property
    def is_seen(self) -> bool:
        """True if noise does not explain the differences."""
        return self.probability < DRIFTS_BELOW


@dataclass(frozen=True)
class JointFit:
    """Mean of several fits, and their differences.

    Attributes:
        changes: An order against itself, by order; empty for one fit.
    """

    values: dict[float, RecordedValue]
    changes: dict[float, Change]


def value_of(x: float, y: float, covariance: Real) -> RecordedValue:
    """Amplitude and phase of an order from its cosine and sine parts.

    A cos φ = x and A sin φ = y are in rad. The errors follow from the covariance of both, shape (2, 2).
    """
    size = math.hypot(x, y)
    along, across = np.array([x, y]) / max(size, 1e-30), np.array([-y, x]) / max(size, 1e-30)
    radial = math.sqrt(max(0.0, float(along @ covariance @ along)))
    tangential = math.sqrt(max(0.0, float(across @ covariance @ across)))
    turned = min(180.0, math.degrees(tangential / max(size, 1e-30)))
    return RecordedValue(size / ARCSEC, math.degrees(math.atan2(y, x)) % 360.0, radial / ARCSEC, turned)


def values_of(fit: SectionFit) -> dict[float, RecordedValue]:
    """Values of one stretch by order."""
    return {order: value_of(*_pair(fit, row)) for row, order in enumerate(fit.orders)}


def _pair(fit: SectionFit, row: int) -> tuple[float, float, Real]:
    inside = slice(2 * row, 2 * row + 2)
    x, y = map(float, fit.unknowns[inside])
    return x, y, fit.covariance[inside, inside]


def joined(fits: Sequence[SectionFit], moves: Sequence[Real] | None = None) -> JointFit:
    """Average some fits of the same orders, weighted by their covariances.

    The errors are widened if the fits differ by more than noise.

    Args:
        moves: Moves of the unknowns of each for every standard error that all have in common; shape (2·orders, errors).

    Raises:
        ValueError: There is no fit.
    """
    if not fits:
        raise ValueError("no stretch has been fitted; at least 1 is needed")
    values: dict[float, RecordedValue] = {}
    changes: dict[float, Change] = {}
    for row, order in enumerate(fits[0].orders):
        pairs = [_pair(fit, row) for fit in fits]
        weights = [np.linalg.pinv(covariance) for _, _, covariance in pairs]
        total = np.linalg.pinv(np.sum(weights, axis=0))
        vectors = [np.array([x, y]) for x, y, _ in pairs]
        mean = total @ np.sum([weight @ vector for weight, vector in zip(weights, vectors, strict=True)], axis=0)
        widened = 1.0
        if len(fits) > 1:
            off = sum(float((v - mean) @ weight @ (v - mean)) for v, weight in zip(vectors, weights, strict=True))
            freedom = 2 * (len(fits) - 1)
            widened = math.sqrt(max(1.0, off / freedom))
            changes[order] = Change(order, float(scipy.stats.chi2.sf(off, freedom)), widened, _span_deg(vectors))
        covariance = total * widened**2
        if moves is not None:
            inside = slice(2 * row, 2 * row + 2)
            move = total @ np.sum([weight @ each[inside] for weight, each in zip(weights, moves, strict=True)], axis=0)
            covariance = covariance + move @ move.T
        values[order] = value_of(float(mean[0]), float(mean[1]), covariance)
    return JointFit(values, changes)


def widened_by(whole: JointFit, parts: JointFit) -> JointFit:
    """Widen the standard errors of orders that change between parts.

    No single value holds for such an order.

    So it is where a motion passes the arm's resonance, of which the encoders see the arm's answer and not the gear's error.
    """
    values = {}
    for order, value in whole.values.items():
        change, widened = parts.changes.get(order), 1.0
        if change is not None and change.is_seen:
            between = whole.changes.get(order)
            widened = max(1.0, change.widened / (1.0 if between is None else between.widened))
        a_error, phi_error = widened * value.a_error_arcsec, min(180.0, widened * value.phi_error_deg)
        values[order] = replace(value, a_error_arcsec=a_error, phi_error_deg=phi_error)
    return replace(whole, values=values)


def _span_deg(vectors: Sequence[Real]) -> float:
    """Largest difference of two phases in degrees."""
    phases = [complex(float(v[0]), float(v[1])) for v in vectors]
    return max(abs(math.degrees(cmath.phase(a * b.conjugate()))) if a and b else 0.0 for a in phases for b in phases)
