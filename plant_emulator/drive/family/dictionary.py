"""The dictionary of a described drive."""

import math

from drive_profiles.family.parameter import LIMITS, Parameter
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType, Value
from drive_profiles.standard.cia402 import Object
from drive_profiles.standard.object_address import ObjectAddress, object_address
from drive_profiles.standard.units import Scaling
from plant_emulator.drive.dictionary import manufacturer_objects as objects
from plant_emulator.drive.dictionary.cia402_objects import cia402_entries
from plant_emulator.drive.dictionary.limit_table import MOTION_LIMITS
from plant_emulator.drive.family.gains import Gains
from plant_emulator.drive.family.objects import ENGINE, as_raw, merged, parameter_entry, si_steps, stated_default
from plant_emulator.robots.robot import RobotAxis
from plant_emulator.slave.dictionary import Access, Entry
from plant_emulator.slave.objects import communication_entries
from plant_emulator.slave.store import StoreCommand, command_entry


def store_commands(profile: Profile) -> tuple[StoreCommand, ...]:
    """Return the drive's store and restore commands."""
    store, commands = profile.store, []
    if store.object is not None:
        commands.append(StoreCommand(object_address(store.object), store.signature))
    if store.restore is not None:
        commands.append(StoreCommand(object_address(store.restore), store.restore_signature, is_restore=True))
    return tuple(commands)


def vendor_scaling(profile: Profile, axis: RobotAxis) -> Scaling:
    """Return the scaling of the drive on this axis.

    It has the motor's rated torque and encoder, as far as the drive's objects can state them.
    """
    step_nm = 0.001 if profile.torque is None else profile.torque.rated_torque_step_nm
    return Scaling(_encoder_counts(profile, axis), max(1, round(axis.rated_torque / step_nm)) * step_nm)


def _encoder_counts(profile: Profile, axis: RobotAxis) -> int:
    """Return the counts per motor revolution.

    They are the axis', halved until the object that states them can hold them; else those of the profile.
    """
    encoder = profile.encoder
    counts = axis.encoder_counts_per_rev
    if encoder is None or (encoder.increments is None and encoder.counts_per_rev is None):
        return counts
    if encoder.increments is None:
        return encoder.counts_per_rev or counts
    address = object_address(encoder.increments)
    stated = next((parameter for parameter in profile.parameters.values() if parameter.address == address), None)
    if stated is not None and stated.data_type in LIMITS:
        while counts > min(LIMITS[stated.data_type][1], stated.maximum or math.inf):
            counts //= 2
    return counts


class FamilyDictionary:
    """Composition of the entries.

    Args:
        number: Number of the axis, and the drive's serial number.

    Attributes:
        commands: The entries that store and restore.
        motor: Values of the objects by which a master scales: the motor's values, whatever the factory's.
        steps: SI units per step of the CiA 402 objects that the maker scales differently.
    """

    def __init__(self, profile: Profile, axis: RobotAxis, number: int, scaling: Scaling, gains: Gains) -> None:
        self._facts, self._axis, self._number, self._scaling, self._gains = profile, axis, number, scaling, gains
        self._parameters = {parameter.address: (name, parameter) for name, parameter in profile.parameters.items()}
        self.commands = store_commands(profile)
        self.motor = self._motor_values()
        self.steps = si_steps(profile.parameters.values(), scaling)

    def entries(self) -> list[Entry]:
        """Return all entries."""
        base = self._base_entries()
        return merged(base, self._stated({(entry.index, entry.subindex): entry for entry in base}))

    def _base_entries(self) -> list[Entry]:
        """Return identity, engine, CiA 402, store commands and the motor's scaling."""
        identity = self._facts.identity
        entries = communication_entries(
            device_type=objects.DEVICE_TYPE if identity.device_type is None else identity.device_type,
            name=self._facts.title.encode("latin-1", "replace").decode("latin-1"),
            vendor_id=identity.vendor_id,
            product_code=identity.product_code or 0,
            revision=identity.typical_revision,
            serial_number=self._number,
        )
        entries += objects.cycle_entries()
        modes = tuple(mode for mode in self._facts.supported_modes if mode in objects.MODES)
        counts = self._scaling.encoder_counts_per_rev
        axis = self._axis
        entries += cia402_entries(counts, axis.rated_torque_mnm, axis.peak_per_mille, modes, axis.rated_current_ma)
        entries += (
            command_entry(command.address, "Restore default parameters" if command.is_restore else "Store parameters")
            for command in self.commands
        )
        motor = (
            Entry(*address, "Scaling of the motor", DataType.UNSIGNED32, Access.CONST, value)
            for address, value in self.motor.items()
        )
        return merged(entries, motor)

    def _motor_values(self) -> dict[ObjectAddress, int]:
        encoder, torque = self._facts.encoder, self._facts.torque
        values = {}
        if torque is not None and torque.rated_torque is not None:
            values[object_address(torque.rated_torque)] = round(self._scaling.rated_torque_nm / torque.rated_torque_step_nm)
        if encoder is not None:
            gear = self._unit_gear(encoder.gear_motor_revs, encoder.gear_shaft_revs)
            for address, value in (
                (encoder.increments, self._scaling.encoder_counts_per_rev),
                (encoder.revolutions, 1),
                (encoder.gear_motor_revs, gear),
                (encoder.gear_shaft_revs, gear),
            ):
                if address is not None:
                    values[object_address(address)] = value
        return values

    def _unit_gear(self, *addresses: str | None) -> int:
        """Return the value of the gear ratio's objects.

        The ratio is 1, so both have the same value: the factory setting if the profile states one, else 1.
        """
        found = {self._parameters.get(object_address(address)) for address in addresses if address is not None}
        defaults = {known[1].default for known in found if known is not None}
        return next((int(d) for d in defaults if len(defaults) == 1 and isinstance(d, int) and d > 0), 1)

    def _stated(self, present: dict[ObjectAddress, Entry]) -> list[Entry]:
        """Return the profile's parameters without the engine's own objects."""
        commands = {command.address for command in self.commands}
        motor, gains = self.motor, self._gains.factory()
        stated = []
        for address, (name, parameter) in self._parameters.items():
            if address in commands or (parameter.index in ENGINE and address in present):
                continue
            base, default = present.get(address), stated_default(parameter)
            if address in motor:
                default = motor[address]
            elif address in gains:
                default = gains[address]
            elif default is None and base is not None:
                default = self._converted(base, parameter)
            stated.append(parameter_entry(name, parameter, self._scaling, default, base))
        return stated

    def _converted(self, base: Entry, parameter: Parameter) -> Value | None:
        """Return our default of a CiA 402 object in the maker's steps."""
        if parameter.address not in self.steps or not isinstance(base.default, int):
            return base.default
        if parameter.index == Object.MAX_TORQUE:
            return as_raw(self._axis.torque_limit_nm, parameter, self._scaling)
        ours = MOTION_LIMITS[parameter.index].quantity.si(self._scaling, 1)
        return round(base.default * ours / self.steps[parameter.address])
