"""Parameters of a PDO, changed in order (CiA 301, 7.5.2.35 to 7.5.2.38)."""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from drive_profiles.standard.cia301 import CobIdBit, DataType, SdoAbortCode, Value, decode, encode, identifier_refusal
from plant_emulator.slave.dictionary import Cell, Dictionary

Field = tuple[DataType | None, int]
"""A data type, or None for a gap, and the bits that it takes."""


def bits_of(data_type: DataType) -> int:
    """Return the number of bits that a value takes in a PDO.

    It is 1 for a BOOLEAN, else the bits of its bytes (CiA 301, 7.4.7).
    """
    return 1 if data_type is DataType.BOOLEAN else 8 * (data_type.size or 0)


class BitPacker:
    """Packer for fields of any number of bits (CiA 301, 7.5.2.36).

    It has the methods of `struct.Struct` that a PDO uses.

    The first field lies in the least significant bits of the first byte, the next one above it, and so on through the
    bytes, as a little-endian number; the bits above the last field are 0. Made of whole bytes, this is what `struct` gives.

    Attributes:
        size: Bytes that the fields take, the last one perhaps in part.
    """

    def __init__(self, fields: Sequence[Field]) -> None:
        self._fields: list[tuple[DataType, int, int]] = []
        end = 0
        for data_type, bits in fields:
            if data_type is not None:
                self._fields.append((data_type, end, bits))
            end += bits
        self.size = -(-end // 8)

    def pack(self, *values: Value) -> bytes:
        """Pack one value for each field that is not a gap.

        Raises:
            ValueError: A value is not of its field's type, or there are more or fewer values than fields.
        """
        number = 0
        for (data_type, offset, _), value in zip(self._fields, values, strict=True):
            number |= int.from_bytes(encode(data_type, value), "little") << offset
        return number.to_bytes(self.size, "little")

    def unpack_from(self, data: bytes) -> tuple[Value, ...]:
        """Unpack the values that are not gaps; bytes behind are ignored."""
        number = int.from_bytes(data, "little")
        return tuple(
            decode(data_type, (number >> offset & (1 << bits) - 1).to_bytes(-(-bits // 8), "little"))
            for data_type, offset, bits in self._fields
        )


RPDO_COMMUNICATION, RPDO_MAPPING = 0x1400, 0x1600
TPDO_COMMUNICATION, TPDO_MAPPING = 0x1800, 0x1A00
MAX_MAPPED = 8
"""Objects of one PDO; the standard allows up to 64, of a bit each. A higher number is refused with 0604 0042h."""
MAX_BITS = 64
MAX_SYNCHRONOUS = 240
SYNCHRONOUS_ON_REQUEST, ON_REQUEST = 252, 253
"""Transmission types of a TPDO that only a remote request triggers: sampled at SYNC, or at the request."""
EVENT_DRIVEN = (254, 255)

_DUMMIES = {data_type: bits_of(data_type) for data_type in DataType if data_type <= DataType.UNSIGNED32}
"""Data types that an RPDO may name as dummies, with their bits (CiA 301, 7.4.7.1)."""


@dataclass(frozen=True, slots=True)
class PdoObject:
    """One mapped object of a PDO, packed into 32 bits.

    Source: CiA 301, 7.5.2.36.
    """

    index: int
    subindex: int
    bits: int

    @classmethod
    def from_value(cls, value: int) -> "PdoObject":
        """Unpack a mapping parameter."""
        return cls(value >> 16, value >> 8 & 0xFF, value & 0xFF)

    @property
    def value(self) -> int:
        """The mapping parameter."""
        return self.index << 16 | self.subindex << 8 | self.bits

    @property
    def is_dummy(self) -> bool:
        """True if a data type replaces an object."""
        return self.subindex == 0 and self.index in _DUMMIES


class PdoSetup:
    """The parameters of one PDO from the dictionary, compiled for the cycle.

    It takes charge of the write access to the communication and mapping record, and calls `changed` when the PDO is to
    be looked at anew. `Rpdo` and `Tpdo` add what a PDO does.

    Args:
        dictionary: Must have both records and the objects to be mapped.
        number: 0 for the first PDO.
        is_transmit: TPDO (1800h, 1A00h) or RPDO (1400h, 1600h).
        changed: Called after an accepted change.

    Attributes:
        inhibit_ns: Sub-index 3, or 0.
        event_timer_ns: Sub-index 5, or 0.
        cells: The mapped objects, without dummies.
        start_value: Sub-index 6: counter of the SYNC that is taken as the first, or 0.
        allows_requests: Bit 30 of the COB-ID is clear: remote requests are answered.
    """

    def __init__(self, dictionary: Dictionary, number: int, *, is_transmit: bool, changed: Callable[[], None]) -> None:
        self._dictionary, self._is_transmit, self._changed = dictionary, is_transmit, changed
        self._communication = (TPDO_COMMUNICATION if is_transmit else RPDO_COMMUNICATION) + number
        self._mapping = (TPDO_MAPPING if is_transmit else RPDO_MAPPING) + number
        self.can_id = self.transmission_type = self.inhibit_ns = self.event_timer_ns = self.start_value = 0
        self.allows_requests = False
        self.cells: tuple[Cell, ...] = ()
        self.packer: struct.Struct | BitPacker = struct.Struct("<")
        self._is_valid = False
        self._count = 0
        self._mapped = [PdoObject(0, 0, 0)] * MAX_MAPPED
        self._hooks: dict[tuple[int, int], Callable[[int], SdoAbortCode | None]] = {
            # In the order in which they can be set: mapping, its length, the rest, the COB-ID that makes it valid.
            **{(self._mapping, i): partial(self._set_mapped, i) for i in range(1, MAX_MAPPED + 1)},
            (self._mapping, 0): self._set_count,
            (self._communication, 2): self._set_transmission_type,
            (self._communication, 3): self._set_inhibit_time,
            (self._communication, 5): self._set_event_timer,
            (self._communication, 6): self._set_start_value,
            (self._communication, 1): self._set_cob_id,
        }
        for (index, subindex), hook in self._hooks.items():
            if (index, subindex) in dictionary:
                dictionary.on_write(index, subindex, hook)

    @property
    def is_active(self) -> bool:
        """True if the PDO exists and carries something."""
        return self._is_valid and self._count > 0

    @property
    def is_synchronous(self) -> bool:
        """True if SYNC governs the PDO."""
        return self.transmission_type <= MAX_SYNCHRONOUS

    def start(self) -> None:
        """Start anew, without data from earlier frames."""

    def restart_timer(self) -> None:
        """Start anew with the event timer that has been written."""

    def load(self) -> None:
        """Read all parameters from the dictionary.

        The rules are those for writes from the bus. A stored value that they refuse is replaced by the default, a mapping by
        an empty one, and the PDO is disabled, as its COB-ID then shows: a stored value must not keep a node from starting.

        Raises:
            ValueError: The defaults of the dictionary are not a possible PDO.
        """
        self._is_valid = False
        self._count = 0
        addresses = [address for address in self._hooks if address in self._dictionary]
        is_stored = any(address in self._dictionary.stored for address in addresses)
        is_broken = False
        for address in addresses:
            hook, cell = self._hooks[address], self._dictionary.cell(*address)
            value = self._dictionary.get_int(*address)
            if is_broken and address == (self._communication, 1):
                cell.value = value = value | CobIdBit.INVALID
            code = hook(value)
            if code is None:
                continue
            if not is_stored:
                raise ValueError(f"PDO parameter {address[0]:04X}h:{address[1]:02X}h = {value!r}: {code.text}")
            is_broken = True
            cell.value = value = self._substitute(address)
            hook(value)

    def _substitute(self, address: tuple[int, int]) -> int:
        if address[0] == self._mapping:
            return 0
        default = int(self._dictionary.cell(*address).entry.default_for(self._dictionary.node_id))
        return default | CobIdBit.INVALID if address[1] == 1 else default

    def _restart(self) -> None:
        self.start()
        self._changed()

    def _set_cob_id(self, cob_id: int) -> SdoAbortCode | None:
        # Bit 30 is "do not care" in an RPDO; in a TPDO it may change at any time, since masters of both habits exist.
        is_valid = not cob_id & CobIdBit.INVALID
        can_id = cob_id & ~(CobIdBit.INVALID | CobIdBit.NO_RTR)
        code = identifier_refusal(can_id, is_valid=is_valid, in_use=self.can_id if self._is_valid else None)
        if code is None:
            self.can_id, self._is_valid = can_id, is_valid
            self.allows_requests = not cob_id & CobIdBit.NO_RTR
            self._restart()
        return code

    def _set_transmission_type(self, transmission_type: int) -> SdoAbortCode | None:
        # 241 to 251 are reserved; 252 and 253 wait for remote requests, which only a TPDO answers.
        is_on_request = transmission_type in {SYNCHRONOUS_ON_REQUEST, ON_REQUEST} and self._is_transmit
        if transmission_type > MAX_SYNCHRONOUS and transmission_type not in EVENT_DRIVEN and not is_on_request:
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
        self.restart_timer()
        self._changed()
        return None

    def _set_start_value(self, counter: int) -> SdoAbortCode | None:
        if counter > MAX_SYNCHRONOUS or (self._is_valid and counter != self.start_value):
            return SdoAbortCode.INVALID_VALUE  # not to be changed while the PDO exists
        self.start_value = counter
        return None

    def _set_count(self, count: int) -> SdoAbortCode | None:
        # The standard asks for an invalid PDO but names no abort code; 0601 0000h is what CANopenNode answers.
        if self._is_valid:
            return SdoAbortCode.UNSUPPORTED_ACCESS
        if count > MAX_MAPPED:
            return SdoAbortCode.PDO_LENGTH
        mapped = self._mapped[:count]
        for item in mapped:
            code = self._refusal(item)
            if code is not None:
                return code
        if sum(item.bits for item in mapped) > MAX_BITS:
            return SdoAbortCode.PDO_LENGTH
        self._count = count
        self._compile(mapped)
        self._restart()
        return None

    def _set_mapped(self, position: int, value: int) -> SdoAbortCode | None:
        if self._is_valid or self._count > 0:
            return SdoAbortCode.UNSUPPORTED_ACCESS
        mapped = PdoObject.from_value(value)
        code = self._refusal(mapped) if value else None  # 0 leaves the position free; counting it is refused
        if code is None:
            self._mapped[position - 1] = mapped
        return code

    def _refusal(self, mapped: PdoObject) -> SdoAbortCode | None:
        """Return the reason why an object cannot be mapped, or None."""
        # CiA 301, 7.5.2.36 names two codes only: an object is mapped whole, so other bits than its own are "not mappable" too.
        if mapped.is_dummy:
            is_mappable, data_type = not self._is_transmit, DataType(mapped.index)
        elif (mapped.index, mapped.subindex) in self._dictionary:
            entry = self._dictionary.cell(mapped.index, mapped.subindex).entry
            is_mappable = entry.is_tpdo_mappable if self._is_transmit else entry.is_rpdo_mappable
            data_type = entry.data_type
        else:
            return SdoAbortCode.NO_OBJECT
        return None if is_mappable and mapped.bits == bits_of(data_type) else SdoAbortCode.NOT_MAPPABLE

    def _compile(self, mapped: list[PdoObject]) -> None:
        fields: list[Field] = []
        cells = []
        for item in mapped:
            if item.is_dummy:
                fields.append((None, item.bits))
            else:
                cell = self._dictionary.cell(item.index, item.subindex)
                fields.append((cell.entry.data_type, item.bits))
                cells.append(cell)
        self.cells = tuple(cells)
        self.packer = _packer(fields)


def _packer(fields: list[Field]) -> struct.Struct | BitPacker:
    """Return the fast packer for whole-byte fields, else the general one."""
    layout = "<"
    for data_type, bits in fields:
        character = f"{bits // 8}x" if data_type is None else data_type.struct_format
        if bits % 8 or character is None:
            return BitPacker(fields)
        layout += character
    return struct.Struct(layout)
