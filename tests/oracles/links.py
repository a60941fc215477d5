"""What an arm's bodies weigh and hold, for tests: torques of gravity, and the numbers of the mass matrix's regressor."""

import numpy as np

from hil.arm.kinematics import Kinematics, LinkFrame
from hil.arm.tables import ArmTable


def gravity_torques(arm: ArmTable, joints_rad: np.ndarray) -> np.ndarray:
    """Torques in N·m that hold the arm against gravity; shape (n_links,)."""
    kinematics = Kinematics.of(arm)
    total = np.zeros(kinematics.count)
    for link, body in enumerate(arm.bodies(), 1):
        centre = LinkFrame(link, np.array(body.centre_m), np.eye(3))
        total -= body.mass_kg * kinematics.jacobian(joints_rad, centre)[:3].T @ np.array(arm.gravity_m_s2)
    return total


def link_masses(arm: ArmTable) -> np.ndarray:
    """θ of an arm whose links have bodies, as `hil.arm.regressor` has it; shape (10 n,)."""
    numbers = []
    for body in arm.bodies():
        centre = np.array(body.centre_m)
        about = body.inertia_kg_m2.tensor() + body.mass_kg * (float(centre @ centre) * np.eye(3) - np.outer(centre, centre))
        pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        numbers += [body.mass_kg, *(body.mass_kg * centre), *(about[a, b] for a, b in pairs)]
    return np.array(numbers, dtype=np.float64)
