"""A family of drives (or accelerometers) as data: who it is, what it can do, and which object holds which parameter.

The facts are in ``vendors/*.toml``, each with its source; nothing here rests on a factory setting.
"""

from __future__ import annotations

import difflib
import math
import re
from pathlib import Path
from typing import Annotated, Literal, Self

import pydantic

from drive_profiles import files, units
from drive_profiles.cia402 import Mode
from drive_profiles.errors import DriveProfileError, OutOfRangeError, ProfileNotFoundError, UnknownParameterError
from drive_profiles.files import UNIT_NAMES, Table, split_unit

VENDORS = Path(__file__).parent / "vendors"
_NAME = re.compile(r"[a-z0-9_-]+")

Unsigned32 = Annotated[int, pydantic.Field(ge=0, le=0xFFFF_FFFF)]
ParameterClass = Literal["tuning", "limits", "communication", "commissioning"]
Evidence = Literal["definition", "standard", "eds", "manual", "source code", "measured", "inferred"]

LIMITS: dict[str, tuple[int, int]] = {
    "BOOLEAN": (0, 1),
    "INTEGER8": (-(2**7), 2**7 - 1),
    "INTEGER16": units.INTEGER16,
    "INTEGER32": units.INTEGER32,
    "UNSIGNED8": (0, 2**8 - 1),
    "UNSIGNED16": units.UNSIGNED16,
    "UNSIGNED32": units.UNSIGNED32,
}
"""What the integer types of CiA 301 hold; REAL32 is the one type beside them."""


class Identity(Table):
    """1018h: what the upload compares before it writes anything."""

    vendor_id: Annotated[int, pydantic.Field(ge=1, le=0xFFFF_FFFF)]  # 0 is no vendor (CiA 301, 1018h)
    product_code: Unsigned32
    revision: Unsigned32


class SyncLimits(Table):
    """The SYNC periods that the device follows."""

    min_period_s: float = pydantic.Field(gt=0)
    max_period_s: float = pydantic.Field(gt=0)

    @pydantic.model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min_period_s > self.max_period_s:
            raise ValueError(f"min_period_s {self.min_period_s} is above max_period_s {self.max_period_s}")
        return self


class Capability(Table):
    """Whether the device can do a thing, and why that is said."""

    answer: Literal["exact", "yes", "approximate", "no"]
    reason: str = pydantic.Field(min_length=1)


class Capabilities(Table):
    """Where the loop and the notch can live.

    Attributes:
        p_pi_inside: The drive closes position P and velocity PI itself.
        notch_inside: It holds the notch; exact when it is the paper's filter rather than a fit to it.
        notch_variable_while_moving: The notch follows the speed during a motion.
        host_closed: The host can close the loop over the bus by torque, cyclically.
    """

    p_pi_inside: Capability
    notch_inside: Capability
    notch_variable_while_moving: Capability
    host_closed: Capability


class Parameter(Table):
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
        description: What it does.
        source: Where this is written.
        evidence: How it is known.
    """

    index: int = pydantic.Field(ge=0x1000, le=0xFFFF)
    subindex: int = pydantic.Field(ge=0, le=0xFE)
    data_type: Literal["BOOLEAN", "INTEGER8", "INTEGER16", "INTEGER32", "UNSIGNED8", "UNSIGNED16", "UNSIGNED32", "REAL32"]
    unit: str = ""
    scale: Annotated[float, pydantic.Field(gt=0)] | Literal["counts", "per mille"] = 1.0
    access: Literal["rw", "ro"] = "rw"
    parameter_class: ParameterClass = pydantic.Field(alias="class")
    minimum: float | None = None
    maximum: float | None = None
    description: str = pydantic.Field(min_length=1)
    source: str = pydantic.Field(min_length=1)
    evidence: Evidence

    @property
    def address(self) -> str:
        """The object as it is written down: ``2101:1``, hexadecimal."""
        return f"{self.index:04X}:{self.subindex:X}"

    @property
    def step(self) -> str:
        """What one step on the wire is, in words."""
        if isinstance(self.scale, str):
            return {"counts": "1 count", "per mille": "1 ‰ of 6076h"}[self.scale]
        return "" if self.data_type == "REAL32" else f"{self.scale:g} {self.unit}".rstrip()

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
            DriveProfileError: The scaling is needed and was not given.
        """
        real = self.data_type == "REAL32"
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        if real:  # a limit as the drive holds it, else a value read back at 0.01 would be refused as 0.0099999998
            low = low if math.isinf(low) else min(low, units.real32(low))
            high = high if math.isinf(high) else max(high, units.real32(high))
        if not low <= value <= high:
            raise OutOfRangeError(self.address, value, self.unit, f"is outside {low:g} to {high:g}")
        per_step = self.value_per_step(scaling)
        if real:
            return units.real32(value / per_step)
        return units.to_integer(value, LIMITS[self.data_type], self.address, self.unit, 1.0 / per_step)

    def value(self, raw: float, scaling: units.Scaling | None = None) -> float:
        """The value in ``unit`` of what the object holds; the inverse of `raw`."""
        return raw * self.value_per_step(scaling)


