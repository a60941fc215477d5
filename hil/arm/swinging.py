"""Frequencies and shapes of an arm's modes, with all motors held.

    H(q) v̈ + K v = 0:  K^{−1/2} H K^{−1/2} w = ω^{−2} w,  v = K^{−1/2} w

Small deflections about a posture; damping, friction and the gears' hysteresis are left out.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hil.arm.kinematics import Kinematics
from hil.arm.masses import mass_matrix
from hil.arm.tables import ArmTable
from hil.control.arrays import Real


@dataclass(frozen=True)
class ModeShape:
    """One mode of an arm in a posture.

    The motion of the tip has the length 1; if the tip does not move, the largest turn of a joint is 1.

    Attributes:
        frequency_hz: Its frequency, all motors held.
        joints_rad: Deflection of each joint, from the base on; shape (n_links,).
        tip_m: Motion of the tip that belongs to it, in the frame of the base; shape (3,).
    """

    frequency_hz: float
    joints_rad: Real
    tip_m: Real


def mode_shapes(
    arm: ArmTable, joints_rad: Real, stiffness_nm_rad: Mapping[int, float], matrix_kg_m2: Real | None = None
) -> list[ModeShape]:
    """Modes of an arm, the lowest first.

    Args:
        joints_rad: Joint angles; shape (n_links,).
        stiffness_nm_rad: Stiffness of the gears by axis, at the joint; joints of other axes count as rigid.
        matrix_kg_m2: Mass matrix in that posture, shape (n_links, n_links); None for that of the links' bodies.

    Raises:
        ValueError: A stiffness is not above 0, or none of the arm's axes has one.
    """
    soft = [joint for joint, axis in enumerate(arm.axes) if axis in stiffness_nm_rad]
    if not soft or min(stiffness_nm_rad[arm.axes[joint]] for joint in soft) <= 0.0:
        raise ValueError(f"modes of an arm need the stiffness of at least one gear, above 0: {dict(stiffness_nm_rad)}")
    inverse_root = 1.0 / np.sqrt([stiffness_nm_rad[arm.axes[joint]] for joint in soft])
    matrix = mass_matrix(arm, joints_rad) if matrix_kg_m2 is None else matrix_kg_m2
    scaled = inverse_root[:, np.newaxis] * matrix[np.ix_(soft, soft)] * inverse_root
    values, vectors = np.linalg.eigh(scaled)
    lever = Kinematics.of(arm).jacobian(joints_rad)[:3]
    shapes = []
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        if value <= 0.0:  # it turns no mass: no frequency
            continue
        deflection = np.zeros(len(arm.axes))
        deflection[soft] = inverse_root * vector
        tip = lever @ deflection
        length = float(np.linalg.norm(tip))
        scale = 1.0 / (length if length > 1e-9 * float(np.max(np.abs(deflection))) else float(np.max(np.abs(deflection))))
        shapes.append(ModeShape(1.0 / (2.0 * math.pi * math.sqrt(float(value))), scale * deflection, scale * tip))
    return shapes
