"""Rotation matrices: from roll, pitch and yaw, and about an axis."""

import math

import numpy as np

from hil.control.arrays import Real

_GIMBAL = 1e-9
"""Cosine of a pitch below which roll and yaw turn about one axis, and only their sum can be told."""


def turn(axis: Real, angle_rad: Real | float) -> Real:
    """Return the rotation by an angle about an axis of length 1.

    1 + sin q [a]× + (1 − cos q) [a]×²; angles of shape (...) give (..., 3, 3).
    """
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.asarray(angle_rad, dtype=np.float64)[..., np.newaxis, np.newaxis]
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross))


def rotation(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Real:
    """Return R = R_z(yaw) R_y(pitch) R_x(roll); shape (3, 3).

    Turns about fixed axes, roll first, as in URDF.
    """
    cr, sr, cp, sp = math.cos(roll_rad), math.sin(roll_rad), math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def roll_pitch_yaw(matrix: Real) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a rotation in rad.

    They are the inverse of `rotation`; at a pitch of ±90° the roll is 0.
    """
    flat = math.hypot(matrix[0, 0], matrix[1, 0])
    pitch = math.atan2(-matrix[2, 0], flat)
    if flat < _GIMBAL:
        return 0.0, pitch, math.atan2(-matrix[0, 1], matrix[1, 1])
    return math.atan2(matrix[2, 1], matrix[2, 2]), pitch, math.atan2(matrix[1, 0], matrix[0, 0])
