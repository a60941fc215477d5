"""An emulated drive of any profile, with its stated tuning and filters."""

import re
from collections.abc import Callable
from typing import Any

from drive_profiles.errors import DriveProfileError
from drive_profiles.family.capability import FilterSection
from drive_profiles.family.profile import Profile
from drive_profiles.realisation import held_filter
from drive_profiles.standard.object_address import ObjectAddress, object_address
from hil.control.notch import NO_NOTCH, NOTCHES, FixedFilter
from plant_emulator.drive.dictionary import manufacturer_objects as objects
from plant_emulator.drive.dictionary.user_units import hold_units, only
from plant_emulator.drive.family.base import DriveFamily
from plant_emulator.drive.family.dictionary import FamilyDictionary, vendor_scaling
from plant_emulator.drive.family.gains import Gains
from plant_emulator.drive.family.objects import axis_dictionary, state_abort_code
from plant_emulator.motion.axes import Axes
from plant_emulator.robots.robot import Robot
from plant_emulator.slave.dictionary import WriteHook

_STANDARD_UNITS = frozenset({"counts", "°"})
"""Units in which a number is what CiA 402 makes of it: positions in the drive's own steps."""

_AT_THE_TORQUE = re.compile("torque command|current (command|reference)")


class DescribedFamily(DriveFamily):
    """A drive of a profile.

    What acts: the gains whose scaling the profile knows, in the emulator's P-PI; a fixed filter on the torque command; limits
    and ramps; when a parameter may be written and when it acts. Every other parameter is there and holds what is written to it.
    """

    equal_limits_are_none = True
    unwatched_windows = frozenset({0, 2**32 - 1})

    def __init__(self, profile: Profile, robot: Robot, number: int) -> None:
        """Make the drive of an axis.

        Raises:
            ValueError: The profile is not a drive's, or states no loop.
        """
        if profile.kind != "drive":
            raise ValueError(f"axis.{number}: profile {profile.name} describes an {profile.kind}; expected a drive profile")
        if profile.loop is None:
            raise ValueError(f"axis.{number}: {profile.name} states no loop")
        axis = robot.axis[number]
        scaling = vendor_scaling(profile, axis)
        self.profile, self._facts = profile.label, profile
        self._gains = Gains(profile, profile.loop, axis, scaling)
        if profile.load_encoder is not None and profile.load_encoder.position is not None:
            self.load_position = object_address(profile.load_encoder.position)
        entries = FamilyDictionary(profile, axis, number, scaling, self._gains)
        super().__init__(axis_dictionary(entries.entries(), robot, number, self.load_position), scaling)
        self.modes = tuple(mode for mode in profile.supported_modes if mode in objects.MODES)
        self.store_commands, self.store_limit_s = entries.commands, profile.store.wait_s
        self.steps = entries.steps
        if profile.torque is not None and profile.torque.rated_torque is not None:
            self.rated_torque = object_address(profile.torque.rated_torque), profile.torque.rated_torque_step_nm
        if profile.torque is not None and profile.torque.current_step_a is not None:
            self.current_step_a = profile.torque.current_step_a
        if profile.position_mode is not None:
            self.position_mode = profile.position_mode.number, object_address(profile.position_mode.target)
        self._motor = entries.motor
        self._period_s = robot.control_period_s
        self._axis_counts = axis.encoder_counts_per_rev
        self._refusal = state_abort_code((abort.code, abort.text) for abort in profile.aborts)
        self._parameters = {parameter.address: parameter for parameter in profile.parameters.values()}
        self._latched: dict[ObjectAddress, Any] = {}
        self._written: set[ObjectAddress] = set()
        self._filter_note = ""

    # -- filter --------------------------------------------------------------------------------------------------------

    def _sections(self) -> tuple[FilterSection, ...]:
        notch = self._facts.notch
        return () if notch is None or notch.form == "variable" else notch.sections

    def _filters(self) -> list[FixedFilter]:
        """Return the sections that act; a note names the others.

        A section of which a value is not known (the profile has no default, and no client has written it) does not act: a filter
        of made-up values would be none of the drive's.
        """
        filters: list[FixedFilter] = []
        self._filter_note = ""
        for section in self._sections():
            if all(self._is_known(name) for name in section.parts.values()):
                try:
                    filters += self._held(section)
                except (DriveProfileError, ValueError) as error:
                    self._filter_note = f"A filter is off: {error}."
        if len(filters) > NOTCHES:
            self._filter_note = f"Of {len(filters)} filter sections the first {NOTCHES} act."
        return filters[:NOTCHES]

    def _is_known(self, name: str) -> bool:
        parameter = self._facts.parameter(name)
        return parameter.is_bytes or parameter.default is not None or parameter.address in self._written

    def _held(self, section: FilterSection) -> list[FixedFilter]:
        """Return one section's filters that act, with the drive's values."""
        values = {}
        for name in (*section.parts.values(), *section.settings):
            parameter = self._facts.parameter(name)
            held = self.acting(parameter.address)
            if isinstance(held, int | float):
                values[name] = parameter.value(held, self.scaling)
        notch = self._facts.notch
        alone = None if notch is None else notch.model_copy(update={"sections": (section,)})
        biquads = held_filter(self._facts.model_copy(update={"notch": alone}), values, self._period_s)
        return [FixedFilter(*biquad) for biquad in biquads if (biquad.b0, *biquad[1:3]) != (1.0, *biquad[3:5])]

    # -- what the drive does -------------------------------------------------------------------------------------------

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on missing functions and on assumptions."""
        notes = []
        missing = [mode.name for mode in self._facts.supported_modes if mode not in self.modes]
        if missing:
            notes.append(f"Modes that are not emulated: {', '.join(missing)}.")
        notes += self._gains.notes
        if self.scaling.encoder_counts_per_rev != self._axis_counts:
            notes.append(
                f"Its encoder counts {self.scaling.encoder_counts_per_rev} per revolution, not the axis' {self._axis_counts}."
            )
        notch = self._facts.notch
        if notch is not None and notch.form == "variable":
            notes.append("Its variable filter is not emulated.")
        elif notch is not None and not _AT_THE_TORQUE.search(notch.place):
            notes.append(f"Its filter sits elsewhere ({notch.place}); here it is on the torque command.")
        return (*notes, self._filter_note) if self._filter_note else tuple(notes)

    def acting(self, address: ObjectAddress) -> Any:
        """Return the value in force."""
        if address in self._latched:
            return self._latched[address]
        return self.dictionary.cell(*address).value

    def is_scaled(self, address: ObjectAddress) -> bool:
        """Return True if the scale of an object is known.

        The profile states it; an object that the profile does not have keeps the emulator's own scale.
        """
        parameter = self._parameters.get(address)
        return parameter is None or address in self.steps or parameter.unit in _STANDARD_UNITS

    def states(self, address: ObjectAddress) -> bool:
        """Return True if the profile has the object."""
        return address in self._parameters

    def bind(self, axes: Axes, row: int, is_powered: Callable[[], bool]) -> None:
        """Bind gains and filter to the axis, and restrict writes.

        Each parameter can be written when the profile allows it.
        """
        self._axes, self._row, self._is_powered = axes, row, is_powered
        gains = self._gains.addresses
        names = {name for section in self._sections() for name in (*section.parts.values(), *section.settings)}
        filters = {self._facts.parameter(name).address for name in names}
        motor = self._motor
        fixed = set(motor) - {self.rated_torque[0]}
        commands = {command.address for command in self.store_commands}
        for address, parameter in self._parameters.items():
            cell = self.dictionary.cell(*address)
            if address in commands or not cell.entry.access.is_writable:
                continue
            if address in fixed:
                self.dictionary.on_write(*address, only(motor[address]))
            elif address in gains | filters:
                self.dictionary.on_write(
                    *address, self._writer(address, self._apply_gains if address in gains else self._apply_filters)
                )
            if parameter.effective == "disabled":
                self.dictionary.wrap_write(*address, self._guarded)
        hold_units(self.dictionary, set(self._parameters))

    def _writer(self, address: ObjectAddress, apply: Callable[[], None]) -> WriteHook:
        cell = self.dictionary.cell(*address)

        def write(value: Any) -> None:
            cell.value = value
            self._written.add(address)
            apply()

        return write

    def _guarded(self, inner: WriteHook | None) -> WriteHook:
        def write(value: Any) -> int | None:
            if self._is_powered():
                return self._refusal
            return None if inner is None else inner(value)

        return write

    def apply(self) -> None:
        """Apply the whole dictionary, after a reset."""
        latched = (address for address, parameter in self._parameters.items() if parameter.effective == "reset")
        self._written &= set(self.dictionary.stored)
        self._latched = {address: self.dictionary.cell(*address).value for address in latched}
        self._apply_gains()
        self._apply_filters()

    def _apply_gains(self) -> None:
        row = self._axes.cascade_config[self._row]
        for name, value in self._gains.acting(self.acting).items():
            row[name] = value

    def _apply_filters(self) -> None:
        filters = self._filters()
        for column in range(NOTCHES):
            setting = filters[column] if column < len(filters) else NO_NOTCH
            setting.write(self._axes.notch_config[self._row, column])
