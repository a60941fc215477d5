"""A parameter set: what a drive holds, or shall hold, as a text file with one object per line, its value and its unit.

    [header]
    profile = "emulated_drive"
    …
    [tuning]
    "position_gain_per_s" = { value = 25.0, unit = "1/s" }
    "0x2200:1" = { value = 7, type = "UNSIGNED16" }          # raw, as on the wire: no profile is asked

The tables are the four classes. ``commissioning`` (offsets, encoder facts) belongs to one device and is never copied to another
unless that is forced.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple, Self, get_args

import pydantic

from drive_profiles import files
from drive_profiles.catalogue import Catalogue, Entry, place_from
from drive_profiles.cia301 import DataType, Value, encode
from drive_profiles.errors import DriveProfileError, FileError, Problem, RefusedError
from drive_profiles.files import Table, toml_value
from drive_profiles.parameter import ParameterClass, Place, address_of
from drive_profiles.safefile import write_atomically
from drive_profiles.steps import pdo_of, steps, support
from drive_profiles.units import Scaling

CLASSES: tuple[ParameterClass, ...] = get_args(ParameterClass)
MAX_OBJECTS = 8192

_COMMANDS = frozenset({
    0x1003, 0x100C, 0x100D, 0x1010, 0x1011, 0x1014, 0x1015, 0x1020, 0x1021, 0x1023, 0x1024, 0x1025, 0x1026,
    0x1F22, 0x1F50, 0x1F51, 0x1F56, 0x1F57, 0x1F80, 0x1F82,
    0x6040, 0x6060, 0x6042, 0x6071, 0x607A, 0x60B0, 0x60B1, 0x60B2, 0x60B8, 0x60C1, 0x60FE, 0x60FF,
})  # fmt: skip
"""Objects that command or move a drive, rewrite its program or its history: never written from a file, never pulled."""


_SDO_PARAMETERS = range(0x1200, 0x1300)
"""Identifiers of the SDO channels: changed in the middle of an upload they would end it."""


def is_command(place: Place) -> bool:
    """Whether writing the object *does* something rather than sets something; of several axes (CiA 402: + 800h) each."""
    index = place[0]
    return (
        index in _COMMANDS
        or index in _SDO_PARAMETERS
        or (0x6800 <= index < 0xA000 and 0x6000 + (index - 0x6000) % 0x800 in _COMMANDS)
    )


class Item(Table):
    """One line of a set.

    Attributes:
        value: In ``unit``; text for strings, hexadecimal text for bytes.
        unit: As the profile says it.
        type: Given: the value is as on the wire, of this type.
        name: Of the object, for people.
    """

    value: int | float | str
    unit: str = ""
    type: str | None = None
    name: str = ""

    @pydantic.field_validator("type")
    @classmethod
    def _known(cls, kind: str | None) -> str | None:
        if kind is not None and kind not in DataType.__members__:
            raise ValueError(f"{kind!r} is no data type; expected one of {', '.join(DataType.__members__)}")
        return kind


class Header(Table):
    """Of which device the set is.

    Attributes:
        unverified: Why nobody can vouch for the values: the facts that they were computed from are not verified.
    """

    format: Literal[1] = 1
    profile: str = ""
    node_id: int | None = None
    title: str = ""
    vendor_id: int | None = None
    product_code: int | None = None
    revision: int | None = None
    serial_number: int | None = None
    firmware: str = ""
    date: str = ""
    hash: str = ""
    unverified: str = ""
    not_read: tuple[str, ...] = ()


class Write(NamedTuple):
    """An object and the bytes that it shall hold."""

    entry: Entry
    data: bytes
    value: float | str
    parameter_class: ParameterClass

    @property
    def place(self) -> Place:
        """Index and sub-index."""
        return self.entry.place


class Difference(NamedTuple):
    """One object in which two sets differ; None where one of them does not have it."""

    key: str
    left: float | str | None
    right: float | str | None
    unit: str


class ParameterSet(Table):
    """Values by class and name."""

    header: Header = Header()
    tuning: dict[str, Item] = pydantic.Field(default_factory=dict)
    limits: dict[str, Item] = pydantic.Field(default_factory=dict)
    communication: dict[str, Item] = pydantic.Field(default_factory=dict)
    commissioning: dict[str, Item] = pydantic.Field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file.

        Raises:
            FileError: With every problem, by line.
        """
        loaded = files.load(path, cls)
        if sum(1 for _ in loaded.items()) > MAX_OBJECTS:
            problem = Problem(0, "", f"holds more than {MAX_OBJECTS} objects", f"at most {MAX_OBJECTS}")
            raise FileError(Path(path), (problem,))
        return loaded

    def items(self) -> Iterator[tuple[ParameterClass, str, Item]]:
        """Class, key and line of every object."""
        for name in CLASSES:
            for key, item in getattr(self, name).items():
                yield name, key, item

    def digest(self) -> str:
        """SHA-256 over classes, keys, values and units: equal for equal contents, whatever the header says."""
        lines = [json.dumps([name, key, item.value, item.unit, item.type]) for name, key, item in self.items()]
        return "sha256:" + hashlib.sha256("\n".join(sorted(lines)).encode()).hexdigest()

    @property
    def is_edited(self) -> bool:
        """Whether the values are others than those that the hash in the header was made of."""
        return bool(self.header.hash) and self.header.hash != self.digest()

    def dumps(self) -> str:
        """The text of the file."""
        lines = ["# Parameter set: one object per line. See docs/parameters.md.", "", "[header]"]
        header = self.header.model_copy(update={"hash": self.digest()})
        for key, value in header.model_dump(exclude_none=True, exclude_defaults=True, exclude={"format"}).items():
            lines.append(f"{key} = {toml_value(value, hexadecimal=key in {'vendor_id', 'product_code', 'revision'})}")
        for name in CLASSES:
            table = getattr(self, name)
            lines += ["", f"[{name}]"] if table else []
            for key, item in table.items():
                parts = [f"value = {toml_value(item.value)}"]
                parts += [f"{part} = {toml_value(text)}" for part in ("unit", "type", "name") if (text := getattr(item, part))]
                lines.append(f"{toml_value(key)} = {{ {', '.join(parts)} }}")
        return "\n".join(lines) + "\n"

    def save(self, path: Path, *, force: bool = False) -> None:
        """Write the file, whole or not at all.

        Raises:
            RefusedError: It is there already, and ``force`` is not given.
            FileError: It cannot be written.
        """
        write_atomically(path, self.dumps().encode(), force=force)

    def writes(
        self,
        catalogue: Catalogue,
        scaling: Scaling | None = None,
        *,
        classes: Collection[str] = CLASSES,
        limits: bool = True,
    ) -> list[Write]:
        """What each line means in bytes, in the order in which the objects are best written.

        Args:
            catalogue: Of the device.
            scaling: Of the drive, where a unit depends on its encoder or rated torque.
            classes: Those that are wanted; the others are left out.
            limits: Whether the limits of profile and EDS hold for raw lines: not for what the device itself has held.

        Raises:
            RefusedError: Lines that cannot be written, each with its reason: unknown, read only, out of range, a wrong unit, a
                command, or twice the same object. Nothing is clamped.
        """
        reasons: list[str] = []
        found: dict[Place, Write] = {}
        for name, key, item in self.items():
            if name not in classes:
                continue
            try:
                write = _write(name, key, item, catalogue, scaling, limits=limits)
            except DriveProfileError as error:
                reasons.append(f"{key}: {error}")
                continue
            if write.place in found:
                reasons.append(f"{key}: {write.entry} is in the set twice")
            found[write.place] = write
        if reasons:
            raise RefusedError(*reasons)
        return sorted(found.values(), key=lambda write: 0 if write.entry.parameter is None else write.entry.parameter.order)

    def differences(self, other: ParameterSet) -> list[Difference]:
        """The objects in which this set (left) and another (right) differ, in this set's order."""
        left = {key: item for _, key, item in self.items()}
        right = {key: item for _, key, item in other.items()}
        found = []
        for key in (*left, *(key for key in right if key not in left)):
            a, b = left.get(key), right.get(key)
            if a is None or b is None or (a.value, a.unit, a.type) != (b.value, b.unit, b.type):
                unit = (a or b or Item(value=0)).unit
                found.append(Difference(key, None if a is None else a.value, None if b is None else b.value, unit))
        return found


