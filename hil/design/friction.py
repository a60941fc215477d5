"""Friction and gravity of one axis from slow motion in both directions."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hil.design.frequency import Real
from hil.design.plant_identification import Parameter, UnidentifiableError, inverse


@dataclass(frozen=True)
class SlowStretch:
    """Rows at one constant speed.

    Attributes:
        angle_rad: Motor angle; shape (n,).
        torque_nm: Shape (n,).
    """

    angle_rad: Real
    torque_nm: Real


@dataclass(frozen=True)
class Friction:
    """What slow motion takes, motor side but for the gravity moment.

    τ = sgn(ω)(τ_C + b |ω|) + (G_c cos(θ_m/N) + G_s sin(θ_m/N))/N, fitted to the means over whole motor turns, which carry no
    transmission error.

    Attributes:
        coulomb_nm: τ_C.
        viscous_nm_s_rad: b: D_m + D_l/N², with whatever else grows with the speed.
        gravity_moment_nm: √(G_c² + G_s²) = m g l, at the arm.
        gravity_phase_deg: q₀, so that the moment is m g l cos(θ_l + q₀).
        residual_nm: √ of the mean squared residual.
        speed_rad_s: Of each mean; shape (blocks,).
        arm_angle_rad: Of each mean, θ_m/N; shape (blocks,).
        torque_nm: Shape (blocks,).
        model_nm: The fit; shape (blocks,).
        gravity_nm: Its gravity part, at the motor; shape (blocks,).
    """

    coulomb_nm: Parameter
    viscous_nm_s_rad: Parameter
    gravity_moment_nm: Parameter
    gravity_phase_deg: Parameter
    residual_nm: float
    speed_rad_s: Real
    arm_angle_rad: Real
    torque_nm: Real
    model_nm: Real
    gravity_nm: Real

    @property
    def arm_span_deg(self) -> float:
        """How much of the gravity's cosine was seen."""
        return math.degrees(float(np.ptp(self.arm_angle_rad)))


def fit_friction(stretches: Sequence[SlowStretch], sync_s: float, reduction_ratio: float) -> Friction:
    """Coulomb and viscous friction and gravity from slow runs in both directions at two or more speeds.

    Raises:
        UnidentifiableError: Fewer whole motor turns than the four unknowns need, or one direction only.
    """
    rows = [block for stretch in stretches for block in _turns(stretch, sync_s)]
    if len(rows) < 8:
        raise UnidentifiableError("whole motor turns at constant speed", len(rows), 8)
    table = np.array(rows)
    angle, speed, torque = table.T
    sign = np.sign(speed)
    if not (np.any(sign > 0) and np.any(sign < 0)):
        raise UnidentifiableError("directions of motion", 1, 2)
    arm = angle / reduction_ratio
    matrix = np.column_stack([sign, speed, np.cos(arm) / reduction_ratio, np.sin(arm) / reduction_ratio])
    scale = np.linalg.norm(matrix, axis=0)
    found = np.linalg.lstsq(matrix / scale, torque, rcond=None)[0] / scale
    left = torque - matrix @ found
    power = float(np.sum(left**2)) / max(1, len(left) - 4)
    covariance = inverse(matrix.T @ matrix) * power
    moment = math.hypot(found[2], found[3])
    along = np.array([0.0, 0.0, found[2], found[3]]) / max(moment, 1e-30)
    across = np.array([0.0, 0.0, -found[3], found[2]]) / max(moment, 1e-30) ** 2
    # G_c cos θ + G_s sin θ = m g l cos(θ + q₀) with q₀ = −atan2(G_s, G_c)
    phase = -math.degrees(math.atan2(found[3], found[2]))
    spread = [math.sqrt(max(0.0, float(v @ covariance @ v))) for v in (*np.eye(4)[:2], along, across)]
    gravity = matrix[:, 2:] @ found[2:]
    return Friction(
        Parameter(float(found[0]), spread[0]),
        Parameter(float(found[1]), spread[1]),
        Parameter(moment, spread[2]),
        Parameter(phase, math.degrees(spread[3])),
        math.sqrt(power),
        speed,
        arm,
        torque,
        matrix @ found,
        gravity,
    )


def _turns(stretch: SlowStretch, sync_s: float) -> list[tuple[float, float, float]]:
    """Mean angle, speed and torque of each whole motor turn of a stretch."""
    angle, torque = stretch.angle_rad, stretch.torque_nm
    if len(angle) < 2:
        return []
    speed = (angle[-1] - angle[0]) / ((len(angle) - 1) * sync_s)
    per_turn = 2.0 * math.pi / abs(speed) / sync_s if speed else math.inf
    count = int(len(angle) / per_turn) if math.isfinite(per_turn) else 0
    edges = [round(turn * per_turn) for turn in range(count + 1)]
    return [(float(np.mean(angle[a:b])), float(speed), float(np.mean(torque[a:b]))) for a, b in pairwise(edges)]
