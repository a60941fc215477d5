"""Metrics of a tip's acceleration as in the report, reckoned by the world itself; a test holds both side by side."""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import signal

Real = NDArray[np.float64]

TIP_BAND_HZ = (6.0, 25.0)
"""Band of the tip vibration."""
SPEED_LOWPASS_HZ = 20.0
WINDOW_RPS = (4.5, 7.5)
LINE_WINDOW_S = (0.5, 2.0)
LINE_BAND_HZ = (0.0, 50.0)


@cache
def _band(period_s: float) -> Real:
    return np.asarray(signal.butter(2, TIP_BAND_HZ, "bandpass", fs=1.0 / period_s, output="sos"))


def tip_displacement_mm(acceleration_m_s2: Real, period_s: float, f_al_hz: float) -> Real:
    """The tip's vertical acceleration from 6 to 25 Hz (2nd-order Butterworth, forward and backward) over (2π f_al)², in mm."""
    return np.asarray(1e3 * signal.sosfiltfilt(_band(period_s), acceleration_m_s2) / (2.0 * math.pi * f_al_hz) ** 2)


def speed_window(revolutions: Real, period_s: float) -> NDArray[np.bool_]:
    """Rows in which the motor's speed rises through 4.5 … 7.5 rps (order k = 2); shape (n,)."""
    corner = min(SPEED_LOWPASS_HZ, 0.2 / period_s)
    sections = signal.butter(2, corner, fs=1.0 / period_s, output="sos")
    speed = np.abs(signal.sosfiltfilt(sections, np.gradient(revolutions, period_s)))
    rising = np.arange(len(speed)) < int(np.argmax(speed))
    return np.asarray((speed >= WINDOW_RPS[0]) & (speed <= WINDOW_RPS[1]) & rising)


def spectrum_area(acceleration_m_s2: Real, period_s: float) -> float:
    """Trapezoid area of the amplitude spectrum (rectangular window) from 0 to 50 Hz, in m/s²·Hz."""
    amplitude = 2.0 * np.abs(np.fft.rfft(acceleration_m_s2)) / len(acceleration_m_s2)
    amplitude[0] *= 0.5
    frequency = np.fft.rfftfreq(len(acceleration_m_s2), period_s)
    inside = (frequency >= LINE_BAND_HZ[0]) & (frequency <= LINE_BAND_HZ[1])
    return float(np.trapezoid(amplitude[inside], frequency[inside]))


def above_band(acceleration_m_s2: Real, period_s: float) -> Real:
    """The part above 6 Hz: what the motion itself asks of the tip is left out."""
    sections = signal.butter(2, TIP_BAND_HZ[0], "highpass", fs=1.0 / period_s, output="sos")
    return np.asarray(signal.sosfiltfilt(sections, acceleration_m_s2))
