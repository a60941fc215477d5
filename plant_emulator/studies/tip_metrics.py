"""Metrics of a tip's acceleration, as in the report.

The emulator computes them itself; a test compares both.
"""

import math

import numpy as np
import scipy
from numpy.typing import NDArray

Real = NDArray[np.float64]

BAND_FACTORS = (0.5, 2.1)
"""Band of the tip vibration, in units of f_al."""
SPEED_LOWPASS_HZ = 20.0
ORDER, WINDOW_FACTORS = 2, (0.76, 1.27)
"""Order by which a ramp is judged, and the motor speeds around the one at which it meets f_al, in units of f_al/k."""
LINE_WINDOW_S = (0.5, 2.0)
LINE_BAND_HZ = (0.0, 50.0)


def band_hz(f_al_hz: float) -> tuple[float, float]:
    """Return the vibration band of an arm with resonance f_al."""
    return BAND_FACTORS[0] * f_al_hz, BAND_FACTORS[1] * f_al_hz


def tip_displacement_mm(acceleration_m_s2: Real, period_s: float, f_al_hz: float) -> Real:
    """Return the tip's vertical displacement in its band, in mm.

    It is the acceleration, filtered by a 2nd-order Butterworth forward and backward, over (2π f_al)².
    """
    band = scipy.signal.butter(2, band_hz(f_al_hz), "bandpass", fs=1.0 / period_s, output="sos")
    return np.asarray(1e3 * scipy.signal.sosfiltfilt(band, acceleration_m_s2) / (2.0 * math.pi * f_al_hz) ** 2)


def speed_window(revolutions: Real, period_s: float, f_al_hz: float) -> NDArray[np.bool_]:
    """Return the rows in which the speed crosses the resonance; shape (n,).

    The motor speed rises through 0.76 … 1.27 f_al/2 (order k = 2) there.
    """
    low_rps, high_rps = (factor * f_al_hz / ORDER for factor in WINDOW_FACTORS)
    corner = min(SPEED_LOWPASS_HZ, 0.2 / period_s)
    sections = scipy.signal.butter(2, corner, fs=1.0 / period_s, output="sos")
    speed = np.abs(scipy.signal.sosfiltfilt(sections, np.gradient(revolutions, period_s)))
    rising = np.arange(len(speed)) < int(np.argmax(speed))
    return np.asarray((speed >= low_rps) & (speed <= high_rps) & rising)


def spectrum_area(acceleration_m_s2: Real, period_s: float) -> float:
    """Return the area of the amplitude spectrum, in m/s²·Hz.

    It is the trapezoid area from 0 to 50 Hz, with a rectangular window.
    """
    amplitude = 2.0 * np.abs(np.fft.rfft(acceleration_m_s2)) / len(acceleration_m_s2)
    amplitude[0] *= 0.5
    frequency = np.fft.rfftfreq(len(acceleration_m_s2), period_s)
    inside = (frequency >= LINE_BAND_HZ[0]) & (frequency <= LINE_BAND_HZ[1])
    return float(np.trapezoid(amplitude[inside], frequency[inside]))


def above_band(acceleration_m_s2: Real, period_s: float, f_al_hz: float) -> Real:
    """Return the part above f_al/2.

    The acceleration of the motion itself is left out.
    """
    sections = scipy.signal.butter(2, band_hz(f_al_hz)[0], "highpass", fs=1.0 / period_s, output="sos")
    return np.asarray(scipy.signal.sosfiltfilt(sections, acceleration_m_s2))
