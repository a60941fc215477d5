"""Accelerometer on an arm: mounting, and acceleration from its signals.

A sensor that is fixed to a link turns with it, and measures the specific force f = R_sᵀ (a − g): zero in free fall, −g at rest.
So a = R_s f + g in the base frame, with R_s from the joint angles. An axis moves the sensor by its lever ℓ = z × (p_s − p).
Length and direction of the lever along the sensor's axes remain constant as long as this axis alone turns.
"""

import math

import numpy as np

from drive_profiles.files.toml import Table
from hil.arm.bodies import NOWHERE, Vector
from hil.arm.kinematics import Kinematics, LinkFrame
from hil.arm.rotation import rotation
from hil.arm.tables import ArmTable
from hil.control.arrays import Real
from hil.robot_tables import AxisNumber


class Mounting(Table):
    """Place and orientation of an accelerometer on an arm.

    Attributes:
        axis: Number of the axis whose link carries it; left out, the last.
        origin_m: Its origin in the frame of this link.
        rpy_deg: Roll, pitch and yaw of its axes in the same frame.
        misalignment_deg: Rotation of its own axes against those, from gluing and manufacture.
        gravity: True if it measures gravity, as a sensor with a response down to 0 Hz does.
    """

    axis: AxisNumber | None = None
    origin_m: Vector = NOWHERE
    rpy_deg: Vector = NOWHERE
    misalignment_deg: Vector = NOWHERE
    gravity: bool = True

    def check_arm(self, arm: ArmTable) -> None:
        """Refuse a mounting on a link that is not there.

        Raises:
            ValueError: The arm has no such axis.
        """
        if self.axis is not None and self.axis not in arm.axes:
            raise ValueError(f"the accelerometer sits on axis {self.axis}; the arm has axes {', '.join(map(str, arm.axes))}")

    def frame(self, arm: ArmTable) -> LinkFrame:
        """The sensor's place and axes on its link."""
        link = len(arm.link) if self.axis is None else arm.axes.index(self.axis) + 1
        turned = rotation(*map(math.radians, self.rpy_deg)) @ rotation(*map(math.radians, self.misalignment_deg))
        return LinkFrame(link, np.array(self.origin_m), turned)


def in_base(arm: Kinematics, of: LinkFrame, angles: Real, sensed_m_s2: Real, gravity_m_s2: Real) -> Real:
    """Return a sensor's acceleration in the base frame, R_s f + g.

    Joint angles have the shape (n, joints), the signals f along the sensor's own axes (n, 3), free fall (3,): zeros for a
    sensor that does not measure gravity.
    """
    _, frames = arm.pose(angles, of)
    return np.asarray((frames @ sensed_m_s2[..., np.newaxis])[..., 0] + gravity_m_s2)


def along_lever(arm: Kinematics, of: LinkFrame, angles: Real, joint: int, acceleration_m_s2: Real) -> Real:
    """Return a point's acceleration along the direction of one joint's motion.

    Zero if the joint does not move the point. Joint angles have the shape (n, joints), the point's acceleration in the base
    frame (n, 3); joints count from the base on.
    """
    lever = arm.jacobian(angles, of)[..., :3, joint]
    length = np.linalg.norm(lever, axis=-1)
    return np.asarray(np.sum(lever * acceleration_m_s2, axis=-1) / np.where(length > 0.0, length, 1.0))