class Profile(Table):
    """A family of devices as a file states it.

    Attributes:
        name: As the file is called.
        title: For people.
        kind: What it is.
        device_type: 1000h.
        identity: 1018h.
        modes: CiA 402 modes by their short names, empty for an accelerometer.
        sync: SYNC periods it follows.
        control_period_s: Of the loop inside the drive; the notch inside runs at it.
        capabilities: Of a drive.
        parameters: By name; the names are those of the robot file, with their units.
    """

    name: str = pydantic.Field(pattern=r"^[a-z0-9_-]+$")
    title: str = pydantic.Field(min_length=1)
    kind: Literal["drive", "accelerometer"]
    device_type: Unsigned32
    identity: Identity
    modes: tuple[Literal["PP", "PV", "TQ", "HM", "IP", "CSP", "CSV", "CST"], ...] = ()
    sync: SyncLimits
    control_period_s: float | None = pydantic.Field(default=None, gt=0)
    capabilities: Capabilities | None = None
    parameters: dict[str, Parameter]

    @pydantic.field_validator("parameters")
    @classmethod
    def _consistent(cls, parameters: dict[str, Parameter]) -> dict[str, Parameter]:
        """One object holds one parameter, and the unit in a name is the unit of the value."""
        objects: dict[tuple[int, int], str] = {}
        for name, parameter in parameters.items():
            first = objects.setdefault((parameter.index, parameter.subindex), name)
            if first != name:
                raise ValueError(f"{first} and {name} are both in object {parameter.address}")
            unit = UNIT_NAMES.get(split_unit(name)[1], "")
            if unit and parameter.unit != unit:
                raise ValueError(f"{name} says {unit}, its unit says {parameter.unit or 'nothing'}")
        return parameters

    @pydantic.model_validator(mode="after")
    def _complete(self) -> Self:
        if self.kind == "drive" and (not self.modes or self.capabilities is None or self.control_period_s is None):
            raise ValueError("a drive states modes, capabilities and control_period_s")
        return self

    @classmethod
    def load(cls, name_or_path: str | Path) -> Self:
        """A profile of the package by its name, or of any file by its path.

        Nothing is searched for: a bare name is looked up in the package only, never in the working directory.

        Args:
            name_or_path: A name of ``[a-z0-9_-]+``; anything else, and any `Path`, is a path.

        Raises:
            ProfileNotFoundError: The package has no such profile.
            FileError: The file has errors; all of them are listed.
        """
        if isinstance(name_or_path, str) and _NAME.fullmatch(name_or_path):
            if name_or_path not in available():
                raise ProfileNotFoundError(name_or_path, tuple(available()))
            return files.load(VENDORS / f"{name_or_path}.toml", cls)
        return files.load(name_or_path, cls)

    @property
    def supported_modes(self) -> tuple[Mode, ...]:
        """The modes as CiA 402 numbers them."""
        return tuple(Mode[mode] for mode in self.modes)

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name.

        Raises:
            UnknownParameterError: There is none.
        """
        try:
            return self.parameters[name]
        except KeyError:
            close = difflib.get_close_matches(name, self.parameters, n=3)
            raise UnknownParameterError(self.name, name, tuple(close)) from None

    def in_class(self, parameter_class: ParameterClass) -> dict[str, Parameter]:
        """The parameters of one class, in the order of the file."""
        return {name: entry for name, entry in self.parameters.items() if entry.parameter_class == parameter_class}


def available() -> list[str]:
    """Names of the profiles in the package."""
    return sorted(path.stem for path in VENDORS.glob("*.toml") if _NAME.fullmatch(path.stem))
