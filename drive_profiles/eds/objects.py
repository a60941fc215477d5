"""The objects of a description: canopen's dictionary from the sections that name them.

Built here and not by canopen's reader, which stops at the first fault of a file, or reads ``0xFD`` in an INTEGER8 as 253. An
object that cannot be read is left out and named; the others stay.

Source: CiA 306-1 (objects, ``CompactSubObj``).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from canopen.objectdictionary import ObjectDictionary, ODArray, ODRecord, ODVariable

from drive_profiles.eds import values
from drive_profiles.eds.text import Entry, Findings, Section, quoted
from drive_profiles.eds.variables import DOMAIN_OBJECT, VariableReader, assign

VAR, ARRAY, RECORD = 0x7, 0x8, 0x9
_TYPE_OBJECTS = {0x5, 0x6}  # DEFTYPE, DEFSTRUCT: they describe types and cannot be accessed
_FIRST_OBJECT = 0x1000
MAX_VARIABLES = 65_536
"""Entries of one dictionary, compact notations written out."""
_NAME = re.compile(r"([0-9A-F]{4})(?:sub([0-9A-F]+)|(name|value|denotation))?")


@dataclass(slots=True)
class Parts:
    """The sections that belong to one index."""

    index: int
    head: Section | None = None
    subs: dict[int, Section] = field(default_factory=dict)
    lists: dict[str, Section] = field(default_factory=dict)
    """Of a compact notation: name, value, denotation."""


def parts_of(sections: dict[str, Section], findings: Findings) -> dict[int, Parts]:
    """Sort the sections of objects by index; those that are none are passed over."""
    parts: dict[int, Parts] = {}
    for identity, section in sections.items():
        match = _NAME.fullmatch(identity)
        if match is None:
            continue
        number, subindex, kind = match.groups()
        index = int(number, 16)
        mine = parts.setdefault(index, Parts(index))
        if kind is not None:
            mine.lists[kind] = section
        elif subindex is None:
            mine.head = section
        elif int(subindex, 16) > 0xFF:
            findings.refuse(section.line, section.name, "", "sub-index above FFh; left out", "a sub-index from 0 to FF")
        else:
            mine.subs[int(subindex, 16)] = section
    return parts


class Builder(VariableReader):
    """Makes the dictionary out of the parts.

    Args:
        findings: Where repairs and refusals go.
        node_id: For ``$NODEID``; None if nobody knows it.

    Attributes:
        dictionary: What has been built.
        sections: The section of every variable that has one of its own.
        compact: The parts of every object with a compact notation.
    """

    def __init__(self, findings: Findings, node_id: int | None) -> None:
        super().__init__(findings, node_id)
        self.dictionary: ObjectDictionary = ObjectDictionary()  # type: ignore[no-untyped-call]  # canopen leaves it so
        self.sections: dict[tuple[int, int], Section] = {}
        self.compact: dict[int, Parts] = {}
        self._count = 0

    def build(self, parts: dict[int, Parts]) -> None:
        """Add all objects."""
        for index in sorted(parts):
            if index < _FIRST_OBJECT:
                self._note_type(parts[index])
        for index in sorted(parts):
            if index >= _FIRST_OBJECT:
                self._object(parts[index])

    def add(self, item: ODVariable | ODRecord | ODArray) -> None:
        """Take an object into the dictionary."""
        self._count += 1 if isinstance(item, ODVariable) else len(item.subindices)
        self.dictionary.add_object(item)

    def has_room(self, section: Section, size: int) -> bool:
        """Tell whether so many more entries may be added, and note the refusal if not."""
        if self._count + size <= MAX_VARIABLES:
            return True
        self.findings.refuse(section.line, section.name, "", "too many entries; left out", f"at most {MAX_VARIABLES}")
        return False

    def _note_type(self, parts: Parts) -> None:
        """Keep what a type definition says of the type below it: its length in bits, or the type that it is made of."""
        if parts.head is None:
            return
        kind = self.number(parts.head, "ObjectType")
        source = parts.head if kind in _TYPE_OBJECTS else parts.subs.get(1)
        default = source.get("DefaultValue") if source is not None else None
        reading = values.number(default.value) if default is not None else values.Reading(None)
        if kind not in _TYPE_OBJECTS and isinstance(reading.value, int) and reading.value in values.NAMES:
            self.types[parts.index] = reading.value  # an editor's way to give a type limits: sub-index 1 names the real one
        elif kind in _TYPE_OBJECTS:
            widths = {width: data_type for data_type, width in values.UNSIGNED.items()}
            self.types[parts.index] = widths.get(reading.value if isinstance(reading.value, int) else 0, values.DOMAIN)
        else:
            line, name = parts.head.line, parts.head.name
            self.findings.refuse(line, name, "", "below 1000h there are only data types; left out", "an index from 1000 to FFFF")

    def _object(self, parts: Parts) -> None:
        head = parts.head
        if head is None:
            if not parts.subs and not parts.lists:
                return  # its one section has been refused
            line, name = _first(parts)
            if not parts.subs:
                self.findings.refuse(line, name, "", f"no section [{parts.index:04X}] to which it belongs; left out", "one")
                return
            self.findings.warn(line, name, "", f"no section [{parts.index:04X}] above it; a record is made up", "one")
            head = Section(f"{parts.index:04X}", line)
            head.entries["parametername"] = Entry("ParameterName", head.name, line)
            self._compound(ODRecord(head.name, parts.index), head, parts)
            return
        kind = self._kind(head, parts)
        if kind in {VAR, DOMAIN_OBJECT}:
            self._single(head, parts)
        elif kind in {ARRAY, RECORD}:
            container = ODArray if kind == ARRAY else ODRecord
            self._compound(container(self.name(head, head.name), parts.index), head, parts)

    def _kind(self, head: Section, parts: Parts) -> int | None:
        """What kind of object it is; None if it is none that can be accessed."""
        entry = head.get("ObjectType")
        kind = self.number(head, "ObjectType")
        if kind in _TYPE_OBJECTS or kind == 0:
            self.findings.refuse(
                head.line, head.name, "ObjectType", f"{kind} is no object that holds a value; left out", "2, 7, 8 or 9"
            )
            return None
        looks_compound = bool(parts.subs) and head.get("DataType") is None
        if kind in {ARRAY, RECORD} or (kind in {VAR, DOMAIN_OBJECT} and not looks_compound):
            return kind
        if kind is None and entry is None and not looks_compound:
            return VAR  # CiA 306-1: a missing ObjectType means 7
        made = RECORD if parts.subs or head.get("SubNumber") else VAR
        seen = "missing, but there are sub-objects" if entry is None else f"{quoted(entry.value)} does not fit"
        word = "RECORD" if made == RECORD else "VAR"
        line = head.line if entry is None else entry.line
        self.findings.warn(line, head.name, "ObjectType", f"{seen}; taken as {word}", "7 (VAR), 8 (ARRAY) or 9 (RECORD)")
        return made

    def _single(self, head: Section, parts: Parts) -> None:
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

    def _compound(self, item: ODRecord | ODArray, head: Section, parts: Parts) -> None:
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
        self.add(item)

    def _check_compound(self, item: ODRecord | ODArray, head: Section, parts: Parts) -> None:
        """Warn of what a head says that its sub-objects do not."""
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

    def _compact_count(self, head: Section) -> int:
        """How many entries a compact notation stands for; 0 where there is none."""
        entry = head.get("CompactSubObj")
        if entry is None:
            return 0
        count = self.number(head, "CompactSubObj") or 0
        if 0 <= count <= 0xFE:
            return count
        self.remark(head, entry, "out of range; ignored", "0 to 254")
        return 0

    def _compact(self, item: ODRecord | ODArray, head: Section, parts: Parts, count: int) -> None:
        """Write out an array of like entries."""
        item.add_member(_entry_count(item.index, count))
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

    def _numbered(self, section: Section | None, count: int) -> dict[int, Entry]:
        """The entries 1 to count of a list that goes with a compact notation."""
        found: dict[int, Entry] = {}
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


def _entry_count(index: int, count: int) -> ODVariable:
    """Sub-index 0 of a compact notation, as CiA 306-1 writes it out."""
    variable = ODVariable("NrOfObjects", index, 0)
    variable.data_type = 0x05
    variable.access_type = "ro"
    assign(variable, default=count, default_raw=str(count))
    return variable


def _first(parts: Parts) -> tuple[int, str]:
    sections: Iterable[Section] = (*parts.subs.values(), *parts.lists.values())
    first = min(sections, key=lambda section: section.line)
    return first.line, first.name
