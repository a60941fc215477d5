"""Model of the arm for a cancellation that follows.

The model is the response as one sampled resonance, and the band of its vibration.

Around f_al the response of arm and loop to the transmission error is that of one mass on one spring,

    X(s) = θ_l/θ_sync ≈ (b₀ + b₁ s)/(s² + a₁ s + a₀),

to 1 … 4 % between 0.76 and 1.3 f_al (drawn robots); it is fitted to X of the loop itself by least squares, in rounds, each
weighted by the last one's denominator. Source: Sanathanan and Koerner, IEEE Trans. Automatic Control 8 (1963) 56.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hil.control.arrays import Complex, Real
from hil.control.following import ArmModel
from hil.design.frequency import OF_SAMPLING, RESONANCE_BAND

FIT_POINTS, FIT_ROUNDS = 200, 6
"""Accuracy: frequencies of a fit, 1 % apart, and its rounds, each weighted by the denominator of the one before. Source: C. K.
Sanathanan, J. Koerner, IEEE Trans. Automatic Control 8 (1963) 56."""
ROUNDING_POINTS = 2000
"""Accuracy: frequencies over which a filter's noise by rounding is summed, 0.02 % too low."""


@dataclass(frozen=True)
class Resonance:
    """Response X as one resonance.

    Attributes:
        b0: b₀ in 1/s².
        b1: b₁ in 1/s.
        a1: a₁ in 1/s.
        a0: a₀ in 1/s².
        f_al_hz: Frequency at which the arm rings most.
    """

    b0: float
    b1: float
    a1: float
    a0: float
    f_al_hz: float

    @property
    def ring_down_s(self) -> float:
        """Time in which the resonance rings down to 1/e."""
        return 2.0 / self.a1

    def at(self, frequency_hz: Real) -> Complex:
        """X(jω); shape of `frequency_hz`."""
        s = 2j * math.pi * np.asarray(frequency_hz, dtype=np.float64)
        return np.asarray((self.b0 + self.b1 * s) / (s * s + self.a1 * s + self.a0))


def resonance_of(response: Callable[[Real], Complex], f_al_hz: float) -> Resonance:
    """Fit of a response around its resonance.

    Args:
        response: X at frequencies in Hz.
        f_al_hz: Frequency at which the arm rings most.

    Raises:
        ValueError: There is no resonance there that rings down.
    """
    frequency = np.geomspace(RESONANCE_BAND[0] * f_al_hz, RESONANCE_BAND[1] * f_al_hz, FIT_POINTS)
    s, wanted, scale = 2j * math.pi * frequency, response(frequency), 2.0 * math.pi * f_al_hz
    below = np.ones_like(wanted)
    found = np.zeros(4)
    for _ in range(FIT_ROUNDS):
        weight = np.sqrt(frequency) / np.abs(below)
        columns = np.stack([np.ones_like(s), s, -wanted * s, -wanted], axis=1)
        sizes = np.array([scale**2, scale, scale, scale**2])
        columns, right = columns * weight[:, np.newaxis] * sizes, wanted * s * s * weight
        both, wants = np.concatenate([columns.real, columns.imag]), np.concatenate([right.real, right.imag])
        found = np.linalg.lstsq(both, wants, rcond=None)[0] * sizes
        below = s * s + found[2] * s + found[3]
    if not (found[2] > 0.0 and found[3] > 0.0):
        raise ValueError(
            f"no resonance that rings down is found at {f_al_hz:.3g} Hz: a₁ = {found[2]:.3g}, a₀ = {found[3]:.3g}; "
            "expected both above 0"
        )
    b0, b1, a1, a0 = found.tolist()
    return Resonance(b0, b1, a1, a0, f_al_hz)


def arm_model(resonance: Resonance, reduction_ratio: float, period_s: float, sensor_delay_s: float = 0.0) -> ArmModel:
    """Sample the resonance; the input is the mean of two samples.

    Size and time of the model are corrected so that its response at f_al is exact.
    """
    a0, a1, b0, b1 = resonance.a0, resonance.a1, resonance.b0, resonance.b1
    decay, turning = 0.5 * a1, complex(a0 - 0.25 * a1 * a1) ** 0.5
    poles = np.array([-decay + 1j * turning, -decay - 1j * turning])
    vectors = np.array([[1.0, 1.0], poles])
    a = (vectors @ np.diag(np.exp(poles * period_s)) @ np.linalg.inv(vectors)).real
    b = np.linalg.solve(np.array([[0.0, 1.0], [-a0, -a1]]), (a - np.eye(2)) @ np.array([0.0, 1.0]))
    omega = 2.0 * math.pi * resonance.f_al_hz
    z = np.exp(1j * omega * period_s)
    # the sample of now is heard with the mean of this input and the one before
    made = np.array([b0, b1]) @ np.linalg.solve(z * np.eye(2) - a, b) * 0.5 * (z + 1.0)
    missing = complex(resonance.at(np.array([resonance.f_al_hz]))[0] / made)
    late_s = sensor_delay_s - float(np.angle(missing)) / omega
    return ArmModel(
        a=(float(a[0, 0]), float(a[0, 1]), float(a[1, 0]), float(a[1, 1])),
        b=(float(b[0] * abs(missing)), float(b[1] * abs(missing))),
        stiff=(a0, a1, b0, b1),
        f_al_hz=resonance.f_al_hz,
        reduction_ratio=reduction_ratio,
        delay_s=late_s,
    )


def rounding_noise_m_s2(rad_per_count: float, lever_m: float, band: Sequence[float], period_s: float) -> float:
    """Noise in the band of an acceleration from rounded angles, in m/s².

    The result is a standard deviation. The acceleration comes from second differences of an angle that is rounded to counts.

    An angle that moves is off by an even q/√12 at each sample, which the band-pass and (2 sin(ωT/2))²/T² let through.

    Args:
        rad_per_count: q.
        band: A section of the band-pass, of which there are two.
    """
    b0, b1, b2, a1, a2 = band
    back = np.exp(-1j * np.linspace(0.0, math.pi, ROUNDING_POINTS))
    section = (b0 + b1 * back + b2 * back**2) / (1.0 + a1 * back + a2 * back**2)
    passed = np.abs(1.0 - back) ** 2 * np.abs(section) ** 2
    return abs(rad_per_count * lever_m) / math.sqrt(12.0) / period_s**2 * float(np.sqrt(np.mean(passed**2)))


def band_pass(lowest_hz: float, highest_hz: float, period_s: float) -> tuple[float, float, float, float, float]:
    """Design a band-pass section for the vibration of some arms.

    Returns b₀, b₁, b₂, a₁, a₂.

    Args:
        lowest_hz: Lowest f_al.
        highest_hz: Highest f_al.
    """
    low, high = RESONANCE_BAND[0] * lowest_hz, min(RESONANCE_BAND[1] * highest_hz, OF_SAMPLING / period_s)
    low_w, high_w = (2.0 / period_s * math.tan(math.pi * each * period_s) for each in (low, high))
    width, middle = high_w - low_w, low_w * high_w
    c = 2.0 / period_s
    whole = c * c + width * c + middle
    return width * c / whole, 0.0, -width * c / whole, 2.0 * (middle - c * c) / whole, (c * c - width * c + middle) / whole
