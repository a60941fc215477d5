"""Transmission error from motor angle and tip acceleration.

Both are recorded in one constant-acceleration run.

Given the measured motor angle θ_m, the arm's motion follows without any knowledge of the controller,

    a_l = H(s) [θ_m/N + θ_sync(θ_m)]'',   H(s) = (2 ζ_g ω s + ω²)/(s² + 2 ζ ω s + ω²),

H being the arm on its gear with the motor held: ω² = K_g/J_l, 2 ζ_g ω = D_g/J_l, 2 ζ ω = (D_g + D_l)/J_l. θ_sync is linear in
A_k cos φ_k and A_k sin φ_k, so for a given H it comes from one linear least-squares problem, all orders jointly (k = 2 alone
biases A₂ by a quarter, since the two lines share the resonance). ω and ζ are refined around that.

Source: the paper, section 3.2, eq. (1) to (3), which gives the idea (tip acceleration of a constant-acceleration run) and the
results, not the method.
"""

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.control.angles import ARCSEC
from hil.design.frequency import TwoInertia

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Rows = NDArray[np.bool_]

PAPER_ORDERS = (2, 4)
"""Orders of eq. (2)."""
DEFAULT_BAND_HZ = (6.0, 25.0)
"""The resonance near 12 Hz with its skirts: below lies the motion itself, above lies noise."""

SMOOTHED = 5.0
"""Samples over which the motor speed is smoothed."""
SHOWN = (0.42, 0.5)
"""Frequencies over the sampling rate between which a wave fades out: up to half of it, gradually, since a jump shakes the arm."""
RING_DOWN = 6.0
"""Time constants of the arm on its gear for which the transform is padded, so that its end does not wrap into its beginning."""


@dataclass(frozen=True)
class TransmissionError:
    """Transmission error θ_sync = Σ A_k cos(k θ_m + φ_k), eq. (2).

    Attributes:
        amplitude_arcsec: Amplitude A_k by order k.
        phase_deg: Phase φ_k by order k.
    """

    amplitude_arcsec: Mapping[float, float]
    phase_deg: Mapping[float, float]

    def angle_rad(self, motor_angle_rad: Real) -> Real:
        """Error θ_sync in rad at the arm; shape of `motor_angle_rad`."""
        angle = np.asarray(motor_angle_rad, dtype=np.float64)
        total = np.zeros_like(angle)
        for order, amplitude in self.amplitude_arcsec.items():
            total += amplitude * ARCSEC * np.cos(order * angle + math.radians(self.phase_deg[order]))
        return total


@dataclass(frozen=True)
class TransmissionErrorEstimate:
    """Result of a fit, with its standard errors.

    The errors suppose that the residual of the model is noise, flat over the band. They do not cover a wrong lever arm, which
    goes straight into A_k, nor a wrong zero of the motor angle, which goes into φ_k.

    Attributes:
        error: Transmission error with A_k and φ_k (0 ≤ φ_k < 360°).
        amplitude_error_arcsec: Standard error of A_k by order.
        phase_error_deg: Standard error of φ_k by order.
        resonance_hz: Refined resonance ω/2π.
        damping: Refined damping ratio ζ.
        residual_m_s2: Root mean square of the residual in the band, at the tip.
        explained: Fraction of the tip's band-passed power that the model explains, 0 … 1, the motor's own motion included.
    """

    error: TransmissionError
    amplitude_error_arcsec: Mapping[float, float]
    phase_error_deg: Mapping[float, float]
    resonance_hz: float
    damping: float
    residual_m_s2: float
    explained: float


@dataclass(frozen=True)
class _Arm:
    """Response H(s) of the arm on its gear.

    `gear_fraction` is ζ_g/ζ, held while ζ is refined.
    """

    omega_rad_s: float
    zeta: float
    gear_fraction: float

    @classmethod
    def of(cls, model: TwoInertia) -> "_Arm":
        omega = math.sqrt(model.gear_stiffness_nm_rad / model.arm_inertia_kg_m2)
        damping = model.gear_damping_nm_s_rad + model.arm_damping_nm_s_rad
        zeta = 0.5 * damping / (model.arm_inertia_kg_m2 * omega)
        return cls(omega, zeta, model.gear_damping_nm_s_rad / damping if damping > 0.0 else 1.0)

    def response(self, frequency_hz: Real) -> Complex:
        """Response H(jω); shape of `frequency_hz`."""
        s = 2j * math.pi * frequency_hz
        through = 2.0 * self.gear_fraction * self.zeta * self.omega_rad_s * s + self.omega_rad_s**2
        return np.asarray(through / (s**2 + 2.0 * self.zeta * self.omega_rad_s * s + self.omega_rad_s**2))

    def padded(self, count: int, period_s: float) -> int:
        """Length of the transform with room for the ring-down."""
        decay = max(self.zeta * self.omega_rad_s, 0.2)
        return int(scipy.fft.next_fast_len(count + round(RING_DOWN / decay / period_s), real=True))


