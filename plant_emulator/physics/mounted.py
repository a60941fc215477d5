"""What an accelerometer feels that is fixed to a link of an arm, or an ideal one at its tip."""

import numpy as np
from numpy.typing import NDArray

from hil.arm.mounting import Mounting
from hil.arm.tables import ArmTable
from hil.control.compiled import compiled
from hil.control.records import Rows
from plant_emulator.physics.articulated import LinkRow, along_z
from plant_emulator.physics.tool import tool_motion

Real = NDArray[np.float64]

SENSOR_ROWS = 5
"""Origin, three of the frame, and what it is: number of its link (0: none, an ideal sensor), 1 where it feels its weight."""


def sensor_rows(arm: ArmTable, mounting: Mounting | None) -> Real:
    """A sensor in the frame of its link of `link_rows`; shape (5, 3).

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


@compiled
def feel(links: Rows[LinkRow], sensor: Real, tip: Real, room: Real, felt: Real) -> None:
    """What a sensor feels along its own axes: f = R_sᵀ (a − g), without g where it does not feel its weight.

    Args:
        links: `LINK` array as `accelerations` has left it.
        sensor: `sensor_rows`.
        tip: Acceleration of the tip in the frame of the base, which an ideal sensor shows; shape (3,).
        room: Room for the motion of the sensor's place; shape (4, 3).
        felt: Written; shape (3,).
    """
    number = int(sensor[4, 0])
    if number == 0:
        for r in range(3):
            felt[r] = tip[r]
        return
    tool_motion(links, number, sensor, room)
    link, up = links[number], links[0].acceleration
    for r in range(3):
        felt[r] = 0.0
    for k in range(3):
        along = 0.0
        for r in range(3):
            along += link.frame[r, k] * (room[2, r] + sensor[4, 1] * up[3 + r])
        for r in range(3):
            felt[r] += sensor[1 + k, r] * along
