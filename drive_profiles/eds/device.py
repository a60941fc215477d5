"""Parts of a description other than its objects.

Source: CiA 306-1 (file and device information).
"""

import re

from canopen.objectdictionary import ObjectDictionary, ODRecord

from drive_profiles.address import BIT_RATES
from drive_profiles.eds import values
from drive_profiles.eds.objects import Builder, ObjectSections
from drive_profiles.eds.text import EdsEntry, EdsSection, Findings, quoted
from drive_profiles.eds.variables import assign, made_variable
from drive_profiles.standard.cia301 import MAX_NODE_ID, RPDO_BASES, TPDO_BASES

BIT_RATES_KBIT_S = tuple(rate // 1000 for rate in BIT_RATES)
COMMISSIONING = ("devicecomissioning", "devicecommissioning")
"""Both spellings of the section: the standard has one m, many writers of files have two."""
DEVICE_COMMISSIONING = "DeviceComissioning"
"""Name of that section where it is written: the standard's."""
LISTS = {
    "mandatoryobjects": "MandatoryObjects",
    "optionalobjects": "OptionalObjects",
    "manufacturerobjects": "ManufacturerObjects",
}
_TEXTS = {"VendorName": "vendor_name", "ProductName": "product_name", "OrderCode": "order_code"}
_NUMBERS = {
    "VendorNumber": "vendor_number",
    "ProductNumber": "product_number",
    "RevisionNumber": "revision_number",
    "Granularity": "granularity",
    "NrOfRXPDO": "nr_of_RXPDO",
    "NrOfTXPDO": "nr_of_TXPDO",
}
_FLAGS = {
    "SimpleBootUpMaster": "simple_boot_up_master",
    "SimpleBootUpSlave": "simple_boot_up_slave",
    "DynamicChannelsSupported": "dynamic_channels_supported",
    "GroupMessaging": "group_messaging",
    "LSS_Supported": "LSS_supported",
}
_MODULAR = re.compile(r"m\d+(?:moduleinfo|fixedobjects|subextends|subext[0-9a-f]*|comments)|supportedmodules|connectedmodules")
MAX_UNSIGNED32 = 0xFFFF_FFFF
_SUB_OBJECTS = ("COB-ID", "Transmission type", "Inhibit time", "Compatibility entry", "Event timer", "SYNC start value")
_MAX_PDOS = 512


def read_device_info(section: EdsSection | None, builder: Builder) -> None:
    """Copy identity and features into canopen's form; an empty number means unknown."""
    if section is None:
        return
    information = builder.dictionary.device_information
    for key, attribute in _TEXTS.items():
        if key.lower() in section.entries:
            setattr(information, attribute, builder.text(section, key))
    for key, attribute in _NUMBERS.items():
        number = _unsigned32(section, key, builder)
        if number is not None:
            setattr(information, attribute, number)
    for key, attribute in _FLAGS.items():
        number = builder.number(section, key)
        if number is not None:
            setattr(information, attribute, bool(number) if key != "DynamicChannelsSupported" else number)
    for rate in BIT_RATES_KBIT_S:
        if builder.number(section, f"BaudRate_{rate}"):
            information.allowed_baudrates.add(rate * 1000)


def read_commissioning(sections: dict[str, EdsSection], builder: Builder) -> tuple[int | None, int | None]:
    """Return node-ID and bit rate (bit/s) of a DCF; 0 means unknown."""
    node_id = bit_rate = None
    for identity in COMMISSIONING:
        section = sections.get(identity)
        if section is None:
            continue
        node_id = node_id or _node_id(section, builder)
        bit_rate = bit_rate or _bit_rate(section, builder)
    return node_id, bit_rate


def read_serial_number(sections: dict[str, EdsSection], builder: Builder) -> int | None:
    """Return ``LSS_SerialNumber`` of a DCF; 0 in the file means unknown."""
    found = (_unsigned32(sections[each], "LSS_SerialNumber", builder) for each in COMMISSIONING if each in sections)
    return next((number for number in found if number), None)


def read_dummies(section: EdsSection | None, builder: Builder) -> None:
    """Add the dummy data types that fill gaps in an RPDO."""
    for key, entry in section.entries.items() if section is not None else ():
        match = re.fullmatch(r"dummy([0-9a-f]{4})", key)
        if match is None or section is None:
            continue
        data_type = int(match.group(1), 16)
        if builder.number(section, entry.key, values.flag) and data_type in values.NAMES:
            builder.add(made_variable(f"Dummy{data_type:04X}", data_type, 0, data_type, "const"))


def read_comments(section: EdsSection | None, builder: Builder) -> None:
    """Join the lines of the comment; a missing line costs a warning."""
    if section is None:
        return
    found: dict[int, str] = {}
    for key, entry in section.entries.items():
        match = re.fullmatch(r"line(\d{1,6})", key)
        if match is not None:
            found[int(match.group(1))] = entry.value
    said = builder.number(section, "Lines")
    if said is not None and said != len(found):
        entry = section.entries["lines"]
        builder.findings.warn(entry.line, section.name, entry.key, f"{said}; there are {len(found)} lines", str(len(found)))
    builder.dictionary.comments = "\n".join(found[number] for number in sorted(found))


def check_lists(sections: dict[str, EdsSection], parts: dict[int, ObjectSections], findings: Findings) -> None:
    """Compare the lists of objects with the sections; the sections count."""
    listed: dict[int, tuple[EdsSection, EdsEntry]] = {}
    present = [identity for identity in LISTS if identity in sections]
    for identity in present:
        _read_list(sections[identity], listed, findings)
    if not present:
        findings.warn(0, "", "", "has none of the lists of objects; all sections of objects are read", "[MandatoryObjects] …")
        return
    for index, (section, entry) in listed.items():
        if index not in parts:
            findings.remark(section, entry, "has no section; there is no such object", f"a section [{index:04X}]")
    for index, mine in parts.items():
        if index >= 0x1000 and index not in listed and mine.head is not None:
            findings.warn(
                mine.head.line, mine.head.name, "", "not in any list of objects; read anyway", "its index in one of the lists"
            )


def note_modules(sections: dict[str, EdsSection], findings: Findings) -> None:
    """Warn once that the modules of a modular device are passed over."""
    modular = [section for identity, section in sections.items() if _MODULAR.fullmatch(identity)]
    if modular:
        message = f"a modular device: {len(modular)} sections of modules ignored"
        findings.warn(modular[0].line, modular[0].name, "", message, "the objects of the device itself")


def add_compact_pdos(section: EdsSection | None, builder: Builder) -> None:
    """Add the PDO objects that ``CompactPDO`` abbreviates, unless they have sections."""
    mask = builder.number(section, "CompactPDO") if section is not None and section.get("CompactPDO") else None
    if not mask or section is None:
        return
    information = builder.dictionary.device_information
    for first, count, bases in ((0x1400, information.nr_of_RXPDO, RPDO_BASES), (0x1800, information.nr_of_TXPDO, TPDO_BASES)):
        there = sum(index in builder.dictionary.indices for index in range(first, first + _MAX_PDOS))
        missing = min(int(count or 0), _MAX_PDOS) - there
        for number in range(_MAX_PDOS):
            if missing <= 0:
                break
            if first + number in builder.dictionary.indices:
                continue
            if not builder.has_room(section, 2 + mask.bit_count() + 0x40):
                return
            missing -= 1
            base = bases[number] if number < len(bases) else None
            builder.add(_communication(first + number, mask, base, builder.node_id))
            if first + 0x200 + number not in builder.dictionary.indices:
                builder.add(_mapping(first + 0x200 + number))


def _communication(index: int, mask: int, base: int | None, node_id: int | None) -> ODRecord:
    """Return a PDO's communication record with the sub-indices in `mask`."""
    record = ODRecord(f"{'RPDO' if index < 0x1800 else 'TPDO'} {(index & 0x1FF) + 1} communication parameter", index)
    highest = max(subindex for subindex in range(1, 7) if mask >> (subindex - 1) & 1) if mask & 0x3F else 0
    record.add_member(made_variable("Highest sub-index supported", index, 0, 0x05, "const", highest))
    for subindex, (name, data_type) in enumerate(zip(_SUB_OBJECTS, (0x07, 0x05, 0x06, 0x05, 0x06, 0x05), strict=True), 1):
        if not mask >> (subindex - 1) & 1:
            continue
        member = made_variable(name, index, subindex, data_type, "rw")
        if subindex == 1:
            member.relative = base is not None
            raw = "0x80000000" if base is None else f"$NODEID+0x{base:X}"
            assign(member, default=0x8000_0000 if base is None else base + (node_id or 0), default_raw=raw)
        record.add_member(member)
    return record


def _mapping(index: int) -> ODRecord:
    record = ODRecord(f"{'RPDO' if index < 0x1A00 else 'TPDO'} {(index & 0x1FF) + 1} mapping parameter", index)
    record.add_member(made_variable("Number of mapped objects", index, 0, 0x05, "rw", 0))
    for subindex in range(1, 0x41):
        record.add_member(made_variable(f"Mapped object {subindex}", index, subindex, 0x07, "rw"))
    return record


def _unsigned32(section: EdsSection, key: str, builder: Builder) -> int | None:
    entry = section.entries.get(key.lower())
    if entry is None:
        return None
    if not entry.value:
        if key in {"VendorNumber", "ProductNumber", "RevisionNumber"}:
            builder.findings.warn(entry.line, section.name, entry.key, "empty; read as unknown", "a whole number")
        return None
    number = builder.number(section, key)
    if number is None or 0 <= number <= MAX_UNSIGNED32:
        return number
    if -(1 << 31) <= number < 0:
        made, result = f"read as 0x{number & MAX_UNSIGNED32:08X}", number & MAX_UNSIGNED32
    else:
        made, result = "taken as unknown", None
    builder.findings.remark(section, entry, made, "0 to 0xFFFFFFFF")
    return result


def _node_id(section: EdsSection, builder: Builder) -> int | None:
    entry = section.get("NodeID")
    number = builder.number(section, "NodeID")
    if entry is None or not number:
        return None
    if 1 <= number <= MAX_NODE_ID:
        return number
    builder.findings.warn(
        entry.line, section.name, entry.key, f"{number} is not a node-ID; read as unknown", f"1 to {MAX_NODE_ID}"
    )
    return None


def _bit_rate(section: EdsSection, builder: Builder) -> int | None:
    entry = section.get("Baudrate")
    number = builder.number(section, "Baudrate")
    if entry is None or not number:
        return None
    if number in BIT_RATES_KBIT_S:
        return number * 1000
    in_bits = number % 1000 == 0 and number // 1000 in BIT_RATES_KBIT_S
    made = "read as bit/s" if in_bits else "taken as unknown"
    builder.findings.warn(
        entry.line, section.name, entry.key, f"{number} {made}", "10, 20, 50, 125, 250, 500, 800 or 1000 (kbit/s)"
    )
    return number if in_bits else None


def _read_list(section: EdsSection, listed: dict[int, tuple[EdsSection, EdsEntry]], findings: Findings) -> None:
    entries = [entry for key, entry in section.entries.items() if key != "supportedobjects"]
    numbered = 0
    for entry in (*entries, *(entry for entry in section.repeated if entry.key.isdigit())):
        if not (entry.key.isascii() and entry.key.isdigit()):
            continue
        numbered += 1
        reading = values.number(entry.value)
        index = reading.value
        if not isinstance(index, int) or not 0x1000 <= index <= 0xFFFF:
            findings.remark(section, entry, "is not an index; ignored", "0x1000 to 0xFFFF")
            continue
        if index in listed:
            findings.remark(section, entry, f"listed already, line {listed[index][1].line}", "each object once")
        listed.setdefault(index, (section, entry))
    said_entry = section.get("SupportedObjects")
    said = values.number(said_entry.value).value if said_entry is not None else None
    if said != numbered:
        line = section.line if said_entry is None else said_entry.line
        seen = "missing" if said_entry is None else quoted(said_entry.value)
        findings.warn(line, section.name, "SupportedObjects", f"{seen}; {numbered} objects are listed", str(numbered))


def file_info(section: EdsSection | None, dictionary: ObjectDictionary) -> None:
    """Put ``[FileInfo]`` where canopen's writer looks for it."""
    if section is not None:
        dictionary.__dict__["__edsFileInfo"] = {entry.key: entry.value for entry in section.entries.values()}
