"""The plant of one axis from its frequency response: motor angle per torque, measured with a periodic excitation as instrument.

The motor turns slowly, so that Coulomb friction is a constant, the drive's loop stays closed, and a periodic signal is added
to its torque (60B2h) or to its reference. Period p gives the spectra Y_p of the motor angle and U_p of the torque on the
excited lines; the excitation's spectrum D is the same in each. Averages over periods keep what follows the excitation and lose
the rest, in closed loop too, so that

    P(jω) = Ȳ*/Ū*

is free of the bias that Y/U has where the loop's own noise drives the torque. Y* and U* are what the plant felt and did, made
from what was sampled with the SYNC (period T) while the drive's law runs at T_c:

    U* = D H_d + (U − D e^{−jωT} − Σ F_k) e^{jωδ},        Y* = Y − Σ Y_k

The offset is held over a period, H_d = (1 − e^{−jωT})/(jωT), but is sampled at its very end; the loop's own part is younger:
δ is how old the torque is that the drive reports, half a control period if it reports the present one, and refined by the fit.
At the resonance the two nearly cancel, which is why a single delay for both will not do. F_k and Y_k are the images of the
held excitation at f + k/T, which fold onto the line; they are computed from the fitted plant and the law's gains.

Source: R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. (2012), sections 2.5 to 2.7 and 9.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from hil.control.cascade import Cascade
from hil.design.estimation import EstimatedParameter, UnidentifiableError, inverse
from hil.design.frequency import AnyComplex, Complex, Loop, Real, TwoInertia
from hil.design.plant_spectra import Spectra

DELAY_PRIOR_S = 3e-4
"""Standard deviation of the age of the reported torque around half a control period, as believed before the fit."""
LARGEST_CHANGE = 3.0
"""Largest change, as a logarithm, of an inertia, the stiffness, the damping or the lever in one round of the fit."""
SMOOTHED_LINES = 5
"""Lines over which the scatter between periods is averaged: of a few periods alone it is too uncertain for a weight."""
CONFIDENCE = 0.95


@dataclass(frozen=True)
class SamplingTiming:
    """Sampling times of a measurement, and the law inside the drive.

    Attributes:
        sync_s: Time T between two samples and two set-points.
        control_s: Control period T_c of the drive's law; 0 where it is not known.
        kind: Input to which the excitation is added: `torque`, which is held, or `reference`, which is interpolated.
        law: The drive's gains, for the images; None leaves them out.
    """

    sync_s: float
    control_s: float
    kind: Literal["torque", "reference"]
    law: Cascade | None


@dataclass(frozen=True)
class ResponseEstimate:
    """A frequency response with its uncertainty; all of shape (lines,).

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
    """The fitted plant, its standard errors, and the responses that it was fitted to.

    Attributes:
        plant: The fitted plant; its dampings D_m and D_l may come out below 0, within their errors.
        parameters: Parameters by name: the fitted fields of `TwoInertia`, `antiresonance_hz`, `resonance_hz`, `damping` (ζ),
            `viscous_damping_nm_s_rad` (D_m + D_l/N²), `torque_age_s`, and with an accelerometer `lever_ratio` and
            `accelerometer_delay_s`.
        response: Motor angle per torque.
        tip: Tip acceleration per motor angle; None without accelerometer.
        misfit: √ of the mean squared residual in standard deviations: 1 where the model explains all but the scatter.
        periods: Number of periods that were averaged.
    """

    plant: TwoInertia
    parameters: Mapping[str, EstimatedParameter]
    response: ResponseEstimate
    tip: ResponseEstimate | None
    misfit: float
    periods: int


