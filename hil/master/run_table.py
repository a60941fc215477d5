"""The rows of a run while they are being recorded."""

from collections.abc import Sequence

import numpy as np

from hil.recording import Recording

_COMMON, _PER_AXIS = 5, 4
_AXIS_COLUMNS = ("reference_rad", "position_rad", "torque_nm", "notch_hz")
_TIP_COLUMNS = ("tip_x_m_s2", "tip_y_m_s2", "tip_z_m_s2", "missing")


class RunTable:
    """One row per SYNC of the motion: time, tip, missing answers, and four values of each axis.

    Args:
        length: Number of rows of the whole motion.
        axes: Number of axes.

    Attributes:
        rows: Number of rows so far.
    """

    def __init__(self, length: int, axes: int) -> None:
        self.rows = 0
        # written once, so that its pages are there before the motion needs them
        self._values = np.full((length, _COMMON + _PER_AXIS * axes), 0.0)

    def keep(self, row: int, values: Sequence[float]) -> None:
        """Keep a row: time, X, Y, Z, missing answers, then reference, position, torque and notch frequency of each axis."""
        self._values[row] = values
        self.rows = row + 1

    def recording(self, axes: Sequence[int], *, with_notch: bool) -> Recording:
        """The rows that are kept, as columns.

        Args:
            axes: Numbers of the axes.
            with_notch: True where the drives send notch frequencies; else these have no columns.
        """
        table = self._values[: self.rows]
        columns = {"time_s": table[:, 0]}
        names = _AXIS_COLUMNS if with_notch else _AXIS_COLUMNS[:-1]
        for i, number in enumerate(axes):
            for j, name in enumerate(names):
                columns[f"axis{number}_{name}"] = table[:, _COMMON + _PER_AXIS * i + j]
        for j, name in enumerate(_TIP_COLUMNS):
            columns[name] = table[:, 1 + j]
        return Recording(columns)
