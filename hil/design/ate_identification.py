"""The transmission error from ramps in both directions, with everything else that the data must tell: arm, delay, confidence.

The model is that of `hil.design.transmission_error`, seen by a sensor that lags the motor angle by Δ,

    y(t) = e^{−sΔ} (g H(s) [θ_m/N + Σ A_k cos(k θ_m + φ_k)]'' + J θ̈_m),

with y the tip acceleration, g the tip lever and J = 0; or, without an accelerometer, y the motor torque, g = J_l/N and J = J_m,
since what the motor feels of its gear is τ_g/N with τ_g = J_l H(s) [θ_m/N + θ_sync]'' (D_l = 0). Linear are A_k cos φ_k and
A_k sin φ_k; ω, ζ and Δ are refined around them. With an accelerometer nothing of the arm needs to be known but the lever.

Why both directions: turning backwards, φ_k appears with the opposite sign, while Δ and all phase of H keep theirs. One direction
cannot tell φ_k from a delay (4.3° for each millisecond at 12 Hz), two can. How much of the damping is the gear's (ζ_g) is such a
phase too: 1 + 2 ζ_g s/ω ≈ e^{2 ζ_g s/ω}. Believed wrongly it goes into Δ and not into φ_k.

Source: the paper, section 3.2.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft, optimize, signal

from hil.design.frequency import ARCSEC
from hil.design.transmission_error import RING_DOWN, TransmissionError, acceleration_spectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Signs = NDArray[np.int8]

SEARCH_HZ = (4.0, 35.0)
"""Where an unknown arm is looked for."""
SEARCH_DAMPING = (0.02, 0.05, 0.12)
DELAY_S = (-0.010, 0.030)
"""Delays that are looked for: half a period of the resonance more (42 ms at 12 Hz) looks like φ_k turned by 180°."""
BAND = (0.5, 2.1)
"""Pass band by the arm's frequency: the resonance with its skirts; below lies the motion itself, above lies noise."""
GEAR_SHARE = 0.9
"""ζ_g/ζ unless a plant tells it: most of the damping is the gear's. A tenth more or less is 0.2 ζ/ω in Δ, 0.1 ms, and no more."""
FLOOR = 0.02
"""Smallest ζ ω, as a share of ω, for which a transform is padded."""


@dataclass(frozen=True)
class Sweep:
    """Ramps as they were recorded, in one piece that begins and ends at rest.

    What happens between the ramps belongs to it: the arm still rings from there when the next one begins.

    Attributes:
        motor_angle_rad: θ_m, equally spaced; shape (n,).
        signal: The tip acceleration in m/s², or the motor torque in N·m, sampled with it; shape (n,).
        period_s: Sampling period.
        direction: +1 where the motor speeds up forwards, −1 backwards, 0 for samples that do not count; shape (n,).
    """

    motor_angle_rad: Real
    signal: Real
    period_s: float
    direction: Signs


@dataclass(frozen=True)
class Sensing:
    """What the ramps' signal is.

    Attributes:
        gain: g: the tip lever in m, or J_l/N in kg·m² for the motor torque.
        motor_inertia_kg_m2: J: 0 for the tip, J_m for the motor torque. Left free it would take A_k 5 % with it, since the
            motor moves as θ_sync makes it; 5 % wrong it changes A_k by 0.3 %.
    """

    gain: float
    motor_inertia_kg_m2: float = 0.0


@dataclass(frozen=True)
class Arm:
    """The arm on its gear and the sensor's delay.

    Attributes:
        resonance_hz: ω/2π.
        damping: ζ.
        delay_s: Δ.
        gear_share: ζ_g/ζ, believed.
    """

    resonance_hz: float
    damping: float
    delay_s: float = 0.0
    gear_share: float = GEAR_SHARE

    def response(self, frequency_hz: Real) -> Complex:
        """H(jω) e^{−jωΔ}; shape of `frequency_hz`."""
        x = np.asarray(frequency_hz) / self.resonance_hz
        late = np.exp(-2j * math.pi * frequency_hz * self.delay_s)
        return np.asarray((1.0 + 2j * self.gear_share * self.damping * x) / (1.0 + 2j * self.damping * x - x**2) * late)


