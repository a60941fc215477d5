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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from hil.control.angles import ARCSEC
from hil.design.ate_misfit import BEND, misfit, structured_power
from hil.design.ate_model import GEAR_FRACTION, Arm, Noise, RampsModel, Sensing, Sweep, least_squares
from hil.design.ate_motion import motion_factor
from hil.design.transmission_error import PAPER_ORDERS, TransmissionError

Real = NDArray[np.float64]

SEARCH_HZ = (4.0, 35.0)
"""Resonances among which an unknown arm is searched."""
SEARCH_DAMPING = (0.02, 0.05, 0.12)
DELAY_S = (-0.010, 0.030)
"""Delays that are searched: half a period of the resonance more (42 ms at 12 Hz) looks like φ_k turned by 180°."""
MOUNTING_HZ = 110.0
"""A sensor's resonance on its mounting, as likely below as above, so its bend at an arm's frequency f is within ±(f/110 Hz)²."""
LARGEST_BEND = 0.17
"""A mounting that resonates at 2.4 times the arm's frequency."""
ROUNDING_FELT, ROUNDING_STEPS = 0.02, 20
"""Fraction of the residual's power from which the encoder's rounding is taken out of the arm, and steps for that."""
ROUNDING_LEFT = 0.25
"""Fraction of that correction which goes into the standard error of A_k."""
LEAST_DAMPING = 0.003
OWN_FROM_ORDER = 2
"""Least order with an arm of its own: order 1 passes its resonance at twice the speed of order 2, which few ramps reach."""
OWN_FROM, OWN_BETTER = 0.1, 0.85
"""Amplitude over the largest from which an order may have its own arm, and the residual power that this may leave."""
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
        own_arms: Arms of those orders whose vibration showed another resonance than the strongest order's: a gear that is softer,
            or stiffer, for a small vibration than for a large one.
        misfit: What is left beside noise, over the part of each order, by order.
        structured: Fraction of the signal without the motor's own motion that neither θ_sync nor noise explains.
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
    own_arms: Mapping[float, Arm] = field(default_factory=dict)
    misfit: Mapping[float, float] = field(default_factory=dict)
    structured: float = 0.0


def identify(
    sweeps: Sequence[Sweep],
    reduction_ratio: float,
    sensing: Sensing,
    start: Arm | None = None,
    orders: Sequence[float] = PAPER_ORDERS,
    *,
    is_near: bool = False,
) -> JointEstimate:
    """A_k and φ_k, the arm and the sensor's delay from ramps in both directions.

    Args:
        sweeps: Recordings with at least one ramp in each direction, through the resonance with every order.
        reduction_ratio: Reduction ratio N.
        sensing: The kind of signal in the recordings.
        start: An arm to start from beside those searched over `SEARCH_HZ`; it may be wrong.
        orders: Orders k of the error.
        is_near: True for a start from an estimate of most of these recordings: nothing is searched.

    Raises:
        ValueError: A direction is missing or too short, or shapes differ.

    Source: the paper, section 3.2.
    """
    _check(sweeps, tuple(orders))
    arm = start if is_near and start is not None else _search(sweeps, reduction_ratio, sensing, tuple(orders), start)
    noise = None
    for _ in range(2):  # the band follows the arm, and the weights the noise
        model = _model_around(sweeps, reduction_ratio, sensing, tuple(orders), arm.resonance_hz, noise)
        arm = _refine(model, arm)
        noise = model.noise(arm)
    arm, own = _own_arms(model, arm)
    for again in (True, False):
        bend_row = _bend_row(model, arm, model.solve(arm, own)[1])
        rounded = _refined(model, arm, own, bend_row)
        arm, own = _without_rounding(model, *rounded)
        moved = _moved(model, rounded, (arm, own))
        if not again or not _is_rounding_felt(model, arm, own):
            break
        model = _model_around(sweeps, reduction_ratio, sensing, tuple(orders), arm.resonance_hz, model.noise(arm))
    factor = motion_factor(sweeps, reduction_ratio, sensing, orders, arm)
    return _estimate(model, arm, own, factor, moved)


def _check(sweeps: Sequence[Sweep], orders: tuple[float, ...]) -> None:
    for sweep in sweeps:
        shapes = {np.shape(sweep.motor_angle_rad), np.shape(sweep.signal), np.shape(sweep.direction)}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise ValueError(f"motor angle, signal and direction have shapes {sorted(shapes)}; all must be the same (n,)")
    needed = 0.06 * (2 * len(orders) + 3)
    for direction, word in ((1, "forwards"), (-1, "backwards")):
        seconds = sum(float(np.count_nonzero(sweep.direction == direction)) * sweep.period_s for sweep in sweeps)
        if seconds < needed:
            raise ValueError(
                f"{seconds:.2f} s of ramps {word} cannot give {2 * len(orders) + 3} numbers; {needed:.2f} s are needed"
            )


