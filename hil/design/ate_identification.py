"""The transmission error from ramps in both directions, with the arm, the sensor's delay and the confidence in each.

The model is that of `hil.design.transmission_error`, seen by a sensor that lags the motor angle by Δ,

    y(t) = e^{−sΔ} (g H(s) [θ_m/N + Σ A_k cos(k θ_m + φ_k)]'' + J θ̈_m),

with y the tip acceleration, g the tip lever and J = 0; or, without an accelerometer, y the motor torque, g = J_l/N and J = J_m,
since the motor feels τ_g/N of its gear with τ_g = J_l H(s) [θ_m/N + θ_sync]'' (D_l = 0). The model is linear in A_k cos φ_k and
A_k sin φ_k; ω, ζ and Δ are refined around them. With an accelerometer only the lever of the arm must be known.

Both directions are needed: turning backwards, φ_k appears with the opposite sign, while Δ and all phase of H keep theirs. One
direction cannot tell φ_k from a delay (4.3° for each millisecond at 12 Hz), two can. The gear's part of the damping (ζ_g) is
such a phase too: 1 + 2 ζ_g s/ω ≈ e^{2 ζ_g s/ω}. An error in it goes into Δ and not into φ_k.

Source: the paper, section 3.2.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from hil.control.angles import ARCSEC
from hil.design.ate_model import GEAR_FRACTION, Arm, FreeMotionModel, RampsModel, Sensing, Sweep, least_squares
from hil.design.transmission_error import PAPER_ORDERS, TransmissionError

Real = NDArray[np.float64]

SEARCH_HZ = (4.0, 35.0)
"""Resonances among which an unknown arm is searched."""
SEARCH_DAMPING = (0.02, 0.05, 0.12)
DELAY_S = (-0.010, 0.030)
"""Delays that are searched: half a period of the resonance more (42 ms at 12 Hz) looks like φ_k turned by 180°."""
BAND = (0.5, 2.1)
"""Pass band by the arm's frequency: the resonance with its skirts; below lies the motion itself, above lies noise."""


@dataclass(frozen=True)
class Agreement:
    """One number as either direction alone gives it, at the arm and delay of both together.

    Attributes:
        name: `a2_arcsec`, `phi2_deg` …
        forward: Value from the ramps in which the motor turns forwards.
        backward: Value from the ramps in which it turns backwards.
        sigma: Difference of both over its standard error.
    """

    name: str
    forward: float
    backward: float
    sigma: float


@dataclass(frozen=True)
class JointEstimate:
    """Estimate of A_k, φ_k, arm and delay from ramps in both directions.

    The standard errors suppose that the residual of the model is noise, flat over the band; where the two directions differ
    by more than that explains, they have been widened until it does. They know nothing of a wrong lever arm, which goes
    straight into A_k, nor of a wrong zero of the motor angle, which goes into φ_k.

    Attributes:
        error: A_k and φ_k (0 ≤ φ_k < 360°).
        amplitude_error_arcsec: Standard error of A_k by order.
        phase_error_deg: Standard error of φ_k by order.
        arm: Arm with its ω, ζ and the delay Δ.
        arm_error: Standard errors of ω, ζ and Δ.
        residual: Root mean square of the residual in the band, in the signal's unit.
        explained: Fraction of the signal's band-passed power that the model explains, 0 … 1.
        explained_by_error: Fraction by which θ_sync lowers the residual power of a model without it.
        motion_scale: Factor that the motor's own motion has in the signal, 1 where N and g are right; estimated beside the rest.
        motion_scale_error: Standard error of `motion_scale`.
        agreement: The two directions against each other.
        widened: Factor by which the standard errors have been multiplied.
        band_hz: Pass band of the fit.
    """

    error: TransmissionError
    amplitude_error_arcsec: Mapping[float, float]
    phase_error_deg: Mapping[float, float]
    arm: Arm
    arm_error: Arm
    residual: float
    explained: float
    explained_by_error: float
    motion_scale: float
    motion_scale_error: float
    agreement: tuple[Agreement, ...]
    widened: float
    band_hz: tuple[float, float]


def identify(
    sweeps: Sequence[Sweep],
    reduction_ratio: float,
    sensing: Sensing,
    start: Arm | None = None,
    orders: Sequence[float] = PAPER_ORDERS,
) -> JointEstimate:
    """A_k and φ_k, the arm and the sensor's delay from ramps in both directions.

    Args:
        sweeps: Recordings with at least one ramp in each direction, through the resonance with every order.
        reduction_ratio: Reduction ratio N.
        sensing: The kind of signal in the recordings.
        start: An arm to start from beside those searched over `SEARCH_HZ`; it may be wrong.
        orders: Orders k of the error.

    Raises:
        ValueError: A direction is missing or too short, or shapes differ.

    Source: the paper, section 3.2.
    """
    _check(sweeps, tuple(orders))
    arm = _search(sweeps, reduction_ratio, sensing, tuple(orders), start)
    for _ in range(2):  # the band follows the arm
        model = _model_around(sweeps, reduction_ratio, sensing, tuple(orders), arm.resonance_hz)
        arm = _refine(model, arm)
    return _estimate(model, arm)


