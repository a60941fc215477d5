"""Path of the tip's acceleration through the accelerometer.

Mounting resonance, low-pass and delay at the control period.

    mounting   (2 ζ ω s + ω²)/(s² + 2 ζ ω s + ω²)      the sensor's mass on its elastic mounting
    low-pass   ω²/(s² + √2 ω s + ω²)                    Butterworth of order 2

Both are bilinear with their own frequency kept (prewarped). The delay is exact in whole control periods; fractions are
interpolated by the cubic through the four samples around them.
"""

import math

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core import CORE

Real = NDArray[np.float64]

CHANNELS: int = CORE.call.CHANNELS
"""X, Y and Z."""
HIGHEST_FREQUENCY = 0.4
"""Largest frequency of a section in units of the sampling frequency: above it the bilinear form is another filter."""


SECTIONS = CORE.dtype("sections")


class SensorResponse:
    """Response of an accelerometer to its tip's motion, from rest.

    Args:
        period_s: Sampling period of the true acceleration, the control period.
        lowpass_hz: Corner of the low-pass; None for none.
        mounting_resonance_hz: Resonance of the mounting; None for a stiff one.

    Attributes:
        shared: Sections, ring and output of `sense`, in C.

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
                most = HIGHEST_FREQUENCY / period_s
                raise ValueError(f"{name} = {frequency:g} is too high for samples every {1e6 * period_s:g} µs; at most {most:g}")
        rows = np.zeros(1, SECTIONS)
        row = rows[0]
        row["coefficients"][:, 0] = 1.0
        if mounting_resonance_hz is not None:
            row["coefficients"][0] = section(mounting_resonance_hz, mounting_damping, period_s, with_zero=True)
        if lowpass_hz is not None:
            row["coefficients"][1] = section(lowpass_hz, math.sqrt(0.5), period_s, with_zero=False)
        row["first"], row["weights"] = interpolation(delay_s / period_s)
        ring = np.zeros((int(row["first"]) + 5, CHANNELS))
        self.shared = CORE.pointer(rows, "sections"), CORE.pointer(ring), len(ring), CORE.pointer(np.zeros(CHANNELS))


def section(frequency_hz: float, damping: float, period_s: float, *, with_zero: bool) -> tuple[float, float, float, float, float]:
    """Return the coefficients b0, b1, b2, a1, a2 of a section.

    It is (2 ζ ω s + ω²)/(s² + 2 ζ ω s + ω²), or ω²/(…) without the zero; bilinear, ω kept.

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
    """Return first sample and weights of Lagrange's cubic for a delay.

    The delay is in samples; the newest of the four samples is counted backwards.
    """
    whole = math.floor(delay_samples)
    fraction = delay_samples - whole
    if fraction < 1e-9:
        return whole, (1.0, 0.0, 0.0, 0.0)
    first = max(0, whole - 1)  # the delay lies between the two in the middle, but for one below a sample
    at = delay_samples - first
    weights = [math.prod((at - other) / (each - other) for other in range(4) if other != each) for each in range(4)]
    return first, (weights[0], weights[1], weights[2], weights[3])
