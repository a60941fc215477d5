"""The rows of a run while they are being recorded."""

from collections.abc import Sequence

import numpy as np

from hil.control.arrays import Real
from hil.core.library import CORE
from hil.recording import Recording

_COMMON: int = CORE.call.COMMON_COLUMNS
_PER_AXIS: int = CORE.call.AXIS_COLUMNS
_AXIS_COLUMNS = ("reference_rad", "position_rad", "torque_nm", "notch_hz")
_TIP_COLUMNS = ("tip_x_m_s2", "tip_y_m_s2", "tip_z_m_s2", "missing")


class RunTable:
    """Recorded rows of a motion, one per SYNC.

    Time, tip, missing answers, four values of each axis, and the angle of each joint's encoder: see `run.h`.

    Args:
        time_s: Time of each row of the whole motion; shape (n,).
        encoders: Number of second encoders.

    Attributes:
        rows: Number of rows so far.
        room: Number of rows of the whole motion.
        values: All rows; the core fills them.
    """

    def __init__(self, time_s: Real, axes: int, encoders: int = 0) -> None:
        self.rows, self.room = 0, len(time_s)
        # written once, so that its pages are there before the motion needs them
        self.values = np.full((self.room, _COMMON + _PER_AXIS * axes + encoders), 0.0)
        self.values[:, 0] = time_s

    def recording(self, axes: Sequence[int], *, with_notch: bool, encoders: Sequence[int] = ()) -> Recording:
        """The rows that are kept, as columns.

        Args:
            with_notch: True if the drives send notch frequencies; else these have no columns.
            encoders: Numbers of the axes whose second encoders were kept.
        """
        table = self.values[: self.rows]
        columns, behind = {"time_s": table[:, 0]}, _COMMON + _PER_AXIS * len(axes)
        loads = {number: going_on(table[:, behind + i]) for i, number in enumerate(encoders)}
        for i, number in enumerate(axes):
            for j, name in enumerate(_AXIS_COLUMNS):
                if with_notch or name != "notch_hz":
                    columns[f"axis{number}_{name}"] = table[:, _COMMON + _PER_AXIS * i + j]
            if number in loads:
                columns[f"axis{number}_load_rad"] = loads.pop(number)
        columns |= {f"axis{number}_load_rad": angles for number, angles in loads.items()}
        for j, name in enumerate(_TIP_COLUMNS):
            columns[name] = table[:, 1 + j]
        return Recording(columns)


def going_on(angles_rad: Real) -> Real:
    """Unwrap the angles of a single-turn encoder; NaN remains; shape (n,)."""
    result, known = np.array(angles_rad), np.isfinite(angles_rad)
    result[known] = np.unwrap(result[known])
    return result
