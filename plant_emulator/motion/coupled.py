"""The control period of the drives of an arm: all axes go through each period together, since the links couple them."""

import numpy as np
from numpy.typing import NDArray

from hil.control.compiled import compiled, inlined
from hil.control.records import Rows
from plant_emulator.motion.period import age, command
from plant_emulator.motion.record import BRAKED, AxisRow
from plant_emulator.physics.angle_grid import Constants
from plant_emulator.physics.articulated import LinkRow
from plant_emulator.physics.axis import PlantStateRow
from plant_emulator.physics.flexible import SLOPE, STATE, flexible_period, flexible_rest, take_error
from plant_emulator.physics.mounted import feel
from plant_emulator.physics.tool import tool_motion

Real = NDArray[np.float64]


@inlined
def _take(axis: AxisRow, i: int, drive: Real, stages: Real, period_s: float) -> None:
    """Run the drive of a joint, and take the joint's state from its axis."""
    s, x = axis.plant_state, stages[STATE, i]
    drive[0, i] = command(axis, s.motor_angle_rad, period_s)
    drive[1, i] = 1.0 if axis.motion.mode == BRAKED else 0.0
    x[0], x[1], x[2], x[3] = s.motor_angle_rad, s.motor_speed_rad_s, s.arm_angle_rad, s.arm_speed_rad_s
    x[4], x[5] = s.hysteresis_nm, s.torque_nm


@inlined
def _put_back(s: PlantStateRow, x: Real) -> None:
    """Give an axis the state of its joint."""
    s.motor_angle_rad, s.motor_speed_rad_s, s.arm_angle_rad, s.arm_speed_rad_s = x[0], x[1], x[2], x[3]
    s.hysteresis_nm, s.torque_nm = x[4], x[5]


@compiled
def advance_coupled(
    periods: int,
    period_s: float,
    substeps: int,
    axes: Rows[AxisRow],
    joints: Rows[Constants],
    links: Rows[LinkRow],
    near: Real,
    drive: Real,
    turning: Real,
    stages: Real,
    tool: Real,
    moved: Real,
    sensor: Real,
    room: Real,
    tips: Real,
) -> None:
    """Advance all axes of an arm by some control periods: measure, set-point, servo law, limits, plant.

    Args:
        periods: Number of control periods.
        period_s: The control period.
        substeps: Runge-Kutta steps of the plant per period.
        axes: `AXIS` array, by row; changed in place.
        joints: `JOINT` array, from the base on; shape (n,).
        links: `LINK` array; shape (n + 1,).
        near: Room for grid points; shape (n, NEAR).
        drive: Torque commands and brakes, written; shape (2, n).
        turning: Room for the links' joints; shape (4, n).
        stages: Room for states and rates; shape (4, n, STATES).
        tool: `tool_rows` of the arm.
        moved: `tool_motion` after the last period, written; shape (4, 3).
        sensor: `sensor_rows` of its accelerometer.
        room: Room for the sensor's motion; shape (4, 3).
        tips: What the sensor feels after each of the last of these periods, written; shape (rows, 3).
    """
    count, first = len(joints), periods - len(tips)
    for period in range(periods):
        for i in range(count):
            _take(axes[links[i + 1].row], i, drive, stages, period_s)
        flexible_period(joints, links, near, drive, turning, stages, period_s, substeps)
        for i in range(count):
            axis = axes[links[i + 1].row]
            _put_back(axis.plant_state, stages[STATE, i])
            if axis.change.is_changing > 0.0:
                age(axis, period_s)
                take_error(joints[i], axis.plant, near[i])
        if period >= first:
            flexible_rest(joints, links, near, drive, turning, stages)
            tool_motion(links, count, tool, moved)
            feel(links, sensor, moved[2], room, tips[period - first])
    for i in range(count):
        axis = axes[links[i + 1].row]
        axis.motion.wake = 1 if axis.motion.trip != 0 or axis.motion.event != 0 else 0
        if periods > 0:
            axis.plant_state.arm_acceleration_rad_s2 = stages[SLOPE, i, 3]
