"""Plants that an axis might have."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from hil.design.frequency import TwoInertia
from hil.design.transmission_error import TransmissionError

DEFAULT_PERCENT = 5.0
"""Uncertainty of gear stiffness and arm inertia where no other is given."""

CORNER_SIGMAS = 2.0
"""Probability: standard errors by which a value may well be off, as a corner is: chance does it to one of 22. What is no more is
not told from 0."""

LIKELY = (0.04, 0.4, 0.003)
"""Measured: deviations of a model's ln f and ln ζ, and of the sensor's delay in s: plants and ramps of the drawn robots 10700 to
10764 differ by 0.013 and 0.42 (rms)."""

LEAST_SPREAD = 0.03
"""Least relative distance of a corner: standard errors do not tell how far load, temperature and wear take a robot."""


@dataclass(frozen=True)
class Member:
    """One plant of the set.

    Attributes:
        label: Its difference in words; `nominal` for that one.
        factors: Factors of the values that set it apart from the nominal one, by symbol.
    """

    label: str
    plant: TwoInertia
    error: TransmissionError
    factors: Mapping[str, float] = field(default_factory=dict)


def around(
    plant: TwoInertia,
    error: TransmissionError,
    *,
    percent: float | None = None,
    standard_error: Mapping[str, float] | None = None,
    amplitude_error_arcsec: Mapping[float, float] | None = None,
) -> tuple[Member, ...]:
    """Build the nominal plant and four corners around it.

    Without standard errors the corners are K_g and J_l, each by `percent` up or down. With them they are f_a and K_g by two
    standard errors, but 3 % at least, J_l following from both: a frequency response gives f_a ten times better than K_g or J_l.
    The corners have a gear damping and amplitudes two standard errors to the worse side.

    Args:
        percent: Uncertainty of K_g and J_l; it wins over the standard errors where both are given. 0: only the nominal plant.
        standard_error: Standard errors by the names of `TwoInertia`, and `antiresonance_hz`.

    Raises:
        ValueError: The percentage is not within 0 … 50, or above 0 and below `LEAST_SPREAD`.
    """
    nominal = Member("nominal", plant, error)
    known = dict(standard_error or {})
    if percent is None and not (known.keys() & {"gear_stiffness_nm_rad", "arm_inertia_kg_m2", "antiresonance_hz"}):
        percent = DEFAULT_PERCENT
    if percent is not None and not 0.0 <= percent <= 50.0:
        raise ValueError(f"an uncertainty of {percent} % is not within 0 … 50 %")
    if percent is not None and 0.0 < percent < 100.0 * LEAST_SPREAD:
        least = 100.0 * LEAST_SPREAD
        raise ValueError(
            f"an uncertainty of {percent} % is below the {least:g} % by which f_a varies in any case; choose 0 for "
            f"none, or at least {least:g} %"
        )
    amplitudes = {
        order: amplitude + CORNER_SIGMAS * (amplitude_error_arcsec or {}).get(order, 0.0)
        for order, amplitude in error.amplitude_arcsec.items()
    }
    larger = TransmissionError(amplitudes, error.phase_deg)
    damping = max(
        0.3 * plant.gear_damping_nm_s_rad, plant.gear_damping_nm_s_rad - CORNER_SIGMAS * known.get("gear_damping_nm_s_rad", 0.0)
    )
    worse = replace(plant, gear_damping_nm_s_rad=damping)
    if percent is not None:
        if percent == 0.0:
            return (nominal,)
        fraction = percent / 100.0
        return (nominal, *(_by_parts(worse, larger, fraction, signs) for signs in itertools.product((-1.0, 1.0), repeat=2)))
    return (nominal, *(_by_frequency(worse, larger, known, signs) for signs in itertools.product((-1.0, 1.0), repeat=2)))


def _by_parts(plant: TwoInertia, error: TransmissionError, fraction: float, signs: tuple[float, ...]) -> Member:
    stiffness, inertia = (1.0 + sign * fraction for sign in signs)
    changed = replace(
        plant,
        gear_stiffness_nm_rad=plant.gear_stiffness_nm_rad * stiffness,
        arm_inertia_kg_m2=plant.arm_inertia_kg_m2 * inertia,
    )
    return _member({"K_g": stiffness, "J_l": inertia}, changed, error)


def _by_frequency(plant: TwoInertia, error: TransmissionError, known: Mapping[str, float], signs: tuple[float, ...]) -> Member:
    """Build the corner with f_a and K_g off by two standard errors.

    The distance is 3 % at least. If f_a has no standard error, it follows from those of K_g and J_l.
    """
    relative = {
        name: known.get(name, 0.0) / getattr(plant, name)
        for name in ("gear_stiffness_nm_rad", "arm_inertia_kg_m2", "antiresonance_hz")
    }
    part = 0.5 * math.hypot(relative["gear_stiffness_nm_rad"], relative["arm_inertia_kg_m2"])
    frequency = 1.0 + signs[0] * max(LEAST_SPREAD, CORNER_SIGMAS * (relative["antiresonance_hz"] or part))
    stiffness = 1.0 + signs[1] * max(
        LEAST_SPREAD, CORNER_SIGMAS * (relative["gear_stiffness_nm_rad"] or relative["arm_inertia_kg_m2"])
    )
    inertia = stiffness / frequency**2
    changed = replace(
        plant,
        gear_stiffness_nm_rad=plant.gear_stiffness_nm_rad * stiffness,
        arm_inertia_kg_m2=plant.arm_inertia_kg_m2 * inertia,
    )
    return _member({"f_a": frequency, "K_g": stiffness}, changed, error)


def _member(factors: Mapping[str, float], plant: TwoInertia, error: TransmissionError) -> Member:
    return Member(", ".join(f"{name} {_percent(factor)}" for name, factor in factors.items()), plant, error, factors)


def plants_words(members: Sequence[Member]) -> str:
    """Describe the plants of a design and how far they differ."""
    return f"{len(members)} plants: {spread_words(members)}" if len(members) > 1 else "the nominal plant only"


def spread_words(members: Sequence[Member]) -> str:
    """Describe the distance of the corners from the nominal plant."""
    names = list(dict.fromkeys(name for member in members for name in member.factors))
    reach = {name: max(abs(member.factors.get(name, 1.0) - 1.0) for member in members) for name in names}
    return ", ".join(f"{name} ±{100.0 * distance:.2g} %" for name, distance in reach.items())


def _percent(factor: float) -> str:
    return f"{100.0 * (factor - 1.0):+.2g} %".replace("-", "−")