def _model_around(
    sweeps: Sequence[Sweep],
    reduction_ratio: float,
    sensing: Sensing,
    orders: tuple[float, ...],
    frequency_hz: float,
    noise: Noise | None = None,
) -> RampsModel:
    top = 0.4 / max(sweep.period_s for sweep in sweeps)
    band = (BAND[0] * frequency_hz, min(BAND[1] * frequency_hz, top))
    return RampsModel(sweeps, reduction_ratio, sensing, orders, band, noise)


def _search(
    sweeps: Sequence[Sweep], reduction_ratio: float, sensing: Sensing, orders: tuple[float, ...], start: Arm | None
) -> Arm:
    """The arm and the delay over a grid, the directions apart; then the delay more finely, the directions together."""
    top = 0.3 / max(sweep.period_s for sweep in sweeps)
    low, high = SEARCH_HZ[0], min(SEARCH_HZ[1], top)
    model = RampsModel(sweeps, reduction_ratio, sensing, orders, (0.8 * low, min(1.2 * high, 1.2 * top)))
    gear_fraction = GEAR_FRACTION if start is None else start.gear_fraction
    arms = [Arm(float(f), zeta, 0.0, gear_fraction) for f in np.geomspace(low, high, 56) for zeta in SEARCH_DAMPING]
    if start is not None:
        arms.append(start)
    # the motor's own motion is as late as all else: at 30 Hz a delay that is left out looks like another resonance
    best = _least_apart(model, arms, np.arange(DELAY_S[0], DELAY_S[1] + 1e-9, 4e-3))
    model = _model_around(sweeps, reduction_ratio, sensing, orders, best.resonance_hz)
    fine = [
        replace(best, resonance_hz=best.resonance_hz * float(f), damping=best.damping * z)
        for f in np.linspace(0.96, 1.04, 9)
        for z in (0.6, 1.0, 1.6)
    ]
    delays = np.arange(DELAY_S[0], DELAY_S[1] + 1e-9, 2e-3)
    best = _least_apart(model, fine, delays)
    return min((replace(best, delay_s=float(delay)) for delay in delays), key=model.power)


def _least_apart(model: RampsModel, arms: Sequence[Arm], delays_s: Real) -> Arm:
    """The arm and the delay that leave least where either direction has its own error."""
    delays = [float(delay) for delay in delays_s]
    powers = np.array([model.powers_apart(arm, delays) for arm in arms])
    row, column = divmod(int(np.argmin(powers)), len(delays))
    return replace(arms[row], delay_s=delays[column])


def _refine(model: RampsModel, start: Arm) -> Arm:
    """Gauss-Newton in ω, ζ and Δ with the linear unknowns projected out."""
    return _refined(model, start, {}, 0.0)[0]


def _refined(model: RampsModel, start: Arm, own: Mapping[float, Arm], bend_row: float) -> tuple[Arm, dict[float, Arm]]:
    """Gauss-Newton in ω, ζ, Δ, the mounting's bend where `bend_row` is not 0, and ω and ζ of every order's own arm."""
    step_s = 1.0 / (2.0 * math.pi * start.resonance_hz)
    has_bend = bend_row > 0.0

    def arms(scaled: Real) -> tuple[Arm, dict[float, Arm]]:
        delay = start.delay_s + step_s * float(scaled[2])
        bend = start.bend + (float(scaled[3]) if has_bend else 0.0)
        pairs = [(start, scaled[:2])]
        pairs += [(own[order], scaled[i : i + 2]) for order, i in zip(own, range(3 + has_bend, len(scaled), 2), strict=True)]
        made = [
            replace(
                each, resonance_hz=each.resonance_hz * float(hz), damping=each.damping * float(zeta), delay_s=delay, bend=bend
            )
            for each, (hz, zeta) in pairs
        ]
        return made[0], dict(zip(own, made[1:], strict=True))

    def residual(scaled: Real) -> Real:
        arm, others = arms(scaled)
        return np.append(model.solve(arm, others)[1], bend_row * arm.bend)

    more = len(own)
    fit = optimize.least_squares(
        residual,
        np.array([1.0, 1.0, 0.0] + has_bend * [0.0] + more * [1.0, 1.0]),
        bounds=(
            [0.8, 0.1, -1.0] + has_bend * [-LARGEST_BEND] + more * [0.8, 0.1],
            [1.25, 10.0, 1.0] + has_bend * [LARGEST_BEND] + more * [1.25, 10.0],
        ),
        x_scale=np.array([0.01, 0.3, 0.05] + has_bend * [0.01] + more * [0.01, 0.3]),
        diff_step=np.full(3 + has_bend + 2 * more, 1e-4),
    )
    return arms(fit.x)


