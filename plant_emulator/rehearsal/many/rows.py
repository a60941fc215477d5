"""Rows of the table, one per robot, each in its file."""

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from drive_profiles.errors import FileError, Problem, RefusedError
from drive_profiles.files.reading import read_file
from drive_profiles.files.safefile import write_atomically, write_json
from plant_emulator.trials.executors import CRASHED_WORDS
from plant_emulator.trials.rows import TABLES, Row, Value

WALKED, BROKEN, CRASHED = "walked", "error", "crashed"
"""Ends of a robot's path: at its end, by an internal error, with its process."""


MAX_ROW_BYTES = 1_000_000
EXPECTED = "a file of plant-emulator rehearse"
SETTINGS_FILE = "rehearsal.json"
CLAIMS_FILE, PAGE_FILE = "claims.json", "report.html"
WRITTEN = (*TABLES, CLAIMS_FILE, PAGE_FILE)
"""Files of all robots together: table, claims and report."""


@dataclass(frozen=True)
class RehearsalSettings:
    """Settings shared by all robots of a rehearsal.

    Attributes:
        kind: `linear`, `real` or `any`: the robots that are drawn.
        over_bus: True if the path runs over a bus, False if in one process without frames.
    """

    kind: str
    over_bus: bool


def crashed(seed: int) -> Row:
    """Return the row of a robot whose process died each time."""
    return {"seed": seed, "walk": CRASHED, "walk_words": CRASHED_WORDS}


class Kept:
    """The rows in a folder.

    Args:
        folder: Folder of the rehearsal; created if missing.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def begin(self, settings: RehearsalSettings, *, resume: bool) -> None:
        """Begin a rehearsal in a folder, or resume one.

        Raises:
            RefusedError: There are rows already and `resume` is not given, or they were made with other settings. Or the folder
                has a file of another command that would be replaced.
            FileError: The folder cannot be read or written.
        """
        path = self.folder / SETTINGS_FILE
        has_rows = any(self._paths())
        if not path.exists() or not has_rows:
            if has_rows:
                raise RefusedError(f"{self.folder} has robots but no {SETTINGS_FILE}; choose another folder")
            foreign = [name for name in WRITTEN if (self.folder / name).exists()]
            if foreign and not path.exists():
                raise RefusedError(f"{self.folder} has a {foreign[0]} of another command; choose another folder")
            write_json(path, asdict(settings), force=True)
            return
        before = self.settings()
        if not resume:
            raise RefusedError(f"{self.folder} already holds a rehearsal; give --resume to continue it, or choose another folder")
        if before != settings:
            differs = ", ".join(
                f"{each.name} was {getattr(before, each.name)}, now {getattr(settings, each.name)}"
                for each in fields(RehearsalSettings)
                if getattr(before, each.name) != getattr(settings, each.name)
            )
            raise RefusedError(f"{self.folder} has a rehearsal with other settings ({differs}); choose another folder")

    def settings(self) -> RehearsalSettings:
        """Return the settings of the rehearsal in the folder.

        Raises:
            FileError: The folder holds none, or one that cannot be read.
        """
        document = _document(self.folder / SETTINGS_FILE)
        if set(document) != {"kind", "over_bus"}:
            raise _bad(self.folder / SETTINGS_FILE, f"has the keys {sorted(document)}", "kind and over_bus")
        kind, over_bus = document["kind"], document["over_bus"]
        if not isinstance(kind, str) or not isinstance(over_bus, bool):
            raise _bad(self.folder / SETTINGS_FILE, f"says {document}", "a text for kind, and true or false for over_bus")
        return RehearsalSettings(kind, over_bus)

    def keep(self, row: Row) -> None:
        """Write one robot's row atomically.

        Raises:
            FileError: It cannot be written.
        """
        text = json.dumps(row, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        write_atomically(self._path(_seed(row)), text.encode(), force=True)

    def seeds(self) -> set[int]:
        """Return the seeds whose rows are saved."""
        return {int(path.stem.removeprefix("seed-")) for path in self._paths()}

    def rows(self) -> list[Row]:
        """Return all rows in the order of their seeds.

        Raises:
            FileError: A row is not there or cannot be read.
        """
        found: list[Row] = []
        for seed in sorted(self.seeds()):
            path = self._path(seed)
            row = _document(path)
            if row.get("seed") != seed:
                raise _bad(path, f"is the row of seed {row.get('seed')}", f"that of seed {seed}")
            found.append(row)
        return found

    def _path(self, seed: int) -> Path:
        return self.folder / "robots" / f"seed-{seed}.json"

    def _paths(self) -> Iterator[Path]:
        yield from (path for path in (self.folder / "robots").glob("seed-*.json") if path.stem[5:].isdecimal())


def _seed(row: Row) -> int:
    seed = row["seed"]
    if not isinstance(seed, int):
        raise TypeError(f"seed {seed!r} is not a number")
    return seed


def _document(path: Path) -> dict[str, Value]:
    """Return a flat JSON document of plain values."""
    data = read_file(path, EXPECTED, max_bytes=MAX_ROW_BYTES)
    try:
        document = json.loads(data)
    except ValueError as error:
        raise _bad(path, f"is not JSON ({error})", EXPECTED) from None
    if not isinstance(document, dict) or not all(_is_plain(value) for value in document.values()):
        raise _bad(path, "is not a flat JSON object", EXPECTED)
    return document


def _is_plain(value: object) -> bool:
    return value is None or isinstance(value, str | bool | int) or (isinstance(value, float) and math.isfinite(value))


def _bad(path: Path, found: str, wanted: str) -> FileError:
    return FileError(path, (Problem(0, "", found, wanted),))
