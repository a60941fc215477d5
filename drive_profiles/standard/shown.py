"""Values as they are shown to people.

Numbers have four digits and units, words of bits are hexadecimal. Files and JSON hold all digits.
"""

import math
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # --help must not wait for pydantic
    from drive_profiles.standard.cia301 import DataType
    from drive_profiles.standard.object_address import ObjectAddress

DIGITS = 4
_EXACT = 17
_UNITS = {"us": "µs", "per mille": "‰", "per mille/s": "‰/s", "rps": "rev/s", "rps/s": "rev/s²", "deg": "°"}
_BITS: frozenset[tuple[int, int]] = frozenset(
    {(index, 0) for index in (0x1000, 0x1001, 0x1002, 0x1005, 0x1012, 0x1014, 0x603F, 0x6040, 0x6041, 0x60A8, 0x60A9, 0x60AA)}
    | {(index, 0) for index in (0x607E, 0x60FD, 0x6502, 0x67FF)}
    | {(0x1018, subindex) for subindex in (1, 2, 3)}
    | {(0x60FE, 1), (0x60FE, 2)}
)
"""Objects that hold bits, codes or identifiers. Source: CiA 301, 7.5.2; CiA 402-2."""
_BITS_FROM_SUBINDEX_1 = (range(0x1003, 0x1004), range(0x1010, 0x1012), range(0x1016, 0x1017), range(0x1028, 0x1029))
_COB_IDS = ((range(0x1200, 0x1300), (1, 2)), (range(0x1400, 0x1600), (1,)), (range(0x1800, 0x1A00), (1,)))
MAPPINGS = (range(0x1600, 0x1800), range(0x1A00, 0x1C00))


def is_hexadecimal(address: "ObjectAddress") -> bool:
    """Return True for bits, codes, identities, COB-IDs and PDO mappings."""
    index, subindex = address
    if address in _BITS:
        return True
    if any(index in block and subindex in subindices for block, subindices in _COB_IDS):
        return True
    return subindex > 0 and any(index in block for block in (*_BITS_FROM_SUBINDEX_1, *MAPPINGS))


def unit(text: str) -> str:
    """Return the unit's spelling for people.

    Files and JSON keep their own spelling.

    >>> unit("us"), unit("rev/s")
    ('µs', 'rev/s')
    """
    return _UNITS.get(text, text)


def number(value: float, digits: int = DIGITS) -> str:
    """Format a number with four significant digits.

    Whole numbers keep all digits, and large numbers below 10⁹ have no power of ten.

    >>> number(3.7997330000000002), number(25132.741), number(100000), number(1.5e-7)
    ('3.8', '25133', '100000', '1.5e-07')
    """
    if isinstance(value, int) or (math.isfinite(value) and value.is_integer() and abs(value) < 1e15):
        return str(int(value))
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in text and abs(value) < 1e9 else text


def measured(value: float, error: float) -> str:
    """Format a value with its standard error.

    Both end at the second digit of the error.

    >>> measured(48950.23, 38.4), measured(12.4331, 0.0042)
    ('48950 ± 38', '12.4331 ± 0.0042')
    """
    if not (math.isfinite(value) and math.isfinite(error) and error > 0.0):
        return f"{number(value)} ± {number(error)}"
    decimals = 1 - math.floor(math.log10(error))
    return f"{value:.{max(decimals, 0)}f} ± {error:.{max(decimals, 0)}f}"


def value(held: float | str, address: "ObjectAddress", data_type: "DataType | None" = None, digits: int = DIGITS) -> str:
    """Format an object's value; hexadecimal ones have all digits of their type."""
    if isinstance(held, str):
        return held
    if isinstance(held, int) and held >= 0 and is_hexadecimal(address):
        return f"0x{held:0{2 * (data_type.size or 0) if data_type else 0}X}"
    return number(held, digits)


def pair(left: float | str, right: float | str, address: "ObjectAddress", data_type: "DataType | None" = None) -> tuple[str, str]:
    """Format two values of an object so that they differ visibly."""
    for digits in range(DIGITS, _EXACT + 1):
        shown = value(left, address, data_type, digits), value(right, address, data_type, digits)
        if shown[0] != shown[1] or left == right:
            break
    return shown


def spans(numbers: Iterable[int]) -> str:
    """Return whole numbers in as few words as possible.

    >>> spans([1, 2, 3, 7, 9, 10])
    '1-3, 7, 9-10'
    """
    found: list[list[int]] = []
    for each in sorted(numbers):
        if found and each == found[-1][1] + 1:
            found[-1][1] = each
        else:
            found.append([each, each])
    return ", ".join(str(first) if first == last else f"{first}-{last}" for first, last in found)


_SPAN = re.compile(r"(\d{1,10})(?:\s*-\s*(\d{1,10}))?", re.ASCII)


def numbers_of(text: str, what: str, low: int, high: int, most: int = 1000) -> tuple[int, ...]:
    """Return the whole numbers that a text such as `7` or `1-3,9` names, as `spans` writes them.

    Raises:
        ValueError: It names none from `low` to `high`, one twice, or more than `most`.
    """
    found: list[int] = []
    for part in map(str.strip, text.split(",")):
        span = _SPAN.fullmatch(part)
        first, last = (0, -1) if span is None else (int(span[1]), int(span[2] or span[1]))
        if span is None or first < low or last > high:
            raise ValueError(f"{text}: expected a comma-separated list of {what}s from {low} to {high}, such as 7 or 1-3,9")
        if last < first:
            raise ValueError(f"{text}: {part} ends before it begins")
        if len(found) + last - first >= most:
            raise ValueError(f"{text}: expected at most {most} {what}s")
        if twice := set(found).intersection(range(first, last + 1)):
            raise ValueError(f"{text}: {what} {min(twice)} is given twice")
        found += range(first, last + 1)
    return tuple(found)
