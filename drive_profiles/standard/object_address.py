"""Address of an object (index and sub-index), and its text."""

from typing import Annotated

import pydantic

ObjectAddress = tuple[int, int]
"""Index and sub-index of an object."""

WrittenAddress = Annotated[str, pydantic.Field(pattern=r"^[0-9A-F]{4}:[0-9A-F]{1,2}$")]
"""Address of an object as text: index and sub-index, hexadecimal, ``2101:1``."""


def object_address(text: str) -> ObjectAddress:
    """Return index and sub-index of a `WrittenAddress`."""
    index, _, subindex = text.partition(":")
    return int(index, 16), int(subindex or "0", 16)


def address_text(address: ObjectAddress) -> str:
    """Return the address of an object as text: ``2101:1``, hexadecimal."""
    return f"{address[0]:04X}:{address[1]:X}"
