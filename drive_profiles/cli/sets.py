"""Parameter sets as a user names them."""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.device.device import Device
    from drive_profiles.family.catalogue import Catalogue
    from drive_profiles.parameter_set.parameters import Header, ParameterSet


def set_for_drive(
    bus: "SdoBus", node: int, path: Path, profile: str | None = None, eds: Path | None = None
) -> "tuple[Device, ParameterSet]":
    """Open the drive at a node and read the set for it.

    A DCF serves as its own EDS. The profile is the named one, else that of the file's header, else the one that matches. Parts of
    the file that are not used are listed on standard error.

    Raises:
        DriveProfileError: The file cannot be read, or the node cannot be used.
    """
    from drive_profiles.device.target import device_at
    from drive_profiles.parameter_set import formats

    header = formats.header_of(path)
    device = device_at(bus, node, profile or header.profile or None, _own_eds(path, eds))
    wanted = formats.read(path, device.catalogue, node, flagged=True)
    if not formats.is_toml(path):
        for line in wanted.header.not_read:
            typer.echo(f"node {node}: left out: {line}", err=True)
    return device, wanted


def catalogue_for(path: Path, profile: str | None = None, eds: Path | None = None, node_id: int | None = None) -> "Catalogue":
    """Return the objects of a file's device, without a bus.

    A DCF serves as its own EDS. The profile is the named one, else that of the file's header, else the one that matches the
    identity there; the node-ID for ``$NODEID`` likewise.

    Raises:
        DriveProfileError: The file cannot be read, or there is no such profile.
    """
    from drive_profiles.device.target import catalogue_of
    from drive_profiles.parameter_set import formats

    header = formats.header_of(path)
    name = profile or header.profile or _matching(header)
    return catalogue_of(
        name, _own_eds(path, eds), node_id or header.node_id, product_code=header.product_code, revision=header.revision
    )


def _own_eds(path: Path, eds: Path | None) -> Path | None:
    from drive_profiles.parameter_set import formats

    return path if eds is None and path.suffix.lower() in formats.DEVICE_FILES else eds


def _matching(header: "Header") -> str | None:
    """Return the one profile that fits the header's identity, or None."""
    from drive_profiles.device.target import fitting

    names = [] if header.vendor_id is None else fitting(header.vendor_id, header.product_code, header.revision)
    return names[0] if len(names) == 1 else None
