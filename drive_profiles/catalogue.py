"""What is known of a device's objects, from its profile and, where the user gives one, from its EDS: names, types, limits."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import canopen

from drive_profiles import units
from drive_profiles.cia301 import DataType, Value, decode, encode
from drive_profiles.eds import Description
from drive_profiles.errors import AmbiguousNameError, OutOfRangeError, RefusedError, UnknownObjectError
from drive_profiles.parameter import Parameter, ParameterClass, Place, address_of
from drive_profiles.profile import Profile
from drive_profiles.standard import OBJECTS
from drive_profiles.units import Scaling

_SPELLING = re.compile(r"(?:0x)?(?P<index>[0-9a-f]{4})h?(?:\s*(?::|\.|sub)\s*(?:0x)?(?P<sub>[0-9a-f]{1,2})h?)?", re.IGNORECASE)
_PDO = range(0x1400, 0x1C00)
_COMMUNICATION = range(0x1000, 0x2000)
MAX_CANDIDATES = 12


def place_from(text: str) -> Place | None:
    """Index and sub-index of ``0x2147:1``, ``2147sub1``, ``2147h:1`` or ``0x2147`` (sub-index 0); None for anything else."""
    match = _SPELLING.fullmatch(text.strip())
    if match is None:
        return None
    subindex = int(match["sub"] or "0", 16)
    return None if subindex > 0xFE else (int(match["index"], 16), subindex)


@dataclass(frozen=True)
class Entry:
    """One object, as far as it is known.

    Attributes:
        place: Index and sub-index.
        name: The profile's name of the parameter, else the EDS's.
        data_type: None where nobody says it.
        access: As an EDS writes it.
        parameter: What the profile says; None for an object that only the EDS has.
        low: Lowest value on the wire that the EDS allows.
        high: Highest.
        parameter_class: What kind of value it is.
    """

    place: Place
    name: str
    data_type: DataType | None
    access: str = "rw"
    parameter: Parameter | None = None
    low: float | None = None
    high: float | None = None
    parameter_class: ParameterClass = "tuning"

    def __str__(self) -> str:
        """Address and name."""
        return f"{address_of(self.place)} ({self.name})" if self.name else address_of(self.place)

    @property
    def unit(self) -> str:
        """Printable unit of the value."""
        return "" if self.parameter is None else self.parameter.unit

    @property
    def is_readable(self) -> bool:
        """Whether an SDO may read it."""
        return self.access != "wo"

    @property
    def is_writable(self) -> bool:
        """Whether an SDO may write it."""
        return self.access not in {"ro", "const"}

    @property
    def is_verified(self) -> bool:
        """Whether what is known of it is more than a guess; an EDS that the user gives counts."""
        return self.parameter is None or self.parameter.is_verified

    @property
    def needs_scaling(self) -> bool:
        """Whether the drive's encoder or rated torque decides what a step is worth."""
        return self.parameter is not None and isinstance(self.parameter.scale, str)

    def encoded(self, value: float | str, scaling: Scaling | None = None) -> bytes:
        """The bytes that the object holds for a value in its unit, within the limits of profile *and* EDS.

        Raises:
            OutOfRangeError: Outside of either.
            DriveProfileError: No value of this type, or the scaling is needed.
        """
        if self.parameter is not None:
            data = self.parameter.encoded(value, scaling)
            raw = decode(self.parameter.type, data)
        else:
            raw = _raw(self, value)
            data = encode(self._type(), raw)
        if isinstance(raw, int | float) and not isinstance(raw, bool):
            low, high = self._limits_on_the_wire()
            if not low <= raw <= high:
                reason = f"{raw:.10g} on the wire is outside {low:.10g} to {high:.10g}, the limits of the EDS"
                raise OutOfRangeError(str(self), value, self.unit, reason)
        return data

    def decoded(self, data: bytes, scaling: Scaling | None = None) -> float | str:
        """The value in its unit; bytes, and what is of no known type, as hexadecimal text.

        Raises:
            ValueError: The length is not that of the type.
            DriveProfileError: The scaling is needed.
        """
        if self.parameter is not None:
            return self.parameter.decoded(data, scaling)
        held = data if self.data_type is None else decode(self.data_type, data)
        if isinstance(held, bytes):
            return held.hex(" ")
        if self.data_type is DataType.REAL32 and isinstance(held, float):
            return units.shortest(held)
        return int(held) if isinstance(held, bool) else held

    def _type(self) -> DataType:
        if self.data_type is None:
            raise RefusedError(f"{self}: its data type is not known; give an EDS, or the type")
        return self.data_type

    def _limits_on_the_wire(self) -> tuple[float, float]:
        low = -math.inf if self.low is None else self.low
        high = math.inf if self.high is None else self.high
        if self.data_type is DataType.REAL32:  # as the drive holds them
            low, high = low - abs(low) * 6e-8, high + abs(high) * 6e-8
        return low, high


