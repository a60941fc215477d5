"""Limits, ramps and windows of CiA 402 as one table.

A new limit is a row here, beside its name (`drive_profiles.standard.cia402`), its entry (`cia402_objects`), its field
(`plant_emulator.motion.record`: `MOTION` and `UNTIL_WRITTEN`) and the control period that applies it.

Source: CiA 402-2 (IEC 61800-7-201), object dictionary.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from drive_profiles.standard.cia402 import Object
from drive_profiles.standard.units import Scaling
from plant_emulator.motion.record import UNTIL_WRITTEN

TARGET_WINDOW_RAD = 2.0 * math.pi / 1000.0
"""Position window where 6067h states none; friction may leave the motor some counts away."""

QUICK_STOP_RAD_S2 = 50.0 * 2.0 * math.pi
"""Ramp of the quick stop where 6085h states none that is understood."""

SLOW_RAD_S = 2.0 * math.pi / 10.0
"""Velocity window and velocity threshold where 606Dh and 606Fh state none."""


class Quantity(NamedTuple):
    """A physical quantity of CiA 402.

    Args:
        unit: SI unit, as a drive profile spells it.
        si: Gives the value in this unit, of a number on the bus as the standard counts.
    """

    unit: str
    si: Callable[[Scaling, Any], float]


TORQUE = Quantity("N·m", lambda scaling, value: float(value * scaling.torque_quantum_nm))
TORQUE_SLOPE = Quantity("N·m/s", TORQUE.si)
SPEED = Quantity("rad/s", lambda scaling, value: abs(float(scaling.speed_rad_s(value))))  # whatever direction 607Eh gives it
MOTOR_SPEED = Quantity("rad/s", lambda _, value: float(value * 2.0 * math.pi / 60.0))  # in rev/min, whatever the user's units
ACCELERATION = Quantity("rad/s²", lambda scaling, value: float(scaling.acceleration_rad_s2(value)))
POSITION = Quantity("rad", lambda scaling, value: abs(float(scaling.position_rad(value))))
TIME = Quantity("s", lambda _, value: float(1e-3 * value))


@dataclass(frozen=True, slots=True)
class Limit:
    """An object that limits the motion, ramp or window.

    Args:
        field: Field of `MOTION` that it fills by itself, a time in control periods; None if more belongs to it.
        unscaled: Limit that acts where the family states the object without a scale; None: its number is read as the standard's.
        is_ramp: A value of 0 would have no end, and counts as 1.

    Raises:
        KeyError: The field has no value in `UNTIL_WRITTEN`.
    """

    index: Object
    quantity: Quantity
    field: str | None = None
    unscaled: Callable[[Scaling], float] | None = None
    is_ramp: bool = False

    def __post_init__(self) -> None:
        """Refuse a field that would limit an axis without a drive."""
        if self.field is not None and self.field not in UNTIL_WRITTEN:
            raise KeyError(f"{self.index.name}: {self.field} has no value in UNTIL_WRITTEN")


def _always(value: float) -> Callable[[Scaling], float]:
    return lambda _: value


_NO_LIMIT, _NO_TIME, _SLOW = _always(math.inf), _always(0.0), _always(SLOW_RAD_S)
_QUICK_STOP = _always(QUICK_STOP_RAD_S2)

_ROWS = (
    # by themselves
    Limit(Object.MAX_MOTOR_SPEED, MOTOR_SPEED, "max_speed_rad_s", _NO_LIMIT),
    Limit(Object.MAX_PROFILE_VELOCITY, SPEED, "max_profile_speed_rad_s", _NO_LIMIT),
    Limit(Object.MAX_ACCELERATION, ACCELERATION, "max_acceleration_rad_s2", _NO_LIMIT, is_ramp=True),
    Limit(Object.MAX_DECELERATION, ACCELERATION, "max_deceleration_rad_s2", _NO_LIMIT, is_ramp=True),
    Limit(Object.PROFILE_ACCELERATION, ACCELERATION, "profile_acceleration_rad_s2", is_ramp=True),
    Limit(Object.PROFILE_DECELERATION, ACCELERATION, "profile_deceleration_rad_s2", is_ramp=True),
    Limit(Object.TORQUE_SLOPE, TORQUE_SLOPE, "torque_slope_nm_s", lambda scaling: 10.0 * scaling.rated_torque_nm, is_ramp=True),
    Limit(Object.FOLLOWING_ERROR_TIMEOUT, TIME, "following_periods"),
    Limit(Object.POSITION_WINDOW_TIME, TIME, "position_window_periods", _NO_TIME),
    Limit(Object.VELOCITY_WINDOW, SPEED, "velocity_window_rad_s", _SLOW),
    Limit(Object.VELOCITY_WINDOW_TIME, TIME, "velocity_window_periods", _NO_TIME),
    Limit(Object.VELOCITY_THRESHOLD, SPEED, "velocity_threshold_rad_s", _SLOW),
    Limit(Object.VELOCITY_THRESHOLD_TIME, TIME, "velocity_threshold_periods", _NO_TIME),
    # together with others, or with what the drive is doing: see `DriveLimits`
    Limit(Object.MAX_TORQUE, TORQUE),
    Limit(Object.POSITIVE_TORQUE_LIMIT, TORQUE, unscaled=_NO_LIMIT),
    Limit(Object.NEGATIVE_TORQUE_LIMIT, TORQUE, unscaled=_NO_LIMIT),
    Limit(Object.SOFTWARE_POSITION_LIMIT, POSITION),
    Limit(Object.FOLLOWING_ERROR_WINDOW, POSITION, unscaled=_NO_LIMIT),
    Limit(Object.POSITION_WINDOW, POSITION, unscaled=_always(TARGET_WINDOW_RAD)),
    Limit(Object.PROFILE_VELOCITY, SPEED),
    Limit(Object.QUICK_STOP_DECELERATION, ACCELERATION, unscaled=_QUICK_STOP, is_ramp=True),
    # read when homing begins
    Limit(Object.HOMING_SPEEDS, SPEED),
    Limit(Object.HOMING_ACCELERATION, ACCELERATION, is_ramp=True),
)

MOTION_LIMITS: dict[int, Limit] = {row.index: row for row in _ROWS}
"""All limits by their index."""
