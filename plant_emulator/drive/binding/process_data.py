"""A drive's process data."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Mode, Object
from drive_profiles.standard.object_address import ObjectAddress
from drive_profiles.standard.units import Scaling
from hil.control.angles import ARCSEC
from plant_emulator.drive.binding.limits import DriveLimits
from plant_emulator.drive.dictionary.additional_encoder import FIRST
from plant_emulator.drive.dictionary.counting import INT16_MAX, INT32_MAX, Counting, clip
from plant_emulator.drive.dictionary.user_units import UserUnits
from plant_emulator.drive.family.base import DriveFamily
from plant_emulator.motion import record
from plant_emulator.motion.axes import Axes, live
from plant_emulator.robots.encoders import LoadEncoder
from plant_emulator.slave.dictionary import Cell, Dictionary, WriteHook


def bind_load_encoder(dictionary: Dictionary, axes: Axes, number: int, position: ObjectAddress) -> None:
    """Bind the objects of an axis' second encoder to its joint."""
    encoder = axes.robot.axis[number].load_encoder
    if encoder is None:
        return
    row = axes.row(number)
    speeds, way = live(axes.plant_state, "arm_speed_rad_s"), -1.0 if encoder.is_reversed else 1.0
    counts_per_rad = encoder.counts_per_rev / math.tau
    dictionary.on_read(*position, reading(encoder, axes, number))
    if position != FIRST:
        return
    dictionary.on_read(Object.ADDITIONAL_VELOCITY_ACTUAL, 1, lambda: clip(round(way * speeds[row] * counts_per_rad), INT32_MAX))


def reading(encoder: LoadEncoder, axes: Axes, number: int) -> Callable[[], int]:
    """Return a reader of the encoder (errors and noise included), in counts."""
    angles, row, way = live(axes.plant_state, "arm_angle_rad"), axes.row(number), -1.0 if encoder.is_reversed else 1.0
    counts_per_rad, offset = encoder.counts_per_rev / math.tau, math.radians(encoder.offset_deg)
    lines = [(line.order, line.a_arcsec * ARCSEC, math.radians(line.phi_deg)) for line in encoder.eccentricity]
    sigma, draw = (
        encoder.noise_arcsec * ARCSEC,
        np.random.default_rng([axes.robot.seed, Object.ADDITIONAL_POSITION_ACTUAL, number]),
    )

    def read() -> int:
        angle: float = angles[row]
        for order, size, phase in lines:
            angle += size * math.cos(order * angles[row] + phase)
        if sigma:
            angle += sigma * float(draw.standard_normal())
        return clip(math.floor((way * angle + offset) * counts_per_rad + 0.5), INT32_MAX)

    return read


DC_LINK_MV = 48_000
"""6079h: the emulated drives are fed with 48 V, whatever the motor takes."""

SET_POINTS = (
    (Object.VELOCITY_OFFSET, "velocity_offset_rad_s", Counting.speed_rad_s),
    (Object.TORQUE_OFFSET, "torque_offset_nm", Counting.torque_nm),
    (Object.TARGET_TORQUE, "target_torque_nm", Counting.torque_nm),
)
"""Set-points that act as soon as they are written: object, field of `MOTION`, and what its number means."""

SHARED: Mapping[int, str] = {
    Object.TARGET_POSITION: "target_position",
    Object.POSITION_OFFSET: "position_offset",
    Object.TARGET_TORQUE: "target_torque",
    Object.TORQUE_OFFSET: "torque_offset",
}
"""Entries whose values lie in `Axes.processes`, and the fields."""

_INTERPOLATING = frozenset({Mode.CSP, Mode.CSV, Mode.CST, Mode.IP})


def share_set_points(dictionary: Dictionary, axes: Axes, row: int) -> None:
    """Keep the set-points of a drive in the process image.

    This comes first: the parts of a drive hold the cells.
    """
    for index, field in SHARED.items():
        if (index, 0) in dictionary:
            dictionary.share(index, 0, live(axes.processes, field), row)