def acceleration_spectrum(angle_rad: Real, period_s: float, length: int) -> tuple[Real, Complex]:
    """Spectrum of the second derivative of sampled angles.

    Returns the frequencies, shape (m,), and the transform, shape (..., m).

    The second difference of a sampled sine is its second derivative times (sin(ωT/2)/(ωT/2))²; the division by that makes it
    exact for everything below half the sampling rate. A difference, not jω of the angle itself, since the angle of a motor that
    has turned does not come back to where it began, while its acceleration does. Before the first and after the last sample the
    speed is taken to stay what it is: a recording that was cut off while the motor turned must not end in a blow.
    """
    difference = np.zeros_like(angle_rad)
    difference[..., 1:-1] = np.diff(angle_rad, 2, axis=-1) / period_s**2
    frequency = scipy.fft.rfftfreq(length, period_s)
    return frequency, scipy.fft.rfft(difference, length, axis=-1) / np.sinc(frequency * period_s) ** 2


def motor_speed_rps(motor_angle_rad: Real, period_s: float) -> Real:
    """Smoothed motor speed f_m, with its sign; of the angle's shape, and 0 for a single sample."""
    if len(motor_angle_rad) < 2:
        return np.zeros(len(motor_angle_rad))
    speed = np.gradient(motor_angle_rad, period_s) / (2.0 * np.pi)
    return np.asarray(scipy.ndimage.gaussian_filter1d(speed, SMOOTHED))


def shown_fraction(over_rate: Real) -> Real:
    """Fraction of a wave that its samples are taken to show, by its frequency over their rate; shape of `over_rate`."""
    low, high = SHOWN
    return np.asarray(np.clip((high - np.abs(over_rate)) / (high - low), 0.0, 1.0))


def shown_waves(motor_angle_rad: Real, period_s: float, orders: Sequence[float]) -> Real:
    """Cos kθ_m and −sin kθ_m of each order; shape (2·orders, n).

    A_k cos(kθ + φ_k) = (A_k cos φ_k) cos kθ − (A_k sin φ_k) sin kθ. Samples show a wave beyond half of the sampling rate at
    another frequency, at which the arm would answer it: such a wave fades out before.
    """
    speed, waves = motor_speed_rps(motor_angle_rad, period_s), []
    for order in orders:
        there = shown_fraction(order * speed * period_s)
        waves += [there * np.cos(order * motor_angle_rad), -there * np.sin(order * motor_angle_rad)]
    return np.array(waves).reshape(len(waves), len(motor_angle_rad))


def shown_error(error: TransmissionError, motor_angle_rad: Real, period_s: float) -> Real:
    """Error θ_sync in rad at the arm, of waves as their samples show them; of the angle's shape."""
    waves = shown_waves(motor_angle_rad, period_s, tuple(error.amplitude_arcsec))
    sizes = [cmath.rect(error.amplitude_arcsec[k] * ARCSEC, math.radians(error.phase_deg[k])) for k in error.amplitude_arcsec]
    return np.asarray(np.array([part for size in sizes for part in (size.real, size.imag)]) @ waves)


