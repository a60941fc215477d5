"""A recording for a fit: angles unwrapped, SI units, complete rows."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.control.arrays import Real
from hil.errors import RecordingFileError
from hil.recordings.layout import Column, Said, choose_columns
from hil.recordings.source import Source, complete_rows
from hil.recordings.units import Role

GOES_BACK = 20.0
"""Step backwards of the time, in periods, that no jitter makes."""


@dataclass(frozen=True)
class Recorded:
    """One recording of one axis.

    Attributes:
        value: Numbers by role, in s, rad, m/s² and N·m; all of shape (n,).
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
        """Range of the steps between time stamps, without outliers."""
        low, high = np.percentile(np.diff(self.time_s), (1.0, 99.0))
        return float(high - low)


def read_recording(path: Path, said: Said, axis: int) -> Recorded:
    """Read a recording of one axis.

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


def open_source(path: Path, description: Path | None = None, node_id: int | None = None) -> Source:
    """A recording, by the suffix of its name.

    Raises:
        RecordingFileError: The format is not known, or the file cannot be read.
        MissingPackageError: The format needs a package that is not installed.
    """
    if not path.is_file():
        raise RecordingFileError(path, "there is no such file")
    if path.stat().st_size == 0:
        raise RecordingFileError(path, "the file is empty; check that the recording was stopped and copied whole")
    name = path.name.lower()
    if name.endswith((".csv", ".csv.gz", ".txt", ".tsv")):
        from hil.recordings.delimited import DelimitedFile  # noqa: PLC0415 - a reader is loaded where it is needed

        return DelimitedFile(path)
    if name.endswith((".parquet", ".pq")):
        from hil.recordings.parquet import ParquetFile  # noqa: PLC0415

        return ParquetFile(path)
    if name.endswith((".mf4", ".mdf")):
        from hil.recordings.mdf import MdfFile  # noqa: PLC0415

        return MdfFile(path)
    if name.endswith((".log", ".blf", ".asc")):
        from hil.recordings.frames import FrameFile  # noqa: PLC0415

        return FrameFile(path, description, node_id)
    raise RecordingFileError(path, "unknown format; expected .csv, .csv.gz, .tsv, .parquet, .mf4, .log, .blf or .asc")


LARGEST_STEP = 0.35
"""Largest step between two samples, in revolutions, from which the direction is still known where an angle begins anew."""
JUMP = 0.5
"""Step between two samples, in revolutions, that no motor makes: the angle has begun anew there."""


def angle_rad(path: Path, column: Column, values: Real) -> tuple[Real, int]:
    """Unwrap an angle in rad, and count its wraps.

    The path is for errors; the numbers have the shape (n,).

    Raises:
        RecordingFileError: A jump is not a whole revolution, or the angle turns too far from sample to sample.
    """
    unit = column.unit
    turned = values / unit.per_rev
    steps = np.diff(turned)
    jumps = np.flatnonzero(np.abs(steps) > JUMP)
    if len(jumps):
        span = float(np.ptp(turned))
        if span > 1.0 + LARGEST_STEP:
            row = int(jumps[0])
            raise RecordingFileError(
                path,
                f"{column.name!r} jumps by {steps[row]:.3g} revolutions from row {row + 1} to {row + 2} while its "
                f"values span {span:.3g}; it does not wrap after one revolution, so the jump cannot be undone",
            )
        turned = np.unwrap(turned, period=1.0)
    step = float(np.max(np.abs(np.diff(turned)))) if len(turned) > 1 else 0.0
    if len(jumps) and step > LARGEST_STEP:
        row = int(np.argmax(np.abs(np.diff(turned))))
        raise RecordingFileError(
            path,
            f"{column.name!r} wraps after each revolution and turns by {step:.2f} rev from row {row + 1} to {row + 2}; at most "
            f"{LARGEST_STEP:g} rev shows the direction: record more often, or without the wrap",
        )
    return np.asarray(turned * math.copysign(2.0 * math.pi, unit.factor)), len(jumps)
