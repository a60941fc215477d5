"""Objects that command a drive rather than configure it.

No file may contain them, and a pull leaves them out.
"""

from drive_profiles.family.profile import Profile
from drive_profiles.standard.object_address import ObjectAddress, object_address

_COMMANDS = frozenset({
    0x1003, 0x100C, 0x100D, 0x1010, 0x1011, 0x1014, 0x1015, 0x1020, 0x1021, 0x1023, 0x1024, 0x1025, 0x1026,
    0x1F22, 0x1F50, 0x1F51, 0x1F56, 0x1F57, 0x1F80, 0x1F82,
    0x6040, 0x6060, 0x6042, 0x6071, 0x607A, 0x60B0, 0x60B1, 0x60B2, 0x60B8, 0x60C1, 0x60FE, 0x60FF,
})  # fmt: skip
"""Objects that command or move a drive, rewrite its program or its history: never written from a file, never pulled."""

_SDO_PARAMETERS = range(0x1200, 0x1300)
"""Identifiers of the SDO channels: changed in the middle of an upload they would end it."""


def is_command(address: ObjectAddress, profile: Profile | None = None) -> bool:
    """Return True if writing the object commands the drive.

    Objects of further axes count, too (CiA 402: + 800h each), and the set-points of the maker's own that a profile names.
    """
    index = address[0]
    return (
        address in _set_points(profile)
        or index in _COMMANDS
        or index in _SDO_PARAMETERS
        or (0x6800 <= index < 0xA000 and 0x6000 + (index - 0x6000) % 0x800 in _COMMANDS)
    )


def _set_points(profile: Profile | None) -> set[ObjectAddress]:
    """Return the set-points that a profile names."""
    if profile is None:
        return set()
    named = [] if profile.torque is None else [profile.torque.target, profile.torque.offset]
    if profile.position_mode is not None:
        named.append(profile.position_mode.target)
    return {object_address(each) for each in named if each is not None}
