"""Parameter sets in the formats of other tools: DCF (CiA 306) and concise DCF (CiA 302-3, 1F22h)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from drive_profiles import eds
from drive_profiles.errors import RefusedError
from drive_profiles.family.catalogue import Catalogue
from drive_profiles.files.reading import read_file
from drive_profiles.files.safefile import write_atomically
from drive_profiles.parameter_set.parameters import ParameterSet, Write, from_concise, from_values, to_concise
from drive_profiles.standard.cia301 import DataType, Value, decode, type_of_length
from drive_profiles.standard.object_address import ObjectAddress

DEVICE_FILES = frozenset({".eds", ".dcf", ".xdd", ".xdc"})
CONCISE = frozenset({".cdcf", ".bin"})
MAX_BYTES = 4 << 20


def is_toml(path: Path) -> bool:
    """True where the suffix is that of a parameter set of our own."""
    return path.suffix.lower() not in DEVICE_FILES | CONCISE


def read(path: Path, catalogue: Catalogue, node_id: int | None = None) -> ParameterSet:
    """Read a parameter set from a file of any format, by its suffix. Values whose scaling only a drive knows stay raw.

    Args:
        path: ``.toml``, ``.dcf``, ``.xdc``, ``.cdcf`` or ``.bin``.
        catalogue: The objects of the device; those that only the DCF has are taken from it.
        node_id: Node-ID for ``$NODEID``.

    Raises:
        FileError: The file cannot be read.
        RefusedError: The file is no concise DCF, or holds no value.
    """
    suffix = path.suffix.lower()
    if suffix in CONCISE:
        values = _typed(from_concise(read_file(path, "a concise DCF", max_bytes=MAX_BYTES)), catalogue)
        return from_values(catalogue, values)
    if suffix not in DEVICE_FILES:
        return ParameterSet.load(path)
    description = eds.load(path, node_id=node_id)
    if not description.values:
        raise RefusedError(f"{path} holds no parameter values; a DCF has ParameterValue entries, an EDS has none")
    known = Catalogue(catalogue.profile, description if catalogue.description is None else catalogue.description)
    loaded = from_values(known, description.values)
    header = loaded.header.model_copy(
        update={
            "profile": catalogue.profile.label if catalogue.profile else "",
            "title": description.product_name,
            "vendor_id": description.vendor_id or None,
            "product_code": description.product_code or None,
        }
    )
    return loaded.model_copy(update={"header": header})


def write(path: Path, writes: list[Write], device_file: Path | None, *, node_id: int | None = None, force: bool = False) -> None:
    """Write values as a DCF or a concise DCF, by the suffix.

    Args:
        path: ``.dcf``, ``.cdcf`` or ``.bin``.
        writes: The objects and their bytes, as `ParameterSet.writes` gives them.
        device_file: The EDS from which a DCF is made; every other byte of it stays as it is.
        node_id: Node-ID for ``$NODEID``.
        force: Replace a file that exists.

    Raises:
        RefusedError: A DCF lacks its EDS, the suffix is none of the three, or the file exists.
        FileError: A file cannot be read or written.
    """
    if path.suffix.lower() in CONCISE:
        write_atomically(path, to_concise(writes), force=force)
        return
    if path.suffix.lower() != ".dcf":
        raise RefusedError(f"{path} has none of the suffixes .toml, .dcf, .cdcf, .bin")
    if device_file is None:
        raise RefusedError("a DCF is made from the device's EDS; give it with --eds")
    values = {each.address: decode(each.entry.data_type or DataType.DOMAIN, each.data) for each in writes}
    text = eds.load(device_file, node_id=node_id).rewrite(values)
    write_atomically(path, text, force=force)


def _typed(values: Mapping[ObjectAddress, bytes], catalogue: Catalogue) -> dict[ObjectAddress, Value]:
    typed: dict[ObjectAddress, Value] = {}
    for address, data in values.items():
        entry = catalogue.get(address)
        data_type = (entry.data_type if entry else None) or type_of_length(len(data))
        if data_type.size not in {None, len(data)}:
            raise RefusedError(f"{entry} is a {data_type.name} of {data_type.size} bytes, the concise DCF has {len(data)}")
        typed[address] = decode(data_type, data)
    return typed
