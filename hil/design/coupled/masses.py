"""Masses of an arm from the modes that its motors feel.

From modes in some postures follow base parameters and gear stiffnesses, and the dips in other postures.

With all motors held an arm on gears K rings at ω_i: K φ_i = ω_i² H φ_i, φ_iᵀ H φ_i = 1. Motor k feels mode i with the effective
inertia J_ki = (H φ_i)_k². H(q) = Y(q) θ is linear in the links' masses θ, of which only some combinations show in any posture:
the base parameters β, by a singular value decomposition of Y over the workspace. β and the logarithms of K are fitted to all
ω_i and J_ki at once; their covariance grows with the misfit, and goes on into every prediction.

Source: M. Gautier, Numerical calculation of the base inertial parameters of robots, Journal of Robotic Systems 8 (1991).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from hil.control.arrays import Real
from hil.design.estimation import DIFFERENCE_STEP, EVALUATIONS, PROBABILITY, ROUNDING

RANK_TOLERANCE = 1e-5
"""Accuracy: singular value over the largest, unknowns scaled alike, below which postures do not determine a combination."""
LEAST_FREQUENCY_ERROR = 0.003
"""Bound: relative error of a dip: an excited joint turns by degrees, and its dips move by some tenths of a per cent."""
LEAST_INERTIA_ERROR = 0.01
"""Measured: error of an effective inertia at least, in units of the joint's whole inertia: a turn of the reference arm's joints
by 1.5° changes it by 0.7 % (rms), and by 1.4 % at most."""
MOST_STARTS, START_SPREAD = 4, 0.6
"""Accuracy: starts of the fit, and spread of their links' masses (natural logarithm): a fit may take dips for each other. One
whose residual chance explains is the last. On the reference arm with eight draws of noise all give the same."""
MOST_MISFIT = 5.0
"""Probability: misfit from which masses are none, in standard errors."""
PER_BODY = 10
"""Bound: numbers of a link in θ."""
FAR_OFF = 1e3
"""Accuracy: residual of masses that no arm has: any that is far above all others."""


@dataclass(frozen=True)
class FeltMode:
    """Mode that a motor shows in a posture.

    Attributes:
        posture: Number of the posture.
        joint: Row of the joint in the mass matrix.
        frequency_hz: Its dip.
        inertia_kg_m2: Its effective inertia about the joint.
    """

    posture: int
    joint: int
    frequency_hz: float
    frequency_error_hz: float
    inertia_kg_m2: float
    inertia_error_kg_m2: float


class TooFewPosturesError(ValueError):
    """Postures that do not determine the masses.

    Attributes:
        known: Number of combinations that they determine.
        needed: Number that show somewhere in the workspace, gears included.
        best: Row of the posture of the workspace that would add most information.
    """

    def __init__(self, known: int, needed: int, best: int) -> None:
        self.known, self.needed, self.best = known, needed, best
        super().__init__(f"these postures determine {known} of {needed} combinations of masses and gears")


class NoMassesError(ValueError):
    """Modes that no masses explain.

    Attributes:
        misfit: Root mean square of the residuals over their degrees of freedom, in standard errors.
    """

    def __init__(self, misfit: float) -> None:
        self.misfit = misfit
        super().__init__(
            f"no masses explain the measured modes: the misfit is {misfit:.1f} standard errors; at most "
            f"{MOST_MISFIT:g} is allowed"
        )


@dataclass(frozen=True, eq=False)
class MassFit:
    """Fitted masses.

    Attributes:
        basis: Base parameters in terms of θ, as columns; shape (parameters, base).
        unknowns: β, in units of its size, and ln K; shape (base + n,).
        size: Size of β.
    """

    basis: Real
    unknowns: Real
    size: float
    covariance: Real
    misfit: float
    best: int

    @property
    def masses(self) -> Real:
        """Masses θ with these base parameters; shape (parameters,).

        They have no part that shows in no posture, and need not be masses of real bodies.
        """
        return np.asarray(self.basis @ (self.size * self.unknowns[: self.basis.shape[1]]))

    @property
    def stiffness_nm_rad(self) -> Real:
        """K of each gear; shape (n,)."""
        return np.asarray(np.exp(self.unknowns[self.basis.shape[1] :]))

    @property
    def stiffness_error_nm_rad(self) -> Real:
        """Standard error of each K; shape (n,)."""
        return np.asarray(self.stiffness_nm_rad * np.sqrt(np.diag(self.covariance)[self.basis.shape[1] :]))

    def dips_hz(self, regressors: Real) -> tuple[Real, Real]:
        """Predict the dips in some postures, with standard errors.

        Dips are the frequencies at which the arm rings with all motors held; both results have the shape (postures, n).

        Args:
            regressors: Y of the postures; shape (postures, n, n, parameters).
        """
        reduced = regressors @ self.basis

        def dips(x: Real) -> Real:
            return np.array([_modes(x, each, self.size)[0] for each in reduced])

        values = dips(self.unknowns)
        slopes = _slopes(lambda x: np.asarray(dips(x).ravel()), self.unknowns)
        errors = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, self.covariance, slopes), 0.0))
        return values, errors.reshape(values.shape)


def dips_of(mass_matrix_kg_m2: Real, stiffness_nm_rad: Real) -> Real:
    """Dips of an arm on its gears in Hz, from the lowest.

    All motors are held; shape (n,).
    """
    squares = scipy.linalg.eigh(np.diag(stiffness_nm_rad), mass_matrix_kg_m2, eigvals_only=True)
    return np.asarray(np.sqrt(squares) / (2.0 * math.pi))


def base_of(workspace: Real) -> Real:
    """Base parameters, as columns in terms of θ; shape (parameters, base).

    Args:
        workspace: Y of postures all over it; shape (postures, n, n, parameters).
    """
    _, sizes, rows = np.linalg.svd(workspace.reshape(-1, workspace.shape[-1]), full_matrices=False)
    return np.asarray(rows[sizes > ROUNDING * sizes[0]].T)


def fit_masses(regressors: Real, felt: Sequence[FeltMode], workspace: Real, made_up: Real) -> MassFit:
    """Base parameters and gears from the modes of some postures.

    Args:
        regressors: Y of the postures; shape (postures, n, n, parameters).
        felt: What the motors have felt in them.
        workspace: Y of postures all over the workspace; shape (many, n, n, parameters).
        made_up: θ of some arm like it, from which the fit starts; shape (parameters,).

    Raises:
        NoMassesError: No masses explain what was felt.
        TooFewPosturesError: They do not determine what shows in the workspace.
    """
    basis = base_of(workspace)
    reduced, around = regressors @ basis, workspace @ basis

    fit, size = _best_fit(reduced, felt, basis, made_up)
    residuals = np.asarray(fit.fun)
    misfit = math.sqrt(float(residuals @ residuals) / max(1, len(residuals) - len(fit.x)))
    if misfit > MOST_MISFIT:
        raise NoMassesError(misfit)
    slopes = _slopes(lambda x: _residuals(x, reduced, felt, size), fit.x)
    scales = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    _, sizes, rows = np.linalg.svd(slopes / scales, full_matrices=False)
    known = int(np.sum(sizes > RANK_TOLERANCE * sizes[0])) if len(slopes) >= len(fit.x) else len(slopes)
    best = _most_telling(fit.x, around, size, slopes.T @ slopes)
    if known < len(fit.x):
        raise TooFewPosturesError(known, len(fit.x), best)
    covariance = np.asarray((rows.T / sizes**2) @ rows) / np.outer(scales, scales) * max(1.0, misfit) ** 2
    return MassFit(basis, np.asarray(fit.x), size, covariance, misfit, best)


def _best_fit(reduced: Real, felt: Sequence[FeltMode], basis: Real, made_up: Real) -> tuple[Any, float]:
    """Choose the best of some fits, and its size of β."""
    generator, found = np.random.default_rng(1), []
    for number in range(MOST_STARTS):
        links = np.exp(START_SPREAD * generator.standard_normal(len(made_up) // PER_BODY)) if number else np.ones(1)
        other = made_up * (np.repeat(links, PER_BODY) if number else 1.0)
        start, size = _start(reduced, felt, basis.T @ other)

        def left(x: Real, size: float = size) -> Real:
            return _residuals(x, reduced, felt, size)

        fit: Any = scipy.optimize.least_squares(left, start, x_scale="jac", method="trf", max_nfev=EVALUATIONS)
        found.append((float(fit.cost), number, fit, size))
        if 2.0 * fit.cost < scipy.stats.chi2.ppf(PROBABILITY, max(1, len(fit.fun) - len(fit.x))):
            break
    _, _, best, size = min(found, key=lambda each: each[:2])
    return best, size


def _modes(x: Real, reduced: Real, size: float) -> tuple[Real, Real]:
    """Dips in Hz, and effective inertias by joint and mode.

    Shapes (n,) and (n, n); NaN if H is not a mass matrix.
    """
    n = reduced.shape[0]
    inertia, gears = reduced @ (size * x[:-n]), np.exp(x[-n:])
    try:
        squares, shapes = scipy.linalg.eigh(np.diag(gears), inertia)
    except scipy.linalg.LinAlgError:
        return np.full(n, math.nan), np.full((n, n), math.nan)
    return np.sqrt(squares) / (2.0 * math.pi), (inertia @ shapes) ** 2


def _residuals(x: Real, reduced: Real, felt: Sequence[FeltMode], size: float) -> Real:
    """Residuals of dip and effective inertia of each felt mode.

    They are in standard errors; shape (2 modes,).
    """
    modes = [_modes(x, each, size) for each in reduced]
    whole = [[sum(mode.inertia_kg_m2 for mode in felt if (mode.posture, mode.joint) == (p, k)) for k in range(reduced.shape[1])]
             for p in range(len(reduced))]  # fmt: skip
    found = np.full((len(felt), 2), FAR_OFF)
    for posture, (dips, inertias) in enumerate(modes):
        if not np.all(np.isfinite(dips)):
            continue
        for joint in range(reduced.shape[1]):
            rows = [row for row, mode in enumerate(felt) if (mode.posture, mode.joint) == (posture, joint)]
            seen = np.log([[felt[row].frequency_hz / hz for hz in dips] for row in rows]) if rows else np.zeros((0, 1))
            for row, which in zip(rows, scipy.optimize.linear_sum_assignment(np.abs(seen))[1], strict=True):
                mode = felt[row]
                dip_error = math.hypot(mode.frequency_error_hz / mode.frequency_hz, LEAST_FREQUENCY_ERROR)
                inertia_error = math.hypot(mode.inertia_error_kg_m2, LEAST_INERTIA_ERROR * whole[posture][joint])
                found[row, 0] = math.log(mode.frequency_hz / dips[which]) / dip_error
                found[row, 1] = (mode.inertia_kg_m2 - inertias[joint, which]) / inertia_error
    return found.ravel()


def _start(reduced: Real, felt: Sequence[FeltMode], made_up: Real) -> tuple[Real, float]:
    """Unknowns to begin with, and the size of β.

    The made-up masses are scaled to the joints' inertias; the gear stiffnesses follow from the modes.

    A linear fit of the joints' inertias would come nearer to these, and may end in masses that no arm has, beside the right ones.
    """
    n, ratios = reduced.shape[1], []
    stiffness: list[list[float]] = [[] for _ in range(n)]
    for posture, joint in sorted({(mode.posture, mode.joint) for mode in felt}):
        modes = [mode for mode in felt if (mode.posture, mode.joint) == (posture, joint)]
        whole = sum(mode.inertia_kg_m2 for mode in modes)
        ratios.append(whole / float(reduced[posture, joint, joint] @ made_up))
        stiffness[joint].append(sum(mode.inertia_kg_m2 * (2.0 * math.pi * mode.frequency_hz) ** 2 for mode in modes))
    whole_arm = math.exp(float(np.mean(np.log(ratios)))) * made_up
    size = float(np.linalg.norm(whole_arm))
    return np.concatenate([whole_arm / size, np.log([float(np.mean(each)) for each in stiffness])]), size


def _slopes(function: Callable[[Real], Real], x: Real) -> Real:
    """Slopes of a function by central differences; shape (values, unknowns)."""
    steps = DIFFERENCE_STEP * np.eye(len(x))
    return np.stack([(function(x + step) - function(x - step)) / (2.0 * DIFFERENCE_STEP) for step in steps], axis=1)


def _most_telling(x: Real, around: Real, size: float, information: Real) -> int:
    """Find the row of the posture whose modes would add most information."""

    def told(y: Real) -> Real:
        values = []
        for each in around:
            dips, inertias = _modes(y, each, size)
            whole = LEAST_INERTIA_ERROR * np.sum(inertias, axis=1, keepdims=True)
            values.append(np.concatenate([np.log(dips) / LEAST_FREQUENCY_ERROR, (inertias / whole).ravel()]))
        return np.concatenate(values)

    slopes = _slopes(told, x).reshape(len(around), -1, len(x))
    some = 1e-12 * float(np.trace(information)) * np.eye(len(x))
    are_real = [bool(np.all(np.isfinite(rows))) for rows in slopes]
    gains = [
        np.linalg.slogdet(information + some + rows.T @ rows)[1] if is_real else -math.inf
        for rows, is_real in zip(slopes, are_real, strict=True)
    ]
    return int(np.argmax(gains))
