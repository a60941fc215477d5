"""The snapshot of an upload as a parameter set, so that going back takes the same way as going forth."""

from __future__ import annotations

from drive_profiles.catalogue import Catalogue, Entry
from drive_profiles.cia301 import type_of_length
from drive_profiles.errors import RefusedError
from drive_profiles.journal import Snapshot
from drive_profiles.parameter import address_of
from drive_profiles.parameters import Header, Item, ParameterSet, is_command, item_of


def as_set(snapshot: Snapshot, catalogue: Catalogue) -> ParameterSet:
    """The values that the drive held, raw, by address.

    Raises:
        RefusedError: Nothing that could be written back is in it, or bytes that are no value of their object's type.
    """
    table: dict[str, Item] = {}
    reasons: list[str] = []
    for place, data in snapshot.old.items():
        entry = catalogue.get(place)
        if is_command(place) or (entry is not None and not entry.is_writable):  # read for its PDO's sake, never written
            continue
        kind = (entry.data_type if entry else None) or type_of_length(len(data))
        try:
            key, table_item = item_of(Entry(place, snapshot.names.get(place, ""), kind), data, None)
        except ValueError as error:
            reasons.append(f"{address_of(place)}: what the drive held cannot be written back: {error}")
            continue
        table[key] = table_item
    if reasons:
        raise RefusedError(*reasons)
    if not table:
        raise RefusedError("the snapshot holds nothing that could be written back")
    identity = snapshot.identity
    header = Header(
        profile=snapshot.profile,
        vendor_id=identity.get("vendor_id"),
        product_code=identity.get("product_code"),
        revision=identity.get("revision"),
        serial_number=identity.get("serial_number"),
    )
    # one class for all: a snapshot goes back to the very device that it is of, which the serial number in the header decides
    return ParameterSet(header=header, commissioning=table)
