"""Contradictions of a description with itself or the standard.

Nothing is repaired, because only the device knows which side is right.

Source: CiA 301, version 4.2.0 (7.4.1, sub-index 0; 7.5.1, mandatory objects); CiA 306-1 (device information).
"""

from canopen.objectdictionary import ODArray, ODRecord

from drive_profiles.eds import values
from drive_profiles.eds.device import MAX_UNSIGNED32
from drive_profiles.eds.objects import Builder
from drive_profiles.eds.text import EdsSection, quoted
from drive_profiles.errors import Problem
from drive_profiles.standard.shown import MAPPINGS

_IDENTITY = {"VendorNumber": 1, "ProductNumber": 2, "RevisionNumber": 3}
"""Sub-index in 1018h of each number in [DeviceInfo]."""
_MANDATORY = {0x1000: "device type", 0x1001: "error register", 0x1018: "identity"}
_HISTORY = 0x1003
_PDOS = {"NrOfRXPDO": range(0x1400, 0x1600), "NrOfTXPDO": range(0x1800, 0x1A00)}
_UNSIGNED8 = 0x05
_STRUCTURE = 0xFF
"""Sub-index that describes the structure of an object, and is not counted (CiA 301, 7.4.1)."""


def found(sections: dict[str, EdsSection], builder: Builder) -> list[Problem]:
    """List the contradictions of a file that has been read."""
    information = sections.get("deviceinfo")
    problems = [*_identity(information, builder), *_pdo_counts(information, builder), *_missing(builder)]
    for item in builder.dictionary.indices.values():
        if isinstance(item, ODArray | ODRecord) and item.index >= min(_MANDATORY):
            problems += _entry_count(item, builder)
    return problems


def _identity(information: EdsSection | None, builder: Builder) -> list[Problem]:
    """Compare [DeviceInfo] with the defaults of 1018h; 0 means unknown."""
    item = builder.dictionary.indices.get(0x1018)
    if information is None or not isinstance(item, ODArray | ODRecord):
        return []
    problems = []
    device = builder.dictionary.device_information
    stated = dict(zip(_IDENTITY, (device.vendor_number, device.product_number, device.revision_number), strict=True))
    for key, subindex in _IDENTITY.items():
        entry = information.get(key)
        default = item.subindices[subindex].default if subindex in item.subindices else None
        number = default & MAX_UNSIGNED32 if isinstance(default, int) else 0
        if entry is not None and stated[key] and number and number != stated[key]:
            message = f"0x{stated[key]:X}, but the default of 1018:{subindex} is 0x{number:X}"
            problems.append(Problem(entry.line, f"[{information.name}] {entry.key}", message, "the same number in both"))
    return problems


def _pdo_counts(information: EdsSection | None, builder: Builder) -> list[Problem]:
    problems = []
    for key, indices in _PDOS.items():
        entry = information.get(key) if information is not None else None
        reading = values.number(entry.value) if entry is not None else values.ValueReading(None)
        there = sum(index in builder.dictionary.indices for index in indices)
        if information is not None and entry is not None and isinstance(reading.value, int) and reading.value != there:
            message = f"{reading.value}, but {there} have communication parameters, {indices[0]:04X}h and above"
            problems.append(Problem(entry.line, f"[{information.name}] {entry.key}", message, str(there)))
    return problems


def _missing(builder: Builder) -> list[Problem]:
    return [
        Problem(0, f"[{index:04X}]", f"missing: the {name} is mandatory for every CANopen device", f"an object {index:04X}h")
        for index, name in _MANDATORY.items()
        if index not in builder.dictionary.indices
    ]


def _entry_count(item: ODArray | ODRecord, builder: Builder) -> list[Problem]:
    """Check type and value of sub-index 0 against the existing sub-indices."""
    count = item.subindices.get(0)
    section = builder.sections.get((item.index, 0))
    if count is None or section is None:
        return []
    where = f"[{section.name}]"
    if count.data_type != _UNSIGNED8:
        name = values.NAMES.get(count.data_type or 0, "of an unknown type")
        return [Problem(section.line, f"{where} DataType", f"sub-index 0 is {name}", "UNSIGNED8, the number of entries")]
    highest = max((each for each in item.subindices if each != _STRUCTURE), default=0)
    entry = section.get("DefaultValue")
    said = count.default
    if entry is None or not isinstance(said, int) or said == highest:
        return []
    varies = item.index == _HISTORY or any(item.index in mappings for mappings in MAPPINGS)
    varies = varies or (isinstance(item, ODArray) and count.access_type not in {"ro", "const"})
    if said < highest and varies:
        return []  # how many are in use, of those that there are
    message = f"{quoted(entry.value)}, but the highest sub-index described is {highest}"
    return [Problem(entry.line, f"{where} {entry.key}", message, str(highest))]
