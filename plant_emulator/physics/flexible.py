"""An arm on elastic joints over time: motors, gears and transmission errors of `angle_grid`, links of `articulated`.

Gears couple both: the torque of a gear turns its link, and acts back on its motor. A motor's spin counts about its own axis only,
and its mass belongs to the link that carries it.

Source: M. W. Spong, Modeling and Control of Elastic Joint Robots, ASME Journal of Dynamic Systems, Measurement, and Control 109,
1987.
"""

import math
from types import SimpleNamespace
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from hil.control.compiled import compiled, inlined
from hil.control.records import Rows
from plant_emulator.physics.angle_grid import AxisState, Constants, GridPoint, constants, grid_angles, grid_point, rates
from plant_emulator.physics.articulated import LinkRow, accelerations
from plant_emulator.physics.axis import MORE_LINES, PLANT, PlantRow

Real = NDArray[np.float64]

JOINT = np.dtype(
    [
        (name, np.float64) if kind is float else (name, np.float64, (MORE_LINES,))
        for name, kind in get_type_hints(Constants).items()
    ]
)
"""`Constants` of a joint as a record: compiled functions read either alike."""

STATES, NEAR = len(AxisState._fields), len(GridPoint._fields)
"""Numbers of an axis' state, and of the grid point near to it."""

STATE, POINT, SLOPE, SUM = range(4)
"""Planes of the array that the integration works on: state, state of a stage, its rates, and their weighted sum."""


def joint_row(plant: NDArray[Any]) -> NDArray[np.void]:
    """`JOINT` record of a `PLANT` record, whose own inertia and gravity give way to those of the links.

    An arm of 1 kg·m² without gravity makes of `rates` the torque on the link.
    """
    values = {name: plant[name].tolist() for name in PLANT.names or ()}
    values |= {"arm_inertia_kg_m2": 1.0, "gravity_moment_nm": 0.0, "home_angle_rad": 0.0}
    row: Any = SimpleNamespace(**values)
    found = np.zeros((), JOINT)
    for name, value in constants.py_func(row)._asdict().items():
        found[name] = value
    return found


@inlined
def _to_grid(k: Constants, near: Real, i: int, motor_angle: float, arm_angle: float) -> None:
    """Make a row of `near` the grid point nearest to a state."""
    motor, arm = grid_angles(k, motor_angle, arm_angle)
    if motor != near[i, 0] or arm != near[i, 7]:
        g = grid_point(k, motor, arm)
        near[i, 0], near[i, 1], near[i, 2], near[i, 3], near[i, 4] = g.motor, g.x1, g.y1, g.x2, g.y2
        near[i, 5], near[i, 6], near[i, 7], near[i, 8], near[i, 9] = g.x4, g.y4, g.arm, g.gravity_cos, g.gravity_sin


@inlined
def take_error(joint: Any, p: PlantRow, near: Real) -> None:
    """Give a joint the transmission error that its axis has now.

    Args:
        joint: A record of `JOINT`, changed in place; a protocol of what is written would be all of `Constants` once more.
        p: The axis' constants.
        near: The joint's grid point, which is worked out anew.
    """
    joint.a1_cos, joint.a1_sin = p.a1_rad * math.cos(p.phi1_rad), p.a1_rad * math.sin(p.phi1_rad)
    joint.a2_cos, joint.a2_sin = p.a2_rad * math.cos(p.phi2_rad), p.a2_rad * math.sin(p.phi2_rad)
    joint.a4_cos, joint.a4_sin = p.a4_rad * math.cos(p.phi4_rad), p.a4_rad * math.sin(p.phi4_rad)
    for i in range(MORE_LINES):
        joint.more_rad[i], joint.more_phi[i] = p.more_rad[i], p.more_phi_rad[i]
    near[0] = math.inf


@inlined
def _begin(joints: Rows[Constants], drive: Real, stages: Real) -> None:
    """Stop the motors behind a closed brake; where the current follows at once, the torque is the command."""
    for i in range(len(joints)):
        if drive[1, i] > 0.0:
            stages[STATE, i, 1], stages[STATE, i, 5] = 0.0, 0.0
        elif joints[i].current_time_constant <= 0.0:
            stages[STATE, i, 5] = drive[0, i]