def item_of(entry: Entry, data: bytes, scaling: Scaling | None) -> tuple[str, Item]:
    """Key and line for an object that holds these bytes; raw, by address, where what a step is worth is not known.

    Raises:
        ValueError: They are no value of the object's type, or not finite.
    """
    if entry.parameter is not None and (scaling is not None or not entry.needs_scaling):
        value = entry.decoded(data, scaling)
        _check_finite(value)
        return entry.name, Item(value=value, unit=entry.unit)
    kind = entry.data_type or DataType.DOMAIN
    value = replace(entry, data_type=kind, parameter=None).decoded(data)
    _check_finite(value)
    return f"0x{address_of(entry.place)}", Item(value=value, type=kind.name, name=entry.name)


def _check_finite(value: float | str) -> None:
    if isinstance(value, float) and not abs(value) < float("inf"):
        raise ValueError(f"{value} is no finite number")


def from_values(catalogue: Catalogue, values: Mapping[Place, Value], scaling: Scaling | None = None) -> ParameterSet:
    """The set that a DCF's values are.

    Commands and what is read only are left out and listed in the header's ``not_read``.
    """
    tables: dict[str, dict[str, Item]] = {name: {} for name in CLASSES}
    left_out: list[str] = []
    for place, value in sorted(values.items()):
        entry = catalogue.get(place)
        if entry is None or is_command(place) or not entry.is_writable:
            why = "is in no object of the file" if entry is None else "is a command" if is_command(place) else "is read only"
            left_out.append(f"{address_of(place)} {why}")
            continue
        kind = entry.data_type or (DataType.VISIBLE_STRING if isinstance(value, str) else DataType.DOMAIN)
        try:
            key, item = item_of(entry, encode(kind, value), scaling)
        except (ValueError, DriveProfileError) as error:
            left_out.append(f"{entry}: {error}")
            continue
        tables[entry.parameter_class][key] = item
    return ParameterSet.model_validate({"header": Header(not_read=tuple(left_out)), **tables})


