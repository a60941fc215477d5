"""A recording for a fit: angles unwrapped, SI units, complete rows."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.recordings.angles import angle_rad
from hil.recordings.errors import RecordingFileError
from hil.recordings.layout import Column, Said, choose_columns
from hil.recordings.opening import open_source
from hil.recordings.source import complete_rows
from hil.recordings.units import Role

Real = NDArray[np.float64]

GOES_BACK = 20.0
"""Step backwards of the time, in periods, that no jitter makes."""


@dataclass(frozen=True)
class Recorded:
    """One recording of one axis.

    Attributes:
        path: The file.
        column: Columns by their role.
        value: Numbers by role, in s, rad, m/s² and N·m; all of shape (n,).
        notes: Sentences on changes to them.
    """

    path: Path
    column: dict[Role, Column]
    value: dict[Role, Real]
    notes: tuple[str, ...] = ()

    @property
    def time_s(self) -> Real:
        """Time stamps as they were recorded, from the first; shape (n,)."""
        return self.value["time"]

    @property
    def motor_rad(self) -> Real:
        """Motor angle; shape (n,)."""
        return self.value["motor"]

    @property
    def period_s(self) -> float:
        """Mean sampling period."""
        return float(self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1)

    @property
    def jitter_s(self) -> float:
        """Range of the steps between time stamps, without outliers.

        From the 1st to the 99th percentile.
        """
        low, high = np.percentile(np.diff(self.time_s), (1.0, 99.0))
        return float(high - low)


def read_recording(path: Path, said: Said, axis: int) -> Recorded:
    """Read a recording of one axis.

    Args:
        path: The file.
        said: The user's statements on its columns.
        axis: Number of the axis.

    Raises:
        RecordingFileError: The file, a column or its numbers cannot be used.
        MissingPackageError: Its format needs a package that is not installed.
    """
    source = open_source(path, said.description, said.node_id)
    column = choose_columns(path, source.names, said, axis)
    raw = source.columns([each.name for each in column.values()])
    raw, missing = complete_rows(path, raw)
    notes = [f"{missing} rows without a number are left out"] if missing else []
    value: dict[Role, Real] = {"time": _running(path, column["time"], raw[column["time"].name])}
    for role, each in column.items():
        if each.unit.per_rev:
            value[role], wraps = angle_rad(path, each, raw[each.name])
            if wraps:
                notes.append(f"{each.name!r} wraps {wraps} times; whole revolutions were added")
        elif role != "time":
            value[role] = raw[each.name] * each.unit.factor
    return Recorded(path, column, value, tuple(notes))


def _running(path: Path, column: Column, stamps: Real) -> Real:
    """Return the time in s from the first stamp.

    Jitter may decrease a stamp, but not by many periods.
    """
    time: Real = np.asarray((stamps - stamps[0]) * column.unit.factor)
    step = np.diff(time)
    typical = float(np.median(step))
    back = int(np.argmin(step))
    if step[back] < -GOES_BACK * abs(typical):
        raise RecordingFileError(
            path,
            f"the time goes back by {-step[back]:.3g} s from row {back + 1} to {back + 2}: are these two recordings in one file?",
        )
    if typical <= 0.0 or time[-1] <= 0.0:
        raise RecordingFileError(
            path,
            f"the time {column.name!r} does not increase: its median step is {typical:.3g} s; check for a reversed order, too "
            "few digits, or doubled stamps",
        )
    return time
