"""Kinematics of an arm with revolute joints in a row.

Any number of axes in any directions. The frame of a joint has a constant place and rotation in the frame before it, and turns
about the joint's axis by the joint angle: R_i = R_{i−1} Q_i exp(q_i [a_i]×), p_i = p_{i−1} + R_{i−1} r_i, as a URDF describes it.

    J_i = (z_i × (p − p_i); z_i),  z_i = R_i a_i          geometric Jacobian of a point p, in the base frame
    Δq = Jᵀ (J Jᵀ + λ² 1)⁻¹ e,    λ² = ½ eᵀe + λ_0²      damped least squares, from a pose to joint angles

Source: Sugihara, Solvability-unconcerned inverse kinematics by the Levenberg–Marquardt method, IEEE T-RO 27 (2011), for λ.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hil.arm.rotation import rotation, turn
from hil.arm.tables import ArmTable
from hil.control.arrays import Real

REGULAR_DAMPING = 1e-12
"""λ_0² of damped least squares, positions in units of the arm's length."""
ROUNDS = 60
"""Rounds of damped least squares unless more are asked for: near a singular posture they halve the error, elsewhere square it."""
STILL_RAD = 1e-14
"""Step of the joints from which another round changes nothing."""
PROBES = 16
"""Postures among which the rank of the Jacobian is looked for that an arm can have at all."""
RANK_FRACTION = 1e-6
"""Singular value over the largest from which it counts as none in such a posture."""


@dataclass(frozen=True)
class LinkFrame:
    """Point on a link, with a frame of its own.

    Attributes:
        link: Number of joints that move it: 0 for the base, the number of all joints for the last link.
        origin_m: Its place in the link's frame; shape (3,).
        frame: Its axes in the link's frame, as columns; shape (3, 3).
    """

    link: int
    origin_m: Real
    frame: Real


