"""Choice of a device by bus, node, profile and EDS."""

from functools import cache
from pathlib import Path

from drive_profiles import eds
from drive_profiles.device.bus import SdoBus
from drive_profiles.device.device import Device, DeviceIdentity, identity_at
from drive_profiles.errors import NodeError, UnknownProductError
from drive_profiles.family.catalogue import Catalogue
from drive_profiles.family.profile import Profile, available


def matching(identity: DeviceIdentity) -> list[str]:
    """Return the labels of the profiles that fit a device; see `fitting`."""
    return fitting(identity.vendor_id, identity.product_code, identity.revision)


def fitting(vendor_id: int | None, product_code: int | None, revision: int | None) -> list[str]:
    """Return the labels of the profiles that fit 1018h.

    Vendor, product and revision must fit; if a profile has no known code, the vendor alone.
    """
    exact: list[str] = []
    vendor: list[str] = []
    for name in available():
        known = _profile(name)
        if known.identity.vendor_id != vendor_id:
            continue
        for each in known.candidates(product_code, revision):
            (vendor if each.identity.product_code is None else exact).append(each.label)
    return exact or vendor


def fault_texts_of(vendor_id: int | None, product_code: int | None, revision: int | None) -> dict[int, str]:
    """Return the maker's error codes in words, if exactly one family fits."""
    families = {label.partition("/")[0] for label in fitting(vendor_id, product_code, revision)}
    return _profile(families.pop()).fault_texts if len(families) == 1 else {}


@cache
def _profile(name: str) -> Profile:
    """Read a profile of the package once."""
    return Profile.load(name)


def named_profile(identity: DeviceIdentity, name: str) -> Profile:
    """Return the profile that a user names for a device.

    Of a family with several products it is that of the device's product.

    Raises:
        NodeError: The profile is of another maker's devices.
        ProfileNotFoundError: There is no such profile.
    """
    if foreign := _foreign(identity, name):
        raise NodeError(identity.node, foreign, "name a profile of this device")
    return _of_product(Profile.load(name), identity.product_code, identity.revision)


def catalogue_of(
    profile: str | None,
    eds_file: Path | None,
    node: int | None = None,
    *,
    product_code: int | None = None,
    revision: int | None = None,
) -> Catalogue:
    """Return the catalogue of a device from profile and EDS.

    Of a family with several products it is that of the device's, by the numbers of 1018h given, else by those of the EDS; of the
    first one if neither states them. `node` stands for ``$NODEID`` in the file.

    Raises:
        ProfileNotFoundError: There is no such profile.
        FileError: A file has errors.
    """
    description = None if eds_file is None else eds.load(eds_file, node_id=node)
    if profile is None:
        return Catalogue(None, description)
    known = Profile.load(profile)
    if product_code is None and description is not None:
        product_code, revision = description.product_code, description.revision
    return Catalogue(_of_product(known, product_code, revision), description)


def doubt_of_profile(identity: DeviceIdentity, name: str) -> str | None:
    """Return a warning if a named profile is of another maker's devices."""
    foreign = _foreign(identity, name)
    return foreign and f"node {identity.node}: {foreign}, so its objects may mean something else; check the profile"


def _foreign(identity: DeviceIdentity, name: str) -> str | None:
    vendor = Profile.load(name).identity.vendor_id
    if identity.vendor_id in {None, vendor}:
        return None
    return f"profile {name} is for vendor-ID 0x{vendor:08X}; the device is another ({_who(identity)})"


def _of_product(known: Profile, product_code: int | None, revision: int | None) -> Profile:
    """Return the profile of the device's product, else the family's.

    What is not named is read by the facts of the first product; an upload refuses it, see `upload.checks`.
    """
    if not known.products or product_code is None:
        return known
    try:
        return known.product(product_code, revision)
    except UnknownProductError:
        return known


def device_at(bus: SdoBus, node: int, profile: str | None = None, eds_file: Path | None = None) -> Device:
    """Open the device at a node, by default with its own profile.

    Where none matches the identity, the EDS alone is taken. Of a family with several products it is the device's.

    Raises:
        NodeError: The node does not answer, or several profiles match.
        ProfileNotFoundError: There is no such profile.
        FileError: A file has errors.
    """
    port = bus.port(node)
    if profile is not None:
        description = None if eds_file is None else eds.load(eds_file, node_id=node)
        known = Profile.load(profile)
        if known.products:
            identity = identity_at(port)
            known = _of_product(known, identity.product_code, identity.revision)
        return Device(port, Catalogue(known, description), bus.nmt)
    identity = identity_at(port)
    names = matching(identity)
    if len(names) > 1:
        raise NodeError(node, f"may be any of {', '.join(names)}", "choose with --profile")
    if not names and eds_file is None:
        raise NodeError(node, f"no profile fits this device ({_who(identity)})", _remedy(identity))
    return Device(port, catalogue_of(names[0] if names else None, eds_file, node), bus.nmt)


def any_device_at(bus: SdoBus, node: int, profile: str | None = None, eds_file: Path | None = None) -> Device:
    """Open a device, without a fitting profile by the standard's objects alone."""
    try:
        return device_at(bus, node, profile, eds_file)
    except NodeError:  # no profile is of it, or several are
        return Device(bus.port(node), Catalogue(), bus.nmt)


def _who(identity: DeviceIdentity) -> str:
    revision = "" if identity.revision is None else f", revision 0x{identity.revision:08X}"
    return f"vendor 0x{identity.vendor_id or 0:08X}, product 0x{identity.product_code or 0:08X}{revision}"


def _remedy(identity: DeviceIdentity) -> str:
    """Return advice for a device that no profile names."""
    near = [each for each in map(_profile, available()) if each.identity.vendor_id == identity.vendor_id]
    if not near:
        return "give --profile, or the EDS of the device with --eds"
    named = "; ".join(f"{each.name} names {' or '.join(each.products_in_words)}" for each in near)
    return f"profiles of its maker: {named}; give --profile to use one of them, or the EDS of the device with --eds"
