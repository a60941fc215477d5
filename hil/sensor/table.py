"""The bench file's `[accelerometer.serial]`; docs/serial.md has two complete ones."""

import re
from typing import Annotated, Literal

from pydantic import Field, model_validator

from drive_profiles.files.toml import Table
from hil.sensor.clock import AtSync
from hil.sensor.framing import COUNTER, BinaryFraming, Checksum, Fields, Framing, LineFraming

_LINE_KEYS = ("separator", "prefix")
_BINARY_KEYS = ("sync", "format", "checksum_place", "checksum_order", "checksum_covers_sync", "frame_bytes")
_SIZES = {"B": 1, "H": 2, "I": 4, "L": 4, "Q": 8}


class SerialTable(Table):
    """Port, framing and timing of the sensor.

    Attributes:
        port: Device of the serial port.
        baud_rate: Bit rate in bit/s; 8 data bits, no parity, one stop bit.
        framing: Lines of text, or binary frames of a fixed length.
        fields: Meaning of the numbers of a frame: x, y, z, counter, and - for a number that is ignored.
        scale_m_s2: m/s² per unit of x, y and z.
        range_m_s2: Largest possible measurement; values beyond it are refused.
        checksum: Kind of checksum in each frame.
        counter_modulo: Count at which the counter starts again; the default for binary frames follows from its type.
        sample_rate_hz: Sampling rate of the sensor.
        delay_s: Time from the acceleration to the first bit on the line: half the filter's length, and that of a USB converter.
        at_sync: Measurement of a SYNC: the newest sample by then, or interpolated if the next one has arrived already.
        max_age_s: Largest age of a sample; with an older one the sensor counts as silent.
        separator: Text between the numbers of a line; a comma unless it is given.
        prefix: Beginning of every line; not in the checksum.
        sync: Bytes that every binary frame begins with, in hexadecimal.
        format: Numbers of a binary frame as Python's `struct` writes them, byte order first.
        checksum_place: Position of the checksum: at the end unless it is given.
        checksum_order: Byte order of a CRC-16; the low byte first unless it is given.
        checksum_covers_sync: True if the checksum covers the sync bytes, as it does unless this is given.
        frame_bytes: Length of a whole frame, to check the other keys against.
    """

    port: Annotated[str, Field(min_length=1)]
    baud_rate: Annotated[int, Field(ge=300, le=12_000_000)]
    framing: Literal["line", "binary"]
    fields: Annotated[tuple[str, ...], Field(min_length=3, max_length=64)]
    scale_m_s2: tuple[float, float, float] = (1.0, 1.0, 1.0)
    range_m_s2: Annotated[float, Field(gt=0.0)] = 1000.0
    checksum: Checksum = "none"
    counter_modulo: Annotated[int, Field(ge=4, le=2**63)] | None = None
    sample_rate_hz: Annotated[float, Field(ge=1.0, le=20_000.0)]
    delay_s: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    at_sync: AtSync = "latest"
    max_age_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.05
    separator: Annotated[str, Field(min_length=1, max_length=1, pattern=r"[,; \t|:]")] | None = None
    prefix: Annotated[str, Field(max_length=16, pattern=r"^[!-~]*$")] | None = None
    sync: Annotated[str, Field(pattern=r"^([0-9A-Fa-f]{2} ?){1,8}$")] | None = None
    format: str | None = None
    checksum_place: Literal["end", "start"] | None = None
    checksum_order: Literal["little", "big"] | None = None
    checksum_covers_sync: bool | None = None
    frame_bytes: int | None = None

    @model_validator(mode="after")
    def _consistent(self) -> "SerialTable":
        others = _BINARY_KEYS if self.framing == "line" else _LINE_KEYS
        given = [key for key in others if getattr(self, key) is not None]
        if given:
            raise ValueError(f"framing {self.framing!r} has no {given[0]}")
        if 0.0 in self.scale_m_s2:
            raise ValueError("scale_m_s2 has a 0; expected three factors other than 0")
        self.layout()
        self.modulo()
        if self.max_age_s < 2.0 / self.sample_rate_hz:
            raise ValueError(f"max_age_s {self.max_age_s:g} is less than two samples at sample_rate_hz {self.sample_rate_hz:g}")
        return self

    def layout(self) -> Framing:
        """Return the layout of the samples in the stream."""
        fields = Fields(self.fields, self.scale_m_s2, self.range_m_s2)
        if self.framing == "line":
            return LineFraming(fields, self.separator or ",", self.prefix or "", self.checksum)
        if self.sync is None or self.format is None:
            raise ValueError("framing 'binary' needs sync and format")
        position, order = self.checksum_place or "end", self.checksum_order or "little"
        covers_sync = self.checksum_covers_sync is not False
        framing = BinaryFraming(fields, bytes.fromhex(self.sync), self.format, self.checksum, position, order, covers_sync)
        if self.frame_bytes not in {None, framing.frame_bytes}:
            raise ValueError(f"frame_bytes is {self.frame_bytes}; sync, format and checksum make {framing.frame_bytes}")
        bits = framing.frame_bytes * 10 * self.sample_rate_hz
        if bits > self.baud_rate:
            raise ValueError(
                f"{self.sample_rate_hz:g} frames of {framing.frame_bytes} bytes a second need baud_rate = {bits:g} or more"
            )
        return framing

    def modulo(self) -> int | None:
        """Return the counter's modulus; a binary frame's follows from its type."""
        if COUNTER not in self.fields:
            if self.counter_modulo is not None:
                raise ValueError("counter_modulo needs a counter among the fields")
            return None
        if self.counter_modulo is not None:
            return self.counter_modulo
        letters = re.sub(r"(\d+)([^x])", lambda m: m[2] * int(m[1]), re.sub(r"\d*x", "", (self.format or "")[1:]))
        size = _SIZES.get(letters[self.fields.index(COUNTER)]) if letters else None
        if size is None:
            raise ValueError("a counter needs counter_modulo, unless it is an unsigned number of a binary frame")
        return 1 << 8 * size
