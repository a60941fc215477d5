"""The metrics of a recording, with their exact definitions."""

# ruff: noqa: PLC0415 - scipy.signal takes longer to import than all else that a run needs before it moves

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.recording import Recording

Real = NDArray[np.float64]

TIP_BAND_HZ = (6.0, 25.0)
"""Band of the tip vibration: the resonance near 12 Hz with its skirts, without the motion itself."""

SPEED_LOWPASS_HZ = 20.0
"""Corner of the low-pass, forward and backward, that makes a speed from the sampled motor angle."""

WINDOWS_RPS = {2: (4.5, 7.5), 4: (2.2, 3.6)}
"""Motor speeds in which a constant-acceleration run is judged, by the order k that crosses the resonance there."""

LINE_WINDOW_S = (0.5, 2.0)
"""Times after the start of the line motion in which its tip displacement is judged."""

PEAK_BAND_HZ = (8.0, 16.0)
LINE_BAND_HZ = (0.0, 50.0)


def motor_speed_rps(recording: Recording, axis: int) -> Real:
    """Motor speed f_m in rev/s from the recorded motor angle, low-passed without phase; shape (n,)."""
    from scipy import signal

    period = recording.period_s
    speed = np.gradient(recording.axis(axis, "position_rad"), period) / (2.0 * math.pi)
    corner = min(SPEED_LOWPASS_HZ, 0.2 / period)
    return np.asarray(signal.sosfiltfilt(signal.butter(2, corner, fs=1.0 / period, output="sos"), speed))


def band_passed(acceleration_m_s2: Real, period_s: float) -> Real:
    """The part of a vertical acceleration from 6 to 25 Hz (2nd-order Butterworth, forward and backward); shape (n,).

    Raises:
        ValueError: The sampling period is too long for 25 Hz.
    """
    from scipy import signal

    if 0.5 / period_s <= TIP_BAND_HZ[1]:
        raise ValueError(f"samples every {1e3 * period_s:g} ms do not show vibrations up to {TIP_BAND_HZ[1]:g} Hz")
    band = signal.butter(2, TIP_BAND_HZ, "bandpass", fs=1.0 / period_s, output="sos")
    return np.asarray(signal.sosfiltfilt(band, acceleration_m_s2))


def tip_displacement_mm(acceleration_m_s2: Real, period_s: float, f_al_hz: float) -> Real:
    """The paper's equivalent displacement of the tip, in mm.

    The vertical acceleration, band-passed from 6 to 25 Hz (2nd-order Butterworth, forward and backward),
    over (2π f_al)².

    Args:
        acceleration_m_s2: Vertical tip acceleration; shape (n,).
        period_s: Its sampling period.
        f_al_hz: Peak frequency of |G_al|.
    """
    return np.asarray(1e3 * band_passed(acceleration_m_s2, period_s) / (2.0 * math.pi * f_al_hz) ** 2)


def speed_window(recording: Recording, axis: int, order: int) -> NDArray[np.bool_]:
    """Rows of a constant-acceleration run in which f_m rises through the order's window; shape (n,)."""
    low, high = WINDOWS_RPS[order]
    speed = np.abs(motor_speed_rps(recording, axis))
    rising = np.arange(len(speed)) < int(np.argmax(speed))
    return np.asarray((speed >= low) & (speed <= high) & rising)


def amplitude_spectrum(values: Real, period_s: float, window: str) -> tuple[Real, Real]:
    """Frequencies in Hz and one-sided amplitudes, shapes (m,); a sine of amplitude 1 shows 1 with either window."""
    from scipy import signal

    weights = signal.get_window(window, len(values))
    amplitude = np.asarray(2.0 * np.abs(np.fft.rfft(values * weights)) / float(np.sum(weights)), dtype=np.float64)
    amplitude[0] *= 0.5
    if len(values) % 2 == 0:
        amplitude[-1] *= 0.5  # Nyquist's line, like the mean, has no mirror image
    return np.asarray(np.fft.rfftfreq(len(values), period_s), dtype=np.float64), amplitude


