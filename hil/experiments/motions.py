"""Motions of the bench file."""

import math

import numpy as np

from hil.arm.line import arm_line
from hil.arm.straight_line import JointLimits
from hil.arm.tables import ArmLink, ArmTable
from hil.bench.bench import AxisTable, Bench
from hil.control.trajectory import ConstantAcceleration, PointToPoint, sample_times
from hil.errors import NotPossibleError
from hil.master.motion import Motion
from hil.master.request import check_acceleration
from hil.robot_tables import LineMotion

MARGIN_REV = 0.5
"""Bound: distance of a planned travel from the position limits: a motor lags its set-point by 0.4 rev at 10 rps and K_pp = 25/s,
and an excitation comes on top."""

CONSTANT_ACCELERATION, LINE_MOTION, POINT_TO_POINT = "constant-acceleration", "line-motion", "point-to-point"


def constant_acceleration(bench: Bench, axis: int, period_s: float) -> Motion:
    """Turn one motor through the resonant speeds and back to rest.

    The motion begins at the present position. Source: the paper, sections 3.2 and 5.1.

    Raises:
        NotPossibleError: The bench file has no such motion or axis.
    """
    table = bench.constant_acceleration
    if table is None:
        raise NotPossibleError(f"bench {bench.name!r} has no constant_acceleration table")
    return _of_one_axis(bench, axis, table.trajectory(), period_s)


def point_to_point(bench: Bench, axis: int, period_s: float) -> Motion:
    """Move one motor from rest to rest, from its present position.

    Raises:
        NotPossibleError: The bench file has no such motion or axis.
    """
    table = bench.point_to_point
    if table is None:
        raise NotPossibleError(
            f"bench {bench.name!r} has no point_to_point table: distance_rev, speed_rps and acceleration_rps_s of the motor"
        )
    return _of_one_axis(bench, axis, table.trajectory(), period_s)


def _of_one_axis(bench: Bench, axis: int, trajectory: ConstantAcceleration | PointToPoint, period_s: float) -> Motion:
    bench.check_axis(axis)
    check_acceleration(bench.axis[axis], axis, trajectory)
    times = sample_times(trajectory.duration_s, period_s)
    return Motion((axis,), times, trajectory.motor_angle(times)[:, np.newaxis], starts_at_home=False)


def line_motion(bench: Bench, period_s: float) -> Motion:
    """Move the tip along a straight line.

    The line is that of an arm, or of the chain of the geometry table (the paper, section 5.2).

    Raises:
        NotPossibleError: The bench file has no such motion.
        UnreachableError: The line leaves the reach of the geometry's chain.
        LineError: The arm cannot follow the line: out of reach, singular, or beyond a limit of a joint.
    """
    if bench.arm is not None and bench.line_motion is not None:
        return _arm_motion(bench, bench.arm, bench.line_motion, period_s)
    if bench.line_motion is None or bench.geometry is None:
        missing = [name for name in ("geometry", "line_motion") if getattr(bench, name) is None]
        raise NotPossibleError(
            f"bench {bench.name!r} has no {' and no '.join(missing)} table: a line needs the lengths of the arm, with "
            "axes = [shoulder, elbow, wrist], and its ends"
        )
    line = bench.line_motion.line(bench.geometry.chain())
    times = sample_times(line.duration_s, period_s)
    joints = line.joints(times)
    ratios = np.array([bench.axis[number].reduction_ratio for number in bench.chain_axes])
    return Motion(bench.chain_axes, times, (joints - joints[0]) * ratios, starts_at_home=True)


def _arm_motion(bench: Bench, arm: ArmTable, motion: LineMotion, period_s: float) -> Motion:
    """Motion of an arm along its line."""
    wanted = arm_line(arm, motion)
    limits = [
        _joint_limits(bench.axis[link.axis], link, home) for link, home in zip(arm.link, arm.home_rad().tolist(), strict=True)
    ]
    wanted.line.check_limits(limits, period_s)
    axes, times = wanted.axes, sample_times(wanted.line.duration_s, period_s)
    ratios = np.array([bench.axis[number].reduction_ratio for number in axes])
    return Motion(axes, times, wanted.turned(times) * ratios, starts_at_home=True)


def _joint_limits(axis: AxisTable, link: ArmLink, home_rad: float) -> JointLimits:
    """Limits of a joint: the closer ones of axis and link."""
    turn = 2.0 * math.pi / axis.reduction_ratio
    low, high = home_rad + axis.limits.position_min_rev * turn, home_rad + axis.limits.position_max_rev * turn
    speed = axis.limits.speed_rps * turn
    if link.range_deg is not None:
        low, high = max(low, math.radians(link.range_deg[0])), min(high, math.radians(link.range_deg[1]))
    if link.speed_limit_deg_s is not None:
        speed = min(speed, math.radians(link.speed_limit_deg_s))
    return JointLimits(low, high, speed)
