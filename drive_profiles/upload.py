"""The upload transaction: identify, quiet, snapshot, write what differs, read everything back, store; or put everything back.

The outcome of each drive is one of

* *done*: every object of the set has been read back and holds, byte for byte, what it shall,
* *rolled back*: every object has been read back and holds what it held before,
* *unknown*: the objects that are listed could not be shown to hold either; all others hold what they held before.

Whether the values were stored is said beside it. A write is never repeated without a look at what the drive holds.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from drive_profiles.cia301 import SdoAbortCode
from drive_profiles.device import Device, Found
from drive_profiles.errors import (
    DriveProfileError,
    InterruptedUploadError,
    NoAnswerError,
    NodeError,
    RefusedError,
    SdoAbortedError,
)
from drive_profiles.journal import Answer, Journal, Snapshot
from drive_profiles.parameter import Place, address_of, place_of
from drive_profiles.parameters import CLASSES, ParameterSet, Write
from drive_profiles.steps import Step, mapped, steps, support

Kind = Literal["done", "rolled back", "unknown"]


_NOT_STORED = frozenset({
    SdoAbortCode.NOT_STORED, SdoAbortCode.LOCAL_CONTROL, SdoAbortCode.DEVICE_STATE, SdoAbortCode.NO_OBJECT,
    SdoAbortCode.NO_SUBINDEX, SdoAbortCode.READ_ONLY, SdoAbortCode.INVALID_VALUE, SdoAbortCode.UNSUPPORTED_ACCESS,
})  # fmt: skip
"""Aborts of the store command after which nothing has been stored; after others, such as a fault of the memory, who knows."""


class ReadBackError(DriveProfileError):
    """Objects do not hold what was written to them."""

    exit_code = 6

    def __init__(self, node: int, mismatches: Sequence[str]) -> None:
        """Keep them."""
        self.node, self.mismatches = node, tuple(mismatches)
        super().__init__(f"node {node}: " + "; ".join(mismatches))


@dataclass(frozen=True)
class Options:
    """How an upload is made.

    Attributes:
        classes: Of the parameters that are written.
        store: Whether the drive shall keep them over a loss of power.
        reset: Whether to reset the drive after storing, and to read everything once more.
        rollback: Whether to put everything back when something fails.
        allow_unverified: Whether to write by facts that nobody has verified.
        force_commissioning: Whether to write one device's offsets to another.
        limits: Whether the limits of profile and EDS hold for raw lines; not where the drive's own values go back.
        journals: Folder of the journals.
    """

    classes: tuple[str, ...] = CLASSES
    store: bool = False
    reset: bool = False
    rollback: bool = True
    allow_unverified: bool = False
    force_commissioning: bool = False
    limits: bool = True
    journals: Path = Path("drive-journals")


@dataclass(frozen=True)
class Outcome:
    """How an upload ended on one drive.

    Attributes:
        node: Its id.
        kind: See the module.
        written: How many objects differed and were written.
        unknown: Objects that may hold anything, by address and name.
        stored: Whether the drive keeps the values over a loss of power.
        reason: Why it was not done.
        journal: Its journal; None where nothing had to be written.
        exit_code: Of a command that ends with it.
    """

    node: int
    kind: Kind
    written: int = 0
    unknown: tuple[str, ...] = ()
    stored: Answer = "no"
    reason: str = ""
    journal: Path | None = None
    exit_code: int = 0

    def __str__(self) -> str:
        """In words."""
        kept = {"yes": ", stored", "no": "", "unknown": ", whether it was stored is not known"}[self.stored]
        match self.kind:
            case "done":
                what = f"{self.written} written and read back" if self.written else "nothing to write, everything is there"
                return f"node {self.node}: done, {what}{kept}"
            case "rolled back":
                return f"node {self.node}: rolled back, everything is as it was{kept}: {self.reason}"
            case _:
                return f"node {self.node}: unknown: {', '.join(self.unknown)}{kept}: {self.reason}"


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
        self.stored: Answer = "no"

    @property
    def changes(self) -> list[tuple[Write, bytes]]:
        """What would be written, each with what the drive holds now."""
        return [(write, self._old[write.place]) for write in self.writes if self._old[write.place] != write.data]

    # -- before anything is written ------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Identify, check that it is quiet, resolve every line, read what the drive holds.

        Raises:
            DriveProfileError: It is another device, it is enabled, or lines that cannot be written; nothing has been sent but
                reads.
        """
        self.device.port.strays.clear()
        self.found = self.device.identify()
        self._check_identity(self.found)
        self.device.check_quiet()
        self._resolve()
        self._goal = {write.place: write.data for write in self.writes}
        self._old = {place: self._before(place) for place in (*self._goal, *sorted(support(self._goal) - set(self._goal)))}
        self._old |= {place: self._before(place) for place in mapped(self._goal, self._old)}
        self._goal |= {place: data for place, data in self._old.items() if place not in self._goal}
        self._steps = steps(self._goal, self._old)
        if strays := self.device.port.strays:
            names = ", ".join(self._named(place) for place in sorted(strays))
            raise NodeError(
                self.device.node, f"a disturbed frame has written {names}, whose old value is not known", "check the bus"
            )

    def _before(self, place: Place) -> bytes:
        """What an object holds before anything is written; of the length that its type has, or it is read once more."""
        entry = self.device.catalogue.get(place)
        kind = None if entry is None else entry.data_type
        held = self.device.read(place)
        if kind is None or kind.size in {None, len(held)}:
            return held
        held = self.device.read(place)
        if len(held) != kind.size:
            what = f"{self._named(place)} has {len(held)} bytes, a {kind.name} has {kind.size}"
            raise NodeError(self.device.node, what, "is this the right profile or EDS?")
        return held

    def _check_identity(self, found: Found) -> None:
        profile, header = self.device.profile, self.parameter_set.header
        reasons: list[str] = []
        if profile is not None:
            identity = profile.identity
            reasons += _differs("vendor (1018h:1)", found.vendor_id, (identity.vendor_id,), f"profile {profile.name}")
            reasons += _differs("product (1018h:2)", found.product_code, identity.product_codes, f"profile {profile.name}")
            if identity.device_type is not None:
                reasons += _differs("device type (1000h)", found.device_type, (identity.device_type,), f"profile {profile.name}")
            if not (identity.is_verified and identity.product_codes) and not self.options.allow_unverified:
                reasons.append(f"the identity in profile {profile.name} is not verified ({identity.source}); --allow-unverified")
        for name, wanted, is_there in (
            ("vendor", header.vendor_id, found.vendor_id),
            ("product", header.product_code, found.product_code),
        ):
            reasons += _differs(name, is_there, () if wanted is None else (wanted,), "the parameter set")
        if header.revision is not None and found.revision != header.revision:
            self.warnings.append(f"the set is of revision {header.revision}, the device of {found.revision}")
        if self.parameter_set.is_edited:
            self.warnings.append("the set has been edited since it was written")
        if reasons:
            raise NodeError(self.device.node, "; ".join(reasons), "is this the right node, profile and file?")

    def _resolve(self) -> None:
        """Lines to bytes; every reason against it at once."""
        lines = self.parameter_set
        self.writes = self.device.resolve(lines, self.options.classes, limits=self.options.limits)
        guesses = [] if self.options.allow_unverified else [write for write in self.writes if not write.entry.is_verified]
        why = "nobody has verified what is known of it; --allow-unverified writes it all the same"
        reasons = [f"{write.entry}: {why}" for write in guesses]
        header, found = lines.header, self.found
        same = found is not None and header.serial_number is not None and header.serial_number == found.serial_number
        theirs = [write for write in self.writes if write.parameter_class == "commissioning"]
        if theirs and not same and not self.options.force_commissioning:
            serials = f"the set is of serial number {header.serial_number}, the device has {found and found.serial_number}"
            names = ", ".join(str(write.entry) for write in theirs[:5])
            reasons.append(
                f"{names}: commissioning values of another device ({serials}); leave the class out, or --force-commissioning"
            )
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
        wrong: list[str] = []
        for place, data in self._goal.items():
            if cancelled():
                raise InterruptedUploadError(f"node {self.device.node}: interrupted")
            held = self.device.read(place)
            if held != data:
                wrong.append(f"{self._named(place)} holds {held.hex(' ')}, not {data.hex(' ')}")
            progress()
        wrong += [f"{self._named(place)} was written instead of another object" for place in sorted(self.device.port.strays)]
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
        address, signature, wait_s = store_command(self.device)
        self.device.check_quiet()
        before = self.stored
        self._note("storing")
        self.stored = "unknown"
        try:
            self.device.write(place_of(address), signature.to_bytes(4, "little"), "the store signature", wait_s)
        except SdoAbortedError as error:
            if error.code in _NOT_STORED:
                self.stored = before
                self._note("not stored")
            raise
        self.stored = "yes"
        self._note("stored")

    def done(self) -> Outcome:
        """The drive holds the set."""
        if self.stored == "unknown":
            address, _, _ = store_command(self.device)
            return self.end(
                "unknown", (f"{address} (the store command)",), "the drive did not answer it", NoAnswerError.exit_code
            )
        return self.end("done")

    def roll_back(self, error: BaseException, *, store_again: bool = False) -> Outcome:
        """Put back what was written, read everything back, and say what is certain.

        Only what this upload has tried to write is put back: an object that it never touched is somebody else's.
        """
        reason = str(error)
        code = error.exit_code if isinstance(error, DriveProfileError) else 1
        self._going_back = True
        if not self.options.rollback and self._attempted:
            return self.end("unknown", tuple(self._named(place) for place in self._attempted), reason, code)
        self._note("rolling back", reason=reason)
        held = self._read_all()
        known = {place: data for place, data in held.items() if data is not None}
        mine = set(self._attempted) | self.device.port.strays
        # without the COB-ID of its PDO an object cannot be written in the right order
        goal = {place: data for place, data in self._old.items() if place in mine and support([place]) | {place} <= set(known)}
        back = steps(goal, known)
        for place, data in back:
            try:
                self._put(place, data)
            except DriveProfileError:
                continue  # what it holds is looked at below
        if back:
            held = self._read_all()
        lost = [place for place, data in held.items() if data != self._old[place]]
        lost += sorted(self.device.port.strays - set(self._old))
        if store_again and not lost:
            lost += self._store_again()
        elif self.stored == "unknown":
            lost.append(place_of(store_command(self.device)[0]))
        if lost:
            return self.end("unknown", tuple(self._named(place) for place in lost), reason, code)
        return self.end("rolled back", reason=reason, code=code)

    def _store_again(self) -> list[Place]:
        """It has stored, or perhaps, and then something failed: its old values are stored over the new ones."""
        address, _, _ = store_command(self.device)
        try:
            self.store()
        except DriveProfileError:
            return [place_of(address)]
        self.stored = "no"
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

    def end(self, kind: Kind, unknown: tuple[str, ...] = (), reason: str = "", code: int = 0) -> Outcome:
        """The outcome, and the end of the journal."""
        self._going_back = True
        self._note("outcome", outcome=kind, unknown=list(unknown), reason=reason)
        path = None
        if self._journal is not None:
            path = self._journal.path
            with contextlib.suppress(OSError):  # a full disk
                self._journal.close()
            self._journal = None
        return Outcome(self.device.node, kind, len(self.changes), unknown, self.stored, reason, path, code)

    def _note(self, event: str, place: Place | None = None, **more: object) -> None:
        """A line of the journal. On the way there no write goes without one; the way back does not stop for a full disk."""
        if self._journal is None:
            return
        try:
            self._journal.note(event, place, **more)
        except OSError as error:
            if not self._going_back:
                raise RefusedError(f"the journal {self._journal.path} cannot be written ({error.strerror})") from error

    def _named(self, place: Place) -> str:
        name = self.device.name_of(place)
        return f"{address_of(place)} ({name})" if name else address_of(place)


def _differs(what: str, found: int | None, wanted: Collection[int], who: str) -> list[str]:
    if not wanted or found in wanted:
        return []
    shown = " or ".join(f"0x{value:X}" for value in wanted)
    return [f"its {what} is {'not given' if found is None else f'0x{found:X}'}, {who} says {shown}"]


def store_command(device: Device) -> tuple[str, int, float]:
    """Object, signature and waiting time of the device's store command.

    Raises:
        RefusedError: It has none.
    """
    facts = device.profile.store if device.profile else None
    if facts is None:
        return "1010:1", 0x6576_6173, 5.0  # CiA 301, 7.5.2.13
    if facts.object is None:
        raise RefusedError(
            f"node {device.node}: a {device.profile.name if device.profile else 'drive'} has no store command: {facts.note}"
        )
    return facts.object, facts.signature, facts.wait_s