def to_concise(writes: Collection[Write]) -> bytes:
    """Concise DCF, the value of 1F22h: count, then index, sub-index, length and bytes of each (CiA 302-3, 1F22h).

    Whoever sends it writes entry by entry, so PDOs whose COB-ID is in the set are made invalid first and valid last.
    """
    goal = {write.place: write.data for write in writes}
    # as if the device held something else everywhere, and every PDO were valid
    held = {place: data + b"\0" for place, data in goal.items()}
    held |= {place: b"\1" for place in goal if place[1] == 0 and pdo_of(place) is not None}
    held |= {place: data[:3] + bytes((data[3] & 0x7F,)) for place, data in goal.items() if _is_cob_id(place) and len(data) == 4}
    whole = {place for place in goal if support([place]) <= set(goal)}
    order = steps({place: goal[place] for place in goal if place in whole}, held)
    order += [(place, data) for place, data in goal.items() if place not in whole]
    entries = [struct.pack("<HBI", *place, len(data)) + data for place, data in order]
    return struct.pack("<I", len(entries)) + b"".join(entries)


def _is_cob_id(place: Place) -> bool:
    return place[1] == 1 and pdo_of(place) == place[0]


def from_concise(data: bytes) -> dict[Place, bytes]:
    """What a concise DCF leaves a device with; of an object that it writes several times, the last.

    Raises:
        RefusedError: It ends too early, or goes on after its end.
    """
    if len(data) < 4:
        raise RefusedError(f"a concise DCF begins with a count of 4 bytes, this one has {len(data)} bytes")
    count, position = struct.unpack_from("<I", data)[0], 4
    found: dict[Place, bytes] = {}
    for number in range(1, count + 1):
        if position + 7 > len(data):
            raise RefusedError(f"entry {number} of {count} of the concise DCF is cut off at byte {len(data)}")
        index, subindex, length = struct.unpack_from("<HBI", data, position)
        position += 7
        if position + length > len(data):
            raise RefusedError(f"entry {number}, {index:04X}:{subindex:X}, says {length} bytes, {len(data) - position} are left")
        found[index, subindex] = data[position : position + length]
        position += length
    if position != len(data):
        raise RefusedError(f"{len(data) - position} bytes follow the {count} entries of the concise DCF")
    return found


def _write(name: ParameterClass, key: str, item: Item, catalogue: Catalogue, scaling: Scaling | None, *, limits: bool) -> Write:
    if item.type is None:
        entry = catalogue.find(key, whole=True)
    else:
        place = place_from(key)
        entry = _as_on_the_wire(place, None if place is None else catalogue.get(place), item, scaling, limits=limits)
    if is_command(entry.place):
        raise RefusedError(f"{entry} is a command; a file does not give commands")
    if not entry.is_writable:
        raise RefusedError(f"{entry} is read only")
    if not entry.is_readable:
        raise RefusedError(f"{entry} is write only and cannot be checked after it is written")
    if item.type is not None and item.unit:
        raise RefusedError(f"says {item.unit}, but a line with a type is as on the wire and has no unit")
    if item.type is None and item.unit != entry.unit:
        raise RefusedError(f"says {item.unit or 'no unit'}, its unit is {entry.unit or 'none'}")
    # a line that is moved to another table is still what the profile says of it
    kind: ParameterClass = "commissioning" if entry.parameter_class == "commissioning" else name
    return Write(entry, entry.encoded(item.value, scaling), item.value, kind)


def _as_on_the_wire(place: Place | None, known: Entry | None, item: Item, scaling: Scaling | None, *, limits: bool) -> Entry:
    """The object of a line that gives a type, and so a raw value; what is known of its limits and access still holds."""
    kind = DataType[item.type or ""]
    if known is None:
        if place is None:
            raise RefusedError("a line with a type names its object as 0x2147:1")
        return Entry(place, item.name, kind)
    if known.data_type not in {None, kind}:
        raise RefusedError(f"{known} is a {known.data_type.name if known.data_type else '?'}, the set says {kind.name}")
    raw = replace(known, data_type=kind, parameter=None)
    if not limits:
        return replace(raw, low=None, high=None)
    if known.parameter is not None and (scaling is not None or not known.needs_scaling):
        known.encoded(known.decoded(raw.encoded(item.value), scaling), scaling)  # the profile's limits
    return raw
