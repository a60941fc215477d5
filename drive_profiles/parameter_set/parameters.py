"""A parameter set as a text file with one object per line.

    [header]
    profile = "emulated_drive"
    …
    [tuning]
    "position_gain_per_s" = { value = 25.0, unit = "1/s" }
    "0x2200:1" = { value = 7, type = "UNSIGNED16" }          # raw, as on the wire: no profile is asked

The tables are the four classes. ``commissioning`` (offsets, encoder facts) belongs to one device and is never copied to another
unless that is forced.
"""

import contextlib
import hashlib
import json
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple, Self, get_args

import pydantic

from drive_profiles.eds.variables import ObjectFlag
from drive_profiles.errors import DriveProfileError, RefusedError
from drive_profiles.family.catalogue import Catalogue, CatalogueEntry, address_from
from drive_profiles.family.parameter import ParameterClass
from drive_profiles.files import toml as files
from drive_profiles.files.safefile import write_atomically
from drive_profiles.files.toml import Table, toml_value
from drive_profiles.parameter_set.commands import is_command
from drive_profiles.standard.cia301 import DataType, Value, encode, type_of_length
from drive_profiles.standard.object_address import ObjectAddress, address_text
from drive_profiles.standard.units import Scaling

CLASSES: tuple[ParameterClass, ...] = get_args(ParameterClass)
MAX_BYTES = 4 << 20
"""Largest file of a set, in any format: the sections of an EDS, 20,000 at most, make one of 2.1 MB, with 107 bytes a line."""


def check_size(data: bytes) -> None:
    """Refuse (`RefusedError`) the bytes of a file that no reader would take."""
    if len(data) > MAX_BYTES:
        raise RefusedError(
            f"the set would be a file of {len(data)} bytes; expected at most {MAX_BYTES >> 20} MiB, the largest that is read; "
            "pull fewer classes into one file (--classes)"
        )


class Item(Table):
    """One line of a parameter set.

    Attributes:
        value: Value in ``unit``; text for strings, hexadecimal text for bytes.
        unit: Unit as in the profile.
        type: Data type of a raw value, as on the wire; None for a value in ``unit``.
        name: Name of the object, for people.
    """

    value: int | float | str
    unit: str = ""
    type: str | None = None
    name: str = ""

    @pydantic.field_validator("type")
    @classmethod
    def _known(cls, name: str | None) -> str | None:
        if name is not None and name not in DataType.__members__:
            raise ValueError(f"{name!r} is not a data type; expected one of {', '.join(DataType.__members__)}")
        return name


class Header(Table):
    """Header of a parameter set: the device that it belongs to.

    Attributes:
        unverified: The unverified facts from which the values were computed; empty if all are verified.
        not_read: Objects that could not be read, each with the reason.
        bitrate_bit_s: Bit rate of the bus that the set was pulled on, where the bus had one.
        counts_per_rev: Increments of the drive's encoder per revolution, where values count in them; None if not known.
        rated_torque_nm: Rated torque of the drive, where values count in it.
        gear_motor_revs: 6091h:1, where positions count by it; likewise the three below.
        gear_shaft_revs: 6091h:2.
        feed: 6092h:1.
        feed_shaft_revs: 6092h:2.
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
    bitrate_bit_s: int | None = pydantic.Field(default=None, gt=0)
    counts_per_rev: int | None = pydantic.Field(default=None, gt=0)
    rated_torque_nm: float | None = pydantic.Field(default=None, gt=0)
    gear_motor_revs: int = pydantic.Field(default=1, gt=0)
    gear_shaft_revs: int = pydantic.Field(default=1, gt=0)
    feed: int | None = pydantic.Field(default=None, gt=0)
    feed_shaft_revs: int = pydantic.Field(default=1, gt=0)

    def scaling_of(self, entry: CatalogueEntry) -> Scaling | None:
        """Return the scaling for one object, or None."""
        known = {"counts": self.counts_per_rev, "per mille": self.rated_torque_nm}.get(entry.scale)
        return None if known is None else self.scaling()

    def scaling(self) -> Scaling:
        """Return the header's scaling, with 1 for what it lacks."""
        return Scaling(
            self.counts_per_rev or 1,
            self.rated_torque_nm or 1.0,
            self.gear_motor_revs,
            self.gear_shaft_revs,
            self.feed,
            self.feed_shaft_revs,
        )