class _Problem:
    """The fit's data and its residual as a function of the unknowns."""

    def __init__(self, data: Spectra, timing: SamplingTiming, reduction_ratio: float, lever_m: float, gravity: float) -> None:
        self.data, self.timing, self.ratio, self.lever_m = data, timing, reduction_ratio, lever_m
        self.gravity = gravity
        self.jw = 2j * math.pi * data.frequency_hz
        self.age_s = 0.5 * timing.control_s
        self.images: tuple[Complex, Complex] = (np.zeros_like(data.angle[0]), np.zeros_like(data.angle[0]))
        self.excitation = data.excitation.mean(axis=0)
        self.scatter = self.tip_scatter = _Scatter(*(np.ones(len(self.jw)) for _ in range(3)))

    # -- what the plant felt and did -----------------------------------------------------------------------------------

    def torque(self, age_s: float, torque: Complex, excitation: Complex) -> Complex:
        """Torque U* that acted, from the reported one; shape (…, lines)."""
        corrected = (torque - self.images[0]) * np.exp(self.jw * age_s)
        if self.timing.kind == "reference":
            return np.asarray(corrected)
        sync = self.timing.sync_s
        hold = (1.0 - np.exp(-self.jw * sync)) / (self.jw * sync)
        own = excitation * np.exp(-self.jw * sync)
        return np.asarray(excitation * hold + corrected - own * np.exp(self.jw * age_s))

    def angle(self, angle: Complex) -> Complex:
        """Motor angle Y* without images; shape (…, lines)."""
        return np.asarray(angle - self.images[1])

    def find_images(self, plant: TwoInertia) -> None:
        """Compute the images F_k and Y_k of the excitation, from the plant and the law inside the drive."""
        law, sync = self.timing.law, self.timing.sync_s
        if law is None or self.timing.control_s <= 0.0:
            return
        control = self.timing.control_s
        loop = Loop(plant, law, (), control)
        torque, angle = np.zeros_like(self.excitation), np.zeros_like(self.excitation)
        highest = max(1, int(0.5 * sync / control + 1e-9) - 1)  # below half the rate of the law
        for k in (k for k in range(-highest, highest + 1) if k):
            frequency = self.data.frequency_hz + k / sync
            jw = 2j * math.pi * frequency
            motion, feedback = plant.motor_angle_per_torque(frequency), loop.controller(frequency)
            closed = 1.0 + feedback * motion
            as_reported = np.exp(-jw * self.age_s) / np.sinc(frequency * control)
            if self.timing.kind == "torque":
                hold = (1.0 - np.exp(-jw * sync)) / (jw * sync)
                moved = motion / closed * self.excitation * hold
                torque = torque - feedback * moved * as_reported
            else:
                # the set-point of a SYNC is reached, in a straight line, with the last control period before the next
                wanted = self.excitation * np.exp(-jw * (sync - control)) * np.sinc(frequency * sync) ** 2
                acting = _reference_path(law, jw, control) / closed * wanted
                moved = motion * acting
                torque = torque + acting * as_reported
            angle = angle + moved
        self.images = torque, angle

    # -- scatter -------------------------------------------------------------------------------------------------------

    def weigh(self) -> None:
        """Compute the covariances of the averages, from the scatter between periods."""
        data = self.data
        angle = self.angle(data.angle)
        self.scatter = _Scatter.of(angle, data.torque)
        if data.tip is not None:
            self.tip_scatter = _Scatter.of(data.tip, angle)

    # -- unknowns ------------------------------------------------------------------------------------------------------

    def plant(self, x: Real) -> TwoInertia:
        """The plant of the unknowns: ln J_m, ln J_l, ln K_g, ln (D_g + D_l), D_m + D_l/N², and last D_l."""
        motor, arm, stiffness, damping = np.exp(x[:4]).tolist()
        arm_damping = float(x[6])
        return TwoInertia(
            self.ratio, motor, float(x[4]) - arm_damping / self.ratio**2, arm, arm_damping, stiffness, damping - arm_damping
        )

    def residual(self, x: Real) -> Real:
        """Residuals in standard deviations, real and imaginary parts, and that of the believed age."""
        plant, age = self.plant(x), float(x[5])
        data = self.data
        angle = self.angle(data.angle.mean(axis=0))
        torque = self.torque(age, data.torque.mean(axis=0), self.excitation)
        model = angle_response(plant, data.frequency_hz, self.gravity)
        left = [(angle - model * torque) / self.scatter.deviation(model * np.exp(self.jw * age))]
        if data.tip is not None:
            model = tip_response(plant, data.frequency_hz, self.lever_m * math.exp(x[7]), float(x[8]), self.gravity)
            left.append((data.tip.mean(axis=0) - model * angle) / self.tip_scatter.deviation(model))
        stacked = np.concatenate(left) * math.sqrt(2.0)  # σ² = E|e|²: half of it in either part
        believed = (age - 0.5 * self.timing.control_s) / DELAY_PRIOR_S
        return np.concatenate([stacked.real, stacked.imag, [believed]])


