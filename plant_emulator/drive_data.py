"""A drive's process data: what its object dictionary says, in the units and arrays of its axis, and back."""

import math
from collections.abc import Callable
from typing import Any

from drive_profiles.cia301 import SdoAbortCode
from drive_profiles.cia402 import Object
from drive_profiles.units import Scaling
from hil.control.notch import NOTCH_OFF, NOTCHES, Notch
from plant_emulator import drive_objects as objects
from plant_emulator import motion as law
from plant_emulator.axes import Axes
from plant_emulator.robot import Robot
from plant_emulator.slave.dictionary import Dictionary

_INT16, _INT32 = 2**15 - 1, 2**31 - 1
_NO_WINDOW = 2**32 - 1
"""6065h: the following error is not watched (CiA 402)."""

TARGET_WINDOW_RAD = 2.0 * math.pi / 1000.0
"""How near the motor must be to count as arrived; friction may leave it a few encoder counts away for a while."""

VELOCITY_GAINS = ((1, "velocity_gain_nm_s_rad"), (2, "velocity_integral_gain_nm_rad"), (3, "lowpass_hz"))
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


def axis_dictionary(robot: Robot, number: int) -> Dictionary:
    """The dictionary of the drive that moves an axis: its motor, its encoder, and the gains that the robot file gives it."""
    axis = robot.axis[number]
    rated_mnm = round(1000.0 * axis.rated_torque)
    gains = (0.0, 0.0, 0.0, 300.0)
    if axis.control is not None:
        control = axis.control
        gains = (
            control.position_gain_per_s,
            control.velocity_gain_nm_s_rad,
            control.velocity_integral_gain_nm_rad,
            control.lowpass_hz,
        )
    return Dictionary(
        objects.drive_entries(
            encoder_counts_per_rev=axis.encoder_counts_per_rev,
            rated_torque_mnm=rated_mnm,
            max_torque_per_mille=min(65535, math.floor(1e6 * axis.torque_limit_nm / rated_mnm)),
            control_period_ns=round(1e9 * robot.control_period_s),
            gains=gains,
            serial_number=number,
        )
    )


def clip(value: float, limit: int = _INT32) -> int:
    """The nearest whole number within ±limit: what an object can hold."""
    return int(max(-limit, min(limit, round(value))))


