"""From what the user names (bus, node, profile, EDS) to a device that can be read and written."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from drive_profiles import eds
from drive_profiles.bus import Bus
from drive_profiles.catalogue import Catalogue
from drive_profiles.device import Device, Found, found_at
from drive_profiles.errors import NodeError
from drive_profiles.profile import Identity, Profile, available


def matching(found: Found) -> list[str]:
    """Profiles of the package that are of this device: by vendor and product; of the vendor alone where one knows no more."""
    exact, vendor = [], []
    for name in available():
        identity = _identity(name)
        if identity.vendor_id != found.vendor_id:
            continue
        if found.product_code in identity.product_codes:
            exact.append(name)
        elif not identity.product_codes:
            vendor.append(name)
    return exact or vendor


@cache
def _identity(name: str) -> Identity:
    """Of a profile of the package, which is read once: a scan asks for all of them at every node."""
    return Profile.load(name).identity


def catalogue_of(profile: str | None, eds_file: Path | None, node: int | None = None) -> Catalogue:
    """What profile and EDS say.

    Raises:
        ProfileNotFoundError: There is no such profile.
        FileError: A file has errors.
    """
    description = None if eds_file is None else eds.load(eds_file, node_id=node)
    return Catalogue(None if profile is None else Profile.load(profile), description)


def device_at(bus: Bus, node: int, profile: str | None = None, eds_file: Path | None = None) -> Device:
    """The device at a node; without a profile the one that matches its identity, without a match what the EDS says.

    Raises:
        NodeError: It is silent, or several profiles match.
        ProfileNotFoundError: There is no such profile.
        FileError: A file has errors.
    """
    port = bus.port(node)
    if profile is None:
        found = found_at(port)
        names = matching(found)
        if len(names) > 1:
            raise NodeError(node, f"may be any of {', '.join(names)}", "choose with --profile")
        profile = names[0] if names else None
        if profile is None and eds_file is None:
            who = f"vendor 0x{found.vendor_id or 0:08X}, product 0x{found.product_code or 0:08X}"
            raise NodeError(node, f"no profile is of this device ({who})", "give --profile, or its EDS with --eds")
    return Device(port, catalogue_of(profile, eds_file, node), bus.nmt)
