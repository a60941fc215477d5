"""The object dictionary that a node's SDO server, PDOs and owner share."""

import math
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from enum import Enum, IntEnum
from functools import lru_cache
from typing import Any

from drive_profiles.standard.cia301 import MAX_NODE_ID, PACKERS, DataType, SdoAbortCode, Value, abort_text, decode, encode

_CAN_ID = 0x7FF

ReadHook = Callable[[], Value]
WriteHook = Callable[[Any], int | None]
"""Gives the abort code that refuses a value, the standard's or a maker's own, or None."""


def _nothing(_: object) -> None:
    """Stand in for a hook that the owner does not set."""


class SdoAbort(Exception):  # noqa: N818 - the standard's word: an abort, of which not each is an error
    """A refused access, reported to the SDO client by its code."""

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(f"{code:08X}h {abort_text(code)}")


class Postponed(Exception):  # noqa: N818 - not an error: the answer comes later
    """A write whose SDO answer comes only after some time.

    A write hook raises it; it never leaves the slave package.

    Args:
        duration_ns: Time from now until the answer.
        finish: Called at that time; gives the code that refuses the access after all, or None.
    """

    def __init__(self, duration_ns: int, finish: Callable[[], SdoAbortCode | None]) -> None:
        self.duration_ns, self.finish = duration_ns, finish
        super().__init__(f"the answer comes in {duration_ns} ns")


class Access(Enum):
    """Access attribute of an entry, as in an EDS.

    Source: CiA 306-1, 4.5.3.
    """

    RO = "ro"
    WO = "wo"
    RW = "rw"
    CONST = "const"
    RWW = "rww"
    """Read and write; where mappable, in an RPDO only."""
    RWR = "rwr"
    """Read and write; where mappable, in a TPDO only."""

    @property
    def is_readable(self) -> bool:
        """True if an SDO may read the entry."""
        return self is not Access.WO

    @property
    def is_writable(self) -> bool:
        """True if an SDO may write the entry."""
        return self not in _READ_ONLY


_READ_ONLY = (Access.RO, Access.CONST)


class ObjectType(IntEnum):
    """Object codes (CiA 301, 7.4.3)."""

    VAR = 7
    ARRAY = 8
    RECORD = 9


class ResetKind(Enum):
    """Scope of an NMT reset to defaults (CiA 301, 7.3.2.2.1)."""

    COMMUNICATION = "communication"
    """Objects 1000h to 1FFFh."""
    NODE = "node"
    """All objects."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One value of the dictionary: type, access, default and limits.

    Attributes:
        index: 0001h to FFFFh.
        subindex: 0 for a variable.
        data_type: Decides the length on the bus.
        mappable: True if a PDO may carry the entry; in which direction follows from `access`.
        object_type: ARRAY or RECORD; left out, an object with sub-indices is a RECORD.
        node_relative: The default is `default` plus the node-ID (``$NODEID+`` in an EDS).

    Raises:
        ValueError: The description contradicts itself.
    """

    index: int
    subindex: int
    name: str
    data_type: DataType
    access: Access
    default: Value
    low: float | None = None
    high: float | None = None
    mappable: bool = False
    record_name: str | None = None
    object_type: ObjectType | None = None
    node_relative: bool = False

    def __post_init__(self) -> None:
        """Refuse a contradictory entry; round real numbers to their type."""
        problem = self._problem()
        if problem is not None:
            raise ValueError(f"{self}: {problem}")
        if self.data_type.is_real:
            # Else 0.1 written to a REAL32 would be above a limit of 0.1.
            for name in ("default", "low", "high"):
                value = getattr(self, name)
                if value is not None:
                    object.__setattr__(self, name, decode(self.data_type, encode(self.data_type, value)))
        code = self.refusal(self.default_for(1))
        if code is not None:
            raise ValueError(f"{self}: default {self.default!r}: {code.text}")

    def __str__(self) -> str:
        return f"{self.index:04X}h:{self.subindex:02X}h {self.name!r}"

    def _problem(self) -> str | None:
        if not (1 <= self.index <= 0xFFFF and 0 <= self.subindex <= 0xFE):
            return "index or sub-index out of range"
        for name in (self.name, self.record_name):
            # What an EDS, an INI file, can carry as a name.
            if name is not None and (not name.isprintable() or name != name.strip() or not name or ";" in name):
                return f"{name!r} is not a possible name in an EDS"
        if self.mappable and self.data_type.size is None:
            return f"{self.data_type.name} has no fixed length and cannot be mapped"
        limits = [limit for limit in (self.low, self.high) if limit is not None]
        if limits and not (self.data_type.is_integer or self.data_type.is_real):
            return f"{self.data_type.name} has no limits"
        if self.low is not None and self.high is not None and self.low > self.high:
            return f"low limit {self.low} above high limit {self.high}"
        if self.node_relative and not self.data_type.is_integer:
            return "only a whole number can have the node-ID added"
        try:
            for value in (self.default_for(0), self.default_for(MAX_NODE_ID), *limits):
                encode(self.data_type, value)
        except ValueError as error:
            return str(error)
        return None

    def default_for(self, node_id: int) -> Value:
        """Return the default in the node of this number."""
        if self.node_relative and isinstance(self.default, int):
            return self.default + node_id
        return self.default

    def refusal(self, value: Any) -> SdoAbortCode | None:
        """Return the reason why a value is refused, or None."""
        if self.data_type.is_real and not math.isfinite(value):
            return SdoAbortCode.INVALID_VALUE
        if self.high is not None and value > self.high:
            return SdoAbortCode.VALUE_TOO_HIGH
        if self.low is not None and value < self.low:
            return SdoAbortCode.VALUE_TOO_LOW
        return None

    @property
    def is_rpdo_mappable(self) -> bool:
        """True if a PDO that the node receives may carry the entry."""
        return self.mappable and self.access in {Access.WO, Access.RW, Access.RWW}

    @property
    def is_tpdo_mappable(self) -> bool:
        """True if a PDO that the node sends may carry the entry."""
        return self.mappable and self.access in {Access.RO, Access.CONST, Access.RW, Access.RWR}


