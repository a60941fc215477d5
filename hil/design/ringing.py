"""Resonance of an arm from one ramp, without a model.

It needs the motor angle, the tip acceleration and the motor torque.

While the motor speeds up, an error of order k shakes the arm at k θ_m. Whatever its orders, the arm answers all of them with one
resonance, driven in the angle domain:

    a(t) = Σ_k Re(c_k h ∗ d²/dt² e^{jkθ_m}) + what still rings from the start + a slow curve,   H(s) = ω²/(s² + 2ζωs + ω²).

For given ω and ζ this is linear; both are searched on a grid, then refined. A ramp is too quick for windows of steady speed, in
which the peak comes late and low; the model has the lateness in it, so that all orders have their peaks at f_al/k by themselves.

A resonance counts only if nothing else looks like it. A tone of the floor is not tied to the motor's angle, so that the
model leaves it over. A sensor that rings on its mounting answers the orders as an arm does; but the arm's mass pulls at the motor
through its gear, and the sensor's does not: the motor's torque has to show the same resonance. A peak at the ramp's end is no
peak: some order has to pass its speed with room to spare.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from hil.control.arrays import Real
from hil.design.estimation import SEARCHED_SIGMAS, SEEN_SIGMAS
from hil.design.frequency import OF_SAMPLING
from hil.design.plant_spectra import TREND_ORDER
from hil.design.transmission_error import acceleration_spectrum, shown_waves

RANGE_HZ = (2.0, 48.0)
"""Bound: frequencies that are looked at: arms of robots ring at 4 to 30 Hz."""
GRID_STEP = 0.035
"""Accuracy: distance of two frequencies of the grid, as a logarithm: a factor of 2 changes f_al by 3e-4 of its error."""
DAMPINGS = (0.012, 0.03, 0.06, 0.12, 0.22)
"""Accuracy: damping ratios of the grid, a factor of 2 apart, from the best of which the fit goes on."""
RAMP_END_S = 0.05
"""Measured with the constants below on 340 drawn ramps, none wrong by more than 10 % (docs/theory-judgement.md): end of the ramp
that is not used."""
PADDING_S = 3.0
"""Accuracy: time by which a transform is longer than its recording: a factor of 2 changes f_al by less than 1e-4 of its error."""
TOP_RATE_HZ = 200.0
"""Bound: sampling beyond which every n-th sample says all, 4 times the highest frequency."""

LEAST_DAMPING, MOST_DAMPING = 0.008, 0.2
"""Bound: ζ of an arm on its gear with its loop closed: beyond them a swell is not a resonance, but a tone or a slope."""
LEAST_TIP_EXPLAINED = 0.5
"""Measured with `RAMP_END_S`: fraction of the vibration that the resonance explains."""
MOST_UNCERTAINTY = 0.06
"""Measured with `RAMP_END_S`: standard error of a frequency, as a fraction of it."""

RINGING = 1.35
"""Bound: factor r about a resonance within which an order makes it ring: beyond, the arm moves by 1/(r² − 1) = 1.2 θ_sync."""

TORQUE_SPEEDS = (0.55, 1.7)
"""Measured with `RAMP_END_S`: speeds at which the torque is looked at, by that of the clearest order at the resonance."""
TORQUE_FREQUENCIES = np.exp(np.arange(-0.5, 0.51, 0.05))
"""Frequencies at which the torque is fitted, in units of the tip's."""
TORQUE_AGREEMENT = 0.08
"""Measured with `RAMP_END_S`: difference of the frequencies that tip and torque show, as a fraction."""
LEAST_EXPLAINED = 0.6
"""Measured: fraction that a resonance explains: of the vibration 0.99 on gears of all kinds, and 0.3 at a wrong resonance; of
what plain orders leave over of the torque, 0.02 to 0.5 where a sensor's mounting rings."""
FEWEST = 60
"""Measured with `RAMP_END_S`: samples of the torque."""
LEAST_END_RPS = 0.5
"""Measured with `RAMP_END_S`: speed below which no order has met the resonance: friction depends on the speed there."""
BEYOND_RESONANCE = 1.15
"""Measured with `RAMP_END_S`: end speed of a ramp over an order's at the resonance: the vibration is largest behind it."""
LAW_ERROR, LAW_ERROR_BY_DAMPING = 0.003, 1.2
"""Measured: distance of the peak of |G_al| from that of the model, as a fraction, 0.003 + 1.2 ζ², on 35 linear robots."""