class DriveData:
    """Ties the entries of a dictionary to one row of the axes: live values, and checks of what is written.

    Attributes:
        motion: The axis' row of process data.
        scaling: How the drive counts.
        halted: Whether the halt bit holds the profile at speed 0.
    """

    def __init__(self, axes: Axes, number: int, dictionary: Dictionary, is_powered: Callable[[], bool]) -> None:
        """Bind the dictionary.

        Args:
            axes: The mechanics.
            number: Axis number.
            dictionary: Of the drive.
            is_powered: Whether the motor is, or may be, under torque; gains are refused then.
        """
        axis = axes.robot.axis[number]
        self.axes, self.row = axes, axes.row(number)
        self.motion: Any = axes.motion[self.row]
        self.scaling = Scaling(axis.encoder_counts_per_rev, round(1000.0 * axis.rated_torque) / 1000.0)
        self.halted = False
        self._dictionary = dictionary
        self._is_powered = is_powered
        self._motor_limit_nm = axis.torque_limit_nm
        self._control_period_s = axes.robot.control_period_s
        self._bind_values()
        self._bind_writers()
        self.apply()

    def value(self, index: int, subindex: int = 0) -> Any:
        """What an entry holds."""
        return self._dictionary.cell(index, subindex).value

    # -- what is read --------------------------------------------------------------------------------------------------

    def _bind_values(self) -> None:
        read: dict[tuple[int, int], Callable[[], Any]] = {
            (Object.POSITION_ACTUAL, 0): lambda: clip(self.axes.counts(self.row)),
            (Object.VELOCITY_ACTUAL, 0): lambda: clip(self.speed_rad_s * self.scaling.counts_per_rad),
            (Object.TORQUE_ACTUAL, 0): self._torque_per_mille,
            (Object.FOLLOWING_ERROR_ACTUAL, 0): self._following_error_counts,
            (objects.TORQUE_COMMAND, 0): lambda: float(self.motion["torque_nm"]),
        }
        for column, index in enumerate(objects.NOTCH_STATE_OBJECTS):
            state = self.axes.notch_state[self.row, column]
            read[index, 1] = lambda state=state: int(state["active"])  # type: ignore[misc]
            read[index, 2] = lambda state=state: float(state["frequency_hz"]) if state["active"] else 0.0  # type: ignore[misc]
            read[index, 3] = lambda state=state: float(state["zeta_rd"]) if state["active"] else 0.0  # type: ignore[misc]
        for (index, sub), hook in read.items():
            self._dictionary.on_read(index, sub, hook)

    @property
    def speed_rad_s(self) -> float:
        """Motor speed as the law sees it."""
        return float(self.axes.cascade_state[self.row]["speed_rad_s"])

    def _torque_per_mille(self) -> int:
        return clip(1000.0 * float(self.motion["torque_nm"]) / self.scaling.rated_torque_nm, _INT16)

    def _following_error_counts(self) -> int:
        return clip(float(self.motion["following_error_rad"]) * self.scaling.counts_per_rad)

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
        return int(self.value(Object.TARGET_POSITION) + self.value(Object.POSITION_OFFSET))

    # -- what is written -----------------------------------------------------------------------------------------------

    def _bind_writers(self) -> None:
        on_write = self._dictionary.on_write
        on_write(0x1006, 0, self._write_cycle_period)
        on_write(objects.POSITION_LOOP, 1, self._gain_writer("position_gain_per_s"))
        for sub, field in VELOCITY_GAINS:
            on_write(objects.VELOCITY_LOOP, sub, self._gain_writer(field))
        for column, index in enumerate(objects.NOTCH_OBJECTS):
            for sub, parameter in enumerate(objects.NOTCH_PARAMETERS, start=1):
                on_write(index, sub, self._notch_writer(column, parameter[0]))
        for index, sub in _LIMITS:
            on_write(index, sub, self._limit_writer(index, sub))
        for index, field, factor in (
            (Object.VELOCITY_OFFSET, "velocity_offset_rad_s", self.scaling.speed_rad_s(1)),
            (Object.TORQUE_OFFSET, "torque_offset_nm", self.scaling.torque_quantum_nm),
            (Object.TARGET_TORQUE, "target_torque_nm", self.scaling.torque_quantum_nm),
        ):
            on_write(index, 0, self._set_point_writer(field, factor))

    def _write_cycle_period(self, value: int) -> SdoAbortCode | None:
        """1006h must be a whole number of control periods: the world advances by it."""
        return SdoAbortCode.INVALID_VALUE if 1000 * value % round(1e9 * self._control_period_s) else None

    def _gain_writer(self, field: str) -> Callable[[float], SdoAbortCode | None]:
        def write(value: float) -> SdoAbortCode | None:
            if self._is_powered():
                return SdoAbortCode.DEVICE_STATE
            self.axes.cascade_config[self.row][field] = value
            return None

        return write

    def _notch_writer(self, column: int, field: str) -> Callable[[float], SdoAbortCode | None]:
        """Filters may be switched on and off while the motor turns; their other parameters not."""

        def write(value: float) -> SdoAbortCode | None:
            if self._is_powered() and field != "mode":
                return SdoAbortCode.DEVICE_STATE
            row = self.axes.notch_config[self.row, column]
            wanted = {name: row[name].item() for name in row.dtype.names} | {field: value}
            try:
                if wanted["mode"] != NOTCH_OFF:
                    Notch(**wanted)
            except ValueError:
                return SdoAbortCode.PARAMETER_INCOMPATIBLE
            row[field] = value
            return None

        return write

    def _limit_writer(self, index: int, sub: int) -> Callable[[Any], SdoAbortCode | None]:
        cell = self._dictionary.cell(index, sub)

        def write(value: Any) -> SdoAbortCode | None:
            cell.value = value
            self.apply_limits()
            return None

        return write

    def _set_point_writer(self, field: str, factor: float) -> Callable[[int], SdoAbortCode | None]:
        def write(value: int) -> SdoAbortCode | None:
            self.motion[field] = value * factor
            return None

        return write

    def apply(self) -> None:
        """Put the whole dictionary into force, after a reset."""
        cascade = self.axes.cascade_config[self.row]
        cascade["position_gain_per_s"] = self.value(objects.POSITION_LOOP, 1)
        for sub, field in VELOCITY_GAINS:
            cascade[field] = self.value(objects.VELOCITY_LOOP, sub)
        for column in range(NOTCHES):
            for sub, parameter in enumerate(objects.NOTCH_PARAMETERS, start=1):
                value = self.value(objects.NOTCH_OBJECTS[column], sub)
                self.axes.notch_config[self.row, column][parameter[0]] = value
        self.apply_limits()

    def apply_limits(self) -> None:
        """Put limits, ramps and set-points into force."""
        motion, scaling = self.motion, self.scaling
        quantum = scaling.torque_quantum_nm
        motion["torque_limit_nm"] = min(self._motor_limit_nm, self.value(Object.MAX_TORQUE) * quantum)
        motion["max_speed_rad_s"] = self.value(Object.MAX_MOTOR_SPEED) * 2.0 * math.pi / 60.0
        motion["low_counts"] = self.value(Object.SOFTWARE_POSITION_LIMIT, 1)
        motion["high_counts"] = self.value(Object.SOFTWARE_POSITION_LIMIT, 2)
        window = self.value(Object.FOLLOWING_ERROR_WINDOW)
        motion["following_window_rad"] = math.inf if window == _NO_WINDOW else scaling.position_rad(window)
        timeout_ms = self.value(Object.FOLLOWING_ERROR_TIMEOUT)
        motion["following_ticks"] = round(1e-3 * timeout_ms / self._control_period_s)
        motion["profile_acceleration_rad_s2"] = scaling.speed_rad_s(self.value(Object.PROFILE_ACCELERATION))
        motion["profile_deceleration_rad_s2"] = scaling.speed_rad_s(self.value(Object.PROFILE_DECELERATION))
        self.apply_profile_speed()
        if motion["mode"] != law.STOPPING:
            motion["stop_deceleration_rad_s2"] = scaling.speed_rad_s(self.value(Object.QUICK_STOP_DECELERATION))
        motion["velocity_offset_rad_s"] = scaling.speed_rad_s(self.value(Object.VELOCITY_OFFSET))
        motion["torque_offset_nm"] = self.value(Object.TORQUE_OFFSET) * quantum
        motion["target_torque_nm"] = self.value(Object.TARGET_TORQUE) * quantum

    def apply_profile_speed(self) -> None:
        """6081h, or 0 while the halt bit is set: a limit that is written meanwhile must not end the halt."""
        speed = 0.0 if self.halted else self.scaling.speed_rad_s(self.value(Object.PROFILE_VELOCITY))
        self.motion["profile_speed_rad_s"] = speed
