"""Choice of the drive that moves an axis."""

from plant_emulator.drive.family.base import DriveFamily, OwnFamily
from plant_emulator.robots.robot import Robot


def family_of(robot: Robot, number: int) -> DriveFamily:
    """Return the drive family that the robot file names for an axis.

    Raises:
        DriveProfileError: There is no such profile, or its file or the EDS file has errors.
        ValueError: The profile is not a drive's.
    """
    if robot.axis[number].profile == OwnFamily.profile:
        return OwnFamily(robot, number)

    from drive_profiles.family.profile import Profile  # noqa: PLC0415 - slow to load, and our own drive has none
    from plant_emulator.drive.family.described import DescribedFamily  # noqa: PLC0415

    return DescribedFamily(Profile.load(robot.axis[number].profile), robot, number)