def _bend_row(model: RampsModel, arm: Arm, left: Real) -> float:
    """Weight of what is known of the mounting beside a residual: its bend is 0 ± (f/110 Hz)²."""
    variance = float(np.sum(left**2)) / max(1.0, len(left) * model.independent)
    return math.sqrt(variance) / (arm.resonance_hz / MOUNTING_HZ) ** 2


def _without_rounding(model: RampsModel, arm: Arm, own: Mapping[float, Arm]) -> tuple[Arm, dict[float, Arm]]:
    """Arms less the bias of the encoder's rounding: the resonance amplifies its noise, so least squares damp the resonance.

    The expected power of that noise P(ω, ζ) is known, and what is minimised is the residual's power less P: steps
    −(JᵀJ)⁻¹ (Jᵀr − ∇P/2), with J the slopes of the residual r by the unknowns of the arms, the linear unknowns projected out.
    """
    found, others = arm, dict(own)
    unknowns, left = model.solve(arm, own)
    if not _is_rounding_felt(model, arm, own):
        return found, others
    bend_row = _bend_row(model, arm, left)
    for _ in range(ROUNDING_STEPS):
        unknowns, left = model.solve(found, others)
        matrix = model.columns(found, others)[1]
        slopes = np.column_stack(_slopes(model, found, others, unknowns))
        slopes = slopes - matrix @ np.column_stack([least_squares(matrix, slope) for slope in slopes.T])
        known = np.zeros((1, slopes.shape[1]))
        known[0, 3] = bend_row
        downhill = slopes.T @ left
        downhill[:2] += 0.5 * np.array(_rounding_slopes(model, found))
        downhill[3] -= bend_row**2 * found.bend
        step = _inverse(np.vstack([slopes, known])) @ downhill
        step *= min(1.0, 0.3 * found.damping / max(abs(float(step[1])), 1e-30))
        found = _shifted(found, *step[:4])
        others = {k: _shifted(each, step[4 + 2 * i], step[5 + 2 * i], *step[2:4]) for i, (k, each) in enumerate(others.items())}
        is_lost = abs(found.resonance_hz / arm.resonance_hz - 1.0) > 0.1 or abs(found.bend) > LARGEST_BEND
        if is_lost or min(each.damping for each in (found, *others.values())) < LEAST_DAMPING:
            return arm, dict(own)
    return found, others


def _is_rounding_felt(model: RampsModel, arm: Arm, own: Mapping[float, Arm]) -> bool:
    """True where the encoder's rounding is a part of what a fit leaves."""
    return model.rounding_power(arm) >= ROUNDING_FELT * float(np.sum(model.solve(arm, own)[1] ** 2))


def _rounding_slopes(model: RampsModel, arm: Arm) -> tuple[float, float]:
    """Slopes of the rounding's power by ω/2π and ζ."""
    d_hz, d_zeta = 1e-3 * arm.resonance_hz, 1e-2 * arm.damping
    by_hz = model.rounding_power(_shifted(arm, hz=d_hz)) - model.rounding_power(_shifted(arm, hz=-d_hz))
    by_zeta = model.rounding_power(_shifted(arm, damping=d_zeta)) - model.rounding_power(_shifted(arm, damping=-d_zeta))
    return by_hz / (2.0 * d_hz), by_zeta / (2.0 * d_zeta)


def _shifted(arm: Arm, hz: float = 0.0, damping: float = 0.0, late_s: float = 0.0, bend: float = 0.0) -> Arm:
    """An arm with other ω/2π, ζ, Δ and bend."""
    return replace(
        arm,
        resonance_hz=arm.resonance_hz + float(hz),
        damping=arm.damping + float(damping),
        delay_s=arm.delay_s + float(late_s),
        bend=arm.bend + float(bend),
    )


def _own_arms(model: RampsModel, arm: Arm) -> tuple[Arm, dict[float, Arm]]:
    """Arms of some orders' own, where they leave clearly less: a large vibration feels another gear than a small one."""
    unknowns, left = model.solve(arm)
    sizes = {order: math.hypot(*unknowns[2 * row : 2 * row + 2]) for row, order in enumerate(model.orders)}
    strongest = max(sizes, key=lambda order: sizes[order])
    others = [k for k, size in sizes.items() if k != strongest and k >= OWN_FROM_ORDER and size > OWN_FROM * sizes[strongest]]
    if not others:
        return arm, {}
    refined, own = _refined(model, arm, dict.fromkeys(others, arm), 0.0)
    apart = model.solve(refined, own)[1]
    is_better = float(np.sum(apart**2)) < OWN_BETTER * float(np.sum(left**2))
    return (refined, own) if is_better else (arm, {})