def arm_response(
    model: TwoInertia,
    motor_angle_rad: Real,
    period_s: float,
    lever_m: float,
    error: TransmissionError,
    *,
    resonance_hz: float | None = None,
    damping: float | None = None,
) -> Real:
    """Predict the tip acceleration L a_l from the motor angle, in m/s².

    Shape of `motor_angle_rad`.

    a_l = H(s) [θ_m/N + θ_sync(θ_m)]'' as in the module's docstring; the arm does not vibrate before the first sample. Gravity and
    the other axes are left out: they move slowly, below the band of the resonance.

    Args:
        model: The axis.
        motor_angle_rad: Motor angle θ_m, equally spaced; shape (n,).
        period_s: Sampling period of the angle.
        lever_m: Lever L from the axis to the tip.
        error: Transmission error θ_sync.
        resonance_hz: Resonance ω/2π of the arm on its gear, where it is known better than from the model.
        damping: Damping ratio ζ, likewise.
    """
    arm = _Arm.of(model)
    omega = arm.omega_rad_s if resonance_hz is None else 2.0 * math.pi * resonance_hz
    arm = _Arm(omega, arm.zeta if damping is None else damping, arm.gear_fraction)
    angle = np.asarray(motor_angle_rad, dtype=np.float64)
    driven = angle / model.reduction_ratio + shown_error(error, angle, period_s)
    length = arm.padded(len(angle), period_s)
    frequency, spectrum = acceleration_spectrum(driven, period_s, length)
    return np.asarray(lever_m * scipy.fft.irfft(spectrum * arm.response(frequency), length)[: len(angle)])


class _Problem:
    """Least-squares problem of the fit.

    The transforms are computed once, then one inverse transform for each ω and ζ.
    """

    def __init__(
        self, angle: Real, tip: Real, period_s: float, model: TwoInertia, lever_m: float,
        orders: Sequence[float], band_hz: tuple[float, float], rows: Rows,
    ) -> None:  # fmt: skip
        self.arm, self._rows, self._count = _Arm.of(model), rows, len(angle)
        self._length = self.arm.padded(self._count, period_s)
        waves = np.vstack([angle / model.reduction_ratio, shown_waves(angle, period_s, orders)])
        self._frequency, spectra = acceleration_spectrum(waves, period_s, self._length)
        band = scipy.signal.butter(2, band_hz, "bandpass", fs=1.0 / period_s, output="sos")
        _, gain = scipy.signal.sosfreqz(band, self._frequency, fs=1.0 / period_s)
        weight = np.abs(gain) ** 2  # forward and backward: no phase
        self._spectra = lever_m * weight * spectra
        self.tip = scipy.fft.irfft(weight * scipy.fft.rfft(tip, self._length), self._length)[: self._count][rows]
        # the fraction of white noise that comes through, hence of the samples that are independent
        self.independent = float(np.mean(weight**2))

    def columns(self, omega: float, zeta: float) -> tuple[Real, Real]:
        """Columns of the tip acceleration.

        Returns that of the motor's own motion, shape (n,), and that per unit of each unknown, shape (n, 2·orders).
        """
        response = _Arm(omega, zeta, self.arm.gear_fraction).response(self._frequency)
        rows = scipy.fft.irfft(self._spectra * response, self._length)[:, : self._count][:, self._rows]
        return rows[0], rows[1:].T

    def solve(self, omega: float, zeta: float) -> tuple[Real, Real]:
        """Solve for the unknowns.

        Returns them in rad, shape (2·orders,), and the residual in m/s², shape (n,).
        """
        motion, matrix = self.columns(omega, zeta)
        unknowns = np.asarray(np.linalg.lstsq(matrix, self.tip - motion, rcond=None)[0], dtype=np.float64)
        return unknowns, self.tip - motion - matrix @ unknowns


