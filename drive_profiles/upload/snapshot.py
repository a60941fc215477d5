"""The snapshot of an upload as a parameter set."""

from __future__ import annotations

from drive_profiles.errors import RefusedError
from drive_profiles.family.catalogue import Catalogue, CatalogueEntry
from drive_profiles.parameter_set.commands import is_command
from drive_profiles.parameter_set.parameters import Header, Item, ParameterSet, item_of
from drive_profiles.standard.cia301 import type_of_length
from drive_profiles.standard.object_address import address_text
from drive_profiles.upload.journal import UploadSnapshot


def as_set(snapshot: UploadSnapshot, catalogue: Catalogue) -> ParameterSet:
    """Make a parameter set of the values that the drive held.

    The values are raw, the objects named by address.

    Raises:
        RefusedError: The snapshot has nothing that could be written back, or bytes that are not a value of their object's type.
    """
    table: dict[str, Item] = {}
    reasons: list[str] = []
    for address, data in snapshot.old.items():
        entry = catalogue.get(address)
        if is_command(address, catalogue.profile) or (
            entry is not None and not entry.is_writable
        ):  # read for its PDO's sake, never written
            continue
        data_type = (entry.data_type if entry else None) or type_of_length(len(data))
        try:
            key, table_item = item_of(CatalogueEntry(address, snapshot.names.get(address, ""), data_type), data, None)
        except ValueError as error:
            reasons.append(f"{address_text(address)}: the drive's previous value cannot be restored: {error}")
            continue
        table[key] = table_item
    if reasons:
        raise RefusedError(*reasons)
    if not table:
        raise RefusedError("the snapshot holds nothing that can be restored")
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
