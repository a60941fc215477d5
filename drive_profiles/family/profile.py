"""A family of drives (or accelerometers) as data.

The facts are in ``vendors/*.toml``, each with its source and evidence; none of them rests on a factory setting.
"""

import difflib
import functools
import re
from pathlib import Path
from typing import Any, Literal, Self, cast

import pydantic

from drive_profiles.errors import ProfileNotFoundError, UnknownParameterError, UnknownProductError
from drive_profiles.family.capability import (
    Abort,
    Capabilities,
    EncoderFacts,
    FaultCode,
    LoadEncoderFacts,
    LoopFacts,
    NotchFacts,
    PositionModeFacts,
    StoreFacts,
    TorqueFacts,
    gain_unit,
)
from drive_profiles.family.identity import PRODUCT_NAME, Identity, Modes, SyncLimits
from drive_profiles.family.parameter import Parameter
from drive_profiles.family.product import Product, in_words
from drive_profiles.files import toml as files
from drive_profiles.files.toml import UNIT_NAMES, Table, split_unit
from drive_profiles.standard.cia402 import Mode
from drive_profiles.standard.object_address import ObjectAddress

VENDORS = Path(__file__).parents[1] / "vendors"
_NAME = re.compile(r"[a-z0-9_-]+")
_OF_A_PRODUCT = re.compile(rf"(?P<family>[a-z0-9_-]+|.+\.toml)/(?!.*\.toml$)(?P<product>{PRODUCT_NAME})", re.IGNORECASE)