def fit_transmission_error(
    motor_angle_rad: Real,
    tip_acceleration_m_s2: Real,
    period_s: float,
    model: TwoInertia,
    lever_m: float,
    orders: Sequence[float] = PAPER_ORDERS,
    band_hz: tuple[float, float] = DEFAULT_BAND_HZ,
    rows: Rows | None = None,
) -> TransmissionErrorEstimate:
    """Fit A_k and φ_k to one constant-acceleration run without a notch.

    Minimises Σ (B [tip − L H s² (θ_m/N + Σ A_k cos(k θ_m + φ_k))])² over the rows, with B the same band-pass (2nd-order
    Butterworth, forward and backward) on both sides: linear in A_k cos φ_k and A_k sin φ_k jointly, and in an
    outer Gauss-Newton (variable projection) in ω and ζ, which start from the model. Sample i of the motor angle and of the
    tip acceleration must belong to the same instant: every millisecond between them turns φ by 4.3° at 12 Hz.

    For the accuracy on the reference robot see docs/theory-transmission-error.md.

    Args:
        motor_angle_rad: Motor angle θ_m; shape (n,).
        tip_acceleration_m_s2: Vertical tip acceleration at the same instants; shape (n,).
        period_s: Sampling period of both.
        model: The axis; N and J_l are taken as true, ω and ζ start the refinement.
        lever_m: Lever L; its relative error is that of A_k.
        orders: Orders k of the error.
        band_hz: Pass band of B.
        rows: Mask or slice of the samples that count; all of them by default. Those of a ramp through the resonances carry the
            information.

    Raises:
        ValueError: The shapes differ, or there are fewer rows than the fit needs.

    Source: the paper, section 3.2.
    """
    angle = np.asarray(motor_angle_rad, dtype=np.float64)
    tip = np.asarray(tip_acceleration_m_s2, dtype=np.float64)
    if angle.ndim != 1 or angle.shape != tip.shape:
        raise ValueError(f"motor angle and tip acceleration have shapes {angle.shape} and {tip.shape}; both must be (n,)")
    mask = np.ones(len(angle), dtype=np.bool_) if rows is None else np.asarray(rows, dtype=np.bool_)
    if mask.shape != angle.shape:
        raise ValueError(f"rows have shape {mask.shape}, the samples {angle.shape}")
    unknown_count = 2 * len(orders) + 2
    needed = round(2.0 * unknown_count / (2.0 * period_s * (band_hz[1] - band_hz[0])))
    if np.count_nonzero(mask) < needed:
        raise ValueError(
            f"{np.count_nonzero(mask)} samples are too few to identify {unknown_count} values; at least {needed} are needed"
        )
    problem = _Problem(angle, tip, period_s, model, lever_m, orders, band_hz, mask)
    start = problem.arm

    def residual(scale: Real) -> Real:
        return problem.solve(start.omega_rad_s * float(scale[0]), start.zeta * float(scale[1]))[1]

    # in units of the model's own values; further away than this the model is not of this axis
    fit = scipy.optimize.least_squares(
        residual, np.ones(2), bounds=([0.7, 0.1], [1.4, 8.0]), x_scale=np.array([0.01, 0.3]), diff_step=np.full(2, 1e-4)
    )
    omega, zeta = start.omega_rad_s * float(fit.x[0]), start.zeta * float(fit.x[1])
    return _estimate(problem, omega, zeta, tuple(orders))


def _estimate(problem: _Problem, omega: float, zeta: float, orders: tuple[float, ...]) -> TransmissionErrorEstimate:
    """Convert the unknowns to amplitudes and phases, with errors.

    The errors come from the Jacobian of all unknowns, ω and ζ included.
    """
    unknowns, left = problem.solve(omega, zeta)
    _, matrix = problem.columns(omega, zeta)
    slopes = []
    for step in ((1e-4 * omega, 0.0), (0.0, 1e-3 * zeta)):
        sides = []
        for sign in (1.0, -1.0):
            motion, other = problem.columns(omega + sign * step[0], zeta + sign * step[1])
            sides.append(motion + other @ unknowns)
        slopes.append((sides[0] - sides[1]) / (2.0 * sum(step)))
    jacobian = np.column_stack([matrix, *slopes])
    power = float(np.sum(left**2))
    independent = max(1.0, len(left) * problem.independent - jacobian.shape[1])
    covariance = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True) * power / independent
    amplitude, phase, amplitude_error, phase_error = {}, {}, {}, {}
    for row, order in enumerate(orders):
        x, y = float(unknowns[2 * row]), float(unknowns[2 * row + 1])
        size = math.hypot(x, y)
        block = covariance[2 * row : 2 * row + 2, 2 * row : 2 * row + 2]
        along, across = np.array([x, y]) / max(size, 1e-30), np.array([-y, x]) / max(size, 1e-30)
        amplitude[order] = size / ARCSEC
        phase[order] = math.degrees(math.atan2(y, x)) % 360.0
        amplitude_error[order] = math.sqrt(max(0.0, float(along @ block @ along))) / ARCSEC
        phase_error[order] = math.degrees(math.sqrt(max(0.0, float(across @ block @ across))) / max(size, 1e-30))
    return TransmissionErrorEstimate(
        TransmissionError(amplitude, phase),
        amplitude_error,
        phase_error,
        omega / (2.0 * math.pi),
        zeta,
        math.sqrt(power / len(left)),
        1.0 - power / max(float(np.sum(problem.tip**2)), 1e-300),
    )
