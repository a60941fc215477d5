"""The parameters of one PDO, and the order in which they may be changed (CiA 301, 7.5.2.35 to 7.5.2.38)."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from drive_profiles.cia301 import CobIdBit, DataType, SdoAbortCode, is_restricted
from hil.can.frame import CAN_SFF_MASK
from plant_emulator.slave.dictionary import Cell, Dictionary

RPDO_COMMUNICATION, RPDO_MAPPING = 0x1400, 0x1600
TPDO_COMMUNICATION, TPDO_MAPPING = 0x1800, 0x1A00
MAX_MAPPED = 8
MAX_BITS = 64
MAX_SYNCHRONOUS = 240
EVENT_DRIVEN = (254, 255)

_DUMMIES = {
    data_type: data_type.size * 8
    for data_type in DataType
    if DataType.INTEGER8 <= data_type <= DataType.UNSIGNED32 and data_type.size
}
"""Data types that an RPDO may name as place holders, with their bits (CiA 301, 7.4.7.1)."""


@dataclass(frozen=True, slots=True)
class Mapped:
    """One object of a PDO, as a mapping parameter packs it into 32 bits (CiA 301, 7.5.2.36)."""

    index: int
    subindex: int
    bits: int

    @classmethod
    def from_value(cls, value: int) -> "Mapped":
        """Unpack a mapping parameter."""
        return cls(value >> 16, value >> 8 & 0xFF, value & 0xFF)

    @property
    def value(self) -> int:
        """The mapping parameter."""
        return self.index << 16 | self.subindex << 8 | self.bits

    @property
    def is_dummy(self) -> bool:
        """Whether a data type stands in the place of an object."""
        return self.subindex == 0 and self.index in _DUMMIES


class PdoSetup:
    """Holds what the dictionary says about one PDO, compiled for the cycle.

    It takes charge of the write access to the communication and mapping record, and calls `changed` when the PDO is to
    be looked at anew. `Rpdo` and `Tpdo` add what a PDO does.

    Args:
        dictionary: Brings both records and the objects to be mapped.
        number: 0 for the first PDO.
        is_transmit: TPDO (1800h, 1A00h) or RPDO (1400h, 1600h).
        changed: Called after an accepted change.

    Attributes:
        can_id: Identifier of the frames.
        transmission_type: Sub-index 2.
        inhibit_ns: Sub-index 3, or 0.
        event_timer_ns: Sub-index 5, or 0.
        cells: The mapped objects, without place holders.
        packer: Layout of the frame.
    """

    def __init__(self, dictionary: Dictionary, number: int, *, is_transmit: bool, changed: Callable[[], None]) -> None:
        self._dictionary = dictionary
        self._is_transmit = is_transmit
        self._changed = changed
        self._communication = (TPDO_COMMUNICATION if is_transmit else RPDO_COMMUNICATION) + number
        self._mapping = (TPDO_MAPPING if is_transmit else RPDO_MAPPING) + number
        self.can_id = self.transmission_type = self.inhibit_ns = self.event_timer_ns = 0
        self.cells: tuple[Cell, ...] = ()
        self.packer = struct.Struct("<")
        self._is_valid = False
        self._count = 0
        self._mapped = [Mapped(0, 0, 0)] * MAX_MAPPED
        self._hooks: dict[tuple[int, int], Callable[[int], SdoAbortCode | None]] = {
            # In the order in which they can be set: mapping, its length, the rest, the COB-ID that makes it valid.
            **{(self._mapping, i): partial(self._set_mapped, i) for i in range(1, MAX_MAPPED + 1)},
            (self._mapping, 0): self._set_count,
            (self._communication, 2): self._set_transmission_type,
            (self._communication, 3): self._set_inhibit_time,
            (self._communication, 5): self._set_event_timer,
            (self._communication, 1): self._set_cob_id,
        }
        for (index, subindex), hook in self._hooks.items():
            if (index, subindex) in dictionary:
                dictionary.on_write(index, subindex, hook)

    @property
    def is_active(self) -> bool:
        """Whether the PDO exists and carries something."""
        return self._is_valid and self._count > 0

    @property
    def is_synchronous(self) -> bool:
        """Whether SYNC governs the PDO."""
        return self.transmission_type <= MAX_SYNCHRONOUS

    def start(self) -> None:
        """Begin anew; nothing of what came or went before may reach into what follows."""

    def load(self) -> None:
        """Take everything from the dictionary, by the same rules as from the bus.

        Raises:
            ValueError: The defaults of the dictionary are not a possible PDO.
        """
        self._is_valid = False
        self._count = 0
        for place, hook in self._hooks.items():
            if place not in self._dictionary:
                continue
            value = self._dictionary.get_int(*place)
            code = hook(value)
            if code is not None:
                raise ValueError(f"PDO parameter {place[0]:04X}h:{place[1]:02X}h = {value!r}: {code.text}")

    def _restart(self) -> None:
        self.start()
        self._changed()

    def _set_cob_id(self, cob_id: int) -> SdoAbortCode | None:
        # Bit 30 is "do not care" in an RPDO; in a TPDO it is kept as written, since a remote request is never answered
        # and masters of both habits exist. 29-bit identifiers are not supported: bit 29, and bits 28 to 11 without it.
        is_valid = not cob_id & CobIdBit.INVALID
        can_id = cob_id & ~(CobIdBit.INVALID | CobIdBit.NO_RTR)
        if can_id > CAN_SFF_MASK or (is_valid and is_restricted(can_id)):
            return SdoAbortCode.INVALID_VALUE
        if is_valid and self._is_valid and can_id != self.can_id:
            return SdoAbortCode.INVALID_VALUE  # bits 0 to 29 do not change while the PDO exists
        self.can_id, self._is_valid = can_id, is_valid
        self._restart()
        return None

    def _set_transmission_type(self, transmission_type: int) -> SdoAbortCode | None:
        # 241 to 251 are reserved, 252 and 253 wait for remote requests, which this node does not answer.
        if transmission_type > MAX_SYNCHRONOUS and transmission_type not in EVENT_DRIVEN:
            return SdoAbortCode.INVALID_VALUE
        self.transmission_type = transmission_type
        self._restart()
        return None

    def _set_inhibit_time(self, multiple_of_100us: int) -> SdoAbortCode | None:
        if self._is_valid and multiple_of_100us * 100_000 != self.inhibit_ns:
            return SdoAbortCode.INVALID_VALUE  # not to be changed while the PDO exists
        self.inhibit_ns = multiple_of_100us * 100_000
        return None

    def _set_event_timer(self, milliseconds: int) -> SdoAbortCode | None:
        self.event_timer_ns = milliseconds * 1_000_000
        self._changed()
        return None

    def _set_count(self, count: int) -> SdoAbortCode | None:
        # The standard asks for an invalid PDO but names no abort code; 0601 0000h is what CANopenNode answers.
        if self._is_valid:
            return SdoAbortCode.UNSUPPORTED_ACCESS
        if count > MAX_MAPPED:
            return SdoAbortCode.PDO_LENGTH
        mapped = self._mapped[:count]
        for place in mapped:
            code = self._refusal(place)
            if code is not None:
                return code
        if sum(place.bits for place in mapped) > MAX_BITS:
            return SdoAbortCode.PDO_LENGTH
        self._count = count
        self._compile(mapped)
        self._restart()
        return None

    def _set_mapped(self, position: int, value: int) -> SdoAbortCode | None:
        if self._is_valid or self._count > 0:
            return SdoAbortCode.UNSUPPORTED_ACCESS
        mapped = Mapped.from_value(value)
        code = self._refusal(mapped) if value else None  # 0 leaves the position free; counting it is refused
        if code is None:
            self._mapped[position - 1] = mapped
        return code

    def _refusal(self, mapped: Mapped) -> SdoAbortCode | None:
        """Tell why an object cannot be mapped, or None where it can."""
        is_whole = mapped.bits > 0 and mapped.bits % 8 == 0
        if mapped.is_dummy:
            if self._is_transmit or not is_whole:
                return SdoAbortCode.NOT_MAPPABLE
            return None if _DUMMIES[DataType(mapped.index)] == mapped.bits else SdoAbortCode.LENGTH_MISMATCH
        if (mapped.index, mapped.subindex) not in self._dictionary:
            return SdoAbortCode.NO_OBJECT
        entry = self._dictionary.cell(mapped.index, mapped.subindex).entry
        if not is_whole or not (entry.is_tpdo_mappable if self._is_transmit else entry.is_rpdo_mappable):
            return SdoAbortCode.NOT_MAPPABLE
        return None if entry.data_type.size == mapped.bits // 8 else SdoAbortCode.LENGTH_MISMATCH

    def _compile(self, mapped: list[Mapped]) -> None:
        layout = "<"
        cells = []
        for place in mapped:
            if place.is_dummy:
                layout += f"{place.bits // 8}x"
            else:
                cell = self._dictionary.cell(place.index, place.subindex)
                layout += cell.entry.data_type.struct_format or ""
                cells.append(cell)
        self.cells = tuple(cells)
        self.packer = struct.Struct(layout)
