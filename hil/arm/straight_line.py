"""Straight line of an arm's tip in joint angles.

The tip moves straight from place to place; its axes turn about one direction in proportion to the distance covered, or are free.
A first pass solves the line in small steps from the angles at its start, so that the arm remains in the same configuration.
All requested points are then solved at once, beginning with angles interpolated between those steps.
A line that the arm cannot follow raises an error with the reason and the place.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hil.arm.kinematics import Kinematics, rotation_vector
from hil.arm.rotation import turn
from hil.control.arrays import Real
from hil.control.trajectory import Smooth, sample_times

STEP_M, STEP_RAD = 0.002, math.radians(0.5)
"""Steps in which a line is solved: the shorter counts."""
FEWEST_STEPS, MOST_STEPS = 64, 2048
REACHED_M, REACHED_RAD = 1e-7, 1e-7
"""Errors of a pose up to which it is reached."""
MOST_ROUNDS = 1000
"""Rounds before a pose is out of reach: next to a singular posture each lowers the error little."""
MOST_CONDITION = 300.0
"""Condition of the Jacobian from which a posture counts as singular: the arm turns so much faster than its tip moves."""


class LineError(ValueError):
    """A line that the arm cannot follow.

    Attributes:
        fraction: Its end, as a fraction of the line.
        at_m: The same in m from its start.
    """

    def __init__(self, fraction: float, length_m: float, why: str) -> None:
        self.fraction, self.at_m, self.why = fraction, fraction * length_m, why
        where = (
            f"{1e3 * self.at_m:.1f} mm, {100.0 * fraction:.3g} % of the way"
            if length_m
            else f"{100.0 * fraction:.3g} % of the turn"
        )
        super().__init__(f"the line ends after {where}: {why}")


@dataclass(frozen=True)
class Pose:
    """Position of the tip, and its axes in the base frame.

    Attributes:
        position_m: Position; shape (3,).
        frame: The axes as columns; shape (3, 3); None if they are free.
    """

    position_m: Real
    frame: Real | None


@dataclass(frozen=True)
class JointLimits:
    """Limits of one joint's motion."""

    low_rad: float
    high_rad: float
    speed_rad_s: float


