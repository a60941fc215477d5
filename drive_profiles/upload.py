"""The upload transaction: identify, quiet, snapshot, write what differs, read everything back, store; or put everything back.

The outcome of each drive is one of

* *done*: every object of the set has been read back and holds, byte for byte, what it shall,
* *rolled back*: every object has been read back and holds what it held before,
* *unknown*: the objects that are listed could not be shown to hold either; what all others hold is said (``others``).

Whether the values were stored is said beside it. A write is never repeated without a look at what the drive holds.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Literal

from drive_profiles.checks import against_identity, against_values, doubts
from drive_profiles.device import Device, Found
from drive_profiles.errors import (
    DriveProfileError,
    InterruptedUploadError,
    NoAnswerError,
    NodeError,
    RefusedError,
    SdoAbortedError,
)
from drive_profiles.journal import Journal, Snapshot
from drive_profiles.memory import has_done_nothing, store_command
from drive_profiles.outcome import Kind, Options, Outcome, ReadBackError, Stored
from drive_profiles.parameter import Place, address_of
from drive_profiles.parameters import ParameterSet, Write
from drive_profiles.steps import Step, mapped, steps, support

MAX_PASSES = 3
"""How often the way back is tried, where writing one object changes another."""


class Upload:
    """The transaction of one drive, step by step; `drive_profiles.fleet` makes the steps of one or several drives in order.

    Attributes:
        device: The drive.
        found: Who it said it is.
        writes: What each line of the set means in bytes.
        stored: Whether the drive keeps what it holds over a loss of power, as far as this upload has told it to.
    """

    def __init__(self, device: Device, parameter_set: ParameterSet, options: Options, bus: str = "") -> None:
        """Join them; nothing is sent."""
        self.device = device
        self.parameter_set = parameter_set
        self.options = options
        self.bus = bus
        self.found: Found | None = None
        self.writes: list[Write] = []
        self.warnings: list[str] = []
        self._goal: dict[Place, bytes] = {}
        self._old: dict[Place, bytes] = {}
        self._steps: list[Step] = []
        self._attempted: dict[Place, None] = {}
        self._journal: Journal | None = None
        self._going_back = False
        self._boots = 0
        self.stored: Stored = "no"

    @property
    def changes(self) -> list[tuple[Write, bytes]]:
        """What would be written, each with what the drive holds now."""
        return [(write, self._old[write.place]) for write in self.writes if self._old[write.place] != write.data]

    @property
    def places(self) -> list[Place]:
        """Every object that the upload concerns."""
        return list(self._old)

    def restarted(self) -> None:
        """The node has been reset on purpose."""
        self._boots = self.device.port.boots

    # -- before anything is written ------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Identify, check that it is quiet, resolve every line, read what the drive holds.

        Raises:
            DriveProfileError: It is another device, it is enabled, or lines that cannot be written; nothing has been sent but
                reads.
        """
        self.device.port.forget()
        self._boots = self.device.port.boots
        self.found = found = self.device.identify()
        reasons = against_identity(self.device, self.parameter_set.header, found, self.options)
        if reasons:
            raise NodeError(self.device.node, "; ".join(reasons), "is this the right node, profile and file?")
        self.device.check_quiet()
        self._resolve(found)
        self.warnings = doubts(self.parameter_set, found, self.writes)
        self.device.check_quiet(self._axes())
        self._goal = {write.place: write.data for write in self.writes}
        self._old = {place: self._before(place) for place in (*self._goal, *sorted(support(self._goal) - set(self._goal)))}
        self._old |= {place: self._before(place) for place in mapped(self._goal, self._old)}
        self._goal |= {place: data for place, data in self._old.items() if place not in self._goal}
        self._steps = steps(self._goal, self._old)
        if strays := self.device.port.strays:
            names = ", ".join(self.named(place) for place in sorted(strays))
            what = f"a disturbed frame, or another SDO client, has written {names}, whose old value is not known"
            raise NodeError(self.device.node, what, "check the bus")

    def still_as_prepared(self) -> None:
        """The same device, quiet, and holding what it held: a user may have thought for long before saying yes.

        Raises:
            NodeError: It is not so; nothing has been written.
        """
        if self.device.identify() != self.found:
            raise NodeError(self.device.node, "another device answers now", "start again; nothing has been written")
        self.device.check_quiet(self._axes())
        moved = [self.named(place) for place, old in self._old.items() if self.device.read(place) != old]
        if moved:
            what = f"{', '.join(moved)} changed since they were read"
            raise NodeError(self.device.node, what, "start again; nothing has been written")

    def _axes(self) -> list[int]:
        """The axes of a multi-axis device that the set concerns; the first always."""
        return sorted({0, *((place[0] - 0x6000) // 0x800 for place in self._goal if 0x6000 <= place[0] < 0xA000)})

    def _check_restart(self) -> None:
        """A node that has restarted meanwhile holds what it has stored, whatever was read before."""
        if self.device.port.boots != self._boots:
            self._boots = self.device.port.boots
            raise NodeError(self.device.node, "it has restarted meanwhile", "is its supply sound?")

    def _before(self, place: Place) -> bytes:
        """What an object holds before anything is written; of the length that its type has, or it is read once more."""
        entry = self.device.catalogue.get(place)
        kind = None if entry is None else entry.data_type
        held = self.device.read(place)
        if kind is None or kind.size in {None, len(held)}:
            return held
        held = self.device.read(place)
        if len(held) != kind.size:
            what = f"{self.named(place)} has {len(held)} bytes, a {kind.name} has {kind.size}"
            raise NodeError(self.device.node, what, "is this the right profile or EDS?")
        return held

    def _resolve(self, found: Found) -> None:
        """Lines to bytes; every reason against it at once."""
        header = self.parameter_set.header
        self.writes = self.device.resolve(self.parameter_set, self.options.classes, limits=self.options.limits)
        reasons = against_values(self.device, header, found, self.writes, self.options)
        if reasons:
            raise RefusedError(*reasons)

    def open_journal(self) -> None:
        """Write the snapshot to disk; nothing is written to the drive before that.

        Raises:
            FileError: It cannot be written.
        """
        if not self._steps or self._journal is not None:
            return
        found = self.found
        identity = {} if found is None else {
            "device_type": found.device_type, "vendor_id": found.vendor_id, "product_code": found.product_code,
            "revision": found.revision, "serial_number": found.serial_number,
        }  # fmt: skip
        names = {write.place: write.entry.name for write in self.writes}
        profile = self.device.profile.name if self.device.profile else ""
        snapshot = Snapshot(self.device.node, self.bus, identity, profile, self._old, self._goal, names)
        stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime()) + f"-{time.time_ns() % 1_000_000_000:09d}"
        self._journal = Journal(self.options.journals / f"node{self.device.node}-{stamp}.jsonl", snapshot)

    # -- writing -------------------------------------------------------------------------------------------------------

    def write(self, cancelled: Callable[[], bool], progress: Callable[[], None]) -> None:
        """Write what differs, each once, then read everything back.

        Raises:
            DriveProfileError: Something failed; `roll_back` is next.
        """
        for place, data in self._steps:
            if cancelled():
                raise InterruptedUploadError(f"node {self.device.node}: interrupted")
            self._put(place, data)
            progress()
        self.verify(cancelled, progress)

    def _put(self, place: Place, data: bytes) -> None:
        self._attempted[place] = None
        self._note("write", place, data=data.hex())
        self.device.write(place, data, self._shown(place, data))
        self._note("written", place, data=data.hex())

    def _shown(self, place: Place, data: bytes) -> object:
        for write in self.writes:
            if write.place == place and write.data == data:
                return f"{write.value} {write.entry.unit}".rstrip()
        return data.hex(" ")

    def verify(self, cancelled: Callable[[], bool] = lambda: False, progress: Callable[[], None] = lambda: None) -> None:
        """Read every object of the set, raw bytes compared.

        Raises:
            ReadBackError: Some hold something else.
            DriveProfileError: Some could not be read.
        """
        wrong: list[tuple[str, str]] = []
        for place, data in self._goal.items():
            if cancelled():
                raise InterruptedUploadError(f"node {self.device.node}: interrupted")
            held = self.device.read(place)
            if held != data:
                wrong.append((self.named(place), f"holds {held.hex(' ')}, not {data.hex(' ')}"))
            progress()
        self._check_restart()
        astray = "was written by a disturbed frame, or by another SDO client"
        wrong += [(self.named(place), astray) for place in sorted(self.device.port.strays)]
        if wrong:
            raise ReadBackError(self.device.node, wrong)

    # -- the end -------------------------------------------------------------------------------------------------------

    def store(self) -> None:
        """Let the drive keep its values; it must still be quiet.

        Raises:
            SdoAbortedError: It refuses, and has stored nothing.
            NoAnswerError: It does not say; `outcome_done` says *unknown* then.
            DriveProfileError: It has no store command.
        """
        command = store_command(self.device)
        self.device.check_quiet(self._axes())
        self._check_restart()
        before = self.stored
        self._note("storing")
        self.stored = "unknown"
        try:
            command.give(self.device)
        except SdoAbortedError as error:
            if has_done_nothing(error):
                self.stored = before
                self._note("not stored")
            raise
        self.stored = "yes"
        self._note("stored")
        self._check_restart()

    def done(self) -> Outcome:
        """The drive holds the set."""
        if self.stored == "unknown":
            what = (f"{store_command(self.device).address} (the store command)",)
            return self.end("unknown", what, "the drive did not answer it", NoAnswerError.exit_code, others="new")
        return self.end("done")

    def roll_back(self, error: BaseException, *, store_again: bool = False) -> Outcome:
        """Put back what was written, read everything back, and say what is certain.

        Only what this upload has tried to write is put back: an object that it never touched is somebody else's.
        """
        reason = str(error)
        code = error.exit_code if isinstance(error, DriveProfileError) else 1
        self._going_back = True
        if not self.options.rollback:
            touched = [*self._attempted, *sorted(self.device.port.strays - set(self._attempted))]
            if self.stored != "no":
                touched.append(store_command(self.device).place)
            if touched:
                return self.end("unknown", tuple(map(self.named, touched)), reason, code)
        self._note("rolling back", reason=reason)
        held = self._put_back()
        lost = [place for place, data in held.items() if data != self._old[place]]
        lost += sorted(self.device.port.strays - set(self._old))
        if store_again and not lost:
            lost += self._store_again()
        elif self.stored != "no":
            lost.append(store_command(self.device).place)
        if lost:
            return self.end("unknown", tuple(map(self.named, lost)), reason, code)
        return self.end("rolled back", reason=reason, code=code)

    def _put_back(self) -> dict[Place, bytes | None]:
        """Write what this upload has tried to write as it was, the last first; what every object holds then.

        The way back passes through states that were valid on the way there. Where a write changes another object it takes another
        pass; an enabled drive is read, and not written to.
        """
        held = self._read_all()
        for _ in range(MAX_PASSES):
            known = {place: data for place, data in held.items() if data is not None}
            mine = [*reversed(self._attempted), *sorted(self.device.port.strays)]
            # without the COB-ID of its PDO an object cannot be written in the right order
            goal = {place: self._old[place] for place in mine if place in self._old and support([place]) | {place} <= set(known)}
            back = steps(goal, known)
            boots = self.device.port.boots
            try:
                self.device.check_quiet(self._axes())
            except DriveProfileError:
                break
            for place, data in back:
                with contextlib.suppress(DriveProfileError):  # what it holds is looked at below
                    self._put(place, data)
            if back:
                held = self._read_all()
            if self.device.port.boots == boots and not steps(goal, {**known, **{p: d for p, d in held.items() if d is not None}}):
                break
            if self.device.port.boots != boots:
                held = self._read_all()
        return held

    def _store_again(self) -> list[Place]:
        """It has stored, or perhaps, and then something failed: its old values are stored over the new ones."""
        try:
            self.store()
        except DriveProfileError:
            return [store_command(self.device).place]
        self.stored = "again"
        return []

    def _read_all(self) -> dict[Place, bytes | None]:
        held: dict[Place, bytes | None] = {}
        for place in self._old:
            try:
                held[place] = self.device.read(place)
            except DriveProfileError:
                held[place] = None
                self._note("lost", place)
            else:
                self._note("read", place, data=(held[place] or b"").hex())
        for place in self.device.port.strays - set(self._old):
            self._note("lost", place)
        return held

    def end(
        self,
        kind: Kind,
        unknown: tuple[str, ...] = (),
        reason: str = "",
        code: int = 0,
        *,
        others: Literal["new", "old"] = "old",
    ) -> Outcome:
        """The outcome, and the end of the journal."""
        self._going_back = True
        self._note("outcome", outcome=kind, unknown=list(unknown), reason=reason)
        path = None
        if self._journal is not None:
            path = self._journal.path
            with contextlib.suppress(OSError):  # a full disk
                self._journal.close()
            self._journal = None
        others = "new" if kind == "done" else others
        return Outcome(self.device.node, kind, len(self.changes), unknown, others, self.stored, reason, path, code)

    def _note(self, event: str, place: Place | None = None, **more: object) -> None:
        """A line of the journal. On the way there no write goes without one; the way back does not stop for a full disk."""
        if self._journal is None:
            return
        try:
            self._journal.note(event, place, **more)
        except (OSError, ValueError) as error:  # ValueError: text that is no Unicode
            if not self._going_back:
                raise RefusedError(f"the journal {self._journal.path} cannot be written ({error})") from error

    def named(self, place: Place) -> str:
        """Address and name of an object."""
        name = self.device.name_of(place)
        return f"{address_of(place)} ({name})" if name else address_of(place)
