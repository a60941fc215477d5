"""Plant of one axis from its frequency response.

The response is the motor angle per torque, measured with a periodic excitation as instrument.

The motor turns slowly, so that Coulomb friction is a constant, the drive's loop stays closed, and a periodic signal is added
to its torque (60B2h) or to its reference. Period p gives the spectra Y_p of the motor angle and U_p of the torque on the
excited lines; the excitation's spectrum D is the same in each. Averages over periods keep what follows the excitation and lose
the rest, in closed loop too, so that

    P(jω) = Ȳ*/Ū*

is free of the bias that Y/U has where the loop's own noise drives the torque. Y* and U* are what the plant did and felt, made
from what was sampled:
see `hil.design.plant_problem`.

Source: R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. (2012), sections 2.5 to 2.7 and 9.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from hil.control.arrays import Complex, Real
from hil.design.estimate import Estimate
from hil.design.estimation import (
    EVALUATIONS,
    FAR_SIGMAS,
    PROBABILITY,
    ROUNDING,
    EstimatedMode,
    EstimatedParameter,
    UnidentifiableError,
    inverse,
)
from hil.design.frequency import TwoInertia
from hil.design.plant_problem import (
    AGE,
    ARM_PART,
    DAMPING,
    DELAY,
    J_L,
    J_M,
    K_G,
    LAG,
    LEVER,
    VISCOUS,
    PlantProblem,
    SamplingTiming,
    Scatter,
)
from hil.design.plant_spectra import Spectra

SMALLEST_MISFIT = 0.5
"""Measured: misfit below which the errors shrink no further: 0.59 (median), 0.82 at most on the linear robots 10700 to 10724."""
ZETA_LEFT_OPEN = 3e-3
"""Measured: least relative error of ζ. On the linear robots 10600 to 10629 the rms of z of ζ is 0.63 with it, and 0.82 without;
with a SYNC of 8 ms and an encoder of 13 bits ζ was off by 2.5 %."""


@dataclass(frozen=True)
class ResponseEstimate:
    """Frequency response with its uncertainty; all of shape (lines,).

    Attributes:
        frequency_hz: Frequencies of the lines.
        value: Response P = Ȳ*/Ū*, in rad/(N·m); or tip acceleration per motor angle, in m/s² per rad.
        deviation: Standard deviation of `value`, √E|ΔP|², from the scatter between periods.
        radius: Radius of the circle that holds the true value with a probability of 95 %.
        coherence: Fraction of the output of one period that follows the input.
    """

    frequency_hz: Real
    value: Complex
    deviation: Real
    radius: Real
    coherence: Real


@dataclass(frozen=True)
class PlantEstimate:
    """Fitted plant with its standard errors and the measured responses.

    Attributes:
        plant: The fitted plant; its dampings D_m and D_l may come out below 0, within their errors.
        parameters: Parameters by name: the fitted fields of `TwoInertia`, `antiresonance_hz`, `resonance_hz`, `damping` (ζ),
            `viscous_damping_nm_s_rad` (D_m + D_l/N²), `torque_age_s`, `torque_lag_s`, and with an accelerometer `lever_ratio` and
            `accelerometer_delay_s`.
        values: The same as the fit has them, with their covariance.
        response: Motor angle per torque.
        tip: Tip acceleration per motor angle; None without accelerometer.
        misfit: √ of the mean squared residual in standard deviations: 1 where the model explains all but the scatter.
        torsion_rad: Amplitude of a sine at f_a whose torsion of the gear meets the same friction as the excitation; stiffness and
            damping hold for it where the gear has hysteresis.
        spring_torsion_rad: Amplitude of a sine whose torsion meets the same spring as the excitation, where it is cubic.
        unknowns: The fit's own unknowns, from which another may start.
        modes: All modes of an arm that rings with several, from the lowest; then the plant is the motor with the leading one of
            them. Empty where there is one.
    """

    plant: TwoInertia
    parameters: Mapping[str, EstimatedParameter]
    values: Estimate
    response: ResponseEstimate
    tip: ResponseEstimate | None
    misfit: float
    periods: int
    torsion_rad: float
    spring_torsion_rad: float
    unknowns: Real
    modes: tuple[EstimatedMode, ...] = ()


def fit_plant(
    data: Spectra,
    timing: SamplingTiming,
    reduction_ratio: float,
    lever_m: float,
    gravity_nm_rad: float = 0.0,
    near: PlantEstimate | None = None,
) -> PlantEstimate:
    """Fit J_m, J_l, K_g and the dampings on the excited lines.

    Minimises Σ |Ȳ* − P(jω) Ū*|²/σ²(P) over the lines, with σ from the scatter of both between periods, jointly with the age of
    the reported torque; with an accelerometer also Σ |Ā − g L s² c/(N (B + c)) e^{−jωδ_a} Ȳ*|²/σ_A²: its information on f_a
    and ζ needs neither torque nor lever, since its scale g and its delay δ_a are unknowns too. Means and standard errors are
    integrated over the lag (`over_lag`), the latter times the misfit (`enlargement`), of which a half is the least.

    The data determine D_g + D_l, which damps the arm at f_a (ζ), and D_m + D_l/N², against which the motor turns: these are the
    unknowns, with D_l third. D_l alone shows only in how the damping differs between f_a and f_r, and through an
    accelerometer as a lead of D_l/K_g, 0.1 ms on the reference robot, which its delay hides.

    Args:
        lever_m: Tip lever L of the bench file.
        gravity_nm_rad: Slope dM/dθ_l of the gravity moment over the stretch, which acts as a second spring on the arm.
        near: An earlier estimate to start from, besides the fit's own guesses.

    Raises:
        UnidentifiableError: There are fewer than three periods, too few lines, or no resonance in the response.
    """
    if data.periods < 3:
        raise UnidentifiableError("periods to average over", data.periods, 3)
    if len(data.frequency_hz) < 12:
        raise UnidentifiableError("excited lines", len(data.frequency_hz), 12)
    problem = PlantProblem(data, timing, reduction_ratio, lever_m, gravity_nm_rad)
    starts = problem.first_guesses()
    if near is not None:
        starts = [problem.resumed(near.unknowns), *starts[:2]]
    descents = Descents(problem)
    fits = descents.of(starts)
    inside = [fit for fit in fits if problem.is_inside(fit.x)]
    best = min(inside or fits, key=_left)
    problem.focus(problem.plant(best.x).antiresonance_hz)
    others = descents.of([*problem.beside(best.x), *problem.with_other_delay(best.x)])
    best = min([best, *(fit for fit in others if problem.is_inside(fit.x))], key=_left)
    problem.focus(problem.plant(best.x).antiresonance_hz)
    return estimate_of(problem, *over_lag(problem, best))


def _left(fit: Any) -> float:
    """Cost of a fit per residual.

    Fits use the tip around f_a, so they have different numbers of residuals.
    """
    return float(fit.cost) / len(fit.fun)


class Descents:
    """Fits of a problem from several starts, each in three rounds.

    The first round holds the times near the prior values, so that the fit does not wander off; the others fit all unknowns. A
    fit that has come to where another was is given up after the first round, and so is one whose residuals are `FAR_SIGMAS`
    times those of the best with its resonances in the band.
    """

    def __init__(self, problem: PlantProblem) -> None:
        self._problem, self._least, self._reached = problem, math.inf, list[Real]()

    def of(self, starts: Sequence[Real]) -> list[Any]:
        """Fit from starts, beside those of earlier calls."""
        begun = [_round(self._problem, start, EVALUATIONS // 4, are_times_held=True) for start in starts]
        inside = [fit for fit in begun if self._problem.is_inside(fit.x)]
        self._least = min([self._least, *(_left(fit) for fit in inside or begun)])
        return [self._ended(fit.x) for fit in begun if _left(fit) <= FAR_SIGMAS**2 * self._least and not self._was_at(fit.x)]

    def _was_at(self, x: Real) -> bool:
        size = 0.05 * self._problem.scale(x)  # half a percent of an inertia, 5 µs of an age: no two minima are so near
        return any(bool(np.all(np.abs(x - other) < size)) for other in self._reached)

    def _ended(self, x: Real) -> Any:
        fit = _round(self._problem, _round(self._problem, x, EVALUATIONS).x, EVALUATIONS // 4)
        self._reached += [x, fit.x]
        return fit


def _round(problem: PlantProblem, x: Real, evaluations: int, *, are_times_held: bool = False) -> Any:
    """Fit with the tip's lines around the antiresonance of a start."""
    problem.focus(problem.plant(x).antiresonance_hz)
    return _descended(problem, x, list(range(len(x))), problem.bounds(x, are_times_held=are_times_held), evaluations)


