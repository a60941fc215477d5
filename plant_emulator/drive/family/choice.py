"""Choice of the drive that moves an axis."""

from dataclasses import replace
from functools import lru_cache

from drive_profiles.standard.object_address import ObjectAddress, object_address
from drive_profiles.standard.units import Scaling
from plant_emulator.drive.dictionary import manufacturer_objects as objects
from plant_emulator.drive.dictionary.additional_encoder import FIRST, load_encoder_entries
from plant_emulator.drive.family.base import DriveFamily, OwnFamily
from plant_emulator.drive.family.objects import described_entries, merged
from plant_emulator.robots.robot import Robot
from plant_emulator.slave.dictionary import Dictionary, Entry


def family_of(robot: Robot, number: int) -> DriveFamily:
    """Return the drive family that the robot file names for an axis.

    Raises:
        DriveProfileError: There is no such profile, or its file or the EDS file has errors.
        ValueError: The profile is not a drive's.
    """
    axis = robot.axis[number]
    if axis.profile == OwnFamily.profile:
        scaling = Scaling(axis.encoder_counts_per_rev, axis.rated_torque)
        return OwnFamily(_dictionary(_own_entries(robot, number), robot, number), scaling)

    from drive_profiles.family.profile import Profile  # noqa: PLC0415 - slow to load, and our own drive has none
    from plant_emulator.drive.family.described import DescribedFamily  # noqa: PLC0415
    from plant_emulator.drive.family.dictionary import FamilyDictionary, vendor_scaling  # noqa: PLC0415
    from plant_emulator.drive.family.gains import Gains  # noqa: PLC0415

    profile = Profile.load(axis.profile)
    if profile.kind != "drive":
        raise ValueError(f"axis.{number}: profile {profile.name} describes an {profile.kind}; expected a drive profile")
    scaling = vendor_scaling(profile, axis)
    gains = None if profile.loop is None else Gains(profile, profile.loop, axis, scaling)
    if gains is None:
        raise ValueError(f"axis.{number}: {profile.name} states no loop")
    objects_of_it = FamilyDictionary(profile, axis, number, scaling, gains)
    facts = profile.load_encoder
    position = FIRST if facts is None or facts.position is None else object_address(facts.position)
    family = DescribedFamily(
        profile, robot, number, _dictionary(objects_of_it.entries(), robot, number, position), scaling, gains, objects_of_it
    )
    family.load_position = position
    return family


_entries_of_a_kind = lru_cache(maxsize=16)(objects.drive_entries)  # they never change, so a hundred drives share them


def _own_entries(robot: Robot, number: int) -> list[Entry]:
    """Return the entries of the emulated drive."""
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


def _dictionary(entries: list[Entry], robot: Robot, number: int, position: ObjectAddress = FIRST) -> Dictionary:
    """Make the dictionary of these and further entries.

    The further ones are those of a second encoder, and those of the axis' EDS file that are not among them.
    """
    path, encoder = robot.axis[number].eds, robot.axis[number].load_encoder
    if encoder is not None:
        entries = merged(entries, load_encoder_entries(encoder, position))
    if path is None:
        return Dictionary(entries)

    from drive_profiles import eds  # noqa: PLC0415 - slow to load

    present = {(entry.index, entry.subindex): entry for entry in entries}
    described = described_entries(eds.load(path, node_id=robot.node_ids[number]).dictionary, present)
    return Dictionary([*entries, *described])
