"""What speaks against an upload before anything is written: another device, guesses, another device's values."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from drive_profiles.device import Device, Found
from drive_profiles.outcome import Options
from drive_profiles.parameters import Header, ParameterSet, Write
from drive_profiles.steps import pdo_of


def against_identity(device: Device, header: Header, found: Found, options: Options) -> list[str]:
    """Why profile, EDS or set are not of the device that answers; empty where nothing speaks against it."""
    profile, description = device.profile, device.catalogue.description
    reasons: list[str] = []
    if profile is not None:
        identity, who = profile.identity, f"profile {profile.name}"
        types = () if identity.device_type is None else (identity.device_type,)
        reasons += _differs("vendor (1018h:1)", found.vendor_id, (identity.vendor_id,), who)
        reasons += _differs("product (1018h:2)", found.product_code, identity.product_codes, who)
        reasons += _differs("device type (1000h)", found.device_type, types, who)
        if not (identity.is_verified and identity.product_codes) and not options.allow_unverified:
            reasons.append(f"the identity in {who} is not verified ({identity.source}); --allow-unverified")
    if description is not None:  # 0 and nothing are what an EDS says that does not know
        who = str(description.path)
        reasons += _differs("vendor (1018h:1)", found.vendor_id, filter(None, (description.vendor_id,)), who)
        reasons += _differs("product (1018h:2)", found.product_code, filter(None, (description.product_code,)), who)
    who = "the parameter set"
    reasons += _differs("vendor", found.vendor_id, () if header.vendor_id is None else (header.vendor_id,), who)
    reasons += _differs("product", found.product_code, () if header.product_code is None else (header.product_code,), who)
    return reasons


def doubts(parameter_set: ParameterSet, found: Found, writes: Sequence[Write] = ()) -> list[str]:
    """What a user should know, but what does not forbid the upload."""
    header, said = parameter_set.header, []
    if header.revision is not None and found.revision != header.revision:
        said.append(f"the set is of revision {header.revision}, the device of {found.revision}")
    if parameter_set.is_edited:
        said.append("the set has been edited since it was written")
    theirs = [str(write.entry) for write in writes if write.parameter_class == "limits"]
    if header.serial_number and header.serial_number != found.serial_number and theirs:
        serials = f"serial number {header.serial_number}, this one has {found.serial_number}"
        said.append(f"limits of another drive ({serials}): {', '.join(theirs[:5])}{', …' if len(theirs) > 5 else ''}")
    return said


def against_values(device: Device, header: Header, found: Found, writes: Sequence[Write], options: Options) -> list[str]:
    """Why these values must not be written to this very device, although each of them could be."""
    guesses = [] if options.allow_unverified else [write for write in writes if not write.entry.is_verified]
    why = "nobody has verified what is known of it; --allow-unverified writes it all the same"
    reasons = [f"{write.entry}: {why}" for write in guesses]
    if header.unverified and writes and not options.allow_unverified:
        reasons.append(f"the values were made of facts that nobody has verified ({header.unverified}); --allow-unverified")
    reasons += _commissioning(header, found, writes, options)
    reasons += _foreign_identifiers(header, device.node, writes)
    reasons += _moving_scale(device, writes)
    return reasons


def _commissioning(header: Header, found: Found, writes: Sequence[Write], options: Options) -> list[str]:
    """Offsets and the like go back to the device with the serial number of the set alone."""
    theirs = [write for write in writes if write.parameter_class == "commissioning"]
    # 0 is what a device says that has no serial number
    same = bool(header.serial_number) and header.serial_number == found.serial_number
    if not theirs or same or options.force_commissioning:
        return []
    serials = f"the set is of serial number {header.serial_number}, the device has {found.serial_number}"
    names = ", ".join(str(write.entry) for write in theirs[:5])
    remedy = "--force-commissioning writes them all the same, upload --classes leaves them out"
    return [f"{names}: commissioning values of another device ({serials}); {remedy}"]


def _foreign_identifiers(header: Header, own: int, writes: Sequence[Write]) -> list[str]:
    """PDO identifiers of the node that the set was pulled from: on another node its set-points would move this one."""
    theirs = header.node_id
    if theirs in {None, own}:
        return []
    pdos = [write for write in writes if write.place[1] == 1 and pdo_of(write.place) == write.place[0]]
    named = ", ".join(str(write.entry) for write in pdos if int.from_bytes(write.data, "little") & 0x7F == theirs)
    what = f"{named}: identifiers of node {theirs}, this is node {own}; leave communication out (--classes)"
    return [what] if named else []


def _moving_scale(device: Device, writes: Sequence[Write]) -> list[str]:
    """What a step is worth must not change in the middle of the set that counts in it."""
    sources = device.scaling_places()
    scaled = [write for write in writes if write.entry.needs_scaling]
    moved = [write for write in writes if write.place in sources and scaled and device.read(write.place) != write.data]
    if not moved:
        return []
    named = ", ".join(str(write.entry) for write in moved)
    return [f"{named} decides what a step of {scaled[0].entry} is worth: upload it first, in a set of its own"]


def _differs(what: str, found: int | None, wanted: Iterable[int], who: str) -> list[str]:
    values = tuple(wanted)
    if not values or found in values:
        return []
    shown = " or ".join(f"0x{value:X}" for value in values)
    return [f"its {what} is {'not given' if found is None else f'0x{found:X}'}, {who} says {shown}"]
