"""Samples of a serial accelerometer in a stream of any bytes; pure."""

import functools
import math
import operator
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

Checksum = Literal["none", "xor", "sum8", "crc16-modbus"]
Vector = tuple[float, float, float]

AXES = ("x", "y", "z")
COUNTER, IGNORED = "counter", "-"
MAX_LINE_BYTES = 512
MAX_FRAME_BYTES = 256

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?", re.ASCII)
_COUNT = re.compile(r"\d{1,15}", re.ASCII)


def _crc16_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
        table.append(crc)
    return tuple(table)


_CRC16 = _crc16_table()


def xor8(data: bytes) -> int:
    """Exclusive or of all bytes, as in NMEA 0183."""
    return functools.reduce(operator.xor, data, 0)


def sum8(data: bytes) -> int:
    """Sum of all bytes modulo 256."""
    return sum(data) & 0xFF


def crc16_modbus(data: bytes) -> int:
    """Return the CRC-16 with the reflected polynomial A001h from FFFFh.

    Source: MODBUS over serial line V1.02, 6.2.2.
    """
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _CRC16[(crc ^ byte) & 0xFF]
    return crc


CHECKSUMS: dict[Checksum, tuple[Callable[[bytes], int], int]] = {
    "none": (lambda data: 0, 0),
    "xor": (xor8, 1),
    "sum8": (sum8, 1),
    "crc16-modbus": (crc16_modbus, 2),
}
"""Function and length in bytes of each checksum."""


class Sample(NamedTuple):
    """Content of one frame.

    Attributes:
        acceleration_m_s2: Acceleration along X, Y and Z.
        counter: The sensor's own count of samples, or None if it has none.
    """

    acceleration_m_s2: Vector
    counter: int | None


@dataclass(frozen=True)
class Fields:
    """Meaning of the numbers of a frame.

    Attributes:
        names: `x`, `y`, `z`, each once; `counter` at most once; `-` for a number that is ignored.
        scale_m_s2: m/s² per unit of x, y and z; a negative one turns an axis round.
        range_m_s2: Largest possible measurement; a frame with a value beyond it is refused.
    """

    names: tuple[str, ...]
    scale_m_s2: Vector
    range_m_s2: float

    def __post_init__(self) -> None:
        """Check that the names make a sample.

        Raises:
            ValueError: The names do not make a sample.
        """
        for name in AXES:
            if self.names.count(name) != 1:
                raise ValueError(f"fields name {name!r} {self.names.count(name)} times; expected x, y and z once each")
        if self.names.count(COUNTER) > 1:
            raise ValueError("fields name 'counter' twice")
        unknown = set(self.names) - {*AXES, COUNTER, IGNORED}
        if unknown:
            raise ValueError(f"fields name {min(unknown)!r}; expected x, y, z, counter, or - for an ignored number")

    def sample(self, values: dict[str, float]) -> Sample | None:
        """The sample of these numbers; None if one is beyond the range."""
        x, y, z = (values[name] * scale for name, scale in zip(AXES, self.scale_m_s2, strict=True))
        if not max(abs(x), abs(y), abs(z)) <= self.range_m_s2:  # says no to NaN as well
            return None
        counter = values.get(COUNTER)
        return Sample((x, y, z), None if counter is None else int(counter))


@dataclass(frozen=True)
class LineFraming:
    """Lines of text: prefix, numbers between separators, optional checksum.

    The checksum is hexadecimal, after ``*``.

    Attributes:
        separator: Text between the numbers; spaces around a number do not matter.
        prefix: Beginning of every line; the checksum does not cover it, as the ``$`` of NMEA 0183.
        checksum: Checksum over the text between prefix and ``*``; a CRC-16 is written as a number, high byte first.
    """

    fields: Fields
    separator: str = ","
    prefix: str = ""
    checksum: Checksum = "none"

    @property
    def frame_bytes(self) -> int | None:
        """None: a line is as long as its numbers."""
        return None

    def decoder(self) -> "LineDecoder":
        """A decoder at the beginning of a stream."""
        return LineDecoder(self)


class LineDecoder:
    """Decoder of lines into samples."""

    def __init__(self, framing: LineFraming) -> None:
        self.framing = framing
        self.checksum_errors = self.malformed = 0
        self._line = bytearray()
        self._synchronised = False
        self._prefix = framing.prefix.encode("ascii")
        self._digits = 2 * CHECKSUMS[framing.checksum][1]

    def feed(self, data: bytes) -> list[Sample]:
        """The samples of the lines that these bytes end."""
        samples = []
        *ended, rest = data.replace(b"\r", b"\n").split(b"\n")
        for part in ended:
            self._append(part)
            line = bytes(self._line)
            self._line.clear()
            sample = self._sample(line) if self._synchronised and line else None
            self._synchronised = True
            if sample is not None:
                samples.append(sample)
        self._append(rest)
        return samples

    def _append(self, part: bytes) -> None:
        self._line += part
        if len(self._line) > MAX_LINE_BYTES:  # whatever it is, it is not a line of ours
            self.malformed += self._synchronised
            self._line.clear()
            self._synchronised = False

    def _sample(self, line: bytes) -> Sample | None:
        if self._prefix:
            start = line.rfind(self._prefix)
            if start < 0:
                self.malformed += 1
                return None
            line = line[start + len(self._prefix) :]
        if self._digits:
            line, star, given = line.rpartition(b"*")
            given = given.strip()
            if not star or len(given) != self._digits or not re.fullmatch(rb"[0-9A-Fa-f]+", given):
                self.malformed += 1
                return None
            if int(given, 16) != CHECKSUMS[self.framing.checksum][0](line):
                self.checksum_errors += 1
                return None
        values = self._values(line)
        sample = None if values is None else self.framing.fields.sample(values)
        self.malformed += sample is None
        return sample

    def _values(self, line: bytes) -> dict[str, float] | None:
        names = self.framing.fields.names
        separator = None if self.framing.separator.isspace() else self.framing.separator  # some spaces are one
        texts = [text.strip() for text in line.decode("latin-1").split(separator)]
        if len(texts) != len(names):
            return None
        values: dict[str, float] = {}
        for name, text in zip(names, texts, strict=True):
            if name == IGNORED:
                continue
            if not (_COUNT if name == COUNTER else _NUMBER).fullmatch(text):
                return None
            values[name] = float(text)
        return values


