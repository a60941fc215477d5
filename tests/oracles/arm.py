"""An arm on elastic joints in plain Python: what the core in C has to compute."""

import math
from typing import Any

from tests.oracles.plant import AxisState, rates

STATES = len(AxisState._fields)
STATE, POINT, SLOPE, SUM = range(4)


def _locate(before: Any, link: Any, angle: float) -> None:
    """Frame, position and screw of a link from those of the one before."""
    cos, sin = math.cos(angle), math.sin(angle)
    for r in range(3):
        b0, b1, b2 = before.frame[r, 0], before.frame[r, 1], before.frame[r, 2]
        x = b0 * link.turn[0, 0] + b1 * link.turn[1, 0] + b2 * link.turn[2, 0]
        y = b0 * link.turn[0, 1] + b1 * link.turn[1, 1] + b2 * link.turn[2, 1]
        link.frame[r, 0] = cos * x + sin * y
        link.frame[r, 1] = cos * y - sin * x
        link.frame[r, 2] = b0 * link.turn[0, 2] + b1 * link.turn[1, 2] + b2 * link.turn[2, 2]
        link.position[r] = before.position[r] + (b0 * link.origin[0] + b1 * link.origin[1] + b2 * link.origin[2])
    ax, ay, az = link.frame[0, 2], link.frame[1, 2], link.frame[2, 2]
    px, py, pz = link.position[0], link.position[1], link.position[2]
    link.screw[0], link.screw[1], link.screw[2] = ax, ay, az
    link.screw[3], link.screw[4], link.screw[5] = py * az - pz * ay, pz * ax - px * az, px * ay - py * ax


def _move(before: Any, link: Any, speed: float) -> None:
    """Velocity of a link, and the acceleration v_before × (screw q̇) that it has without any of its joint's."""
    wx, wy, wz = before.velocity[0], before.velocity[1], before.velocity[2]
    vx, vy, vz = before.velocity[3], before.velocity[4], before.velocity[5]
    ax, ay, az = link.screw[0] * speed, link.screw[1] * speed, link.screw[2] * speed
    bx, by, bz = link.screw[3] * speed, link.screw[4] * speed, link.screw[5] * speed
    link.velocity[0], link.velocity[1], link.velocity[2] = wx + ax, wy + ay, wz + az
    link.velocity[3], link.velocity[4], link.velocity[5] = vx + bx, vy + by, vz + bz
    link.drift[0], link.drift[1], link.drift[2] = wy * az - wz * ay, wz * ax - wx * az, wx * ay - wy * ax
    link.drift[3] = (wy * bz - wz * by) + (vy * az - vz * ay)
    link.drift[4] = (wz * bx - wx * bz) + (vz * ax - vx * az)
    link.drift[5] = (wx * by - wy * bx) + (vx * ay - vy * ax)


def _weigh(link: Any) -> None:
    """Inertia of a link alone, and its bias force v ×* (body v)."""
    m = link.mass_kg
    c0, c1, c2 = link.centre[0], link.centre[1], link.centre[2]
    x = link.position[0] + (link.frame[0, 0] * c0 + link.frame[0, 1] * c1 + link.frame[0, 2] * c2)
    y = link.position[1] + (link.frame[1, 0] * c0 + link.frame[1, 1] * c1 + link.frame[1, 2] * c2)
    z = link.position[2] + (link.frame[2, 0] * c0 + link.frame[2, 1] * c1 + link.frame[2, 2] * c2)
    body = link.body
    for r in range(3):
        f0, f1, f2 = link.frame[r, 0], link.frame[r, 1], link.frame[r, 2]
        t0 = f0 * link.inertia[0, 0] + f1 * link.inertia[1, 0] + f2 * link.inertia[2, 0]
        t1 = f0 * link.inertia[0, 1] + f1 * link.inertia[1, 1] + f2 * link.inertia[2, 1]
        t2 = f0 * link.inertia[0, 2] + f1 * link.inertia[1, 2] + f2 * link.inertia[2, 2]
        for k in range(3):
            body[r, k] = t0 * link.frame[k, 0] + t1 * link.frame[k, 1] + t2 * link.frame[k, 2]
            body[3 + r, 3 + k] = 0.0
            body[r, 3 + k] = 0.0
    mx, my, mz = m * x, m * y, m * z
    body[0, 0] += my * y + mz * z
    body[1, 1] += mx * x + mz * z
    body[2, 2] += mx * x + my * y
    body[0, 1] -= mx * y
    body[0, 2] -= mx * z
    body[1, 2] -= my * z
    body[1, 0], body[2, 0], body[2, 1] = body[0, 1], body[0, 2], body[1, 2]
    body[0, 4], body[0, 5], body[1, 3], body[1, 5], body[2, 3], body[2, 4] = -mz, my, mz, -mx, -my, mx
    for r in range(3):
        body[3 + r, 3 + r] = m
        for k in range(3):
            body[3 + r, k] = body[k, 3 + r]
    wx, wy, wz = link.velocity[0], link.velocity[1], link.velocity[2]
    vx, vy, vz = link.velocity[3], link.velocity[4], link.velocity[5]
    fx, fy, fz = m * vx + (wy * mz - wz * my), m * vy + (wz * mx - wx * mz), m * vz + (wx * my - wy * mx)
    nx = body[0, 0] * wx + body[0, 1] * wy + body[0, 2] * wz + (my * vz - mz * vy)
    ny = body[1, 0] * wx + body[1, 1] * wy + body[1, 2] * wz + (mz * vx - mx * vz)
    nz = body[2, 0] * wx + body[2, 1] * wy + body[2, 2] * wz + (mx * vy - my * vx)
    link.force[0] = (wy * nz - wz * ny) + (vy * fz - vz * fy)
    link.force[1] = (wz * nx - wx * nz) + (vz * fx - vx * fz)
    link.force[2] = (wx * ny - wy * nx) + (vx * fy - vy * fx)
    link.force[3], link.force[4], link.force[5] = wy * fz - wz * fy, wz * fx - wx * fz, wx * fy - wy * fx


