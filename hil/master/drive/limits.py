"""Limits of the bench file, and the drive's parameters for them.

The master alone holds limits for which a drive has no parameter.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Final, Literal, NamedTuple

from drive_profiles.family.parameter import Parameter
from drive_profiles.family.profile import Profile
from drive_profiles.standard.units import Scaling
from hil.bench.bench import Limits

_TURN = 2.0 * math.pi

Holder = Literal["drive", "master alone", "drive, as found", "nobody"]
"""Who holds a limit: the drive and the master; the master alone; the drive with the value that it has; nobody."""

_SUFFIXES: Final[Mapping[str, tuple[str, ...]]] = {
    "N·m": ("_nm", "_per_mille"),
    "rad/s": ("_rad_s", "_rps"),
    "rad": ("_rad", "_counts", "_deg"),
    "s": ("_s",),
    "rad/s²": ("_rad_s2",),
}
"""Ends of the names under which a profile has a quantity: with a unit, so that its scale is known."""


class Limit(NamedTuple):
    """A limit of the bench file, and the drives' parameters for it.

    Attributes:
        key: Key of the bench file.
        stems: Names of the parameter without their unit; the first one that a profile has counts.
        factor: SI units per unit of the bench file.
        is_watched: True if the master holds the limit as well.
        at_least: Key of a limit that is a lower bound of the drive's value; None without one.
    """

    key: str
    stems: tuple[str, ...]
    unit: str
    factor: float
    is_watched: bool = True
    at_least: str | None = None

    def held_by(self, profile: Profile) -> str | None:
        """Return the name of a drive's parameter for the limit."""
        names = (stem + suffix for stem in self.stems for suffix in _SUFFIXES[self.unit])
        return next((name for name in names if name in profile.parameters and profile.parameters[name].is_settable), None)

    def holder(self, profile: Profile) -> Holder:
        """Who holds the limit."""
        if self.held_by(profile) is not None:
            return "drive"
        if not self.is_watched:
            return "drive, as found"
        return "nobody" if self.key == "torque_nm" and not tells_torque(profile) else "master alone"

    def si(self, limits: Limits) -> float | None:
        """Return the bench file's value in SI units, or None."""
        stated = [getattr(limits, key) for key in (self.key, self.at_least) if key is not None]
        return None if stated[0] is None else self.factor * float(max(stated))


LIMITS: Final = (
    Limit("torque_nm", ("torque_limit",), "N·m", 1.0),
    Limit("speed_rps", ("speed_limit", "velocity_limit"), "rad/s", _TURN),
    Limit("acceleration_rps_s", ("max_acceleration",), "rad/s²", _TURN),
    Limit("acceleration_rps_s", ("max_deceleration",), "rad/s²", _TURN, at_least="quick_stop_rps_s"),  # it bounds that ramp too
    Limit("position_min_rev", ("position_limit_min",), "rad", _TURN),
    Limit("position_max_rev", ("position_limit_max",), "rad", _TURN),
    Limit("following_error_rev", ("following_error_window", "following_error_limit"), "rad", _TURN),
    Limit("following_error_timeout_s", ("following_error_timeout",), "s", 1.0),
    Limit("quick_stop_rps_s", ("quick_stop_deceleration",), "rad/s²", _TURN, is_watched=False),
)
"""All limits of an axis; where drives hold one by several objects, the first tells who holds it."""


def limit_of(key: str) -> Limit:
    """The limit of a key of the bench file."""
    return next(limit for limit in LIMITS if limit.key == key)


def tells_torque(profile: Profile) -> bool:
    """True if the drive reports a torque, or a usable current.

    The torque follows from the current.
    """
    return profile.torque is not None and (profile.torque.actual is not None or tells_current(profile))


def tells_current(profile: Profile) -> bool:
    """True if the drive reports a current in place of a torque."""
    torque = profile.torque
    return torque is not None and torque.actual is None and torque.current is not None


def value_in(parameter: Parameter, si: float, scaling: Scaling) -> float:
    """A value in the unit of a parameter.

    Args:
        parameter: The parameter; its unit is SI, or one of the drive's own.
    """
    match parameter.unit:
        case "per mille":
            return round(si / scaling.torque_quantum_nm)
        case "counts":
            return round(si * scaling.counts_per_rad)
        case "°":  # of the joint: the steps are those of the drive's positions
            return round(si * scaling.counts_per_rad) * parameter.value_per_step(scaling)
        case "rev/s":
            return si / _TURN
        case _:
            return si


def holders(profile: Profile) -> dict[Holder, list[str]]:
    """Return the keys of the bench file's limits by holder."""
    found: dict[Holder, list[str]] = {}
    for key in dict.fromkeys(limit.key for limit in LIMITS):
        held = [limit.holder(profile) for limit in LIMITS if limit.key == key]
        found.setdefault(next((each for each in held if each != "drive"), "drive"), []).append(key)
    return found


_SENTENCES: Final[Mapping[Holder, str]] = {
    "master alone": "the master alone holds {}",
    "drive, as found": "the drive keeps its own value for {}",
    "nobody": "neither master nor drive holds {}: the drive neither limits nor reports torque; set its current limit with its "
    "maker's tool",
}


def limit_words(number: int, profile: Profile, limits: Limits) -> Iterable[str]:
    """Yield a sentence per holder on limits a drive does not hold.

    Args:
        limits: Limits of the axis; unstated ones have no sentence.
    """
    found = holders(profile)
    for holder, sentence in _SENTENCES.items():
        stated = [f"limits.{key}" for key in found.get(holder, ()) if getattr(limits, key) is not None]
        if stated:
            yield f"axis {number}: {sentence.format(', '.join(stated))}"