@dataclass(frozen=True)
class Agreement:
    """One number as either direction alone gives it, at the arm and delay of both together.

    Attributes:
        name: `a2_arcsec`, `phi2_deg` …
        forward: With the motor turning forwards.
        backward: Backwards.
        sigma: Their difference over its standard error.
    """

    name: str
    forward: float
    backward: float
    sigma: float


@dataclass(frozen=True)
class JointEstimate:
    """What ramps in both directions gave.

    The standard errors suppose that what the model leaves over is noise, flat over the band; where the two directions differ
    by more than that explains, they have been widened until it does. They know nothing of a wrong lever arm, which goes
    straight into A_k, nor of a wrong zero of the motor angle, which goes into φ_k.

    Attributes:
        error: A_k and φ_k (0 ≤ φ_k < 360°).
        amplitude_error_arcsec: Standard error of A_k by order.
        phase_error_deg: Standard error of φ_k by order.
        arm: ω, ζ and Δ.
        arm_error: Their standard errors.
        residual: Root mean square of what is left over in the band, in the signal's unit.
        explained: Share of the signal's band-passed power that the model explains, 0 … 1.
        explained_by_error: Share by which θ_sync lowers what is left over without it.
        motion_scale: Factor that the motor's own motion has in the signal, 1 where N and g are right; found beside the rest.
        motion_scale_error: Its standard error.
        agreement: The two directions against each other.
        widened: By what the standard errors have been multiplied.
        band_hz: The band.
    """

    error: TransmissionError
    amplitude_error_arcsec: Mapping[int, float]
    phase_error_deg: Mapping[int, float]
    arm: Arm
    arm_error: Arm
    residual: float
    explained: float
    explained_by_error: float
    motion_scale: float
    motion_scale_error: float
    agreement: tuple[Agreement, ...]
    widened: float
    band_hz: tuple[float, float]