def angle_response(plant: TwoInertia, frequency_hz: Real, gravity_nm_rad: float = 0.0) -> Complex:
    """Motor angle per torque, θ_m/τ = (B' + c)/(A (B' + c) + B' c/N²) with B' = B + k; gravity as a spring k on the arm."""
    a, b, c = plant.terms(2j * math.pi * frequency_hz)
    b = b + gravity_nm_rad
    return np.asarray((b + c) / (a * (b + c) + b * c / plant.reduction_ratio**2))


def tip_response(
    plant: TwoInertia, frequency_hz: Real, lever_m: float, delay_s: float = 0.0, gravity_nm_rad: float = 0.0
) -> Complex:
    """Tip acceleration per motor angle, L s² θ_l/θ_m = L s² c/(N (B' + c)) e^{−jωδ}; gravity as in `angle_response`.

    Args:
        plant: The plant.
        frequency_hz: Frequencies; shape (m,).
        lever_m: Tip lever L.
        delay_s: Delay δ of the accelerometer.
        gravity_nm_rad: Spring constant k, dM/dθ_l of the gravity moment.
    """
    jw = 2j * math.pi * frequency_hz
    _, b, c = plant.terms(jw)
    return np.asarray(lever_m / plant.reduction_ratio * jw**2 * c / (b + gravity_nm_rad + c) * np.exp(-jw * delay_s))


def _reference_path(law: Cascade, jw: AnyComplex, control_s: float) -> Complex:
    """Torque per reference angle of the bilinear P-PI, held."""
    delay = np.exp(-jw * control_s)
    s = 2.0 / control_s * (1.0 - delay) / (1.0 + delay)
    pi = law.velocity_gain_nm_s_rad + law.velocity_integral_gain_nm_rad / s
    return np.asarray(pi * law.position_gain_per_s * (1.0 - delay) / (jw * control_s))


@dataclass(frozen=True)
class _Scatter:
    """Covariances of the mean of an output and an input over the periods, smoothed over neighbouring lines; shape (lines,).

    Attributes:
        output: Variance E|Δy|² of the output.
        given: Variance E|Δu|² of the input.
        both: Covariance E[Δy Δu*].
    """

    output: Real
    given: Real
    both: NDArray[Any]

    @classmethod
    def of(cls, output: Complex, given: Complex) -> "_Scatter":
        """Compute them from the spectra of the periods, shapes (periods, lines)."""
        out, put = output - output.mean(axis=0), given - given.mean(axis=0)
        count = len(out) * (len(out) - 1)
        power, other = np.sum(np.abs(out) ** 2, axis=0), np.sum(np.abs(put) ** 2, axis=0)
        return cls(_smooth(power) / count, _smooth(other) / count, _smooth(np.sum(out * put.conj(), axis=0)) / count)

    def deviation(self, gain: Complex) -> Real:
        """Standard deviation √E|Δy − G Δu|² for a gain G; shape (lines,).

        The deviation must follow the gain while that is fitted: under feedback a smaller G would leave less noise in the
        residual, and would be preferred for it.
        """
        variance = self.output + np.abs(gain) ** 2 * self.given - 2.0 * np.real(gain.conj() * self.both)
        return np.asarray(np.sqrt(np.maximum(variance, 1e-9 * self.output + 1e-300)))


def _smooth(values: NDArray[Any]) -> NDArray[Any]:
    """Moving average over neighbouring lines, narrower at the ends."""
    width = min(SMOOTHED_LINES, len(values))
    window = np.ones(width)
    return np.asarray(np.convolve(values, window, "same") / np.convolve(np.ones(len(values)), window, "same"))