class Profile(Table):
    """Drive profile: a family of devices as a file states it.

    Attributes:
        name: Name of the file without its suffix.
        title: Name of the family for people.
        kind: Type of the device.
        identity: 1000h and 1018h of the devices.
        modes: CiA 402 modes of a drive.
        position_mode: A mode of the maker's own that takes positions cyclically; None if it has none.
        sync: SYNC periods that the device follows.
        capabilities: Capabilities of a drive for the paper's loop.
        loop: The drive's own control loop.
        notch: The drive's filter; None if it has none.
        torque: Torques on the bus.
        encoder: Unit of positions on the bus.
        load_encoder: Second encoder; None if nothing is known of one.
        store: Commands that store and restore parameters.
        aborts: The maker's own abort codes.
        fault_codes: The maker's own error codes, of emergencies, 603Fh and 1003h.
        quirks: Peculiarities that a user of this family must know, one sentence each.
        parameters: Parameters by name. A name is that of the robot file, with its unit, where the meaning is the same.
        products: The further products, ``[[product]]`` in the file; all other tables are those of the first one.
    """

    name: str = pydantic.Field(pattern=r"^[a-z0-9_-]+$")
    title: str = pydantic.Field(min_length=1)
    kind: Literal["drive", "accelerometer"]
    identity: Identity
    modes: Modes | None = None
    position_mode: PositionModeFacts | None = None
    sync: SyncLimits
    capabilities: Capabilities | None = None
    loop: LoopFacts | None = None
    notch: NotchFacts | None = None
    torque: TorqueFacts | None = None
    encoder: EncoderFacts | None = None
    load_encoder: LoadEncoderFacts | None = None
    store: StoreFacts
    aborts: tuple[Abort, ...] = ()
    fault_codes: tuple[FaultCode, ...] = ()
    quirks: tuple[str, ...] = ()
    parameters: dict[str, Parameter]
    products: tuple[Product, ...] = pydantic.Field(default=(), alias="product")

    @pydantic.field_validator("fault_codes")
    @classmethod
    def _once(cls, codes: tuple[FaultCode, ...]) -> tuple[FaultCode, ...]:
        """Refuse a code with two meanings."""
        stated = [each.code for each in codes]
        twice = sorted({code for code in stated if stated.count(code) > 1})
        if twice:
            raise ValueError(f"{twice[0]:04X}h is given twice")
        return codes

    @pydantic.field_validator("parameters")
    @classmethod
    def _consistent(cls, parameters: dict[str, Parameter]) -> dict[str, Parameter]:
        """Refuse a shared object, and a name with the wrong unit."""
        objects: dict[ObjectAddress, str] = {}
        for name, parameter in parameters.items():
            first = objects.setdefault(parameter.address, name)
            if first != name:
                raise ValueError(f"{first} and {name} are both in object {parameter.address}")
            unit = UNIT_NAMES.get(split_unit(name)[1], "")
            if unit and parameter.unit != unit:
                raise ValueError(f"{name} ends in a unit, {unit}, but states unit = {parameter.unit!r}; make them the same")
        return parameters

    @pydantic.model_validator(mode="after")
    def _complete(self) -> Self:
        stated = (self.modes, self.capabilities, self.loop, self.torque, self.encoder)
        if self.kind == "drive" and None in stated:
            raise ValueError("a drive profile needs modes, capabilities, loop, torque and encoder")
        named = {gain.parameter for gain in self.loop.gains.values()} if self.loop else set()
        for section in self.notch.sections if self.notch else ():
            named |= set(section.parts.values()) | set(section.settings)
        missing = sorted(named - set(self.parameters))
        if missing:
            raise ValueError(f"loop or notch name parameters that are not there: {', '.join(missing)}")
        if self.notch is None and self.capabilities is not None and self.capabilities.notch_inside.answer in {"exact", "yes"}:
            raise ValueError("capabilities.notch_inside says yes, but there is no notch table")
        return self

    @pydantic.model_validator(mode="after")
    def _distinct(self) -> Self:
        """Refuse products with equal names, overlapping identities or incomplete facts."""
        if self.products and not self.identity.product:
            raise ValueError("identity.product is missing: a family of several products must name its first product")
        names = [self.identity.product, *(product.name for product in self.products)]
        for number, product in enumerate(self.products):
            if product.name in names[: number + 1]:
                raise ValueError(f"product {product.name} is given twice")
            for other in self.products[:number]:
                if product.product_code is not None and product.overlaps(other):
                    raise ValueError(f"{other.name} and {product.name} have the same product code and firmware")
            try:
                self._as(product)
            except ValueError as error:
                raise ValueError(f"product {product.name}: {error}") from None
        return self

    def unit_of(self, name: str) -> str:
        """Return a parameter's unit; a gain's follows from the loop's facts."""
        parameter = self.parameters.get(name)
        if parameter is None or parameter.unit or self.loop is None:
            return "" if parameter is None else parameter.unit
        return next((gain_unit(role, gain) for role, gain in self.loop.gains.items() if gain.parameter == name), "")

    @classmethod
    def load(cls, name_or_path: str | Path) -> Self:
        """Read a profile by name or path; ``/product`` chooses one product.

        A bare name is looked up in the package only, never in the working directory; any `Path` is a file.

        Raises:
            ProfileNotFoundError: The package has no such profile.
            UnknownProductError: The profile names no such product.
            FileError: The file has errors; all of them are listed.
        """
        family, product = _split(name_or_path)
        if isinstance(family, str) and _NAME.fullmatch(family):
            if family not in available():
                raise ProfileNotFoundError(family, tuple(available()))
            file = VENDORS / f"{family}.toml"
            profile = cast("Self", _packaged(cls, file, file.stat().st_mtime_ns))
        elif isinstance(family, str) and _OF_A_PRODUCT.fullmatch(family) and not Path(family).exists():
            raise ProfileNotFoundError(family.partition("/")[0], tuple(available()))  # rather than a path that nobody meant
        else:
            profile = files.load(family, cls)
        return profile.product_named(product) if product else profile

    @property
    def fault_texts(self) -> dict[int, str]:
        """The maker's own error codes in words."""
        return {each.code: each.text for each in self.fault_codes}

    @property
    def label(self) -> str:
        """Name of the profile as a user writes it."""
        return f"{self.name}/{self.identity.product}" if self.identity.product and not self.products else self.name

    @property
    def members(self) -> tuple[Self, ...]:
        """Profiles of all products, the first product's first."""
        first = self.model_copy(update={"products": ()}) if self.products else self
        return (first, *map(self._as, self.products))

    def candidates(self, product_code: int | None, revision: int | None = None) -> tuple[Self, ...]:
        """Return the products that a device may be, as profiles.

        Products are told apart by product code (1018h:2) and revision (1018h:3), None where the device states none. If no product
        has that code, it may be each of those whose code is not known.
        """
        first, *others = self.members
        coded = [each for each in (*others, first) if product_code is not None and each.identity.product_code == product_code]
        if coded:  # the first product comes last: it is for the firmware that no other names
            return tuple(each for each in coded if each.identity.covers(revision))[:1]
        return tuple(each for each in (first, *others) if each.identity.product_code is None)

    def product(self, product_code: int | None, revision: int | None = None) -> Self:
        """Return the profile of the product that a device is, by 1018h.

        If several products have no known code, the first of them is taken.

        Raises:
            UnknownProductError: The profile names no product, or no firmware, of this identity.
        """
        found = self.candidates(product_code, revision)
        if not found:
            raise UnknownProductError(self.label, product_code, revision, tuple(self.products_in_words))
        return found[0]

    def product_named(self, name: str) -> Self:
        """Return the profile of the product of a name.

        Raises:
            UnknownProductError: The profile names no such product.
        """
        wanted = name.casefold()
        for member in self.members:
            if member.identity.product and member.identity.product == wanted:
                return member
        raise UnknownProductError(self.name, name, None, tuple(self.products_in_words))

    @property
    def products_in_words(self) -> list[str]:
        """The products by code and name, as messages show them."""
        shown = []
        for identity in (member.identity for member in self.members):
            code = "any product" if identity.product_code is None else f"0x{identity.product_code:X}"
            details = ", ".join(filter(None, (identity.product if self.products else "", identity.range_in_words)))
            shown.append(f"{code} ({details})" if details else code)
        return shown

    def _as(self, product: Product) -> Self:
        """Return the profile of a further product.

        Raises:
            ValueError: It does not come out whole.
        """
        identity, own = self.identity, product.model_dump(include=set(Identity.model_fields))
        stated: dict[str, Any] = {name: getattr(self, name) for name in type(self).model_fields}
        stated |= product.facts
        stated |= {
            "title": product.title,
            "identity": Identity(
                vendor_id=identity.vendor_id,
                product=product.name,
                **own | {"device_type": identity.device_type if product.device_type is None else product.device_type},
            ),
            "quirks": (*self.quirks, *product.quirks),
            "parameters": product.parameters_of(self.parameters),
        }
        if self.capabilities is not None:
            stated["capabilities"] = self.capabilities.model_copy(
                update={str(name): answer for name, answer in product.capabilities.items()}
            )
        del stated["products"]
        try:
            return type(self).model_validate(stated)
        except pydantic.ValidationError as error:
            raise ValueError(in_words(error)) from None

    @property
    def supported_modes(self) -> tuple[Mode, ...]:
        """The modes as CiA 402 numbers them."""
        return () if self.modes is None else tuple(Mode[name] for name in self.modes.names)

    def parameter(self, name: str) -> Parameter:
        """Return the parameter of a name.

        Raises:
            UnknownParameterError: The profile has no such parameter.
        """
        try:
            return self.parameters[name]
        except KeyError:
            close = difflib.get_close_matches(name, self.parameters, n=3)
            raise UnknownParameterError(self.name, name, tuple(close)) from None

    def is_fixed(self, address: ObjectAddress) -> bool:
        """Return True if the profile marks an object as constant."""
        return any(entry.address == address and not entry.is_settable for entry in self.parameters.values())


