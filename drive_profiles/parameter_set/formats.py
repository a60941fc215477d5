"""Parameter sets as DCF (CiA 306) and concise DCF (CiA 302-3).

A DCF has keys for node-ID, bit rate and serial number. What else the header of a set says stands in comments of its commissioning
section, which other tools pass over: ``; drive-profiles: counts_per_rev = 65536``. So do values that cannot stand on a line, such
as an empty text, with their bytes: ``; drive-profiles: 2FF0:0 = ()``.
"""

import json
import re
import struct
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from drive_profiles import eds
from drive_profiles.eds.description import MAX_BYTES as MAX_DESCRIPTION_BYTES
from drive_profiles.eds.values import text_of
from drive_profiles.errors import RefusedError
from drive_profiles.family.catalogue import Catalogue
from drive_profiles.files.reading import read_file
from drive_profiles.files.safefile import write_atomically
from drive_profiles.files.toml import loads, toml_value
from drive_profiles.parameter_set.parameters import MAX_BYTES, Header, ParameterSet, Write, check_size, from_values
from drive_profiles.parameter_set.steps import pdo_of, steps, support
from drive_profiles.standard.cia301 import DataType, Value, decode, type_of_length
from drive_profiles.standard.object_address import ObjectAddress, address_text, object_address

DEVICE_FILES = frozenset({".eds", ".dcf", ".xdd", ".xdc"})
CONCISE = frozenset({".cdcf", ".bin"})
_OURS = "drive-profiles:"
_COMMENT = re.compile(rf"\s*;\s*{_OURS}\s*([a-z_]+)\s*=\s*(.*?)\s*")
_VALUE = re.compile(rf"\s*;\s*{_OURS}\s*([0-9A-Fa-f]{{4}}:[0-9A-Fa-f]{{1,2}})\s*=\s*\(([0-9A-Fa-f ]*)\)\s*")
_COMMENT_LINES = re.compile(rb"(?m)^[ \t]*;[ \t]*" + _OURS.encode() + rb"[^\r\n]*(?:\r\n|\r|\n|\Z)")
_NOT_IN_COMMENTS = {"format", "hash", "not_read", "node_id", "serial_number", "bitrate_bit_s"}


def is_toml(path: Path) -> bool:
    """Return True if the suffix means our own parameter set."""
    return path.suffix.lower() not in DEVICE_FILES | CONCISE


def check_suffix(path: Path) -> None:
    """Refuse a file to be written that is neither a DCF nor a concise DCF.

    Raises:
        RefusedError: The suffix is another one.
    """
    if path.suffix.lower() not in {".dcf", *CONCISE}:
        raise RefusedError(f"{path} has none of the suffixes .toml, .dcf, .cdcf, .bin")