def _hand_on(before: Any, link: Any, torque: float, is_on_base: bool) -> None:
    """Add to the link before what it feels of this one: what its joint, free to turn, does not take up."""
    body, screw, carried, force, drift = link.body, link.screw, link.carried, link.force, link.drift
    about, rest = 0.0, torque
    for r in range(6):
        u = 0.0
        for k in range(6):
            u += body[r, k] * screw[k]
        carried[r] = u
        about += screw[r] * u
        rest -= screw[r] * force[r]
    link.about, link.rest = about, rest
    if is_on_base:
        return
    per_about = 1.0 / about
    ahead = rest * per_about
    for r in range(6):
        scaled = carried[r] * per_about
        felt = force[r] + carried[r] * ahead
        for k in range(6):
            element = body[r, k] - scaled * carried[k]
            before.body[r, k] += element
            felt += element * drift[k]
        before.force[r] += felt


def _accelerate(before: Any, link: Any) -> float:
    """Acceleration of a link; that of its joint."""
    rest = link.rest
    for r in range(6):
        link.acceleration[r] = before.acceleration[r] + link.drift[r]
        rest -= link.carried[r] * link.acceleration[r]
    turning = rest / link.about
    for r in range(6):
        link.acceleration[r] += link.screw[r] * turning
    return turning


def accelerations(links: Any, joints: Any) -> None:
    """Accelerations of an arm's joints under their torques.

    Args:
        links: `LINK` array; what belongs to one evaluation is written.
        joints: Angles q in rad, speeds q̇, torques in N·m, and q̈, which is written; from the base on, shape (4, n_links).
    """
    count = len(links) - 1
    for i in range(count):
        _locate(links[i], links[i + 1], joints[0, i])
        _move(links[i], links[i + 1], joints[1, i])
        _weigh(links[i + 1])
    for i in range(count - 1, -1, -1):
        _hand_on(links[i], links[i + 1], joints[2, i], i == 0)
    for i in range(count):
        joints[3, i] = _accelerate(links[i], links[i + 1])


def holding_torques(links: Any, joints: Any) -> None:
    """Torques that hold an arm at rest against gravity.

    Args:
        links: `LINK` array; what belongs to one evaluation is written.
        joints: As of `accelerations`: the angles are read, the torques written.
    """
    count = len(links) - 1
    for i in range(count):
        _locate(links[i], links[i + 1], joints[0, i])
    gx, gy, gz = links[0].acceleration[3], links[0].acceleration[4], links[0].acceleration[5]  # upwards
    fx, fy, fz, nx, ny, nz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(count, 0, -1):
        link = links[i]
        m, c0, c1, c2 = link.mass_kg, link.centre[0], link.centre[1], link.centre[2]
        x = link.position[0] + (link.frame[0, 0] * c0 + link.frame[0, 1] * c1 + link.frame[0, 2] * c2)
        y = link.position[1] + (link.frame[1, 0] * c0 + link.frame[1, 1] * c1 + link.frame[1, 2] * c2)
        z = link.position[2] + (link.frame[2, 0] * c0 + link.frame[2, 1] * c1 + link.frame[2, 2] * c2)
        fx, fy, fz = fx + m * gx, fy + m * gy, fz + m * gz
        nx, ny, nz = nx + m * (y * gz - z * gy), ny + m * (z * gx - x * gz), nz + m * (x * gy - y * gx)
        turning = link.screw[0] * nx + link.screw[1] * ny + link.screw[2] * nz
        joints[2, i - 1] = turning + (link.screw[3] * fx + link.screw[4] * fy + link.screw[5] * fz)


