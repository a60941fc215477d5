"""The journal of an upload on disk, and its snapshot as a parameter set.

One JSON object per line. The first, written by way of a temporary file and fsync before anything is sent, holds for every object
its bytes before and its bytes wanted. Each write is announced before it is sent and confirmed after it is answered; those
lines survive the death of the tool. After a loss of power they may be missing: then every object of the snapshot is uncertain.
"""

import calendar
import contextlib
import json
import os
import re
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self

from drive_profiles.errors import FileError, Problem, RefusedError
from drive_profiles.family.catalogue import Catalogue, CatalogueEntry
from drive_profiles.files.reading import read_file
from drive_profiles.files.safefile import write_atomically
from drive_profiles.parameter_set.commands import is_command
from drive_profiles.parameter_set.parameters import Header, Item, ParameterSet, item_of
from drive_profiles.standard.cia301 import type_of_length
from drive_profiles.standard.object_address import ObjectAddress, address_text, object_address

MAX_SNAPSHOT_BYTES = 8 << 20
"""Longest first line: of a set's bytes, which its file holds in 4 MiB at most, it has the old ones and the new ones."""
MAX_BYTES = 8 * MAX_SNAPSHOT_BYTES
"""Longest journal that is read. The notes of an object, written and restored, are up to four times its part of the first line."""
Answer = Literal["yes", "no", "unknown"]


@dataclass(frozen=True)
class UploadSnapshot:
    """Bytes of a drive before an upload, and wanted bytes, by address.

    `identity` has 1018h and 1000h as the drive gave them.
    """

    node: int
    bus: str
    identity: dict[str, int | None]
    profile: str
    old: dict[ObjectAddress, bytes]
    new: dict[ObjectAddress, bytes]
    names: dict[ObjectAddress, str] = field(default_factory=dict)


@dataclass
class JournalStatement:
    """The conclusions that a journal allows about a drive.

    Attributes:
        possible: Bytes that each object may hold now, by address; a single value where that is certain.
        stored: ``yes``, ``no`` or ``unknown``: the drive has stored the values.
        outcome: End of the upload as it noted it; empty if it was killed before.
    """

    snapshot: UploadSnapshot
    possible: dict[ObjectAddress, frozenset[bytes]]
    stored: Answer = "no"
    outcome: str = ""
    stored_before: Answer = "no"

    @property
    def uncertain(self) -> list[ObjectAddress]:
        """Addresses of the objects whose bytes are not certain."""
        return [address for address, values in self.possible.items() if len(values) != 1]

    def __str__(self) -> str:
        """Return the conclusions in words."""
        changed = [address for address, values in self.possible.items() if values == {self.snapshot.new.get(address)}]
        end = f"ended: {self.outcome}" if self.outcome else "was not ended"
        doubt = ", ".join(address_text(address) for address in self.uncertain) or "none"
        stored = {"yes": "stored", "no": "not stored", "unknown": "perhaps stored"}[self.stored]
        return (
            f"upload to node {self.snapshot.node} {end}; {len(changed)} of {len(self.possible)} objects hold the requested "
            f"values, uncertain: {doubt}; {stored}"
        )


_SECOND_NS = 1_000_000_000


def journal_path(folder: Path, node: int, now_ns: int) -> Path:
    """Return the path of a new journal, stamped after all others.

    The stamp orders the journals even if the clock was set back; `restore` takes the newest. `now_ns` is the time since 1970
    (UTC), read once: second and fraction belong together.
    """
    newest = max(filter(None, (_stamp_ns(path) for path in folder.glob("*.jsonl"))), default=0)
    second, fraction = divmod(max(now_ns, newest + 1), _SECOND_NS)
    return folder / f"node{node}-{time.strftime(_STAMP, time.gmtime(second))}-{fraction:09d}.jsonl"


_STAMP = "%Y%m%dT%H%M%S"


def _stamp_ns(path: Path) -> int | None:
    stamp = re.fullmatch(r"node\d+-(\d{8}T\d{6})-(\d{9})", path.stem, re.ASCII)
    if stamp is None:
        return None
    with contextlib.suppress(ValueError):  # digits that are not a date
        return calendar.timegm(time.strptime(stamp[1], _STAMP)) * _SECOND_NS + int(stamp[2])
    return None


class Journal:
    """The open journal of one upload."""

    def __init__(self, path: Path, snapshot: UploadSnapshot) -> None:
        """Write the snapshot to disk.

        Raises:
            FileError: The journal cannot be written, or could not be read again; then nothing may be sent.
        """
        self.path = path
        head = {
            "format": 1,
            "node": snapshot.node,
            "bus": snapshot.bus,
            "identity": snapshot.identity,
            "profile": snapshot.profile,
            "objects": [
                {
                    "object": address_text(address),
                    "name": snapshot.names.get(address, ""),
                    "old": old.hex(),
                    "new": snapshot.new.get(address, old).hex(),
                }
                for address, old in snapshot.old.items()
            ],
        }
        line = _line(head)
        if len(line) > MAX_SNAPSHOT_BYTES:
            wanted = f"at most {MAX_SNAPSHOT_BYTES >> 20} MiB; split the upload by --classes"
            raise FileError(path, (Problem(0, "", f"its first line would have {len(line)} bytes", wanted),))
        write_atomically(path, line)
        self._file = path.open("ab", buffering=0)

    def note(self, event: str, address: ObjectAddress | None = None, **more: Any) -> None:
        """Add a line, at once and whole."""
        where = {} if address is None else {"object": address_text(address)}
        line = _line({"event": event, **where, **more})
        while line:
            line = line[self._file.write(line) :]

    def close(self) -> None:
        """Close the journal, which is then on disk."""
        if not self._file.closed:
            os.fsync(self._file.fileno())
            self._file.close()

    def __enter__(self) -> Self:
        """Return the journal."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the journal."""
        self.close()