class Catalogue:
    """The objects of one kind of device; the standard's own can be found by name besides, but are not counted as the device's.

    Args:
        profile: Its family, where it is known.
        description: Its EDS, where there is one.
    """

    def __init__(self, profile: Profile | None = None, description: Description | None = None) -> None:
        self.profile = profile
        self.description = description
        self._entries: dict[Place, Entry] = {}
        for entry in _from_eds(description):
            self._entries[entry.place] = entry
        for name, parameter in profile.parameters.items() if profile else ():
            known = self._entries.get(parameter.place)
            # of another type than the profile says, the EDS is of another firmware: its limits are not this object's
            same = known is not None and known.data_type is parameter.type
            self._entries[parameter.place] = Entry(
                parameter.place,
                name,
                parameter.type,
                parameter.access,
                parameter,
                known.low if known is not None and same else None,
                known.high if known is not None and same else None,
                parameter.parameter_class,
            )
        self._entries = dict(sorted(self._entries.items()))
        self._standard = {place: Entry(place, *facts) for place, facts in OBJECTS.items() if place not in self._entries}
        self._names: dict[str, list[Place]] = {}
        for entry in _from_eds(description):
            self._names.setdefault(entry.name.casefold(), []).append(entry.place)
        for name, parameter in profile.parameters.items() if profile else ():
            self._names[name.casefold()] = [parameter.place]

    def __iter__(self) -> Iterator[Entry]:
        """All of them, in the order of their places."""
        return iter(self._entries.values())

    def __len__(self) -> int:
        """How many are known."""
        return len(self._entries)

    def get(self, place: Place) -> Entry | None:
        """What is known of an object."""
        return self._entries.get(place) or self._standard.get(place)

    @property
    def names(self) -> list[str]:
        """All names, for completion."""
        return [entry.name for entry in self]

    def find(self, text: str, *, whole: bool = False) -> Entry:
        """The object that a user means: ``0x2147:1``, ``2147sub1``, or a name.

        An object that neither profile nor EDS has is given by its address alone. A name must be of one object only.

        Args:
            text: What is looked for.
            whole: The name must be whole, as in a file; else a part of it will do.

        Raises:
            UnknownObjectError: Nothing is called so.
            AmbiguousNameError: Several are.
        """
        wanted = text.strip().casefold()
        if wanted in self._names:
            return self._only(text, self._names[wanted])
        place = place_from(text)
        if place is not None:
            return self.get(place) or Entry(place, "", None)
        standard = {entry.name: place for place, entry in self._standard.items()}
        if wanted in standard:
            return self._standard[standard[wanted]]
        if not whole and wanted:
            part = [place for name, places in self._names.items() if wanted in name for place in places]
            part = part or [place for name, place in standard.items() if wanted in name]
            if part:
                return self._only(text, list(dict.fromkeys(part)))  # one object may be known by two names
        close = difflib.get_close_matches(text, [*self.names, *standard], n=3, cutoff=0.5)
        raise UnknownObjectError(text, tuple(close))

    def _at(self, place: Place) -> Entry:
        return self._entries[place] if place in self._entries else self._standard[place]

    def _only(self, text: str, places: list[Place]) -> Entry:
        if len(places) == 1:
            return self._at(places[0])
        shown = [str(self._at(place)) for place in sorted(places)[:MAX_CANDIDATES]]
        more = len(places) - len(shown)
        raise AmbiguousNameError(text, (*shown, *((f"{more} more",) if more else ())))


def _raw(entry: Entry, value: float | str) -> Value:
    """A value without a unit as its type holds it."""
    kind = entry._type()
    if kind in {DataType.OCTET_STRING, DataType.DOMAIN}:
        if not isinstance(value, str):
            raise RefusedError(f"{entry}: {value!r} is no hexadecimal text, which a {kind.name} takes")
        try:
            return bytes.fromhex(value)
        except ValueError:
            raise RefusedError(f"{entry}: {value!r} is no hexadecimal text") from None
    if (kind is DataType.VISIBLE_STRING) != isinstance(value, str):
        raise RefusedError(f"{entry}: {value!r} is no {kind.name}")
    if isinstance(value, str):
        if not value.isascii() and max(value) > "\xff":
            raise RefusedError(f"{entry}: {value!r} has characters that are not in ISO 8859-1, which a {kind.name} takes")
        return value
    if not (kind.is_real or isinstance(value, int) or value.is_integer()):
        raise OutOfRangeError(str(entry), value, "", f"is no whole number, which a {kind.name} takes")
    try:
        raw = float(value) if kind.is_real else int(value)
        encode(kind, raw)
    except (ValueError, OverflowError):
        raw = math.inf
    if (kind is DataType.BOOLEAN and raw not in {0, 1}) or not math.isfinite(raw):  # struct takes 2, and 10**400, for true
        raise OutOfRangeError(str(entry), value, "", f"is outside what {kind.name} holds")
    return bool(raw) if kind is DataType.BOOLEAN else raw


def _from_eds(description: Description | None) -> Iterator[Entry]:
    if description is None:
        return
    for item in description.dictionary.values():
        if isinstance(item, canopen.objectdictionary.ODVariable):
            yield _entry(item, item.name)
        else:
            for variable in item.values():
                name = variable.name if variable.name.startswith(item.name) else f"{item.name}.{variable.name}"
                yield _entry(variable, name)


def _entry(variable: Any, name: str) -> Entry:
    try:
        kind = DataType(variable.data_type)
    except ValueError:
        kind = None
    numeric = kind is not None and (kind.is_integer or kind.is_real)
    return Entry(
        (variable.index, variable.subindex),
        name,
        kind,
        (variable.access_type or "rw").lower(),
        None,
        variable.min if numeric else None,
        variable.max if numeric else None,
        "communication" if variable.index in _COMMUNICATION else "tuning",
    )