def available() -> list[str]:
    """Return the names of the profiles in the package."""
    return sorted(path.stem for path in VENDORS.glob("*.toml") if _NAME.fullmatch(path.stem))


def known_name(text: str) -> str:
    """Return a profile's name if the package has it, or a path.

    Raises:
        ProfileNotFoundError: The package has no such profile.
        UnknownProductError: The profile names no such product.
    """
    if is_name(text) and text not in available():
        Profile.load(text)
    return text


def file_of(text: str, folder: Path) -> Path | None:
    """Return the file that a profile's path names; None for a name."""
    return None if is_name(text) else folder / _split(text)[0]


def is_name(text: str) -> bool:
    """Return True for a profile name, False for a path."""
    family, _ = _split(text)
    return isinstance(family, str) and _NAME.fullmatch(family) is not None


@functools.lru_cache(maxsize=64)
def _packaged(model: type[Profile], file: Path, written_ns: int) -> Profile:
    """Read a profile of the package, cached until its file changes."""
    return files.load(file, model)


def _split(text: str | Path) -> tuple[str | Path, str]:
    """Split a text into family or file, and product (or None)."""
    match = _OF_A_PRODUCT.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        return text, ""
    family = match["family"]
    is_file = family.lower().endswith(".toml")
    return (family, match["product"]) if is_file or family in available() else (text, "")
