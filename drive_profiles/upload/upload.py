"""The upload transaction of one drive.

Its steps are: identify, check, take a snapshot, write the differences, read everything back, and store. If a step fails, the
former values are written back.

The result on each drive is one of

* * *done*: every object of the set has been read back and holds the new value, byte for byte,
* *rolled back*: every object has been read back and holds its former value,
* *unknown*: the listed objects could not be shown to hold either; ``others`` tells the state of all others, but for those that
  were not written and could not be read at the end, which are counted.

The result also says if the values were stored. A write is never repeated before the drive's value has been read again.
"""

import contextlib
import time
from collections.abc import Callable
from typing import Literal

from drive_profiles.device.device import Device, DeviceIdentity
from drive_profiles.device.memory import has_done_nothing, store_command
from drive_profiles.errors import (
    DriveProfileError,
    InterruptedUploadError,
    NoAnswerError,
    NodeError,
    RefusedError,
    SdoAbortedError,
)
from drive_profiles.parameter_set.parameters import ParameterSet, Write
from drive_profiles.parameter_set.steps import Step, mapped, steps, support
from drive_profiles.standard.object_address import ObjectAddress, address_text
from drive_profiles.upload.checks import identity_refusals, value_refusals, warnings_for
from drive_profiles.upload.journal import Journal, UploadSnapshot, journal_path
from drive_profiles.upload.result import Stored, UploadOptions, UploadReadBackError, UploadResult, UploadStatus

MAX_PASSES = 3
"""Number of attempts to restore everything, where writing one object changes another."""