class _SweepProblem:
    """One recording: transforms once, then one inverse transform for each arm."""

    def __init__(
        self, sweep: Sweep, reduction_ratio: float, sensing: Sensing, orders: Sequence[int], band_hz: tuple[float, float]
    ) -> None:
        angle, period_s = sweep.motor_angle_rad, sweep.period_s
        # nothing passes beyond four times the band, so every n-th sample says all
        self._every = max(1, int(0.5 / period_s / (4.0 * band_hz[1])))
        self.direction = sweep.direction[:: self._every]
        self._rows, self._count = self.direction != 0, len(self.direction)
        ring_down = round(min(RING_DOWN / (FLOOR * 2.0 * math.pi * band_hz[0]), 4.0) / period_s)
        self._length = int(fft.next_fast_len(-(-(len(angle) + ring_down) // self._every), real=True))
        full = self._length * self._every
        waves = [angle / reduction_ratio]
        for order in orders:  # A cos(kθ + φ) = (A cos φ) cos kθ − (A sin φ) sin kθ
            waves += [np.cos(order * angle), -np.sin(order * angle)]
        frequency, spectra = acceleration_spectrum(np.stack(waves), period_s, full)
        band = signal.butter(2, band_hz, "bandpass", fs=1.0 / period_s, output="sos")
        _, gain = signal.sosfreqz(band, frequency, fs=1.0 / period_s)
        weight = np.abs(gain) ** 2  # forward and backward: no phase
        inside = slice(0, self._length // 2)
        self._frequency = frequency[inside]
        self._spectra = sensing.gain * weight[inside] * spectra[:, inside]
        inertia = sensing.motor_inertia_kg_m2 * reduction_ratio  # the first spectrum is that of θ̈_m/N
        self._own = inertia * weight[inside] * spectra[0, inside]
        self.share = self._every * float(np.mean(weight**2))  # of white noise that comes through: of samples that are independent
        self.signal = self._samples(weight[inside] * fft.rfft(_level(sweep.signal), full)[inside])

    def _samples(self, spectra: Complex) -> Real:
        """Spectra as samples in the rows that count."""
        found = fft.irfft(spectra, self._length, axis=-1) / self._every
        return np.asarray(found[..., : self._count][..., self._rows], dtype=np.float64)

    def columns(self, arm: Arm) -> tuple[Real, Real]:
        """What the motor's motion gives by itself (n,), and what a unit of each linear unknown does (n, unknowns)."""
        spectra = self._spectra * arm.response(self._frequency)
        spectra[0] += self._own * np.exp(-2j * math.pi * self._frequency * arm.delay_s)
        found = self._samples(spectra)
        return found[0], found[1:].T


def _level(values: Real, edge: int = 16) -> Real:
    """Less the straight line from its beginning to its end: gravity's share, which would be a blow where a record is cut off."""
    few = min(edge, len(values))
    return np.asarray(values - np.linspace(float(np.mean(values[:few])), float(np.mean(values[-few:])), len(values)))


class _Problem:
    """Several ramps at once."""

    def __init__(
        self,
        sweeps: Sequence[Sweep],
        reduction_ratio: float,
        sensing: Sensing,
        orders: tuple[int, ...],
        band_hz: tuple[float, float],
    ) -> None:
        self._parts = [_SweepProblem(sweep, reduction_ratio, sensing, orders, band_hz) for sweep in sweeps]
        self.directions = np.concatenate([part.direction[part.direction != 0] for part in self._parts])
        self.signal = np.concatenate([part.signal for part in self._parts])
        self.share = float(np.mean([part.share for part in self._parts]))
        self.orders, self.band_hz = orders, band_hz

    def columns(self, arm: Arm) -> tuple[Real, Real]:
        """As those of the parts, one behind the other."""
        found = [part.columns(arm) for part in self._parts]
        return np.concatenate([motion for motion, _ in found]), np.concatenate([matrix for _, matrix in found])

    def solve(self, arm: Arm) -> tuple[Real, Real]:
        """The linear unknowns, and the residual."""
        motion, matrix = self.columns(arm)
        unknowns = _least_squares(matrix, self.signal - motion)
        return unknowns, self.signal - motion - matrix @ unknowns

    def power_apart(self, arm: Arm) -> float:
        """What is left over where each direction may have its own amplitudes and phases, and so hides a delay."""
        motion, matrix = self.columns(arm)
        total = 0.0
        for direction in (1, -1):
            rows = self.directions == direction
            if rows.any():
                wanted = (self.signal - motion)[rows]
                total += float(np.sum((wanted - matrix[rows] @ _least_squares(matrix[rows], wanted)) ** 2))
        return total

    def power(self, arm: Arm) -> float:
        """What is left over."""
        return float(np.sum(self.solve(arm)[1] ** 2))


def _least_squares(matrix: Real, wanted: Real) -> Real:
    """By normal equations on scaled columns: half a dozen well-separated unknowns, tens of thousands of rows."""
    scale = np.sqrt(np.sum(matrix**2, axis=0)) + 1e-300
    scaled = matrix / scale
    return np.asarray(np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True) @ (scaled.T @ wanted) / scale)


def identify(
    sweeps: Sequence[Sweep],
    reduction_ratio: float,
    sensing: Sensing,
    start: Arm | None = None,
    orders: Sequence[int] = (2, 4),
) -> JointEstimate:
    """A_k and φ_k, the arm and the sensor's delay from ramps in both directions.

    Args:
        sweeps: With at least one ramp in each direction, through the resonance with every order.
        reduction_ratio: N.
        sensing: What their signal is.
        start: An arm to start from beside those that are looked for over `SEARCH_HZ`; it may be wrong.
        orders: k.

    Raises:
        ValueError: A direction is missing or too short, or shapes differ.

    Source: the paper, section 3.2.
    """
    _check(sweeps, tuple(orders))
    found = _search(sweeps, reduction_ratio, sensing, tuple(orders), start)
    for _ in range(2):  # the band follows the arm
        problem = _problem_around(sweeps, reduction_ratio, sensing, tuple(orders), found.resonance_hz)
        found = _refine(problem, found)
    return _estimate(problem, found)


def modelled(sweep: Sweep, reduction_ratio: float, sensing: Sensing, arm: Arm, error: TransmissionError) -> Real:
    """The signal that the model predicts over a whole recording, without gravity's share; shape (n,)."""
    angle, period_s = np.asarray(sweep.motor_angle_rad, dtype=np.float64), sweep.period_s
    waves = np.stack([angle / reduction_ratio + error.angle_rad(angle), angle])
    length = int(
        fft.next_fast_len(len(angle) + round(RING_DOWN / (FLOOR * 2.0 * math.pi * arm.resonance_hz) / period_s), real=True)
    )
    frequency, (driven, own) = acceleration_spectrum(waves, period_s, length)
    late = np.exp(-2j * math.pi * frequency * arm.delay_s)
    spectrum = sensing.gain * driven * arm.response(frequency) + sensing.motor_inertia_kg_m2 * own * late
    return np.asarray(fft.irfft(spectrum, length)[: len(angle)])


def _check(sweeps: Sequence[Sweep], orders: tuple[int, ...]) -> None:
    for sweep in sweeps:
        shapes = {np.shape(sweep.motor_angle_rad), np.shape(sweep.signal), np.shape(sweep.direction)}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise ValueError(f"motor angle, signal and direction have shapes {sorted(shapes)}; all must be the same (n,)")
    needed = 0.15 * (2 * len(orders) + 3)
    for direction, word in ((1, "forwards"), (-1, "backwards")):
        seconds = sum(float(np.count_nonzero(sweep.direction == direction)) * sweep.period_s for sweep in sweeps)
        if seconds < needed:
            raise ValueError(
                f"{seconds:.2f} s of ramps {word} cannot give {2 * len(orders) + 3} numbers; {needed:.2f} s are needed"
            )


def _problem_around(
    sweeps: Sequence[Sweep], reduction_ratio: float, sensing: Sensing, orders: tuple[int, ...], frequency_hz: float
) -> _Problem:
    top = 0.4 / max(sweep.period_s for sweep in sweeps)
    band = (BAND[0] * frequency_hz, min(BAND[1] * frequency_hz, top))
    return _Problem(sweeps, reduction_ratio, sensing, orders, band)


def _search(sweeps: Sequence[Sweep], reduction_ratio: float, sensing: Sensing, orders: tuple[int, ...], start: Arm | None) -> Arm:
    """The arm over a grid, first with the directions apart, in which a delay does no harm; then the delay over another."""
    top = 0.3 / max(sweep.period_s for sweep in sweeps)
    low, high = SEARCH_HZ[0], min(SEARCH_HZ[1], top)
    problem = _Problem(sweeps, reduction_ratio, sensing, orders, (0.8 * low, min(1.2 * high, 1.2 * top)))
    share = GEAR_SHARE if start is None else start.gear_share
    arms = [Arm(float(f), zeta, 0.0, share) for f in np.geomspace(low, high, 56) for zeta in SEARCH_DAMPING]
    if start is not None:
        arms.append(replace(start, delay_s=0.0))
    best = min(arms, key=problem.power_apart)
    problem = _problem_around(sweeps, reduction_ratio, sensing, orders, best.resonance_hz)
    fine = [
        replace(best, resonance_hz=best.resonance_hz * float(f), damping=best.damping * z)
        for f in np.linspace(0.96, 1.04, 9)
        for z in (0.6, 1.0, 1.6)
    ]
    best = min(fine, key=problem.power_apart)
    delays = [replace(best, delay_s=float(delay)) for delay in np.arange(DELAY_S[0], DELAY_S[1] + 1e-9, 2e-3)]
    return min(delays, key=problem.power)


def _refine(problem: "_Problem | _WithFreeMotion", start: Arm) -> Arm:
    """Gauss-Newton in ω, ζ and Δ with the linear unknowns projected out."""
    step_s = 1.0 / (2.0 * math.pi * start.resonance_hz)

    def arm(scaled: Real) -> Arm:
        hz, damping, late = (float(value) for value in scaled)
        return Arm(start.resonance_hz * hz, start.damping * damping, start.delay_s + step_s * late, start.gear_share)

    def residual(scaled: Real) -> Real:
        return problem.solve(arm(scaled))[1]

    found = optimize.least_squares(
        residual,
        np.array([1.0, 1.0, 0.0]),
        bounds=([0.8, 0.1, -1.0], [1.25, 10.0, 1.0]),
        x_scale=np.array([0.01, 0.3, 0.05]),
        diff_step=np.full(3, 1e-4),
    )
    return arm(found.x)


def _estimate(problem: _Problem, arm: Arm) -> JointEstimate:
    """The unknowns as amplitudes and phases, with errors from the Jacobian of all unknowns."""
    unknowns, left = problem.solve(arm)
    motion, matrix = problem.columns(arm)
    jacobian = np.column_stack([matrix, *_slopes(problem, arm, unknowns)])
    power = float(np.sum(left**2))
    variance = power / max(1.0, len(left) * problem.share - jacobian.shape[1])
    covariance = _inverse(jacobian) * variance
    agreement = _agreement(problem, arm, left, variance)
    chi2 = sum(each.sigma**2 for each in agreement) / max(1, len(agreement))
    widened = math.sqrt(max(1.0, chi2))
    amplitude, phase, amplitude_error, phase_error = _polar(unknowns, covariance * widened**2, problem.orders)
    arm_error = widened * np.sqrt(np.maximum(0.0, np.diag(covariance)[-3:]))
    without = problem.signal - motion
    scale, scale_error = _motion_scale(problem, arm)
    return JointEstimate(
        TransmissionError(amplitude, phase),
        amplitude_error,
        phase_error,
        arm,
        Arm(*(float(value) for value in arm_error)),
        math.sqrt(power / len(left)),
        1.0 - power / max(float(np.sum(problem.signal**2)), 1e-300),
        1.0 - power / max(float(np.sum(without**2)), 1e-300),
        scale,
        scale_error,
        agreement,
        widened,
        problem.band_hz,
    )


class _WithFreeMotion:
    """A problem in which the motor's own motion may show other than it should: one more linear unknown, the last."""

    def __init__(self, problem: _Problem) -> None:
        self._problem, self.signal = problem, problem.signal

    def columns(self, arm: Arm) -> tuple[Real, Real]:
        """No motion that is given, and the columns of the unknowns."""
        motion, matrix = self._problem.columns(arm)
        return np.zeros_like(motion), np.column_stack([matrix, motion])

    def solve(self, arm: Arm) -> tuple[Real, Real]:
        """The linear unknowns, and the residual."""
        _, matrix = self.columns(arm)
        unknowns = _least_squares(matrix, self.signal)
        return unknowns, self.signal - matrix @ unknowns


def _motion_scale(problem: _Problem, arm: Arm) -> tuple[float, float]:
    """How strongly the motor's own motion shows, the arm refined anew: with a wrong one it bends ω and ζ until it fits."""
    free = _WithFreeMotion(problem)
    best = _refine(free, _refine(free, replace(arm, damping=max(arm.damping, 0.01))))
    unknowns, left = free.solve(best)
    jacobian = np.column_stack([free.columns(best)[1], *_slopes(free, best, unknowns)])
    variance = float(np.sum(left**2)) / max(1.0, len(left) * problem.share - jacobian.shape[1])
    place = len(unknowns) - 1
    return float(unknowns[place]), math.sqrt(max(0.0, float(_inverse(jacobian)[place, place])) * variance)


def _slopes(problem: _Problem | _WithFreeMotion, arm: Arm, unknowns: Real) -> list[Real]:
    """What the model does per unit of ω/2π, ζ and Δ."""
    found = []
    for d_hz, d_zeta, d_s in ((1e-4 * arm.resonance_hz, 0.0, 0.0), (0.0, 1e-3 * arm.damping, 0.0), (0.0, 0.0, 1e-5)):
        sides = []
        for sign in (1.0, -1.0):
            motion, matrix = problem.columns(
                replace(
                    arm,
                    resonance_hz=arm.resonance_hz + sign * d_hz,
                    damping=arm.damping + sign * d_zeta,
                    delay_s=arm.delay_s + sign * d_s,
                )
            )
            sides.append(motion + matrix @ unknowns)
        found.append((sides[0] - sides[1]) / (2.0 * (d_hz + d_zeta + d_s)))
    return found


def _inverse(jacobian: Real) -> Real:
    """(JᵀJ)⁻¹, on scaled columns."""
    scale = np.sqrt(np.sum(jacobian**2, axis=0)) + 1e-300
    scaled = jacobian / scale
    return np.asarray(np.linalg.pinv(scaled.T @ scaled, rcond=1e-14, hermitian=True) / np.outer(scale, scale))


def _polar(
    unknowns: Real, covariance: Real, orders: tuple[int, ...]
) -> tuple[dict[int, float], dict[int, float], dict[int, float], dict[int, float]]:
    """A_k in arcsec, φ_k in degrees, and the standard errors of both."""
    amplitude, phase, amplitude_error, phase_error = {}, {}, {}, {}
    for place, order in enumerate(orders):
        x, y = float(unknowns[2 * place]), float(unknowns[2 * place + 1])
        size = max(math.hypot(x, y), 1e-30)
        block = covariance[2 * place : 2 * place + 2, 2 * place : 2 * place + 2]
        along, across = np.array([x, y]) / size, np.array([-y, x]) / size
        amplitude[order] = math.hypot(x, y) / ARCSEC
        phase[order] = math.degrees(math.atan2(y, x)) % 360.0
        amplitude_error[order] = math.sqrt(max(0.0, float(along @ block @ along))) / ARCSEC
        phase_error[order] = min(180.0, math.degrees(math.sqrt(max(0.0, float(across @ block @ across))) / size))
    return amplitude, phase, amplitude_error, phase_error


def _agreement(problem: _Problem, arm: Arm, left: Real, variance: float) -> tuple[Agreement, ...]:
    """A_k and φ_k of each direction alone."""
    motion, matrix = problem.columns(arm)
    sides = []
    for direction in (1, -1):
        rows = problem.directions == direction
        own = matrix[rows]
        sides.append(_polar(_least_squares(own, (problem.signal - motion)[rows]), _inverse(own) * variance, problem.orders))
    (forward_a, forward_p, forward_ea, forward_ep), (backward_a, backward_p, backward_ea, backward_ep) = sides
    found = []
    for order in problem.orders:
        difference = forward_a[order] - backward_a[order]
        error = math.hypot(forward_ea[order], backward_ea[order])
        found.append(Agreement(f"a{order}_arcsec", forward_a[order], backward_a[order], abs(difference) / max(error, 1e-30)))
        turn = (forward_p[order] - backward_p[order] + 180.0) % 360.0 - 180.0
        error = math.hypot(forward_ep[order], backward_ep[order])
        found.append(Agreement(f"phi{order}_deg", forward_p[order], backward_p[order], abs(turn) / max(error, 1e-30)))
    return tuple(found)
