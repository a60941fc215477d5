"""Options of an upload, and its result."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from drive_profiles.errors import DriveProfileError
from drive_profiles.parameter_set.parameters import CLASSES

UploadStatus = Literal["done", "rolled back", "unknown"]
Stored = Literal["no", "yes", "unknown", "again"]
"""``again``: the new values had been stored, and then the old ones, with whatever else the drive held unsaved."""

_SHOWN = 8
"""Most unknown objects that a message names; the journal and ``--json`` have all."""


class UploadReadBackError(DriveProfileError):
    """Objects that do not hold the bytes that were written to them."""

    exit_code = 6

    def __init__(self, node: int, mismatches: Sequence[tuple[str, str]]) -> None:
        """Compose the message."""
        self.node, self.mismatches = node, tuple(mismatches)
        super().__init__(f"node {node}: " + "; ".join(f"{name} {what}" for name, what in mismatches))

    @property
    def objects(self) -> tuple[str, ...]:
        """Addresses and names of the objects."""
        return tuple(name for name, _ in self.mismatches)


@dataclass(frozen=True)
class UploadOptions:
    """Options of an upload.

    Attributes:
        store: Let the drive store the values over a loss of power.
        reset: Reset the drive after storing, and read everything once more.
        rollback: Put everything back when something fails.
        force_commissioning: Write one device's offsets to another.
        other_device: Write a set that was pulled from another device; its commissioning values need `force_commissioning`.
        limits: Hold raw lines to the limits of profile and EDS; not where the drive's own values go back.
    """

    classes: tuple[str, ...] = CLASSES
    store: bool = False
    reset: bool = False
    rollback: bool = True
    allow_unverified: bool = False
    force_commissioning: bool = False
    other_device: bool = False
    limits: bool = True
    journals: Path = Path("drive-journals")


@dataclass(frozen=True)
class UploadResult:
    """Result of an upload on one drive.

    Attributes:
        kind: *done*, *rolled back* or *unknown*, as `upload.upload` defines them.
        written: Number of objects that differed and were written.
        unknown: Objects that may hold anything, by address and name.
        unread: Number of objects of the set that this upload has not written, and that could not be read at its end.
        others: ``new``: all other objects of the set hold the new values; ``old``: they hold their former values.
        stored: ``yes``, ``no``, ``unknown`` or ``again``: the drive has stored the values.
        journal: Path of the journal; None if nothing had to be written.
        other_count: Number of all other objects; None if it was not counted.
    """

    node: int
    kind: UploadStatus
    written: int = 0
    unknown: tuple[str, ...] = ()
    others: Literal["new", "old"] = "new"
    stored: Stored = "no"
    reason: str = ""
    journal: Path | None = None
    exit_code: int = 0
    unread: int = 0
    other_count: int | None = None
    is_reset: bool = False

    def __str__(self) -> str:
        """Return the result in words."""
        stored = {
            "yes": ", stored",
            "no": "",
            "unknown": ", whether it was stored is not known",
            "again": ", and these values are stored again, with all other unsaved values of the drive",
        }[self.stored]
        match self.kind:
            case "done":
                what = f"{self.written} written and read back" if self.written else "nothing to write: the drive has all values"
                reset = ", reset, and read back once more" if self.is_reset else ""
                return f"node {self.node}: done, {what}{stored}{reset}"
            case "rolled back":
                return f"node {self.node}: rolled back, every object holds its old value{stored}: {self.reason}"
            case _:
                more = len(self.unknown) - _SHOWN
                named = ", ".join(self.unknown[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
                return f"node {self.node}: unknown: {named}{self._of_others()}{stored}: {self.reason}"

    def _of_others(self) -> str:
        """Return what is certain of the unnamed objects, or ""."""
        said = f"; {self.unread} more were not written, and could not be read" if self.unread else ""
        if self.other_count != 0:
            said += "; all others hold the new values" if self.others == "new" else "; all others hold the old values"
        return said