class DriveData:
    """Binding of a dictionary to one row of the axes.

    Attributes:
        row: Row of the axis in `Axes.rows`.
        process: The axis' row of `Axes.processes`.
        on_units: Called when `counting` has changed.
    """

    def __init__(self, axes: Axes, number: int, family: DriveFamily, is_powered: Callable[[], bool]) -> None:
        self.axes, self.row = axes, axes.row(number)
        self.motion: Any = axes.motion[self.row]
        self.dictionary = family.dictionary
        self.counting = Counting(family.scaling)
        self.process: Any = axes.processes[self.row]
        self.on_units: Callable[[], None] = lambda: None
        self.limits = DriveLimits(axes, number, family, self.counting)
        self._family = family
        self._torque_constant_nm_a = axes.robot.axis[number].torque_constant_nm_a
        self._control_period_s = axes.robot.control_period_s
        self._is_powered = is_powered
        self._rated_address, self._rated_step_nm = family.rated_torque
        self._is_rated_fixed = not self.dictionary.cell(*self._rated_address).entry.access.is_writable
        self.motion["counts_per_rad"] = family.scaling.encoder_counts_per_rad
        self.motion["counts_per_rev"] = family.scaling.encoder_counts_per_rev
        self._speeds, self._torques = live(axes.cascade_state, "speed_rad_s"), live(axes.motion, "torque_nm")
        self._errors = live(axes.cascade_state, "error_rad_s")
        self._following_errors = live(axes.motion, "following_error_rad")
        self._reached = live(axes.motion, "reached")
        self._demands, self._demand_speeds = live(axes.motion, "demand_rad"), live(axes.motion, "demand_speed_rad_s")
        self._torque_demands = live(axes.motion, "torque_demand_nm")
        self._target, self._offset = (self.dictionary.cell(index) for index in (Object.TARGET_POSITION, Object.POSITION_OFFSET))
        self._set_point_hooks: dict[int, WriteHook] = {}
        self._units = None
        if family.has_user_units:
            self._units = UserUnits(self.dictionary, is_powered, lambda: self.counting.scaling, self._use_units)
        self._bind_values()
        bind_load_encoder(self.dictionary, axes, number, family.load_position)
        self._bind_writers()

    # -- units ---------------------------------------------------------------------------------------------------------

    def _use(self, counting: Counting) -> None:
        """Change the counting.

        The entries keep their numbers, which then mean other quantities.
        """
        self.counting = counting
        self.limits.counting = counting
        self.on_units()

    def _use_units(self, scaling: Scaling) -> None:
        self._use(self.counting.scaled(scaling))
        self.apply()

    def set_home(self, counts: float) -> None:
        """Set the zero: these encoder counts are shown as 607Ch.

        Targets and limits move along.
        """
        self._use(self.counting.homed(self.value(Object.HOME_OFFSET), counts))
        self.apply()

    def shown_position(self, counts: float) -> int:
        """Return the position shown at these counts of the encoder."""
        return self.counting.shown_position(counts)

    def value(self, index: int, subindex: int = 0) -> Any:
        """Return the value of an entry."""
        return self.dictionary.cell(index, subindex).value

    # -- what is read --------------------------------------------------------------------------------------------------

    def _bind_values(self) -> None:
        read: dict[int, Callable[[], Any]] = {
            Object.POSITION_DEMAND: lambda: self.shown_position(self._demand_counts()),
            Object.POSITION_ACTUAL_INTERNAL: lambda: clip(self.axes.counts(self.row)),
            Object.POSITION_ACTUAL: self.position_counts,
            Object.VELOCITY_SENSOR_ACTUAL: self._shown_actual_speed,
            Object.VELOCITY_DEMAND: lambda: self.counting.shown_speed(self._demand_speeds[self.row]),
            Object.VELOCITY_ACTUAL: self._shown_actual_speed,
            Object.TORQUE_DEMAND: lambda: self.counting.shown_torque(self._torque_demands[self.row]),
            Object.TORQUE_ACTUAL: self.shown_torque,
            Object.CURRENT_ACTUAL: self._shown_current,
            Object.DC_LINK_VOLTAGE: lambda: DC_LINK_MV,
            Object.FOLLOWING_ERROR_ACTUAL: self._following_error_counts,
            Object.CONTROL_EFFORT: lambda: self.counting.shown_speed(self._errors[self.row] + self._speeds[self.row]),
            Object.POSITION_DEMAND_INTERNAL: lambda: clip(self._demand_counts()),
        }
        for index, hook in read.items():
            self.dictionary.on_read(index, 0, hook)

    @property
    def speed_rad_s(self) -> float:
        """Motor speed as the law measures it."""
        return float(self._speeds[self.row])

    def shown_torque(self) -> int:
        """Return the present 6077h."""
        return self.counting.shown_torque(self._torques[self.row])

    def position_counts(self) -> int:
        """Return the present 6064h."""
        counting, counts = self.counting, self.axes.counts(self.row)
        shown = counts + counting.offset_counts
        # every TPDO passes here: in increments and within its object the position is what it is
        return shown if counting.is_encoder and -INT32_MAX <= shown <= INT32_MAX else counting.shown_position(counts)

    def _demand_counts(self) -> float:
        return float(self._demands[self.row] * self.counting.scaling.encoder_counts_per_rad)

    def _shown_actual_speed(self) -> int:
        return self.counting.shown_speed(self._speeds[self.row])

    def _shown_current(self) -> int:
        """Return the current from the torque and the motor constant.

        It is per mille of 6075h, or in the steps of the family.
        """
        current_ma = 1000.0 * self._torques[self.row] / self._torque_constant_nm_a
        if self._family.current_step_a is not None:
            return clip(1e-3 * current_ma / self._family.current_step_a, INT16_MAX)
        rated_ma = self.value(Object.MOTOR_RATED_CURRENT)
        return clip(1000.0 * current_ma / rated_ma, INT16_MAX) if rated_ma > 0 else 0

    def _following_error_counts(self) -> int:
        counting = self.counting
        return clip(self._following_errors[self.row] * counting.scaling.encoder_counts_per_rad * counting.units_per_count)

    @property
    def is_target_reached(self) -> bool:
        """True if the motor has reached the profile's target.

        While halted it is True at rest. The motor's position counts, not only the reference.
        """
        motion = self.motion
        if motion["reference_speed_rad_s"] != 0.0:
            return False
        if self.limits.is_profile_halted:
            return abs(self.speed_rad_s) < record.STOPPED_RAD_S
        left_rad = motion["target_counts"] / motion["counts_per_rad"] - motion["reference_rad"]
        return bool(abs(left_rad) < 1e-9 and self._reached[self.row] & record.IN_POSITION)

    def cyclic_target_counts(self) -> int:
        """Return 607Ah + 60B0h, the cyclic target, in counts of the encoder."""
        target: Any = self._target.value
        target += self._offset.value
        counting = self.counting
        return target - counting.offset_counts if counting.is_encoder else counting.encoder_counts(target)

    # -- what the process image knows ----------------------------------------------------------------------------------

    def shares(self, cell: Cell) -> bool:
        """Return True if an RPDO gives an entry what the process image gives it.

        The entry is one of `SHARED`, without limits, and with no other write hook than the usual one.
        """
        entry = cell.entry
        if entry.subindex or entry.index not in SHARED or cell.is_guarded:
            return False
        return cell.write_hook is self._set_point_hooks.get(entry.index)

    def write_units(self) -> None:
        """Write the units into the process image."""
        counting, process = self.counting, self.process
        process["is_encoder"], process["offset_counts"] = counting.is_encoder, counting.offset_counts
        process["units_per_count"], process["rated_torque_nm"] = counting.units_per_count, counting.scaling.rated_torque_nm
        process["torque_quantum_nm"] = counting.scaling.torque_quantum_nm

    # -- what is written -----------------------------------------------------------------------------------------------

    def _bind_writers(self) -> None:
        on_write = self.dictionary.on_write
        on_write(0x1006, 0, self._write_cycle_period)
        for index, field, convert in SET_POINTS:
            self._set_point_hooks[index] = hook = self._set_point_writer(field, convert)
            on_write(index, 0, hook)
        for sub in (1, 2):
            on_write(Object.INTERPOLATION_PERIOD, sub, self._period_writer(sub))
        if not self._is_rated_fixed:
            on_write(*self._rated_address, self._write_rated_torque)

    def _write_cycle_period(self, value: int) -> SdoAbortCode | None:
        """Refuse a 1006h that is not a multiple of control periods.

        The world advances by 1006h.
        """
        return SdoAbortCode.INVALID_VALUE if 1000 * value % round(1e9 * self._control_period_s) else None

    def _period_writer(self, sub: int) -> Callable[[int], SdoAbortCode | None]:
        """Return a write hook that keeps 60C2h constant under torque.

        It takes effect when a mode begins; in an interpolating mode under torque only the same value is accepted.
        """
        cell = self.dictionary.cell(Object.INTERPOLATION_PERIOD, sub)

        def write(value: int) -> SdoAbortCode | None:
            if value == cell.value or not self._is_powered():
                return None
            acting = self.dictionary.get_int(Object.MODES_OF_OPERATION_DISPLAY)
            return SdoAbortCode.DEVICE_STATE if acting in _INTERPOLATING else None

        return write

    def _write_rated_torque(self, value: float) -> SdoAbortCode | None:
        """Check and apply the rated torque.

        All torques are per mille of it, so it does not change under torque, and 0 has no inverse.
        """
        if self._is_powered():
            return SdoAbortCode.DEVICE_STATE
        if value <= 0:
            return SdoAbortCode.VALUE_TOO_LOW
        self.dictionary.cell(*self._rated_address).value = value
        self._apply_rated_torque()
        self.apply()
        return None

    def _apply_rated_torque(self) -> None:
        if not self._is_rated_fixed:
            rated_torque_nm = self.value(*self._rated_address) * self._rated_step_nm
            self._use(self.counting.scaled(replace(self.counting.scaling, rated_torque_nm=rated_torque_nm)))

    def _set_point_writer(self, field: str, convert: Callable[[Counting, int], float]) -> Callable[[int], SdoAbortCode | None]:
        column, row = live(self.axes.motion, field), self.row

        def write(value: int) -> SdoAbortCode | None:
            column[row] = convert(self.counting, value)
            return None

        return write

    def restart(self) -> None:
        """Apply the whole dictionary after a reset.

        A halt, and the zero that homing has found, are lost.
        """
        self.limits.is_profile_halted = False
        self._use(self.counting.shifted(0))
        self._apply_rated_torque()
        if self._units is not None:
            self._units.apply()
        self._family.apply()
        self.apply()

    def apply(self) -> None:
        """Apply limits, ramps and set-points."""
        self.limits.apply()
        for index, field, convert in SET_POINTS:
            self.motion[field] = convert(self.counting, self.value(index))