@dataclass(frozen=True)
class StraightLine:
    """A straight line with smooth speed; rest before and after.

    Attributes:
        near: Joint angles near the start, which select the arm's configuration; shape (n,).
        end: Pose at the end; its axes are free if the start's are.
    """

    arm: Kinematics
    near: Real
    start: Pose
    end: Pose
    move: Smooth
    dwell_s: float
    tail_s: float
    names: tuple[str, ...]

    @property
    def duration_s(self) -> float:
        """Duration of the motion, both rests included."""
        return self.dwell_s + self.move.duration_s + self.tail_s

    @property
    def length_m(self) -> float:
        """Distance from start to end."""
        return float(np.linalg.norm(self.end.position_m - self.start.position_m))

    @property
    def with_frame(self) -> bool:
        """True if the tip's axes are not free."""
        return self.start.frame is not None

    @property
    def turned_rad(self) -> float:
        """Angle by which the tool turns from start to end."""
        return float(np.linalg.norm(self._turned))

    @cached_property
    def _turned(self) -> Real:
        """Axis times angle of the tip's turn in base; shape (3,)."""
        if self.start.frame is None or self.end.frame is None:
            return np.zeros(3)
        return rotation_vector(self.end.frame @ self.start.frame.T)

    def poses(self, fraction: Real) -> tuple[Real, Real | None]:
        """Return positions and axes of the tip at fractions of the line.

        Shapes (n, 3) and (n, 3, 3); None for the axes if they are free.
        """
        s = np.asarray(fraction, dtype=np.float64)
        positions = self.start.position_m + s[:, np.newaxis] * (self.end.position_m - self.start.position_m)
        if self.start.frame is None:
            return positions, None
        angle = self.turned_rad
        axis = self._turned / angle if angle else np.array([0.0, 0.0, 1.0])
        return positions, turn(axis, s * angle) @ self.start.frame

    @cached_property
    def joints_along(self) -> tuple[Real, Real]:
        """Fractions of the line, shape (m,), and joint angles, (m, n).

        Raises:
            LineError: The arm does not reach a point of the line, or passes a singular posture; with the first such point.
        """
        steps = math.ceil(max(self.length_m / STEP_M, self.turned_rad / STEP_RAD))
        fractions = np.linspace(0.0, 1.0, min(max(steps, FEWEST_STEPS), MOST_STEPS) + 1)
        positions, frames = self.poses(fractions)
        found, angles = np.empty((len(fractions), self.arm.count)), np.asarray(self.near, dtype=np.float64)
        for i, fraction in enumerate(fractions.tolist()):
            wanted = None if frames is None else frames[i]
            before, (angles, left) = angles, self.arm.solve(angles, positions[i], wanted)
            if not _is_reached(left):
                angles, left = self.arm.solve(before, positions[i], wanted, rounds=MOST_ROUNDS)
            self._check_reach(fraction, positions[i], left)
            found[i] = angles
        condition = self.arm.condition(found, with_frame=self.with_frame)
        singular = np.flatnonzero(condition > MOST_CONDITION)
        if len(singular):
            self._refuse_singular(float(fractions[singular[0]]), found[singular[0]], float(condition[singular[0]]))
        return fractions, found

    def _check_reach(self, fraction: float, position_m: Real, left: Real) -> None:
        if _is_reached(left):
            return
        missing_m, missing_rad = float(np.linalg.norm(left[:3])), float(np.linalg.norm(left[3:]))
        x, y, z = position_m.tolist()
        why = f"the arm does not bring its tip to x = {x:.3f}, y = {y:.3f}, z = {z:.3f} m"
        if self.with_frame:
            why += " in the required direction"
        why += f"; the nearest place found is {1e3 * missing_m:.3g} mm" + (
            f" and {math.degrees(missing_rad):.2g}°" if self.with_frame else ""
        )
        raise LineError(fraction, self.length_m, f"{why} away")

    def _refuse_singular(self, fraction: float, angles: Real, condition: float) -> None:
        rows = 6 if self.with_frame else 3
        _, _, directions = np.linalg.svd(self.arm.jacobian(angles)[:rows])
        idle = np.abs(directions[self.arm.rank(with_frame=self.with_frame) - 1])
        joints = " and ".join(self.names[joint] for joint in np.flatnonzero(idle > 0.3))
        raise LineError(
            fraction, self.length_m,
            f"the posture is singular (condition {condition:.3g}, allowed: {MOST_CONDITION:g}): {joints} would turn "
            "without moving the tip",
        )  # fmt: skip

    def angles(self, fraction: Real) -> Real:
        """Return exact joint angles (n, joints) at fractions of the line (n,).

        Raises:
            LineError: The arm cannot follow the line.
        """
        fractions, joints_rad = self.joints_along
        near = _smooth_between(fractions, joints_rad, fraction)
        found, left = self.arm.solve(near, *self.poses(fraction))
        worst = int(np.argmax(np.max(np.abs(left), axis=-1)))
        self._check_reach(float(fraction[worst]), self.poses(fraction)[0][worst], left[worst])
        return found

    def joints(self, time_s: Real) -> Real:
        """Joint angles over the time; shape (n,) gives (n, joints).

        Raises:
            LineError: The arm cannot follow the line.
        """
        fraction = self.move.position(np.asarray(time_s) - self.dwell_s)
        different, back = np.unique(fraction, return_inverse=True)
        return np.asarray(self.angles(different)[back])

    def check_limits(self, limits: Sequence[JointLimits], period_s: float) -> None:
        """Refuse a line on which a joint leaves its limits.

        Limits are from the base on; instants are checked every `period_s`.

        Raises:
            LineError: A joint does, or the arm cannot follow the line.
        """
        times = sample_times(self.duration_s, period_s)
        angles = self.joints(times)
        speeds = np.gradient(angles, period_s, axis=0)
        fraction = self.move.position(times - self.dwell_s)
        for joint, limit in enumerate(limits):
            name, own, speed = self.names[joint], angles[:, joint], np.abs(speeds[:, joint])
            outside = np.flatnonzero((own < limit.low_rad) | (own > limit.high_rad))
            if len(outside):
                at = outside[0]
                raise LineError(
                    float(fraction[at]), self.length_m,
                    f"{name} would be at {math.degrees(own[at]):.2f}°; its limits are {math.degrees(limit.low_rad):.2f}° "
                    f"and {math.degrees(limit.high_rad):.2f}°",
                )  # fmt: skip
            fast = np.flatnonzero(speed > limit.speed_rad_s)
            if len(fast):
                most = float(np.max(speed))
                longer = self.move.duration_s * most / limit.speed_rad_s
                raise LineError(
                    float(fraction[fast[0]]), self.length_m,
                    f"{name} would turn at up to {math.degrees(most):.3g}°/s; its limit is "
                    f"{math.degrees(limit.speed_rad_s):.3g}°/s: duration_s {longer:.2g} or more",
                )  # fmt: skip


def _is_reached(left: Real) -> bool:
    """True if the remaining displacement and turn are below the tolerances."""
    return float(np.linalg.norm(left[:3])) <= REACHED_M and float(np.linalg.norm(left[3:])) <= REACHED_RAD


def _smooth_between(fractions: Real, joints_rad: Real, wanted: Real) -> Real:
    """Interpolate angles between equal steps by Catmull and Rom's cubic.

    The result is smooth enough as a starting value; shape (n, joints).
    """
    slopes = np.gradient(joints_rad, fractions, axis=0)
    step = float(fractions[1] - fractions[0])
    at = np.clip((wanted / step).astype(np.int64), 0, len(fractions) - 2)
    u = ((wanted - fractions[at]) / step)[:, np.newaxis]
    before, after = joints_rad[at], joints_rad[at + 1]
    rise, fall = slopes[at] * step, slopes[at + 1] * step
    return np.asarray(
        (2 * u**3 - 3 * u**2 + 1) * before + (u**3 - 2 * u**2 + u) * rise + (3 * u**2 - 2 * u**3) * after + (u**3 - u**2) * fall
    )
