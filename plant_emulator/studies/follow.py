"""A whole run of cyclic set-points in one call.

Studies of hundreds of runs use it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core import CORE

Real = NDArray[np.float64]

COUNTS: int = CORE.call.TRACE_COUNTS
ARM_ANGLE: int = CORE.call.TRACE_ARM_ANGLE
ARM_SPEED: int = CORE.call.TRACE_ARM_SPEED
ARM_ACCELERATION: int = CORE.call.TRACE_ARM_ACCELERATION
TORQUE: int = CORE.call.TRACE_TORQUE
"""Columns of a trace."""


def follow(periods: int, period_s: float, substeps: int, axes: NDArray[Any], set_points: Real, noise: Real) -> Real:
    """Return measurements and states at each SYNC; shape (n, n_axes, 5).

    The same as `Axes.set_point` and `Axes.advance` in turn, to the bit, while no limit is set.

    Args:
        periods: Control periods per set-point.
        period_s: The control period.
        substeps: Runge-Kutta steps of the plant per period.
        axes: `AXIS` array, shape (n_axes,); changed in place.
        set_points: In counts; shape (n, n_axes).
        noise: Noise of the encoders in rad, instead of their own; shape (n_axes, n · periods).

    Raises:
        ValueError: The arrays do not fit each other.
    """
    samples, count = set_points.shape
    if len(axes) != count or noise.shape != (count, samples * periods):
        raise ValueError(
            f"set-points of shape {set_points.shape} do not fit {len(axes)} axes and noise of shape {noise.shape}; "
            f"expected a column for each axis, and {periods} control periods each"
        )
    trace = np.zeros((samples, count, CORE.call.TRACE_COLUMNS))
    given = (CORE.pointer(np.ascontiguousarray(each)) for each in (set_points, noise))
    CORE.call.follow(periods, period_s, substeps, CORE.pointer(axes, "axis"), count, samples, *given, CORE.pointer(trace))
    return trace
