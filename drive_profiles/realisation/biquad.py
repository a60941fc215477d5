"""Conversion of second-order filters between coefficients and frequencies.

The quadratic Q(s) = 1 + 2 ζ s/ω + s²/ω² becomes a polynomial C(x) = c₀ + c₁ x + c₂ x² in x = z⁻¹, with T the sampling time:

- bilinear, s = (2/T) (1 − x)/(1 + x), k = ωT/2:  C = (1 + x)² + (2ζ/k) (1 − x²) + (1 − x)²/k²
- bilinear prewarped: the same with k = tan(ωT/2), so that the frequency is exact
- backward Euler prewarped, s = (1 − x)/T, κ = tan(ωT):  C = 1 + (2ζ/κ) (1 − x) + (1 − x)²/κ². An undamped root s = jκ/T falls on
  z = 1/(1 − jκ), whose angle is ωT: the frequency is exact. Its modulus is cos(ωT) < 1: ζ grows by about ωT/2.

A filter is the quotient of two such, its gain at DC (x = 1) is 1.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

TWO_PI = 2.0 * math.pi
Rule = Literal["bilinear", "bilinear prewarped", "backward Euler prewarped"]
Polynomial = tuple[float, float, float]
"""Coefficients c₀, c₁, c₂ of c₀ + c₁ z⁻¹ + c₂ z⁻²."""


class Biquad(NamedTuple):
    """Coefficients of a second-order difference equation.

    y_n = b₀ u_n + b₁ u_{n−1} + b₂ u_{n−2} − a₁ y_{n−1} − a₂ y_{n−2}.
    """

    b0: float
    b1: float
    b2: float
    a1: float
    a2: float


class Quadratic(NamedTuple):
    """Frequency and damping of a quadratic in s.

    The quadratic is 1 + 2 ζ s/ω + s²/ω²; the frequency is ω/2π in Hz.
    """

    frequency_hz: float
    zeta: float


@dataclass(frozen=True)
class NotchTarget:
    """The paper's notch at one speed, eq. (6) and (7).

    Its DC gain is 1.

    Attributes:
        zero_hz: Frequency of the zeros, ω_rn / 2π = k f_m, Hz.
        pole_hz: Frequency of the poles, ω_rd / 2π = k f_m + ω_d / 2π, Hz.
        zeta_zero: Damping of the zeros, ζ_rn.
        zeta_pole: Damping of the poles, ζ_rd.

    Raises:
        ValueError: A frequency or damping is not positive and finite, or the zeros are not damped less than the poles.
    """

    zero_hz: float
    pole_hz: float
    zeta_zero: float
    zeta_pole: float

    def __post_init__(self) -> None:
        """Refuse values that make no filter."""
        for name in ("zero_hz", "pole_hz", "zeta_zero", "zeta_pole"):
            value = getattr(self, name)
            if not (value > 0.0 and math.isfinite(value)):
                raise ValueError(f"{name} = {value} must be positive and finite")
        if self.zeta_zero >= self.zeta_pole:
            raise ValueError(f"zeta_zero = {self.zeta_zero:g} must be below zeta_pole = {self.zeta_pole:g} to make a notch")

    @classmethod
    def at_speed(cls, order: float, speed_rps: float, offset_hz: float, zeta_rn: float, zeta_rdth: float) -> "NotchTarget":
        """Return the notch for one motor speed.

        Its zeros are at k f_m (the harmonic order k, revolutions per second), its poles ω_d/2π above, with dampings ζ_rn and
        ζ_rd.

        Raises:
            ValueError: A frequency or damping is not positive and finite.

        Source: the paper, eq. (6), (7) and Table 3.
        """
        zero_hz = order * speed_rps
        return cls(zero_hz, zero_hz + offset_hz, zeta_rn, zeta_rdth)

    @property
    def offset_hz(self) -> float:
        """ω_d / 2π."""
        return self.pole_hz - self.zero_hz

    @property
    def shape(self) -> "Shape":
        """The target as a continuous filter."""
        return Shape(self.zero_hz, self.zeta_zero, self.pole_hz, self.zeta_pole, 1.0, is_stable=True)


@dataclass(frozen=True)
class Shape:
    """A continuous filter, as the bilinear transform relates it to a biquad.

    F(s) = g (s²/ω_z² + 2 ζ_z s/ω_z + 1) / (s²/ω_p² + 2 ζ_p s/ω_p + 1).

    A pair of roots that is not an oscillation (one at or beyond s = 0) has frequency 0 and damping ∞, one at infinity
    frequency ∞ and damping 0.

    Attributes:
        dc_gain: Gain at DC, g; infinite where the denominator vanishes at DC.
        is_stable: True if both poles are inside the unit circle.
    """

    zero_hz: float
    zeta_zero: float
    pole_hz: float
    zeta_pole: float
    dc_gain: float
    is_stable: bool

    @property
    def is_notch(self) -> bool:
        """True if the filter is a stable notch with a DC gain."""
        pairs = ((self.zero_hz, self.zeta_zero), (self.pole_hz, self.zeta_pole))
        return self.is_stable and math.isfinite(self.dc_gain) and all(0 < f < math.inf and 0 <= zeta < 1 for f, zeta in pairs)

    def gain_db(self, frequency_hz: float) -> float:
        """Return the gain in dB, 20 log₁₀ |F(j 2π f)|.

        It is −∞ at an undamped zero.
        """

        def value(f: float, zeta: float) -> float:
            ratio = frequency_hz / f if f > 0.0 else math.inf
            return abs(complex(1.0 - ratio * ratio, 2.0 * zeta * ratio))

        magnitude = abs(self.dc_gain) * value(self.zero_hz, self.zeta_zero) / value(self.pole_hz, self.zeta_pole)
        return 20.0 * math.log10(magnitude) if magnitude > 0.0 else -math.inf


def shape_of(biquad: Biquad, period_s: float) -> Shape:
    """Recompute zeros, poles and DC gain from coefficients.

    With s = (2/T)(z − 1)/(z + 1) put back in, n₀ = Σb, n₁ = 2 (b₀ − b₂), n₂ = b₀ − b₁ + b₂ belong to 1, sT/2 and (sT/2)². Hence
    ω_z = (2/T) √(n₀/n₂), ζ_z = n₁/(2 √(n₀ n₂)), and the same for the poles with 1, a₁, a₂. At the sampling rates of drives n₀ is
    at most 10⁻⁴ while b₁ is 2, so short words lose the filter here.
    """
    zero = quadratic_of((biquad.b0, biquad.b1, biquad.b2), period_s)
    pole = quadratic_of((1.0, biquad.a1, biquad.a2), period_s)
    denominator = 1.0 + biquad.a1 + biquad.a2
    dc_gain = (biquad.b0 + biquad.b1 + biquad.b2) / denominator if denominator else math.inf
    is_stable = abs(biquad.a2) < 1.0 and abs(biquad.a1) < 1.0 + biquad.a2  # Jury's triangle
    return Shape(zero.frequency_hz, zero.zeta, pole.frequency_hz, pole.zeta, dc_gain, is_stable)


def polynomial_of(quadratic: Quadratic, period_s: float, rule: Rule = "bilinear") -> Polynomial:
    """Return the polynomial C(z⁻¹) of a quadratic in s.

    Raises:
        ValueError: The rule has no such frequency at this sampling time.
    """
    frequency_hz, zeta = quadratic
    angle = TWO_PI * frequency_hz * period_s
    limit = {"bilinear": math.inf, "bilinear prewarped": math.pi, "backward Euler prewarped": math.pi / 2}[rule]
    if not 0.0 < angle < limit:
        raise ValueError(f"{frequency_hz:g} Hz is not possible with the {rule} transform at {1e6 * period_s:g} µs")
    if rule == "backward Euler prewarped":
        k = math.tan(angle)
        p1, p2 = 2.0 * zeta / k, 1.0 / (k * k)
        return 1.0 + p1 + p2, -p1 - 2.0 * p2, p2
    k = angle / 2.0 if rule == "bilinear" else math.tan(angle / 2.0)
    p1, p2 = 2.0 * zeta / k, 1.0 / (k * k)
    return 1.0 + p1 + p2, 2.0 * (1.0 - p2), 1.0 - p1 + p2


def quadratic_of(polynomial: Polynomial, period_s: float, rule: Rule = "bilinear") -> Quadratic:
    """Return the quadratic in s that a rule maps to a polynomial.

    A root at or beyond s = 0 gives frequency 0 with damping ∞, a root at infinity gives frequency ∞ with damping 0.
    """
    c0, c1, c2 = polynomial
    if rule == "backward Euler prewarped":
        p0, p1, p2 = c0 + c1 + c2, -(c1 + 2.0 * c2), c2
    else:
        p0, p1, p2 = c0 + c1 + c2, 2.0 * (c0 - c2), c0 - c1 + c2
    if p2 == 0.0:
        return Quadratic(math.inf, 0.0)
    if p0 * p2 <= 0.0:
        return Quadratic(0.0, math.inf)
    k = math.sqrt(p0 / p2)
    zeta = math.copysign(p1, p1 * p2) / (2.0 * math.sqrt(p0 * p2))
    if rule == "backward Euler prewarped":
        return Quadratic(math.atan(k) / (TWO_PI * period_s), zeta)
    return Quadratic((k if rule == "bilinear" else math.atan(k)) / (math.pi * period_s), zeta)


def biquad_of(zero: Quadratic, pole: Quadratic, period_s: float, rule: Rule = "bilinear") -> Biquad:
    """Return the filter with given zeros and poles and DC gain 1.

    Raises:
        ValueError: The rule has no such frequency at this sampling time.
    """
    n0, n1, n2 = polynomial_of(zero, period_s, rule)
    d0, d1, d2 = polynomial_of(pole, period_s, rule)
    return Biquad(n0 / d0, n1 / d0, n2 / d0, d1 / d0, d2 / d0)


def stated(held: Quadratic, period_s: float, rule: Rule) -> Quadratic:
    """Return the quadratic to state, for which the drive holds ``held``."""
    return quadratic_of(polynomial_of(held, period_s), period_s, rule)


def factors(numerator: list[float], denominator: list[float]) -> tuple[Biquad, Biquad]:
    """Factor a filter of order 4 into two biquads in series.

    The coefficients are those of the powers of z⁻¹, a₀ = 1. The roots lie close to z = 1, where a polynomial in z says little
    about them; they are sought in w = z − 1. For coefficients of 24 bits the shift to w is exact in double precision. Poles and
    zeros are paired by frequency.
    """
    pairs_b, gain = _pairs(numerator)
    pairs_a, _ = _pairs(denominator)
    (n1, n2), (d1, d2) = pairs_b, pairs_a
    return Biquad(gain * n1[0], gain * n1[1], gain * n1[2], d1[1], d1[2]), Biquad(*n2, d2[1], d2[2])


def _pairs(coefficients: list[float]) -> tuple[tuple[Polynomial, Polynomial], float]:
    """Factor a polynomial of order 4 into two quadratics.

    They are in z⁻¹, the one with roots nearest to z = 1 first; a constant factor is returned, too.
    """
    leading = next((n for n, c in enumerate(coefficients) if c != 0.0), len(coefficients) - 1)
    roots = 1.0 + _roots_about_one(np.array(coefficients[leading:]))
    above = sorted((r for r in roots if r.imag > 0.0), key=lambda r: abs(r - 1.0))
    real = sorted((r.real for r in roots if r.imag == 0.0), key=lambda r: abs(r - 1.0))
    quadratics: list[list[float]] = [[1.0, -2.0 * r.real, abs(r) ** 2] for r in above]
    while real:
        two, real = real[:2], real[2:]
        quadratics.append([1.0, -sum(two), math.prod(two)] if len(two) == 2 else [1.0, -two[0]])
    quadratics.sort(key=lambda c: abs(sum(c)))
    quadratics += [[1.0]] * (2 - len(quadratics))
    padded = [[0.0] * (3 - len(c)) + c for c in quadratics]  # b₀ = 0 is a delay
    first, second = ((c[0], c[1], c[2]) for c in padded)
    return (first, second), coefficients[leading]


def _roots_about_one(descending: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return a polynomial's roots, shifted by 1 to w."""
    shifted = descending.copy()
    for last in range(len(shifted) - 1, 0, -1):  # repeated synthetic division by z − 1
        for n in range(1, last + 1):
            shifted[n] += shifted[n - 1]
    return np.asarray(np.roots(shifted), dtype=np.complex128)
