"""Mark of an emulated node in its hardware version (1009h).

An emulated drive of a maker's family answers like a real one, identity and name included, so only this mark tells them
apart. 1009h is optional (CiA 301): a device that lacks it, or holds anything else, is not taken for emulated.

>>> is_emulated(HARDWARE_VERSION.encode()), is_emulated(b"1.0"), is_emulated(b"")
(True, False, False)
"""

from drive_profiles.standard.object_address import ObjectAddress

HARDWARE_VERSION_OBJECT: ObjectAddress = (0x1009, 0)
HARDWARE_VERSION = "none (plant-emulator)"


def is_emulated(hardware_version: bytes) -> bool:
    """Return True for the 1009h content of an emulated node."""
    return hardware_version.rstrip(b"\0 ") == HARDWARE_VERSION.encode("ascii")
