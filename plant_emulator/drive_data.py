"""A drive's process data: what the CiA 402 part of its dictionary says, in the units and arrays of its axis, and back."""

from collections.abc import Callable
from typing import Any

from drive_profiles.cia301 import SdoAbortCode
from drive_profiles.cia402 import Mode, Object
from drive_profiles.units import Scaling
from plant_emulator import motion as law
from plant_emulator.axes import Axes, live
from plant_emulator.drive_limits import DC_LINK_MV, DriveLimits
from plant_emulator.personality import Personality
from plant_emulator.user_units import UserUnits

_INT16, _INT32 = 2**15 - 1, 2**31 - 1
_INTERPOLATING = frozenset({Mode.CSP, Mode.CSV, Mode.CST, Mode.IP})


def clip(value: float, limit: int = _INT32) -> int:
    """The nearest whole number within ±limit: what an object can hold."""
    nearest = round(value)
    return nearest if -limit <= nearest <= limit else int(max(-limit, min(limit, nearest)))


class DriveData(DriveLimits):
    """Ties the entries of a dictionary to one row of the axes: live values, and checks of what is written."""

    def __init__(self, axes: Axes, number: int, personality: Personality, is_powered: Callable[[], bool]) -> None:
        """Bind the dictionary.

        Args:
            axes: The mechanics.
            number: Axis number.
            personality: The drive's manufacturer, with the dictionary.
            is_powered: Whether the motor is, or may be, under torque.
        """
        super().__init__(axes, number, personality)
        self._is_powered = is_powered
        self._rated_place, self._rated_step_nm = personality.rated_torque
        self._is_rated_fixed = not self.dictionary.cell(*self._rated_place).entry.access.is_writable
        self.motion["counts_per_rad"] = self.scaling.encoder_counts_per_rad
        self.motion["counts_per_rev"] = self.scaling.encoder_counts_per_rev
        self._speeds, self._torques = live(axes.cascade_state, "speed_rad_s"), live(axes.motion, "torque_nm")
        self._errors = live(axes.cascade_state, "error_rad_s")
        self._following_errors = live(axes.motion, "following_error_rad")
        self._reached = live(axes.motion, "reached")
        self._demands, self._demand_speeds = live(axes.motion, "demand_rad"), live(axes.motion, "demand_speed_rad_s")
        self._torque_demands = live(axes.motion, "torque_demand_nm")
        self._target, self._offset = (self.dictionary.cell(index) for index in (Object.TARGET_POSITION, Object.POSITION_OFFSET))
        self._target_speed = self.dictionary.cell(Object.TARGET_VELOCITY)
        self._units = None
        if personality.has_user_units:
            self._units = UserUnits(self.dictionary, is_powered, lambda: self.scaling, self._use_units)
        self._bind_values()
        self._bind_writers()

    # -- units ---------------------------------------------------------------------------------------------------------

    def shown_position(self, counts: float) -> int:
        """What the drive shows as its position at these counts of the encoder."""
        if self._counts_as_encoder:
            return clip(counts + self.offset_counts)
        return clip((counts + self.offset_counts) * self._units_per_count)

    def speed_of(self, value: Any) -> float:
        """A speed of the bus in rad/s."""
        return float(value * self._rad_s_per_unit)

    def shown_speed(self, speed_rad_s: float) -> int:
        """What the drive shows as this speed."""
        return clip(speed_rad_s * self._units_per_rad_s)

    def _use_units(self, scaling: Scaling) -> None:
        self.use(scaling)
        self.apply_limits()

    def set_home(self, counts: float) -> None:
        """From now on the drive shows 607Ch at these counts of the encoder; targets and limits move along."""
        self.offset_counts = 0
        self.offset_counts = clip(self.encoder_counts(self.value(Object.HOME_OFFSET)) - counts)
        self.apply_limits()

    # -- what is read --------------------------------------------------------------------------------------------------

    def _bind_values(self) -> None:
        read: dict[int, Callable[[], Any]] = {
            Object.POSITION_DEMAND: self._demand_position,
            Object.POSITION_ACTUAL_INTERNAL: lambda: clip(self.axes.counts(self.row)),
            Object.POSITION_ACTUAL: self._position_counts,
            Object.VELOCITY_SENSOR_ACTUAL: self._shown_actual_speed,
            Object.VELOCITY_DEMAND: lambda: self.shown_speed(self._demand_speeds[self.row]),
            Object.VELOCITY_ACTUAL: self._shown_actual_speed,
            Object.TORQUE_DEMAND: lambda: self._per_mille(self._torque_demands[self.row]),
            Object.TORQUE_ACTUAL: lambda: self._per_mille(self._torques[self.row]),
            Object.CURRENT_ACTUAL: self._current_per_mille,
            Object.DC_LINK_VOLTAGE: lambda: DC_LINK_MV,
            Object.FOLLOWING_ERROR_ACTUAL: self._following_error_counts,
            Object.CONTROL_EFFORT: lambda: self.shown_speed(self._errors[self.row] + self._speeds[self.row]),
            Object.POSITION_DEMAND_INTERNAL: lambda: clip(self._demands[self.row] * self.scaling.encoder_counts_per_rad),
        }
        for index, hook in read.items():
            self.dictionary.on_read(index, 0, hook)

    @property
    def speed_rad_s(self) -> float:
        """Motor speed as the law sees it."""
        return float(self._speeds[self.row])

    def _position_counts(self) -> int:
        counts = self.axes.counts(self.row)
        shown = counts + self.offset_counts
        # every TPDO passes here: in increments and within its object the position is what it is
        return shown if self._counts_as_encoder and -_INT32 <= shown <= _INT32 else self.shown_position(counts)

    def _demand_position(self) -> int:
        return self.shown_position(self._demands[self.row] * self.scaling.encoder_counts_per_rad)

    def _shown_actual_speed(self) -> int:
        return clip(self._speeds[self.row] * self._units_per_rad_s)

    def _per_mille(self, torque_nm: float) -> int:
        return clip(1000.0 * torque_nm / self.scaling.rated_torque_nm, _INT16)

    def _current_per_mille(self) -> int:
        """Of 6075h: the current is what the motor constant makes of the torque."""
        rated_ma = self.value(Object.MOTOR_RATED_CURRENT)
        current_ma = 1000.0 * self._torques[self.row] / self._torque_constant_nm_a
        return clip(1000.0 * current_ma / rated_ma, _INT16) if rated_ma > 0 else 0

    def _following_error_counts(self) -> int:
        return clip(self._following_errors[self.row] * self.scaling.encoder_counts_per_rad * self._units_per_count)

    @property
    def is_target_reached(self) -> bool:
        """Profile position: the motor itself is where it was sent, or (halted) stands; not only its reference."""
        motion = self.motion
        if motion["reference_speed_rad_s"] != 0.0:
            return False
        if self.halted:
            return abs(self.speed_rad_s) < law.STOPPED_RAD_S
        way_left = motion["target_counts"] / motion["counts_per_rad"] - motion["reference_rad"]
        return bool(abs(way_left) < 1e-9 and self._reached[self.row] & law.IN_POSITION)

    def cyclic_target_counts(self) -> int:
        """Where cyclic position mode shall go: 607Ah + 60B0h (CiA 402: the offset is added to the target)."""
        target: Any = self._target.value
        target += self._offset.value
        return target - self.offset_counts if self._counts_as_encoder else self.encoder_counts(target)

    def cyclic_target_speed_rad_s(self) -> float:
        """How fast cyclic velocity mode shall go: 60FFh; 60B1h is added in the law."""
        return self.speed_of(self._target_speed.value)

    # -- what is written -----------------------------------------------------------------------------------------------

    def _bind_writers(self) -> None:
        on_write = self.dictionary.on_write
        on_write(0x1006, 0, self._write_cycle_period)
        on_write(Object.VELOCITY_OFFSET, 0, self._set_point_writer("velocity_offset_rad_s", self.speed_of))
        on_write(Object.TORQUE_OFFSET, 0, self._set_point_writer("torque_offset_nm", self._torque))
        on_write(Object.TARGET_TORQUE, 0, self._set_point_writer("target_torque_nm", self._torque))
        for sub in (1, 2):
            on_write(Object.INTERPOLATION_PERIOD, sub, self._period_writer(sub))
        if not self._is_rated_fixed:
            on_write(*self._rated_place, self._write_rated_torque)

    def _torque(self, value: int) -> float:
        return value * self.scaling.torque_quantum_nm

    def _write_cycle_period(self, value: int) -> SdoAbortCode | None:
        """1006h must be a whole number of control periods: the world advances by it."""
        return SdoAbortCode.INVALID_VALUE if 1000 * value % round(1e9 * self._control_period_s) else None

    def _period_writer(self, sub: int) -> Callable[[int], SdoAbortCode | None]:
        """60C2h comes into force where a mode begins: under torque in one that counts in it only the same value passes."""
        cell = self.dictionary.cell(Object.INTERPOLATION_PERIOD, sub)

        def write(value: int) -> SdoAbortCode | None:
            if value == cell.value or not self._is_powered():
                return None
            acting = self.dictionary.get_int(Object.MODES_OF_OPERATION_DISPLAY)
            return SdoAbortCode.DEVICE_STATE if acting in _INTERPOLATING else None

        return write

    def _write_rated_torque(self, value: float) -> SdoAbortCode | None:
        """All torques are per mille of it, so it does not change under torque, and 0 has no inverse."""
        if self._is_powered():
            return SdoAbortCode.DEVICE_STATE
        if value <= 0:
            return SdoAbortCode.VALUE_TOO_LOW
        self.dictionary.cell(*self._rated_place).value = value
        self._apply_rated_torque()
        self.apply_limits()
        return None

    def _apply_rated_torque(self) -> None:
        if not self._is_rated_fixed:
            self.set_rated_torque(self.value(*self._rated_place) * self._rated_step_nm)

    def _set_point_writer(self, field: str, convert: Callable[[int], float]) -> Callable[[int], SdoAbortCode | None]:
        place, row = live(self.axes.motion, field), self.row

        def write(value: int) -> SdoAbortCode | None:
            place[row] = convert(value)
            return None

        return write

    def apply(self) -> None:
        """Put the whole dictionary into force, after a reset; the zero that homing has found is lost with it."""
        self.offset_counts = 0
        self._apply_rated_torque()
        if self._units is not None:
            self._units.apply()
        self._personality.apply()
        self.apply_limits()

    def apply_limits(self) -> None:
        """Put limits, ramps and set-points into force."""
        super().apply_limits()
        motion = self.motion
        motion["velocity_offset_rad_s"] = self.speed_of(self.value(Object.VELOCITY_OFFSET))
        motion["torque_offset_nm"] = self._torque(self.value(Object.TORQUE_OFFSET))
        motion["target_torque_nm"] = self._torque(self.value(Object.TARGET_TORQUE))
