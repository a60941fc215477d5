"""A drive's process data: what the CiA 402 part of its dictionary says, in the units and arrays of its axis, and back."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from drive_profiles.cia301 import SdoAbortCode
from drive_profiles.cia402 import Object
from drive_profiles.units import Scaling
from plant_emulator import motion as law
from plant_emulator.axes import Axes, live
from plant_emulator.personality import Personality

_INT16, _INT32 = 2**15 - 1, 2**31 - 1

TARGET_WINDOW_RAD = 2.0 * math.pi / 1000.0
"""How near the motor must be to count as arrived; friction may leave it a few encoder counts away for a while."""

_LIMITS = (
    (Object.MAX_TORQUE, 0),
    (Object.MAX_MOTOR_SPEED, 0),
    (Object.SOFTWARE_POSITION_LIMIT, 1),
    (Object.SOFTWARE_POSITION_LIMIT, 2),
    (Object.FOLLOWING_ERROR_WINDOW, 0),
    (Object.FOLLOWING_ERROR_TIMEOUT, 0),
    (Object.PROFILE_VELOCITY, 0),
    (Object.PROFILE_ACCELERATION, 0),
    (Object.PROFILE_DECELERATION, 0),
    (Object.QUICK_STOP_DECELERATION, 0),
)


_RAMPS = frozenset({Object.PROFILE_ACCELERATION, Object.PROFILE_DECELERATION, Object.QUICK_STOP_DECELERATION})

_SI: dict[int, Callable[[Scaling, Any], float]] = {
    Object.MAX_TORQUE: lambda scaling, value: float(value * scaling.torque_quantum_nm),
    Object.MAX_MOTOR_SPEED: lambda _, value: float(value * 2.0 * math.pi / 60.0),
    Object.SOFTWARE_POSITION_LIMIT: lambda scaling, value: scaling.position_rad(value),
    Object.FOLLOWING_ERROR_WINDOW: lambda scaling, value: scaling.position_rad(value),
    Object.FOLLOWING_ERROR_TIMEOUT: lambda _, value: float(1e-3 * value),
    Object.PROFILE_VELOCITY: lambda scaling, value: scaling.speed_rad_s(value),
    Object.PROFILE_ACCELERATION: lambda scaling, value: scaling.speed_rad_s(value),
    Object.PROFILE_DECELERATION: lambda scaling, value: scaling.speed_rad_s(value),
    Object.QUICK_STOP_DECELERATION: lambda scaling, value: scaling.speed_rad_s(value),
}
"""What the objects mean in SI units where the manufacturer does not say otherwise: counts, per mille, rev/min and ms."""


def clip(value: float, limit: int = _INT32) -> int:
    """The nearest whole number within ±limit: what an object can hold."""
    nearest = round(value)
    return nearest if -limit <= nearest <= limit else int(max(-limit, min(limit, nearest)))


class DriveData:
    """Ties the entries of a dictionary to one row of the axes: live values, and checks of what is written.

    Attributes:
        motion: The axis' row of process data.
        scaling: How the drive counts.
        halted: Whether the halt bit holds the profile at speed 0.
    """

    def __init__(self, axes: Axes, number: int, personality: Personality, is_powered: Callable[[], bool]) -> None:
        """Bind the dictionary.

        Args:
            axes: The mechanics.
            number: Axis number.
            personality: The drive's manufacturer, with the dictionary.
            is_powered: Whether the motor is, or may be, under torque.
        """
        self.axes, self.row = axes, axes.row(number)
        self.motion: Any = axes.motion[self.row]
        self.scaling = personality.scaling
        self.halted = False
        self._personality = personality
        self._dictionary = personality.dictionary
        self._is_powered = is_powered
        self._motor_limit_nm = axes.robot.axis[number].torque_limit_nm
        self._control_period_s = axes.robot.control_period_s
        self._rated_place, self._rated_step_nm = personality.rated_torque
        self._is_rated_fixed = not self._dictionary.cell(*self._rated_place).entry.access.is_writable
        self.motion["counts_per_rad"] = self.scaling.counts_per_rad
        self._speeds, self._torques = live(axes.cascade_state, "speed_rad_s"), live(axes.motion, "torque_nm")
        self._following_errors = live(axes.motion, "following_error_rad")
        self._target, self._offset = (self._dictionary.cell(index) for index in (Object.TARGET_POSITION, Object.POSITION_OFFSET))
        self._bind_values()
        self._bind_writers()

    def value(self, index: int, subindex: int = 0) -> Any:
        """What an entry holds."""
        return self._dictionary.cell(index, subindex).value

    def si(self, index: int, subindex: int = 0) -> float:
        """What acts of a limit, a speed or a ramp, in SI units."""
        place = index, subindex
        value, step = self._personality.acting(place), self._personality.steps.get(place)
        if index in _RAMPS and value <= 0:
            value = 1  # a ramp of 0 would have no end
        return _SI[index](self.scaling, value) if step is None else float(value * step)

    # -- what is read --------------------------------------------------------------------------------------------------

    def _bind_values(self) -> None:
        read: dict[tuple[int, int], Callable[[], Any]] = {
            (Object.POSITION_ACTUAL, 0): self._position_counts,
            (Object.VELOCITY_ACTUAL, 0): lambda: clip(self.speed_rad_s * self.scaling.counts_per_rad),
            (Object.TORQUE_ACTUAL, 0): self._torque_per_mille,
            (Object.FOLLOWING_ERROR_ACTUAL, 0): self._following_error_counts,
        }
        for (index, sub), hook in read.items():
            self._dictionary.on_read(index, sub, hook)

    @property
    def speed_rad_s(self) -> float:
        """Motor speed as the law sees it."""
        return float(self._speeds[self.row])

    def _position_counts(self) -> int:
        return clip(self.axes.counts(self.row))

    def _torque_per_mille(self) -> int:
        return clip(1000.0 * self._torques[self.row] / self.scaling.rated_torque_nm, _INT16)

    def _following_error_counts(self) -> int:
        return clip(self._following_errors[self.row] * self.scaling.counts_per_rad)

    @property
    def is_target_reached(self) -> bool:
        """Profile position: the motor itself is where it was sent, or (halted) stands; not only its reference."""
        motion = self.motion
        if motion["reference_speed_rad_s"] != 0.0:
            return False
        if self.halted:
            return abs(self.speed_rad_s) < law.STOPPED_RAD_S
        window = max(TARGET_WINDOW_RAD, 1.0 / self.scaling.counts_per_rad)
        way_left = motion["target_counts"] / motion["counts_per_rad"] - motion["reference_rad"]
        return bool(abs(way_left) < 1e-9 and abs(motion["following_error_rad"]) <= window)

    def interpolation_ticks(self) -> float:
        """Control periods per set-point, from 60C2h."""
        value, index = self.value(Object.INTERPOLATION_PERIOD, 1), self.value(Object.INTERPOLATION_PERIOD, 2)
        return float(value * 10.0**index / self._control_period_s)

    def cyclic_target_counts(self) -> int:
        """Where cyclic position mode shall go: 607Ah + 60B0h (CiA 402: the offset is added to the target)."""
        return int(self._target.value + self._offset.value)  # type: ignore[operator]

    # -- what is written -----------------------------------------------------------------------------------------------

    def _bind_writers(self) -> None:
        on_write = self._dictionary.on_write
        on_write(0x1006, 0, self._write_cycle_period)
        for index, sub in _LIMITS:
            on_write(index, sub, self._limit_writer(index, sub))
        on_write(Object.VELOCITY_OFFSET, 0, self._set_point_writer("velocity_offset_rad_s", self._speed))
        on_write(Object.TORQUE_OFFSET, 0, self._set_point_writer("torque_offset_nm", self._torque))
        on_write(Object.TARGET_TORQUE, 0, self._set_point_writer("target_torque_nm", self._torque))
        if not self._is_rated_fixed:
            on_write(*self._rated_place, self._write_rated_torque)

    def _speed(self, value: int) -> float:
        return self.scaling.speed_rad_s(value)

    def _torque(self, value: int) -> float:
        return value * self.scaling.torque_quantum_nm

    def _write_cycle_period(self, value: int) -> SdoAbortCode | None:
        """1006h must be a whole number of control periods: the world advances by it."""
        return SdoAbortCode.INVALID_VALUE if 1000 * value % round(1e9 * self._control_period_s) else None

    def _write_rated_torque(self, value: float) -> SdoAbortCode | None:
        """All torques are per mille of it, so it does not change under torque, and 0 has no inverse."""
        if self._is_powered():
            return SdoAbortCode.DEVICE_STATE
        if value <= 0:
            return SdoAbortCode.VALUE_TOO_LOW
        self._dictionary.cell(*self._rated_place).value = value
        self._apply_rated_torque()
        self.apply_limits()
        return None

    def _apply_rated_torque(self) -> None:
        if not self._is_rated_fixed:
            self.scaling = replace(self.scaling, rated_torque_nm=self.value(*self._rated_place) * self._rated_step_nm)

    def _limit_writer(self, index: int, sub: int) -> Callable[[Any], SdoAbortCode | None]:
        cell = self._dictionary.cell(index, sub)

        def write(value: Any) -> SdoAbortCode | None:
            cell.value = value
            self.apply_limits()
            return None

        return write

    def _set_point_writer(self, field: str, convert: Callable[[int], float]) -> Callable[[int], SdoAbortCode | None]:
        place, row = live(self.axes.motion, field), self.row

        def write(value: int) -> SdoAbortCode | None:
            place[row] = convert(value)
            return None

        return write

    def apply(self) -> None:
        """Put the whole dictionary into force, after a reset."""
        self._apply_rated_torque()
        self._personality.apply()
        self.apply_limits()

    def apply_limits(self) -> None:
        """Put limits, ramps and set-points into force."""
        motion = self.motion
        motion["torque_limit_nm"] = min(self._motor_limit_nm, self.si(Object.MAX_TORQUE))
        motion["max_speed_rad_s"] = self.si(Object.MAX_MOTOR_SPEED)
        motion["low_counts"], motion["high_counts"] = self._limits_counts()
        is_watched = self._personality.acting((Object.FOLLOWING_ERROR_WINDOW, 0)) not in self._personality.unwatched_windows
        motion["following_window_rad"] = self.si(Object.FOLLOWING_ERROR_WINDOW) if is_watched else math.inf
        motion["following_ticks"] = round(self.si(Object.FOLLOWING_ERROR_TIMEOUT) / self._control_period_s)
        motion["profile_acceleration_rad_s2"] = self.si(Object.PROFILE_ACCELERATION)
        motion["profile_deceleration_rad_s2"] = self.si(Object.PROFILE_DECELERATION)
        self.apply_profile_speed()
        if motion["mode"] != law.STOPPING:
            motion["stop_deceleration_rad_s2"] = self.si(Object.QUICK_STOP_DECELERATION)
        motion["velocity_offset_rad_s"] = self._speed(self.value(Object.VELOCITY_OFFSET))
        motion["torque_offset_nm"] = self._torque(self.value(Object.TORQUE_OFFSET))
        motion["target_torque_nm"] = self._torque(self.value(Object.TARGET_TORQUE))

    def _limits_counts(self) -> tuple[float, float]:
        low, high = self._limit_counts(1), self._limit_counts(2)
        return (-math.inf, math.inf) if low == high and self._personality.equal_limits_are_none else (low, high)

    def _limit_counts(self, subindex: int) -> float:
        place = Object.SOFTWARE_POSITION_LIMIT, subindex
        if place in self._personality.steps:
            return self.si(*place) * self.scaling.counts_per_rad
        return float(self._personality.acting(place))

    def apply_profile_speed(self) -> None:
        """6081h, or 0 while the halt bit is set: a limit that is written meanwhile must not end the halt."""
        self.motion["profile_speed_rad_s"] = 0.0 if self.halted else self.si(Object.PROFILE_VELOCITY)