class NoResonanceError(ValueError):
    """Error: the ramp shows no resonance that is clearly the arm's."""


@dataclass(frozen=True)
class Ramp:
    """One recorded ramp of a motor.

    Attributes:
        motor_angle_rad: Angle θ_m; shape (n,).
        reference_rad: Set-points, which say when the ramp begins; shape (n,).
        tip_m_s2: Vertical acceleration of the tip; shape (n,).
        torque_nm: Torque of the motor; shape (n,).
    """

    motor_angle_rad: Real
    reference_rad: Real
    tip_m_s2: Real
    torque_nm: Real
    period_s: float


@dataclass(frozen=True)
class Ringing:
    """Resonance of the arm, seen in a ramp.

    Attributes:
        peak_hz: Peak of the answer's acceleration, f_al.
        standard_error_hz: Its standard error, that of the model for the loop included.
        orders: Orders that show it, the clearest first.
    """

    peak_hz: float
    standard_error_hz: float
    damping: float
    orders: tuple[float, ...]


@dataclass(frozen=True)
class _Fit:
    """Resonance fitted to one signal."""

    resonance_hz: float
    damping: float
    standard_error_hz: float
    significance: tuple[float, ...]
    explained_fraction: float

    @property
    def peak_hz(self) -> float:
        """Frequency at which ω² |H| peaks."""
        return self.resonance_hz / math.sqrt(max(0.3, 1.0 - 2.0 * self.damping**2))


def ringing(ramp: Ramp, orders: Sequence[float]) -> Ringing:
    """Resonance of the arm that a ramp shows.

    Args:
        orders: Orders k that may shake the arm.

    Raises:
        NoResonanceError: There is none that is clearly the arm's.
    """
    model = _RampModel(ramp, tuple(orders))
    tip = model.fitted()
    law = LAW_ERROR + LAW_ERROR_BY_DAMPING * tip.damping**2
    error = math.hypot(tip.standard_error_hz, law * tip.peak_hz)
    if not LEAST_DAMPING < tip.damping < MOST_DAMPING:
        raise NoResonanceError(
            f"the clearest resonance has a damping ratio of {tip.damping:.2g}; that of an arm lies between "
            f"{LEAST_DAMPING:g} and {MOST_DAMPING:g}"
        )
    if error > MOST_UNCERTAINTY * tip.peak_hz:
        raise NoResonanceError(
            f"a resonance near {tip.peak_hz:.1f} Hz has a standard error of {error:.1f} Hz; at most "
            f"{MOST_UNCERTAINTY * tip.peak_hz:.1f} Hz is allowed"
        )
    if tip.explained_fraction < LEAST_TIP_EXPLAINED:
        raise NoResonanceError(
            f"a resonance near {tip.peak_hz:.1f} Hz explains {100.0 * tip.explained_fraction:.0f} % of the "
            f"vibration; at least {100.0 * LEAST_TIP_EXPLAINED:.0f} % is needed"
        )
    clear = [(each, order) for each, order in zip(tip.significance, orders, strict=True) if each >= SEARCHED_SIGMAS]
    met = [order for _, order in sorted(clear, reverse=True) if model.passes(tip.peak_hz / order)]
    if not met:
        raise NoResonanceError(f"the ramp passes no speed at which an order meets a resonance near {tip.peak_hz:.1f} Hz")
    if not model.is_felt(tip, tip.peak_hz / met[0]):
        raise NoResonanceError(
            f"the tip rings near {tip.peak_hz:.1f} Hz, which is f_al or the sensor on its mounting; the motor "
            "torque does not show which"
        )
    return Ringing(tip.peak_hz, error, tip.damping, tuple(met))


