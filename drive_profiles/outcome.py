"""How an upload is made, and how it ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from drive_profiles.errors import DriveProfileError
from drive_profiles.parameters import CLASSES

Kind = Literal["done", "rolled back", "unknown"]
Stored = Literal["no", "yes", "unknown", "again"]
"""``again``: the new values had been stored, and then the old ones, with whatever else the drive held unsaved."""

_SHOWN = 8
"""Unknown objects that are named in words; the journal and ``--json`` have all."""


class ReadBackError(DriveProfileError):
    """Objects do not hold what was written to them."""

    exit_code = 6

    def __init__(self, node: int, mismatches: Sequence[tuple[str, str]]) -> None:
        """Keep them: each object by address and name, and what is wrong with it."""
        self.node, self.mismatches = node, tuple(mismatches)
        super().__init__(f"node {node}: " + "; ".join(f"{name} {what}" for name, what in mismatches))

    @property
    def objects(self) -> tuple[str, ...]:
        """The objects, by address and name."""
        return tuple(name for name, _ in self.mismatches)


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
        others: What all other objects of the set hold: what they shall, or what they held before.
        stored: Whether the drive keeps the values over a loss of power.
        reason: Why it was not done.
        journal: Its journal; None where nothing had to be written.
        exit_code: Of a command that ends with it.
    """

    node: int
    kind: Kind
    written: int = 0
    unknown: tuple[str, ...] = ()
    others: Literal["new", "old"] = "new"
    stored: Stored = "no"
    reason: str = ""
    journal: Path | None = None
    exit_code: int = 0

    def __str__(self) -> str:
        """In words."""
        kept = {
            "yes": ", stored",
            "no": "",
            "unknown": ", whether it was stored is not known",
            "again": ", and these values, with whatever else the drive held unsaved, are stored again",
        }[self.stored]
        match self.kind:
            case "done":
                what = f"{self.written} written and read back" if self.written else "nothing to write, everything is there"
                return f"node {self.node}: done, {what}{kept}"
            case "rolled back":
                return f"node {self.node}: rolled back, everything is as it was{kept}: {self.reason}"
            case _:
                others = {"new": "all others hold the new values", "old": "all others are as they were"}[self.others]
                more = len(self.unknown) - _SHOWN
                named = ", ".join(self.unknown[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
                return f"node {self.node}: unknown: {named}; {others}{kept}: {self.reason}"
