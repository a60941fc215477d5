"""Interface of a recording: names of columns, and numbers on request."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from hil.control.arrays import Real
from hil.errors import RecordingFileError

MOST_ROWS = 20_000_000
LEAST_SAMPLED = 50
MOST_MISSING = 0.05
"""Fraction of the rows in which a number may be missing; such rows are left out."""


class Source(Protocol):
    """A file of columns."""

    path: Path
    names: tuple[str, ...]

    def columns(self, names: Sequence[str]) -> dict[str, Real]:
        """Read columns of numbers by name; NaN for missing ones.

        All of shape (n,).

        Raises:
            RecordingFileError: A column has values that are not numbers.
        """
        ...


def complete_rows(path: Path, columns: dict[str, Real]) -> tuple[dict[str, Real], int]:
    """Return the rows without missing numbers, and count the others.

    Raises:
        RecordingFileError: There are too few rows, or too many without a number.
    """
    is_there = np.all([np.isfinite(values) for values in columns.values()], axis=0)
    rows, missing = len(is_there), int(np.count_nonzero(~is_there))
    if missing > MOST_MISSING * rows:
        worst = max(columns, key=lambda name: int(np.count_nonzero(~np.isfinite(columns[name]))))
        count = int(np.count_nonzero(~np.isfinite(columns[worst])))
        raise RecordingFileError(
            path,
            f"a number is missing in {missing} of {rows} rows, most of them in {worst!r} ({count}); expected at most "
            f"{100 * MOST_MISSING:g} %",
        )
    if rows - missing < LEAST_SAMPLED:
        raise RecordingFileError(path, f"{rows - missing} rows are too few; at least {LEAST_SAMPLED} are needed")
    return {name: values[is_there] for name, values in columns.items()}, missing


def at_stamps(path: Path, name: str, stamps: Real, own: Real, values: Real) -> Real:
    """Interpolate numbers at other stamps, linearly.

    NaN beyond their ends; of the shape of `stamps`. Wanted stamps have the shape (n,), their own and the numbers (m,); path and
    name are for errors.

    Raises:
        RecordingFileError: Their stamps go back, so that there are two numbers for one instant.
    """
    if len(own) == len(stamps) and bool(np.all(own == stamps)):
        return values
    step = np.diff(own)
    if len(step) and float(np.min(step)) < 0.0:
        row = int(np.argmin(step))
        raise RecordingFileError(
            path,
            f"the stamps of {name!r} go back by {-step[row]:.3g} s from its number {row + 1} to {row + 2}: are these two "
            "recordings in one file?",
        )
    return np.asarray(np.interp(stamps, own, values, np.nan, np.nan))
