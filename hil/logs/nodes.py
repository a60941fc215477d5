"""Nodes of a log, and the contents of their process data.

They come from the SDO traffic of the set-up, or from a device description.
Without either, only the timing of a PDO is checked.

Source: CiA 301, 7.5.2.35 to 7.5.2.38 (PDO communication and mapping parameters); CiA 402-2 for the objects' types.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from drive_profiles.standard.cia301 import RPDO_BASES, TPDO_BASES, CobIdBit, DataType, FunctionCode
from drive_profiles.standard.object_address import ObjectAddress
from drive_profiles.standard.objects import OBJECTS
from hil.logs.log import Log, Stream
from hil.logs.overheard import Event, OverheardValue

if TYPE_CHECKING:
    from drive_profiles.eds.description import Description

MOST_PDOS = 512
COMMUNICATION_PARAMETERS = {"rpdo": 0x1400, "tpdo": 0x1800}
MAPPING_PARAMETERS = {"rpdo": 0x1600, "tpdo": 0x1A00}
BASES = {"rpdo": RPDO_BASES, "tpdo": TPDO_BASES}
MOST_ENTRIES = 64
WITH_SYNC = range(1, 241)
"""Transmission types of a PDO that is sent or takes effect with every n-th SYNC."""
SIGNED = {0x6060, 0x6061, 0x6064, 0x6065, 0x606C, 0x6071, 0x6074, 0x6077, 0x6078, 0x607A, 0x60B0, 0x60B1, 0x60B2, 0x60C1, 0x60E4,
    0x60F4, 0x60FA, 0x60FC, 0x60FF, 0x7130, 0x9130}  # fmt: skip
"""Indices of signed process data of CiA 402, and of CiA 404 (values that were measured)."""

SIGNED_TYPES = {2, 3, 4, 16, 18, 19, 20, 21}
"""Data types with a sign: INTEGER8, 16, 32, 24, 40, 48, 56 and 64."""

Direction = Literal["rpdo", "tpdo"]


@dataclass(frozen=True)
class MappedNumber:
    """A number in a PDO.

    Attributes:
        is_real: True for a floating-point number of 32 or 64 bits.
    """

    address: ObjectAddress
    start: int
    bits: int
    is_signed: bool
    is_real: bool = False

    def numbers(self, stream: Stream) -> NDArray[np.float64]:
        """Return the number in each frame as float; shape (n,)."""
        if not self.is_real:
            return self.of(stream).astype(np.float64)
        raw = stream.data >> np.uint64(self.start)
        if self.bits == 64:
            return raw.view(np.float64)
        return raw.astype(np.uint32).view(np.float32).astype(np.float64)

    def of(self, stream: Stream) -> NDArray[np.int64]:
        """The bits in each frame as a whole number; shape (n,)."""
        mask = np.uint64((1 << self.bits) - 1)
        raw = (stream.data >> np.uint64(self.start)) & mask
        if not self.is_signed:
            return raw.astype(np.int64)
        sign = np.uint64(1 << (self.bits - 1))
        return (raw ^ sign).astype(np.int64) - np.int64(1 << (self.bits - 1))

    @property
    def value(self) -> int:
        """Value of the mapping parameter."""
        return self.address[0] << 16 | self.address[1] << 8 | self.bits

    @property
    def bytes(self) -> int:
        """Bytes that a frame must have for it."""
        return -(-(self.start + self.bits) // 8)


@dataclass(frozen=True)
class Pdo:
    """A PDO of a node.

    Attributes:
        direction: Direction, as the node sees it.
        number: From 1.
        entries: Its numbers; empty if the mapping is not known.
    """

    node: int
    direction: Direction
    number: int
    can_id: int
    transmission_type: int | None
    entries: tuple[MappedNumber, ...]

    @property
    def name(self) -> str:
        """Name in words: `RPDO 1 of node 2`."""
        return f"{self.direction.upper()} {self.number} of node {self.node}"

    def entry(self, index: int, subindex: int = 0) -> MappedNumber | None:
        """Return the number of a mapped object, or None."""
        return next((entry for entry in self.entries if entry.address == (index, subindex)), None)


@dataclass
class Node:
    """A node during the process data of a log.

    It has the objects' contents before a run restores them at its end.

    Attributes:
        values: Contents of its objects then, by address: written or read last, else from a description.
        heard: Addresses of those in the log itself.
    """

    number: int
    values: dict[ObjectAddress, int] = field(default_factory=dict)
    heard: set[ObjectAddress] = field(default_factory=set)
    pdos: tuple[Pdo, ...] = ()
    description: "Description | None" = None

    def value(self, index: int, subindex: int = 0) -> int | None:
        """Content of an object as a number; None if unknown."""
        return self.values.get((index, subindex))

    def pdo_with(self, direction: Direction, index: int, subindex: int = 0) -> tuple[Pdo, MappedNumber] | None:
        """The PDO with an object, and its place in the PDO."""
        for pdo in self.pdos:
            entry = pdo.entry(index, subindex) if pdo.direction == direction else None
            if entry is not None:
                return pdo, entry
        return None


def nodes_of(log: Log, events: Iterable[Event], descriptions: "Mapping[int, Description]") -> dict[int, Node]:
    """Nodes of a log, by node-ID."""
    found = {number: Node(number) for number in _node_ids(log)}
    for number, description in descriptions.items():
        node = found.setdefault(number, Node(number))
        node.description = description
        node.values = dict(_described(description))
    at_ns = _working_ns(log)
    written_later: set[tuple[int, ObjectAddress]] = set()
    for event in events:
        if not isinstance(event, OverheardValue) or event.node not in found or not 0 < len(event.data) <= 8:
            continue
        node = found[event.node]
        if event.stamp_ns > at_ns:
            if event.is_write:
                written_later.add((event.node, event.address))
            if event.address in node.heard or (event.node, event.address) in written_later:
                continue  # else what was read later was so all the time
        node.values[event.address] = int.from_bytes(event.data, "little", signed=_is_signed(node, event.address))
        node.heard.add(event.address)
    for node in found.values():
        node.pdos = tuple(pdo for pdo in _pdos(node) if pdo.can_id in log)
    return dict(sorted(found.items()))


def described_node(number: int, description: "Description") -> Node:
    """A node as its description sets it up, without any log."""
    node = Node(number, dict(_described(description)), description=description)
    node.pdos = tuple(_pdos(node))
    return node


def _working_ns(log: Log) -> int:
    """Return an instant in the middle of the SYNCs, in ns."""
    stream = log.of(FunctionCode.SYNC)
    if not len(stream):
        own = log.near(FunctionCode.TPDO1, range(1, FunctionCode.SDO_RESPONSE - FunctionCode.TPDO1))
        stream = max(own, key=len, default=stream)
    return int(stream.stamp_ns[len(stream) // 2]) if len(stream) else log.duration_ns


def _node_ids(log: Log) -> set[int]:
    """Return the node-IDs that send frames."""
    found = set()
    for can_id in log.streams:
        base, node = can_id & ~0x7F, can_id & 0x7F
        if can_id < 0x800 and node and base in {FunctionCode.HEARTBEAT, FunctionCode.SDO_RESPONSE, *TPDO_BASES}:
            found.add(node)
    return found


def _described(description: "Description") -> Iterable[tuple[ObjectAddress, int]]:
    for index, entry in description.dictionary.items():
        subindices = [0] if not hasattr(entry, "subindices") else list(entry.subindices)
        for subindex in subindices:
            content = description.values.get((index, subindex))
            variable = description.dictionary.get_variable(index, subindex)
            if content is None and variable is not None:
                content = variable.default
            if isinstance(content, int):
                yield (index, subindex), int(content)


def _data_type(node: Node, address: ObjectAddress) -> int | None:
    """Data type of an object by its number in CiA 301; None if it is not known."""
    variable = None if node.description is None else node.description.dictionary.get_variable(*address)
    if variable is not None:
        return variable.data_type or 0
    known = OBJECTS.get(address)
    return None if known is None else known[1]


def _is_signed(node: Node, address: ObjectAddress) -> bool:
    kind = _data_type(node, address)
    return address[0] in SIGNED if kind is None else kind in SIGNED_TYPES


def _pdos(node: Node) -> Iterable[Pdo]:
    for direction in ("rpdo", "tpdo"):
        for number in range(MOST_PDOS):
            communication, mapping = COMMUNICATION_PARAMETERS[direction] + number, MAPPING_PARAMETERS[direction] + number
            cob_id = node.value(communication, 1)
            if cob_id is None:
                if number >= 4:
                    continue
                cob_id = BASES[direction][number] + node.number
            can_id = cob_id & 0x7FF
            if cob_id & CobIdBit.INVALID or not can_id:
                continue
            entries = tuple(_entries(node, mapping))
            yield Pdo(node.number, direction, number + 1, can_id, node.value(communication, 2), entries)


def _entries(node: Node, mapping: int) -> Iterable[MappedNumber]:
    start = 0
    for place in range(1, min(node.value(mapping) or 0, MOST_ENTRIES) + 1):
        mapped = node.value(mapping, place)
        if mapped is None or mapped & 0xFF == 0 or start + (mapped & 0xFF) > 64:
            return
        address, bits = (mapped >> 16 & 0xFFFF, mapped >> 8 & 0xFF), mapped & 0xFF
        is_real = bits in {32, 64} and _data_type(node, address) in {DataType.REAL32, DataType.REAL64}
        yield MappedNumber(address, start, bits, _is_signed(node, address), is_real)
        start += bits