class Cell:
    """Value of one entry, with its hooks.

    PDOs and the owner hold a reference to it, so that a cycle costs no look-up.

    Attributes:
        is_guarded: True if the entry refuses some values of its type.
        value: The present value; the owner may set it directly, unchecked. It does not count where there is a read hook.
        write_hook: Checks and applies a value from the bus before it is stored.
    """

    __slots__ = ("_packer", "entry", "is_guarded", "is_readable", "read_hook", "value", "write_hook")

    def __init__(self, entry: Entry) -> None:
        self.entry = entry
        self.value: Value = entry.default
        self.read_hook: ReadHook | None = None
        self.write_hook: WriteHook | None = None
        self._packer: struct.Struct | None = PACKERS.get(entry.data_type)
        self.is_readable = entry.access.is_readable
        self.is_guarded = entry.data_type.is_real or entry.low is not None or entry.high is not None

    def current(self) -> Value:
        """Return the value of this instant."""
        return self.value if self.read_hook is None else self.read_hook()

    def encoded(self) -> bytes:
        """Return the value of this instant as bytes."""
        value = self.value if self.read_hook is None else self.read_hook()
        if self._packer is not None:
            try:
                return self._packer.pack(value)
            except (struct.error, OverflowError):  # `encode` says why
                pass
        return encode(self.entry.data_type, value)

    def length_refusal(self, length: int) -> SdoAbortCode | None:
        """Return the reason why a length is refused, or None."""
        if self._packer is None or length == self._packer.size:
            return None
        return SdoAbortCode.TOO_LONG if length > self._packer.size else SdoAbortCode.TOO_SHORT

    def assign(self, value: Value) -> int | None:
        """Write a value from the bus; return the reason for refusal.

        The value must have the right type. A refusal changes nothing; None means success.
        """
        if self.is_guarded:
            code: int | None = self.entry.refusal(value)
            if code is not None:
                return code
        if self.write_hook is not None:
            code = self.write_hook(value)
            if code is not None:
                return code
        self.value = value
        return None


