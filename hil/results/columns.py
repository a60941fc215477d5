"""Columns of numbers beside a result: curves of a page, as CSV."""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]


def save_columns(path: Path, columns: Mapping[str, Real]) -> None:
    """Write columns of the same length with one line of names."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="", fmt="%.7g")


def load_columns(path: Path) -> dict[str, Real]:
    """Read columns that `save_columns` has written.

    Raises:
        OSError: The file cannot be read.
        ValueError: It holds something else; the message has its name.
    """
    with path.open(newline="", encoding="utf-8") as file:
        names = next(csv.reader(file), [])
        try:
            values = np.loadtxt(file, delimiter=",", ndmin=2)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
    if values.shape[1] != len(names):
        raise ValueError(f"{path}: {len(names)} names for {values.shape[1]} columns; expected a name for each")
    return {name: values[:, place] for place, name in enumerate(names)}
