"""Friction and gravity of one axis from slow motion in both directions."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.stats import norm

from hil.control.arrays import Real
from hil.design.estimation import EstimatedParameter, UnidentifiableError, inverse

STRIBECK_RAD_S = (0.5, 0.8, 1.2, 1.8, 2.5, 3.5, 5.0, 7.0)
"""Accuracy: Stribeck speeds ω_s that are tried, a factor of 1.5 apart: averaged, τ_C of 60 drawn robots is 2.6 % off (rms)."""
LAW_LEFT_OPEN, SAME_SPEED = 3e-3, 0.1
"""Measured: deviation of friction from any law, over Coulomb friction, and speeds, as a logarithm, at which it is the same.

The rms of z of τ_C is 0.80 with it on the drawn robots 50905 to 50964 and 51305 to 51364, and that of the viscous friction 0.98;
0.86 and 1.11 with 2e-3, 0.99 and 1.43 with 1e-3. With 2e-3, τ_C of the reference robot is 2.3 % off once in twenty."""
GRAVITY_LEFT_OPEN = 3e-4
"""Measured: least relative error of the gravity moment. The rms of its z is 0.84 with it on the drawn robots 50201 to 50317, 0.78
with 5e-4, and 1.48 without."""


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
    """Friction and gravity seen in slow motion.

    Torques are at the motor, the gravity moment is at the arm.

    τ = sgn(ω)(τ_C + b |ω| + s exp(−(ω/ω_s)²)) + (G_c cos(θ_m/N) + G_s sin(θ_m/N))/N, fitted to the work per angle of whole motor
    turns, ∫τ dθ_m/Δθ_m, which, unlike the mean over time, does not contain what the servo loop moves to and fro: 4 % of the
    friction of 51348, a drawn robot. Where both differ the arm vibrates, and takes a part of the work that is of the same size.

    Attributes:
        coulomb_nm: Coulomb friction τ_C.
        viscous_nm_s_rad: Viscous friction b: D_m + D_l/N² and all else that grows with the speed.
        gravity_moment_nm: Moment √(G_c² + G_s²) = m g l, at the arm.
        gravity_phase_deg: Phase q₀, so that the moment is m g l cos(θ_l + q₀).
        speed_rad_s: Speed of each mean; shape (blocks,).
        arm_angle_rad: Arm angle of each mean, θ_m/N less the torsion under gravity; shape (blocks,).
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


def fit_friction(
    stretches: Sequence[SlowStretch], sync_s: float, reduction_ratio: float, stiffness_nm_rad: float = math.inf
) -> Friction:
    """Fit friction and gravity to slow runs in both directions.

    The runs need two or more speeds.

    Args:
        stiffness_nm_rad: K_g, as far as it is known, by which the arm hangs below θ_m/N: a hundredth of a radian, on a soft gear,
            puts the gravity moment off by half a per cent.

    Raises:
        UnidentifiableError: Fewer whole motor turns than the four unknowns need, or one direction only.
    """
    rows = [block for stretch in stretches for block in _turns(stretch, sync_s)]
    if len(rows) < 8:
        raise UnidentifiableError("whole motor turns at constant speed", len(rows), 8)
    angle, speed, torque, swing = np.array(rows).T
    if not (np.any(speed > 0) and np.any(speed < 0)):
        raise UnidentifiableError("directions of motion", 1, 2)
    arm = angle / reduction_ratio
    for is_last in (False, True):
        fits = _with_stribeck(arm, speed, torque, swing, reduction_ratio)
        best = max(fits, key=lambda fit: fit.weight)
        whole = sum(fit.weight for fit in fits)
        mean = sum((fit.weight / whole * fit.values for fit in fits), np.zeros(4))
        if is_last:
            break
        arm = angle / reduction_ratio - (np.cos(arm) * mean[2] + np.sin(arm) * mean[3]) / stiffness_nm_rad
    covariance = sum(
        (fit.weight / whole * (fit.covariance + np.outer(fit.values - mean, fit.values - mean)) for fit in fits), np.zeros((4, 4))
    )
    moment = math.hypot(mean[2], mean[3])
    along = np.array([0.0, 0.0, mean[2], mean[3]]) / max(moment, 1e-30)
    across = np.array([0.0, 0.0, -mean[3], mean[2]]) / max(moment, 1e-30) ** 2
    # G_c cos θ + G_s sin θ = m g l cos(θ + q₀) with q₀ = −atan2(G_s, G_c)
    phase = -math.degrees(math.atan2(mean[3], mean[2]))
    spread = [math.sqrt(max(0.0, float(v @ covariance @ v))) for v in (*np.eye(4)[:2], along, across)]
    gravity = (np.cos(arm) * best.values[2] + np.sin(arm) * best.values[3]) / reduction_ratio
    return Friction(
        EstimatedParameter(float(mean[0]), spread[0]),
        EstimatedParameter(float(mean[1]), spread[1]),
        EstimatedParameter(moment, math.hypot(spread[2], GRAVITY_LEFT_OPEN * moment)),
        EstimatedParameter(phase, math.degrees(spread[3])),
        best.residual_nm,
        speed,
        arm,
        torque,
        best.model_nm,
        gravity,
    )