class Upload:
    """Upload to one drive, step by step; `upload.fleet` calls the steps.

    Attributes:
        identity: Identity that the drive stated; None before `prepare`.
        writes: The objects of the set and their bytes.
        stored: ``yes``, ``no``, ``unknown`` or ``again``: the drive has stored its values on request of this upload.
    """

    def __init__(self, device: Device, parameter_set: ParameterSet, options: UploadOptions, bus: str = "") -> None:
        """Join device, set and options; the bus is for the journal."""
        self.device = device
        self.parameter_set = parameter_set
        self.options = options
        self.bus = bus
        self.identity: DeviceIdentity | None = None
        self.writes: list[Write] = []
        self.warnings: list[str] = []
        self._goal: dict[ObjectAddress, bytes] = {}
        self._old: dict[ObjectAddress, bytes] = {}
        self._steps: list[Step] = []
        self._attempted: dict[ObjectAddress, None] = {}
        self._journal: Journal | None = None
        self._going_back = False
        self._boots = 0
        self.stored: Stored = "no"

    @property
    def changes(self) -> list[tuple[Write, bytes]]:
        """Differing objects with the bytes that the drive holds now."""
        return [(write, self._old[write.address]) for write in self.writes if self._old[write.address] != write.data]

    @property
    def addresses(self) -> list[ObjectAddress]:
        """Addresses of all objects that the upload concerns."""
        return list(self._old)

    def restarted(self) -> None:
        """Note that the node has been reset on purpose."""
        self._boots = self.device.port.boots

    # -- before anything is written ------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Identify and check the drive, encode the set, read the values.

        Raises:
            DriveProfileError: It is another device, it is enabled, or a line cannot be written. The drive has only been read.
        """
        self.device.port.forget()
        self._boots = self.device.port.boots
        self.identity = identity = self.device.identify()
        reasons = identity_refusals(self.device, self.parameter_set.header, identity, self.options)
        if reasons:
            raise NodeError(self.device.node, "; ".join(reasons), "check node, profile and file")
        self.device.check_quiet()
        self._resolve(identity)
        self.warnings = warnings_for(self.parameter_set, identity, self.writes)
        if skipped_by_objflags := self.parameter_set.skipped_by_objflags(self.device.catalogue) if self.options.limits else []:
            self.warnings.append(
                f"left out, since the EDS excludes them from downloads (ObjFlags): {', '.join(skipped_by_objflags)}"
            )
        self.device.check_quiet(self._axes())
        self._goal = {write.address: write.data for write in self.writes}
        self._old = {address: self._before(address) for address in (*self._goal, *sorted(support(self._goal) - set(self._goal)))}
        self._old |= {address: self._before(address) for address in mapped(self._goal, self._old)}
        self._goal |= {address: data for address, data in self._old.items() if address not in self._goal}
        self._steps = steps(self._goal, self._old)
        if self.options.store:
            store_command(self.device).check(self.device)
        if strays := self.device.port.strays:
            names = ", ".join(self.named(address) for address in sorted(strays))
            what = f"a disturbed frame, or another SDO client, has written {names}, whose old value is not known"
            raise NodeError(self.device.node, what, "check the bus")

    def still_as_prepared(self) -> None:
        """Check that nothing has changed since `prepare`; a confirmation may take long.

        Raises:
            NodeError: Something has changed; nothing has been written.
        """
        if self.device.identify() != self.identity:
            raise NodeError(self.device.node, "another device answers now", "start again; nothing has been written")
        self.device.check_quiet(self._axes())
        moved = [self.named(address) for address, old in self._old.items() if self.device.read(address) != old]
        if moved:
            what = f"{', '.join(moved)} changed since they were read"
            raise NodeError(self.device.node, what, "start again; nothing has been written")

    def _axes(self) -> list[int]:
        """Return the device's axes that the set concerns, the first always."""
        return sorted({0, *((address[0] - 0x6000) // 0x800 for address in self._goal if 0x6000 <= address[0] < 0xA000)})

    def _check_restart(self) -> None:
        """Refuse a restarted node, which holds its stored values."""
        if self.device.port.boots != self._boots:
            self._boots = self.device.port.boots
            raise NodeError(self.device.node, "the node has restarted during the upload", "check its supply")

    def _before(self, address: ObjectAddress) -> bytes:
        """Read an object before writing, once more if its length is wrong."""
        entry = self.device.catalogue.get(address)
        data_type = None if entry is None else entry.data_type
        held = self.device.read(address)
        if data_type is None or data_type.size in {None, len(held)}:
            return held
        held = self.device.read(address)
        if len(held) != data_type.size:
            what = f"{self.named(address)} has {len(held)} bytes, but {data_type.name} has {data_type.size}"
            raise NodeError(self.device.node, what, "check the profile and the EDS")
        return held

    def _resolve(self, identity: DeviceIdentity) -> None:
        """Turn the lines into bytes; all objections are raised together."""
        header = self.parameter_set.header
        self.writes = self.device.resolve(self.parameter_set, self.options.classes, limits=self.options.limits)
        reasons = value_refusals(self.device, header, identity, self.writes, self.options)
        if reasons:
            raise RefusedError(*reasons)

    def open_journal(self) -> None:
        """Write the snapshot to disk before anything goes to the drive.

        Raises:
            FileError: The journal cannot be written.
        """
        if not self._steps or self._journal is not None:
            return
        identity = self.identity
        facts = {} if identity is None else {
            "device_type": identity.device_type, "vendor_id": identity.vendor_id, "product_code": identity.product_code,
            "revision": identity.revision, "serial_number": identity.serial_number,
        }  # fmt: skip
        names = {write.address: write.entry.name for write in self.writes}
        profile = self.device.profile.label if self.device.profile else ""
        snapshot = UploadSnapshot(self.device.node, self.bus, facts, profile, self._old, self._goal, names)
        self._journal = Journal(journal_path(self.options.journals, self.device.node, time.time_ns()), snapshot)

    # -- writing -------------------------------------------------------------------------------------------------------

    def write(self, cancelled: Callable[[], bool], progress: Callable[[], None]) -> None:
        """Write each differing object once, then read everything back.

        Raises:
            DriveProfileError: Something failed; `roll_back` is next.
        """
        for address, data in self._steps:
            if cancelled():
                raise InterruptedUploadError(f"node {self.device.node}: interrupted")
            self._put(address, data)
            progress()
        self.verify(cancelled, progress)

    def _put(self, address: ObjectAddress, data: bytes) -> None:
        self._attempted[address] = None
        self._note("write", address, data=data.hex())
        self.device.write(address, data, self._shown(address, data))
        self._note("written", address, data=data.hex())

    def _shown(self, address: ObjectAddress, data: bytes) -> object:
        for write in self.writes:
            if write.address == address and write.data == data:
                return f"{write.value} {write.entry.unit}".rstrip()
        return data.hex(" ")

    def verify(self, cancelled: Callable[[], bool] = lambda: False, progress: Callable[[], None] = lambda: None) -> None:
        """Read every object of the set, and compare the raw bytes.

        Raises:
            UploadReadBackError: Some objects hold other bytes.
            DriveProfileError: Some objects could not be read.
        """
        wrong: list[tuple[str, str]] = []
        for address, data in self._goal.items():
            if cancelled():
                raise InterruptedUploadError(f"node {self.device.node}: interrupted")
            held = self.device.read(address)
            if held != data:
                wrong.append((self.named(address), f"holds {held.hex(' ')}, not {data.hex(' ')}"))
            progress()
        self._check_restart()
        astray = "was written by a disturbed frame, or by another SDO client"
        wrong += [(self.named(address), astray) for address in sorted(self.device.port.strays)]
        if wrong:
            raise UploadReadBackError(self.device.node, wrong)

    # -- the end -------------------------------------------------------------------------------------------------------

    def store(self) -> None:
        """Store the drive's values; the drive must still be disabled.

        Raises:
            SdoAbortedError: The drive refuses, and has stored nothing.
            NoAnswerError: The drive does not answer; `done` then returns *unknown*.
            DriveProfileError: The drive has no store command.
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

    def done(self) -> UploadResult:
        """End an upload after which the drive holds the set."""
        if self.stored == "unknown":
            what = (f"{store_command(self.device).written_address} (the store command)",)
            return self.end("unknown", what, "the drive did not answer the store command", NoAnswerError.exit_code, others="new")
        return self.end("done")

    def roll_back(self, error: BaseException, *, store_again: bool = False) -> UploadResult:
        """Write the former values back and read everything back.

        The result states what is certain. Only objects that this upload has tried to write are written back. `store_again`: the
        drive may have stored the new values, so the former ones are stored over them.
        """
        reason = str(error)
        code = error.exit_code if isinstance(error, DriveProfileError) else 1
        self._going_back = True
        if not self.options.rollback:
            touched = [*self._attempted, *sorted(self.device.port.strays - set(self._attempted))]
            if self.stored != "no":
                touched.append(store_command(self.device).address)
            if touched:
                return self.end("unknown", tuple(map(self.named, touched)), reason, code)
        self._note("rolling back", reason=reason)
        held = self._put_back()
        written = {*self._attempted, *self.device.port.strays}
        unread = [address for address, data in held.items() if data is None and address not in written]
        lost = [address for address, data in held.items() if data != self._old[address] and address not in unread]
        lost += sorted(self.device.port.strays - set(self._old))
        if store_again and not lost:
            lost += self._store_again()
        elif self.stored != "no":
            lost.append(store_command(self.device).address)
        if lost or unread:
            # of nothing but unread ones each is named: there is nothing else to say
            return self.end("unknown", tuple(map(self.named, lost or unread)), reason, code, unread=len(unread) if lost else 0)
        return self.end("rolled back", reason=reason, code=code)

    def _put_back(self) -> dict[ObjectAddress, bytes | None]:
        """Write the former values of all attempted objects, the last first.

        Returns the bytes that every object then holds.

        In this order the drive passes through the same states as before. Where a write changes another object it takes another
        pass; an enabled drive is read, and not written to.
        """
        held = self._read_all()
        for _ in range(MAX_PASSES):
            known = {address: data for address, data in held.items() if data is not None}
            mine = [*reversed(self._attempted), *sorted(self.device.port.strays)]
            # without the COB-ID of its PDO an object cannot be written in the right order
            goal = {
                address: self._old[address]
                for address in mine
                if address in self._old and support([address]) | {address} <= set(known)
            }
            back = steps(goal, known)
            boots = self.device.port.boots
            try:
                self.device.check_quiet(self._axes())
            except DriveProfileError:
                break
            for address, data in back:
                with contextlib.suppress(DriveProfileError):  # what it holds is looked at below
                    self._put(address, data)
            if back:
                held = self._read_all()
            if self.device.port.boots == boots and not steps(goal, {**known, **{p: d for p, d in held.items() if d is not None}}):
                break
            if self.device.port.boots != boots:
                held = self._read_all()
        return held

    def _store_again(self) -> list[ObjectAddress]:
        """Store the former values over the new ones."""
        try:
            self.store()
        except DriveProfileError:
            return [store_command(self.device).address]
        self.stored = "again"
        return []

    def _read_all(self) -> dict[ObjectAddress, bytes | None]:
        held: dict[ObjectAddress, bytes | None] = {}
        for address in self._old:
            try:
                held[address] = self.device.read(address)
            except DriveProfileError:
                held[address] = None
                if address in self._attempted or address in self.device.port.strays:  # else nothing has been written to it
                    self._note("lost", address)
            else:
                self._note("read", address, data=(held[address] or b"").hex())
        for address in self.device.port.strays - set(self._old):
            self._note("lost", address)
        return held

    def end(
        self,
        kind: UploadStatus,
        unknown: tuple[str, ...] = (),
        reason: str = "",
        code: int = 0,
        *,
        others: Literal["new", "old"] = "old",
        unread: int = 0,
    ) -> UploadResult:
        """Make the result, see `UploadResult`, and close the journal."""
        self._going_back = True
        self._note("outcome", outcome=kind, unknown=list(unknown), reason=reason)
        path = None
        if self._journal is not None:
            path = self._journal.path
            with contextlib.suppress(OSError):  # a full disk
                self._journal.close()
            self._journal = None
        others = "new" if kind == "done" else others
        other_count = len({self.named(address) for address in self._old} - {*unknown}) - unread
        return UploadResult(
            self.device.node, kind, len(self.changes), unknown, others, self.stored, reason, path, code, unread, other_count
        )

    def _note(self, event: str, address: ObjectAddress | None = None, **more: object) -> None:
        """Add a line to the journal; a full disk stops no rollback."""
        if self._journal is None:
            return
        try:
            self._journal.note(event, address, **more)
        except (OSError, ValueError) as error:  # ValueError: text that is not Unicode
            if not self._going_back:
                raise RefusedError(f"the journal {self._journal.path} cannot be written ({error})") from error

    def named(self, address: ObjectAddress) -> str:
        """Return address and name of an object."""
        name = self.device.name_of(address)
        return f"{address_text(address)} ({name})" if name else address_text(address)
