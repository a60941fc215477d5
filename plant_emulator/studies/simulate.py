"""The experiments without CAN, in one process, for comparison with bus runs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drive_profiles.standard.units import Scaling, real32
from hil.arm.line import arm_line
from hil.control.arrays import Real
from hil.control.cascade import Cascade
from hil.control.notch import Notch
from hil.control.trajectory import sample_times
from hil.robot_tables import Control, NotchShape
from plant_emulator.motion.axes import Axes, FollowedRun, follow_alike
from plant_emulator.motion.record import POSITION
from plant_emulator.robots.robot import Robot

SETTLE_S = 0.5
"""Rest of the axes before a motion."""


@dataclass(frozen=True)
class Simulation:
    """A simulated run, sampled at the SYNC period.

    Row i is the instant at which set-point i takes effect.

    Attributes:
        time_s: Shape (n,).
        axes: The axes that moved, in the order of the columns below.
        reference_counts: Set-points; shape (n, axes).
        tip_acceleration_m_s2: Acceleration (X, Y, Z) of the tip as the accelerometer passes it on, without noise; shape (n, 3).
    """

    time_s: Real
    axes: tuple[int, ...]
    reference_counts: NDArray[np.int64]
    position_counts: NDArray[np.int64]
    arm_angle_rad: Real
    torque_nm: Real
    tip_acceleration_m_s2: Real


def axis_columns(axes: Sequence[int], reference_counts: NDArray[Any], run: "Simulation | FollowedRun") -> dict[str, Any]:
    """Return set-points, encoders, arm angles and torques of a run by column."""
    signals = {
        "reference_counts": reference_counts, "position_counts": run.position_counts,
        "arm_angle_rad": run.arm_angle_rad, "torque_nm": run.torque_nm,
    }  # fmt: skip
    return {f"axis{number}_{name}": each[:, i] for i, number in enumerate(axes) for name, each in signals.items()}


def references(robot: Robot, axis: int | None, sync_period_s: float) -> tuple[tuple[int, ...], Real, Real]:
    """Return axes, times and motor angles (n, axes) of a motion.

    It is the constant-acceleration motion of one axis, or the line motion (None).

    Raises:
        ValueError: The robot file lacks the motion, or the axis; or its arm cannot follow the line.
    """
    if axis is not None:
        if robot.constant_acceleration is None or axis not in robot.axis:
            raise ValueError(f"robot {robot.name!r} has no constant-acceleration motion of an axis {axis}")
        trajectory = robot.constant_acceleration.trajectory()
        times = sample_times(trajectory.duration_s, sync_period_s)
        return (axis,), times, trajectory.motor_angle(times)[:, np.newaxis]
    if robot.line_motion is not None and robot.links is not None:
        wanted = arm_line(robot.links, robot.line_motion)
        times = sample_times(wanted.line.duration_s, sync_period_s)
        ratios = np.array([robot.axis[number].reduction_ratio for number in wanted.axes])
        return wanted.axes, times, wanted.turned(times) * ratios
    if robot.line_motion is None or robot.geometry is None:
        raise ValueError(f"robot {robot.name!r} has no line motion")
    line = robot.line_motion.line(robot.geometry.chain())
    times = sample_times(line.duration_s, sync_period_s)
    joints = line.joints(times)
    ratios = np.array([robot.axis[number].reduction_ratio for number in robot.chain_axes])
    return robot.chain_axes, times, (joints - joints[0]) * ratios


def simulate(
    robot: Robot,
    axis: int | None,
    *,
    controls: Mapping[int, Control],
    notches: Mapping[int, tuple[NotchShape, ...]],
    sync_period_s: float = 0.002,
    settle_s: float = SETTLE_S,
) -> Simulation:
    """Run one experiment with the loop closed in the drives.

    Set-points come every SYNC period; the servo law runs at the control period.

    Set-points are rounded to counts and gains to single precision, as they are when they cross the bus.

    Args:
        sync_period_s: A whole number of control periods.

    Raises:
        ValueError: The robot lacks the motion, or the periods do not fit.
    """
    periods = round(sync_period_s / robot.control_period_s)
    if periods < 1 or not math.isclose(periods * robot.control_period_s, sync_period_s, rel_tol=1e-9):
        raise ValueError(f"{sync_period_s} s is not a whole number of control periods of {robot.control_period_s} s")
    numbers, times, angles = references(robot, axis, sync_period_s)
    scalings = [Scaling(robot.axis[number].encoder_counts_per_rev, robot.axis[number].rated_torque) for number in numbers]
    targets = np.stack([each.position_counts(turned) for each, turned in zip(scalings, angles.T, strict=True)], axis=1)
    laws = {
        number: LawOfAxis(gains_as_uploaded(controls[number]), [as_uploaded(each.notch()) for each in notches.get(number, ())])
        for number in numbers
    }
    [run] = follow([Axes(robot)], laws, targets, periods, settle_s)
    return Simulation(times, numbers, targets, run.position_counts, run.arm_angle_rad, run.torque_nm, run.sensed_m_s2)


class LawOfAxis(NamedTuple):
    """Gains and filters of an axis, as its drive holds them."""

    cascade: Cascade
    notches: Sequence[Notch]


def follow(
    robots: Sequence[Axes], laws: Mapping[int, LawOfAxis], targets: NDArray[Any], periods: int, settle_s: float = SETTLE_S
) -> list[FollowedRun]:
    """Run the same axes of each robot under their laws along set-points, after a rest.

    Args:
        robots: The axes of each, at rest behind their brakes; changed.
        laws: Law of each axis that moves, by number, in the order of the columns of `targets`.
        targets: Set-points in counts; shape (n, axes).
        periods: Control periods from one to the next.
    """
    rows = [robots[0].row(number) for number in laws]
    for axes in robots:
        for row, law in zip(rows, laws.values(), strict=True):
            law.cascade.write(axes.cascade_config[row])
            for slot, notch in enumerate(law.notches):
                notch.write(axes.notch_config[row, slot])
            axes.open_brake(row, POSITION, periods)
    rest = round(settle_s / (periods * robots[0].robot.control_period_s))
    runs = follow_alike(robots, rows, np.concatenate([np.zeros((rest, len(rows))), targets]), periods)
    return [run.since(rest) for run in runs]


def gains_as_uploaded(control: Control) -> Cascade:
    """Return the gains as a drive holds them after upload."""
    return Cascade(**{name: real32(value) for name, value in control.model_dump().items()})


def as_uploaded(notch: Notch) -> Notch:
    """Return the filter as a drive holds it, its parameters as REAL32."""
    singles: dict[str, Any] = {name: real32(value) for name, value in vars(notch).items() if isinstance(value, float)}
    return replace(notch, **singles)
