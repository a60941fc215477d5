"""Values from their text in a file.

Text with one possible meaning is read, with a remark if the standard demands another spelling. Ambiguous text is dropped,
with a remark. A `ValueReading` with a remark and no value was dropped.

Source: CiA 306-1 (values of keys); CiA 301, version 4.2.0, 7.4.7 (data types).
"""

import math
import re
import struct
from typing import NamedTuple

from drive_profiles.eds.text import BLANK, comment_start, quoted

VISIBLE_STRING, OCTET_STRING, UNICODE_STRING, DOMAIN, BOOLEAN = 0x09, 0x0A, 0x0B, 0x0F, 0x01
SIGNED = {0x02: 8, 0x03: 16, 0x10: 24, 0x04: 32, 0x12: 40, 0x13: 48, 0x14: 56, 0x15: 64}
"""Widths of the signed types by their index."""
UNSIGNED = {0x05: 8, 0x06: 16, 0x16: 24, 0x07: 32, 0x18: 40, 0x19: 48, 0x1A: 56, 0x1B: 64}
TIMES = {0x0C: 48, 0x0D: 48}
"""Widths of TIME_OF_DAY and TIME_DIFFERENCE, which files give as one number, if at all."""
REALS = {0x08: 32, 0x11: 64}
_STRINGS = {VISIBLE_STRING: "VISIBLE_STRING", OCTET_STRING: "OCTET_STRING", UNICODE_STRING: "UNICODE_STRING", DOMAIN: "DOMAIN"}
NAMES: dict[int, str] = {
    BOOLEAN: "BOOLEAN",
    **{data_type: f"INTEGER{width}" for data_type, width in SIGNED.items()},
    **{data_type: f"UNSIGNED{width}" for data_type, width in UNSIGNED.items()},
    **{data_type: f"REAL{width}" for data_type, width in REALS.items()},
    **_STRINGS,
    0x0C: "TIME_OF_DAY",
    0x0D: "TIME_DIFFERENCE",
}
"""Name of every data type that an entry can have."""
ACCESS = frozenset({"ro", "wo", "rw", "rwr", "rww", "const"})
_ACCESS_WORDS = {
    "r": "ro", "read": "ro", "readonly": "ro", "w": "wo", "write": "wo", "writeonly": "wo", "constant": "const", "c": "const",
    "wr": "rw", "r/w": "rw", "readwrite": "rw", "read/write": "rw", "read-write": "rw",
    "rwi": "rww", "readwriteinput": "rwr", "readwriteoutput": "rww", "noaccess": "ro",
}  # fmt: skip
MAX_STRING = 1024
MAX_NUMBER = 64
"""Most characters of a number; ``int`` would take thousands."""

_HEX = re.compile(r"([+-]?)0x([0-9a-f]+)", re.IGNORECASE)
_SPACED_HEX = re.compile(r"([0-9a-f][0-9a-f ]*)h", re.IGNORECASE)
_DECIMAL = re.compile(r"[+-]?[0-9]+")
_REAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?")
_SUFFIX = re.compile(r"(0x[0-9a-f]+|[+-]?[0-9]+)([ul]{1,3})", re.IGNORECASE)
_NODE_ID = re.compile(r"\$?node_?id", re.IGNORECASE)


class ValueReading(NamedTuple):
    """A value as it was read from its text.

    Args:
        value: The value; None if the text is empty or was dropped.
        remark: The fault and its repair; empty if the text is as the standard demands.
        relative: True if ``$NODEID`` is in the text.
    """

    value: int | float | str | bytes | None
    remark: str = ""
    relative: bool = False


def limits_of(data_type: int) -> tuple[int, int] | None:
    """Return the least and the greatest number of an integer type."""
    if data_type in SIGNED:
        return -(1 << SIGNED[data_type] - 1), (1 << SIGNED[data_type] - 1) - 1
    if data_type == BOOLEAN:
        return 0, 1
    width = UNSIGNED.get(data_type, TIMES.get(data_type))
    return None if width is None else (0, (1 << width) - 1)


def expected_of(data_type: int) -> str:
    """Name the values of a type, for a message."""
    limits = limits_of(data_type)
    name = NAMES.get(data_type, f"type 0x{data_type:04X}")
    if limits is not None:
        return f"{name}, {limits[0]} to {limits[1]}"
    if data_type in REALS:
        return f"{name}, as 1.5 or as its bit pattern with 0x"
    return f"{name}, as pairs of hexadecimal digits" if data_type in {OCTET_STRING, DOMAIN} else name


