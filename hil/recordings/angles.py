"""Angles that wrap after a revolution, unwrapped."""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.recordings.errors import RecordingFileError
from hil.recordings.layout import Column

Real = NDArray[np.float64]

LARGEST_STEP = 0.35
"""Largest step between two samples, in revolutions, from which the direction is still known where an angle begins anew."""
JUMP = 0.5
"""Step between two samples, in revolutions, that no motor makes: the angle has begun anew there."""


def angle_rad(path: Path, column: Column, values: Real) -> tuple[Real, int]:
    """Unwrap an angle in rad, and count its wraps.

    Args:
        path: The file, for errors.
        column: The column.
        values: Its numbers; shape (n,).

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