def _first_guess(response: Complex, frequency_hz: Real, ratio: float) -> Real:
    """First guess of ln J_m, ln J_l, ln K_g, ln D_g, D_m from dip and peak of |P| ω²."""
    omega = 2.0 * math.pi * frequency_hz
    compliance = np.abs(response) * omega**2
    smooth = np.exp(np.convolve(np.pad(np.log(compliance), 1, "edge"), np.ones(3) / 3.0, "valid"))
    best: tuple[float, Real] | None = None
    order = np.argsort(smooth)[:8]
    for dip in order:
        if dip >= len(omega) - 3:
            continue
        peak = int(dip) + 1 + int(np.argmax(smooth[dip + 1 :]))
        w_a, w_r = omega[dip], omega[peak]
        shape = np.abs((1 - (omega / w_a) ** 2 + 0.06j * omega / w_a) / (1 - (omega / w_r) ** 2 + 0.06j * omega / w_r))
        whole = math.exp(float(np.median(np.log(shape / compliance))))
        error = float(np.median(np.abs(np.log(compliance * whole / shape))))
        if best is None or error < best[0]:
            motor = whole * (w_a / w_r) ** 2
            arm = ratio**2 * (whole - motor)
            stiffness = w_a**2 * arm
            guess = np.array([math.log(motor), math.log(arm), math.log(stiffness), math.log(0.08 * stiffness / w_a), 0.2 * whole])
            best = error, guess
    if best is None:
        raise UnidentifiableError("the response has no dip below the end of the band", 0.0, 1.0, "dip")
    return best[1]


def fit_plant(
    data: Spectra, timing: SamplingTiming, reduction_ratio: float, lever_m: float, gravity_nm_rad: float = 0.0
) -> PlantEstimate:
    """Fit J_m, J_l, K_g and the dampings by weighted nonlinear least squares on the excited lines.

    Minimises Σ |Ȳ* − P(jω) Ū*|²/σ²(P) over the lines, with σ from the scatter of both between periods, jointly with the age of
    the reported torque; with an accelerometer also Σ |Ā − g L s² c/(N (B + c)) e^{−jωδ_a} Ȳ*|²/σ_A²: its information on f_a
    and ζ needs neither torque nor lever, since its scale g and its delay δ_a are unknowns too. Standard errors are from the
    Jacobian, times the misfit where that is above 1.

    The data determine D_g + D_l, which damps the arm at f_a (ζ), and D_m + D_l/N², against which the motor turns: these are the
    unknowns, with D_l third. D_l alone shows only in how the damping differs between f_a and f_r, and through an
    accelerometer as a lead of D_l/K_g, 0.1 ms on the reference robot, which its delay hides.

    Args:
        data: Spectra of the main run's periods.
        timing: Sampling times, and the law inside the drive.
        reduction_ratio: Reduction ratio N.
        lever_m: Tip lever L of the bench file.
        gravity_nm_rad: Slope dM/dθ_l of the gravity moment over the stretch, which acts as a second spring on the arm.

    Raises:
        UnidentifiableError: There are fewer than three periods, too few lines, or no resonance in the response.
    """
    if data.periods < 3:
        raise UnidentifiableError("periods to average over", data.periods, 3)
    if len(data.frequency_hz) < 12:
        raise UnidentifiableError("excited lines", len(data.frequency_hz), 12)
    problem = _Problem(data, timing, reduction_ratio, lever_m, gravity_nm_rad)
    raw = problem.angle(data.angle.mean(axis=0)) / problem.torque(problem.age_s, data.torque.mean(axis=0), problem.excitation)
    x = np.concatenate([_first_guess(raw, data.frequency_hz, reduction_ratio), [problem.age_s, 0.0]])
    if data.tip is not None:
        x = np.concatenate([x, [0.0, 0.0]])
    fit: Any = None
    for _ in range(4):  # images and weights follow the plant; after two rounds nothing moves
        problem.find_images(problem.plant(x))
        problem.weigh()
        fit = _least_squares(problem, x)
        x = fit.x
        problem.age_s = float(x[5])
    problem.find_images(problem.plant(x))
    return _estimate(problem, x, np.asarray(fit.jac))


def _least_squares(problem: _Problem, x: Real) -> Any:
    scale = np.array([0.1, 0.1, 0.1, 0.3, max(1e-6, 0.3 * math.exp(x[0])), 1e-4, max(1e-6, 0.1 * math.exp(x[3])), 0.1, 1e-3])[
        : len(x)
    ]
    reach = np.full(len(x), np.inf)
    reach[[0, 1, 2, 3, *range(7, min(8, len(x)))]] = LARGEST_CHANGE  # logarithms
    bounds = x - reach, x + reach
    return optimize.least_squares(problem.residual, x, bounds=bounds, x_scale=scale, loss="soft_l1", f_scale=3.0)


