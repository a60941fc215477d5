"""Mass matrix, torques of gravity and levers of an arm."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hil.arm.rotation import turned
from hil.arm.tables import ArmTable

Real = NDArray[np.float64]

LEAST_FREE = 1e-9
"""Inertia of a joint with those behind it free, over that with those behind it held: below it nothing is left that it turns."""


def mass_matrix(arm: ArmTable, joints_rad: Real) -> Real:
    """Return the mass matrix in kg·m²; shape (n_links, n_links).

    H(q) = Σ m J_vᵀ J_v + J_ωᵀ I J_ω over all bodies, joints from the base on.

    Args:
        arm: The arm.
        joints_rad: Joint angles q; shape (n_links,).
    """
    located = list(_frames(arm, joints_rad))
    total = np.zeros((len(located), len(located)))
    for count, (body, (frame, origin, _)) in enumerate(zip(arm.bodies(), located, strict=True), 1):
        about, linear = _jacobian(located[:count], origin + frame @ np.array(body.centre_m))
        inertia = frame @ body.inertia_kg_m2.tensor() @ frame.T
        total[:count, :count] += body.mass_kg * linear.T @ linear + about.T @ inertia @ about
    return total


def gravity_torques(arm: ArmTable, joints_rad: Real) -> Real:
    """Torques in N·m that hold the arm against gravity; shape (n_links,).

    Args:
        arm: The arm.
        joints_rad: Joint angles q; shape (n_links,).
    """
    located = list(_frames(arm, joints_rad))
    total = np.zeros(len(located))
    for count, (body, (frame, origin, _)) in enumerate(zip(arm.bodies(), located, strict=True), 1):
        _, linear = _jacobian(located[:count], origin + frame @ np.array(body.centre_m))
        total[:count] -= body.mass_kg * linear.T @ np.array(arm.gravity_m_s2)
    return total


def levers(arm: ArmTable, joints_rad: Real) -> Real:
    """Return the tip's distance from each joint's axis in m; shape (n_links,)."""
    located = list(_frames(arm, joints_rad))
    frame, origin, _ = located[-1]
    _, linear = _jacobian(located, origin + frame @ np.array(arm.tip_m))
    return np.asarray(np.linalg.norm(linear, axis=0))


def check_masses(arm: ArmTable) -> None:
    """Refuse an arm on which a joint turns no mass.

    Its motion would not be determined.

    Raises:
        ValueError: With the link.
    """
    bodies = arm.bodies()
    heavy = [number for number, body in enumerate(bodies) if body.mass_kg > 0.0]
    last = heavy[-1] if heavy else -1
    if last + 1 < len(bodies):
        raise ValueError(f"{arm.link[last + 1].label} turns no mass; give a body to it, to a link after it, or to the payload")
    matrix = mass_matrix(arm, arm.home_rad())
    size_m = sum(math.hypot(*link.origin_m) for link in arm.link) + max(math.hypot(*body.centre_m) for body in bodies)
    nothing = LEAST_FREE**2 * sum(body.mass_kg for body in bodies) * size_m**2
    for count, link in enumerate(arm.link, 1):
        # inertia that a joint feels while those behind it are free: the last of the arm's own, and no motion without it
        held = matrix[count - 1 :, count - 1 :]
        with_it, behind = float(np.linalg.det(_scaled(held))), float(np.linalg.det(_scaled(held[1:, 1:])))
        if matrix[count - 1, count - 1] <= nothing or with_it < LEAST_FREE * behind:
            raise ValueError(
                f"{link.label} turns nothing at home: all mass lies on its axis, or another joint makes the same motion"
            )


def _scaled(matrix: Real) -> Real:
    """Scale a mass matrix to a diagonal of 1.

    Its determinant then tells how nearly the joints move the same masses in the same way.
    """
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.asarray(matrix / np.outer(size, size))


def _frames(arm: ArmTable, joints_rad: Real) -> Iterator[tuple[Real, Real, Real]]:
    """Yield each link's rotation, origin and joint axis in the base frame."""
    frame, origin = np.eye(3), np.zeros(3)
    for link, angle in zip(arm.link, np.asarray(joints_rad).tolist(), strict=True):
        direction = link.unit_direction()
        origin = origin + frame @ np.array(link.origin_m)
        frame = frame @ link.rotation() @ turned(direction, angle)
        yield frame, origin, frame @ direction


def _jacobian(located: list[tuple[Real, Real, Real]], point: Real) -> tuple[Real, Real]:
    """Return angular and linear velocity of a point per joint speed.

    Per rad/s of each joint; shape (3, n) each.
    """
    about = np.array([axis for _, _, axis in located]).T
    linear = np.array([np.cross(axis, point - origin) for _, origin, axis in located]).T
    return about, linear
