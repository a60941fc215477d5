"""Straight-line motion of an arm, and the axes that move on it."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from hil.arm.kinematics import Kinematics
from hil.arm.rotation import rotation
from hil.arm.straight_line import LineError, Pose, StraightLine
from hil.arm.tables import ArmTable
from hil.control.arrays import Real
from hil.control.trajectory import Smooth
from hil.robot_tables import LineMotion, Point

MOVED_RAD = 1e-6
"""Turn of a joint on a line up to which its axis stays where it is: 1 µm at 1 m."""
SHORTEST_M, SHORTEST_RAD = 1e-6, 1e-6
"""Way and turn below which a line is not motion."""


@dataclass(frozen=True)
class ArmLine:
    """A line motion of an arm."""

    arm: ArmTable
    line: StraightLine

    @cached_property
    def moved(self) -> NDArray[np.int64]:
        """Indices of the joints that move on the line.

        From the base on. A joint counts if the line turns it, or holds it away from home.

        Raises:
            LineError: The arm cannot follow the line.
        """
        _, joints_rad = self.line.joints_along
        return np.asarray(np.flatnonzero(np.max(np.abs(joints_rad - self.arm.home_rad()), axis=0) > MOVED_RAD), dtype=np.int64)

    @property
    def axes(self) -> tuple[int, ...]:
        """Numbers of the axes that move, from the base on.

        Raises:
            LineError: The arm cannot follow the line.
        """
        return tuple(self.arm.axes[joint] for joint in self.moved)

    def turned(self, time_s: Real) -> Real:
        """Return the angles of the moving joints; shape (n,) gives (n, moved).

        Raises:
            LineError: The arm cannot follow the line.
        """
        return np.asarray((self.line.joints(time_s) - self.arm.home_rad())[:, self.moved])


@lru_cache(maxsize=16)
def arm_line(arm: ArmTable, motion: LineMotion) -> ArmLine:
    """The line motion of an arm.

    Raises:
        LineError: It has no length.
    """
    kinematics = Kinematics.of(arm)
    _, own = kinematics.pose(arm.home_rad())
    start = end = None
    if motion.orientation == "kept":
        start = own if motion.start_rpy_deg is None else rotation(*map(math.radians, motion.start_rpy_deg))
        end = start if motion.end_rpy_deg is None else rotation(*map(math.radians, motion.end_rpy_deg))
    line = StraightLine(
        kinematics,
        arm.home_rad(),
        Pose(_position(motion.start_m), start),
        Pose(_position(motion.end_m), end),
        Smooth(motion.duration_s, motion.ramp_s),
        motion.dwell_s,
        motion.tail_s,
        tuple(f"axis {axis}" for axis in arm.axes),
    )
    if line.length_m < SHORTEST_M and line.turned_rad < SHORTEST_RAD:
        raise LineError(
            0.0, line.length_m, "start_m and end_m are equal and the tool does not turn; give another end_m or end_rpy_deg"
        )
    return ArmLine(arm, line)


def _position(point: Point) -> Real:
    return np.array([point.x, point.y, point.z])


def moved_axes(arm: ArmTable, motion: LineMotion | None) -> tuple[int, ...]:
    """Return the numbers of the axes that the arm's line moves.

    From the base on. All axes if the arm cannot follow the line; none without a line.
    """
    if motion is None:
        return ()
    try:
        return arm_line(arm, motion).axes
    except LineError:
        return arm.axes
