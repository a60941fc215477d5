"""Objections to an upload, raised before anything is written."""

from collections.abc import Iterable, Sequence

from drive_profiles.device.device import Device, DeviceIdentity
from drive_profiles.errors import UnknownProductError
from drive_profiles.parameter_set.parameters import Header, ParameterSet, Write
from drive_profiles.parameter_set.steps import pdo_of
from drive_profiles.upload.result import UploadOptions


def foreign_device(device: Device, header: Header, identity: DeviceIdentity) -> list[str]:
    """Return reasons why the set is for another maker's device or product."""
    profile, who = device.profile, "the parameter set"
    reasons: list[str] = []
    if profile is not None:
        reasons += _differs("vendor (1018h:1)", identity.vendor_id, (profile.identity.vendor_id,), f"profile {profile.label}")
    reasons += _differs("vendor", identity.vendor_id, (header.vendor_id,), who)
    reasons += _differs("product", identity.product_code, (header.product_code,), who)
    return reasons


def identity_refusals(device: Device, header: Header, identity: DeviceIdentity, options: UploadOptions) -> list[str]:
    """Return reasons why profile, EDS or set do not fit the device."""
    profile, description = device.profile, device.catalogue.description
    reasons = foreign_device(device, header, identity)
    if profile is not None:
        who = f"profile {profile.label}"
        try:
            expected = profile.product(identity.product_code, identity.revision).identity
        except UnknownProductError as error:
            expected = profile.identity
            what_to_do = ": a [[product]] in a copy of the profile can name it" if profile.products else ""
            reasons.append(f"{error}{what_to_do}")
        reasons += _differs("device type (1000h)", identity.device_type, (expected.device_type,), who)
        if not (expected.is_verified and expected.product_code is not None) and not options.allow_unverified:
            reasons.append(
                f"the identity in {who} is not verified ({expected.source}); give --allow-unverified to write nevertheless"
            )
    if description is not None:  # 0 and nothing are what an EDS says that does not know
        who = str(description.path)
        reasons += _differs("vendor (1018h:1)", identity.vendor_id, description.vendor_ids, who)
        reasons += _differs("product (1018h:2)", identity.product_code, description.product_codes, who)
    return reasons


def warnings_for(parameter_set: ParameterSet, identity: DeviceIdentity, writes: Sequence[Write] = ()) -> list[str]:
    """Return the warnings to the user that do not forbid the upload."""
    header, said = parameter_set.header, []
    if header.revision is not None and identity.revision != header.revision:
        theirs, own = ("none" if number is None else f"0x{number:X}" for number in (header.revision, identity.revision))
        said.append(f"the set is for revision {theirs}; the device has {own}")
    if parameter_set.is_edited:
        said.append("the set has been edited since it was written")
    other = _other_device(header, identity)
    if other and writes:  # refused unless that was asked for: see `value_refusals`
        said.append(f"the set is for another device ({other})")
    return said


def value_refusals(
    device: Device, header: Header, identity: DeviceIdentity, writes: Sequence[Write], options: UploadOptions
) -> list[str]:
    """Return reasons why these values must not go to this device."""
    guesses = [] if options.allow_unverified else [write for write in writes if not write.entry.is_verified]
    why = "its facts are not verified; give --allow-unverified to write it nevertheless"
    reasons = [f"{write.entry}: {why}" for write in guesses]
    if header.unverified and writes and not options.allow_unverified:
        reasons.append(
            f"the values come from unverified facts ({header.unverified}); give --allow-unverified to write them nevertheless"
        )
    reasons += _foreign_set(header, identity, writes, options)
    reasons += _commissioning(header, identity, writes, options)
    reasons += _foreign_identifiers(header, device.node, writes)
    reasons += _moving_scale(device, writes)
    return reasons


def _foreign_set(header: Header, identity: DeviceIdentity, writes: Sequence[Write], options: UploadOptions) -> list[str]:
    """Refuse another device's set: a mistyped node-ID would give its limits."""
    theirs = [write for write in writes if write.parameter_class != "commissioning"]  # of these see `_commissioning`
    other = _other_device(header, identity)
    if not other or not theirs or options.other_device or options.force_commissioning:
        return []
    limits = [str(write.entry) for write in theirs if write.parameter_class == "limits"]
    among = f"; it contains limits: {', '.join(limits[:3])}{', …' if len(limits) > 3 else ''}" if limits else ""
    return [f"the set is for another device ({other}){among}; give --other-device to write it nevertheless"]


def _other_device(header: Header, identity: DeviceIdentity) -> str:
    """Return the reason why the set is another device's, or ""."""
    if header.serial_number:  # 0 is what a device says that has none
        if header.serial_number == identity.serial_number:
            return ""
        return f"serial number {header.serial_number}; node {identity.node} has {identity.serial_number or 'none'}"
    if header.node_id in {None, identity.node}:
        return ""
    return f"of node {header.node_id}, without a serial number; this is node {identity.node}"


def _commissioning(header: Header, identity: DeviceIdentity, writes: Sequence[Write], options: UploadOptions) -> list[str]:
    """Refuse commissioning values on a device with another serial number."""
    theirs = [write for write in writes if write.parameter_class == "commissioning"]
    # 0 is what a device says that has no serial number
    same = bool(header.serial_number) and header.serial_number == identity.serial_number
    if not theirs or same or options.force_commissioning:
        return []
    names = ", ".join(str(write.entry) for write in theirs[:5])
    if header.serial_number:
        serials = f"the set is for serial number {header.serial_number}; the device has {identity.serial_number or 'none'}"
        what = f"commissioning values of another device ({serials})"
    else:
        what = "commissioning values, and no serial number shows that they belong to this device"
    remedy = "--force-commissioning writes them nevertheless; upload --classes leaves them out"
    return [f"{names}: {what}; {remedy}"]


def _foreign_identifiers(header: Header, own: int, writes: Sequence[Write]) -> list[str]:
    """Refuse another node's PDO identifiers: its set-points would move this one."""
    theirs = header.node_id
    if theirs in {None, own}:
        return []
    pdos = [write for write in writes if write.address[1] == 1 and pdo_of(write.address) == write.address[0]]
    named = ", ".join(str(write.entry) for write in pdos if int.from_bytes(write.data, "little") & 0x7F == theirs)
    what = f"{named}: identifiers of node {theirs}, but this is node {own}; leave communication out (--classes)"
    return [what] if named else []


def _moving_scale(device: Device, writes: Sequence[Write]) -> list[str]:
    """Refuse a set that changes the scaling of its own values."""
    sources = device.scaling_addresses()
    scaled = [write for write in writes if write.entry.needs_scaling]
    moved = [write for write in writes if write.address in sources and scaled and device.read(write.address) != write.data]
    if not moved:
        return []
    named = ", ".join(str(write.entry) for write in moved)
    return [f"{named} changes the scaling of {scaled[0].entry}; upload it first, in a set of its own"]


def _differs(what: str, actual: int | None, wanted: Iterable[int | None], who: str) -> list[str]:
    values = [each for each in wanted if each is not None]
    if not values or actual in values:
        return []
    shown = " or ".join(f"0x{value:X}" for value in values)
    return [f"its {what} is {'not given' if actual is None else f'0x{actual:X}'}, {who} says {shown}"]