def _descended(
    problem: PlantProblem, x: Real, free: list[int], bounds: tuple[Real, Real], evaluations: int, tolerance: float = 1e-8
) -> Any:
    """Fit of the free unknowns, to a relative change of the cost; the others stay as they are."""
    low, high = bounds[0][free], bounds[1][free]

    def whole(part: Real) -> Real:
        full = x.copy()
        full[free] = part
        return full

    def residual(part: Real) -> Real:
        return problem.residual(whole(part))

    def slopes(part: Real) -> Real:
        return problem.slopes(whole(part))[:, free]

    return scipy.optimize.least_squares(
        residual,
        np.clip(x[free], low + 1e-9, high - 1e-9),
        slopes,
        bounds=(low, high),
        x_scale=problem.scale(x)[free],
        loss="soft_l1",
        f_scale=FAR_SIGMAS,
        max_nfev=evaluations,
        ftol=tolerance,
    )


def enlargement(problem: PlantProblem, x: Real) -> float:
    """Factor of the covariance: the mean squared residual of the kind that is explained least, not of them all.

    What is allowed for beside scatter, for the law and for images at the tip, is seldom met in full; that residuals of one kind
    are small says nothing of those of another.
    """
    left = problem.left(x)
    count = sum(map(len, left))
    freedom = max(1.0, 2.0 * count - len(x)) / count
    return max(SMALLEST_MISFIT**2, *(float(2.0 * np.sum(np.abs(each) ** 2) / (freedom * max(1, len(each)))) for each in left))