def read(path: str | Path) -> JournalStatement:
    """Read a journal, even of a killed upload, without its unfinished line.

    Raises:
        FileError: The file is not a journal.
    """
    path = Path(path)
    data = read_file(path, "a journal of an upload", max_bytes=MAX_BYTES)
    lines = data.split(b"\n")[:-1]  # what is behind the last line end was not written whole
    number = 1
    try:
        snapshot = _snapshot(json.loads(lines[0]))
        statement = JournalStatement(snapshot, {address: frozenset({old}) for address, old in snapshot.old.items()})
        for number, line in enumerate(lines[1:], 2):  # noqa: B007 - the error below says where it stopped
            _apply(statement, json.loads(line))
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        raise FileError(path, (Problem(number, "", f"is not a line of a journal ({error})", "a journal of an upload"),)) from None
    return statement


def _apply(statement: JournalStatement, line: dict[str, Any]) -> None:
    event = line["event"]
    if event == "write":
        address = object_address(line["object"])
        before = statement.possible.get(address, frozenset())
        written = bytes.fromhex(line["data"])
        statement.possible[address] = (
            before | {written} if before else before
        )  # of what may hold anything, nothing is certain yet
    elif event in {"written", "read"}:
        statement.possible[object_address(line["object"])] = frozenset({bytes.fromhex(line["data"])})
    elif event == "lost":
        statement.possible[object_address(line["object"])] = frozenset()
    elif event == "storing":
        statement.stored_before, statement.stored = statement.stored, "unknown"
    elif event == "stored":
        statement.stored = "yes"
    elif event == "not stored":
        statement.stored = statement.stored_before  # refused: what was stored before, still is
    elif event == "outcome":
        statement.outcome = str(line["outcome"])
        if statement.outcome == "done":  # everything has been read back
            statement.possible |= {address: frozenset({new}) for address, new in statement.snapshot.new.items()}


def _snapshot(head: dict[str, Any]) -> UploadSnapshot:
    if head["format"] != 1:
        raise ValueError(f"format {head['format']!r}")
    old: dict[ObjectAddress, bytes] = {}
    new: dict[ObjectAddress, bytes] = {}
    names: dict[ObjectAddress, str] = {}
    for item in head["objects"]:
        address = object_address(item["object"])
        old[address], new[address], names[address] = bytes.fromhex(item["old"]), bytes.fromhex(item["new"]), _text(item["name"])
    identity = dict(head["identity"])
    if any(type(value) is not int for value in identity.values() if value is not None):
        raise ValueError(f"identity {identity!r}")
    return UploadSnapshot(int(head["node"]), _text(head["bus"]), identity, _text(head["profile"]), old, new, names)


def _text(value: object) -> str:
    text = str(value)
    text.encode()  # JSON can write half a character, which no file and no terminal takes: a ValueError
    return text


def _line(content: dict[str, Any]) -> bytes:
    return json.dumps(content, ensure_ascii=False, separators=(",", ":")).encode() + b"\n"


def as_set(snapshot: UploadSnapshot, catalogue: Catalogue) -> ParameterSet:
    """Make a parameter set of the values that the drive held.

    Raises:
        RefusedError: The snapshot has nothing that could be written back, or bytes that are not a value of their object's type.
    """
    table: dict[str, Item] = {}
    reasons: list[str] = []
    for address, data in snapshot.old.items():
        entry = catalogue.get(address)
        if is_command(address, catalogue.profile) or (
            entry is not None and not entry.is_writable
        ):  # read for its PDO's sake, never written
            continue
        data_type = (entry.data_type if entry else None) or type_of_length(len(data))
        try:
            key, table_item = item_of(CatalogueEntry(address, snapshot.names.get(address, ""), data_type), data, None)
        except ValueError as error:
            reasons.append(f"{address_text(address)}: the drive's previous value cannot be restored: {error}")
            continue
        table[key] = table_item
    if reasons:
        raise RefusedError(*reasons)
    if not table:
        raise RefusedError("the snapshot holds nothing that can be restored")
    identity = snapshot.identity
    header = Header(
        profile=snapshot.profile,
        vendor_id=identity.get("vendor_id"),
        product_code=identity.get("product_code"),
        revision=identity.get("revision"),
        serial_number=identity.get("serial_number"),
    )
    # one class for all: a snapshot goes back to the very device that it is of, which the serial number in the header decides
    return ParameterSet(header=header, commissioning=table)
