"""Ellipse of the tip at a resonance, from the recorded vibration.

    u(t) = Re(a e^{iωt}),  a ∈ ℂ³

A complex vector is an ellipse in space. With a turned by e^{−iψ}, 2ψ = arg(a·a), its real part is the long half-axis and its
imaginary part the short one: a measured operating deflection shape of one point.
"""

import cmath
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hil.control.arrays import Complex, Real, Rows

MOST_SWINGS = 3
"""Largest number of resonances that are looked for."""
LEAST_FRACTION = 0.2
"""Amplitude over the largest from which a peak counts."""
APART_BINS = 2.0
"""Distance of two peaks in 1/T: half the main lobe of Hann's window."""
FINENESS = 8
"""Points of the spectrum per 1/T."""
LEAST_SWING_ROWS = 32


@dataclass(frozen=True)
class Swing:
    """Vibration of the tip at one frequency.

    Attributes:
        amplitude_mm: Complex amplitude a along x, y and z, in a Hann window over the rows; shape (3,).
        row: Row around which the vibration at this frequency was largest.
    """

    frequency_hz: float
    amplitude_mm: Complex
    row: int

    @cached_property
    def half_axes_mm(self) -> tuple[Real, Real]:
        """Long and short half-axis of the ellipse; shape (3,) each."""
        turned = self.amplitude_mm * cmath.exp(-0.5j * cmath.phase(complex(self.amplitude_mm @ self.amplitude_mm)))
        return np.real(turned), np.imag(turned)

    def ellipse_mm(self, points: int = 73) -> Real:
        """The ellipse, closed; shape (points, 3)."""
        angle = np.linspace(0.0, 2.0 * math.pi, points)[:, np.newaxis]
        long, short = self.half_axes_mm
        return np.asarray(np.cos(angle) * long + np.sin(angle) * short)


def spectrum_mm(moved_mm: Real, period_s: float, rows: Rows) -> tuple[Real, Real]:
    """Compute the amplitude spectrum of all directions together.

    In a Hann window, interpolated between its bins. Displacements of the tip have the shape (n, 3), the rows of the window
    (n,).

    Returns:
        Frequencies and amplitudes, of equal shape (m,).

    Raises:
        ValueError: There are fewer than 32 rows.
    """
    inside = moved_mm[rows]
    if len(inside) < LEAST_SWING_ROWS:
        raise ValueError(f"{len(inside)} rows are too few for a spectrum; at least {LEAST_SWING_ROWS} are needed")
    weights = np.hanning(len(inside))
    length = FINENESS * len(inside)
    found = np.abs(np.fft.rfft(weights[:, np.newaxis] * inside, length, axis=0)) * 2.0 / float(np.sum(weights))
    return np.asarray(np.fft.rfftfreq(length, period_s)), np.asarray(np.linalg.norm(found, axis=1))


def resonances_hz(moved_mm: Real, period_s: float, rows: Rows, band_hz: tuple[float, float]) -> list[float]:
    """Return the frequencies of the tip's largest swings in a band.

    They are peaks of the spectrum, three at most, the lowest first. Displacements of the tip have the shape (n, 3), the rows
    that count (n,).

    Raises:
        ValueError: There are fewer than 32 rows.
    """
    frequency, amplitude = spectrum_mm(moved_mm, period_s, rows)
    apart_hz = APART_BINS / (np.count_nonzero(rows) * period_s)
    middle = amplitude[1:-1]
    is_peak = (middle > amplitude[:-2]) & (middle >= amplitude[2:])
    peaks = 1 + np.flatnonzero(is_peak & (frequency[1:-1] >= band_hz[0]) & (frequency[1:-1] <= band_hz[1]))
    chosen: list[int] = []
    for peak in sorted(peaks.tolist(), key=lambda each: -float(amplitude[each])):
        is_clear = float(amplitude[peak]) >= LEAST_FRACTION * float(amplitude[chosen[0]]) if chosen else True
        if is_clear and all(abs(frequency[peak] - frequency[other]) >= apart_hz for other in chosen):
            chosen.append(peak)
    return sorted(float(frequency[peak]) for peak in chosen[:MOST_SWINGS])


def swing(moved_mm: Real, period_s: float, rows: Rows, frequency_hz: float) -> Swing:
    """The tip's swing at a frequency.

    Displacements of the tip have the shape (n, 3), the rows that count (n,); the frequency is above 0.

    Raises:
        ValueError: There are fewer than 32 rows, or the frequency is not above 0.
    """
    inside = moved_mm[rows]
    if len(inside) < LEAST_SWING_ROWS or frequency_hz <= 0.0:
        raise ValueError(f"{len(inside)} rows and {frequency_hz:g} Hz: {LEAST_SWING_ROWS} rows at least, and a frequency above 0")
    begin = int(np.argmax(rows))
    time = period_s * (begin + np.arange(len(inside)))
    turned = inside * np.exp(-2j * math.pi * frequency_hz * time)[:, np.newaxis]
    weights = np.hanning(len(inside))
    amplitude = 2.0 * (weights @ turned) / float(np.sum(weights))
    width = min(len(inside), max(3, round(3.0 / (frequency_hz * period_s))))  # three periods: near enough to say when
    local = np.stack([np.convolve(column, np.hanning(width + 2)[1:-1], mode="same") for column in turned.T], axis=1)
    return Swing(frequency_hz, np.asarray(amplitude), begin + int(np.argmax(np.linalg.norm(local, axis=1))))
