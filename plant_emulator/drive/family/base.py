"""The family of an emulated drive."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Mode, Object
from drive_profiles.standard.object_address import ObjectAddress
from drive_profiles.standard.units import Scaling
from hil.control.notch import NOTCH_OFF, NOTCHES, Notch
from plant_emulator.core import CORE
from plant_emulator.drive.dictionary import manufacturer_objects as objects
from plant_emulator.drive.dictionary.additional_encoder import FIRST
from plant_emulator.drive.family.objects import axis_dictionary
from plant_emulator.motion.axes import Axes, live
from plant_emulator.robots.robot import Robot
from plant_emulator.slave.dictionary import Dictionary, Entry, ReadHook
from plant_emulator.slave.store import StoreCommand, standard_commands


class DriveFamily(ABC):
    """The part of a drive that depends on its family.

    Attributes:
        profile: Name of the profile that describes the drive.
        scaling: Scaling of the drive when it leaves the factory.
        steps: SI units per step of those CiA 402 objects that do not count as ours do.
        rated_torque: The object that torques are per mille of, and N·m per step of it.
        unwatched_windows: Values of 6065h with which the following error is not watched.
        has_user_units: True if the objects of the factor group act (6091h, 6092h, 607Eh, 60A8h to 60AAh).
        position_mode: Number of a mode of its maker that takes positions with each SYNC, and its target; None: there is none.
        current_step_a: Amperes per step of 6078h; None: it is per mille of 6075h.
        load_position: Where it shows the position of a second encoder.
        set_point_timeout: Object with the number of interpolation periods that a set-point may be missing; None: it is held.
        shown: Read hooks of its entries that the process image shows, and what they show; known when it is bound.
        equal_limits_are_none: True if 607Dh with both limits equal means that there are none, as both 0 always does.
    """

    profile: str
    dictionary: Dictionary
    scaling: Scaling
    modes: tuple[Mode, ...]
    store_commands: tuple[StoreCommand, ...] = standard_commands()
    store_limit_s: float = float("inf")
    steps: Mapping[ObjectAddress, float] = {}
    rated_torque: tuple[ObjectAddress, float] = ((Object.MOTOR_RATED_TORQUE, 0), 0.001)
    unwatched_windows: frozenset[int] = frozenset({2**32 - 1})
    set_point_timeout: ObjectAddress | None = None
    equal_limits_are_none: bool = False
    has_user_units: bool = False
    position_mode: tuple[int, ObjectAddress] | None = None
    current_step_a: float | None = None
    load_position: ObjectAddress = FIRST

    def __init__(self, dictionary: Dictionary, scaling: Scaling) -> None:
        """Make a family that moves no axis yet."""
        self.dictionary, self.scaling = dictionary, scaling
        self._axes: Any = None
        self._row = 0
        self._is_powered: Callable[[], bool] = lambda: False
        self.shown: dict[ReadHook, int] = {}

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on deviations from the real drive."""
        return ()

    def acting(self, address: ObjectAddress) -> Any:
        """Return the raw value in force: the entry's, or the last reset's."""
        return self.dictionary.cell(*address).value

    def is_scaled(self, address: ObjectAddress) -> bool:
        """Return True if the scale of a CiA 402 limit is known.

        A limit of unknown scale is kept but not applied.
        """
        return True

    def states(self, address: ObjectAddress) -> bool:
        """Return True if the family defines a CiA 402 object's values."""
        return False

    @abstractmethod
    def bind(self, axes: Axes, row: int, is_powered: Callable[[], bool]) -> None:
        """Bind the family's entries to a row of the axes.

        The CiA 402 entries and the engine's are bound already.
        """

    @abstractmethod
    def apply(self) -> None:
        """Apply all entries, after a reset."""


def _while_active(active: Any, values: Any, column: int) -> float:
    return float(values[column]) if active[column] else 0.0


