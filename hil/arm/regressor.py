"""Regressor of an arm's mass matrix: H(q) = Y(q) θ.

The mass matrix is linear in the masses θ. θ has ten numbers per link, in the link's own frame: mass m, first moment m c, and
the inertia about the frame's origin. Some of these numbers move no joint, or act on H only in combination with others;
`hil.design.coupled.masses` finds the combinations that H determines.
"""

import math

import numpy as np

from hil.arm.kinematics import Kinematics
from hil.control.arrays import Real

PER_LINK = 10
"""Numbers of a link: m; m c_x, m c_y, m c_z; I_xx, I_yy, I_zz, I_xy, I_xz, I_yz about the origin of its frame."""
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))

ROD_KG_M = 20.0
"""Mass of a rod per length, of which a made-up arm consists."""
ROD_RADIUS_M = 0.06
END_KG = 5.0
"""Mass at the tip of a made-up arm."""


def regressor(arm: Kinematics, joints_rad: Real) -> Real:
    """Return Y(q); shape (..., n, n, 10 n)."""
    rotations, origins = arm.links(joints_rad)
    lead, n = origins.shape[:-2], arm.count
    directions = np.einsum("...ijk,ik->...ij", rotations, arm.axes)
    found = np.zeros((*lead, n, n, PER_LINK * n))
    for i in range(n):
        own, moving = rotations[..., i, :, :], slice(0, i + 1)
        linear = np.cross(directions[..., moving, :], origins[..., i : i + 1, :] - origins[..., moving, :])
        # rows of joints, in the link's own axes
        v, w = linear @ own, directions[..., moving, :] @ own
        begin = PER_LINK * i
        found[..., moving, moving, begin] = v @ np.swapaxes(v, -1, -2)
        across = np.cross(v[..., :, np.newaxis, :], w[..., np.newaxis, :, :])
        found[..., moving, moving, begin + 1 : begin + 4] = across + np.swapaxes(across, -2, -3)
        for column, (a, b) in enumerate(_PAIRS, begin + 4):
            product = w[..., :, np.newaxis, a] * w[..., np.newaxis, :, b]
            found[..., moving, moving, column] = product if a == b else product + np.swapaxes(product, -1, -2)
    return found


def made_up_masses(arm: Kinematics) -> Real:
    """Return θ of rods with a load at the tip.

    The rods go from joint to joint. A starting value; shape (10 n,).
    """
    numbers = []
    for i in range(arm.count):
        is_last = i + 1 == arm.count
        along = arm.tip.origin_m if is_last else arm.origins_m[i + 1]
        length = float(np.linalg.norm(along))
        mass = ROD_KG_M * length + 1.0
        about = mass / 3.0 * (length**2 * np.eye(3) - np.outer(along, along)) + mass * ROD_RADIUS_M**2 * np.eye(3)
        moment = 0.5 * mass * along
        if is_last:
            about = about + END_KG * (length**2 * np.eye(3) - np.outer(along, along)) + END_KG * ROD_RADIUS_M**2 * np.eye(3)
            mass, moment = mass + END_KG, moment + END_KG * along
        numbers += [mass, *moment, *(about[a, b] for a, b in _PAIRS)]
    return np.array(numbers, dtype=np.float64)


def workspace(low_rad: Real, high_rad: Real, count: int) -> Real:
    """Postures spread over ranges of the joints; shape (count, n).

    Shapes (n,); an angle that is to stay has equal ends, a joint without end a full turn.
    """
    low = np.where(np.isfinite(low_rad), low_rad, -math.pi)
    high = np.where(np.isfinite(high_rad), high_rad, math.pi)
    return np.asarray(low + np.random.default_rng(1).random((count, len(low))) * (high - low))