def _check(sweeps: Sequence[Sweep], orders: tuple[float, ...]) -> None:
    for sweep in sweeps:
        shapes = {np.shape(sweep.motor_angle_rad), np.shape(sweep.signal), np.shape(sweep.direction)}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise ValueError(f"motor angle, signal and direction have shapes {sorted(shapes)}; all must be the same (n,)")
    needed = 0.15 * (2 * len(orders) + 3)
    for direction, word in ((1, "forwards"), (-1, "backwards")):
        seconds = sum(float(np.count_nonzero(sweep.direction == direction)) * sweep.period_s for sweep in sweeps)
        if seconds < needed:
            raise ValueError(
                f"{seconds:.2f} s of ramps {word} cannot give {2 * len(orders) + 3} numbers; {needed:.2f} s are needed"
            )


def _model_around(
    sweeps: Sequence[Sweep], reduction_ratio: float, sensing: Sensing, orders: tuple[float, ...], frequency_hz: float
) -> RampsModel:
    top = 0.4 / max(sweep.period_s for sweep in sweeps)
    band = (BAND[0] * frequency_hz, min(BAND[1] * frequency_hz, top))
    return RampsModel(sweeps, reduction_ratio, sensing, orders, band)


def _search(
    sweeps: Sequence[Sweep], reduction_ratio: float, sensing: Sensing, orders: tuple[float, ...], start: Arm | None
) -> Arm:
    """The arm over a grid, first with the directions apart, in which a delay does no harm; then the delay over another."""
    top = 0.3 / max(sweep.period_s for sweep in sweeps)
    low, high = SEARCH_HZ[0], min(SEARCH_HZ[1], top)
    model = RampsModel(sweeps, reduction_ratio, sensing, orders, (0.8 * low, min(1.2 * high, 1.2 * top)))
    gear_fraction = GEAR_FRACTION if start is None else start.gear_fraction
    arms = [Arm(float(f), zeta, 0.0, gear_fraction) for f in np.geomspace(low, high, 56) for zeta in SEARCH_DAMPING]
    if start is not None:
        arms.append(replace(start, delay_s=0.0))
    best = min(arms, key=model.power_apart)
    model = _model_around(sweeps, reduction_ratio, sensing, orders, best.resonance_hz)
    fine = [
        replace(best, resonance_hz=best.resonance_hz * float(f), damping=best.damping * z)
        for f in np.linspace(0.96, 1.04, 9)
        for z in (0.6, 1.0, 1.6)
    ]
    best = min(fine, key=model.power_apart)
    delays = [replace(best, delay_s=float(delay)) for delay in np.arange(DELAY_S[0], DELAY_S[1] + 1e-9, 2e-3)]
    return min(delays, key=model.power)


def _refine(model: RampsModel | FreeMotionModel, start: Arm) -> Arm:
    """Gauss-Newton in ω, ζ and Δ with the linear unknowns projected out."""
    step_s = 1.0 / (2.0 * math.pi * start.resonance_hz)

    def arm(scaled: Real) -> Arm:
        hz, damping, late = (float(value) for value in scaled)
        return Arm(start.resonance_hz * hz, start.damping * damping, start.delay_s + step_s * late, start.gear_fraction)

    def residual(scaled: Real) -> Real:
        return model.solve(arm(scaled))[1]

    fit = optimize.least_squares(
        residual,
        np.array([1.0, 1.0, 0.0]),
        bounds=([0.8, 0.1, -1.0], [1.25, 10.0, 1.0]),
        x_scale=np.array([0.01, 0.3, 0.05]),
        diff_step=np.full(3, 1e-4),
    )
    return arm(fit.x)


def _estimate(model: RampsModel, arm: Arm) -> JointEstimate:
    """The unknowns as amplitudes and phases, with errors from the Jacobian of all unknowns."""
    unknowns, left = model.solve(arm)
    motion, matrix = model.columns(arm)
    jacobian = np.column_stack([matrix, *_slopes(model, arm, unknowns)])
    power = float(np.sum(left**2))
    variance = power / max(1.0, len(left) * model.independent - jacobian.shape[1])
    covariance = _inverse(jacobian) * variance
    agreement = _agreement(model, arm, left, variance)
    chi2 = sum(each.sigma**2 for each in agreement) / max(1, len(agreement))
    widened = math.sqrt(max(1.0, chi2))
    amplitude, phase, amplitude_error, phase_error = _polar(unknowns, covariance * widened**2, model.orders)
    arm_error = widened * np.sqrt(np.maximum(0.0, np.diag(covariance)[-3:]))
    without = model.signal - motion
    scale, scale_error = _motion_scale(model, arm)
    return JointEstimate(
        TransmissionError(amplitude, phase),
        amplitude_error,
        phase_error,
        arm,
        Arm(*(float(value) for value in arm_error)),
        math.sqrt(power / len(left)),
        1.0 - power / max(float(np.sum(model.signal**2)), 1e-300),
        1.0 - power / max(float(np.sum(without**2)), 1e-300),
        scale,
        scale_error,
        agreement,
        widened,
        model.band_hz,
    )


