"""Objects of a device with names, types and limits."""

import difflib
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from drive_profiles.eds import Description
from drive_profiles.eds.export import entries
from drive_profiles.errors import AmbiguousNameError, OutOfRangeError, RefusedError, UnknownObjectError, beyond
from drive_profiles.family.parameter import Parameter, ParameterClass
from drive_profiles.family.profile import Profile
from drive_profiles.standard import shown, units
from drive_profiles.standard.cia301 import DataType, Value, decode, encode
from drive_profiles.standard.object_address import ObjectAddress, address_text
from drive_profiles.standard.objects import OBJECTS
from drive_profiles.standard.units import Scaling

_SPELLING = re.compile(r"(?:0x)?(?P<index>[0-9a-f]{4})h?(?:\s*(?::|\.|sub)\s*(?:0x)?(?P<sub>[0-9a-f]{1,2})h?)?", re.IGNORECASE)
_COMMUNICATION = range(0x1000, 0x2000)
MAX_CANDIDATES = 12


def address_from(text: str) -> ObjectAddress | None:
    """Parse an object address; None for any other text.

    Accepted are ``0x2147:1``, ``2147sub1``, ``2147h:1`` and ``0x2147`` (sub-index 0).
    """
    match = _SPELLING.fullmatch(text.strip())
    if match is None:
        return None
    subindex = int(match["sub"] or "0", 16)
    return None if subindex > 0xFE else (int(match["index"], 16), subindex)


@dataclass(frozen=True)
class CatalogueEntry:
    """One object of a device, as far as it is known.

    Attributes:
        name: Name of the parameter in the profile, else in the EDS.
        data_type: CiA 301 data type; None if neither profile nor EDS states it.
        parameter: The parameter in the profile; None for an object that only the EDS has.
        low: Lowest value on the wire that the EDS allows.
        high: Highest value on the wire that the EDS allows.
        flags: ``ObjFlags`` in the EDS: see `eds.variables.ObjectFlag`.
    """

    address: ObjectAddress
    name: str
    data_type: DataType | None
    access: str = "rw"
    parameter: Parameter | None = None
    low: float | None = None
    high: float | None = None
    parameter_class: ParameterClass = "tuning"
    flags: int = 0

    def __str__(self) -> str:
        """Return address and name."""
        return f"{address_text(self.address)} ({self.name})" if self.name else address_text(self.address)

    @property
    def unit(self) -> str:
        """Printable unit of the value."""
        return "" if self.parameter is None else self.parameter.unit

    @property
    def is_readable(self) -> bool:
        """True if an SDO may read the object."""
        return self.access != "wo"

    @property
    def is_writable(self) -> bool:
        """True if an SDO may write the object."""
        return self.access not in {"ro", "const"}

    @property
    def is_verified(self) -> bool:
        """True unless the facts are a guess; an EDS's are verified."""
        return self.parameter is None or self.parameter.is_verified

    @property
    def scale(self) -> Literal["", "counts", "per mille"]:
        """Quantity that decides the value of one step, or ""."""
        return self.parameter.scale if self.parameter is not None and isinstance(self.parameter.scale, str) else ""

    @property
    def needs_scaling(self) -> bool:
        """True if one step's value depends on encoder or rated torque."""
        return bool(self.scale)

    def without_limits(self) -> "CatalogueEntry":
        """Return the entry without limits, for values that a device already holds."""
        free = None if self.parameter is None else self.parameter.model_copy(update={"minimum": None, "maximum": None})
        return replace(self, low=None, high=None, parameter=free)

    def encoded(self, value: float | str, scaling: Scaling | None = None) -> bytes:
        """Encode a value, given in the object's unit.

        The limits of profile *and* EDS hold.

        Raises:
            OutOfRangeError: The value is outside the limits of either.
            DriveProfileError: The value is not of this type, or the scaling is needed and not given.
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
                reason = f"{raw:.10g} on the wire {beyond(low, high)}, the limits of the EDS"
                raise OutOfRangeError(str(self), value, self.unit, reason)
        return data

    def decoded(self, data: bytes, scaling: Scaling | None = None) -> float | str:
        """Decode the object's bytes to a value in its unit.

        Bytes, and objects of unknown type, give hexadecimal text.

        Raises:
            ValueError: The length is not that of the type.
            DriveProfileError: The scaling is needed and not given.
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
    """The objects of one type of device, by address and by name.

    The standard's objects can be found by name too; iteration and length leave them out.
    """

    def __init__(self, profile: Profile | None = None, description: Description | None = None) -> None:
        self.profile = profile
        self.description = description
        self._entries: dict[ObjectAddress, CatalogueEntry] = {}
        for entry in _from_eds(description):
            self._entries[entry.address] = entry
        for name, parameter in profile.parameters.items() if profile else ():
            stated = parameter.address, name, parameter.type, parameter.access, parameter
            own = CatalogueEntry(*stated, parameter_class=parameter.parameter_class)
            known = self._entries.get(parameter.address, own)
            # of another type than the profile says, the EDS is of another firmware: its limits are not this object's
            limits = known if known.data_type is parameter.type else own
            self._entries[own.address] = replace(own, low=limits.low, high=limits.high, flags=known.flags)
        self._entries = dict(sorted(self._entries.items()))
        self._standard = {
            address: CatalogueEntry(address, *facts) for address, facts in OBJECTS.items() if address not in self._entries
        }
        self._names: dict[str, list[ObjectAddress]] = {}
        for entry in _from_eds(description):
            self._names.setdefault(entry.name.casefold(), []).append(entry.address)
        for name, parameter in profile.parameters.items() if profile else ():
            self._names[name.casefold()] = [parameter.address]

    def __iter__(self) -> Iterator[CatalogueEntry]:
        """Iterate over the objects of the device by rising address."""
        return iter(self._entries.values())

    def __len__(self) -> int:
        """Return the number of objects of the device."""
        return len(self._entries)

    def get(self, address: ObjectAddress) -> CatalogueEntry | None:
        """Return the entry of an object, or None."""
        return self._entries.get(address) or self._standard.get(address)

    def unit_of(self, entry: CatalogueEntry) -> str:
        """Return the unit of an object's value, also a gain's, for people."""
        known = entry.unit or (self.profile.unit_of(entry.name) if self.profile and entry.parameter is not None else "")
        return shown.unit(known)

    @property
    def names(self) -> list[str]:
        """Names of all objects, for completion."""
        return [entry.name for entry in self]

    def find(self, text: str, *, whole: bool = False) -> CatalogueEntry:
        """Find an object by ``0x2147:1``, ``2147sub1``, or a name.

        An object that neither profile nor EDS has is found by its address alone. A name must be that of one object only; a part
        of it is enough unless it must be `whole`, as in a file.

        Raises:
            UnknownObjectError: No object has this name.
            AmbiguousNameError: Several objects have it.
        """
        wanted = text.strip().casefold()
        if wanted in self._names:
            return self._only(text, self._names[wanted])
        address = address_from(text)
        if address is not None:
            return self.get(address) or CatalogueEntry(address, "", None)
        standard = {entry.name: address for address, entry in self._standard.items()}
        if wanted in standard:
            return self._standard[standard[wanted]]
        if not whole and wanted:
            part = [address for name, addresses in self._names.items() if wanted in name for address in addresses]
            part = part or [address for name, address in standard.items() if wanted in name]
            if part:
                return self._only(text, list(dict.fromkeys(part)))  # one object may be known by two names
        close = difflib.get_close_matches(text, [*self.names, *standard], n=3, cutoff=0.5)
        raise UnknownObjectError(text, tuple(close))

    def _at(self, address: ObjectAddress) -> CatalogueEntry:
        return self._entries[address] if address in self._entries else self._standard[address]

    def _only(self, text: str, addresses: list[ObjectAddress]) -> CatalogueEntry:
        if len(addresses) == 1:
            return self._at(addresses[0])
        shown = [str(self._at(address)) for address in sorted(addresses)[:MAX_CANDIDATES]]
        more = len(addresses) - len(shown)
        raise AmbiguousNameError(text, (*shown, *((f"{more} more",) if more else ())))


