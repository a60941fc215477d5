"""Recordings as text: CSV with commas, semicolons or tabulators, compressed or not."""

import csv
import gzip
import io
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

import numpy as np

from hil.control.arrays import Real
from hil.errors import RecordingFileError
from hil.recordings.source import MOST_ROWS

DELIMITERS = ",;\t"
MAX_HEADER = 1 << 20
MISSING = frozenset({"", "nan", "na", "null", "none"})


class DelimitedFile:
    """A text file of columns with one line of names."""

    def __init__(self, path: Path) -> None:
        """Read the line of names.

        Raises:
            RecordingFileError: The file cannot be read, or has no such line.
        """
        self.path = path
        try:
            with self._open() as file:
                line = file.readline(MAX_HEADER).rstrip("\r\n")
        except (OSError, EOFError, UnicodeDecodeError, zlib.error) as error:
            raise RecordingFileError(path, f"cannot be read: {error}") from error
        self._delimiter = max(DELIMITERS, key=line.count)
        self.names = tuple(name.strip() for name in next(csv.reader([line], delimiter=self._delimiter), []))
        if len(self.names) < 2:
            raise RecordingFileError(
                path, f"its first line holds {len(self.names)} names; expected commas, semicolons or tabulators between them"
            )
        if all(_is_number(name) for name in self.names):
            raise RecordingFileError(path, "its first line has numbers; expected the names of the columns")
        twice = sorted({name for name in self.names if name and self.names.count(name) > 1})
        if twice:
            raise RecordingFileError(path, f"{twice[0]!r} names two columns")

    def columns(self, names: Sequence[str]) -> dict[str, Real]:
        """Read columns of numbers by name; NaN for empty cells.

        All of shape (n,).

        Raises:
            RecordingFileError: A cell holds no number, or a row has too few.
        """
        indices = [self.names.index(name) for name in names]
        values: list[list[float]] = [[] for _ in names]
        try:
            with self._open() as file:
                reader = csv.reader(file, delimiter=self._delimiter)
                next(reader)
                for count, row in enumerate(reader):
                    if not row:
                        continue
                    if count >= MOST_ROWS:
                        raise RecordingFileError(self.path, f"more than {MOST_ROWS} rows")
                    if len(row) <= max(indices):
                        raise RecordingFileError(
                            self.path,
                            f"line {reader.line_num} has {len(row)} cells; expected {len(self.names)} as in line 1",
                        )
                    for name, place, column in zip(names, indices, values, strict=True):
                        column.append(self._number(row[place], name, reader.line_num))
        except (OSError, EOFError, UnicodeDecodeError, zlib.error, csv.Error) as error:
            raise RecordingFileError(self.path, f"cannot be read: {error}") from error
        return {name: np.asarray(column, dtype=np.float64) for name, column in zip(names, values, strict=True)}

    def _number(self, cell: str, name: str, line: int) -> float:
        try:
            return float(cell)
        except ValueError:
            pass
        text = cell.strip()
        if text.lower() in MISSING:
            return float("nan")
        if self._delimiter == ";" and text.count(",") == 1 and _is_number(text.replace(",", ".")):
            return float(text.replace(",", "."))
        raise RecordingFileError(self.path, f"line {line}: {text[:40]!r} in the column {name!r} is not a number")

    def _open(self) -> TextIO:
        if self.path.name.lower().endswith(".gz"):
            return io.TextIOWrapper(gzip.open(self.path, "rb"), encoding="utf-8-sig", newline="")
        return self.path.open(encoding="utf-8-sig", newline="")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