def tool_motion(links: Any, number: int, tool: Any, moved: Any) -> None:
    """Position, velocity and acceleration of the tip in the frame of the base, and its specific force a − g in that of the tool.

    Args:
        links: `LINK` array as `accelerations` has left it.
        number: Any of the link that carries the tool.
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


def feel(links: Any, sensor: Any, tip: Any, room: Any, felt: Any) -> None:
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


def _begin(joints: Any, drive: Any, stages: Any) -> None:
    """Stop the motors behind a closed brake; where the current follows at once, the torque is the command."""
    for i in range(len(joints)):
        if drive[1, i] > 0.0:
            stages[STATE, i, 1], stages[STATE, i, 5] = 0.0, 0.0
        elif joints[i].current_time_constant <= 0.0:
            stages[STATE, i, 5] = drive[0, i]


def _weighted(stages: Any, to: int, first: int, second: int, weight: float) -> None:
    """Plane `to` = plane `first` + weight · plane `second`."""
    for i in range(stages.shape[1]):
        for k in range(STATES):
            stages[to, i, k] = stages[first, i, k] + weight * stages[second, i, k]


def flexible_rates(joints: Any, links: Any, near: Any, drive: Any, turning: Any, stages: Any, plane: int, part: float) -> None:
    """The rates of all states of an arm.

    Args:
        joints: `JOINT` array, from the base on; shape (n,).
        links: `LINK` array; shape (n + 1,), what belongs to one evaluation is written.
        near: Their grid points, which move along.
        drive: Torque commands in N·m, and 1 where the brake holds the motor; shape (2, n).
        turning: Angles, speeds, torques and accelerations of the links' joints, written; shape (4, n).
        stages: States, and their rates, which are written to the plane SLOPE; shape (4, n, STATES).
        plane: The plane that has the states: STATE or POINT.
        part: As of `rates`.
    """
    for i in range(len(joints)):
        x = stages[plane, i]
        at = AxisState(x[0], x[1], x[2], x[3], x[4], x[5])
        motor, torque, hysteresis, current = rates(joints[i], near[i], drive[0, i], drive[1, i] > 0.0, at, part)
        slope = stages[SLOPE, i]
        slope[0], slope[1], slope[2], slope[4], slope[5] = x[1], motor, x[3], hysteresis, current
        turning[0, i], turning[1, i], turning[2, i] = links[i + 1].home_rad + x[2], x[3], torque
    accelerations(links, turning)
    for i in range(len(joints)):
        stages[SLOPE, i, 3] = turning[3, i]


def flexible_period(
    joints: Any,
    links: Any,
    near: Any,
    drive: Any,
    turning: Any,
    stages: Any,
    period_s: float,
    substeps: int,
) -> None:
    """One control period of an arm under constant torque commands: classical Runge-Kutta, fixed sub-steps.

    Args:
        joints: `JOINT` array, from the base on; shape (n,).
        links: `LINK` array; shape (n + 1,), what belongs to one evaluation is written.
        near: Their grid points, which move along.
        drive: Torque commands in N·m, and 1 where the brake holds the motor; shape (2, n).
        turning: Room for angles, speeds, torques and accelerations of the links' joints; shape (4, n).
        stages: The plane STATE has the state and is changed, the others are room; shape (4, n, STATES).
        period_s: The control period.
        substeps: Runge-Kutta steps per period.
    """
    h = period_s / substeps
    _begin(joints, drive, stages)
    for _ in range(substeps):
        _weighted(stages, SUM, SUM, SUM, -1.0)
        _weighted(stages, POINT, STATE, STATE, 0.0)
        for stage in range(4):
            flexible_rates(joints, links, near, drive, turning, stages, POINT, 0.5 if stage == 0 else 1.0)
            _weighted(stages, SUM, SUM, SLOPE, 2.0 if stage in (1, 2) else 1.0)
            _weighted(stages, POINT, STATE, SLOPE, h if stage == 2 else 0.5 * h)
        _weighted(stages, STATE, STATE, SUM, h / 6.0)


def flexible_rest(joints: Any, links: Any, near: Any, drive: Any, turning: Any, stages: Any) -> None:
    """Everything that follows from the plane STATE: its rates in SLOPE, and the links as they move; see `flexible_rates`.

    Args:
        joints: `JOINT` array.
        links: `LINK` array.
        near: Their grid points.
        drive: Torque commands and brakes.
        turning: Room for the links' joints.
        stages: States and rates.
    """
    flexible_rates(joints, links, near, drive, turning, stages, STATE, 0.5)