@inlined
def _weighted(stages: Real, to: int, first: int, second: int, weight: float) -> None:
    """Plane `to` = plane `first` + weight · plane `second`."""
    for i in range(stages.shape[1]):
        for k in range(STATES):
            stages[to, i, k] = stages[first, i, k] + weight * stages[second, i, k]


@compiled
def flexible_rates(
    joints: Rows[Constants], links: Rows[LinkRow], near: Real, drive: Real, turning: Real, stages: Real, plane: int
) -> None:
    """The rates of all states of an arm.

    Args:
        joints: `JOINT` array, from the base on; shape (n,).
        links: `LINK` array; shape (n + 1,), what belongs to one evaluation is written.
        near: Grid points near to the state; shape (n, NEAR).
        drive: Torque commands in N·m, and 1 where the brake holds the motor; shape (2, n).
        turning: Angles, speeds, torques and accelerations of the links' joints, written; shape (4, n).
        stages: States, and their rates, which are written to the plane SLOPE; shape (4, n, STATES).
        plane: The plane that has the states: STATE or POINT.
    """
    for i in range(len(joints)):
        x = stages[plane, i]
        at = AxisState(x[0], x[1], x[2], x[3], x[4], x[5])
        g = GridPoint(
            near[i, 0], near[i, 1], near[i, 2], near[i, 3], near[i, 4], near[i, 5], near[i, 6], near[i, 7], near[i, 8], near[i, 9]
        )
        motor, torque, hysteresis, current = rates(joints[i], g, drive[0, i], drive[1, i] > 0.0, at)
        slope = stages[SLOPE, i]
        slope[0], slope[1], slope[2], slope[4], slope[5] = x[1], motor, x[3], hysteresis, current
        turning[0, i], turning[1, i], turning[2, i] = links[i + 1].home_rad + x[2], x[3], torque
    accelerations(links, turning)
    for i in range(len(joints)):
        stages[SLOPE, i, 3] = turning[3, i]


@compiled
def flexible_period(
    joints: Rows[Constants],
    links: Rows[LinkRow],
    near: Real,
    drive: Real,
    turning: Real,
    stages: Real,
    period_s: float,
    substeps: int,
) -> None:
    """One control period of an arm under constant torque commands: classical Runge-Kutta, fixed sub-steps.

    Args:
        joints: `JOINT` array, from the base on; shape (n,).
        links: `LINK` array; shape (n + 1,), what belongs to one evaluation is written.
        near: Room for the grid points near to the state; shape (n, NEAR).
        drive: Torque commands in N·m, and 1 where the brake holds the motor; shape (2, n).
        turning: Room for angles, speeds, torques and accelerations of the links' joints; shape (4, n).
        stages: The plane STATE has the state and is changed, the others are room; shape (4, n, STATES).
        period_s: The control period.
        substeps: Runge-Kutta steps per period.
    """
    h = period_s / substeps
    _begin(joints, drive, stages)
    for _ in range(substeps):
        for i in range(len(joints)):
            _to_grid(joints[i], near, i, stages[STATE, i, 0], stages[STATE, i, 2])
        _weighted(stages, SUM, SUM, SUM, -1.0)
        _weighted(stages, POINT, STATE, STATE, 0.0)
        for stage in range(4):
            flexible_rates(joints, links, near, drive, turning, stages, POINT)
            _weighted(stages, SUM, SUM, SLOPE, 2.0 if stage in (1, 2) else 1.0)
            _weighted(stages, POINT, STATE, SLOPE, h if stage == 2 else 0.5 * h)
        _weighted(stages, STATE, STATE, SUM, h / 6.0)


@compiled
def flexible_rest(joints: Rows[Constants], links: Rows[LinkRow], near: Real, drive: Real, turning: Real, stages: Real) -> None:
    """Everything that follows from the plane STATE: its rates in SLOPE, and the links as they move; see `flexible_rates`.

    Args:
        joints: `JOINT` array.
        links: `LINK` array.
        near: Room for grid points.
        drive: Torque commands and brakes.
        turning: Room for the links' joints.
        stages: States and rates.
    """
    for i in range(len(joints)):
        _to_grid(joints[i], near, i, stages[STATE, i, 0], stages[STATE, i, 2])
    flexible_rates(joints, links, near, drive, turning, stages, STATE)
