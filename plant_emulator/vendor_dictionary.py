"""The dictionary of a vendor's drive: who it is, what it needs to move, and the parameters of its profile."""

import math

from drive_profiles.cia301 import DataType, Value
from drive_profiles.cia402 import Object
from drive_profiles.parameter import LIMITS, Parameter, place_of
from drive_profiles.profile import Profile
from drive_profiles.units import Scaling
from plant_emulator import drive_objects as objects
from plant_emulator.cia402_objects import cia402_entries
from plant_emulator.robot import Axis
from plant_emulator.slave.dictionary import Access, Entry
from plant_emulator.slave.objects import communication_entries
from plant_emulator.slave.store import Place, StoreCommand, command_entry
from plant_emulator.vendor_gains import Gains
from plant_emulator.vendor_objects import ENGINE, as_raw, merged, parameter_entry, si_steps, stated_default


def store_commands(profile: Profile) -> tuple[StoreCommand, ...]:
    """The entries that store and restore, as far as the drive has them."""
    store, commands = profile.store, []
    if store.object is not None:
        commands.append(StoreCommand(place_of(store.object), store.signature))
    if store.restore is not None:
        commands.append(StoreCommand(place_of(store.restore), store.restore_signature, is_restore=True))
    return tuple(commands)


def vendor_scaling(profile: Profile, axis: Axis) -> Scaling:
    """How the drive counts on this axis: the motor's rated torque and encoder, as far as the drive's objects can state them."""
    step_nm = 0.001 if profile.torque is None else profile.torque.rated_torque_step_nm
    return Scaling(_encoder_counts(profile, axis), max(1, round(axis.rated_torque / step_nm)) * step_nm)


def _encoder_counts(profile: Profile, axis: Axis) -> int:
    """Counts per motor revolution: the axis', halved until the object that states them can; else what the profile knows."""
    encoder = profile.encoder
    counts = axis.encoder_counts_per_rev
    if encoder is None or (encoder.increments is None and encoder.counts_per_rev is None):
        return counts
    if encoder.increments is None:
        return encoder.counts_per_rev or counts
    place = place_of(encoder.increments)
    stated = next((parameter for parameter in profile.parameters.values() if parameter.place == place), None)
    if stated is not None and stated.data_type in LIMITS:
        while counts > min(LIMITS[stated.data_type][1], stated.maximum or math.inf):
            counts //= 2
    return counts


class VendorDictionary:
    """Puts the entries together.

    Args:
        profile: Of the drive.
        axis: That it moves.
        number: Of the axis, and the drive's serial number.
        scaling: Of the drive.
        gains: Of the drive.

    Attributes:
        commands: The entries that store and restore.
        motor: What the objects hold by which a master scales: the motor's values, whatever the factory's.
        steps: SI units per step of the CiA 402 objects that the vendor scales in its own way.
    """

    def __init__(self, profile: Profile, axis: Axis, number: int, scaling: Scaling, gains: Gains) -> None:
        self._facts, self._axis, self._number, self._scaling, self._gains = profile, axis, number, scaling, gains
        self._parameters = {parameter.place: (name, parameter) for name, parameter in profile.parameters.items()}
        self.commands = store_commands(profile)
        self.motor = self._motor_values()
        self.steps = si_steps(profile.parameters.values(), scaling)

    def entries(self) -> list[Entry]:
        """All entries."""
        base = self._base_entries()
        return merged(base, self._stated({(entry.index, entry.subindex): entry for entry in base}))

    def _base_entries(self) -> list[Entry]:
        """Identity, engine, CiA 402, the store commands, and the objects that state the motor's scaling."""
        identity = self._facts.identity
        entries = communication_entries(
            device_type=objects.DEVICE_TYPE if identity.device_type is None else identity.device_type,
            name=self._facts.title.encode("latin-1", "replace").decode("latin-1"),
            vendor_id=identity.vendor_id,
            product_code=next(iter(identity.product_codes), 0),
            revision=identity.revision or 0,
            serial_number=self._number,
        )
        entries += objects.cycle_entries()
        modes = tuple(mode for mode in self._facts.supported_modes if mode in objects.MODES)
        counts = self._scaling.encoder_counts_per_rev
        axis = self._axis
        entries += cia402_entries(counts, axis.rated_torque_mnm, axis.peak_per_mille, modes, axis.rated_current_ma)
        entries += (
            command_entry(command.place, "Restore default parameters" if command.is_restore else "Store parameters")
            for command in self.commands
        )
        motor = (
            Entry(*place, "Scaling of the motor", DataType.UNSIGNED32, Access.CONST, value) for place, value in self.motor.items()
        )
        return merged(entries, motor)

    def _motor_values(self) -> dict[Place, int]:
        encoder, torque = self._facts.encoder, self._facts.torque
        values = {}
        if torque is not None and torque.rated_torque is not None:
            values[place_of(torque.rated_torque)] = round(self._scaling.rated_torque_nm / torque.rated_torque_step_nm)
        if encoder is not None:
            gear = self._unit_gear(encoder.gear_motor_revs, encoder.gear_shaft_revs)
            for address, value in (
                (encoder.increments, self._scaling.encoder_counts_per_rev),
                (encoder.revolutions, 1),
                (encoder.gear_motor_revs, gear),
                (encoder.gear_shaft_revs, gear),
            ):
                if address is not None:
                    values[place_of(address)] = value
        return values

    def _unit_gear(self, *addresses: str | None) -> int:
        """What either object of the gear ratio holds: it is 1, and the factory's own numbers where they say so."""
        found = {self._parameters.get(place_of(address)) for address in addresses if address is not None}
        defaults = {known[1].default for known in found if known is not None}
        return next((int(d) for d in defaults if len(defaults) == 1 and isinstance(d, int) and d > 0), 1)

    def _stated(self, present: dict[Place, Entry]) -> list[Entry]:
        """The profile's parameters, but for those that the engine works by."""
        commands = {command.place for command in self.commands}
        motor, gains = self.motor, self._gains.factory()
        stated = []
        for place, (name, parameter) in self._parameters.items():
            if place in commands or (parameter.index in ENGINE and place in present):
                continue
            base, default = present.get(place), stated_default(parameter)
            if place in motor:
                default = motor[place]
            elif place in gains:
                default = gains[place]
            elif default is None and base is not None:
                default = self._converted(base, parameter)
            stated.append(parameter_entry(name, parameter, self._scaling, default, base))
        return stated

    def _converted(self, base: Entry, parameter: Parameter) -> Value | None:
        """Our default of a CiA 402 object in the steps of the vendor's."""
        if parameter.place not in self.steps or not isinstance(base.default, int):
            return base.default
        counts = 1.0 / self._scaling.counts_per_rad
        known: dict[int, float] = {Object.MAX_MOTOR_SPEED: 2.0 * math.pi / 60.0, Object.FOLLOWING_ERROR_TIMEOUT: 1e-3}
        if parameter.index == Object.MAX_TORQUE:
            return as_raw(self._axis.torque_limit_nm, parameter, self._scaling)
        ours = known.get(parameter.index, counts)
        return round(base.default * ours / self.steps[parameter.place])