def _estimate(problem: _Problem, x: Real, jacobian: Real) -> PlantEstimate:
    """The unknowns as parameters with errors."""
    left = problem.residual(x)[:-1]
    misfit = math.sqrt(float(np.sum(left**2)) / max(1, len(left) - len(x)))
    covariance = inverse(jacobian.T @ jacobian) * max(1.0, misfit) ** 2
    plant = problem.plant(x)

    def parameter(value: float, gradient: Mapping[int, float]) -> EstimatedParameter:
        slope = np.zeros(len(x))
        for unknown, part in gradient.items():
            slope[unknown] = part
        return EstimatedParameter(value, math.sqrt(max(0.0, float(slope @ covariance @ slope))))

    motor, arm, stiffness = plant.motor_inertia_kg_m2, plant.arm_inertia_kg_m2, plant.gear_stiffness_nm_rad
    damping, f_a, f_r = plant.gear_damping_nm_s_rad + plant.arm_damping_nm_s_rad, plant.antiresonance_hz, plant.resonance_hz
    zeta = 0.5 * damping / math.sqrt(stiffness * arm)
    arm_part = arm / (problem.ratio**2 * motor)
    arm_part = 0.5 * arm_part / (1.0 + arm_part)  # ∂ ln f_r/∂ ln J_l beyond that of f_a
    parameters = {
        "motor_inertia_kg_m2": parameter(motor, {0: motor}),
        "arm_inertia_kg_m2": parameter(arm, {1: arm}),
        "gear_stiffness_nm_rad": parameter(stiffness, {2: stiffness}),
        "gear_damping_nm_s_rad": parameter(plant.gear_damping_nm_s_rad, {3: damping, 6: -1.0}),
        "motor_damping_nm_s_rad": parameter(plant.motor_damping_nm_s_rad, {4: 1.0, 6: -1.0 / problem.ratio**2}),
        "arm_damping_nm_s_rad": parameter(plant.arm_damping_nm_s_rad, {6: 1.0}),
        "viscous_damping_nm_s_rad": parameter(float(x[4]), {4: 1.0}),
        "antiresonance_hz": parameter(f_a, {1: -0.5 * f_a, 2: 0.5 * f_a}),
        "resonance_hz": parameter(f_r, {0: -arm_part * f_r, 1: (arm_part - 0.5) * f_r, 2: 0.5 * f_r}),
        "damping": parameter(zeta, {1: -0.5 * zeta, 2: -0.5 * zeta, 3: zeta}),
        "torque_age_s": parameter(float(x[5]), {5: 1.0}),
    }
    tip = None
    data = problem.data
    angle = problem.angle(data.angle)
    if data.tip is not None:
        parameters["lever_ratio"] = parameter(math.exp(x[7]), {7: math.exp(x[7])})
        parameters["accelerometer_delay_s"] = parameter(float(x[8]), {8: 1.0})
        tip = _response(data.frequency_hz, data.tip, angle)
    torque = problem.torque(float(x[5]), data.torque, data.excitation)
    return PlantEstimate(plant, parameters, _response(data.frequency_hz, angle, torque), tip, misfit, data.periods)


def _response(frequency_hz: Real, output: Complex, given: Complex) -> ResponseEstimate:
    """Output per input with its scatter; both of shape (periods, lines)."""
    mean_in, count = given.mean(axis=0), len(given)
    value = output.mean(axis=0) / mean_in
    left = output - value * given
    scatter = np.sqrt(np.maximum(_smooth(np.sum(np.abs(left) ** 2, axis=0)) / (count * (count - 1)), 1e-300))
    deviation = scatter / np.abs(mean_in)
    explained, unexplained = np.abs(value * mean_in) ** 2, count * scatter**2
    bound = math.sqrt(float(stats.f.ppf(CONFIDENCE, 2, 2 * (count - 1))))
    return ResponseEstimate(frequency_hz, value, deviation, bound * deviation, explained / (explained + unexplained))
