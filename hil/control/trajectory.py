"""Trajectories: constant acceleration, straight line of the tip, smooth move."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from hil.control.arrays import Real


class UnreachableError(ValueError):
    """A point that the planar chain cannot reach."""

    def __init__(self, x_m: float, z_m: float, reach_m: float) -> None:
        """Keep the point and the reach."""
        self.x_m, self.z_m, self.reach_m = x_m, z_m, reach_m
        super().__init__(f"the tip cannot reach x = {x_m:.3f} m, z = {z_m:.3f} m: the arm reaches {reach_m:.3f} m")


def sample_times(duration_s: float, period_s: float) -> Real:
    """Return the instants 0, T, 2T …; shape (n,).

    The last is the first one at or after the duration.
    """
    return np.arange(math.ceil(round(duration_s / period_s, 9)) + 1, dtype=np.float64) * period_s


@dataclass(frozen=True)
class ConstantAcceleration:
    """Motion that speeds up slowly and slows down faster.

    Rest, a constant acceleration, a (larger) constant deceleration, rest.

    Attributes:
        deceleration_rps_s: Rate at which the motor is brought to rest, outside the windows of the metrics.
        dwell_s: Time of rest before the motion.
        tail_s: Time of rest after the motion.
        direction: +1 or −1.
    """

    acceleration_rps_s: float
    end_rps: float
    deceleration_rps_s: float
    dwell_s: float
    tail_s: float
    direction: int = 1

    @property
    def ramp_s(self) -> float:
        """Duration of the rise of the speed."""
        return self.end_rps / self.acceleration_rps_s

    @property
    def duration_s(self) -> float:
        """Duration of the motion, both rests included."""
        return self.dwell_s + self.ramp_s + self.end_rps / self.deceleration_rps_s + self.tail_s

    def motor_angle(self, time_s: Real) -> Real:
        """θ_ref in rad over the time; shape of `time_s`."""
        up, down = self.ramp_s, self.end_rps / self.deceleration_rps_s
        t = np.asarray(time_s) - self.dwell_s
        rising = np.clip(t, 0.0, up)
        falling = np.clip(t - up, 0.0, down)
        revolutions = (
            0.5 * self.acceleration_rps_s * rising**2 + self.end_rps * falling - 0.5 * self.deceleration_rps_s * falling**2
        )
        return np.asarray(self.direction * 2.0 * math.pi * revolutions)


def reach_rps(room_rev: float, acceleration_rps_s: float, deceleration_rps_s: float) -> float:
    """Largest speed of a motor from rest to rest."""
    return math.sqrt(2.0 * room_rev / (1.0 / acceleration_rps_s + 1.0 / deceleration_rps_s))


@dataclass(frozen=True)
class PointToPoint:
    """Motion with equal constant acceleration and deceleration.

    Rest, a constant acceleration, a constant speed, the same deceleration, rest.

    Attributes:
        distance_rev: Motor revolutions from rest to rest, negative backwards.
        speed_rps: The speed that is not exceeded; a short way does not reach it.
    """

    distance_rev: float
    speed_rps: float
    acceleration_rps_s: float
    dwell_s: float
    tail_s: float

    @property
    def ramp_s(self) -> float:
        """Duration of the rise of the speed."""
        return min(self.speed_rps / self.acceleration_rps_s, math.sqrt(abs(self.distance_rev) / self.acceleration_rps_s))

    @property
    def move_s(self) -> float:
        """Duration from rest to rest."""
        return self.ramp_s + abs(self.distance_rev) / (self.acceleration_rps_s * self.ramp_s)

    @property
    def duration_s(self) -> float:
        """Duration of the motion, both rests included."""
        return self.dwell_s + self.move_s + self.tail_s

    def motor_angle(self, time_s: Real) -> Real:
        """θ_ref in rad over the time; shape of `time_s`."""
        ramp, even = self.ramp_s, self.move_s - 2.0 * self.ramp_s
        t = np.asarray(time_s) - self.dwell_s
        rising, level, falling = (
            np.clip(t - begin, 0.0, span) for begin, span in ((0.0, ramp), (ramp, even), (ramp + even, ramp))
        )
        reached = 0.5 * rising**2 + ramp * level + ramp * falling - 0.5 * falling**2
        return np.asarray(math.copysign(2.0 * math.pi * self.acceleration_rps_s, self.distance_rev) * reached)


@dataclass(frozen=True)
class Smooth:
    """Move over a distance 1 in a time T.

    Its acceleration is a raised cosine over T_r at either end.

    ṡ = V (t/T_r − sin(2π t/T_r)/(2π)) while it rises, then V = 1/(T − T_r), then the mirror image.
    """

    duration_s: float
    ramp_s: float

    @classmethod
    def way(cls, distance: float, speed: float, ramp_s: float, acceleration: float | None = None) -> Self:
        """Return the move over a distance at a speed.

        Args:
            distance: The distance, in any unit.
            speed: Largest speed, in that unit per second.
            ramp_s: Duration of its ramps; they take longer where the acceleration, whose peak is 2 V/T_r, asks for it.
            acceleration: Largest acceleration; None without a limit.
        """
        ramp_s = ramp_s if acceleration is None else max(ramp_s, 2.0 * speed / acceleration)
        return cls(max(abs(distance) / speed, ramp_s) + ramp_s, ramp_s)

    def __post_init__(self) -> None:
        """Refuse ramps that do not fit into the time."""
        if not 0.0 < 2.0 * self.ramp_s <= self.duration_s:
            raise ValueError(f"two ramps of {self.ramp_s} s do not fit into {self.duration_s} s")

    @property
    def peak_speed(self) -> float:
        """The largest ṡ, in 1/s."""
        return 1.0 / (self.duration_s - self.ramp_s)

    def position(self, time_s: Real) -> Real:
        """Return the distance s over time; shape of `time_s`."""
        t = np.clip(np.asarray(time_s), 0.0, self.duration_s)
        mirrored = t > 0.5 * self.duration_s
        t = np.where(mirrored, self.duration_s - t, t)
        r, v = self.ramp_s, self.peak_speed
        rising = np.minimum(t, r)
        s = v * (rising**2 / (2.0 * r) + r / (4.0 * math.pi**2) * (np.cos(2.0 * math.pi * rising / r) - 1.0))
        s = s + v * np.maximum(0.0, t - r)
        return np.asarray(np.where(mirrored, 1.0 - s, s))


@dataclass(frozen=True)
class PlanarChain:
    """Arm in its vertical plane: shoulder, elbow and wrist.

    The tool points down; lengths are in m.

    They are axes 2, 3 and 5 of most arms with six. Joint angles in rad, counted as industrial arms do: q₂ leans the upper arm
    forwards from the vertical, q₃ and q₅ lift forearm and tool against the link
    before them. With the links' angles above the horizontal

        α₂ = π/2 − q₂,  α₃ = α₂ + q₃,  α₅ = α₃ + q₅
        x = d + L cos α₂ + a cos α₃ − b sin α₃ + t cos α₅
        z = h + L sin α₂ + a sin α₃ + b cos α₃ + t sin α₅
    """

    shoulder_offset_m: float
    shoulder_height_m: float
    upper_arm_m: float
    forearm_m: tuple[float, float]
    tool_m: float

    @staticmethod
    def link_angles(joints: Real) -> Real:
        """Return α₂, α₃, α₅ of joint angles; shape (..., 3).

        The map is affine, so it serves speeds too, less its constant.
        """
        q = np.asarray(joints, dtype=np.float64)
        return np.cumsum(np.stack([0.5 * math.pi - q[..., 0], q[..., 1], q[..., 2]], axis=-1), axis=-1)

    def tip(self, joints: Real) -> Real:
        """Return the tip position (x, z) in m.

        Joints of shape (..., 3) give shape (..., 2).
        """
        q = self.link_angles(joints)
        along, across = self.forearm_m
        cos, sin = np.cos(q), np.sin(q)
        x = self.shoulder_offset_m + self.upper_arm_m * cos[..., 0] + along * cos[..., 1] - across * sin[..., 1]
        z = self.shoulder_height_m + self.upper_arm_m * sin[..., 0] + along * sin[..., 1] + across * cos[..., 1]
        return np.stack([x + self.tool_m * cos[..., 2], z + self.tool_m * sin[..., 2]], axis=-1)

    def joints(self, tip: Real) -> Real:
        """Return joint angles for tip positions (x, z).

        Elbow up and tool pointing down; shape (..., 2) gives (..., 3).

        Raises:
            UnreachableError: A point outside the reach.
        """
        tip = np.asarray(tip, dtype=np.float64)
        x = tip[..., 0] - self.shoulder_offset_m
        z = tip[..., 1] + self.tool_m - self.shoulder_height_m
        along, across = self.forearm_m
        upper, fore, bend = self.upper_arm_m, math.hypot(along, across), math.atan2(across, along)
        distance = np.hypot(x, z)
        inside = (distance <= upper + fore) & (distance >= abs(upper - fore)) & (distance > 0.0)
        if not np.all(inside):  # NaN is not inside either
            x_bad, z_bad = tip.reshape(-1, 2)[int(np.argmin(inside.reshape(-1)))]
            raise UnreachableError(float(x_bad), float(z_bad), upper + fore)
        cosine = (upper**2 + distance**2 - fore**2) / (2.0 * upper * distance)
        first = np.arctan2(z, x) + np.arccos(np.clip(cosine, -1.0, 1.0))  # at full stretch rounding leads beyond 1
        forearm = np.arctan2(z - upper * np.sin(first), x - upper * np.cos(first)) - bend
        return np.stack([0.5 * math.pi - first, forearm - first, -0.5 * math.pi - forearm], axis=-1)


@dataclass(frozen=True)
class Line:
    """Straight line of the tip with smooth speed.

    Attributes:
        start_m: Tip position (x, z) at the start.
        end_m: Tip position (x, z) at the end.
        move: The speed along the line.
    """

    chain: PlanarChain
    start_m: tuple[float, float]
    end_m: tuple[float, float]
    move: Smooth
    dwell_s: float
    tail_s: float

    @property
    def duration_s(self) -> float:
        """Duration of the motion, both rests included."""
        return self.dwell_s + self.move.duration_s + self.tail_s

    def joints(self, time_s: Real) -> Real:
        """Joint angles over the time; shape (n,) gives (n, 3)."""
        s = self.move.position(np.asarray(time_s) - self.dwell_s)[..., np.newaxis]
        start, end = np.asarray(self.start_m), np.asarray(self.end_m)
        return self.chain.joints(start + s * (end - start))
