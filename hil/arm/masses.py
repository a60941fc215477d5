"""Mass matrix and levers of an arm."""

import math
from collections.abc import Iterator

import numpy as np

from hil.arm.bodies import Body
from hil.arm.kinematics import Kinematics, LinkFrame
from hil.arm.tables import ArmTable
from hil.control.arrays import Real

LEAST_FREE = 1e-9
"""Inertia of a joint with those behind it free, over that with those behind it held: below it nothing is left that it turns."""


def mass_matrix(arm: ArmTable, joints_rad: Real) -> Real:
    """Return the mass matrix in kg·m²; shape (n_links, n_links).

    H(q) = Σ m J_vᵀ J_v + J_ωᵀ I J_ω over all bodies, joints from the base on. Joint angles q have the shape (n_links,).
    """
    kinematics = Kinematics.of(arm)
    total = np.zeros((kinematics.count, kinematics.count))
    for body, centre in _centres(arm):
        linear, about = np.split(kinematics.jacobian(joints_rad, centre), 2)
        _, frame = kinematics.pose(joints_rad, centre)
        inertia = frame @ body.inertia_kg_m2.tensor() @ frame.T
        total += body.mass_kg * linear.T @ linear + about.T @ inertia @ about
    return total


def levers(arm: ArmTable, joints_rad: Real) -> Real:
    """Return the tip's distance from each joint's axis in m; shape (n_links,)."""
    return np.asarray(np.linalg.norm(Kinematics.of(arm).jacobian(joints_rad)[:3], axis=0))


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


def _centres(arm: ArmTable) -> Iterator[tuple[Body, LinkFrame]]:
    """Yield each link's body and its centre of mass, with the link's axes."""
    for link, body in enumerate(arm.bodies(), 1):
        yield body, LinkFrame(link, np.array(body.centre_m), np.eye(3))