class Write(NamedTuple):
    """An object, and the bytes and the value that it shall hold."""

    entry: CatalogueEntry
    data: bytes
    value: float | str
    parameter_class: ParameterClass

    @property
    def address(self) -> ObjectAddress:
        """Index and sub-index."""
        return self.entry.address


class Difference(NamedTuple):
    """One object in which two sets differ; None is a missing side."""

    key: str
    left: float | str | None
    right: float | str | None
    unit: str


class ParameterSet(Table):
    """Values by class and by name or address."""

    header: Header = Header()
    tuning: dict[str, Item] = pydantic.Field(default_factory=dict)
    limits: dict[str, Item] = pydantic.Field(default_factory=dict)
    communication: dict[str, Item] = pydantic.Field(default_factory=dict)
    commissioning: dict[str, Item] = pydantic.Field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a parameter set from a file.

        Raises:
            FileError: The file has problems; the error has all of them, by line.
        """
        return files.load(path, cls, max_bytes=MAX_BYTES)

    def items(self) -> Iterator[tuple[ParameterClass, str, Item]]:
        """Iterate over class, key and line of every object."""
        for name in CLASSES:
            for key, item in getattr(self, name).items():
                yield name, key, item

    def digest(self) -> str:
        """Return the SHA-256 over classes, keys, values and units."""
        lines = [json.dumps([name, key, item.value, item.unit, item.type]) for name, key, item in self.items()]
        return "sha256:" + hashlib.sha256("\n".join(sorted(lines)).encode()).hexdigest()

    @property
    def is_edited(self) -> bool:
        """Return True if the values changed after the header's hash was made."""
        return bool(self.header.hash) and self.header.hash != self.digest()

    def dumps(self) -> str:
        """Return the file's text; `RefusedError` if it is longer than `load` reads."""
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
        text = "\n".join(lines) + "\n"
        check_size(text.encode())
        return text

    def save(self, path: Path, *, force: bool = False) -> None:
        """Write the file atomically.

        Raises:
            RefusedError: The file exists already, and ``force`` is not given; or it would be longer than `load` reads.
            FileError: The file cannot be written.
        """
        write_atomically(path, self.dumps().encode(), force=force)

    def writes(
        self,
        catalogue: Catalogue,
        scaling: Scaling | None = None,
        *,
        classes: Collection[str] = CLASSES,
        limits: bool = True,
        flagged: bool = False,
    ) -> list[Write]:
        """Encode each line, in the best order for writing.

        Args:
            scaling: Scaling of the drive, where a unit depends on its encoder or rated torque.
            classes: Classes to write; the others are left out.
            limits: True: the limits of profile and EDS hold. False is for values that the device itself held.
            flagged: False: what is `skipped_by_objflags` is left out, unless the limits do not hold either. True is for a DCF.

        Raises:
            RefusedError: Some lines cannot be written: unknown, read only, out of range, a wrong unit, a command, or the same
                object twice. The error has all of them; no value is clamped.
        """
        reasons: list[str] = []
        writes: dict[ObjectAddress, Write] = {}
        skipped_by_objflags = self.skipped_by_objflags(catalogue) if limits and not flagged else []
        for name, key, item in self.items():
            if name not in classes or key in skipped_by_objflags:
                continue
            try:
                write = _write(name, key, item, catalogue, scaling, limits=limits)
            except DriveProfileError as error:
                reasons.append(f"{key}: {error}")
                continue
            if write.address in writes:
                reasons.append(f"{key}: {write.entry} is in the set twice")
            writes[write.address] = write
        if reasons:
            raise RefusedError(*reasons)
        return sorted(writes.values(), key=lambda write: 0 if write.entry.parameter is None else write.entry.parameter.order)

    def skipped_by_objflags(self, catalogue: Catalogue) -> list[str]:
        """List the keys that the EDS keeps out of downloads (``ObjFlags``)."""
        flagged = {entry.address: entry for entry in catalogue if entry.flags & ObjectFlag.REFUSES_WRITE_ON_DOWNLOAD}
        names = {entry.name for entry in flagged.values()}
        return [key for _, key, item in self.items() if (address_from(key) in flagged if item.type else key in names)]

    def differences(
        self,
        other: "ParameterSet",
        catalogue: Catalogue | None = None,
        scaling_of: Callable[[CatalogueEntry], Scaling | None] = lambda entry: None,
    ) -> list[Difference]:
        """List the objects in which two sets differ, in this one's order.

        With a catalogue objects are compared by address and bytes, so that a line in a unit and a raw line may be the same; a
        line whose bytes are not known is compared as text.
        """
        left, right = (_compared(each, catalogue, scaling_of) for each in (self, other))
        differences = []
        for identity in (*left, *(each for each in right if each not in left)):
            a, b = left.get(identity), right.get(identity)
            if a is None or b is None or not a.is_same_as(b):
                (value, unit), (theirs, their_unit) = (("", "") if each is None else each.shown(scaling_of) for each in (a, b))
                if a is not None and b is not None and unit != their_unit:
                    value, theirs = f"{value} {unit}".rstrip(), f"{theirs} {their_unit}".rstrip()
                    unit = ""
                key = (a or b or _ComparedLine("", Item(value=0))).key
                differences.append(
                    Difference(
                        key, None if a is None else value, None if b is None else theirs, unit or ("" if a else their_unit)
                    )
                )
        return differences


