"""Accelerations of an arm of rigid links under the torques of its joints: the articulated-body algorithm.

All vectors are spatial ones in the frame of the base, at its origin: the angular part first, then the linear one. So no matrix is
carried from link to link, and inertias add up as they are. Each link's frame is turned so that its joint is the z axis.

Source: R. Featherstone, Rigid Body Dynamics Algorithms, Springer 2008, chapters 2 and 7.
"""

import math
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.arm.rotation import turned
from hil.arm.tables import ArmTable
from hil.control.compiled import compiled, inlined
from hil.control.records import Rows, record_dtype

Real = NDArray[np.float64]


class LinkRow(Protocol):
    """A link: constants, then where it is and what acts on it as the last evaluation left it. Row 0 of an array is the base.

    - `row`: row of the link's axis among the axes of a robot.
    - `home_rad`: the joint's angle where the axis' arm angle is 0.
    - `turn`, `origin`: rotation and origin of the joint in the link before it, at an angle of 0.
    - `centre`, `inertia`: centre of mass, and inertia about it, in the link's frame.
    - `screw`: velocity of the link per rad/s of its joint; `drift`: the acceleration that velocities make.
    - `body`, `force`: inertia and bias force of the link with all that it carries.
    - `carried`: U = body · screw, `about`: D = screw · U, `rest`: u, the torque that is left to accelerate the joint.
    """

    row: int
    home_rad: float
    turn: Annotated[Real, (3, 3)]
    origin: Annotated[Real, (3,)]
    mass_kg: float
    centre: Annotated[Real, (3,)]
    inertia: Annotated[Real, (3, 3)]
    frame: Annotated[Real, (3, 3)]
    position: Annotated[Real, (3,)]
    screw: Annotated[Real, (6,)]
    velocity: Annotated[Real, (6,)]
    drift: Annotated[Real, (6,)]
    body: Annotated[Real, (6, 6)]
    force: Annotated[Real, (6,)]
    carried: Annotated[Real, (6,)]
    about: float
    rest: float
    acceleration: Annotated[Real, (6,)]


LINK = record_dtype(LinkRow)


def link_rows(arm: ArmTable, axes: tuple[int, ...]) -> NDArray[np.void]:
    """`LINK` array of an arm, shape (n_links + 1,); row 0 is the base, which falls upwards: so gravity acts on every link.

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
    return turned(axis / sine, math.atan2(sine, float(direction[2])))


@inlined
def _locate(before: LinkRow, link: LinkRow, angle: float) -> None:
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


@inlined
def _move(before: LinkRow, link: LinkRow, speed: float) -> None:
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


@inlined
def _weigh(link: LinkRow) -> None:
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


@inlined
def _hand_on(before: LinkRow, link: LinkRow, torque: float, is_on_base: bool) -> None:
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


@inlined
def _accelerate(before: LinkRow, link: LinkRow) -> float:
    """Acceleration of a link; that of its joint."""
    rest = link.rest
    for r in range(6):
        link.acceleration[r] = before.acceleration[r] + link.drift[r]
        rest -= link.carried[r] * link.acceleration[r]
    turning = rest / link.about
    for r in range(6):
        link.acceleration[r] += link.screw[r] * turning
    return turning


@compiled
def accelerations(links: Rows[LinkRow], joints: Real) -> None:
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


@compiled
def holding_torques(links: Rows[LinkRow], joints: Real) -> None:
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
