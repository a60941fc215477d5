"""One value in a drive's object dictionary, as a profile states it."""

import math
import sys
from collections.abc import Callable
from typing import Annotated, Literal, Self

import pydantic

from drive_profiles.errors import DriveProfileError, OutOfRangeError, beyond
from drive_profiles.files.toml import Table
from drive_profiles.standard import shown, units
from drive_profiles.standard.cia301 import DataType, Value, decode, encode
from drive_profiles.standard.object_address import ObjectAddress, address_text

ParameterClass = Literal["tuning", "limits", "communication", "commissioning"]
Evidence = Literal["definition", "standard", "eds", "documentation", "source code", "measured", "unverified"]
Effective = Literal["now", "disabled", "reset"]
LIMITS: dict[str, tuple[int, int]] = {"BOOLEAN": (0, 1)}
for _bits in (8, 16, 32, 64):
    LIMITS |= {f"INTEGER{_bits}": (-(1 << _bits - 1), (1 << _bits - 1) - 1), f"UNSIGNED{_bits}": (0, (1 << _bits) - 1)}
"""Least and greatest value of each integer type of CiA 301."""

BYTES = frozenset({"VISIBLE_STRING", "OCTET_STRING", "DOMAIN"})
"""Types without a fixed length; their values have no unit and no limits."""


class Fact(Table):
    """A table of a drive profile, with its source and evidence.

    Attributes:
        source: Document, file or measurement that states the facts.
        evidence: Strength of the source. Unverified facts are shown as such, and written to a drive only on request.
    """

    source: str = pydantic.Field(min_length=1)
    evidence: Evidence

    @property
    def is_verified(self) -> bool:
        """True if the evidence is better than a guess."""
        return self.evidence != "unverified"


