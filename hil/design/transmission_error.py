"""Transmission error of a gear, and what samples of a motion show of it.

    θ_sync = Σ A_k cos(k θ_m + φ_k)

Source: the paper, section 3.2, eq. (1) to (3).
"""

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from hil.control.angles import ARCSEC
from hil.control.arrays import Complex, Real

PAPER_ORDERS = (2, 4)
"""Bound: orders of eq. (2)."""
SMOOTHED = 5.0
"""Accuracy: samples over which the motor speed is smoothed: a factor of 2 changes estimates by 3e-4, errors by 4 %."""
SHOWN = (0.42, 0.5)
"""Bound: frequencies over the sampling rate between which a wave fades out, gradually, since a jump shakes the arm."""
AT_ONCE = 8
"""Accuracy: orders whose waves are made at once, for time alone: the waves of a whole scan exceed the processor's caches."""


@dataclass(frozen=True)
class TransmissionError:
    """Transmission error θ_sync = Σ A_k cos(k θ_m + φ_k), eq. (2)."""

    amplitude_arcsec: Mapping[float, float]
    phase_deg: Mapping[float, float]

    def angle_rad(self, motor_angle_rad: Real) -> Real:
        """Error θ_sync in rad at the arm; shape of `motor_angle_rad`."""
        angle = np.asarray(motor_angle_rad, dtype=np.float64)
        total = np.zeros_like(angle)
        for order, amplitude in self.amplitude_arcsec.items():
            total += amplitude * ARCSEC * np.cos(order * angle + math.radians(self.phase_deg[order]))
        return total


def acceleration_spectrum(angle_rad: Real, period_s: float, length: int) -> tuple[Real, Complex]:
    """Spectrum of the second derivative of sampled angles.

    Returns the frequencies, shape (m,), and the transform, shape (..., m).

    The second difference of a sampled sine is its second derivative times (sin(ωT/2)/(ωT/2))²; the division by that makes it
    exact for everything below half the sampling rate. A difference, not jω of the angle itself, since the angle of a motor that
    has turned does not come back to where it began, while its acceleration does. Before the first and after the last sample the
    speed is taken to stay what it is: a recording that was cut off while the motor turned must not end in a blow.
    """
    difference, step = np.zeros_like(angle_rad), np.diff(angle_rad, axis=-1)
    np.subtract(step[..., 1:], step[..., :-1], out=difference[..., 1:-1])
    difference /= period_s**2
    frequency = scipy.fft.rfftfreq(length, period_s)
    spectrum = scipy.fft.rfft(difference, length, axis=-1)
    spectrum /= np.sinc(frequency * period_s) ** 2
    return frequency, np.asarray(spectrum)


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
