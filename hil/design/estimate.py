"""Gaussian estimate of several quantities, with its covariance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from hil.control.arrays import Real


@dataclass(frozen=True)
class Estimate:
    """Gaussian estimate of named quantities.

    Attributes:
        names: Names of the quantities; n of them.
        mean: Their means; shape (n,).
        covariance: Their covariance; shape (n, n).
    """

    names: tuple[str, ...]
    mean: Real
    covariance: Real

    @classmethod
    def independent(cls, values: dict[str, tuple[float, float]]) -> Self:
        """Estimate of independent quantities, from mean and standard error by name."""
        means, errors = (np.array(each) for each in zip(*values.values(), strict=True))
        return cls(tuple(values), means, np.diag(errors**2))

    def value(self, name: str) -> float:
        """Mean of a quantity."""
        return float(self.mean[self.names.index(name)])

    def standard_error(self, name: str) -> float:
        """Standard error of a quantity."""
        index = self.names.index(name)
        return math.sqrt(max(0.0, self.covariance[index, index]))

    @property
    def correlation(self) -> Real:
        """Correlation of the quantities; shape (n, n). One without an error correlates with none.

        Rounding may leave a covariance of quantities that are nearly the same an eigenvalue below 0: it counts as 0.
        """
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        scale = np.outer(*[np.where(errors > 0.0, errors, math.inf)] * 2)
        sizes, axes = np.linalg.eigh(np.eye(len(errors)) + _off_diagonal(self.covariance) / scale)
        square = axes * np.maximum(sizes, 0.0) @ axes.T
        return np.asarray(square / np.sqrt(np.outer(np.diag(square), np.diag(square))))

    def part(self, names: Sequence[str]) -> Self:
        """Estimate of some of the quantities, in the order of their names."""
        at = [self.names.index(name) for name in names]
        return type(self)(tuple(names), self.mean[at], self.covariance[np.ix_(at, at)])

    def correlated(self, names: Sequence[str], covariance: Real) -> Self:
        """Estimate with other covariances between some quantities, whose variances stay.

        Args:
            names: Names of those quantities; m of them.
            covariance: Their covariance, of which the diagonal does not count; shape (m, m).
        """
        at = np.ix_(*[[self.names.index(name) for name in names]] * 2)
        square = self.covariance.copy()
        square[at] = np.diag(np.diag(square[at])) + _off_diagonal(covariance)
        return type(self)(self.names, self.mean, square)

    def replaced(self, name: str, mean: float, standard_error: float) -> Self:
        """Estimate with a new and independent value of one quantity."""
        index = self.names.index(name)
        means, covariance = self.mean.copy(), self.covariance.copy()
        covariance[index, :] = covariance[:, index] = 0.0
        means[index], covariance[index, index] = mean, standard_error**2
        return type(self)(self.names, means, covariance)

    def with_others(self, values: dict[str, tuple[float, float]]) -> Self:
        """Estimate with more independent quantities; one that is there already is replaced."""
        found, new = self, {name: each for name, each in values.items() if name not in self.names}
        for name in values.keys() - new.keys():
            found = found.replaced(name, *values[name])
        if not new:
            return found
        others = self.independent(new)
        covariance = np.zeros((len(found.names) + len(new),) * 2)
        covariance[: len(found.names), : len(found.names)] = found.covariance
        covariance[len(found.names) :, len(found.names) :] = others.covariance
        return type(self)((*found.names, *others.names), np.concatenate([found.mean, others.mean]), covariance)

    def with_marginal(self, name: str, mean: float, standard_error: float) -> Self:
        """Estimate with another marginal of one quantity, the others conditional on it as before.

        x̂ ← x̂ + g (m − x̂_i), P ← P + g gᵀ (σ² − P_ii), g = P_·i/P_ii. These are the moments of the posterior for any prior of
        that quantity, if the mean and standard error are those of its posterior.
        """
        index = self.names.index(name)
        square = float(self.covariance[index, index])
        gain = self.covariance[:, index] / square
        covariance = self.covariance + np.outer(gain, gain) * (standard_error**2 - square)
        return type(self)(self.names, self.mean + gain * (mean - self.mean[index]), covariance)

    def observed(self, rows: Real, values: Real, variances: Real, only: Sequence[str] | None = None) -> Self:
        """Posterior after an observation, by Bayes' rule.

        y = H x + noise: x̂ ← x̂ + K (y − H x̂), P ← (1 − K H) P, K = P Hᵀ (H P Hᵀ + R)⁻¹.

        Args:
            rows: H; shape (m, n).
            values: y; shape (m,).
            variances: Diagonal of R; shape (m,).
            only: Quantities that change; the rows of K are 0 for the others, which are known as before. None: all.

        Source: R. E. Kalman, J. Basic Engineering 82 (1960) 35; S. F. Schmidt, Advances in Control Systems 3 (1966) 293.
        """
        gain = np.linalg.solve(rows @ self.covariance @ rows.T + np.diag(variances), rows @ self.covariance).T
        if only is not None:
            gain[[name not in only for name in self.names]] = 0.0
        # Joseph's form stays symmetric and positive
        kept = np.eye(len(self.mean)) - gain @ rows
        covariance = kept @ self.covariance @ kept.T + (gain * variances) @ gain.T
        return type(self)(self.names, self.mean + gain @ (values - rows @ self.mean), covariance)


def _off_diagonal(square: Real) -> Real:
    return square - np.diag(np.diag(square))