def header_of(path: Path) -> Header:
    """Return a set's header in any format; a concise DCF's is empty.

    Raises:
        FileError: The file cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix in CONCISE:
        return Header()
    return _header_in(eds.load(path)) if suffix in DEVICE_FILES else ParameterSet.load(path).header


def read(
    path: Path,
    catalogue: Catalogue,
    node_id: int | None = None,
    facts: Mapping[str, int | float | None] | None = None,
    *,
    flagged: bool = False,
) -> ParameterSet:
    """Read a parameter set of any format, chosen by its suffix.

    Values whose scaling is not known stay raw; `facts` adds to the header what the file may not state. With `flagged` values that
    a DCF's ``ObjFlags`` keep out of downloads are taken as well, for a comparison or an upload, which leaves them out itself.

    Raises:
        FileError: The file cannot be read.
        RefusedError: The file is not a concise DCF, or holds no value.
    """
    suffix = path.suffix.lower()
    given = {key: value for key, value in (facts or {}).items() if value is not None}
    own = {"profile": catalogue.profile.label} if catalogue.profile else {}
    if suffix in CONCISE:
        values = _typed(from_concise(read_file(path, "a concise DCF", max_bytes=MAX_BYTES)), catalogue)
        header = Header(**own, **given)  # type: ignore[arg-type]  # by its names
        return _with_header(from_values(catalogue, values, header.scaling_of, undescribed=True), header)
    if suffix not in DEVICE_FILES:
        loaded = ParameterSet.load(path)
        return loaded.model_copy(update={"header": loaded.header.model_copy(update=given)})
    description = eds.load(path, node_id=node_id)
    hidden = [match for line in description.document.lines if (match := _VALUE.fullmatch(line.rstrip("\r\n")))]
    if not description.values and not hidden:
        raise RefusedError(f"{path} holds no parameter values; a DCF has ParameterValue entries, an EDS has none")
    known = Catalogue(catalogue.profile, description if catalogue.description is None else catalogue.description)
    header = _header_in(description).model_copy(update={**own, **given})
    bytes_of = {object_address(match[1]): bytes.fromhex(match[2]) for match in hidden}
    values = {**description.values, **_typed(bytes_of, known)}
    return _with_header(from_values(known, values, header.scaling_of, flagged=flagged), header)


def write(
    path: Path,
    writes: list[Write],
    device_file: Path | None,
    *,
    node_id: int | None = None,
    force: bool = False,
    header: Header | None = None,
) -> list[Write]:
    """Write values as a DCF or a concise DCF, by the suffix.

    A DCF is made from an EDS, of which every other byte stays as it is; the header goes into its commissioning section, for which
    a concise DCF has no place.

    Returns:
        Values that are in comments only, which other tools ignore.

    Raises:
        RefusedError: A DCF lacks its EDS, the suffix is none of the three, the file exists, or it would be too long to be read.
        FileError: A file cannot be read or written.
    """
    if path.suffix.lower() in CONCISE:
        data = to_concise(writes)
        check_size(data)
        write_atomically(path, data, force=force)
        return []
    check_suffix(path)
    if device_file is None:
        raise RefusedError("a DCF is made from the device's EDS; give it with --eds")
    hidden = [each for each in writes if not _stands(each)]
    values = {each.address: _value(each) for each in writes if each not in hidden}
    data = read_file(device_file, "an EDS, DCF or XDD file", max_bytes=MAX_DESCRIPTION_BYTES)
    commissioning, comments = ({}, []) if header is None else _commissioning(header)
    comments += [f"{_OURS} {address_text(each.address)} = ({each.data.hex(' ')})" for each in hidden]
    if comments:
        data = _COMMENT_LINES.sub(b"", data)  # those of an earlier set
    text = eds.loads(data, device_file, node_id=node_id).rewrite(values, commissioning, comments)
    check_size(text)
    write_atomically(path, text, force=force)
    return hidden


def _value(each: Write) -> Value:
    return decode(each.entry.data_type or DataType.DOMAIN, each.data)


def _stands(each: Write) -> bool:
    """Return True if a line can hold the value, unlike empty text."""
    value = _value(each)
    if not isinstance(value, str | bytes):
        return True  # what is wrong with a number is said where it is written
    try:
        text_of(value, each.entry.data_type or DataType.DOMAIN)
    except ValueError:
        return False
    return True


def _commissioning(header: Header) -> tuple[dict[str, str], list[str]]:
    """Return the commissioning section's keys, and comments for values without one."""
    rate = header.bitrate_bit_s
    keys = {
        "NodeID": None if header.node_id is None else str(header.node_id),
        "Baudrate": None if rate is None or rate % 1000 else str(rate // 1000),
        "LSS_SerialNumber": None if header.serial_number is None else f"0x{header.serial_number:X}",
    }
    facts = header.model_dump(exclude_none=True, exclude_defaults=True, exclude=_NOT_IN_COMMENTS)
    comments = [f"{_OURS} {key} = {_ascii(value)}" for key, value in facts.items()]
    return {key: value for key, value in keys.items() if value is not None}, comments


def _ascii(value: Any) -> str:
    """Return a value in TOML's form, in characters that every encoding has."""
    return json.dumps("".join(c for c in value if c <= "\uffff")) if isinstance(value, str) else toml_value(value)


def _header_in(description: eds.Description) -> Header:
    lines = [match for line in description.document.lines if (match := _COMMENT.fullmatch(line.rstrip("\r\n")))]
    said = loads("\n".join(f"{match[1]} = {match[2]}" for match in lines), Header, description.path)
    native = {
        "title": said.title or description.product_name,
        "vendor_id": said.vendor_id or description.vendor_id or None,
        "product_code": said.product_code or description.product_code or None,
        "node_id": description.own_node_id,
        "serial_number": description.serial_number,
        "bitrate_bit_s": description.bitrate_bit_s,
    }
    return said.model_copy(update=native)


def _with_header(loaded: ParameterSet, header: Header) -> ParameterSet:
    return loaded.model_copy(update={"header": header.model_copy(update={"not_read": loaded.header.not_read})})


def _typed(values: Mapping[ObjectAddress, bytes], catalogue: Catalogue) -> dict[ObjectAddress, Value]:
    typed: dict[ObjectAddress, Value] = {}
    for address, data in values.items():
        entry = catalogue.get(address)
        data_type = (entry.data_type or type_of_length(len(data))) if entry else DataType.DOMAIN
        if data_type.size not in {None, len(data)}:
            raise RefusedError(f"{entry} is {data_type.name} with {data_type.size} bytes, but the file has {len(data)}")
        typed[address] = decode(data_type, data)
    return typed


def to_concise(writes: Collection[Write]) -> bytes:
    """Write a concise DCF, the value of 1F22h.

    It holds a count, then index, sub-index, length and bytes of each object (CiA 302-3, 1F22h).

    It is sent entry by entry, so PDOs whose COB-ID is in the set are made invalid first and valid last.
    """
    goal = {write.address: write.data for write in writes}
    # as if the device held something else everywhere, and every PDO were valid
    held = {address: data + b"\0" for address, data in goal.items()}
    held |= {address: b"\1" for address in goal if address[1] == 0 and pdo_of(address) is not None}
    held |= {
        address: data[:3] + bytes((data[3] & 0x7F,))
        for address, data in goal.items()
        if address[1] == 1 and pdo_of(address) == address[0] and len(data) == 4
    }
    whole = {address for address in goal if support([address]) <= set(goal)}
    order = steps({address: goal[address] for address in goal if address in whole}, held)
    order += [(address, data) for address, data in goal.items() if address not in whole]
    entries = [struct.pack("<HBI", *address, len(data)) + data for address, data in order]
    return struct.pack("<I", len(entries)) + b"".join(entries)


def from_concise(data: bytes) -> dict[ObjectAddress, bytes]:
    """Read a concise DCF into the bytes of each object.

    If it writes an object several times, the last bytes count.

    Raises:
        RefusedError: The data are too short, or go on after the end.
    """
    if len(data) < 4:
        raise RefusedError(f"a concise DCF begins with a count of 4 bytes, but the file has only {len(data)} bytes")
    count, position = struct.unpack_from("<I", data)[0], 4
    contents: dict[ObjectAddress, bytes] = {}
    for number in range(1, count + 1):
        if position + 7 > len(data):
            raise RefusedError(f"entry {number} of {count} of the concise DCF is cut off at byte {len(data)}")
        index, subindex, length = struct.unpack_from("<HBI", data, position)
        position += 7
        if position + length > len(data):
            raise RefusedError(
                f"entry {number}, {index:04X}:{subindex:X}, states {length} bytes, but only {len(data) - position} are left"
            )
        contents[index, subindex] = data[position : position + length]
        position += length
    if position != len(data):
        raise RefusedError(f"{len(data) - position} bytes follow the last of {count} entries of the concise DCF; expected none")
    return contents
