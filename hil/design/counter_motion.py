"""Motor motion that removes the transmission error, as a sum of waves.

The waves are functions of θ_0, the motor angle without that motion.

The gear does not feel its error where θ_m = θ_0 + Δ with Δ = −a(θ_m), a = N θ_sync = Σ N A_k cos(k θ_m + φ_k), and θ_0 turns
smoothly. The error is read at the angle that the motion itself shakes: as waves of θ_0

    Δ(θ_0) = −a + a′a − (a′² a + a″a²/2) + …

so beside the orders k there are their sums and differences. They are small, k N A_k times as large, 1 % where N A_k is 5 mrad and
10 % where it is 50; but each is a sine of its own frequency, for which the loop needs a set-point of its own.
"""

import cmath
from collections.abc import Mapping
from dataclasses import dataclass

DEGREE = 3
"""Accuracy: terms of the series; the next is (k N A_k)³ times the first, 0.1 % where k N A_k is 0.1."""
LEAST = 5e-4
"""Accuracy: mixed waves that are left out are below 5e-4 of the largest order's own."""
MOST_WAVES = 32
"""Accuracy: mixed waves of an axis, the largest: of three orders all, of six up to 0.14 % of an order (k N A_k = 0.03)."""
DECIMALS = 9
"""Accuracy: decimals in which orders agree that are one."""


@dataclass(frozen=True)
class Wave:
    """One sine of a motion, Re(c e^{j k θ_0}).

    Attributes:
        coefficient: c in rad at the motor.
        degree: Number of amplitudes A_k of which c is a product; 1 for an order of the error itself.
        sources: The orders of the error from which it comes.
    """

    order: float
    coefficient: complex
    degree: int
    sources: frozenset[float]


Key = tuple[float, int, frozenset[float]]
Series = dict[Key, complex]


def counter_motion(amplitude_rad: Mapping[float, float], phase_rad: Mapping[float, float]) -> tuple[Wave, ...]:
    """Compute the waves of Δ(θ_0) = −a(θ_0 + Δ).

    Args:
        amplitude_rad: Amplitudes N A_k at the motor, by order.
        phase_rad: Phases φ_k, by order.
    """
    error = {(k, 1, frozenset({k})): cmath.rect(size, phase_rad[k]) for k, size in amplitude_rad.items()}
    slope = _derivative(error)
    second = _product(slope, error)
    third = _sum(_product(slope, second), _scaled(_product(_derivative(slope), _product(error, error)), 0.5))
    least = LEAST * max((abs(each) for each in error.values()), default=0.0)
    mixed = [
        Wave(key[0], coefficient, key[1], key[2])
        for key, coefficient in _sum(second, _scaled(third, -1.0)).items()
        if key[0] > 0.0 and abs(coefficient) > least
    ]
    mixed.sort(key=lambda wave: (-abs(wave.coefficient), wave.order))
    own = [Wave(key[0], -coefficient, 1, key[2]) for key, coefficient in error.items()]
    return (*own, *mixed[:MOST_WAVES])


def _derivative(series: Series) -> Series:
    """Derivative of a series by θ_0."""
    return {key: 1j * key[0] * coefficient for key, coefficient in series.items()}


def _scaled(series: Series, factor: float) -> Series:
    return {key: factor * coefficient for key, coefficient in series.items()}


def _sum(first: Series, second: Series) -> Series:
    return {key: first.get(key, 0.0) + second.get(key, 0.0) for key in first | second}


def _product(first: Series, second: Series) -> Series:
    """Re(x) Re(y) = Re(x y + x y*)/2, wave by wave."""
    found: Series = {}
    for (k, degree, sources), c in first.items():
        for (m, other_degree, other_sources), d in second.items():
            rest = degree + other_degree, sources | other_sources
            # a wave of a negative order is its conjugate
            difference = c * d.conjugate() if k >= m else c.conjugate() * d
            for order, coefficient in ((k + m, c * d), (abs(k - m), difference)):
                key = (round(order, DECIMALS), *rest)
                found[key] = found.get(key, 0.0) + 0.5 * coefficient
    return found
