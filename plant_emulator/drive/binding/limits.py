"""Limits, ramps and windows of a drive."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Object
from drive_profiles.standard.object_address import ObjectAddress
from plant_emulator.drive.dictionary.counting import Counting
from plant_emulator.drive.dictionary.limit_table import MOTION_LIMITS, TIME, Limit
from plant_emulator.drive.family.base import DriveFamily
from plant_emulator.motion import record
from plant_emulator.motion.axes import Axes

_NO_WINDOW = 2**32 - 1
LONGEST_INTERPOLATION = 2**31
"""Control periods of the longest interpolation, six days of 250 µs; 60C2h can state up to 10^65 s."""


class DriveLimits:
    """Application of the dictionary's limits when they are written or reset.

    A row of `MOTION_LIMITS` with a field is applied alone. The others are applied in groups: their value depends on several
    objects, or on the drive's state.

    Attributes:
        counting: Counting of the drive; after another `apply` converts the entries again.
        is_profile_halted: True if the halt bit holds the profile at speed 0; cleared by a reset.
    """

    def __init__(self, axes: Axes, number: int, family: DriveFamily, counting: Counting) -> None:
        self.counting = counting
        self.is_profile_halted = False
        self._are_position_limits_off = False  # whatever is written: homing looks for the zero that they count from
        self._axes, self._row = axes, axes.row(number)
        self._motion: Any = axes.motion[self._row]
        self._dictionary, self._family = family.dictionary, family
        axis = axes.robot.axis[number]
        self._motor_limit_nm, self._torque_constant_nm_a = axis.torque_limit_nm, axis.torque_constant_nm_a
        self._control_period_s = axes.robot.control_period_s
        self._appliers = self._bind()

    def _bind(self) -> tuple[Callable[[], None], ...]:
        """Bind the functions that apply entries to these entries.

        A write by SDO or RPDO then costs no more than it must.
        """
        timeout = self._family.set_point_timeout
        position_limits: list[ObjectAddress] = [(Object.SOFTWARE_POSITION_LIMIT, sub) for sub in (1, 2)]
        torques = (Object.MAX_TORQUE, Object.MAX_CURRENT, Object.POSITIVE_TORQUE_LIMIT, Object.NEGATIVE_TORQUE_LIMIT)
        appliers: list[tuple[Callable[[], None], list[ObjectAddress]]] = [
            (partial(self._apply_alone, limit, limit.field), [(limit.index, 0)])
            for limit in MOTION_LIMITS.values()
            if limit.field is not None
        ]
        appliers += (
            (self._apply_torque_limits, [(index, 0) for index in torques]),
            (self._apply_profile_speed, [(Object.PROFILE_VELOCITY, 0)]),
            (self._apply_stop, [(Object.QUICK_STOP_DECELERATION, 0)]),
            (self._apply_position_limits, position_limits),
            (self._apply_following_window, [(Object.FOLLOWING_ERROR_WINDOW, 0)]),
            (self._apply_position_window, [(Object.POSITION_WINDOW, 0)]),
            (self._apply_set_point_timeout, [] if timeout is None else [timeout]),
        )
        for apply, addresses in appliers:
            for address in addresses:
                self._dictionary.on_write(*address, self._writer(address, apply))
        return tuple(apply for apply, _ in appliers)

    def _writer(self, address: ObjectAddress, apply: Callable[[], None]) -> Callable[[Any], SdoAbortCode | None]:
        cell = self._dictionary.cell(*address)

        def write(value: Any) -> SdoAbortCode | None:
            cell.value = value
            apply()
            return None

        return write

    # -- values --------------------------------------------------------------------------------------------------------

    def _held(self, index: int, subindex: int = 0) -> Any:
        return self._dictionary.cell(index, subindex).value

    def acting_si(self, index: int, subindex: int = 0) -> float:
        """Return a limit, speed or ramp in SI units."""
        address, limit = (index, subindex), MOTION_LIMITS[index]
        if limit.unscaled is not None and not self._family.is_scaled(address):
            return limit.unscaled(self.counting.scaling)
        value, step = self._family.acting(address), self._family.steps.get(address)
        if limit.is_ramp and value <= 0:
            value = 1
        return limit.quantity.si(self.counting.scaling, value) if step is None else float(value * step)

    def control_periods_per_set_point(self) -> float:
        """Return the control periods per set-point, from 60C2h, at most `LONGEST_INTERPOLATION`."""
        value, exponent = (self._held(Object.INTERPOLATION_PERIOD, sub) for sub in (1, 2))
        return min(float(value * 10.0**exponent / self._control_period_s), float(LONGEST_INTERPOLATION))

    @property
    def is_within_position_limits(self) -> bool:
        """True if the motor is within 607Dh, active or not."""
        low, high = self._limits_counts()
        return low <= self._axes.counts(self._row) <= high

    # -- into force ----------------------------------------------------------------------------------------------------

    def apply(self) -> None:
        """Apply all limits, ramps and windows."""
        for apply in self._appliers:
            apply()

    def switch_position_limits(self, *, on: bool) -> None:
        """Activate or deactivate 607Dh.

        A limit that is written meanwhile does not reactivate it.
        """
        self._are_position_limits_off = not on
        self._apply_position_limits()

    def halt_profile(self, active: bool) -> None:
        """Hold the profile at speed 0, or let it continue.

        A limit that is written meanwhile does not end the halt.
        """
        self.is_profile_halted = active
        self._apply_profile_speed()

    def _apply_alone(self, limit: Limit, field: str) -> None:
        value = self.acting_si(limit.index)
        self._motion[field] = round(value / self._control_period_s) if limit.quantity is TIME else value

    def _apply_torque_limits(self) -> None:
        """Apply the torque limits in both directions.

        Each is the least of 6072h, 6073h, 60E0h or 60E1h, and the motor's limit.
        """
        greatest = min(self._motor_limit_nm, self.acting_si(Object.MAX_TORQUE), self._current_limit_nm())
        motion = self._motion
        motion["torque_high_nm"] = high = min(greatest, self.acting_si(Object.POSITIVE_TORQUE_LIMIT))
        low = min(greatest, self.acting_si(Object.NEGATIVE_TORQUE_LIMIT))
        motion["torque_low_nm"], motion["torque_limit_nm"] = -low, max(high, low)

    def _current_limit_nm(self) -> float:
        """Return the torque of 6073h, per mille of 6075h."""
        rated_ma = self._held(Object.MOTOR_RATED_CURRENT)
        if rated_ma <= 0 or not self._family.is_scaled((Object.MAX_CURRENT, 0)):
            return math.inf
        return float(1e-6 * rated_ma * self._family.acting((Object.MAX_CURRENT, 0)) * self._torque_constant_nm_a)

    def _apply_profile_speed(self) -> None:
        self._motion["profile_speed_rad_s"] = 0.0 if self.is_profile_halted else self.acting_si(Object.PROFILE_VELOCITY)

    def _apply_stop(self) -> None:
        if self._motion["mode"] != record.STOPPING:
            self._motion["stop_deceleration_rad_s2"] = self.acting_si(Object.QUICK_STOP_DECELERATION)

    def _apply_position_limits(self) -> None:
        limits = (-math.inf, math.inf) if self._are_position_limits_off else self._limits_counts()
        self._motion["low_counts"], self._motion["high_counts"] = limits

    def _limits_counts(self) -> tuple[float, float]:
        """Return 607Dh in counts; zeros (or any equal pair) may mean none."""
        if not any(self._family.acting((Object.SOFTWARE_POSITION_LIMIT, sub)) for sub in (1, 2)):
            return -math.inf, math.inf
        low, high = self._limit_counts(1), self._limit_counts(2)
        if low == high and self._family.equal_limits_are_none:
            return -math.inf, math.inf
        return (low, high) if self.counting.scaling.position_sign > 0 else (high, low)

    def _limit_counts(self, subindex: int) -> float:
        address, counting = (Object.SOFTWARE_POSITION_LIMIT, subindex), self.counting
        if address in self._family.steps:
            return self.acting_si(*address) * counting.scaling.encoder_counts_per_rad - counting.offset_counts
        return float(counting.encoder_counts(self._family.acting(address)))

    def _apply_following_window(self) -> None:
        is_watched = self._family.acting((Object.FOLLOWING_ERROR_WINDOW, 0)) not in self._family.unwatched_windows
        self._motion["following_window_rad"] = self.acting_si(Object.FOLLOWING_ERROR_WINDOW) if is_watched else math.inf

    def _apply_position_window(self) -> None:
        """Apply 6067h, at least one count; its greatest value means no window."""
        address = Object.POSITION_WINDOW, 0
        is_off = self._family.is_scaled(address) and self._family.acting(address) == _NO_WINDOW
        window = math.inf if is_off else self.acting_si(Object.POSITION_WINDOW)
        self._motion["position_window_rad"] = max(window, 1.0 / self.counting.scaling.encoder_counts_per_rad)

    def _apply_set_point_timeout(self) -> None:
        timeout = self._family.set_point_timeout
        periods = 0 if timeout is None else self._held(*timeout)
        self._motion["extrapolation_periods"] = periods * max(1, round(self.control_periods_per_set_point()))
