"""Choice of a device: from bus, node, profile and EDS, as the user names them, to a device that can be read and written."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from drive_profiles import eds
from drive_profiles.device.bus import SdoBus
from drive_profiles.device.device import Device, DeviceIdentity, identity_at
from drive_profiles.errors import NodeError
from drive_profiles.family.catalogue import Catalogue
from drive_profiles.family.profile import Identity, Profile, available


def matching(identity: DeviceIdentity) -> list[str]:
    """Names of the profiles that fit a device by vendor and product; by vendor alone where the profile knows no product."""
    exact, vendor = [], []
    for name in available():
        known = _identity(name)
        if known.vendor_id != identity.vendor_id:
            continue
        if identity.product_code in known.product_codes:
            exact.append(name)
        elif not known.product_codes:
            vendor.append(name)
    return exact or vendor


@cache
def _identity(name: str) -> Identity:
    """Identity in a profile of the package, which is read once: a scan compares all of them with every node."""
    return Profile.load(name).identity


def catalogue_of(profile: str | None, eds_file: Path | None, node: int | None = None) -> Catalogue:
    """Catalogue of a device's objects, from the profile and the EDS that the user names.

    Args:
        profile: Name or path of a drive profile, or None.
        eds_file: An EDS, DCF or XDD file, or None.
        node: Node-ID for ``$NODEID`` in the file.

    Raises:
        ProfileNotFoundError: There is no such profile.
        FileError: A file has errors.
    """
    description = None if eds_file is None else eds.load(eds_file, node_id=node)
    return Catalogue(None if profile is None else Profile.load(profile), description)


def device_at(bus: SdoBus, node: int, profile: str | None = None, eds_file: Path | None = None) -> Device:
    """Open the device at a node.

    Without a profile, the one that matches the device's identity is taken; where none matches, the EDS alone.

    Args:
        bus: The bus.
        node: Node-ID of the device.
        profile: Name or path of a drive profile, or None.
        eds_file: An EDS, DCF or XDD file of the device, or None.

    Raises:
        NodeError: The node does not answer, or several profiles match.
        ProfileNotFoundError: There is no such profile.
        FileError: A file has errors.
    """
    port = bus.port(node)
    if profile is None:
        identity = identity_at(port)
        names = matching(identity)
        if len(names) > 1:
            raise NodeError(node, f"may be any of {', '.join(names)}", "choose with --profile")
        profile = names[0] if names else None
        if profile is None and eds_file is None:
            who = f"vendor 0x{identity.vendor_id or 0:08X}, product 0x{identity.product_code or 0:08X}"
            raise NodeError(node, f"no profile is of this device ({who})", "give --profile, or its EDS with --eds")
    return Device(port, catalogue_of(profile, eds_file, node), bus.nmt)