def over_lag(problem: PlantProblem, fit: Any) -> tuple[Real, Real]:
    """Mean and covariance of the unknowns, integrated over the lag of the current loop.

    Lag, age of the torque and motor inertia can stand for each other: with a SYNC of 8 ms the likelihood may be flat from 0 to
    0.4 ms and end there, so that its curvature at a minimum says little of its width. So the others are fitted at lags that are
    half of `FAR_SIGMAS` apart, as far as they are not improbable, and each weighs by its likelihood times the volume that it
    leaves the others, √det of their covariance; in between both are interpolated.
    """
    found = _at_lags(problem, fit)
    found.sort(key=lambda each: each.x[LAG])
    points = np.array([each.x for each in found])
    lags = np.linspace(points[0, LAG], points[-1, LAG], EVALUATIONS)
    values = [each.deviance for each in found], points, [each.covariance for each in found]
    deviance, points, covariances = (
        scipy.interpolate.PchipInterpolator(points[:, LAG], each)(lags) if len(found) > 1 else np.array(each) for each in values
    )
    weights = np.exp(-0.5 * (deviance - deviance.min()))
    weights /= weights.sum()
    mean = weights @ points
    apart = points - mean
    return mean, np.asarray(np.einsum("n,nij->ij", weights, covariances) + (weights * apart.T) @ apart)