def _moved(
    model: RampsModel, before: tuple[Arm, Mapping[float, Arm]], after: tuple[Arm, Mapping[float, Arm]]
) -> dict[float, float]:
    """How far the unknowns of each order, as a fraction of them, went with the arms."""
    first, second = (model.solve(*arms)[0].reshape(-1, 2) for arms in (before, after))
    return {
        order: float(np.linalg.norm(second[row] - first[row]) / max(float(np.linalg.norm(second[row])), 1e-30))
        for row, order in enumerate(model.orders)
    }


def _estimate(
    model: RampsModel, arm: Arm, own: Mapping[float, Arm], factor: tuple[float, float], moved: Mapping[float, float]
) -> JointEstimate:
    """The unknowns as amplitudes and phases, with errors from the Jacobian of all unknowns."""
    unknowns, left = model.solve(arm, own)
    motion, matrix = model.columns(arm, own)
    jacobian = np.column_stack([matrix, *_slopes(model, arm, own, unknowns)])
    power = float(np.sum(left**2))
    variance = power / max(1.0, len(left) * model.independent - jacobian.shape[1])
    known = np.zeros((1, jacobian.shape[1]))
    known[0, len(unknowns) + 3] = _bend_row(model, arm, left)
    inverse = _inverse(np.vstack([jacobian, known]))
    covariance = inverse * variance
    agreement = _agreement(model, matrix, motion, variance)
    chi2 = sum(each.sigma**2 for each in agreement) / max(1, len(agreement))
    widened = math.sqrt(max(1.0, chi2))
    amplitude, phase, amplitude_error, phase_error = _polar(unknowns, covariance * widened**2, model.orders)
    length = model.block(arm.resonance_hz)
    freedom = max(1.0, length * model.independent)
    parts = {k: matrix[:, 2 * i : 2 * i + 2] @ unknowns[2 * i : 2 * i + 2] for i, k in enumerate(model.orders)}
    misfits = {order: misfit(left, part, model.signal - left, length, freedom) for order, part in parts.items()}
    for order, size in misfits.items():
        systematic = math.hypot(BEND * size, ROUNDING_LEFT * moved[order])
        amplitude_error[order] = math.hypot(amplitude_error[order], systematic * amplitude[order])
        phase_error[order] = min(180.0, math.hypot(phase_error[order], math.degrees(BEND * size)))
    arm_error = widened * np.sqrt(np.maximum(0.0, np.diag(covariance)[len(unknowns) : len(unknowns) + 3]))
    without = max(float(np.sum((model.signal - motion) ** 2)), 1e-300)
    return JointEstimate(
        TransmissionError(amplitude, phase),
        amplitude_error,
        phase_error,
        arm,
        Arm(*(float(value) for value in arm_error)),
        math.sqrt(power / len(left)),
        1.0 - power / max(float(np.sum(model.signal**2)), 1e-300),
        1.0 - power / without,
        *factor,
        agreement,
        widened,
        model.band_hz,
        own,
        misfits,
        structured_power(left, length, freedom) * len(left) / without,
    )


def _slopes(model: RampsModel, arm: Arm, own: Mapping[float, Arm], unknowns: Real) -> list[Real]:
    """Slopes of the model by ω/2π, ζ, Δ and the bend of all, then by ω/2π and ζ of each order's own arm."""
    d_hz, d_zeta, d_s = 1e-4 * arm.resonance_hz, 1e-3 * arm.damping, 1e-5

    def difference(make: Callable[[float], tuple[Arm, Mapping[float, Arm]]], step: float) -> Real:
        sides = []
        for sign in (1.0, -1.0):
            motion, matrix = model.columns(*make(sign * step))
            sides.append(motion + matrix @ unknowns)
        return np.asarray((sides[0] - sides[1]) / (2.0 * step))

    slopes = [
        difference(lambda x: (_shifted(arm, hz=x), own), d_hz),
        difference(lambda x: (_shifted(arm, damping=x), own), d_zeta),
        difference(lambda x: (_shifted(arm, late_s=x), {k: _shifted(each, late_s=x) for k, each in own.items()}), d_s),
        difference(lambda x: (_shifted(arm, bend=x), {k: _shifted(each, bend=x) for k, each in own.items()}), 1e-4),
    ]
    for order, each in own.items():
        slopes.append(difference(lambda x, k=order, e=each: (arm, {**own, k: _shifted(e, hz=x)}), d_hz))  # type: ignore[misc]
        slopes.append(difference(lambda x, k=order, e=each: (arm, {**own, k: _shifted(e, damping=x)}), d_zeta))  # type: ignore[misc]
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


def _agreement(model: RampsModel, matrix: Real, motion: Real, variance: float) -> tuple[Agreement, ...]:
    """A_k and φ_k of each direction alone."""
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