class Parameter(Fact):
    """One value in the object dictionary.

    Attributes:
        index: Index of the object.
        subindex: Sub-index of the object.
        data_type: Name of the CiA 301 data type.
        unit: Printable unit of the value, the same as the suffix of its name; empty for a plain number.
        scale: Value per step on the wire; ``counts`` where the encoder decides (rad per count), ``per mille`` where the
            rated torque does (N·m per mille).
        access: Access as in an EDS.
        parameter_class: Class of the value, ``class`` in the file.
        minimum: Smallest value, in ``unit``.
        maximum: Largest value, in ``unit``.
        default: Factory setting, as it is on the wire; bytes as hexadecimal text.
        mappable: True if a PDO may carry the object.
        effective: Moment from which a written value acts: at once, only if written while disabled, or after a reset.
        order: Rank in the order of writing, lowest first; equal ranks are written as the file lists them.
        description: Effect of the parameter.
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
    def address(self) -> ObjectAddress:
        """Index and sub-index."""
        return self.index, self.subindex

    @property
    def written_address(self) -> str:
        """Address as text: ``2101:1``, hexadecimal."""
        return address_text(self.address)

    @property
    def type(self) -> DataType:
        """The CiA 301 data type."""
        return DataType[self.data_type]

    @property
    def is_bytes(self) -> bool:
        """True if the value is bytes or text rather than a number."""
        return self.data_type in BYTES

    @property
    def is_settable(self) -> bool:
        """True if the object is writable and takes several values."""
        low, high = LIMITS.get(self.data_type, (-math.inf, math.inf))
        least = low if self.minimum is None else max(low, self.minimum)
        greatest = high if self.maximum is None else min(high, self.maximum)
        return self.access == "rw" and least < greatest

    @property
    def step(self) -> str:
        """Value of one step on the wire, in words."""
        if isinstance(self.scale, str):
            return {"counts": "1 count", "per mille": "1 ‰ of 6076h"}[self.scale]
        return "" if self.is_bytes or self.type.is_real else f"{self.scale:g} {shown.unit(self.unit)}".rstrip()

    def default_bytes(self) -> bytes | None:
        """Return the bytes of the factory setting, or None.

        Raises:
            ValueError: The default is not of the data type.
        """
        if self.default is None:
            return None
        value: Value = self.default
        if self.is_bytes and self.data_type != "VISIBLE_STRING":
            if not isinstance(self.default, str):
                raise ValueError("expected bytes as hexadecimal text")
            value = bytes.fromhex(self.default)
        elif self.type.is_real and isinstance(self.default, int):
            value = float(self.default)
        return encode(self.type, value)

    def value_per_step(self, scaling: units.Scaling | None = None) -> float:
        """Return the value of one step on the wire, in ``unit``.

        Args:
            scaling: Scaling of the drive; needed where the scale depends on its encoder or rated torque.

        Raises:
            DriveProfileError: The scaling is needed and was not given.
        """
        if not isinstance(self.scale, str):
            return self.scale
        if scaling is None:
            raise DriveProfileError(f"object {self.written_address} counts in {self.scale}: the drive's scaling is needed")
        return 1.0 / scaling.counts_per_rad if self.scale == "counts" else scaling.torque_quantum_nm

    def raw(self, value: float, scaling: units.Scaling | None = None) -> int | float:
        """Return the number that the object holds for a value in ``unit``.

        It is an integer, or a rounded REAL32.

        Raises:
            OutOfRangeError: The value is outside the range of parameter or data type, or not finite.
            DriveProfileError: The scaling is needed and was not given, or the object holds bytes.
        """
        if self.is_bytes:
            raise DriveProfileError(f"object {self.written_address} holds bytes, not a number")
        real = self.type.is_real
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        per_step = self.value_per_step(scaling)
        low, high = (
            limit if math.isinf(limit) else self._as_read_back(limit, per_step, pick) for limit, pick in ((low, min), (high, max))
        )
        if not low <= value <= high or not -sys.float_info.max <= value <= sys.float_info.max:
            unlimited = math.isinf(low) and math.isinf(high)
            reason = f"is outside the range of {self.data_type}" if unlimited else beyond(low, high)
            raise OutOfRangeError(self.written_address, value, self.unit, reason)
        if real:
            held = value / per_step
            if self.data_type == "REAL32":
                return units.real32(held)
            if math.isinf(held):
                raise OutOfRangeError(self.written_address, value, self.unit, f"is outside the range of {self.data_type}")
            return held
        if per_step == 1.0 and (isinstance(value, int) or value.is_integer()):
            exact = int(value)  # 64 bits do not pass through a float
            if not LIMITS[self.data_type][0] <= exact <= LIMITS[self.data_type][1]:
                raise OutOfRangeError(self.written_address, value, self.unit, f"is outside the range of {self.data_type}")
            return exact
        return units.to_integer(value, LIMITS[self.data_type], self.written_address, self.unit, 1.0 / per_step)

    def _as_read_back(self, limit: float, per_step: float, pick: Callable[[float, float], float]) -> float:
        """Round a limit as the drive does, so that its value passes."""
        if self.data_type == "REAL32":
            return pick(limit, units.real32(limit / per_step) * per_step)
        nearest = limit if self.type.is_real else round(limit / per_step) * per_step
        return pick(limit, nearest) if math.isclose(limit, nearest, rel_tol=1e-12) else limit

    def value(self, raw: float, scaling: units.Scaling | None = None) -> float:
        """Return the value in ``unit`` of a held number, the inverse of `raw`."""
        return raw * self.value_per_step(scaling)

    def encoded(self, value: float | str, scaling: units.Scaling | None = None) -> bytes:
        """Encode a value in ``unit``.

        The value is text for a VISIBLE_STRING and hexadecimal text for bytes.

        Raises:
            OutOfRangeError: As for `raw`.
            DriveProfileError: As for `raw`; or a number is given for bytes, or text for a number.
        """
        if isinstance(value, str) != self.is_bytes:
            raise DriveProfileError(f"object {self.written_address}: {value!r} is not a value of {self.data_type}")
        if isinstance(value, str):
            try:
                return encode(self.type, value if self.data_type == "VISIBLE_STRING" else bytes.fromhex(value))
            except ValueError as error:
                raise DriveProfileError(f"object {self.written_address}: {error}") from None
        if self.scale == 1.0 and not self.unit and not self.type.is_real and isinstance(value, float) and not value.is_integer():
            # a choice or a count is refused where a quantity would be rounded to the drive's step
            raise OutOfRangeError(
                self.written_address, value, self.unit, f"is not a whole number; {self.data_type} holds only whole numbers"
            )
        raw = self.raw(value, scaling)
        return encode(self.type, bool(raw) if self.data_type == "BOOLEAN" else raw)

    def decoded(self, data: bytes, scaling: units.Scaling | None = None) -> float | str:
        """Return the value in ``unit`` of the object's bytes.

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
