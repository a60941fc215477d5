"""Configuration of PDOs over SDO in CiA 301's order, and its restoration."""

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drive_profiles.standard.cia301 import CobIdBit, DataType
from hil.errors import HilError, SdoAbortedError

if TYPE_CHECKING:
    from hil.master.network import Network

U8, U32 = DataType.UNSIGNED8, DataType.UNSIGNED32
SYNCHRONOUS = 1
"""Transmission type: with every SYNC."""
MAX_MAPPED = 8


@dataclass(frozen=True)
class MappedObject:
    """One object of a PDO."""

    index: int
    subindex: int
    kind: DataType

    @property
    def value(self) -> int:
        """Value of the mapping parameter."""
        return self.index << 16 | self.subindex << 8 | 8 * int(self.kind.size or 0)


@dataclass(frozen=True)
class PdoConfiguration:
    """Contents of a PDO's two records.

    Attributes:
        communication: Index of the communication record; the mapping record is 200h above it.
        cob_id: COB-ID (sub-index 1), with its flags.
        transmission_type: Transmission type (sub-index 2).
        idle: Mapping parameters behind those in use, which a node may hold but does not use.
    """

    communication: int
    cob_id: int
    transmission_type: int
    mapped: tuple[int, ...]
    idle: tuple[int, ...] = ()

    def apply(self, network: "Network", node: int) -> None:
        """Write the records: invalid, count 0, entries, count, type, valid.

        CiA 301, 7.5.2.36 and 7.5.2.38.
        """
        mapping = self.communication + 0x200
        write = network.write
        write(node, self.communication, 1, U32, self.cob_id | CobIdBit.INVALID, "COB-ID of a PDO")
        write(node, mapping, 0, U8, 0, "number of mapped objects")
        for subindex, value in enumerate(self.mapped, start=1):
            write(node, mapping, subindex, U32, value, "mapped object")
        for subindex, value in enumerate(self.idle, start=len(self.mapped) + 1):
            with contextlib.suppress(SdoAbortedError):  # a node need not take what it does not use
                write(node, mapping, subindex, U32, value, "mapped object")
        write(node, mapping, 0, U8, len(self.mapped), "number of mapped objects")
        write(node, self.communication, 2, U8, self.transmission_type, "transmission type")
        if not self.cob_id & CobIdBit.INVALID:
            write(node, self.communication, 1, U32, self.cob_id, "COB-ID of a PDO")


def read_pdo(network: "Network", node: int, communication: int) -> PdoConfiguration:
    """Read the configuration of a PDO."""
    mapping = communication + 0x200
    cob_id = network.read(node, communication, 1, U32, "COB-ID of a PDO")
    kind = network.read(node, communication, 2, U8, "transmission type")
    count = network.read(node, mapping, 0, U8, "number of mapped objects")
    values = []
    with contextlib.suppress(SdoAbortedError):  # beyond the count a node may have nothing to show
        for sub in range(1, MAX_MAPPED + 1):
            values.append(network.read(node, mapping, sub, U32, "mapped object"))  # noqa: PERF401 - kept up to an abort
    return PdoConfiguration(communication, cob_id, kind, tuple(values[:count]), tuple(values[count:]))


class PdoSet:
    """The PDOs that a run has changed in one node."""

    def __init__(self, network: "Network", node: int) -> None:
        self.network, self.node = network, node
        self._before: list[PdoConfiguration] = []

    def rpdo(self, number: int, objects: tuple[MappedObject, ...]) -> int:
        """Map objects to RPDO `number` (from 1) by SYNC; return its identifier."""
        return self._set(0x1400 + number - 1, 0x100 + 0x100 * number + self.node, objects)

    def tpdo(self, number: int, objects: tuple[MappedObject, ...]) -> int:
        """Map objects to TPDO `number` (from 1) by SYNC; return its identifier."""
        return self._set(0x1800 + number - 1, 0x080 + 0x100 * number + self.node, objects)

    def _set(self, communication: int, can_id: int, objects: tuple[MappedObject, ...]) -> int:
        self._before.append(read_pdo(self.network, self.node, communication))
        values = tuple(entry.value for entry in objects)
        PdoConfiguration(communication, can_id, SYNCHRONOUS, values).apply(self.network, self.node)
        return can_id

    def silence(self, communication: int) -> None:
        """Disable a PDO if the node has it."""
        try:
            before = read_pdo(self.network, self.node, communication)
        except SdoAbortedError:
            return
        if not before.cob_id & CobIdBit.INVALID:
            self._before.append(before)
            self.network.write(self.node, communication, 1, U32, before.cob_id | CobIdBit.INVALID, "COB-ID of a PDO")

    def restore(self) -> list[str]:
        """Restore the former configurations; return the refusals in words."""
        refused = []
        while self._before:
            try:
                self._before.pop().apply(self.network, self.node)
            except HilError as error:
                refused.append(str(error))
        return refused
