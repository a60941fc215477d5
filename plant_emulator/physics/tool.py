"""Motion of an arm's tip."""

import math

import numpy as np
from numpy.typing import NDArray

from hil.arm.rotation import rotation
from hil.arm.tables import ArmTable
from plant_emulator.core import CORE
from plant_emulator.physics.articulated import along_z

Real = NDArray[np.float64]

POSITION: int = CORE.call.TOOL_POSITION
VELOCITY: int = CORE.call.TOOL_VELOCITY
ACCELERATION: int = CORE.call.TOOL_ACCELERATION
SPECIFIC_FORCE: int = CORE.call.TOOL_SPECIFIC_FORCE
ROWS: int = CORE.call.TOOL_ROWS
"""Rows of the array that `tool_motion` writes."""


def tool_rows(arm: ArmTable) -> Real:
    """Return the tool in its link's frame; shape (4, 3).

    Place of the tip, then the tool's frame; the link is the last one of `link_rows`.
    """
    along = along_z(arm.link[-1].unit_direction())
    frame = rotation(*map(math.radians, arm.tip_rpy_deg))
    return np.vstack([along.T @ np.array(arm.tip_m), along.T @ frame])