class _ComparedLine(NamedTuple):
    """A line of a set with its bytes, if they are known."""

    key: str
    item: Item
    entry: CatalogueEntry | None = None
    data: bytes | None = None

    def is_same_as(self, other: "_ComparedLine") -> bool:
        if self.data is not None and other.data is not None:
            return self.data == other.data
        return (self.item.value, self.item.unit, self.item.type) == (other.item.value, other.item.unit, other.item.type)

    def shown(self, scaling_of: Callable[[CatalogueEntry], Scaling | None]) -> tuple[float | str, str]:
        """Return value and unit for display."""
        if self.entry is not None and self.data is not None and self.entry.parameter is not None:
            with contextlib.suppress(ValueError, DriveProfileError):
                return self.entry.decoded(self.data, scaling_of(self.entry)), self.entry.unit
        return self.item.value, self.item.unit


def _compared(
    parameter_set: ParameterSet, catalogue: Catalogue | None, scaling_of: Callable[[CatalogueEntry], Scaling | None]
) -> dict[ObjectAddress | str, _ComparedLine]:
    """Map each line to its address, or where unknown to its key."""
    lines: dict[ObjectAddress | str, _ComparedLine] = {}
    for _, key, item in parameter_set.items():
        entry, data = None, None
        with contextlib.suppress(ValueError, DriveProfileError):
            if item.type is None and catalogue is not None:
                entry = catalogue.find(key, whole=True)
                data = entry.without_limits().encoded(item.value, scaling_of(entry))
            elif catalogue is not None and (address := address_from(key)) is not None:
                raw = CatalogueEntry(address, item.name, DataType[item.type or "DOMAIN"])
                entry = catalogue.get(address) or raw
                data = raw.encoded(item.value)
        lines[key if entry is None else entry.address] = _ComparedLine(key, item, entry, data)
    return lines


def item_of(entry: CatalogueEntry, data: bytes, scaling: Scaling | None) -> tuple[str, Item]:
    """Make key and line of an object from its bytes.

    If the scaling is not known, the value stays raw and the address is the key.

    Raises:
        ValueError: The bytes are not a value of the object's type, or not finite.
    """
    if entry.parameter is not None and (scaling is not None or not entry.needs_scaling):
        value = entry.decoded(data, scaling)
        _check_finite(value)
        return entry.name, Item(value=value, unit=entry.unit)
    data_type = entry.data_type or DataType.DOMAIN
    value = replace(entry, data_type=data_type, parameter=None).decoded(data)
    _check_finite(value)
    return f"0x{address_text(entry.address)}", Item(value=value, type=data_type.name, name=entry.name)


def _check_finite(value: float | str) -> None:
    if isinstance(value, float) and not abs(value) < float("inf"):
        raise ValueError(f"{value} is not a finite number")