def _raw(entry: CatalogueEntry, value: float | str) -> Value:
    """Convert a value without a unit to the type of its object."""
    data_type = entry._type()
    if data_type in {DataType.OCTET_STRING, DataType.DOMAIN}:
        if not isinstance(value, str):
            raise RefusedError(f"{entry}: {value!r} is not a value of {data_type.name}; expected hexadecimal text")
        try:
            return bytes.fromhex(value)
        except ValueError:
            raise RefusedError(
                f"{entry}: {value!r} is not hexadecimal text; expected pairs of the digits 0 to 9 and A to F"
            ) from None
    if (data_type is DataType.VISIBLE_STRING) != isinstance(value, str):
        expected = "a number" if isinstance(value, str) else "a text"
        raise RefusedError(f"{entry}: {value!r} is not a value of {data_type.name}; expected {expected}")
    if isinstance(value, str):
        if not value.isascii() and max(value) > "\xff":
            raise RefusedError(f"{entry}: {value!r} has characters outside ISO 8859-1; {data_type.name} holds none")
        return value
    if not (data_type.is_real or isinstance(value, int) or value.is_integer()):
        raise OutOfRangeError(str(entry), value, "", f"is not a whole number; {data_type.name} holds only whole numbers")
    try:
        raw = float(value) if data_type.is_real else int(value)
        encode(data_type, raw)
    except (ValueError, OverflowError):
        raw = math.inf
    if (data_type is DataType.BOOLEAN and raw not in {0, 1}) or not math.isfinite(raw):  # struct takes 2, and 10**400, for true
        raise OutOfRangeError(str(entry), value, "", f"is outside the range of {data_type.name}")
    return bool(raw) if data_type is DataType.BOOLEAN else raw


def _from_eds(description: Description | None) -> Iterator[CatalogueEntry]:
    if description is None:
        return
    for item, variable in entries(description.dictionary):
        is_named = variable is item or variable.name.startswith(item.name)
        yield _entry(variable, variable.name if is_named else f"{item.name}.{variable.name}", description.flags)


def _entry(variable: Any, name: str, flags: Mapping[ObjectAddress, int]) -> CatalogueEntry:
    try:
        data_type = DataType(variable.data_type)
    except ValueError:
        data_type = None
    numeric = data_type is not None and (data_type.is_integer or data_type.is_real)
    return CatalogueEntry(
        (variable.index, variable.subindex),
        name,
        data_type,
        (variable.access_type or "rw").lower(),
        None,
        variable.min if numeric else None,
        variable.max if numeric else None,
        "communication" if variable.index in _COMMUNICATION else "tuning",
        flags.get((variable.index, variable.subindex), 0),
    )
