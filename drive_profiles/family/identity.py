"""Facts that distinguish devices: identity, modes and SYNC periods."""

from typing import Annotated, Literal, Self

import pydantic

from drive_profiles.family.parameter import Fact
from drive_profiles.files.toml import Table

Unsigned32 = Annotated[int, pydantic.Field(ge=0, le=0xFFFF_FFFF)]

PRODUCT_NAME = r"[a-z0-9][a-z0-9._-]*"
"""Form of a product's name, which follows the family's: ``family/product``."""


class Firmware(Table):
    """Product code and range of revisions for which facts hold.

    The objects are 1018h:2 and 1018h:3.

    Attributes:
        product_code: Product code; None if it is not known, and every product counts as unverified.
        min_revision: Lowest revision number of a firmware for which the facts hold; None: from the first on.
        max_revision: Highest such revision number; None: up to the latest.
    """

    product_code: Unsigned32 | None = None
    min_revision: Unsigned32 | None = None
    max_revision: Unsigned32 | None = None

    @pydantic.model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min_revision is not None and self.max_revision is not None and self.min_revision > self.max_revision:
            raise ValueError(f"min_revision 0x{self.min_revision:X} is above max_revision 0x{self.max_revision:X}")
        return self

    @property
    def has_range(self) -> bool:
        """True if the facts hold for some firmware only."""
        return self.min_revision is not None or self.max_revision is not None

    def covers(self, revision: int | None) -> bool:
        """Return True if the facts hold for a revision."""
        if revision is None:
            return not self.has_range
        return (self.min_revision or 0) <= revision and (self.max_revision is None or revision <= self.max_revision)

    def overlaps(self, other: "Firmware") -> bool:
        """Return True if a device may be covered by both."""
        if self.product_code != other.product_code:
            return False
        starts = max(self.min_revision or 0, other.min_revision or 0)
        return all(each.max_revision is None or starts <= each.max_revision for each in (self, other))

    @property
    def range_in_words(self) -> str:
        """The range as text, empty if all revisions are in it."""
        if not self.has_range:
            return ""
        low = "" if self.min_revision is None else f" from 0x{self.min_revision:08X}"
        high = "" if self.max_revision is None else f" up to 0x{self.max_revision:08X}"
        return f"revision{low}{high}"


class Identity(Firmware, Fact):
    """Identity (1018h) of a family's first product.

    An upload compares it with the device's before it writes anything.

    Attributes:
        vendor_id: Vendor-ID, 1018h:1.
        product: Name of the product, where the family has several.
        revision: 1018h:3 for which the facts hold, if it is known; others are accepted unless there is a range.
        device_type: Device type, 1000h, if it is known.
    """

    vendor_id: Annotated[int, pydantic.Field(ge=1, le=0xFFFF_FFFF)]  # 0 is not a vendor (CiA 301, 1018h)
    product: str = pydantic.Field(default="", pattern=f"^(?:{PRODUCT_NAME})?$")
    revision: Unsigned32 | None = None
    device_type: Unsigned32 | None = None

    @property
    def typical_revision(self) -> int:
        """A revision number for which the facts hold, 0 if any does."""
        return (self.min_revision or 0) if self.revision is None else self.revision


class SyncLimits(Fact):
    """SYNC periods that the device follows; None if not known."""

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