@dataclass(frozen=True)
class _Fit:
    """Fit with one Stribeck speed, or with none.

    It has τ_C, b, G_c and G_s, their covariance, and the fit's evidence as `weight`.
    """

    values: Real
    covariance: Real
    weight: float
    residual_nm: float
    model_nm: Real


def _with_stribeck(arm: Real, speed: Real, torque: Real, swing: Real, reduction_ratio: float) -> list[_Fit]:
    """Fit friction with and without a Stribeck term, for many ω_s.

    The term is exp(−(ω/ω_s)²).

    Few speeds do not determine ω_s. Each fit counts by its evidence, so that the error contains the differences of the fits: a
    Stribeck term is as likely as none, each ω_s as the others, and its size s has the density e^{−s/τ_C}/τ_C.

    Source: D. J. C. MacKay, Bayesian interpolation, Neural Computation 4 (1992): evidence and Occam factor.
    """
    sign, level = np.sign(speed), np.round(np.log(np.abs(speed)) / SAME_SPEED)
    plain = np.column_stack([sign, speed, np.cos(arm) / reduction_ratio, np.sin(arm) / reduction_ratio])
    found: list[tuple[Real, Real, Real, Real]] = []
    for stribeck in (0.0, *STRIBECK_RAD_S):
        matrix = plain
        if stribeck:
            matrix = np.column_stack([plain, sign * np.exp(-((speed / stribeck) ** 2))])
        scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-30)
        values = np.linalg.lstsq(matrix / scale, torque, rcond=None)[0] / scale
        found.append((values, matrix, torque - matrix @ values, inverse(matrix.T @ matrix)))
    free = max(1, len(torque) - 6)
    least = min(float(np.sum(left**2)) for _, _, left, _ in found)
    power = least / free
    without = found[0][0]
    off_law = (LAW_LEFT_OPEN * float(without[0])) ** 2
    fits = []
    for values, matrix, left, square in found:
        excess = (float(np.sum(left**2)) - least) / (power + off_law + np.finfo(float).tiny)
        mean, weight = values, math.exp(-0.5 * min(1400.0, excess))
        residual = math.sqrt(float(np.sum(left**2)) / free)
        # each turn has its own noise, all turns of a speed the same deviation from the law
        levels = [level == each for each in np.unique(level)]
        off = [math.sqrt(off_law + float(np.mean(swing[rows])) ** 2) for rows in levels]
        by_law = square @ (matrix.T @ np.array([size * sign * rows for size, rows in zip(off, levels, strict=True)]).T)
        covariance = square * power + by_law @ by_law.T
        if len(values) > len(without):
            mean, covariance, part = _with_positive_last(values, covariance, max(abs(float(without[0])), np.finfo(float).tiny))
            weight *= part / len(STRIBECK_RAD_S)
        fits.append(_Fit(mean[:4], covariance[:4, :4], weight + 1e-300, residual, matrix @ values))
    return fits


def _with_positive_last(values: Real, covariance: Real, expected: float) -> tuple[Real, Real, float]:
    """Multiply a normal density by the exponential one of its last variable.

    Returns mean and covariance of the product, and its integral over the largest value of the normal density of that variable.
    """
    spread = math.sqrt(max(float(covariance[-1, -1]), np.finfo(float).tiny))
    shift = min(spread / expected, np.finfo(float).eps ** -0.25)  # beyond, the likelihood says nothing, and its square is rounded
    sigma = shift * expected
    least = shift - float(values[-1]) / sigma
    hazard = math.exp(float(norm.logpdf(least) - norm.logsf(least)))
    along = covariance[:, -1] / spread**2 * sigma
    log_part = 0.5 * shift**2 - float(values[-1]) / expected + float(norm.logsf(least))
    part = shift * math.sqrt(2.0 * math.pi) * math.exp(log_part)
    return values + along * (hazard - shift), covariance - np.outer(along, along) * hazard * (hazard - least), part


def _turns(stretch: SlowStretch, sync_s: float) -> list[tuple[float, float, float, float]]:
    """Average angle and speed over each whole motor turn, its work per angle, and by how much the mean torque differs."""
    angle, torque = stretch.angle_rad, stretch.torque_nm
    if len(angle) < 2:
        return []
    speed = (angle[-1] - angle[0]) / ((len(angle) - 1) * sync_s)
    per_turn = 2.0 * math.pi / abs(speed) / sync_s if speed else math.inf
    count = int((len(angle) - 1) / per_turn) if math.isfinite(per_turn) else 0
    between = 0.5 * (torque[1:] + torque[:-1])
    work = np.append(0.0, np.cumsum(between * np.diff(angle)))
    edges = [round(turn * per_turn) for turn in range(count + 1)]
    turns = []
    for a, b in pairwise(edges):
        if angle[b] != angle[a]:
            per_angle = (work[b] - work[a]) / (angle[b] - angle[a])
            swing = per_angle - np.mean(between[a:b])
            turns.append((float(np.mean(angle[a:b])), float(speed), float(per_angle), float(swing)))
    return turns
