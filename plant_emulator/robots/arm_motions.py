"""Motions of an arm for its bench file."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.arm.kinematics import Kinematics
from hil.arm.line import arm_line
from hil.arm.straight_line import JointLimits, LineError
from hil.arm.tables import ArmTable
from hil.robot_tables import LineMotion, Point
from plant_emulator.robots.fleet import antiresonance_hz
from plant_emulator.robots.robot import RobotAxis

RAMP_DEG = 15.0
"""By how much a ramp may turn the arm: its resonances move with the posture."""
STEEPEST_RPS_S = 20.0
LEAST_END = 0.68
"""The ramp's end over the lowest f_a of an axis: it passes the resonance of order 2."""
CARRIERS = 3
"""Axes from the base on that carry the arm, and whose resonances a ramp is to meet."""
LINES_M = (0.25, 0.2, 0.15, 0.1)
DIRECTIONS = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0))
"""Directions of straight lines from home, of which the first that the arm can follow is taken."""
PERIOD_S = 0.002
"""Between two instants at which a line's speeds are looked at."""
PACE_M_S = 0.25 / 2.2
"""Length of the reference robot's line over its duration."""


def first_line(arm: ArmTable, limits: Sequence[JointLimits]) -> LineMotion | None:
    """Return a straight line from home that the arm can follow.

    The tool keeps its orientation. The result is None if there is no line of at least 10 cm.
    """
    home, _ = Kinematics.of(arm).pose(arm.home_rad())
    for length_m in LINES_M:
        for direction in DIRECTIONS:
            start, end = point_of(home), point_of(home + length_m * np.array(direction))
            motion = LineMotion(start_m=start, end_m=end, duration_s=max(1.0, round(length_m / PACE_M_S, 1)))
            try:
                arm_line(arm, motion).line.check_limits(limits, PERIOD_S)
            except LineError:
                continue
            return motion
    return None


def arm_ramp(axes: list[RobotAxis], fastest_rps: float, braking_rps_s: float) -> tuple[float, float]:
    """Return acceleration (rev/s²) and end speed (rev/s) of a short ramp.

    Args:
        axes: The axes of the arm, from the base on.
        fastest_rps: Speed that it must not pass.
    """
    carriers = axes[:CARRIERS]
    end = math.floor(10.0 * min(fastest_rps, LEAST_END * min(map(antiresonance_hz, carriers)))) / 10.0
    room = RAMP_DEG / 360.0 * min(axis.reduction_ratio for axis in carriers) - end**2 / (2.0 * braking_rps_s)
    steep = STEEPEST_RPS_S if room <= 0.0 else min(STEEPEST_RPS_S, end**2 / (2.0 * room))
    return math.ceil(10.0 * steep) / 10.0, end


def point_of(position: NDArray[np.float64]) -> Point:
    """Return a position in m, to the micrometre, as a table has it."""
    x, y, z = (round(float(value), 6) for value in position)
    return Point(x=x, y=y, z=z)
