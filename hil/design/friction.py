"""Friction and gravity of one axis from slow motion in both directions."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hil.design.estimation import EstimatedParameter, UnidentifiableError, inverse
from hil.design.frequency import Real


@dataclass(frozen=True)
class SlowStretch:
    """Recorded rows of motion at one constant speed.

    Attributes:
        angle_rad: Motor angle; shape (n,).
        torque_nm: Motor torque; shape (n,).
    """

    angle_rad: Real
    torque_nm: Real


@dataclass(frozen=True)
class Friction:
    """Friction and gravity seen in slow motion; torques at the motor, the gravity moment at the arm.

    τ = sgn(ω)(τ_C + b |ω|) + (G_c cos(θ_m/N) + G_s sin(θ_m/N))/N, fitted to the means over whole motor turns, which carry no
    transmission error.

    Attributes:
        coulomb_nm: Coulomb friction τ_C.
        viscous_nm_s_rad: Viscous friction b: D_m + D_l/N² and all else that grows with the speed.
        gravity_moment_nm: Moment √(G_c² + G_s²) = m g l, at the arm.
        gravity_phase_deg: Phase q₀, so that the moment is m g l cos(θ_l + q₀).
        residual_nm: Root mean square of the residual.
        speed_rad_s: Speed of each mean; shape (blocks,).
        arm_angle_rad: Arm angle of each mean, θ_m/N; shape (blocks,).
        torque_nm: Torque of each mean; shape (blocks,).
        model_nm: Torque of the fit; shape (blocks,).
        gravity_nm: Gravity part of the fit, at the motor; shape (blocks,).
    """

    coulomb_nm: EstimatedParameter
    viscous_nm_s_rad: EstimatedParameter
    gravity_moment_nm: EstimatedParameter
    gravity_phase_deg: EstimatedParameter
    residual_nm: float
    speed_rad_s: Real
    arm_angle_rad: Real
    torque_nm: Real
    model_nm: Real
    gravity_nm: Real

    @property
    def arm_span_deg(self) -> float:
        """Range of the arm angle over which gravity was seen."""
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
    fitted = np.linalg.lstsq(matrix / scale, torque, rcond=None)[0] / scale
    left = torque - matrix @ fitted
    power = float(np.sum(left**2)) / max(1, len(left) - 4)
    covariance = inverse(matrix.T @ matrix) * power
    moment = math.hypot(fitted[2], fitted[3])
    along = np.array([0.0, 0.0, fitted[2], fitted[3]]) / max(moment, 1e-30)
    across = np.array([0.0, 0.0, -fitted[3], fitted[2]]) / max(moment, 1e-30) ** 2
    # G_c cos θ + G_s sin θ = m g l cos(θ + q₀) with q₀ = −atan2(G_s, G_c)
    phase = -math.degrees(math.atan2(fitted[3], fitted[2]))
    spread = [math.sqrt(max(0.0, float(v @ covariance @ v))) for v in (*np.eye(4)[:2], along, across)]
    gravity = matrix[:, 2:] @ fitted[2:]
    return Friction(
        EstimatedParameter(float(fitted[0]), spread[0]),
        EstimatedParameter(float(fitted[1]), spread[1]),
        EstimatedParameter(moment, spread[2]),
        EstimatedParameter(phase, math.degrees(spread[3])),
        math.sqrt(power),
        speed,
        arm,
        torque,
        matrix @ fitted,
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