class SharedCell(Cell):
    """Cell whose value lies in an array that others read and write.

    Args:
        values: Whole numbers of that array.
        place: Which of them is the value.
    """

    __slots__ = ("_place", "_values")

    def __init__(self, entry: Entry, values: "memoryview[int]", place: int) -> None:
        self._values, self._place = values, place
        super().__init__(entry)

    @property
    def value(self) -> Value:
        """The present value, as in `Cell`."""
        return self._values[self._place]

    @value.setter
    def value(self, value: Value) -> None:
        self._values[self._place] = int(value)


@lru_cache(maxsize=1 << 12)
def _count_entry(last: Entry) -> Entry:
    """Return sub-index 0 of the array or record whose highest sub-index this is; nodes are made by the thousand."""
    return replace(
        last, subindex=0, name="Highest sub-index supported", data_type=DataType.UNSIGNED8, access=Access.RO,
        default=last.subindex, low=None, high=None, mappable=False, node_relative=False,
    )  # fmt: skip


class Dictionary:
    """All entries of a node.

    Sub-index 0 of an array or record, the highest sub-index, is provided where the entries do not bring their own.

    Args:
        entries: In any order.
        node_id: Added to the defaults that depend on it; the `Slave` sets it.

    Attributes:
        stored: By address, the value that a reset restores instead of the default; see `ParameterStore`.
        on_change: Called with the entry that an SDO has given another value; PDOs pass it by.
        on_hook: Called when an entry has got another hook.

    Raises:
        ValueError: Two entries have one address.
    """

    def __init__(self, entries: Iterable[Entry], node_id: int = 0) -> None:
        self.node_id = node_id
        self.stored: dict[tuple[int, int], Value] = {}
        self.on_change: Callable[[Entry], None] = _nothing
        self.on_hook: Callable[[], None] = lambda: None
        self._cells: dict[tuple[int, int], Cell] = {}
        self._highest: dict[int, int] = {}
        for entry in sorted(entries, key=lambda entry: (entry.index, entry.subindex)):
            address = entry.index, entry.subindex
            if address in self._cells:
                raise ValueError(f"{entry}: an entry at this address is given twice")
            self._cells[address] = Cell(entry)
            self._highest[entry.index] = entry.subindex
        for index, highest in self._highest.items():
            if highest > 0 and (index, 0) not in self._cells:
                self._cells[index, 0] = Cell(_count_entry(self._cells[index, highest].entry))
        self._cells = dict(sorted(self._cells.items()))
        self.reset(ResetKind.NODE)

    def __contains__(self, address: tuple[int, int]) -> bool:
        return address in self._cells

    def __iter__(self) -> Iterator[Entry]:
        return (cell.entry for cell in self._cells.values())

    def __len__(self) -> int:
        return len(self._cells)

    def cell(self, index: int, subindex: int = 0) -> Cell:
        """Return the cell of an entry, for its owner.

        Raises:
            KeyError: There is no such entry.
        """
        try:
            return self._cells[index, subindex]
        except KeyError:
            raise KeyError(f"no entry {index:04X}h:{subindex:02X}h") from None

    def get(self, index: int, subindex: int = 0) -> Value:
        """Return the value of this instant, whatever the access.

        Raises KeyError if there is no such entry.
        """
        return self.cell(index, subindex).current()

    def get_int(self, index: int, subindex: int = 0) -> int:
        """Return the value of an entry that holds a whole number.

        Raises:
            KeyError: There is no such entry.
            TypeError: The entry holds something else.
        """
        value = self.get(index, subindex)
        if not isinstance(value, int):
            raise TypeError(f"{index:04X}h:{subindex:02X}h holds {value!r}, not a whole number")
        return value

    def set(self, index: int, subindex: int, value: Value) -> None:
        """Set a value as the owner, past access and write hook.

        Raises:
            KeyError: There is no such entry.
            ValueError: The value is not of the entry's type, or outside its limits.
        """
        cell = self.cell(index, subindex)
        value = decode(cell.entry.data_type, encode(cell.entry.data_type, value))
        code = cell.entry.refusal(value)
        if code is not None:
            raise ValueError(f"{cell.entry} = {value!r}: {code.text}")
        cell.value = value

    def on_read(self, index: int, subindex: int, hook: ReadHook) -> None:
        """Set a hook that supplies the value at every read and sample."""
        self.cell(index, subindex).read_hook = hook
        self.on_hook()

    def on_write(self, index: int, subindex: int, hook: WriteHook) -> None:
        """Set a hook that checks and applies values from the bus.

        A code that the hook returns refuses the value, and nothing changes.

        Raises:
            KeyError: There is no such entry.
            ValueError: The entry has a write hook already.
        """
        cell = self.cell(index, subindex)
        if cell.write_hook is not None:
            raise ValueError(f"{cell.entry} has a write hook already; expected one owner; wrap_write puts another hook around it")
        cell.write_hook = hook
        self.on_hook()

    def wrap_write(self, index: int, subindex: int, wrap: Callable[[WriteHook | None], WriteHook]) -> None:
        """Put another write hook around the one that an entry has.

        `wrap` returns the new hook for the present one (None if there is none), which it calls or replaces.

        Raises:
            KeyError: There is no such entry.
        """
        cell = self.cell(index, subindex)
        cell.write_hook = wrap(cell.write_hook)
        self.on_hook()

    def share(self, index: int, subindex: int, values: "memoryview[int]", place: int) -> None:
        """Keep the value of an entry in an array, before anyone holds its cell.

        Raises:
            KeyError: There is no such entry.
        """
        old, cell = self.cell(index, subindex), SharedCell(self.cell(index, subindex).entry, values, place)
        cell.value = old.value
        self._cells[index, subindex] = cell

    def renumber(self, node_id: int) -> None:
        """Change the node-ID, with effect from the next reset.

        A stored COB-ID whose CAN-ID is the default of the old node-ID becomes that of the new one: else two nodes that swap their
        node-IDs would go on with each other's identifiers.
        """
        old, self.node_id = self.node_id, node_id
        for address, value in self.stored.items():
            entry = self._cells[address].entry
            default = entry.default_for(old)
            if entry.node_relative and isinstance(value, int) and isinstance(default, int) and not (value ^ default) & _CAN_ID:
                self.stored[address] = value - old + node_id

    def load(self, index: int, subindex: int = 0) -> None:
        """Pass a reset value to its owner's write hook.

        The rules are those for a value from the bus. If the owner refuses a stored value, the default replaces it.
        """
        cell = self.cell(index, subindex)
        if cell.write_hook is not None and cell.write_hook(cell.value) is not None:
            cell.value = cell.entry.default_for(self.node_id)
            cell.write_hook(cell.value)

    def reset(self, kind: ResetKind) -> None:
        """Restore the stored values, else the defaults, without the write hooks."""
        for address, cell in self._cells.items():
            if kind is ResetKind.NODE or 0x1000 <= address[0] <= 0x1FFF:
                stored = self.stored.get(address)
                cell.value = cell.entry.default_for(self.node_id) if stored is None else stored

    def find(self, index: int, subindex: int) -> Cell:
        """Return the cell that an SDO addresses.

        Raises:
            SdoAbort: There is no such object, or no such sub-index in it.
        """
        cell = self._cells.get((index, subindex))
        if cell is None:
            raise SdoAbort(SdoAbortCode.NO_SUBINDEX if index in self._highest else SdoAbortCode.NO_OBJECT)
        return cell

    def find_writable(self, index: int, subindex: int) -> Cell:
        """Return the cell that an SDO is about to write.

        Raises `SdoAbort` if the write is not allowed.
        """
        cell = self.find(index, subindex)
        if not cell.entry.access.is_writable:
            raise SdoAbort(SdoAbortCode.READ_ONLY)
        return cell

    def read(self, index: int, subindex: int) -> bytes:
        """Return the bytes of an SDO upload.

        Raises `SdoAbort` if the entry is absent or write only.
        """
        cell = self.find(index, subindex)
        if not cell.is_readable:
            raise SdoAbort(SdoAbortCode.WRITE_ONLY)
        return cell.encoded()

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Write the bytes of an SDO download.

        Raises `SdoAbort`, with nothing changed, if length, limits or owner refuse the value.
        """
        cell = self.find_writable(index, subindex)
        code: int | None = cell.length_refusal(len(data))
        before = cell.value
        if code is None:
            code = cell.assign(decode(cell.entry.data_type, data))
        if code is not None:
            raise SdoAbort(code)
        if cell.value != before:
            self.on_change(cell.entry)
