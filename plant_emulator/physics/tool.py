"""Motion of an arm's tip, and the specific force that an accelerometer in the tool's frame feels there."""

import math

import numpy as np
from numpy.typing import NDArray

from hil.arm.rotation import rotation
from hil.arm.tables import ArmTable
from hil.control.compiled import compiled
from hil.control.records import Rows
from plant_emulator.physics.articulated import LinkRow, along_z

Real = NDArray[np.float64]

POSITION, VELOCITY, ACCELERATION, SPECIFIC_FORCE = range(4)
"""Rows of the array that `tool_motion` writes."""


def tool_rows(arm: ArmTable) -> Real:
    """The tool in the frame of the last link of `link_rows`: where the tip is, then the tool's frame; shape (4, 3)."""
    along = along_z(arm.link[-1].unit_direction())
    frame = rotation(*map(math.radians, arm.tip_rpy_deg))
    return np.vstack([along.T @ np.array(arm.tip_m), along.T @ frame])


@compiled
def tool_motion(links: Rows[LinkRow], number: int, tool: Real, moved: Real) -> None:
    """Position, velocity and acceleration of the tip in the frame of the base, and its specific force a − g in that of the tool.

    Args:
        links: `LINK` array as `accelerations` has left it.
        number: Row of the link that carries the tool.
        tool: `tool_rows` of the arm; shape (4, 3).
        moved: Written; shape (4, 3).
    """
    last, ground = links[number], links[0]
    w, a = last.velocity, last.acceleration
    for r in range(3):
        moved[0, r] = last.position[r]
        for k in range(3):
            moved[0, r] += last.frame[r, k] * tool[0, k]
    x, y, z = moved[0, 0], moved[0, 1], moved[0, 2]
    vx, vy, vz = w[3] + (w[1] * z - w[2] * y), w[4] + (w[2] * x - w[0] * z), w[5] + (w[0] * y - w[1] * x)
    moved[1, 0], moved[1, 1], moved[1, 2] = vx, vy, vz
    fx = a[3] + (a[1] * z - a[2] * y) + (w[1] * vz - w[2] * vy)
    fy = a[4] + (a[2] * x - a[0] * z) + (w[2] * vx - w[0] * vz)
    fz = a[5] + (a[0] * y - a[1] * x) + (w[0] * vy - w[1] * vx)
    up = ground.acceleration  # −g: the links fall upwards with it
    moved[2, 0], moved[2, 1], moved[2, 2] = fx - up[3], fy - up[4], fz - up[5]
    for k in range(3):
        lx = last.frame[0, k] * fx + last.frame[1, k] * fy + last.frame[2, k] * fz
        for r in range(3):
            moved[3, r] = tool[1 + k, r] * lx + (moved[3, r] if k > 0 else 0.0)