@dataclass(frozen=True)
class Kinematics:
    """Joints in a row, from the base on.

    Attributes:
        origins_m: Origin of each joint's frame in the frame before it; shape (n, 3).
        frames: Axes of each joint's frame in the frame before it at angle 0, as columns; shape (n, 3, 3).
        axes: Direction of each joint's axis in its own frame, of length 1; shape (n, 3).
    """

    origins_m: Real
    frames: Real
    axes: Real
    tip: LinkFrame

    @classmethod
    def of(cls, arm: ArmTable) -> "Kinematics":
        """The kinematics of an arm's tables, whose URDF file has been read."""
        tool = rotation(*map(math.radians, arm.tip_rpy_deg))
        return cls(
            np.array([link.origin_m for link in arm.link], dtype=np.float64),
            np.stack([link.rotation() for link in arm.link]),
            np.stack([link.unit_direction() for link in arm.link]),
            LinkFrame(len(arm.link), np.array(arm.tip_m, dtype=np.float64), tool),
        )

    @property
    def count(self) -> int:
        """Number of joints."""
        return len(self.axes)

    @cached_property
    def length_m(self) -> float:
        """Bound on the distance from the base to any point, in m.

        Sum of the distances from joint to joint and on to the tip; 1 µm at least.
        """
        return max(1e-6, float(np.sum(np.linalg.norm(self.origins_m, axis=1)) + np.linalg.norm(self.tip.origin_m)))

    def links(self, angles: Real) -> tuple[Real, Real]:
        """Return rotation and origin of each joint's frame after its turn.

        Joint angles are in rad; shape (..., n).

        Returns:
            Shapes (..., n, 3, 3) and (..., n, 3).
        """
        angles = np.asarray(angles, dtype=np.float64)
        lead = angles.shape[:-1]
        rotations, origins = np.empty((*lead, self.count, 3, 3)), np.empty((*lead, self.count, 3))
        rotation, origin = np.broadcast_to(np.eye(3), (*lead, 3, 3)), np.zeros((*lead, 3))
        for i in range(self.count):
            origin = origin + rotation @ self.origins_m[i]
            rotation = rotation @ self.frames[i] @ turn(self.axes[i], angles[..., i])
            rotations[..., i, :, :], origins[..., i, :] = rotation, origin
        return rotations, origins

    def skeleton(self, angles: Real) -> Real:
        """Return the arm as a polyline in the base frame.

        Shape (..., 2 n + 2, 3): the base, each joint and its corner, and the tip. From a joint, a link goes along the
        joint's axis to its corner, and from there straight to the next joint.
        """
        rotations, origins = self.links(angles)
        tip, _ = self._pose(rotations, origins, self.tip)
        directions = np.einsum("...ijk,ik->...ij", rotations, self.axes)
        ahead = np.concatenate([origins[..., 1:, :], tip[..., np.newaxis, :]], axis=-2) - origins
        corners = origins + np.sum(ahead * directions, axis=-1, keepdims=True) * directions
        line = np.stack([origins, corners], axis=-2).reshape(*origins.shape[:-2], 2 * self.count, 3)
        base = np.zeros_like(tip)[..., np.newaxis, :]
        return np.concatenate([base, line, tip[..., np.newaxis, :]], axis=-2)

    def pose(self, angles: Real, of: LinkFrame | None = None) -> tuple[Real, Real]:
        """Return position and axes of a point in the base frame.

        The point is the tip unless another is given; shapes (..., 3) and (..., 3, 3).
        """
        return self._pose(*self.links(angles), self.tip if of is None else of)

    @staticmethod
    def _pose(rotations: Real, origins: Real, of: LinkFrame) -> tuple[Real, Real]:
        if of.link == 0:
            lead = origins.shape[:-2]
            return np.broadcast_to(of.origin_m, (*lead, 3)), np.broadcast_to(of.frame, (*lead, 3, 3))
        rotation, origin = rotations[..., of.link - 1, :, :], origins[..., of.link - 1, :]
        return origin + rotation @ of.origin_m, rotation @ of.frame

    def jacobian(self, angles: Real, of: LinkFrame | None = None) -> Real:
        """Return the geometric Jacobian of a point in the base frame.

        The point is the tip unless another is given.

        Returns:
            Speed of the point (three rows) and turning speed (three rows) by each joint's speed; shape (..., 6, n).
        """
        rotations, origins = self.links(angles)
        return self._jacobian(rotations, origins, self.tip if of is None else of)

    def _jacobian(self, rotations: Real, origins: Real, of: LinkFrame) -> Real:
        point, _ = self._pose(rotations, origins, of)
        directions = np.einsum("...ijk,ik->...ij", rotations, self.axes)
        moved = (np.arange(self.count) < of.link)[:, np.newaxis]
        linear = np.where(moved, np.cross(directions, point[..., np.newaxis, :] - origins), 0.0)
        angular = np.where(moved, directions, 0.0)
        return np.swapaxes(np.concatenate([linear, angular], axis=-1), -1, -2)

    # -- the way back ------------------------------------------------------------------------------------------------------

    def solve(self, near: Real, position_m: Real, frame: Real | None, rounds: int = ROUNDS) -> tuple[Real, Real]:
        """Find joint angles for poses of the tip by damped least squares.

        Args:
            near: Angles to begin with; shape (..., n).
            position_m: Wanted positions of the tip; shape (..., 3).
            frame: Wanted axes of the tip; shape (..., 3, 3); None if they are free.

        Returns:
            The angles, shape (..., n), and the remaining error: in m and, of the axes, in rad, shape (..., 3) or (..., 6).
            If the arm does not reach a pose, the angles are those that come nearest.
        """
        angles = np.array(near, dtype=np.float64)
        found, least = angles, np.full(angles.shape[:-1], math.inf)
        for _ in range(rounds):
            error = self._error(angles, position_m, frame)
            step, scaled = self._step(angles, error)
            size = np.asarray(np.sum(scaled**2, axis=-1))
            is_nearer = size < least
            found, least = np.where(is_nearer[..., np.newaxis], angles, found), np.where(is_nearer, size, least)
            if float(np.max(np.abs(step), initial=0.0)) < STILL_RAD:
                break
            angles = angles + step
        return found, self._error(found, position_m, frame)

    def _step(self, angles: Real, error: Real) -> tuple[Real, Real]:
        """Compute one step of damped least squares, and the scaled error.

        Positions are in units of the arm's length.
        """
        rows = error.shape[-1]
        scale = np.array([1.0 / self.length_m] * 3 + [1.0] * 3)[:rows]
        jacobian = self.jacobian(angles)[..., :rows, :] * scale[:, np.newaxis]
        scaled = error * scale
        damping = (0.5 * np.sum(scaled**2, axis=-1) + REGULAR_DAMPING)[..., np.newaxis, np.newaxis]
        back = np.swapaxes(jacobian, -1, -2)
        if self.count < rows:  # the same by the smaller of both squares
            return np.linalg.solve(back @ jacobian + damping * np.eye(self.count), back @ scaled[..., np.newaxis])[..., 0], scaled
        return (back @ np.linalg.solve(jacobian @ back + damping * np.eye(rows), scaled[..., np.newaxis]))[..., 0], scaled

    def _error(self, angles: Real, position_m: Real, frame: Real | None) -> Real:
        """Return the tip's displacement and turn to the wanted pose."""
        origin, own = self.pose(angles)
        if frame is None:
            return np.asarray(position_m - origin)
        return np.concatenate([position_m - origin, rotation_vector(frame @ np.swapaxes(own, -1, -2))], axis=-1)

    # -- singularities -------------------------------------------------------------------------------------------------------

    def singular_values(self, angles: Real, *, with_frame: bool) -> Real:
        """Return the singular values of the tip's Jacobian; shape (..., m).

        The largest is first; positions are in units of the arm's length.
        """
        rows = 6 if with_frame else 3
        scale = np.array([1.0 / self.length_m] * 3 + [1.0] * 3)[:rows]
        return np.asarray(np.linalg.svd(self.jacobian(angles)[..., :rows, :] * scale[:, np.newaxis], compute_uv=False))

    def rank(self, *, with_frame: bool) -> int:
        """Count the directions in which the arm can move its tip.

        Valid in any posture that is not singular.
        """
        probes = np.arange(1, PROBES + 1)[:, np.newaxis] * np.sqrt(np.array([2.0, 3.0, 5.0, 7.0, 11.0, 13.0] * self.count))
        values = self.singular_values(probes[:, : self.count], with_frame=with_frame)
        return int(np.max(np.count_nonzero(values > RANK_FRACTION * values[..., :1], axis=-1)))

    def condition(self, angles: Real, *, with_frame: bool) -> Real:
        """Return the condition number of the tip's Jacobian; shape (...).

        It is the largest over the least singular value, of as many as the arm's rank: the joint speed that the slowest
        direction costs.
        """
        values = self.singular_values(angles, with_frame=with_frame)
        least = values[..., self.rank(with_frame=with_frame) - 1]
        return np.asarray(values[..., 0] / np.maximum(least, 1e-300))


def rotation_vector(rotation: Real) -> Real:
    """Return axis times angle of rotations, the angle up to π.

    Shape (..., 3, 3) gives (..., 3).
    """
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - slow to load, and for lines with a given tool alone

    turns = Rotation.from_matrix(np.reshape(rotation, (-1, 3, 3)))
    return np.asarray(turns.as_rotvec()).reshape(np.shape(rotation)[:-1])