def number(text: str) -> ValueReading:
    """Read a whole number.

    It may be decimal, ``0x`` hexadecimal, octal with a leading 0, or in another spelling that files have.

    ``010`` is 8, as the standard has it, with a remark, since some writers mean ten; ``008`` cannot be octal and is 8.
    """
    body, remark = _without_comment(text)
    if len(body) > MAX_NUMBER:
        return ValueReading(None, "too long for a number; dropped")
    if suffixed := _SUFFIX.fullmatch(body):
        body, remark = suffixed.group(1), _joined(remark, f"suffix {suffixed.group(2)} left out")
    if match := _HEX.fullmatch(body):
        value = int(match.group(2), 16)
        return ValueReading(-value if match.group(1) == "-" else value, remark)
    if _DECIMAL.fullmatch(body):
        return _decimal(body, remark)
    if match := _SPACED_HEX.fullmatch(body):
        value = int(match.group(1).replace(" ", ""), 16)
        return ValueReading(value, _joined(remark, f"read as hexadecimal, {value}"))
    if _REAL.fullmatch(body):
        whole = float(body)
        if math.isfinite(whole) and whole.is_integer():
            return ValueReading(int(whole), _joined(remark, f"read as {int(whole)}"))
        return ValueReading(None, "not a whole number; dropped")
    return ValueReading(None, "not a number; dropped")


def integer(text: str, data_type: int, node_id: int | None = None) -> ValueReading:
    """Read an integer of a type, or a sum with one ``$NODEID``."""
    if data_type == BOOLEAN and text.lower() in {"true", "false", "yes", "no"}:
        truth = int(text.lower() in {"true", "yes"})
        return ValueReading(truth, f"read as {truth}")
    if not _NODE_ID.search(text):
        return _in_range(number(text), data_type)
    body, remark = _without_comment(text)
    terms = [term.strip() for term in body.split("+")]
    constants = [term for term in terms if not _NODE_ID.fullmatch(term)]
    readings = [number(term) for term in constants]
    values = [reading.value for reading in readings if isinstance(reading.value, int)]
    if len(terms) - len(constants) != 1 or len(values) != len(constants):
        return ValueReading(None, "not understood; dropped", relative=True)
    for reading in readings:
        remark = _joined(remark, reading.remark)
    if not body.startswith("$NODEID") or " " in body:
        remark = _joined(remark, f"read as $NODEID+0x{sum(values):X}")
    total = _in_range(ValueReading(sum(values) + (node_id or 0), remark), data_type)
    return total._replace(relative=True)


def value(text: str, data_type: int, node_id: int | None = None) -> ValueReading:
    """Read a value of a type; one not in `NAMES` is DOMAIN."""
    if not text:
        return ValueReading(None)
    if limits_of(data_type) is not None:
        return integer(text, data_type, node_id)
    if data_type in REALS:
        return _real(text, REALS[data_type])
    if data_type in {VISIBLE_STRING, UNICODE_STRING}:
        if len(text) > MAX_STRING:
            return ValueReading(None, f"{len(text)} characters long; dropped")
        return ValueReading(text)
    return _octets(text)


def access(text: str) -> ValueReading:
    """Read an access type, one of `ACCESS`; ``rwr`` and ``rww`` stay."""
    body, remark = _without_comment(text)
    word = body.lower()
    if word in ACCESS:
        return ValueReading(word, remark)
    meant = _ACCESS_WORDS.get(word.replace(" ", "").replace("_", ""))
    if meant is not None:
        return ValueReading(meant, _joined(remark, f"read as {meant}"))
    return ValueReading(None, "not an access type")


def flag(text: str) -> ValueReading:
    """Read a yes or no: 0 or 1, or a word."""
    body, remark = _without_comment(text)
    words = {"yes": 1, "true": 1, "optional": 1, "default": 1, "no": 0, "false": 0}
    if body.lower() in words:
        return ValueReading(words[body.lower()], _joined(remark, f"read as {words[body.lower()]}"))
    reading = number(body)
    if not isinstance(reading.value, int):
        return reading
    if reading.value not in {0, 1}:
        return ValueReading(1, _joined(remark, "read as 1"))
    return ValueReading(reading.value, _joined(remark, reading.remark))