@dataclass(frozen=True)
class BinaryFraming:
    """Frames of a fixed length: sync bytes, numbers, checksum.

    Attributes:
        sync: Bytes at the beginning of every frame; at least one.
        layout: The numbers as `struct` writes them, byte order first: ``<Hhhh``; ``x`` is a byte that is ignored.
        checksum: Checksum over the numbers, and over the sync bytes where `covers_sync`.
        checksum_position: Position of the checksum: at the end of the frame, or between sync bytes and numbers.
        checksum_order: Byte order of a CRC-16; Modbus sends the low byte first.
    """

    fields: Fields
    sync: bytes
    layout: str
    checksum: Checksum = "none"
    checksum_position: Literal["end", "start"] = "end"
    checksum_order: Literal["little", "big"] = "little"
    covers_sync: bool = True

    def __post_init__(self) -> None:
        """Check that layout and fields agree.

        Raises:
            ValueError: They do not agree, or the layout is not valid.
        """
        if not self.sync:
            raise ValueError("a binary frame needs at least one sync byte")
        if self.layout[:1] not in {"<", ">"} or not re.fullmatch(r"[<>][0-9xbBhHiIlLqQfd]+", self.layout):
            raise ValueError(f"format {self.layout!r}: expected '<' or '>' and then letters of x b B h H i I l L q Q f d")
        try:
            size = struct.calcsize(self.layout)
        except struct.error as error:
            raise ValueError(f"format {self.layout!r}: {error}") from None
        if self.frame_bytes > MAX_FRAME_BYTES:
            raise ValueError(f"a frame of {self.frame_bytes} bytes; the limit is {MAX_FRAME_BYTES}")
        numbers = len(struct.unpack(self.layout, bytes(size)))
        if numbers != len(self.fields.names):
            raise ValueError(f"format {self.layout!r} has {numbers} numbers; fields name {len(self.fields.names)}")

    @property
    def frame_bytes(self) -> int:
        """Length of a whole frame."""
        return len(self.sync) + struct.calcsize(self.layout) + CHECKSUMS[self.checksum][1]

    def decoder(self) -> "BinaryDecoder":
        """A decoder at the beginning of a stream."""
        return BinaryDecoder(self)


class BinaryDecoder:
    """Turns frames of a fixed length into samples.

    After a wrong checksum the search continues at the byte behind the first sync byte, so that a frame is lost only if a false
    one has a right checksum.
    """

    def __init__(self, framing: BinaryFraming) -> None:
        self.framing = framing
        self.checksum_errors = self.malformed = 0
        self._buffer = b""
        self._layout = struct.Struct(framing.layout)
        self._check, self._check_bytes = CHECKSUMS[framing.checksum]

    def feed(self, data: bytes) -> list[Sample]:
        """The samples of the frames that these bytes complete."""
        samples = []
        buffer, at = self._buffer + data, 0
        sync, length = self.framing.sync, self.framing.frame_bytes
        while True:
            start = buffer.find(sync, at)
            if start < 0:
                at = max(at, len(buffer) - len(sync) + 1)
                break
            at = start
            if len(buffer) - at < length:
                break
            body = self._body(buffer[at : at + length])
            if body is None:
                self.checksum_errors += 1
                at += 1
                continue
            sample = self._sample(body)
            if sample is None:
                self.malformed += 1
                at += length if self._check_bytes else 1
                continue
            samples.append(sample)
            at += length
        self._buffer = buffer[at:]
        return samples

    def _body(self, frame: bytes) -> bytes | None:
        """The numbers of a frame, or None if its checksum is wrong."""
        sync, behind = self.framing.sync, frame[len(self.framing.sync) :]
        if not self._check_bytes:
            return behind
        if self.framing.checksum_position == "end":
            body, given = behind[: -self._check_bytes], behind[-self._check_bytes :]
        else:
            body, given = behind[self._check_bytes :], behind[: self._check_bytes]
        expected = self._check(sync + body if self.framing.covers_sync else body)
        return body if int.from_bytes(given, self.framing.checksum_order) == expected else None

    def _sample(self, body: bytes) -> Sample | None:
        numbers = self._layout.unpack(body)
        values = {name: number for name, number in zip(self.framing.fields.names, numbers, strict=True) if name != IGNORED}
        if not all(math.isfinite(value) for value in values.values()):
            return None
        return self.framing.fields.sample(values)


Framing = LineFraming | BinaryFraming
