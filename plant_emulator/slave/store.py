"""Storage of a node's values over a loss of power."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

from drive_profiles.standard.cia301 import DataType, SdoAbortCode, Value
from drive_profiles.standard.object_address import ObjectAddress
from plant_emulator.slave.dictionary import Access, Dictionary, Entry, ObjectType, Postponed, WriteHook

STORE, RESTORE = 0x1010, 0x1011
VERIFY = 0x1020
SAVE, LOAD = 0x6576_6173, 0x6461_6F6C
"""The signatures "save" and "load", least significant byte first."""

ON_COMMAND = 1
"""Value of either object when it is read: bit 0, the node stores on command, or restores."""


EVERYTHING = range(0x1000, 0x10000)
COMMUNICATION = range(0x1000, 0x2000)
APPLICATION = range(0x6000, 0xA000)
MANUFACTURER = range(0x2000, 0x6000)

GROUPS: tuple[tuple[str, range], ...] = (
    ("all parameters", EVERYTHING),
    ("communication parameters", COMMUNICATION),
    ("application parameters", APPLICATION),
    ("manufacturer defined parameters", MANUFACTURER),
)
"""Name and indices of sub-indices 1, 2, … of either object."""

VOLATILE = frozenset({
    *(0x1001, 0x1003, STORE, RESTORE),
    *(0x6040, 0x6060, 0x6071, 0x607A, 0x60B0, 0x60B1, 0x60B2, 0x60C1, 0x60FE, 0x60FF),
})  # fmt: skip
"""Objects that are never stored: commands, set-points and the history of errors."""


@dataclass(frozen=True, slots=True)
class StoreCommand:
    """One entry that stores or restores when its signature is written.

    Attributes:
        is_restore: "load" rather than "save".
        indices: The objects that it concerns.
    """

    address: ObjectAddress
    signature: int
    is_restore: bool = False
    indices: range = EVERYTHING


def store_entries() -> Iterator[Entry]:
    """Return the entries 1010h and 1011h, one sub-index per group."""
    for index, name, verb in ((STORE, "Store parameters", "Save"), (RESTORE, "Restore default parameters", "Restore")):
        for subindex, (group, _) in enumerate(GROUPS, 1):
            yield replace(command_entry((index, subindex), f"{verb} {group}"), record_name=name, object_type=ObjectType.ARRAY)


def command_entry(address: ObjectAddress, name: str) -> Entry:
    """Return the entry of one command."""
    return Entry(*address, name, DataType.UNSIGNED32, Access.RW, ON_COMMAND)


def standard_commands() -> tuple[StoreCommand, ...]:
    """Return the commands that `store_entries` has entries for."""
    return tuple(
        StoreCommand((index, subindex), signature, index == RESTORE, indices)
        for index, signature in ((STORE, SAVE), (RESTORE, LOAD))
        for subindex, (_, indices) in enumerate(GROUPS, 1)
    )


class ParameterStore:
    """Memory of a dictionary's values.

    The next reset restores the values of the last "save".

    The stored values change in one step at the end of the storing: a loss of power or a reset before that leaves the old
    values. "load" drops the stored values, so that the next reset restores the factory defaults; until then nothing changes.

    1020h, if it exists, tells a configuration tool that the node is still configured as the tool left it. It becomes 0 as
    soon as an SDO changes a storable value, or "load" the stored ones (CiA 301, 7.5.2.23). A tool therefore writes it last.

    Args:
        dictionary: Must have the entries of the commands.
        commands: Those whose entries the dictionary does not have are left out.

    Attributes:
        time_ns: Duration of storing; the SDO answer comes when it is over. A node that is stopped or reset before that
            keeps the old values and never answers: its services end without a word (CiA 301, 7.3.2.2.5).
        fails: True if the memory refuses, with abort 0606 0000h at the end of that time.
        may_store: Asked at each command: why the node cannot store now, or None.
    """

    def __init__(self, dictionary: Dictionary, commands: Sequence[StoreCommand], time_ns: int = 0) -> None:
        if time_ns < 0:
            raise ValueError(f"storing takes {time_ns} ns; expected 0 or more")
        self.time_ns = time_ns
        self.fails = False
        self.may_store: Callable[[], SdoAbortCode | None] = lambda: None
        self._dictionary = dictionary
        present = [command for command in commands if command.address in dictionary]
        self._volatile = VOLATILE | {command.address[0] for command in present}
        self._verify = [(VERIFY, subindex) for subindex in (1, 2) if (VERIFY, subindex) in dictionary]
        dictionary.on_change = self._doubt
        for command in present:
            dictionary.on_read(*command.address, lambda: ON_COMMAND)
            dictionary.on_write(*command.address, self._writer(command))

    @property
    def stored(self) -> dict[ObjectAddress, Value]:
        """Values that the next reset restores, by address."""
        return dict(self._dictionary.stored)

    def is_storable(self, entry: Entry) -> bool:
        """Return True if "save" stores the entry."""
        return entry.access.is_writable and entry.index not in self._volatile

    def _writer(self, command: StoreCommand) -> WriteHook:
        def write(signature: int) -> SdoAbortCode | None:
            if signature != command.signature:
                return SdoAbortCode.NOT_STORED
            code = self.may_store()
            if code is not None:
                return code
            if command.is_restore:
                self._forget(command.indices)
                return None
            raise Postponed(self.time_ns, partial(self._keep, self._values(command.indices), self._is_doubted))

        return write

    def _values(self, indices: range) -> dict[ObjectAddress, Value]:
        concerned = (entry for entry in self._dictionary if _is_in(entry.index, indices) and self.is_storable(entry))
        return {(e.index, e.subindex): self._dictionary.cell(e.index, e.subindex).value for e in concerned}

    def _keep(self, values: dict[ObjectAddress, Value], is_doubted: bool) -> SdoAbortCode | None:
        if self.fails:
            return SdoAbortCode.HARDWARE
        stored = {**self._dictionary.stored, **values}
        if is_doubted:  # a group without 1020h must not leave the date of another configuration
            stored |= {address: 0 for address in self._verify if address in stored}
        self._dictionary.stored = stored
        return None

    def _forget(self, indices: range) -> None:
        stored = self._dictionary.stored
        self._dictionary.stored = {
            address: v for address, v in stored.items() if not _is_in(address[0], indices) and address not in self._verify
        }
        self._clear_verify()

    @property
    def _is_doubted(self) -> bool:
        return not any(self._dictionary.cell(*address).value for address in self._verify)

    def _doubt(self, entry: Entry) -> None:
        if entry.index != VERIFY and self.is_storable(entry):
            self._clear_verify()

    def _clear_verify(self) -> None:
        for address in self._verify:
            self._dictionary.cell(*address).value = 0


def _is_in(index: int, indices: range) -> bool:
    """Return True if a group has an index.

    `in` would compare members of an enumeration one by one, which takes 80 ms per store.
    """
    return indices.start <= index < indices.stop
