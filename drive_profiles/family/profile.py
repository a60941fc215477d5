"""A family of drives (or accelerometers) as data: its identity, its capabilities, and the object of each parameter.

The facts are in ``vendors/*.toml``, each with its source and evidence; none of them rests on a factory setting.
"""

from __future__ import annotations

import difflib
import re
from pathlib import Path
from typing import Annotated, Literal, Self

import pydantic

from drive_profiles.errors import ProfileNotFoundError, UnknownParameterError
from drive_profiles.family.capability import (
    Abort,
    Capabilities,
    EncoderFacts,
    LoopFacts,
    NotchFacts,
    StoreFacts,
    TorqueFacts,
    gain_unit,
)
from drive_profiles.family.parameter import Fact, Parameter, ParameterClass
from drive_profiles.files import toml as files
from drive_profiles.files.toml import UNIT_NAMES, Table, split_unit
from drive_profiles.standard.cia402 import Mode
from drive_profiles.standard.object_address import ObjectAddress

VENDORS = Path(__file__).parents[1] / "vendors"
_NAME = re.compile(r"[a-z0-9_-]+")

Unsigned32 = Annotated[int, pydantic.Field(ge=0, le=0xFFFF_FFFF)]


class Identity(Fact):
    """Identity of a family (1018h), which an upload compares before it writes anything.

    Attributes:
        vendor_id: Vendor-ID, 1018h:1.
        product_code: 1018h:2 of the family's main product; None where it is not known, and every product counts as unverified.
        other_products: Product codes of further members of the family, by name.
        revision: 1018h:3 for which the facts hold, where it is known; others are accepted.
        device_type: Device type, 1000h, where it is known.
    """

    vendor_id: Annotated[int, pydantic.Field(ge=1, le=0xFFFF_FFFF)]  # 0 is no vendor (CiA 301, 1018h)
    product_code: Unsigned32 | None = None
    other_products: dict[str, Unsigned32] = pydantic.Field(default_factory=dict)
    revision: Unsigned32 | None = None
    device_type: Unsigned32 | None = None

    @property
    def product_codes(self) -> tuple[int, ...]:
        """All product codes of the family; empty where none is known."""
        main = () if self.product_code is None else (self.product_code,)
        return (*main, *self.other_products.values())


class SyncLimits(Fact):
    """The SYNC periods that the device follows; None where that is not known."""

    min_period_s: float | None = pydantic.Field(default=None, gt=0)
    max_period_s: float | None = pydantic.Field(default=None, gt=0)
    note: str = ""

    @pydantic.model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min_period_s is not None and self.max_period_s is not None and self.min_period_s > self.max_period_s:
            raise ValueError(f"min_period_s {self.min_period_s} is above max_period_s {self.max_period_s}")
        return self


class Modes(Fact):
    """The CiA 402 modes that the drive has."""

    names: tuple[Literal["PP", "PV", "TQ", "HM", "IP", "CSP", "CSV", "CST"], ...]
    note: str = ""