def area(frequency_hz: Real, amplitude: Real, band_hz: tuple[float, float]) -> float:
    """Trapezoid area of a spectrum over a band, in amplitude times Hz."""
    inside = (frequency_hz >= band_hz[0]) & (frequency_hz <= band_hz[1])
    return float(np.trapezoid(amplitude[inside], frequency_hz[inside]))


@dataclass(frozen=True)
class Metrics:
    """Metrics by which a run is judged.

    Attributes:
        tip_peak_mm: Largest |tip displacement| in the window.
        tip_rms_mm: Root mean square of the tip displacement in the window.
        spectrum_peak_m_s2: Largest amplitude of the Hann spectrum from 8 to 16 Hz in the window.
        spectrum_peak_hz: Frequency of that amplitude.
        spectrum_area: Trapezoid area of the amplitude spectrum in m/s²·Hz: the Hann spectrum of the window from 6 to
            25 Hz (single axis), or the rectangular spectrum of the whole motion from 0 to 50 Hz (line motion).
    """

    tip_peak_mm: float
    tip_rms_mm: float
    spectrum_peak_m_s2: float
    spectrum_peak_hz: float
    spectrum_area: float


def constant_acceleration_metrics(recording: Recording, axis: int, order: int, f_al_hz: float) -> Metrics:
    """Metrics of a constant-acceleration run in the window of one order.

    Args:
        recording: The run.
        axis: Number of the axis that moved.
        order: Order k of the window, a key of `WINDOWS_RPS`.
        f_al_hz: Peak frequency of |G_al|.

    Raises:
        ValueError: The run does not pass through the window.
    """
    inside = speed_window(recording, axis, order)
    samples = np.count_nonzero(inside)
    if samples < 16:
        low, high = WINDOWS_RPS[order]
        raise ValueError(f"the run has {samples} samples between {low} and {high} rps; at least 16 are needed")
    acceleration, period = recording.columns["tip_z_m_s2"], recording.period_s
    displacement = tip_displacement_mm(acceleration, period, f_al_hz)[inside]
    frequency, amplitude = amplitude_spectrum(acceleration[inside], period, "hann")
    peak, peak_hz = _peak(frequency, amplitude)
    return Metrics(_largest(displacement), _rms(displacement), peak, peak_hz, area(frequency, amplitude, TIP_BAND_HZ))


def line_motion_metrics(recording: Recording, start_s: float, duration_s: float, f_al_hz: float) -> Metrics:
    """Metrics of a line motion.

    Args:
        recording: The run.
        start_s: Time of the recording at which the motion starts.
        duration_s: Duration of the motion.
        f_al_hz: Peak frequency of |G_al|.
    """
    acceleration, period, time = recording.columns["tip_z_m_s2"], recording.period_s, recording.time_s
    begin, end = start_s + LINE_WINDOW_S[0], start_s + LINE_WINDOW_S[1]
    displacement = tip_displacement_mm(acceleration, period, f_al_hz)[(time >= begin) & (time <= end)]
    motion = acceleration[(time >= start_s) & (time <= start_s + duration_s)]
    frequency, amplitude = amplitude_spectrum(motion, period, "boxcar")
    peak, peak_hz = _peak(frequency, amplitude)
    return Metrics(_largest(displacement), _rms(displacement), peak, peak_hz, area(frequency, amplitude, LINE_BAND_HZ))


def _peak(frequency: Real, amplitude: Real) -> tuple[float, float]:
    inside = np.flatnonzero((frequency >= PEAK_BAND_HZ[0]) & (frequency <= PEAK_BAND_HZ[1]))
    top = inside[int(np.argmax(amplitude[inside]))]
    return float(amplitude[top]), float(frequency[top])


def _largest(values: Real) -> float:
    return float(np.max(np.abs(values)))


def _rms(values: Real) -> float:
    return float(np.sqrt(np.mean(values**2)))