def _at_lags(problem: PlantProblem, fit: Any) -> list["_HeldLag"]:
    """Fits at lags on both sides of a fit, as far as not improbable.

    If one of them is better than that fit, the fit was in another minimum: all begins again from the best of them.
    """
    enlarged, bounds = enlargement(problem, fit.x), problem.bounds(fit.x)
    best = _HeldLag.of(problem, fit.x, fit, enlarged)
    jacobian = np.asarray(fit.jac)
    step = 0.5 * FAR_SIGMAS * math.sqrt(inverse(jacobian.T @ jacobian)[LAG, LAG] * enlarged)
    found = [best]
    for side in (-step, step):
        reach, last = side, best
        for _ in range(EVALUATIONS):
            x = last.x.copy()
            x[LAG] = np.clip(x[LAG] + reach, bounds[0][LAG], bounds[1][LAG])
            # a fit ends a hair's breadth from a bound: two points there would have any slope between them
            if last.deviance > best.deviance + FAR_SIGMAS**2 or abs(x[LAG] - last.x[LAG]) < math.sqrt(ROUNDING) * step:
                break
            fit = _descended(problem, x, _others(x), bounds, EVALUATIONS // 4, math.sqrt(ROUNDING))
            before, last = last, _HeldLag.of(problem, x, fit, enlarged)
            found.append(last)
            if abs(last.deviance - before.deviance) < 1.0:
                reach *= 2.0
    least = min(found, key=lambda each: each.cost)
    if least.cost < (1.0 - math.sqrt(ROUNDING)) * best.cost:
        return _at_lags(problem, _descended(problem, least.x, list(range(len(least.x))), bounds, EVALUATIONS))
    return found


@dataclass(frozen=True)
class _HeldLag:
    """Fit of the other unknowns at a lag.

    Attributes:
        cost: Half of the sum of the squared residuals.
        deviance: −2 ln of the likelihood of the lag, but for a constant.
        x: The unknowns.
        covariance: Their covariance, without that of the lag.
    """

    cost: float
    deviance: float
    x: Real
    covariance: Real

    @classmethod
    def of(cls, problem: PlantProblem, x: Real, fit: Any, enlarged: float) -> "_HeldLag":
        """Take a fit of all unknowns, or of those beside the lag, which then is x's."""
        others, point, jacobian = _others(x), x.copy(), np.asarray(fit.jac)
        is_whole = len(fit.x) == len(x)
        point[others] = fit.x[others] if is_whole else fit.x
        jacobian, scale = jacobian[:, others] if is_whole else jacobian, problem.scale(point)[others]
        information, covariance = jacobian.T @ jacobian / enlarged, np.zeros((len(x), len(x)))
        covariance[np.ix_(others, others)] = inverse(information)
        volume = float(np.linalg.slogdet(information * np.outer(scale, scale))[1])
        return cls(float(fit.cost), 2.0 * float(fit.cost) / enlarged + volume, point, covariance)


def _others(x: Real) -> list[int]:
    """Unknowns but the lag."""
    return [unknown for unknown in range(len(x)) if unknown != LAG]


def estimate_of(problem: PlantProblem, x: Real, covariance: Real) -> PlantEstimate:
    """Convert the unknowns to parameters with errors."""
    left = problem.residual(x)[: -problem.priors]
    misfit = math.sqrt(float(np.sum(left**2)) / max(1, len(left) - len(x)))
    plant = problem.plant(x)

    motor, arm, stiffness = plant.motor_inertia_kg_m2, plant.arm_inertia_kg_m2, plant.gear_stiffness_nm_rad
    damping, f_a, f_r = plant.gear_damping_nm_s_rad + plant.arm_damping_nm_s_rad, plant.antiresonance_hz, plant.resonance_hz
    zeta = 0.5 * damping / math.sqrt(stiffness * arm)
    arm_part = arm / (problem.ratio**2 * motor)
    arm_part = 0.5 * arm_part / (1.0 + arm_part)  # ∂ ln f_r/∂ ln J_l beyond that of f_a
    of_gear, of_arm, per_n2 = plant.gear_damping_nm_s_rad, plant.arm_damping_nm_s_rad, 1.0 / problem.ratio**2
    # each with its slopes by the unknowns
    found: dict[str, tuple[float, dict[int, float]]] = {
        "motor_inertia_kg_m2": (motor, {J_M: motor}),
        "arm_inertia_kg_m2": (arm, {J_L: arm}),
        "gear_stiffness_nm_rad": (stiffness, {K_G: stiffness}),
        "gear_damping_nm_s_rad": (of_gear, {DAMPING: of_gear, ARM_PART: -damping}),
        "motor_damping_nm_s_rad": (
            plant.motor_damping_nm_s_rad, {VISCOUS: 1.0, DAMPING: -of_arm * per_n2, ARM_PART: -damping * per_n2}
        ),
        "arm_damping_nm_s_rad": (of_arm, {DAMPING: of_arm, ARM_PART: damping}),
        "viscous_damping_nm_s_rad": (float(x[VISCOUS]), {VISCOUS: 1.0}),
        "antiresonance_hz": (f_a, {J_L: -0.5 * f_a, K_G: 0.5 * f_a}),
        "resonance_hz": (f_r, {J_M: -arm_part * f_r, J_L: (arm_part - 0.5) * f_r, K_G: 0.5 * f_r}),
        "damping": (zeta, {J_L: -0.5 * zeta, K_G: -0.5 * zeta, DAMPING: zeta}),
        "torque_age_s": (float(x[AGE]), {AGE: 1.0}),
        "torque_lag_s": (float(x[LAG]), {LAG: 1.0}),
    }  # fmt: skip
    tip = None
    data = problem.data
    of_torque, of_angle, of_tip, _ = problem.images(x)
    angle = data.angle - of_angle
    if data.tip is not None:
        found["lever_ratio"] = (math.exp(x[LEVER]), {LEVER: math.exp(x[LEVER])})
        found["accelerometer_delay_s"] = (float(x[DELAY]), {DELAY: 1.0})
        tip = _response(data, data.tip - of_tip, angle)
    torque = problem.torque(x, data.torque, of_torque) * problem.felt(x)
    slopes = np.zeros((len(found), len(x)))
    for row, (_, by_unknown) in enumerate(found.values()):
        slopes[row, list(by_unknown)] = list(by_unknown.values())
    mean = np.array([value for value, _ in found.values()])
    square = slopes @ covariance @ slopes.T
    square[(list(found).index("damping"),) * 2] += (ZETA_LEFT_OPEN * zeta) ** 2
    values = Estimate(tuple(found), mean, square)
    return PlantEstimate(
        plant,
        {name: EstimatedParameter(values.value(name), values.standard_error(name)) for name in found},
        values,
        _response(data, angle, torque),
        tip,
        misfit,
        data.periods,
        sine_of_same_friction_rad(plant, data.frequency_hz, angle),
        sine_of_same_spring_rad(plant, data.frequency_hz, angle),
        x,
    )


def sine_of_same_friction_rad(plant: TwoInertia, frequency_hz: Real, angle: Complex) -> float:
    """Amplitude of the sine at f_a that meets the same friction as the excitation.

    Many lines make the torsion θ_m/N − θ_l a Gaussian signal. To it a friction F sgn(ψ') is a damping of √(2/π) F/σ, with the
    standard deviation σ of ψ'; to a sine of amplitude a it is one of 4 F/(π ω_a a). Both are equal at a = (4/π) √(π/2) σ/ω_a.

    Args:
        frequency_hz: Excited lines; shape (lines,).
        angle: Spectra of the motor angle's periods, amplitudes; shape (periods, lines).

    Source: A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design (1968), appendices B, E.
    """
    rates = 2j * math.pi * frequency_hz * _torsion(plant, frequency_hz, angle)
    return 4.0 / math.pi * math.sqrt(0.5 * math.pi) * _deviation(rates) / (2.0 * math.pi * plant.antiresonance_hz)


def sine_of_same_spring_rad(plant: TwoInertia, frequency_hz: Real, angle: Complex) -> float:
    """Amplitude of the sine that meets the same cubic spring as the excitation.

    To a Gaussian torsion of standard deviation σ a spring K ψ + κ ψ³ has the stiffness K + 3 κ σ², to a sine of amplitude a
    K + ¾ κ a²: both are equal at a = 2 σ. Arguments and source as of `sine_of_same_friction_rad`.
    """
    return 2.0 * _deviation(_torsion(plant, frequency_hz, angle))


def _torsion(plant: TwoInertia, frequency_hz: Real, angle: Complex) -> Complex:
    """Amplitudes of the gear's torsion; shape (lines,)."""
    _, b, c = plant.terms(2j * math.pi * frequency_hz)
    return np.asarray(angle.mean(axis=0) / plant.reduction_ratio * b / (b + c))


def _deviation(amplitudes: Complex) -> float:
    """Standard deviation of a signal of many lines."""
    return math.sqrt(0.5 * float(np.sum(np.abs(amplitudes) ** 2)))


def _response(data: Spectra, output: Complex, given: Complex) -> ResponseEstimate:
    """Output per input with its scatter; both of shape (periods, lines)."""
    mean_in, count = given.mean(axis=0), len(given)
    value = output.mean(axis=0) / mean_in
    scatter = np.sqrt(np.maximum(Scatter.of(output - value * given, given, data.waves).output, 1e-300))
    deviation = scatter / np.abs(mean_in)
    explained, unexplained = np.abs(value * mean_in) ** 2, count * scatter**2
    # the quantile of F with 2 and 2 (count − 1) degrees of freedom
    count = count if data.waves is None else len(np.unique(data.waves))
    bound = math.sqrt((count - 1) * ((2.0 * (1.0 - PROBABILITY)) ** (-1.0 / (count - 1)) - 1.0))
    return ResponseEstimate(data.frequency_hz, value, deviation, bound * deviation, explained / (explained + unexplained))
