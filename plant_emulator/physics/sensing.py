"""Path of the tip's acceleration through the accelerometer: mounting resonance, low-pass and delay at the control period.

    mounting   (2 ζ ω s + ω²)/(s² + 2 ζ ω s + ω²)      the sensor's mass on its elastic mounting
    low-pass   ω²/(s² + √2 ω s + ω²)                    Butterworth of order 2

Both are bilinear with their own frequency kept (prewarped). The delay is exact in whole control periods; fractions are
interpolated by the cubic through the four samples around them.
"""

import math
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.control.compiled import compiled
from hil.control.records import record_dtype

Real = NDArray[np.float64]

CHANNELS = 3
"""X, Y and Z."""
HIGHEST_FREQUENCY = 0.4
"""Largest frequency of a section in units of the sampling frequency: above it the bilinear form is another filter."""


class SectionsRow(Protocol):
    """Two sections of order 2, mounting first, and the delay.

    - `coefficients`: b0, b1, b2, a1, a2 of each section.
    - `memory`: two values of each section for each channel (transposed direct form II).
    - `first`: samples by which the newest of the four interpolated ones is late.
    - `weights`: of these four, the newest first.
    - `newest`: row of the ring that holds the newest sample.
    """

    coefficients: Annotated[NDArray[np.float64], (2, 5)]
    memory: Annotated[NDArray[np.float64], (2, 3, 2)]
    weights: Annotated[NDArray[np.float64], (4,)]
    first: int
    newest: int


SECTIONS = record_dtype(SectionsRow)


@compiled
def sense(row: SectionsRow, ring: Real, tip: Real, sensed: Real) -> None:
    """Let some samples pass; the last output is what the sensor shows now.

    Args:
        row: Sections and delay; changed in place.
        ring: The latest filtered samples; shape (rows, 3), changed in place.
        tip: True accelerations, one row per control period; shape (n, 3).
        sensed: Output after the last of them; shape (3,), written.
    """
    size = ring.shape[0]
    for i in range(tip.shape[0]):
        row.newest = (row.newest + 1) % size
        for channel in range(CHANNELS):
            value = tip[i, channel]
            for section in range(2):
                b0, b1, b2 = row.coefficients[section, 0], row.coefficients[section, 1], row.coefficients[section, 2]
                a1, a2 = row.coefficients[section, 3], row.coefficients[section, 4]
                out = b0 * value + row.memory[section, channel, 0]
                row.memory[section, channel, 0] = b1 * value - a1 * out + row.memory[section, channel, 1]
                row.memory[section, channel, 1] = b2 * value - a2 * out
                value = out
            ring[row.newest, channel] = value
    for channel in range(CHANNELS):
        total = 0.0
        for late in range(4):
            if row.weights[late] != 0.0:
                total += row.weights[late] * ring[(row.newest - row.first - late) % size, channel]
        sensed[channel] = total


class SensorResponse:
    """Response of an accelerometer to the motion of its tip; at rest until it is driven.

    Args:
        period_s: Sampling period of the true acceleration, the control period.
        delay_s: Delay of the output.
        lowpass_hz: Corner of the low-pass; None for none.
        mounting_resonance_hz: Resonance of the mounting; None for a stiff one.
        mounting_damping: Its damping ratio.

    Attributes:
        row: Sections and delay, for `sense`.
        ring: The latest samples.
        sensed: Output of the sensor now.

    Raises:
        ValueError: A frequency is too high for the sampling period.
    """

    def __init__(
        self,
        period_s: float,
        *,
        delay_s: float = 0.0,
        lowpass_hz: float | None = None,
        mounting_resonance_hz: float | None = None,
        mounting_damping: float = 0.05,
    ) -> None:
        for name, frequency in (("lowpass_hz", lowpass_hz), ("mounting_resonance_hz", mounting_resonance_hz)):
            if frequency is not None and frequency * period_s > HIGHEST_FREQUENCY:
                raise ValueError(f"{name} {frequency:g} is too high for samples every {1e6 * period_s:g} µs")
        self._rows = np.zeros(1, SECTIONS)
        self.row = row = self._rows[0]  # kept, as machine code wants it: a record that it has not seen costs 400 µs
        row["coefficients"][:, 0] = 1.0
        if mounting_resonance_hz is not None:
            row["coefficients"][0] = section(mounting_resonance_hz, mounting_damping, period_s, with_zero=True)
        if lowpass_hz is not None:
            row["coefficients"][1] = section(lowpass_hz, math.sqrt(0.5), period_s, with_zero=False)
        row["first"], row["weights"] = interpolation(delay_s / period_s)
        self.ring = np.zeros((int(row["first"]) + 5, CHANNELS))
        self.sensed = np.zeros(CHANNELS)

    def drive(self, tip_m_s2: Real) -> None:
        """Let samples of the true acceleration pass, one per control period; shape (n, 3).

        An array that has been given before costs less than another one.
        """
        sense(self.row, self.ring, tip_m_s2, self.sensed)

    @property
    def acceleration_m_s2(self) -> tuple[float, float, float]:
        """Output of the sensor now, without noise and steps."""
        x, y, z = self.sensed.tolist()
        return x, y, z


def section(frequency_hz: float, damping: float, period_s: float, *, with_zero: bool) -> tuple[float, float, float, float, float]:
    """b0, b1, b2, a1, a2 of (2 ζ ω s + ω²)/(s² + 2 ζ ω s + ω²), or of ω²/(…) without the zero; bilinear, ω kept.

    Args:
        frequency_hz: ω/2π.
        damping: ζ.
        period_s: Sampling period.
        with_zero: True for the mounting, False for a low-pass.
    """
    k = math.tan(math.pi * frequency_hz * period_s)
    whole = 1.0 + 2.0 * damping * k + k * k
    zero = 2.0 * damping * k if with_zero else 0.0
    return (
        (zero + k * k) / whole,
        2.0 * k * k / whole,
        (k * k - zero) / whole,
        2.0 * (k * k - 1.0) / whole,
        (1.0 - 2.0 * damping * k + k * k) / whole,
    )


def interpolation(delay_samples: float) -> tuple[int, tuple[float, float, float, float]]:
    """The newest of four samples, counted backwards, and the weights of all four, for a delay in samples; Lagrange's cubic."""
    whole = math.floor(delay_samples)
    fraction = delay_samples - whole
    if fraction < 1e-9:
        return whole, (1.0, 0.0, 0.0, 0.0)
    first = max(0, whole - 1)  # the delay lies between the two in the middle, but for one below a sample
    at = delay_samples - first
    weights = [math.prod((at - other) / (each - other) for other in range(4) if other != each) for each in range(4)]
    return first, (weights[0], weights[1], weights[2], weights[3])
