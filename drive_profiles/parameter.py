"""One value in a drive's object dictionary, as a profile states it: where it is, what it means, and how that is known."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Annotated, Literal, Self

import pydantic

from drive_profiles import units
from drive_profiles.cia301 import DataType, Value, decode, encode
from drive_profiles.errors import DriveProfileError, OutOfRangeError
from drive_profiles.files import Table

ParameterClass = Literal["tuning", "limits", "communication", "commissioning"]
Evidence = Literal["definition", "standard", "eds", "documentation", "source code", "measured", "unverified"]
Effective = Literal["now", "disabled", "reset"]
Place = tuple[int, int]
"""Index and sub-index of an object."""

ObjectAddress = Annotated[str, pydantic.Field(pattern=r"^[0-9A-F]{4}:[0-9A-F]{1,2}$")]
"""An object as it is written down: index and sub-index, hexadecimal, ``2101:1``."""

LIMITS: dict[str, tuple[int, int]] = {
    "BOOLEAN": (0, 1),
    "INTEGER8": (-(2**7), 2**7 - 1),
    "INTEGER16": units.INTEGER16,
    "INTEGER32": units.INTEGER32,
    "INTEGER64": (-(2**63), 2**63 - 1),
    "UNSIGNED8": (0, 2**8 - 1),
    "UNSIGNED16": units.UNSIGNED16,
    "UNSIGNED32": units.UNSIGNED32,
    "UNSIGNED64": (0, 2**64 - 1),
}
"""What the integer types of CiA 301 hold."""

BYTES = frozenset({"VISIBLE_STRING", "OCTET_STRING", "DOMAIN"})
"""Types whose value decides their length; such a value has no unit and no limits."""


def place_of(address: str) -> Place:
    """Index and sub-index of an `ObjectAddress`."""
    index, _, subindex = address.partition(":")
    return int(index, 16), int(subindex or "0", 16)


def address_of(place: Place) -> str:
    """The object as it is written down: ``2101:1``, hexadecimal."""
    return f"{place[0]:04X}:{place[1]:X}"


class Fact(Table):
    """A table of a profile that says how it is known.

    Attributes:
        source: Where this is written.
        evidence: How it is known; what is unverified is shown as such, and written to a drive only when that is asked for.
    """

    source: str = pydantic.Field(min_length=1)
    evidence: Evidence

    @property
    def is_verified(self) -> bool:
        """Whether anything better than a guess stands behind it."""
        return self.evidence != "unverified"


class Parameter(Fact):
    """One value in the object dictionary.

    Attributes:
        index: Of the object.
        subindex: Of the object.
        data_type: Name of the CiA 301 data type.
        unit: Printable unit of the value, as its name's suffix says; empty for a plain number.
        scale: Value per step on the wire; ``counts`` where the encoder decides (rad per count), ``per mille`` where the
            rated torque does (N·m per mille).
        access: As in an EDS.
        parameter_class: ``class`` in the file.
        minimum: Smallest value, in ``unit``.
        maximum: Largest value, in ``unit``.
        default: What the object holds when the drive leaves the factory, as it is on the wire; bytes as hexadecimal text.
        mappable: Whether a PDO may carry it.
        effective: When a written value acts: at once, only if written while disabled, or after a reset.
        order: Parameters are written in rising order; those of one order as the file lists them.
        description: What it does.
    """

    index: int = pydantic.Field(ge=0x1000, le=0xFFFF)
    subindex: int = pydantic.Field(ge=0, le=0xFE)
    data_type: Literal[
        "BOOLEAN", "INTEGER8", "INTEGER16", "INTEGER32", "INTEGER64", "UNSIGNED8", "UNSIGNED16", "UNSIGNED32", "UNSIGNED64",
        "REAL32", "REAL64", "VISIBLE_STRING", "OCTET_STRING", "DOMAIN",
    ]  # fmt: skip
    unit: str = ""
    scale: Annotated[float, pydantic.Field(gt=0)] | Literal["counts", "per mille"] = 1.0
    access: Literal["rw", "ro", "wo"] = "rw"
    parameter_class: ParameterClass = pydantic.Field(alias="class")
    minimum: float | None = None
    maximum: float | None = None
    default: int | float | str | None = None
    mappable: bool = False
    effective: Effective = "now"
    order: int = 0
    description: str = pydantic.Field(min_length=1)

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.is_bytes and (self.unit or self.minimum is not None or self.maximum is not None or self.scale != 1.0):
            raise ValueError(f"a {self.data_type} has no unit, no scale and no limits")
        if self.minimum is not None and self.maximum is not None and self.minimum > self.maximum:
            raise ValueError(f"minimum {self.minimum:g} is above maximum {self.maximum:g}")
        if self.default is not None:
            try:
                self.default_bytes()
            except ValueError as error:
                raise ValueError(f"default {self.default!r}: {error}") from None
        return self

    @property
    def place(self) -> Place:
        """Index and sub-index."""
        return self.index, self.subindex

    @property
    def address(self) -> str:
        """The object as it is written down: ``2101:1``, hexadecimal."""
        return address_of(self.place)

    @property
    def type(self) -> DataType:
        """The CiA 301 data type."""
        return DataType[self.data_type]

    @property
    def is_bytes(self) -> bool:
        """Whether the value is a string of bytes rather than a number."""
        return self.data_type in BYTES

    @property
    def step(self) -> str:
        """What one step on the wire is, in words."""
        if isinstance(self.scale, str):
            return {"counts": "1 count", "per mille": "1 ‰ of 6076h"}[self.scale]
        return "" if self.is_bytes or self.type.is_real else f"{self.scale:g} {self.unit}".rstrip()

    def default_bytes(self) -> bytes | None:
        """What the object holds when the drive leaves the factory; None where that is not known.

        Raises:
            ValueError: The default is not of the data type.
        """
        if self.default is None:
            return None
        value: Value = self.default
        if self.is_bytes and self.data_type != "VISIBLE_STRING":
            if not isinstance(self.default, str):
                raise ValueError("bytes are written as hexadecimal text")
            value = bytes.fromhex(self.default)
        elif self.type.is_real and isinstance(self.default, int):
            value = float(self.default)
        return encode(self.type, value)

    def value_per_step(self, scaling: units.Scaling | None = None) -> float:
        """The value, in ``unit``, of one step on the wire.

        Args:
            scaling: Of the drive; needed where the scale depends on its encoder or rated torque.

        Raises:
            DriveProfileError: It is needed and was not given.
        """
        if not isinstance(self.scale, str):
            return self.scale
        if scaling is None:
            raise DriveProfileError(f"object {self.address} counts in {self.scale}: the drive's scaling is needed")
        return 1.0 / scaling.counts_per_rad if self.scale == "counts" else scaling.torque_quantum_nm

    def raw(self, value: float, scaling: units.Scaling | None = None) -> int | float:
        """What the object holds for a value in ``unit``: an integer, or a REAL32 as it rounds.

        Raises:
            OutOfRangeError: Outside the parameter's or the data type's range, or not finite.
            DriveProfileError: The scaling is needed and was not given, or the object holds bytes.
        """
        if self.is_bytes:
            raise DriveProfileError(f"object {self.address} holds bytes, not a number")
        real = self.type.is_real
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        per_step = self.value_per_step(scaling)
        low, high = (
            limit if math.isinf(limit) else self._as_read_back(limit, per_step, pick) for limit, pick in ((low, min), (high, max))
        )
        if not low <= value <= high or not -sys.float_info.max <= value <= sys.float_info.max:
            raise OutOfRangeError(self.address, value, self.unit, f"is outside {low:g} to {high:g}")
        if real:
            held = value / per_step
            if self.data_type == "REAL32":
                return units.real32(held)
            if math.isinf(held):
                raise OutOfRangeError(self.address, value, self.unit, f"is outside what {self.data_type} holds")
            return held
        if per_step == 1.0 and (isinstance(value, int) or value.is_integer()):
            exact = int(value)  # 64 bits do not pass through a float
            if not LIMITS[self.data_type][0] <= exact <= LIMITS[self.data_type][1]:
                raise OutOfRangeError(self.address, value, self.unit, f"is outside what {self.data_type} holds")
            return exact
        return units.to_integer(value, LIMITS[self.data_type], self.address, self.unit, 1.0 / per_step)

    def _as_read_back(self, limit: float, per_step: float, pick: Callable[[float, float], float]) -> float:
        """A limit as it comes back from a drive, which rounds: else one read back at 0.01, or at 3 steps of 0.1, is refused."""
        if self.data_type == "REAL32":
            return pick(limit, units.real32(limit / per_step) * per_step)
        nearest = limit if self.type.is_real else round(limit / per_step) * per_step
        return pick(limit, nearest) if math.isclose(limit, nearest, rel_tol=1e-12) else limit

    def value(self, raw: float, scaling: units.Scaling | None = None) -> float:
        """The value in ``unit`` of what the object holds; the inverse of `raw`."""
        return raw * self.value_per_step(scaling)

    def encoded(self, value: float | str, scaling: units.Scaling | None = None) -> bytes:
        """The bytes that the object holds for a value in ``unit``; text for a VISIBLE_STRING, hexadecimal text for bytes.

        Raises:
            OutOfRangeError: See `raw`.
            DriveProfileError: See `raw`; or a number for bytes, or text for a number.
        """
        if isinstance(value, str) != self.is_bytes:
            raise DriveProfileError(f"object {self.address} is a {self.data_type}: {value!r} is no value for it")
        if isinstance(value, str):
            try:
                return encode(self.type, value if self.data_type == "VISIBLE_STRING" else bytes.fromhex(value))
            except ValueError as error:
                raise DriveProfileError(f"object {self.address}: {error}") from None
        if self.scale == 1.0 and not self.unit and not self.type.is_real and isinstance(value, float) and not value.is_integer():
            # a choice or a count is refused where a quantity would be rounded to the drive's step
            raise OutOfRangeError(self.address, value, self.unit, f"is no whole number, which a {self.data_type} takes")
        raw = self.raw(value, scaling)
        return encode(self.type, bool(raw) if self.data_type == "BOOLEAN" else raw)

    def decoded(self, data: bytes, scaling: units.Scaling | None = None) -> float | str:
        """The value in ``unit`` that these bytes are; the inverse of `encoded`.

        Raises:
            ValueError: The length is not that of the type.
            DriveProfileError: The scaling is needed and was not given.
        """
        held = decode(self.type, data)
        if isinstance(held, bytes):
            return held.hex(" ")
        if isinstance(held, str):
            return held
        per_step = self.value_per_step(scaling)
        if per_step == 1.0 and not isinstance(held, float):
            return int(held)
        return units.shortest(held) if per_step == 1.0 and self.data_type == "REAL32" else held * per_step