def _motion_scale(model: RampsModel, arm: Arm) -> tuple[float, float]:
    """Factor of the motor's own motion and its error; the arm is refined anew, since a wrong factor bends ω and ζ."""
    free = FreeMotionModel(model)
    best = _refine(free, _refine(free, replace(arm, damping=max(arm.damping, 0.01))))
    unknowns, left = free.solve(best)
    jacobian = np.column_stack([free.columns(best)[1], *_slopes(free, best, unknowns)])
    variance = float(np.sum(left**2)) / max(1.0, len(left) * model.independent - jacobian.shape[1])
    last = len(unknowns) - 1
    return float(unknowns[last]), math.sqrt(max(0.0, float(_inverse(jacobian)[last, last])) * variance)


def _slopes(model: RampsModel | FreeMotionModel, arm: Arm, unknowns: Real) -> list[Real]:
    """Slopes of the model by ω/2π, ζ and Δ."""
    slopes = []
    for d_hz, d_zeta, d_s in ((1e-4 * arm.resonance_hz, 0.0, 0.0), (0.0, 1e-3 * arm.damping, 0.0), (0.0, 0.0, 1e-5)):
        sides = []
        for sign in (1.0, -1.0):
            motion, matrix = model.columns(
                replace(
                    arm,
                    resonance_hz=arm.resonance_hz + sign * d_hz,
                    damping=arm.damping + sign * d_zeta,
                    delay_s=arm.delay_s + sign * d_s,
                )
            )
            sides.append(motion + matrix @ unknowns)
        slopes.append((sides[0] - sides[1]) / (2.0 * (d_hz + d_zeta + d_s)))
    return slopes


def _inverse(jacobian: Real) -> Real:
    """(JᵀJ)⁻¹, on scaled columns."""
    scale = np.sqrt(np.sum(jacobian**2, axis=0)) + 1e-300
    scaled = jacobian / scale
    return np.asarray(np.linalg.pinv(scaled.T @ scaled, rcond=1e-14, hermitian=True) / np.outer(scale, scale))


def _polar(
    unknowns: Real, covariance: Real, orders: tuple[float, ...]
) -> tuple[dict[float, float], dict[float, float], dict[float, float], dict[float, float]]:
    """A_k in arcsec, φ_k in degrees, and the standard errors of both."""
    amplitude, phase, amplitude_error, phase_error = {}, {}, {}, {}
    for row, order in enumerate(orders):
        x, y = float(unknowns[2 * row]), float(unknowns[2 * row + 1])
        size = max(math.hypot(x, y), 1e-30)
        block = covariance[2 * row : 2 * row + 2, 2 * row : 2 * row + 2]
        along, across = np.array([x, y]) / size, np.array([-y, x]) / size
        amplitude[order] = math.hypot(x, y) / ARCSEC
        phase[order] = math.degrees(math.atan2(y, x)) % 360.0
        amplitude_error[order] = math.sqrt(max(0.0, float(along @ block @ along))) / ARCSEC
        phase_error[order] = min(180.0, math.degrees(math.sqrt(max(0.0, float(across @ block @ across))) / size))
    return amplitude, phase, amplitude_error, phase_error


def _agreement(model: RampsModel, arm: Arm, left: Real, variance: float) -> tuple[Agreement, ...]:
    """A_k and φ_k of each direction alone."""
    motion, matrix = model.columns(arm)
    sides = []
    for direction in (1, -1):
        rows = model.directions == direction
        own = matrix[rows]
        sides.append(_polar(least_squares(own, (model.signal - motion)[rows]), _inverse(own) * variance, model.orders))
    (forward_a, forward_p, forward_ea, forward_ep), (backward_a, backward_p, backward_ea, backward_ep) = sides
    agreements = []
    for order in model.orders:
        difference = forward_a[order] - backward_a[order]
        error = math.hypot(forward_ea[order], backward_ea[order])
        agreements.append(
            Agreement(f"a{order:g}_arcsec", forward_a[order], backward_a[order], abs(difference) / max(error, 1e-30))
        )
        turn = (forward_p[order] - backward_p[order] + 180.0) % 360.0 - 180.0
        error = math.hypot(forward_ep[order], backward_ep[order])
        agreements.append(Agreement(f"phi{order:g}_deg", forward_p[order], backward_p[order], abs(turn) / max(error, 1e-30)))
    return tuple(agreements)
