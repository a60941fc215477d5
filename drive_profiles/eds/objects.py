"""canopen's dictionary, built from the sections of a file.

canopen's own reader stops at the first fault of a file, or reads ``0xFD`` in an INTEGER8 as 253. Here an object that cannot be
read is left out and named; the others stay.

Source: CiA 306-1 (objects, ``CompactSubObj``).
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from canopen.objectdictionary import ObjectDictionary, ODArray, ODRecord, ODVariable

from drive_profiles.eds import values
from drive_profiles.eds.text import EdsEntry, EdsSection, Findings, quoted
from drive_profiles.eds.variables import DOMAIN_OBJECT, VariableReader, assign, made_variable

VAR, ARRAY, RECORD = 0x7, 0x8, 0x9
_TYPE_OBJECTS = {0x5, 0x6}  # DEFTYPE, DEFSTRUCT: they describe types and cannot be accessed
_FIRST_OBJECT = 0x1000
MAX_VARIABLES = 65_536
"""Entries of one dictionary, compact notations written out."""
_NAME = re.compile(r"([0-9A-F]{4})(?:sub([0-9A-F]+)|(name|value|denotation))?")


@dataclass(slots=True)
class ObjectSections:
    """The sections that belong to one index."""

    index: int
    head: EdsSection | None = None
    subs: dict[int, EdsSection] = field(default_factory=dict)
    lists: dict[str, EdsSection] = field(default_factory=dict)
    """Lists of a compact notation by their names: ``name``, ``value``, ``denotation``."""


def parts_of(sections: dict[str, EdsSection], findings: Findings) -> dict[int, ObjectSections]:
    """Collect the sections of each object, by index; other sections are skipped."""
    parts: dict[int, ObjectSections] = {}
    for identity, section in sections.items():
        match = _NAME.fullmatch(identity)
        if match is None:
            continue
        number, subindex, suffix = match.groups()
        index = int(number, 16)
        mine = parts.setdefault(index, ObjectSections(index))
        if suffix is not None:
            mine.lists[suffix] = section
        elif subindex is None:
            mine.head = section
        elif int(subindex, 16) > 0xFF:
            findings.refuse(section.line, section.name, "", "sub-index above FFh; left out", "a sub-index from 0 to FF")
        else:
            mine.subs[int(subindex, 16)] = section
    return parts


class Builder(VariableReader):
    """Builder of canopen's dictionary from the sections of a file.

    Attributes:
        sections: The section of every variable that has one, by index and sub-index.
        compact: The sections of every object with a compact notation, by index.
    """

    def __init__(self, findings: Findings, node_id: int | None) -> None:
        super().__init__(findings, node_id)
        self.dictionary: ObjectDictionary = ObjectDictionary()  # type: ignore[no-untyped-call]  # canopen leaves it so
        self.sections: dict[tuple[int, int], EdsSection] = {}
        self.compact: dict[int, ObjectSections] = {}
        self._count = 0

    def build(self, parts: dict[int, ObjectSections]) -> None:
        """Build all objects."""
        for index in sorted(parts):
            if index < _FIRST_OBJECT:
                self._note_type(parts[index])
        for index in sorted(parts):
            if index >= _FIRST_OBJECT:
                self._object(parts[index])

    def add(self, item: ODVariable | ODRecord | ODArray) -> None:
        """Add an object to the dictionary."""
        self._count += 1 if isinstance(item, ODVariable) else len(item.subindices)
        self.dictionary.add_object(item)

    def has_room(self, section: EdsSection, size: int) -> bool:
        """Return True if `size` more entries fit; otherwise note the refusal."""
        if self._count + size <= MAX_VARIABLES:
            return True
        self.findings.refuse(section.line, section.name, "", "too many entries; left out", f"at most {MAX_VARIABLES}")
        return False

    def _note_type(self, parts: ObjectSections) -> None:
        """Note the type, or its length in bits, behind a type definition."""
        if parts.head is None:
            return
        object_code = self.number(parts.head, "ObjectType")
        source = parts.head if object_code in _TYPE_OBJECTS else parts.subs.get(1)
        default = source.get("DefaultValue") if source is not None else None
        reading = values.number(default.value) if default is not None else values.ValueReading(None)
        if object_code not in _TYPE_OBJECTS and isinstance(reading.value, int) and reading.value in values.NAMES:
            self.types[parts.index] = reading.value  # an editor's way to give a type limits: sub-index 1 names the real one
        elif object_code in _TYPE_OBJECTS:
            widths = {width: data_type for data_type, width in values.UNSIGNED.items()}
            self.types[parts.index] = widths.get(reading.value if isinstance(reading.value, int) else 0, values.DOMAIN)
        else:
            line, name = parts.head.line, parts.head.name
            self.findings.refuse(line, name, "", "below 1000h there are only data types; left out", "an index from 1000 to FFFF")

    def _object(self, parts: ObjectSections) -> None:
        head = parts.head
        if head is None:
            if not parts.subs and not parts.lists:
                return  # its one section has been refused
            line, name = _first(parts)
            if not parts.subs:
                self.findings.refuse(line, name, "", f"no section [{parts.index:04X}] to which it belongs; left out", "one")
                return
            self.findings.warn(line, name, "", f"no section [{parts.index:04X}] above it; a record is assumed", "one")
            head = EdsSection(f"{parts.index:04X}", line)
            head.entries["parametername"] = EdsEntry("ParameterName", head.name, line)
            self._compound(ODRecord(head.name, parts.index), head, parts)
            return
        object_code = self._object_code(head, parts)
        if object_code in {VAR, DOMAIN_OBJECT}:
            self._single(head, parts)
        elif object_code in {ARRAY, RECORD}:
            container = ODArray if object_code == ARRAY else ODRecord
            self._compound(container(self.name(head, head.name), parts.index), head, parts)

    def _object_code(self, head: EdsSection, parts: ObjectSections) -> int | None:
        """Return the object code (CiA 301); None if it cannot be accessed."""
        entry = head.get("ObjectType")
        object_code = self.number(head, "ObjectType")
        if object_code in _TYPE_OBJECTS or object_code == 0:
            self.findings.refuse(
                head.line, head.name, "ObjectType", f"{object_code} is not an object that holds a value; left out", "2, 7, 8 or 9"
            )
            return None
        looks_compound = bool(parts.subs) and head.get("DataType") is None
        if object_code in {ARRAY, RECORD} or (object_code in {VAR, DOMAIN_OBJECT} and not looks_compound):
            return object_code
        if object_code is None and entry is None and not looks_compound:
            return VAR  # CiA 306-1: a missing ObjectType means 7
        made = RECORD if parts.subs or head.get("SubNumber") else VAR
        seen = "missing, but there are sub-objects" if entry is None else f"{quoted(entry.value)} does not fit"
        word = "RECORD" if made == RECORD else "VAR"
        line = head.line if entry is None else entry.line
        self.findings.warn(line, head.name, "ObjectType", f"{seen}; taken as {word}", "7 (VAR), 8 (ARRAY) or 9 (RECORD)")
        return made

    def _single(self, head: EdsSection, parts: ObjectSections) -> None:
        if not self.has_room(head, 1):
            return
        variable = self.variable(head, parts.index, 0)
        self.add(variable)
        self.sections[parts.index, 0] = head
        self.parameter_value(variable, head, head.get("ParameterValue"))
        for section in (*parts.subs.values(), *parts.lists.values()):
            self.findings.refuse(
                section.line, section.name, "", f"[{head.name}] is a VAR; left out", "an ARRAY or RECORD above it"
            )

    def _compound(self, item: ODRecord | ODArray, head: EdsSection, parts: ObjectSections) -> None:
        count = self._compact_count(head)
        if not self.has_room(head, len(parts.subs) + count):
            return
        assign(item, storage_location=head.text("StorageLocation") or None)
        if count:
            self._compact(item, head, parts, count)
        for subindex in sorted(parts.subs):
            section = parts.subs[subindex]
            variable = self.variable(section, parts.index, subindex)
            item.add_member(variable)
            self.sections[parts.index, subindex] = section
            self.parameter_value(variable, section, section.get("ParameterValue"))
        if not count:
            self._check_compound(item, head, parts)
        self.add_flags(head, parts.index, *item.subindices)
        self.add(item)

    def _check_compound(self, item: ODRecord | ODArray, head: EdsSection, parts: ObjectSections) -> None:
        """Warn where the head of an object contradicts its sub-objects."""
        for section in parts.lists.values():
            self.findings.warn(
                section.line, section.name, "", f"ignored: [{head.name}] has no CompactSubObj", "CompactSubObj above it"
            )
        for key in ("DataType", "DefaultValue", "ParameterValue"):
            entry = head.get(key)
            if entry is not None:
                self.remark(head, entry, "ignored: it belongs to the sub-objects", f"no {key} in the head of an ARRAY or RECORD")
        found = len(item.subindices)
        entry = head.get("SubNumber")
        said = self.number(head, "SubNumber")
        if entry is None:
            self.findings.warn(head.line, head.name, "SubNumber", f"missing; there are {found} sub-objects", "their number")
        elif said != found:
            self.remark(head, entry, f"wrong: there are {found} sub-objects", str(found))
        if 0 not in item.subindices and found:
            self.findings.warn(head.line, head.name, "", "no sub-index 0", f"[{head.name}sub0], the number of entries")

    def _compact_count(self, head: EdsSection) -> int:
        """Return the number of entries in a compact notation, else 0."""
        entry = head.get("CompactSubObj")
        if entry is None:
            return 0
        count = self.number(head, "CompactSubObj") or 0
        if 0 <= count <= 0xFE:
            return count
        self.remark(head, entry, "out of range; ignored", "0 to 254")
        return 0

    def _compact(self, item: ODRecord | ODArray, head: EdsSection, parts: ObjectSections, count: int) -> None:
        """Build an array of like entries from a compact notation."""
        item.add_member(made_variable("NrOfObjects", item.index, 0, 0x05, "ro", count))  # as in CiA 306-1
        template = self.variable(head, item.index, 1)
        names = self._numbered(parts.lists.get("name"), count)
        contents = self._numbered(parts.lists.get("value"), count)
        for subindex in range(1, count + 1):
            member = ODVariable("", item.index, subindex)
            member.__dict__.update(template.__dict__)
            member.subindex = subindex
            member.name = f"{item.name}{subindex}"
            if subindex in names and names[subindex].value:
                member.name = self.text(parts.lists["name"], names[subindex].key)
            item.add_member(member)
            if subindex in contents:
                self.parameter_value(member, parts.lists["value"], contents[subindex])
        self.compact[item.index] = parts

    def _numbered(self, section: EdsSection | None, count: int) -> dict[int, EdsEntry]:
        """Return entries 1 to `count` of a compact notation's list."""
        found: dict[int, EdsEntry] = {}
        if section is None:
            return found
        for key, entry in section.entries.items():
            if key.isascii() and key.isdigit() and len(key) <= 3 and 1 <= int(key) <= count:
                found[int(key)] = entry
            elif key != "nrofentries":
                self.remark(section, entry, "ignored", f"a number from 1 to {count}")
        said = self.number(section, "NrOfEntries")
        if said != len(found):
            line = section.line if "nrofentries" not in section.entries else section.entries["nrofentries"].line
            message = f"{'missing' if said is None else said}; there are {len(found)}"
            self.findings.warn(line, section.name, "NrOfEntries", message, str(len(found)))
        return found


def _first(parts: ObjectSections) -> tuple[int, str]:
    sections: Iterable[EdsSection] = (*parts.subs.values(), *parts.lists.values())
    first = min(sections, key=lambda section: section.line)
    return first.line, first.name