class _RampModel:
    """Columns of the model for any ω and ζ."""

    def __init__(self, ramp: Ramp, orders: tuple[float, ...]) -> None:
        period_s, angle = ramp.period_s, np.asarray(ramp.motor_angle_rad, dtype=np.float64)
        begin, end, speed_rps = _rising(ramp)
        every = max(1, int(0.5 / period_s / TOP_RATE_HZ))
        self._rows = np.arange(begin, end, every)
        if len(self._rows) < 8 * (2 * len(orders) + TREND_ORDER + 3):
            raise NoResonanceError(f"the ramp has {len(self._rows)} samples, too few for a resonance")
        self._time_s = (self._rows - begin) * period_s
        self._period_s = every * period_s
        self._top_rps = float(speed_rps[end - 1])
        self._length = int(scipy.fft.next_fast_len(len(angle) + round(PADDING_S / period_s), real=True))
        waves = shown_waves(angle, period_s, orders)
        self._frequency, self._spectra = acceleration_spectrum(waves, period_s, self._length)
        place = 2.0 * self._time_s / self._time_s[-1] - 1.0
        self._slow = np.polynomial.legendre.legvander(place, TREND_ORDER)
        self._tip, self._torque = ramp.tip_m_s2[self._rows], ramp.torque_nm[self._rows]
        self._speed_rps, self._angle_rad, self._orders = speed_rps[self._rows], angle[self._rows], orders
        highest = min(RANGE_HZ[1], OF_SAMPLING / period_s, max(orders) * self._top_rps / BEYOND_RESONANCE)
        if highest < 2.0 * RANGE_HZ[0]:
            raise NoResonanceError(
                f"the ramp shows frequencies up to {highest:.1f} Hz only; at least {2.0 * RANGE_HZ[0]:g} Hz are needed"
            )
        self._grid = np.exp(np.arange(math.log(RANGE_HZ[0]), math.log(highest), GRID_STEP))

    def passes(self, speed_rps: float) -> bool:
        """True if the ramp passes a speed with room on both sides."""
        return LEAST_END_RPS <= speed_rps <= self._top_rps / BEYOND_RESONANCE

    def columns(self, resonance_hz: float, damping: float) -> Real:
        """Columns of the model; shape (n, unknowns)."""
        x = self._frequency / resonance_hz
        answer = 1.0 / (1.0 + 2j * damping * x - x**2)
        driven = scipy.fft.irfft(self._spectra * answer, self._length, axis=-1)[:, self._rows].T
        phase = 2.0 * math.pi * resonance_hz * self._time_s
        decay = np.exp(-damping * phase)
        return np.column_stack([driven, decay * np.cos(phase), decay * np.sin(phase), self._slow])

    def fitted(self) -> _Fit:
        """Fit the resonance with the least residual of the tip's vibration."""
        powers = np.array([[self._left(float(each), damping) for damping in DAMPINGS] for each in self._grid])
        row, column = np.unravel_index(int(np.argmin(powers)), powers.shape)
        start = np.log([self._grid[row], DAMPINGS[column]])

        def power(logarithms: Real) -> float:
            resonance_hz, damping = np.exp(np.clip(logarithms, -7.0, [7.0, -0.5]))
            return math.log(max(self._left(float(resonance_hz), float(damping)), 1e-300))

        simplex = start + np.array([[0.0, 0.0], [0.02, 0.0], [0.02, 0.3]])
        options: Any = {"initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-5, "maxiter": 100}
        found = scipy.optimize.minimize(power, start, method="Nelder-Mead", options=options)
        resonance_hz, damping = (float(value) for value in np.exp(np.clip(found.x, -7.0, [7.0, -0.5])))
        return self._fit(self._tip, resonance_hz, damping)

    def is_felt(self, tip: _Fit, speed_rps: float) -> bool:
        """True if the motor torque shows the tip's resonance.

        Args:
            speed_rps: Speed at which the clearest order meets it.
        """
        low, high = (factor * speed_rps for factor in TORQUE_SPEEDS)
        rows = (self._speed_rps >= low) & (self._speed_rps <= high)
        if np.count_nonzero(rows) < FEWEST:
            return False
        torque, place = self._torque[rows], 2.0 * (self._time_s[rows] - self._time_s[rows][0]) / np.ptp(self._time_s[rows]) - 1.0
        plain = [np.polynomial.legendre.legvander(place, TREND_ORDER)]
        for order in self._orders:
            wave = np.column_stack([np.cos(order * self._angle_rad[rows]), np.sin(order * self._angle_rad[rows])])
            plain += [wave, place[:, np.newaxis] * wave]
        unknowns = 2 * len(self._orders)
        powers = []
        for factor in TORQUE_FREQUENCIES:
            driven = self.columns(float(factor) * tip.resonance_hz, tip.damping)[rows][:, :unknowns]
            powers.append(_left_over(np.column_stack([*plain, driven]), torque))
        before = _left_over(np.column_stack(plain), torque)
        agrees = abs(float(TORQUE_FREQUENCIES[int(np.argmin([left @ left for left in powers]))]) - 1.0) <= TORQUE_AGREEMENT
        after = powers[len(powers) // 2]
        gained = float(before @ before - after @ after)
        noise = max(_noise_near(after, self._period_s, tip.resonance_hz), 1e-300)
        is_clear = gained >= SEEN_SIGMAS**2 * unknowns * noise
        return bool(agrees and is_clear and gained >= LEAST_EXPLAINED * float(before @ before))

    def _left(self, resonance_hz: float, damping: float) -> float:
        """Power of the tip's vibration that the model does not explain."""
        left = _left_over(self.columns(resonance_hz, damping), self._tip)
        return float(left @ left)

    def _fit(self, values: Real, resonance_hz: float, damping: float) -> _Fit:
        """Compute standard errors and significances at the best resonance."""
        columns = self.columns(resonance_hz, damping)
        scale = _length(columns)
        scaled = columns / scale
        residual = _left_over(columns, values)
        unknowns = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10, hermitian=True) @ (scaled.T @ values)
        noise = _noise_near(residual, self._period_s, resonance_hz)
        shift = 1e-3
        moved = (self.columns(resonance_hz * (1.0 + shift), damping), self.columns(resonance_hz, damping * (1.0 + 5.0 * shift)))
        slopes = [((each - columns) / scale @ unknowns) / step for each, step in zip(moved, (shift, 5.0 * shift), strict=True)]
        jacobian = np.column_stack([scaled, *slopes])
        covariance = noise * np.linalg.pinv(jacobian.T @ jacobian)
        error_hz = resonance_hz * math.sqrt(max(float(covariance[len(scale), len(scale)]), 0.0))
        linear = noise * np.linalg.pinv(scaled.T @ scaled)
        significance = []
        for pair in (slice(2 * order, 2 * order + 2) for order in range(len(self._orders))):
            squared = float(unknowns[pair] @ np.linalg.pinv(linear[pair, pair]) @ unknowns[pair])
            significance.append(math.sqrt(max(squared, 0.0)))
        varying = _left_over(self._slow, values)
        explained = 1.0 - float(residual @ residual) / max(float(varying @ varying), 1e-300)
        return _Fit(resonance_hz, damping, error_hz, tuple(significance), explained)


def _length(columns: Real) -> Real:
    return np.asarray(np.sqrt(np.sum(columns**2, axis=0)) + 1e-300)


def _left_over(columns: Real, values: Real) -> Real:
    """Residual of a signal after least squares; shape (n,).

    By normal equations of scaled columns, without the linear algebra's threads: a decomposition of a tall matrix takes them all,
    which on a busy machine is a hundred times as long.
    """
    scaled = columns / _length(columns)
    normal = np.einsum("ij,ik->jk", scaled, scaled)
    unknowns = np.linalg.pinv(normal, rcond=1e-10, hermitian=True) @ np.einsum("ij,i->j", scaled, values)
    return np.asarray(values - np.einsum("ij,j->i", scaled, unknowns))


def _noise_near(residual: Real, period_s: float, frequency_hz: float) -> float:
    """Variance of white noise that explains the residual around a frequency."""
    power = np.abs(scipy.fft.rfft(residual)) ** 2 / len(residual)
    lines = scipy.fft.rfftfreq(len(residual), period_s)
    near = (lines > 0.5 * frequency_hz) & (lines < 2.1 * frequency_hz)
    return float(np.mean(power[near])) if np.count_nonzero(near) > 2 else float(np.mean(residual**2))


def _rising(ramp: Ramp) -> tuple[int, int, Real]:
    """Find the rows of the ramp, and |f_m| in rev/s.

    The rows go from the first set-point that moves to just before the top speed; |f_m| has the shape (n,).
    """
    moved = np.flatnonzero(ramp.reference_rad != ramp.reference_rad[0])
    if not len(moved):
        raise NoResonanceError("the motor does not move")
    width = max(1, round(0.02 / ramp.period_s))
    rate = np.gradient(ramp.motor_angle_rad, ramp.period_s) / (2.0 * math.pi)
    smooth = np.convolve(np.pad(rate, width, mode="edge"), np.full(2 * width + 1, 1.0 / (2 * width + 1)), mode="valid")
    speed = np.abs(smooth)
    end = int(np.argmax(speed)) - max(1, round(RAMP_END_S / ramp.period_s))
    if end <= moved[0] + 1:
        raise NoResonanceError("the motor does not speed up")
    return int(moved[0]), end, speed
