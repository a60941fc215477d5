"""Ripple of the motor that is faster than half of the sampling rate.

Each order of the transmission error shakes the motor too. Where k f_m is beyond half of the sampling rate 1/T, the samples show
that ripple at |k f_m − m/T|, and a spline through them would shake the arm there, at its resonance if need be. Samples of
e^{jkθ_m} are exact at any speed, so the ripple is separated by its angle, not by its frequency:

    θ_m = θ̄ + Σ_k Re[c_k(f_m) e^{jkθ_m}],      c_k(f_m) = C_{k,1} f_k/|f_m| + C_{k,2} (f_k/|f_m|)²,      f_k = 0.3/(k T)

The second power is the motor's inertia, the first one its speed control; forwards and backwards have coefficients of their own.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.control.arrays import Complex, Real
from hil.design.ate.model import Sweep
from hil.design.estimation import ROUNDING
from hil.design.frequency import OF_SAMPLING
from hil.design.ringing import RINGING
from hil.design.transmission_error import motor_speed_rps

SPLINED = 0.3
"""Frequency over the sampling rate up to which the spline through the samples is kept; from `OF_SAMPLING` on c_k replaces it."""
PATH_SAMPLES, WAVE_SAMPLES = 7.5, 19.0
"""Measured: samples between the knots of θ̄ and of the other orders' amplitudes: on four drawn robots with T = 8 ms, 6 to 10 and
12 to 31 give A_k that differ by 0.1 to 0.5 %."""
PASSING = 1.16
"""Measured: factor around f_a of the rows that are left out, where an order that is not fitted shakes the motor; a fitted one
does within `RINGING`. With them, an order of one of four robots got 383″ instead of 56″."""
STRETCH_ROWS = 30
"""Probability: samples of a stretch at least, of which a variance is right to 26 %."""


@dataclass(frozen=True)
class Ripple:
    """Coefficients C of each order that exceeds half of the sampling rate.

    Attributes:
        waves: C in rad by order, forwards and backwards, of f_k/|f_m| and its square; shape (2, 2).
    """

    period_s: float = 1.0
    waves: Mapping[float, Complex] = field(default_factory=dict)

    @classmethod
    def of(cls, sweeps: Sequence[Sweep], orders: Sequence[float], resonance_hz: float, top_hz: float) -> "Ripple":
        """Fit the ripple of some recordings, by least squares.

        It has the orders whose image 1/T − k f_m comes below a frequency. θ̄ and the amplitudes of the other orders are cubic
        splines. Recordings with different sampling periods get no ripple.

        Args:
            resonance_hz: The arm's resonance f_a.
            top_hz: Frequency from which on an image does no harm, at most 1/(2T).
        """
        period_s = sweeps[0].period_s
        speeds = [motor_speed_rps(each.motor_angle_rad, period_s) for each in sweeps]
        top_rps = max(float(np.max(np.abs(speed))) for speed in speeds)
        fast = [order for order in orders if order * top_rps > 1.0 / period_s - top_hz]
        if not fast or any(each.period_s != period_s for each in sweeps):
            return cls(period_s)
        columns, angles = [], []
        for sweep, speed in zip(sweeps, speeds, strict=True):
            for rows in stretches(np.abs(speed) > SPLINED / (max(fast) * period_s)):
                found = _Stretch(sweep.motor_angle_rad[rows], speed[rows], period_s, orders, fast, resonance_hz)
                columns.append(found.without_rest(found.waves()))
                angles.append(found.without_rest(found.angle_rad[:, np.newaxis])[:, 0])
        if not columns:
            return cls(period_s)
        matrix = np.vstack(columns)
        size = np.maximum(np.linalg.norm(matrix, axis=0), np.finfo(float).tiny)
        parts = np.linalg.lstsq(matrix / size, np.concatenate(angles), rcond=None)[0] / size
        found_waves = (parts[0::2] + 1j * parts[1::2]).reshape(len(fast), 2, 2)
        return cls(period_s, dict(zip(fast, found_waves, strict=True)))

    def angle(self, motor_angle_rad: Real, motor_speed_rps: Real) -> tuple[Real, Real]:
        """Ripple in rad, and its rate in rad/s; both of the arguments' shape.

        It is 0 where the spline through the samples is kept.
        """
        angle, rate = np.zeros((2, *np.shape(motor_angle_rad)))
        for order, coefficients in self.waves.items():
            slowness = _slowness(order, motor_speed_rps, self.period_s)
            replaced = np.clip((1.0 / slowness - 1.0) / (OF_SAMPLING / SPLINED - 1.0), 0.0, 1.0)
            forwards, backwards = (slowness * (first + second * slowness) for first, second in coefficients)
            wave = replaced * np.where(motor_speed_rps > 0.0, forwards, backwards) * np.exp(1j * order * motor_angle_rad)
            angle += wave.real
            rate += (2j * np.pi * order * motor_speed_rps * wave).real
        return angle, rate


NO_RIPPLE = Ripple()


def _slowness(order: float, speed_rps: Real, period_s: float) -> Real:
    """f_k/|f_m|; f_k/tiny at rest."""
    return SPLINED / (order * period_s * np.maximum(np.abs(speed_rps), np.finfo(float).tiny ** 0.25))


def stretches(rows: NDArray[np.bool_]) -> Iterator[slice]:
    """Slices of consecutive rows, `STRETCH_ROWS` at least."""
    labels, _ = scipy.ndimage.label(rows)
    for (each,) in scipy.ndimage.find_objects(labels):
        if each.stop - each.start >= STRETCH_ROWS:
            yield each


class _Stretch:
    """Consecutive samples that are fitted.

    Attributes:
        angle_rad: Motor angle, 0 in rows that are left out.
    """

    def __init__(
        self, angle_rad: Real, speed_rps: Real, period_s: float, orders: Sequence[float], fast: Sequence[float],
        resonance_hz: float,
    ) -> None:  # fmt: skip
        self._turned, self._speed, self._period_s, self._fast = angle_rad, speed_rps, period_s, fast
        self._keep = np.ones(len(angle_rad))
        for order in orders:
            shown = order * np.abs(speed_rps) * period_s
            ratio = np.abs(shown - np.round(shown)) / (resonance_hz * period_s)
            factor = RINGING if order in fast else PASSING
            self._keep[(ratio > 1.0 / factor) & (ratio < factor)] = 0.0
        self.angle_rad = (angle_rad - np.mean(angle_rad)) * self._keep
        rest = [_splines(len(angle_rad), PATH_SAMPLES)]
        amplitudes = _splines(len(angle_rad), WAVE_SAMPLES)
        for order in orders:
            is_slow = (self._shown(order) <= SPLINED)[:, np.newaxis] if order in fast else True
            rest += [amplitudes * wave[:, np.newaxis] * is_slow for wave in self._waves_of(order)]
        columns, triangle, _ = scipy.linalg.qr(np.hstack(rest) * self._keep[:, np.newaxis], mode="economic", pivoting=True)
        sizes = np.abs(np.diag(triangle))
        self._rest = columns[:, sizes > ROUNDING * max(sizes[0], 1.0)]

    def _shown(self, order: float) -> Real:
        return np.asarray(order * np.abs(self._speed) * self._period_s)

    def _waves_of(self, order: float) -> tuple[Real, Real]:
        """Columns of the real and the imaginary part of an amplitude."""
        return np.cos(order * self._turned), -np.sin(order * self._turned)

    def waves(self) -> Real:
        """Columns of the coefficients C: by order, direction, power and part."""
        made = []
        for order in self._fast:
            is_fast, slowness = self._shown(order) > SPLINED, _slowness(order, self._speed, self._period_s)
            for is_there in (self._speed > 0.0, self._speed <= 0.0):
                made += [is_fast * is_there * part * wave for part in (slowness, slowness**2) for wave in self._waves_of(order)]
        return np.stack(made, axis=1) * self._keep[:, np.newaxis]

    def without_rest(self, columns: Real) -> Real:
        """What θ̄ and the other orders leave of some columns."""
        return np.asarray(columns - self._rest @ (self._rest.T @ columns))


def _splines(count: int, between: float) -> Real:
    """Cubic splines over so many samples, with knots at about that distance; shape (count, splines)."""
    inner = np.linspace(0.0, count - 1.0, max(1, round((count - 1) / between)) + 1)
    knots = np.concatenate([np.full(3, inner[0]), inner, np.full(3, inner[-1])])
    return np.asarray(scipy.interpolate.BSpline.design_matrix(np.arange(float(count)), knots, 3, extrapolate=True).toarray())