def text_of(content: int | float | str | bytes, data_type: int) -> str:
    """Write a value as text for a file.

    Raises:
        ValueError: The value is not of the type, or does not fit on a line.
    """
    written = _written(content, data_type)
    reading = value(written, data_type)
    if reading.remark or type(reading.value) is not type(content) or reading.value != content:
        raise ValueError(
            f"{quoted(str(content))} cannot be written: {reading.remark or f'it would be read as {reading.value!r}'}"
        )
    return written


def _written(content: int | float | str | bytes, data_type: int) -> str:
    wanted: type = str if data_type in {VISIBLE_STRING, UNICODE_STRING} else float if data_type in REALS else bytes
    if limits_of(data_type) is not None:
        wanted = int
    if isinstance(content, bool) or not isinstance(content, wanted):
        raise ValueError(f"{quoted(str(content))} is not a value of {expected_of(data_type)}")
    if isinstance(content, bytes):
        written = content.hex().upper()
    else:
        written = repr(content) if isinstance(content, float) else str(content)
    if not written or written != written.strip(BLANK + "\r\n") or not written.replace("\t", " ").isprintable():
        raise ValueError(
            f"{quoted(written)} does not fit on a line: it is empty, has blanks around it, or a character that does not print"
        )
    return written


def _without_comment(text: str) -> tuple[str, str]:
    at = comment_start(text)
    if at == len(text):
        return text.strip(), ""
    return text[:at].strip(), "comment after it left out"


def _joined(*remarks: str) -> str:
    return ", ".join(remark for remark in remarks if remark)


def _decimal(body: str, remark: str) -> ValueReading:
    digits = body.lstrip("+-")
    plain = int(body)
    if digits[0] != "0" or plain == 0 or len(digits) == 1:
        return ValueReading(plain, remark)
    if "8" in digits or "9" in digits:
        return ValueReading(
            plain, _joined(remark, f"a leading 0 marks an octal number, but 8 and 9 are not octal digits; read as {plain}")
        )
    octal = int(digits, 8) * (-1 if body[0] == "-" else 1)
    if octal == plain:
        return ValueReading(plain, remark)
    return ValueReading(octal, _joined(remark, f"a leading 0 makes it octal; read as {octal}, not {plain}"))


def _in_range(reading: ValueReading, data_type: int) -> ValueReading:
    """Turn bit patterns into negative numbers; drop other values out of range."""
    limits = limits_of(data_type)
    content = reading.value
    if not isinstance(content, int) or limits is None or limits[0] <= content <= limits[1]:
        return reading
    for width in sorted({SIGNED.get(data_type, 0), 16, 32, 64}):
        # Also the pattern of a wider type: 0xFFFFFFFD in an INTEGER8 comes from a tool that prints 32 bits.
        negative = content - (1 << width)
        if (
            data_type in SIGNED
            and width >= SIGNED[data_type]
            and 1 << (width - 1) <= content < 1 << width
            and negative >= limits[0]
        ):
            return reading._replace(value=negative, remark=_joined(reading.remark, f"read as {negative}, which has these bits"))
    return reading._replace(value=None, remark=_joined(reading.remark, "out of the range of its type; dropped"))


def _real(text: str, width: int) -> ValueReading:
    body, remark = _without_comment(text)
    if match := _HEX.fullmatch(body):
        digits = match.group(2)
        if len(digits) > width // 4 or match.group(1) or (len(digits) < width // 4 and int(digits, 16)):
            return ValueReading(None, f"not a bit pattern of {width} bits; dropped")
        pattern = bytes.fromhex(digits.zfill(width // 4))
        content = struct.unpack(">f" if width == 32 else ">d", pattern)[0]
        if not math.isfinite(content):
            return ValueReading(None, "the bit pattern of no finite number; dropped")
        return ValueReading(content, remark)
    if len(body) > MAX_NUMBER or not _REAL.fullmatch(body):
        return ValueReading(None, "not a number; dropped")
    content = float(body)
    try:
        struct.pack("<f" if width == 32 else "<d", content)
    except OverflowError:
        content = math.inf
    return (
        ValueReading(content, remark) if math.isfinite(content) else ValueReading(None, "out of the range of its type; dropped")
    )


def _octets(text: str) -> ValueReading:
    remark = ""
    body = text
    if body[:2].lower() == "0x":
        body, remark = body[2:], "read without its 0x"
    try:
        return ValueReading(bytes.fromhex(body), remark)
    except ValueError:
        return ValueReading(None, "not pairs of hexadecimal digits; dropped")
