"""A further product of a family, stated by its differences."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

import pydantic

from drive_profiles.family.capability import (
    Capability,
    EncoderFacts,
    LoadEncoderFacts,
    LoopFacts,
    NotchFacts,
    PositionModeFacts,
    StoreFacts,
    TorqueFacts,
)
from drive_profiles.family.identity import PRODUCT_NAME, Firmware, Modes, SyncLimits, Unsigned32
from drive_profiles.family.parameter import Effective, Evidence, Fact, Parameter, ParameterClass
from drive_profiles.files.toml import Table

Question = Literal[
    "p_pi_inside", "notch_inside", "notch_variable_while_moving", "host_closed", "reference_correction", "torque_offset"
]


def in_words(error: pydantic.ValidationError) -> str:
    """Return the errors of a table in one line."""
    said = []
    for each in error.errors(include_url=False):
        key = ".".join(map(str, each["loc"]))
        message = each["msg"].removeprefix("Value error, ")
        said.append(f"{key}: {message}" if key else message)
    return "; ".join(said)


class ParameterChange(Table):
    """Differences of one parameter between a product and the first one.

    Each key of a parameter may be left out. Source and evidence are the product's, unless they are given. A parameter that
    the first product lacks is stated whole.

    Attributes:
        without: Keys that the first product's parameter has and this one has not.
    """

    index: int | None = pydantic.Field(default=None, ge=0x1000, le=0xFFFF)
    subindex: int | None = pydantic.Field(default=None, ge=0, le=0xFE)
    data_type: str | None = None
    unit: str | None = None
    scale: Annotated[float, pydantic.Field(gt=0)] | Literal["counts", "per mille"] | None = None
    access: Literal["rw", "ro", "wo"] | None = None
    parameter_class: ParameterClass | None = pydantic.Field(default=None, alias="class")
    minimum: float | None = None
    maximum: float | None = None
    default: int | float | str | None = None
    mappable: bool | None = None
    effective: Effective | None = None
    order: int | None = None
    description: str | None = None
    source: str | None = pydantic.Field(default=None, min_length=1)
    evidence: Evidence | None = None
    without: tuple[Literal["minimum", "maximum", "default"], ...] = ()

    def of(self, first: Parameter | None, product: Fact) -> Parameter:
        """Return the parameter as the product has it, from the first product's.

        Raises:
            ValueError: What comes out is not a parameter; the text names each key.
        """
        known: dict[str, Any] = {} if first is None else first.model_dump(by_alias=True)
        known |= {"source": product.source}
        if first is None or first.is_verified:  # a guess about the unit is none the better for a limit from a file
            known |= {"evidence": product.evidence}
        known |= {key: value for key, value in self.model_dump(by_alias=True, exclude={"without"}).items() if value is not None}
        known |= dict.fromkeys(self.without)
        try:
            return Parameter.model_validate(known)
        except pydantic.ValidationError as error:
            raise ValueError(in_words(error)) from None


class Product(Firmware, Fact):
    """A further product of a family, stated by its differences.

    A table of facts that is given replaces the first product's; a capability replaces that answer alone.

    Attributes:
        name: Name behind the family's: ``family/name``.
        title: Name for people.
        revision: 1018h:3 for which the facts hold, if it is known.
        device_type: Device type, 1000h, where it is not the first product's.
        modes: CiA 402 modes of the drive.
        position_mode: A mode of the maker's own that takes positions cyclically.
        sync: SYNC periods that it follows.
        loop: Its own control loop.
        notch: Its filter.
        torque: Torques on the bus.
        encoder: Unit of positions on the bus.
        load_encoder: Second encoder.
        store: Commands that store and restore.
        capabilities: Answers that are other than the first product's.
        quirks: Peculiarities that come to the family's.
        absent: Names of the family's parameters that it does not have.
        parameters: Parameters that are other, by name, and those that the first product does not have.
    """

    name: str = pydantic.Field(pattern=f"^{PRODUCT_NAME}$")
    title: str = pydantic.Field(min_length=1)
    revision: Unsigned32 | None = None
    device_type: Unsigned32 | None = None
    modes: Modes | None = None
    position_mode: PositionModeFacts | None = None
    sync: SyncLimits | None = None
    loop: LoopFacts | None = None
    notch: NotchFacts | None = None
    torque: TorqueFacts | None = None
    encoder: EncoderFacts | None = None
    load_encoder: LoadEncoderFacts | None = None
    store: StoreFacts | None = None
    capabilities: dict[Question, Capability] = pydantic.Field(default_factory=dict)
    quirks: tuple[str, ...] = ()
    absent: tuple[str, ...] = ()
    parameters: dict[str, ParameterChange] = pydantic.Field(default_factory=dict)

    @pydantic.model_validator(mode="after")
    def _either(self) -> Self:
        both = sorted(set(self.absent) & set(self.parameters))
        if both:
            raise ValueError(f"listed as absent, but described: {', '.join(both)}")
        return self

    @property
    def facts(self) -> dict[str, Fact]:
        """The tables of facts that replace the first product's, by name."""
        tables = ("modes", "position_mode", "sync", "loop", "notch", "torque", "encoder", "load_encoder", "store")
        named = {name: getattr(self, name) for name in tables}
        return {name: fact for name, fact in named.items() if fact is not None}

    def parameters_of(self, first: Mapping[str, Parameter]) -> dict[str, Parameter]:
        """Return the product's parameters in the order of the first product's.

        Raises:
            ValueError: An absent parameter is none of the family's, or a change makes no parameter.
        """
        unknown = sorted(set(self.absent) - set(first))
        if unknown:
            raise ValueError(f"absent names parameters that the family does not have: {', '.join(unknown)}")
        own = {name: entry for name, entry in first.items() if name not in self.absent}
        for name, change in self.parameters.items():
            try:
                own[name] = change.of(first.get(name), self)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
        return own