class OwnFamily(DriveFamily):
    """The emulated drive itself.

    It has P-PI gains (2100h, 2101h), two variable notches (2110h, 2111h) and a cancellation of the ATE (2114h).
    """

    profile = "emulated_drive"
    modes = objects.MODES
    set_point_timeout = (objects.SET_POINT_TIMEOUT, 0)
    has_user_units = True

    def __init__(self, robot: Robot, number: int) -> None:
        """Make the drive of an axis."""
        axis = robot.axis[number]
        scaling = Scaling(axis.encoder_counts_per_rev, axis.rated_torque)
        super().__init__(axis_dictionary(_own_entries(robot, number), robot, number), scaling)

    def bind(self, axes: Axes, row: int, is_powered: Callable[[], bool]) -> None:
        """Bind gains and filters, and the objects that show them."""
        self._axes, self._row, self._is_powered = axes, row, is_powered
        on_read, on_write = self.dictionary.on_read, self.dictionary.on_write
        for (index, sub), field in objects.GAINS.items():
            on_write(index, sub, self._writer(axes.cascade_config[row], field))
        for column, index in enumerate(objects.NOTCH_OBJECTS):
            for sub, parameter in enumerate(objects.NOTCH_PARAMETERS, start=1):
                on_write(index, sub, self._notch_writer(column, parameter[0]))
        for column, index in enumerate(objects.NOTCH_STATE_OBJECTS):
            active = live(axes.notch_state[row], "active")
            is_active = partial(active.__getitem__, column)
            frequency_hz = partial(_while_active, active, live(axes.notch_state[row], "frequency_hz"), column)
            on_read(index, 1, is_active)
            on_read(index, 2, frequency_hz)
            if column == 0:
                self.shown = {is_active: CORE.call.FILTER_ACTIVE, frequency_hz: CORE.call.FILTER_FREQUENCY}
            on_read(index, 3, partial(_while_active, active, live(axes.notch_state[row], "zeta_rd"), column))
        for sub, parameter in enumerate(objects.CANCELLATION_PARAMETERS, start=1):
            on_write(objects.CANCELLATION, sub, self._writer(axes.motion[row], parameter[0]))
        on_read(objects.TORQUE_COMMAND, 0, partial(live(axes.motion, "torque_nm").__getitem__, row))

    def _writer(self, values: Any, field: str) -> Callable[[float], SdoAbortCode | None]:
        """Return a write hook for a field of the servo law.

        The cancellation may be switched on and off under torque, and fades; gains and its other parameters may not change then.
        """

        def write(value: float) -> SdoAbortCode | None:
            if self._is_powered() and field != "cancel_mode":
                return SdoAbortCode.DEVICE_STATE
            values[field] = value
            return None

        return write

    def _notch_writer(self, column: int, field: str) -> Callable[[float], SdoAbortCode | None]:
        """Return a write hook for a field of a notch.

        Notches may be switched on and off under torque; their other parameters may not change then.
        """

        def write(value: float) -> SdoAbortCode | None:
            if self._is_powered() and field != "mode":
                return SdoAbortCode.DEVICE_STATE
            row = self._axes.notch_config[self._row, column]
            wanted = {parameter[0]: row[parameter[0]].item() for parameter in objects.NOTCH_PARAMETERS} | {field: value}
            try:
                if wanted["mode"] != NOTCH_OFF:
                    Notch(**wanted)
            except ValueError:
                return SdoAbortCode.PARAMETER_INCOMPATIBLE
            row[field] = value
            return None

        return write

    def apply(self) -> None:
        """Apply gains and filters."""
        cascade = self._axes.cascade_config[self._row]
        for address, field in objects.GAINS.items():
            cascade[field] = self.acting(address)
        for column in range(NOTCHES):
            for sub, parameter in enumerate(objects.NOTCH_PARAMETERS, start=1):
                self._axes.notch_config[self._row, column][parameter[0]] = self.acting((objects.NOTCH_OBJECTS[column], sub))
        for sub, parameter in enumerate(objects.CANCELLATION_PARAMETERS, start=1):
            self._axes.motion[self._row][parameter[0]] = self.acting((objects.CANCELLATION, sub))


_entries_of_a_kind = lru_cache(maxsize=16)(objects.drive_entries)  # they never change, so a hundred drives share them


def _own_entries(robot: Robot, number: int) -> list[Entry]:
    axis = robot.axis[number]
    gains = (0.0, 0.0, 0.0, 300.0)
    if axis.control is not None:
        k = axis.control
        gains = (k.position_gain_per_s, k.velocity_gain_nm_s_rad, k.velocity_integral_gain_nm_rad, k.lowpass_hz)
    shared = _entries_of_a_kind(
        encoder_counts_per_rev=axis.encoder_counts_per_rev,
        rated_torque_mnm=axis.rated_torque_mnm,
        max_torque_per_mille=axis.peak_per_mille,
        control_period_ns=round(1e9 * robot.control_period_s),
        gains=gains,
        rated_current_ma=axis.rated_current_ma,
    )
    serial = (0x1018, 4)
    return [replace(entry, default=number) if (entry.index, entry.subindex) == serial else entry for entry in shared]
