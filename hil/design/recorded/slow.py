"""Slow part of a recorded signal.

It is a polynomial in the angle, whose degree is chosen by cross-validation on blocks.
"""

import math
from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.control.arrays import Real

MOST_DEGREE = 24
"""Accuracy: highest degree that is tried: a factor of 2 changes nothing in two recordings."""
LEFT_OUT_TURNS = 0.5
"""Measured: revolutions that are left out in one piece: on 300 recordings the rms of z is about 1 (docs/recordings-method.md)."""
FOLDS = 5
"""Accuracy: parts of the cross-validation that chooses the degree: a factor of 2 changes errors of two recordings by 9 %."""
WAVES_BELOW = 1.2
"""Accuracy: highest degree by the lowest order's waves; one of degree d swings d/2 times: errors of two recordings to 0.7 %."""


def slow_columns(angle_rad: Real, degree: int) -> Real:
    """Chebyshev polynomials over an angle's range; shape (n, degree + 1)."""
    low, high = float(np.min(angle_rad)), float(np.max(angle_rad))
    scaled = (2.0 * angle_rad - low - high) / max(high - low, 1e-12)
    return np.asarray(np.polynomial.chebyshev.chebvander(np.clip(scaled, -1.0, 1.0), degree))


def degrees_for(turns: float, lowest_order: float) -> tuple[int, ...]:
    """List the degrees to choose from.

    None is so high that the polynomial could pass for the lowest order.

    >>> degrees_for(6.9, 1)
    (1, 2, 4, 6, 8)
    """
    most = max(1, min(MOST_DEGREE, int(WAVES_BELOW * turns * lowest_order)))
    return tuple(degree for degree in (1, 2, 4, 6, 8, 10, 12, 16, 20, 24) if degree <= most)


def fold_of(angle_rad: Real) -> NDArray[np.intp]:
    """Fold of each row, in blocks of the angle; shape (n,)."""
    turned = np.abs(angle_rad - angle_rad[0]) / (2.0 * math.pi)
    block = max(LEFT_OUT_TURNS, float(np.max(turned)) / 200.0)
    return np.asarray((turned / block).astype(np.intp) % FOLDS)


class DegreeChoice:
    """Choice of the degree for any signals of one stretch.

    One orthogonal basis serves all degrees: the waves come first, then the slow columns, degree by degree.
    """

    def __init__(self, angle_rad: Real, waves: Real, degrees: Sequence[int]) -> None:
        """Prepare the folds.

        Args:
            angle_rad: Motor angle; shape (n,).
            waves: Columns that are fitted beside the slow part; shape (n, m).
            degrees: Degrees among which is chosen.
        """
        self.degrees = tuple(degrees)
        self.waves = waves.shape[1]
        self._design = np.hstack([waves, slow_columns(angle_rad, max(self.degrees))])
        self._basis, self._triangle = np.linalg.qr(self._design)
        fold = fold_of(angle_rad)
        self._folds = [fold == each for each in range(FOLDS) if np.any(fold == each)]
        self._grams = [self._basis[rows].T @ self._basis[rows] for rows in self._folds]

    def missed(self, signals: Real) -> Real:
        """Mean square of each degree's error on the left-out blocks.

        Shape (degrees, signals).
        """
        whole = self._basis.T @ signals
        total = np.zeros((len(self.degrees), signals.shape[1]))
        for rows, gram in zip(self._folds, self._grams, strict=True):
            own = self._basis[rows].T @ signals[rows]
            power = np.sum(signals[rows] ** 2, axis=0)
            for row, degree in enumerate(self.degrees):
                m = self.waves + degree + 1
                unknowns = np.linalg.solve(np.eye(m) * (1.0 + 1e-9) - gram[:m, :m], (whole - own)[:m])
                crossed = np.sum(unknowns * own[:m], axis=0)
                total[row] += power - 2.0 * crossed + np.sum(unknowns * (gram[:m, :m] @ unknowns), axis=0)
        return total / len(signals)

    def degrees_of(self, signals: Real) -> NDArray[np.intp]:
        """Degree that misses least, of each signal; shape (signals,)."""
        return np.asarray(np.asarray(self.degrees, dtype=np.intp)[np.argmin(self.missed(signals), axis=0)], dtype=np.intp)

    def solve(self, degree: int, signals: Real) -> Real:
        """Solve for the unknowns; shape (m + degree + 1, signals).

        Those of the waves come first, then those of the slow columns.
        """
        m = self.waves + degree + 1
        return np.asarray(scipy.linalg.solve_triangular(self._triangle[:m, :m], self._basis[:, :m].T @ signals))

    def parts(self, degree: int, unknowns: Real) -> tuple[Real, Real]:
        """Waves and slow part of one signal with given unknowns; shapes (n,)."""
        m = self.waves
        return self._design[:, :m] @ unknowns[:m], self._design[:, m : m + degree + 1] @ unknowns[m:]
