"""Sign of an emulated node: a hardware version (1009h) that says that there is no hardware.

An emulated drive of a vendor's family answers as that family's drives do, identity and name included, so none of that tells it
from a real one. 1009h is optional (CiA 301): a device that lacks it, or holds anything else, is not taken for emulated.

>>> is_emulated(HARDWARE_VERSION.encode()), is_emulated(b"1.0"), is_emulated(b"")
(True, False, False)
"""

from drive_profiles.standard.object_address import ObjectAddress

HARDWARE_VERSION_OBJECT: ObjectAddress = (0x1009, 0)
HARDWARE_VERSION = "none (plant-emulator)"


def is_emulated(hardware_version: bytes) -> bool:
    """True for the content of 1009h of an emulated node; fill bytes at its end do not count."""
    return hardware_version.rstrip(b"\0 ") == HARDWARE_VERSION.encode("ascii")
