"""Accelerometer on a link of an arm, or ideal at the tip."""

import numpy as np
from numpy.typing import NDArray

from hil.arm.mounting import Mounting
from hil.arm.tables import ArmTable
from plant_emulator.core import CORE
from plant_emulator.physics.articulated import along_z

Real = NDArray[np.float64]

SENSOR_ROWS: int = CORE.call.SENSOR_ROWS
"""Origin, three of the frame, and what it is: number of its link (0: none, an ideal sensor), 1 where it feels its weight."""


def sensor_rows(arm: ArmTable, mounting: Mounting | None) -> Real:
    """Return a sensor in the frame of its link; shape (5, 3).

    The links are those of `link_rows`.

    Args:
        arm: The arm, its URDF file read.
        mounting: Where the sensor sits; None: an ideal one at the tip, along the axes of the base.
    """
    rows = np.zeros((SENSOR_ROWS, 3))
    if mounting is not None:
        of = mounting.frame(arm)
        along = along_z(arm.link[of.link - 1].unit_direction())
        rows[0], rows[1:4] = along.T @ of.origin_m, along.T @ of.frame
        rows[4, 0], rows[4, 1] = of.link, 1.0 if mounting.gravity else 0.0
    return rows
