"""The tip's vibration as a vector, and its worst direction.

An arm need not swing at the f_al of one of its axes, nor upwards: a coupled arm does neither. So an acceleration becomes a
displacement by double integration within the band of the vibration, X(f)/(2π f)², and not by one frequency's (2π f_al)². The
spectrum's area begins at 0.2 f_al: below it there are the motion itself and, for a sensor that turns, gravity.
"""

import math
from collections.abc import Sequence

import numpy as np

from hil.analysis import (
    DIRECTIONS,
    LINE_BAND_HZ,
    Direction,
    DirectionMetrics,
    TipScale,
    amplitude_spectrum,
    area,
    line_window_s,
    peak_of,
    shown_band,
)
from hil.control.arrays import Real, Rows
from hil.recording import TIP, Recording

BAND_POWER = 8
"""Power by which the band falls: that of Butterworth's of order 4 without phase. Of the motion below it, which grows with 1/f² by
the integration, less is left than of a band of order 2 that is not integrated."""
AFTER_RAMP_S, BEFORE_RAMP_S, LEAST_STEADY = 0.15, 0.05, 0.25
"""Times behind and before the ramps of a line's speed that still show them; least time between, as a fraction of the line's."""
AREA_FROM = 0.2
"""Frequency from which a spectrum's area counts, in units of f_al."""
AREA_FROM_HZ = 2.0
"""The same where no f_al is known."""


def tip_acceleration(recording: Recording) -> Real:
    """The tip's acceleration in the base frame; shape (n, 3)."""
    return np.stack([recording.columns[name] for name in TIP], axis=1)


def displacement_mm(acceleration_m_s2: Real, period_s: float, band_hz: tuple[float, float]) -> Real:
    """Integrate the tip's acceleration in a band twice, without phase.

        X(f) = −A(f)/(2π f)² · 1/(1 + ((f_1 f_2 − f²)/(f (f_2 − f_1)))⁸)

    The tip's acceleration has the shape (n, directions); the band is from f_1 to f_2, as far as samples show it.

    Raises:
        ValueError: The sampling period is too long for the band.
    """
    count = len(acceleration_m_s2)
    length = 2 * count  # as long again: nothing comes round from the end to the beginning
    gain = _gain_mm_s2_m(length, period_s, band_hz)
    spectrum = np.fft.rfft(acceleration_m_s2 - np.mean(acceleration_m_s2, axis=0), length, axis=0)
    return np.asarray(np.fft.irfft(-spectrum * gain[:, np.newaxis], length, axis=0)[:count])


def _gain_mm_s2_m(length: int, period_s: float, band_hz: tuple[float, float]) -> Real:
    """Return displacement over acceleration by frequency.

    At the frequencies of a transform; 0 at its first.
    """
    low_hz, high_hz = shown_band(period_s, band_hz)
    frequency = np.fft.rfftfreq(length, period_s)[1:]
    outside = (low_hz * high_hz - frequency**2) / (frequency * (high_hz - low_hz))
    return np.concatenate([[0.0], 1e3 / ((2.0 * math.pi * frequency) ** 2 * (1.0 + outside**BAND_POWER))])


def noise_rms_mm(variances: Sequence[float], period_s: float, band_hz: tuple[float, float]) -> float:
    """Return the rms displacement of a sensor's white noise.

    In its worst direction. Variances are those of each direction's samples, in (m/s²)².

    Raises:
        ValueError: The sampling period is too long for the band.
    """
    length = 1 << 12
    passed = 2.0 * float(np.sum(_gain_mm_s2_m(length, period_s, band_hz) ** 2)) / length
    return math.sqrt(passed * max(variances))


def steady_window_s(duration_s: float, ramp_s: float) -> tuple[float, float]:
    """Return begin and end of the judged part of an arm's line.

    In s after its start: the part with constant speed. The tip is also judged along the line, where its own acceleration is no
    vibration. A line without much constant speed is judged in the times of `line_window_s`.
    """
    begin_s, end_s = line_window_s(duration_s)
    from_s, to_s = max(begin_s, ramp_s + AFTER_RAMP_S), min(end_s, duration_s - ramp_s - BEFORE_RAMP_S)
    return (from_s, to_s) if to_s - from_s > LEAST_STEADY * duration_s else (begin_s, end_s)


def vector_metrics(
    acceleration_m_s2: Real, period_s: float, judged: Rows, moving: Rows, window: str, scale: TipScale | None
) -> dict[Direction, DirectionMetrics]:
    """Compute the metrics of the tip's vector by direction.

    Args:
        acceleration_m_s2: The tip's acceleration in the base frame; shape (n, 3).
        period_s: Its sampling period.
        judged: Rows in which the displacement is judged; shape (n,).
        moving: Rows of the spectrum; shape (n,).
        window: Its window, `boxcar` or `hann`.
        scale: Scale of the axes that moved; None if no f_al is known: then there are areas alone.

    Raises:
        ValueError: The sampling period is too long for the band.
    """
    found = [amplitude_spectrum(column, period_s, window) for column in acceleration_m_s2[moving].T]
    frequency, spectra = found[0][0], [amplitude for _, amplitude in found]
    spectra.append(np.sqrt(np.sum(np.stack(spectra) ** 2, axis=0)))
    begin = AREA_FROM_HZ if scale is None else AREA_FROM * scale.f_al_hz
    areas = [area(frequency, spectrum, (begin, LINE_BAND_HZ[1])) for spectrum in spectra]
    if scale is None:
        return {name: DirectionMetrics(None, None, None, None, None, each) for name, each in zip(DIRECTIONS, areas, strict=True)}
    moved = displacement_mm(acceleration_m_s2, period_s, scale.band_hz)[judged]
    lengths = np.linalg.norm(moved, axis=1)
    worst = int(np.argmax(lengths))
    units = [*np.eye(3), moved[worst] / max(float(lengths[worst]), 1e-300)]
    metrics: dict[Direction, DirectionMetrics] = {}
    for name, unit, values, spectrum, each in zip(DIRECTIONS, units, (*moved.T, lengths), spectra, areas, strict=True):
        x, y, z = unit.tolist()
        peak_mm, rms_mm = float(np.max(np.abs(values))), float(np.sqrt(np.mean(values**2)))
        metrics[name] = DirectionMetrics((x, y, z), peak_mm, rms_mm, *peak_of(frequency, spectrum, scale.peak_band_hz), each)
    return metrics
