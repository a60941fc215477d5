"""Links, tip and sensor of an arm as the articulated-body algorithm of `articulated.h` reads them."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.arm.mounting import Mounting
from hil.arm.rotation import rotation, turn
from hil.arm.tables import ArmTable
from plant_emulator.core import CORE

Real = NDArray[np.float64]


LINK = CORE.dtype("link")


def link_rows(arm: ArmTable, axes: tuple[int, ...]) -> NDArray[np.void]:
    """Return the `LINK` array of an arm, shape (n_links + 1,).

    Row 0 is the base, which falls upwards: so gravity acts on every link.

    Args:
        arm: The arm, its URDF file read.
        axes: Numbers of the robot's axes, by row.
    """
    rows = np.zeros(len(arm.link) + 1, LINK)
    rows[0]["frame"] = np.eye(3)
    rows[0]["acceleration"][3:] = -np.array(arm.gravity_m_s2)
    before = np.eye(3)
    for row, link, body, home in zip(rows[1:], arm.link, arm.bodies(), arm.home_rad(), strict=True):
        along = along_z(link.unit_direction())
        row["row"], row["home_rad"] = axes.index(link.axis), home
        row["turn"] = before.T @ link.rotation() @ along
        row["origin"] = before.T @ np.array(link.origin_m)
        row["mass_kg"] = body.mass_kg
        row["centre"] = along.T @ np.array(body.centre_m)
        row["inertia"] = along.T @ body.inertia_kg_m2.tensor() @ along
        before = along
    return rows


def along_z(direction: Real) -> Real:
    """A rotation whose z axis is a direction; shape (3, 3)."""
    axis = np.array([-direction[1], direction[0], 0.0])  # z × direction
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return np.diag([1.0, 1.0, 1.0]) if direction[2] > 0.0 else np.diag([1.0, -1.0, -1.0])
    return turn(axis / sine, math.atan2(sine, float(direction[2])))


def accelerations(links: NDArray[np.void], joints: Real) -> None:
    """Accelerations of an arm's joints under their torques.

    Args:
        links: `LINK` array, shape (n + 1,); what belongs to one evaluation is written.
        joints: Angles q in rad, speeds q̇, torques in N·m, and q̈, which is written; from the base on, shape (4, n).

    Raises:
        ValueError: The arrays do not fit each other.
    """
    CORE.call.accelerations(*_arrays(links, joints))


def holding_torques(links: NDArray[np.void], joints: Real) -> None:
    """Torques that hold an arm at rest against gravity.

    Args:
        links: `LINK` array, shape (n + 1,); what belongs to one evaluation is written.
        joints: As of `accelerations`: the angles are read, the torques written.

    Raises:
        ValueError: The arrays do not fit each other.
    """
    CORE.call.holding_torques(*_arrays(links, joints))


def _arrays(links: NDArray[np.void], joints: Real) -> tuple[Any, int, Any]:
    """Arguments in C; the base is not a joint."""
    count = len(links) - 1
    if joints.shape != (CORE.call.JOINT_ROWS, count):
        raise ValueError(f"joints have shape {joints.shape} where {count} links ask for {(CORE.call.JOINT_ROWS, count)}")
    return CORE.pointer(links, "link"), count, CORE.pointer(joints)


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
