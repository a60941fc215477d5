"""Limits, ramps and windows of a drive: from the entries of its dictionary, in whatever units, to the arrays of its axis."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from drive_profiles.cia301 import SdoAbortCode
from drive_profiles.cia402 import Object
from drive_profiles.units import Scaling
from plant_emulator import motion as law
from plant_emulator.axes import Axes
from plant_emulator.personality import Personality

TARGET_WINDOW_RAD = 2.0 * math.pi / 1000.0
"""How near the motor must be to count as arrived, where 6067h does not say; friction may leave it some counts away."""

SLOW_RAD_S = 2.0 * math.pi / 10.0
"""How near to its target a speed counts as reached, and below which one as none, where 606Dh and 606Fh do not say."""

DC_LINK_MV = 48_000
"""6079h: the emulated drives are fed with 48 V, whatever the motor takes."""

_UNWATCHED = 2**32 - 1

Place = tuple[int, int]


def _torque(scaling: Scaling, value: Any) -> float:
    return float(value * scaling.torque_quantum_nm)


def _speed(scaling: Scaling, value: Any) -> float:
    return abs(float(scaling.speed_rad_s(value)))  # a limit or a window has no direction, whatever 607Eh says


def _acceleration(scaling: Scaling, value: Any) -> float:
    return float(scaling.acceleration_rad_s2(value))


def _position(scaling: Scaling, value: Any) -> float:
    return abs(float(scaling.position_rad(value)))


def _milliseconds(_: Scaling, value: Any) -> float:
    return float(1e-3 * value)


_SI: dict[int, Callable[[Scaling, Any], float]] = {
    Object.MAX_TORQUE: _torque,
    Object.POSITIVE_TORQUE_LIMIT: _torque,
    Object.NEGATIVE_TORQUE_LIMIT: _torque,
    Object.TORQUE_SLOPE: _torque,
    Object.MAX_MOTOR_SPEED: lambda _, value: float(value * 2.0 * math.pi / 60.0),
    Object.SOFTWARE_POSITION_LIMIT: _position,
    Object.FOLLOWING_ERROR_WINDOW: _position,
    Object.FOLLOWING_ERROR_TIMEOUT: _milliseconds,
    Object.POSITION_WINDOW: _position,
    Object.POSITION_WINDOW_TIME: _milliseconds,
    Object.VELOCITY_WINDOW: _speed,
    Object.VELOCITY_WINDOW_TIME: _milliseconds,
    Object.VELOCITY_THRESHOLD: _speed,
    Object.VELOCITY_THRESHOLD_TIME: _milliseconds,
    Object.MAX_PROFILE_VELOCITY: _speed,
    Object.PROFILE_VELOCITY: _speed,
    Object.PROFILE_ACCELERATION: _acceleration,
    Object.PROFILE_DECELERATION: _acceleration,
    Object.QUICK_STOP_DECELERATION: _acceleration,
    Object.HOMING_SPEEDS: _speed,
    Object.HOMING_ACCELERATION: _acceleration,
    Object.MAX_ACCELERATION: _acceleration,
    Object.MAX_DECELERATION: _acceleration,
}
"""What the objects mean in SI units where the manufacturer does not say otherwise: counts, per mille, rev/min and ms."""

_RAMPS = frozenset(
    {
        Object.PROFILE_ACCELERATION,
        Object.PROFILE_DECELERATION,
        Object.QUICK_STOP_DECELERATION,
        Object.HOMING_ACCELERATION,
        Object.MAX_ACCELERATION,
        Object.MAX_DECELERATION,
        Object.TORQUE_SLOPE,
    }
)
"""Of these a value of 0 would have no end."""


class DriveLimits:
    """Puts what the dictionary says of limits into force, as it is written and after a reset.

    Attributes:
        axes: The mechanics.
        row: Of the axis.
        motion: The axis' row of process data.
        dictionary: All entries of the drive.
        scaling: How the drive counts.
        offset_counts: What the drive shows as its position, less the encoder's counts: homing has shifted the zero by it.
        halted: Whether the halt bit holds the profile at speed 0.
        are_position_limits_off: Whether 607Dh does not act, whatever is written: homing looks for the zero that it counts from.
    """

    def __init__(self, axes: Axes, number: int, personality: Personality) -> None:
        """Bind the limits' entries.

        Args:
            axes: The mechanics.
            number: Axis number.
            personality: The drive's manufacturer, with the dictionary.
        """
        self.axes, self.row = axes, axes.row(number)
        self.motion: Any = axes.motion[self.row]
        self.dictionary = personality.dictionary
        self.use(personality.scaling)
        self.offset_counts = 0
        self.halted = self.are_position_limits_off = False
        self._personality = personality
        self._motor_limit_nm = axes.robot.axis[number].torque_limit_nm
        self._torque_constant_nm_a = axes.robot.axis[number].torque_constant_nm_a
        self._control_period_s = axes.robot.control_period_s
        for apply, *places in self._groups():
            for index, subindex in places:
                self.dictionary.on_write(index, subindex, self._limit_writer((index, subindex), apply))

    def _groups(self) -> tuple[tuple[Any, ...], ...]:
        """What puts which entries into force, each group by itself: a write by SDO or RPDO costs no more than it must."""
        timeout = self._personality.set_point_timeout
        return (
            (
                self._apply_torque_limits,
                (Object.MAX_TORQUE, 0),
                (Object.MAX_CURRENT, 0),
                (Object.POSITIVE_TORQUE_LIMIT, 0),
                (Object.NEGATIVE_TORQUE_LIMIT, 0),
            ),
            (self._apply_ramps, (Object.PROFILE_ACCELERATION, 0), (Object.PROFILE_DECELERATION, 0)),
            (self.apply_profile_speed, (Object.PROFILE_VELOCITY, 0)),
            (self._apply_greatest_profile_speed, (Object.MAX_PROFILE_VELOCITY, 0)),
            (self._apply_torque_slope, (Object.TORQUE_SLOPE, 0)),
            (self._apply_greatest_speed, (Object.MAX_MOTOR_SPEED, 0)),
            (self._apply_greatest_accelerations, (Object.MAX_ACCELERATION, 0), (Object.MAX_DECELERATION, 0)),
            (self._apply_stop, (Object.QUICK_STOP_DECELERATION, 0)),
            (self._apply_position_limits, (Object.SOFTWARE_POSITION_LIMIT, 1), (Object.SOFTWARE_POSITION_LIMIT, 2)),
            (self._apply_following, (Object.FOLLOWING_ERROR_WINDOW, 0), (Object.FOLLOWING_ERROR_TIMEOUT, 0)),
            (self._apply_position_window, (Object.POSITION_WINDOW, 0), (Object.POSITION_WINDOW_TIME, 0)),
            (self._apply_velocity_window, (Object.VELOCITY_WINDOW, 0), (Object.VELOCITY_WINDOW_TIME, 0)),
            (self._apply_velocity_threshold, (Object.VELOCITY_THRESHOLD, 0), (Object.VELOCITY_THRESHOLD_TIME, 0)),
            (self._apply_set_point_timeout, *(() if timeout is None else (timeout,))),
        )

    def value(self, index: int, subindex: int = 0) -> Any:
        """What an entry holds."""
        return self.dictionary.cell(index, subindex).value

    def si(self, index: int, subindex: int = 0) -> float:
        """What acts of a limit, a speed or a ramp, in SI units."""
        place = index, subindex
        value, step = self._personality.acting(place), self._personality.steps.get(place)
        if index in _RAMPS and value <= 0:
            value = 1
        return _SI[index](self.scaling, value) if step is None else float(value * step)

    def _limit_writer(self, place: Place, apply: Callable[[], None]) -> Callable[[Any], SdoAbortCode | None]:
        cell = self.dictionary.cell(*place)

        def write(value: Any) -> SdoAbortCode | None:
            cell.value = value
            apply()
            return None

        return write

    def _known(self, index: int, otherwise: float, unlimited: int | None = None) -> float:
        """`si` of an entry; of one whose scale is nobody's but its manufacturer's, what acts in its place."""
        place = index, 0
        if not self._personality.is_scaled(place):
            return otherwise
        return math.inf if self._personality.acting(place) == unlimited else self.si(index)

    def _ticks(self, index: int) -> int:
        return round(self._known(index, 0.0) / self._control_period_s)

    def interpolation_ticks(self) -> float:
        """Control periods per set-point, from 60C2h."""
        value, index = self.value(Object.INTERPOLATION_PERIOD, 1), self.value(Object.INTERPOLATION_PERIOD, 2)
        return float(value * 10.0**index / self._control_period_s)

    # -- into force ----------------------------------------------------------------------------------------------------

    def apply_limits(self) -> None:
        """Put all limits, ramps and windows into force."""
        for apply, *_ in self._groups():
            apply()

    def _apply_greatest_speed(self) -> None:
        self.motion["max_speed_rad_s"] = self.si(Object.MAX_MOTOR_SPEED)

    def _apply_greatest_accelerations(self) -> None:
        self.motion["max_acceleration_rad_s2"] = self._known(Object.MAX_ACCELERATION, math.inf)
        self.motion["max_deceleration_rad_s2"] = self._known(Object.MAX_DECELERATION, math.inf)

    def _apply_position_limits(self) -> None:
        limits = (-math.inf, math.inf) if self.are_position_limits_off else self._limits_counts()
        self.motion["low_counts"], self.motion["high_counts"] = limits

    def switch_position_limits(self, *, on: bool) -> None:
        """Put 607Dh into force or out of it: a limit that is written meanwhile must not bring it back."""
        self.are_position_limits_off = not on
        self._apply_position_limits()

    @property
    def is_within_position_limits(self) -> bool:
        """Whether the motor stands within 607Dh, be it in force or not."""
        low, high = self._limits_counts()
        return low <= self.axes.counts(self.row) <= high

    def _apply_following(self) -> None:
        is_watched = self._personality.acting((Object.FOLLOWING_ERROR_WINDOW, 0)) not in self._personality.unwatched_windows
        self.motion["following_window_rad"] = self.si(Object.FOLLOWING_ERROR_WINDOW) if is_watched else math.inf
        self.motion["following_ticks"] = round(self.si(Object.FOLLOWING_ERROR_TIMEOUT) / self._control_period_s)

    def _apply_stop(self) -> None:
        if self.motion["mode"] != law.STOPPING:
            self.motion["stop_deceleration_rad_s2"] = self.si(Object.QUICK_STOP_DECELERATION)

    def _apply_torque_limits(self) -> None:
        """6072h, 6073h, 60E0h, 60E1h and the motor: the least of them, either way."""
        greatest = min(self._motor_limit_nm, self.si(Object.MAX_TORQUE), self._current_limit_nm())
        motion = self.motion
        motion["torque_high_nm"] = high = min(greatest, self._known(Object.POSITIVE_TORQUE_LIMIT, math.inf))
        low = min(greatest, self._known(Object.NEGATIVE_TORQUE_LIMIT, math.inf))
        motion["torque_low_nm"], motion["torque_limit_nm"] = -low, max(high, low)

    def _current_limit_nm(self) -> float:
        """6073h per mille of 6075h, as the torque that so much current makes."""
        rated_ma = self.value(Object.MOTOR_RATED_CURRENT)
        if rated_ma <= 0 or not self._personality.is_scaled((Object.MAX_CURRENT, 0)):
            return math.inf
        return float(1e-6 * rated_ma * self._personality.acting((Object.MAX_CURRENT, 0)) * self._torque_constant_nm_a)

    def _apply_ramps(self) -> None:
        self.motion["profile_acceleration_rad_s2"] = self.si(Object.PROFILE_ACCELERATION)
        self.motion["profile_deceleration_rad_s2"] = self.si(Object.PROFILE_DECELERATION)

    def _apply_greatest_profile_speed(self) -> None:
        self.motion["max_profile_speed_rad_s"] = self._known(Object.MAX_PROFILE_VELOCITY, math.inf)

    def _apply_torque_slope(self) -> None:
        self.motion["torque_slope_nm_s"] = self._known(Object.TORQUE_SLOPE, 10.0 * self.scaling.rated_torque_nm)

    def apply_profile_speed(self) -> None:
        """6081h, or 0 while the halt bit is set: a limit that is written meanwhile must not end the halt."""
        self.motion["profile_speed_rad_s"] = 0.0 if self.halted else self.si(Object.PROFILE_VELOCITY)

    def _apply_position_window(self) -> None:
        window = self._known(Object.POSITION_WINDOW, TARGET_WINDOW_RAD, _UNWATCHED)
        self.motion["position_window_rad"] = max(window, 1.0 / self.scaling.encoder_counts_per_rad)
        self.motion["position_window_ticks"] = self._ticks(Object.POSITION_WINDOW_TIME)

    def _apply_velocity_window(self) -> None:
        self.motion["velocity_window_rad_s"] = self._known(Object.VELOCITY_WINDOW, SLOW_RAD_S)
        self.motion["velocity_window_ticks"] = self._ticks(Object.VELOCITY_WINDOW_TIME)

    def _apply_velocity_threshold(self) -> None:
        self.motion["velocity_threshold_rad_s"] = self._known(Object.VELOCITY_THRESHOLD, SLOW_RAD_S)
        self.motion["velocity_threshold_ticks"] = self._ticks(Object.VELOCITY_THRESHOLD_TIME)

    def _apply_set_point_timeout(self) -> None:
        timeout = self._personality.set_point_timeout
        periods = 0 if timeout is None else self.value(*timeout)
        self.motion["extrapolate_ticks"] = periods * max(1, round(self.interpolation_ticks()))

    def _limits_counts(self) -> tuple[float, float]:
        """607Dh; 0 and 0 are no limits, as masters that want none write them, and with some makers any equal pair is."""
        if not any(self._personality.acting((Object.SOFTWARE_POSITION_LIMIT, sub)) for sub in (1, 2)):
            return -math.inf, math.inf
        low, high = self._limit_counts(1), self._limit_counts(2)
        if low == high and self._personality.equal_limits_are_none:
            return -math.inf, math.inf
        return (low, high) if self.scaling.position_sign > 0 else (high, low)

    def _limit_counts(self, subindex: int) -> float:
        place = Object.SOFTWARE_POSITION_LIMIT, subindex
        if place in self._personality.steps:
            return self.si(*place) * self.scaling.encoder_counts_per_rad - self.offset_counts
        return float(self.encoder_counts(self._personality.acting(place)))

    def set_rated_torque(self, rated_torque_nm: float) -> None:
        """All torques are per mille of it."""
        self.use(replace(self.scaling, rated_torque_nm=rated_torque_nm))

    # -- units ---------------------------------------------------------------------------------------------------------

    def use(self, scaling: Scaling) -> None:
        """Count so from now on; `apply_limits` then puts what the entries hold into force anew."""
        self.scaling = scaling
        self._counts_as_encoder = scaling.counts_are_increments
        self._units_per_count = scaling.position_sign * scaling.counts_per_rad / scaling.encoder_counts_per_rad
        self._units_per_rad_s = scaling.speed_units_per_rad_s
        self._rad_s_per_unit = float(scaling.speed_rad_s(1))

    def encoder_counts(self, position: Any) -> int:
        """Counts of the encoder at a position as the drive shows it."""
        if self._counts_as_encoder:
            return int(position) - self.offset_counts
        counts: int = round(position / self._units_per_count)
        return counts - self.offset_counts