def from_values(
    catalogue: Catalogue,
    values: Mapping[ObjectAddress, Value],
    scaling_of: Callable[[CatalogueEntry], Scaling | None] = lambda entry: None,
    *,
    undescribed: bool = False,
    flagged: bool = False,
) -> ParameterSet:
    """Make a parameter set of a DCF's values.

    Commands, read-only objects and, unless `flagged`, those that refuse a download are left out, and listed in the header's
    ``not_read``. A value whose scaling is not known stays raw; `undescribed` objects are included by the length of their bytes.
    """
    tables: dict[str, dict[str, Item]] = {name: {} for name in CLASSES}
    left_out: list[str] = []
    for address, value in sorted(values.items()):
        entry = catalogue.get(address)
        if entry is None and undescribed:
            entry = CatalogueEntry(address, "", type_of_length(len(value)) if isinstance(value, bytes) else None)
        why = _why_not_from_a_file(address, entry, catalogue, flagged=flagged)
        if entry is None or why:
            left_out.append(f"{address_text(address)} {why}")
            continue
        data_type = entry.data_type or (DataType.VISIBLE_STRING if isinstance(value, str) else DataType.DOMAIN)
        try:
            data = value if undescribed and isinstance(value, bytes) else encode(data_type, value)
            key, item = item_of(entry, data, scaling_of(entry))
        except (ValueError, DriveProfileError) as error:
            left_out.append(f"{entry}: {error}")
            continue
        tables[entry.parameter_class][key] = item
    return ParameterSet.model_validate({"header": Header(not_read=tuple(left_out)), **tables})


def _why_not_from_a_file(address: ObjectAddress, entry: CatalogueEntry | None, catalogue: Catalogue, *, flagged: bool) -> str:
    if entry is None:
        return "is in no object of the file"
    if is_command(address, catalogue.profile):
        return "is a command"
    refuses = entry.flags & ObjectFlag.REFUSES_WRITE_ON_DOWNLOAD and not flagged
    return "is read only" if not entry.is_writable else "is excluded from downloads by the EDS (ObjFlags)" if refuses else ""


def _write(name: ParameterClass, key: str, item: Item, catalogue: Catalogue, scaling: Scaling | None, *, limits: bool) -> Write:
    if item.type is None:
        known = catalogue.find(key, whole=True)
        entry = known if limits else known.without_limits()
    else:
        address = address_from(key)
        entry = _as_on_the_wire(address, None if address is None else catalogue.get(address), item, scaling, limits=limits)
    if is_command(entry.address, catalogue.profile):
        raise RefusedError(f"{entry} is a command; a parameter set cannot contain commands")
    if not entry.is_writable:
        raise RefusedError(f"{entry} is read only")
    if not entry.is_readable:
        raise RefusedError(f"{entry} is write-only, so it cannot be read back; leave it out")
    if item.type is not None and item.unit:
        raise RefusedError(
            f"has the unit {item.unit}, but a line with a type holds the value on the wire; leave out unit or type"
        )
    if item.type is None and item.unit != entry.unit:
        raise RefusedError(f"has {f'the unit {item.unit}' if item.unit else 'no unit'}; expected {entry.unit or 'no unit'}")
    # a line that is moved to another table is still what the profile says of it
    parameter_class: ParameterClass = "commissioning" if entry.parameter_class == "commissioning" else name
    return Write(entry, entry.encoded(item.value, scaling), item.value, parameter_class)


def _as_on_the_wire(
    address: ObjectAddress | None, known: CatalogueEntry | None, item: Item, scaling: Scaling | None, *, limits: bool
) -> CatalogueEntry:
    """Return a raw line's entry; known limits and access still apply."""
    data_type = DataType[item.type or ""]
    if known is None:
        if address is None:
            raise RefusedError("a line with a type needs the address of its object, such as 0x2147:1, as its key")
        return CatalogueEntry(address, item.name, data_type)
    if known.data_type not in {None, data_type}:
        raise RefusedError(
            f"{known} has the type {known.data_type.name if known.data_type else '?'}; the set says {data_type.name}"
        )
    raw = replace(known, data_type=data_type, parameter=None)
    if not limits:
        return replace(raw, low=None, high=None)
    if known.parameter is not None and (scaling is not None or not known.needs_scaling):
        known.encoded(known.decoded(raw.encoded(item.value), scaling), scaling)  # the profile's limits
    return raw
