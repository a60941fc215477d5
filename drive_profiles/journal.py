"""What an upload found and did, on disk before and while it did it: to go back to, and to know what is certain of a killed one.

One JSON object per line. The first, written by way of a temporary file and fsync before anything is sent, holds for every object
what the drive held and what it shall hold. Each write is announced before it is sent and confirmed after it is answered; those
lines survive the death of the tool. After a loss of power they may be missing: then every object of the snapshot is uncertain.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self

from drive_profiles.errors import FileError, Problem
from drive_profiles.parameter import Place, address_of, place_of
from drive_profiles.safefile import write_atomically

MAX_BYTES = 16 << 20
Answer = Literal["yes", "no", "unknown"]


@dataclass(frozen=True)
class Snapshot:
    """What the drive held before, and what it was to hold.

    Attributes:
        node: Its id.
        bus: Where it was.
        identity: 1018h and 1000h as the drive gave them.
        profile: Name of the profile.
        old: Bytes before, by object.
        new: Bytes that were wanted.
        names: Of the objects.
    """

    node: int
    bus: str
    identity: dict[str, int | None]
    profile: str
    old: dict[Place, bytes]
    new: dict[Place, bytes]
    names: dict[Place, str] = field(default_factory=dict)


@dataclass
class Statement:
    """What a journal says for certain.

    Attributes:
        snapshot: Its first line.
        possible: By object: the bytes that it may hold now; one where that is certain.
        stored: Whether the values were stored.
        outcome: The upload's own last word; empty where it did not come to one.
        stored_before: What `stored` was before the last attempt.
    """

    snapshot: Snapshot
    possible: dict[Place, frozenset[bytes]]
    stored: Answer = "no"
    outcome: str = ""
    stored_before: Answer = "no"

    @property
    def uncertain(self) -> list[Place]:
        """Objects of which it is not certain what they hold."""
        return [place for place, values in self.possible.items() if len(values) != 1]

    def __str__(self) -> str:
        """In words."""
        changed = [place for place, values in self.possible.items() if values == {self.snapshot.new.get(place)}]
        end = f"ended: {self.outcome}" if self.outcome else "was not ended"
        doubt = ", ".join(address_of(place) for place in self.uncertain) or "none"
        stored = {"yes": "stored", "no": "not stored", "unknown": "perhaps stored"}[self.stored]
        return (
            f"upload to node {self.snapshot.node} {end}; {len(changed)} of {len(self.possible)} objects hold what was wanted, "
            f"uncertain: {doubt}; {stored}"
        )


class Journal:
    """The open journal of one upload."""

    def __init__(self, path: Path, snapshot: Snapshot) -> None:
        """Write the snapshot; from here on it can be gone back to.

        Raises:
            FileError: It cannot be written; nothing may be sent then.
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
                    "object": address_of(place),
                    "name": snapshot.names.get(place, ""),
                    "old": old.hex(),
                    "new": snapshot.new.get(place, old).hex(),
                }
                for place, old in snapshot.old.items()
            ],
        }
        write_atomically(path, _line(head))
        self._file = os.open(path, os.O_WRONLY | os.O_APPEND)

    def note(self, event: str, place: Place | None = None, **more: Any) -> None:
        """Add a line, at once and whole."""
        where = {} if place is None else {"object": address_of(place)}
        line = _line({"event": event, **where, **more})
        while line:
            line = line[os.write(self._file, line) :]

    def close(self) -> None:
        """End it; on disk before this returns. Again is allowed."""
        if self._file >= 0:
            os.fsync(self._file)
            os.close(self._file)
            self._file = -1

    def __enter__(self) -> Self:
        """Give the journal."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.close()


def read(path: str | Path) -> Statement:
    """What a journal states, also of an upload that was killed; half a last line counts as none.

    Raises:
        FileError: It is no journal.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise FileError(path, (Problem(0, "", f"cannot be read ({error.strerror})", "a journal of an upload"),)) from error
    if len(data) > MAX_BYTES:
        raise FileError(path, (Problem(0, "", "is larger than 16 MiB", "a journal of an upload"),))
    lines = data.split(b"\n")[:-1]  # what is behind the last line end was not written whole
    number = 1
    try:
        snapshot = _snapshot(json.loads(lines[0]))
        statement = Statement(snapshot, {place: frozenset({old}) for place, old in snapshot.old.items()})
        for number, line in enumerate(lines[1:], 2):  # noqa: B007 - the error below says where it stopped
            _apply(statement, json.loads(line))
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        raise FileError(path, (Problem(number, "", f"is no line of a journal ({error})", "a journal of an upload"),)) from None
    return statement


def _apply(statement: Statement, line: dict[str, Any]) -> None:
    event = line["event"]
    if event == "write":
        place = place_of(line["object"])
        before = statement.possible.get(place, frozenset())
        written = bytes.fromhex(line["data"])
        statement.possible[place] = before | {written} if before else before  # of what may hold anything, nothing is certain yet
    elif event in {"written", "read"}:
        statement.possible[place_of(line["object"])] = frozenset({bytes.fromhex(line["data"])})
    elif event == "lost":
        statement.possible[place_of(line["object"])] = frozenset()
    elif event == "storing":
        statement.stored_before, statement.stored = statement.stored, "unknown"
    elif event == "stored":
        statement.stored = "yes"
    elif event == "not stored":
        statement.stored = statement.stored_before  # refused: what was stored before, still is
    elif event == "outcome":
        statement.outcome = str(line["outcome"])
        if statement.outcome == "done":  # everything has been read back
            statement.possible |= {place: frozenset({new}) for place, new in statement.snapshot.new.items()}


def _snapshot(head: dict[str, Any]) -> Snapshot:
    if head["format"] != 1:
        raise ValueError(f"format {head['format']!r}")
    old: dict[Place, bytes] = {}
    new: dict[Place, bytes] = {}
    names: dict[Place, str] = {}
    for item in head["objects"]:
        place = place_of(item["object"])
        old[place], new[place], names[place] = bytes.fromhex(item["old"]), bytes.fromhex(item["new"]), _text(item["name"])
    identity = dict(head["identity"])
    if any(type(value) is not int for value in identity.values() if value is not None):
        raise ValueError(f"identity {identity!r}")
    return Snapshot(int(head["node"]), _text(head["bus"]), identity, _text(head["profile"]), old, new, names)


def _text(value: object) -> str:
    text = str(value)
    text.encode()  # JSON can write half a character, which no file and no terminal takes: a ValueError
    return text


def _line(content: dict[str, Any]) -> bytes:
    return json.dumps(content, ensure_ascii=False, separators=(",", ":")).encode() + b"\n"