class Profile(Table):
    """Drive profile: a family of devices as a file states it.

    Attributes:
        name: Name of the file without its suffix.
        title: Name of the family for people.
        kind: Type of the device.
        identity: 1000h and 1018h of the devices.
        modes: CiA 402 modes of a drive.
        sync: SYNC periods that the device follows.
        capabilities: Capabilities of a drive for the paper's loop.
        loop: The drive's own control loop.
        notch: The drive's filter; None where it has none.
        torque: Torques on the bus.
        encoder: Unit of positions on the bus.
        store: Commands that store and restore parameters.
        aborts: Vendor-specific abort codes.
        quirks: Peculiarities that a user of this family must know, one sentence each.
        parameters: Parameters by name. A name is that of the robot file, with its unit, where the meaning is the same.
    """

    name: str = pydantic.Field(pattern=r"^[a-z0-9_-]+$")
    title: str = pydantic.Field(min_length=1)
    kind: Literal["drive", "accelerometer"]
    identity: Identity
    modes: Modes | None = None
    sync: SyncLimits
    capabilities: Capabilities | None = None
    loop: LoopFacts | None = None
    notch: NotchFacts | None = None
    torque: TorqueFacts | None = None
    encoder: EncoderFacts | None = None
    store: StoreFacts
    aborts: tuple[Abort, ...] = ()
    quirks: tuple[str, ...] = ()
    parameters: dict[str, Parameter]

    @pydantic.field_validator("parameters")
    @classmethod
    def _consistent(cls, parameters: dict[str, Parameter]) -> dict[str, Parameter]:
        """Refuse an object that holds two parameters, and a name whose unit is not that of the value."""
        objects: dict[ObjectAddress, str] = {}
        for name, parameter in parameters.items():
            first = objects.setdefault(parameter.address, name)
            if first != name:
                raise ValueError(f"{first} and {name} are both in object {parameter.address}")
            unit = UNIT_NAMES.get(split_unit(name)[1], "")
            if unit and parameter.unit != unit:
                raise ValueError(f"{name} says {unit}, its unit says {parameter.unit or 'nothing'}")
        return parameters

    @pydantic.model_validator(mode="after")
    def _complete(self) -> Self:
        stated = (self.modes, self.capabilities, self.loop, self.torque, self.encoder)
        if self.kind == "drive" and None in stated:
            raise ValueError("a drive states modes, capabilities, loop, torque and encoder")
        named = {gain.parameter for gain in self.loop.gains.values()} if self.loop else set()
        for section in self.notch.sections if self.notch else ():
            named |= set(section.parts.values()) | set(section.settings)
        missing = sorted(named - set(self.parameters))
        if missing:
            raise ValueError(f"loop or notch name parameters that are not there: {', '.join(missing)}")
        if self.notch is None and self.capabilities is not None and self.capabilities.notch_inside.answer in {"exact", "yes"}:
            raise ValueError("capabilities.notch_inside says yes, but there is no notch table")
        return self

    def unit_of(self, name: str) -> str:
        """Unit of a parameter's value: its own, or what the loop's facts make of a gain that has none."""
        parameter = self.parameters.get(name)
        if parameter is None or parameter.unit or self.loop is None:
            return "" if parameter is None else parameter.unit
        return next((gain_unit(role, gain) for role, gain in self.loop.gains.items() if gain.parameter == name), "")

    @classmethod
    def load(cls, name_or_path: str | Path) -> Self:
        """Read a profile of the package by its name, or of any file by its path.

        A bare name is looked up in the package only, never in the working directory.

        Args:
            name_or_path: A name of ``[a-z0-9_-]+``; other text, and any `Path`, is a path.

        Raises:
            ProfileNotFoundError: The package has no such profile.
            FileError: The file has errors; all of them are listed.
        """
        if isinstance(name_or_path, str) and is_profile_name(name_or_path):
            if name_or_path not in available():
                raise ProfileNotFoundError(name_or_path, tuple(available()))
            return files.load(VENDORS / f"{name_or_path}.toml", cls)
        return files.load(name_or_path, cls)

    @property
    def supported_modes(self) -> tuple[Mode, ...]:
        """The modes as CiA 402 numbers them."""
        return () if self.modes is None else tuple(Mode[name] for name in self.modes.names)

    def parameter(self, name: str) -> Parameter:
        """Parameter of a name.

        Raises:
            UnknownParameterError: The profile has no such parameter.
        """
        try:
            return self.parameters[name]
        except KeyError:
            close = difflib.get_close_matches(name, self.parameters, n=3)
            raise UnknownParameterError(self.name, name, tuple(close)) from None

    def in_class(self, parameter_class: ParameterClass) -> dict[str, Parameter]:
        """The parameters of one class, in the order of the file."""
        return {name: entry for name, entry in self.parameters.items() if entry.parameter_class == parameter_class}


def is_profile_name(text: str) -> bool:
    """True where a text is taken for the name of a profile in the package, and not for a path."""
    return _NAME.fullmatch(text) is not None


def available() -> list[str]:
    """Names of the profiles in the package."""
    return sorted(path.stem for path in VENDORS.glob("*.toml") if _NAME.fullmatch(path.stem))
