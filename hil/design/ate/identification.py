"""Transmission error, arm and sensor delay from ramps in both directions.

Every value has a standard error.

Given the measured motor angle θ_m, the arm's motion follows without any knowledge of the controller. A sensor that lags θ_m by Δ
sees

    y(t) = e^{−sΔ} (g H(s) [θ_m/N + Σ A_k cos(k θ_m + φ_k)]'' + J θ̈_m),      H(s) = (2 ζ_g ω s + ω²)/(s² + 2 ζ ω s + ω²),

with H the arm on its gear, the motor held (ω² = K_g/J_l, 2 ζ_g ω = D_g/J_l, 2 ζ ω = (D_g + D_l)/J_l), y the tip acceleration, g
the tip lever and J = 0; or, without an accelerometer, y the motor torque, g = J_l/N and J = J_m, since the motor feels τ_g/N of
its gear with τ_g = J_l H(s) [θ_m/N + θ_sync]'' (D_l = 0). The model is linear in A_k cos φ_k and A_k sin φ_k, all orders jointly:
k = 2 alone biases A₂ by a quarter, since the two lines share the resonance. ω, ζ and Δ are refined around them. With an
accelerometer only the lever of the arm must be known.

Both directions are needed: turning backwards, φ_k appears with the opposite sign, while Δ and all phase of H keep theirs. One
direction cannot tell φ_k from a delay (4.3° for each millisecond at 12 Hz), two can. The gear's part of the damping (ζ_g) is
such a phase too: 1 + 2 ζ_g s/ω ≈ e^{2 ζ_g s/ω}. An error in it goes into Δ and not into φ_k.

Source: the paper, section 3.2.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from hil.control.angles import ARCSEC
from hil.control.arrays import Real
from hil.control.order_keys import amplitude_key, order_keys, phase_key
from hil.design.ate.gear import GearLaw
from hil.design.ate.misfit import misfit, noise_variance, structured_power
from hil.design.ate.model import BAND, GEAR_FRACTION, Arm, Noise, RampsModel, Sensing, Sweep, least_squares
from hil.design.ate.motion import motion_factor
from hil.design.ate.refinement import bend_weight, refined, slopes_by_arm, without_rounding
from hil.design.estimate import Estimate
from hil.design.estimation import EstimatedParameter, inverse
from hil.design.ringing import DAMPINGS
from hil.design.transmission_error import PAPER_ORDERS, TransmissionError

SEARCH_HZ = (4.0, 35.0)
"""Bound: resonances among which an unknown arm is searched: arms ring at 4 to 30 Hz."""
DELAYS = 11
"""Accuracy: delays of a search over arm and delay: a factor of 2 changes nothing."""
FINE_DELAYS = 2 * DELAYS - 1
"""The same of the one for the delay alone, half as far apart."""
SPRING_MISS = 0.01
"""Measured: part of its vibration that an arm on a spring misses at most: on 14 drawn robots (10700, 10712, 10730, 10735, 10740
to 10749) the gear that is found misses 0.0003, and 0.002 on one."""
UNSHARED = 0.25
"""Measured: part of the missed part's square that directions do not share.

Only that turns φ_k: a shift of time turns it one way forwards, the other way backwards. On the robots 50201 to 50400 the rms of z
of φ_k is 0.84 to 1.01 with it, 0.50 to 0.81 with 1."""
OF_ONE_WAY, ALL_OF_ARM = 2, 4
"""Bound: unknowns of an arm that one direction tells, ω and ζ, and all with delay and bend."""
DELAY_KEY = "accelerometer_delay_s"
ARM_KEYS = ("arm_hz", "damping")
"""Name of the sensor's delay among the values of an estimate."""
LEAST_SIZE_RAD = 1e-3 * ARCSEC
"""Amplitude below which an order has no phase."""
BOTH_WAYS: Mapping[int, str] = MappingProxyType({1: "forwards", -1: "backwards"})
"""Directions of ramps, in words."""


@dataclass(frozen=True)
class Agreement:
    """Value from each direction alone, with arm and delay of both.

    Attributes:
        name: `a2_arcsec`, `phi2_deg` …
        sigma: Difference of both over the standard error that noise gives it.
    """

    name: str
    forward: float
    backward: float
    sigma: float

    @property
    def words(self) -> str:
        """Both values with symbol and unit, as messages and reports have them."""
        is_phase = self.name.startswith("phi")
        order = self.name.removeprefix("phi" if is_phase else "a").partition("_")[0]
        symbol, unit = ("φ", "°") if is_phase else ("A", "″")
        return f"{symbol}_{order} is {self.forward:.2f}{unit} forwards and {self.backward:.2f}{unit} backwards"


@dataclass(frozen=True)
class JointEstimate:
    """Estimate of A_k, φ_k, arm and delay from ramps in both directions.

    The standard errors contain noise and what the model misses of the vibration. They know nothing of a wrong lever arm, which
    goes straight into A_k, nor of a wrong zero of the motor angle, which goes into φ_k.

    Attributes:
        values: A_k in arcsec and φ_k in degrees (0 ≤ φ_k < 360°) of each order, and the sensor's delay if the arm was simulated
            on its gear, by the model file's names.
        arm: Arm with its ω, ζ and the delay Δ.
        residual: Root mean square of the residual in the band, in the signal's unit.
        explained: Fraction of the signal's band-passed power that the model explains, 0 … 1.
        explained_by_error: Fraction by which θ_sync lowers the residual power of a model without it.
        motion_scale: Factor that the motor's own motion has in the signal, 1 where N and g are right; estimated beside the rest.
        miss: Part of the strongest order's vibration that the model misses.
        structured: Fraction of the signal without the motor's own motion that neither θ_sync nor noise explains.
        gear: The gear on which the arm was simulated; None for a linear one.
        torsion_rad: Amplitude of the gear's torsion for which its f_a and ζ hold: the largest of the ramps; None without a gear.
    """

    orders: tuple[float, ...]
    values: Estimate
    arm: Arm
    arm_error: Arm
    residual: float
    explained: float
    explained_by_error: float
    motion_scale: float
    motion_scale_error: float
    agreement: tuple[Agreement, ...]
    band_hz: tuple[float, float]
    miss: float = 0.0
    structured: float = 0.0
    gear: GearLaw | None = None
    torsion_rad: float | None = None

    @cached_property
    def error(self) -> TransmissionError:
        """A_k and φ_k."""
        amplitudes = {order: self.values.value(amplitude_key(order)) for order in self.orders}
        return TransmissionError(amplitudes, {order: self.values.value(phase_key(order)) for order in self.orders})

    @cached_property
    def amplitude_error_arcsec(self) -> dict[float, float]:
        """Standard error of A_k by order."""
        return {order: self.values.standard_error(amplitude_key(order)) for order in self.orders}

    @cached_property
    def phase_error_deg(self) -> dict[float, float]:
        """Standard error of φ_k by order."""
        return {order: self.values.standard_error(phase_key(order)) for order in self.orders}

    @property
    def of_gear(self) -> dict[str, EstimatedParameter]:
        """Δ, f_a and ζ of the simulated gear, by the model file's names; empty without one."""
        names = [name for name in (DELAY_KEY, *ARM_KEYS) if name in self.values.names]
        return {name: EstimatedParameter(self.values.value(name), self.values.standard_error(name)) for name in names}

    @property
    def is_spring(self) -> bool:
        """False if the gear is nonlinear, or bends the vibration visibly."""
        return self.miss <= SPRING_MISS if self.gear is None else self.gear.is_linear


def identify(
    sweeps: Sequence[Sweep],
    reduction_ratio: float,
    sensing: Sensing,
    start: Arm | None = None,
    orders: Sequence[float] = PAPER_ORDERS,
    *,
    is_near: bool = False,
) -> JointEstimate:
    """Estimate A_k, φ_k, arm and sensor delay from ramps in both directions.

    Args:
        sweeps: Recordings with at least one ramp in each direction, through the resonance with every order.
        sensing: The kind of signal in the recordings.
        start: An arm to start from beside those searched over `SEARCH_HZ`; it may be wrong.
        is_near: True for a start from an estimate of most of these recordings: nothing is searched.

    Raises:
        ValueError: A direction is missing or too short, or shapes differ.

    Source: the paper, section 3.2.
    """
    _check(sweeps, tuple(orders))
    arm = start if is_near and start is not None else searched(sweeps, reduction_ratio, sensing, [orders], start)[0]
    noise, weights, like = None, None, None
    for _ in range(2):  # the band follows the arm, and the weights the noise
        model = like = _model_around(sweeps, reduction_ratio, sensing, tuple(orders), arm.resonance_hz, noise, weights, like)
        arm = refined(model, arm)
        noise, weights = model.noise(arm), weights or model.weights(arm)
    arm = _without_rounding(model, arm)
    model = _model_around(sweeps, reduction_ratio, sensing, tuple(orders), arm.resonance_hz, model.noise(arm), weights, model)
    arm = _without_rounding(model, arm)
    factor = motion_factor(sweeps, reduction_ratio, sensing, orders, arm)
    return _estimate(model, arm, factor)


def _without_rounding(model: RampsModel, arm: Arm) -> Arm:
    """Refine all of an arm, and remove the bias of the encoder's rounding."""
    return without_rounding(model, refined(model, arm, ALL_OF_ARM, bend_weight(model, arm, model.solve(arm)[1])))


def identify_one_way(
    sweep: Sweep, reduction_ratio: float, sensing: Sensing, start: Arm, orders: Sequence[float] = PAPER_ORDERS
) -> JointEstimate:
    """Estimate A_k, φ_k, ω and ζ from a ramp in one direction.

    One direction cannot tell φ_k from the sensor's delay, which is taken to be known.

    `start` is an arm near the true one, with the delay.

    Raises:
        ValueError: The ramp is too short, or shapes differ.
    """
    _check([sweep], tuple(orders), {1: "forwards"})
    model = _model_around([sweep], reduction_ratio, sensing, tuple(orders), start.resonance_hz)
    return _estimate(model, refined(model, start, OF_ONE_WAY), (1.0, 0.0), OF_ONE_WAY)


def _check(sweeps: Sequence[Sweep], orders: tuple[float, ...], directions: Mapping[int, str] = BOTH_WAYS) -> None:
    for sweep in sweeps:
        shapes = {np.shape(sweep.motor_angle_rad), np.shape(sweep.signal), np.shape(sweep.direction)}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise ValueError(f"motor angle, signal and direction have shapes {sorted(shapes)}; all must be the same (n,)")
    needed = 0.06 * (2 * len(orders) + 3)
    for direction, word in directions.items():
        seconds = sum(float(np.count_nonzero(sweep.direction == direction)) * sweep.period_s for sweep in sweeps)
        if seconds < needed:
            raise ValueError(
                f"{seconds:.2f} s of ramps {word} are too short for {2 * len(orders) + 3} values; {needed:.2f} s are needed: "
                "accelerate less, or identify fewer orders"
            )


def _model_around(
    sweeps: Sequence[Sweep],
    reduction_ratio: float,
    sensing: Sensing,
    orders: tuple[float, ...],
    frequency_hz: float,
    noise: Noise | None = None,
    weights: Sequence[float] | None = None,
    like: RampsModel | None = None,
) -> RampsModel:
    top = 0.4 / max(sweep.period_s for sweep in sweeps)
    band = (BAND[0] * frequency_hz, min(BAND[1] * frequency_hz, top))
    return RampsModel(sweeps, reduction_ratio, sensing, orders, band, noise, weights, like=like)


def searched(
    sweeps: Sequence[Sweep],
    reduction_ratio: float,
    sensing: Sensing,
    choices: Sequence[Sequence[float]],
    start: Arm | None = None,
) -> list[Arm]:
    """Search arm and delay over a grid, for each choice of orders."""
    orders = tuple(dict.fromkeys(order for choice in choices for order in choice))
    top = 0.3 / max(sweep.period_s for sweep in sweeps)
    low, high = SEARCH_HZ[0], min(SEARCH_HZ[1], top)
    band = (0.8 * low, min(1.2 * high, 1.2 * top))
    # beyond twice the band the filter passes a sixteenth at most: enough to choose between arms
    model = RampsModel(sweeps, reduction_ratio, sensing, orders, band, kept_bands=2.0)
    gear_fraction = GEAR_FRACTION if start is None else start.gear_fraction
    if start is not None and start.others:  # with the other modes as they are known only this one's neighbourhood is left
        low, high = 0.9 * start.resonance_hz, min(1.1 * start.resonance_hz, top)
    others = () if start is None else start.others
    arms = [Arm(float(f), z, 0.0, gear_fraction, 0.0, others) for f in np.geomspace(low, high, 56) for z in DAMPINGS[1:-1]]
    if start is not None:
        arms.append(start)
    # the motor's own motion is as late as all else: at 30 Hz a delay that is left out looks like another resonance
    likely = _least_apart(model, arms, np.linspace(sensing.delay_from_s, sensing.delay_to_s, DELAYS), choices)
    delays, found = np.linspace(sensing.delay_from_s, sensing.delay_to_s, FINE_DELAYS), []
    for choice, best in zip(choices, likely, strict=True):
        model = _model_around(sweeps, reduction_ratio, sensing, tuple(choice), best.resonance_hz)
        fine = [
            replace(best, resonance_hz=best.resonance_hz * float(f), damping=best.damping * z)
            for f in np.linspace(0.96, 1.04, 9)
            for z in (0.6, 1.0, 1.6)
        ]
        (best,) = _least_apart(model, fine, delays, [choice])  # noqa: PLW2901 - nearer
        found.append(min((replace(best, delay_s=float(delay)) for delay in delays), key=model.power))
    return found


def _least_apart(model: RampsModel, arms: Sequence[Arm], delays_s: Real, choices: Sequence[Sequence[float]]) -> list[Arm]:
    """Choose arm and delay with the least residual, directions apart, for each choice of the model's orders."""
    delays = [float(delay) for delay in delays_s]
    powers = np.array([[model.powers_apart(arm, delays, choice) for choice in choices] for arm in arms])
    best = [divmod(int(np.argmin(each)), len(delays)) for each in powers.swapaxes(0, 1)]
    return [replace(arms[row], delay_s=delays[column]) for row, column in best]


def with_arm(
    estimate: JointEstimate, sweeps: Sequence[Sweep], reduction_ratio: float, sensing: Sensing, arm: Arm
) -> JointEstimate:
    """Replace the arm of an estimate, with the delay, A_k and φ_k that suit it best.

    The standard errors stay; the delay of the arm is searched.
    """
    model = _model_around(sweeps, reduction_ratio, sensing, estimate.orders, arm.resonance_hz)
    delays = np.linspace(sensing.delay_from_s, sensing.delay_to_s, FINE_DELAYS)
    best = min((replace(arm, delay_s=float(delay)) for delay in delays), key=model.power)
    unknowns = model.solve(best)[0]
    found = polar(estimate.orders, unknowns, np.zeros((len(unknowns), len(unknowns)))).mean
    return replace(estimate, arm=best, values=replace(estimate.values, mean=found))


def _estimate(model: RampsModel, arm: Arm, factor: tuple[float, float], free: int = ALL_OF_ARM) -> JointEstimate:
    """Convert the unknowns to amplitudes and phases, with errors.

    The covariance is that of least squares under the noise that the residual has where the vibration is weak, and where it is
    strong: (JᵀJ)⁻¹ JᵀSJ (JᵀJ)⁻¹ with the Jacobian J of all unknowns, of which the arm's first `free` ones are.
    """
    unknowns, left = model.solve(arm)
    motion, matrix = model.columns(arm)
    jacobian = np.column_stack([matrix, slopes_by_arm(model, arm, unknowns)[:, :free]])
    power, count, lost = float(np.sum(left**2)), len(unknowns), jacobian.shape[1]
    length = model.block(arm.resonance_hz)
    freedom = max(1.0, length * model.independent)
    parts = [matrix[:, row : row + 2] @ unknowns[row : row + 2] for row in range(0, count, 2)]
    whole, rest = model.split(model.signal - left), model.split(left)
    misses = np.array([misfit(rest, model.split(part), whole, length, freedom) for part in parts])
    known = np.zeros(lost)
    known[-1] = bend_weight(model, arm, left) ** 2 if free == ALL_OF_ARM else 0.0
    lost_samples = len(left) / max(1.0, len(left) - lost / model.independent)
    variance = lost_samples / model.independent * np.concatenate([noise_variance(each, length, freedom) for each in rest])
    solved = inverse(jacobian.T @ jacobian + np.diag(known))
    noise = jacobian.T @ (variance[:, np.newaxis] * jacobian) + np.diag(known) * float(np.mean(variance))
    covariance = solved @ noise @ solved
    miss = float(misses[np.argmax(np.hypot(unknowns[::2], unknowns[1::2]))])
    # a part τ of a resonance may be a shift of it by τ ζ ω, a change of ζ by τ ζ, or a delay of τ/ω
    shift = miss * np.array([arm.damping * arm.resonance_hz, arm.damping, 0.5 / (math.pi * arm.resonance_hz)])[:free]
    errors = np.zeros(3)
    errors[:free] = np.sqrt(np.maximum(0.0, np.diag(covariance)[count : count + 3]) + shift**2)
    hz, zeta, delay_s = errors.tolist()
    without = max(float(np.sum((model.signal - motion) ** 2)), 1e-300)
    return JointEstimate(
        model.orders,
        polar(model.orders, unknowns, covariance[:count, :count] + missed(unknowns, misses)),
        arm,
        Arm(hz, zeta, delay_s),
        math.sqrt(power / len(left)),
        1.0 - power / max(float(np.sum(model.signal**2)), 1e-300),
        1.0 - power / without,
        *factor,
        _agreement(model, matrix, motion, float(np.mean(variance))) if free == ALL_OF_ARM else (),
        model.band_hz,
        miss,
        structured_power(rest, length, freedom) * len(left) / without,
    )


def missed(components: Real, misses: Real) -> Real:
    """Covariance of A_k cos φ_k and A_k sin φ_k by the missed part of the vibration.

    As a variance of the residual it averages out over a ramp; an error of the model need not.
    """
    square = np.zeros((len(components),) * 2)
    for row, miss in zip(range(0, len(components), 2), misses.tolist(), strict=True):
        c, s = components[row : row + 2]
        square[row : row + 2, row : row + 2] = miss**2 * (np.outer([c, s], [c, s]) + UNSHARED * np.outer([-s, c], [-s, c]))
    return square


def polar(orders: Sequence[float], components: Real, covariance: Real, others: tuple[str, ...] = ()) -> Estimate:
    """A_k in arcsec and φ_k in degrees of each order, by the model file's names.

    Args:
        orders: Orders k; n of them.
        components: A_k cos φ_k and A_k sin φ_k of each in rad, and m other quantities, which stay; shape (2 n + m,).
        covariance: Their covariance; shape (2 n + m, 2 n + m).
    """
    mean, slope = components.copy(), np.eye(len(components))
    for at in range(0, 2 * len(orders), 2):
        x, y = components[at : at + 2]
        size, turned = math.hypot(x, y), math.atan2(y, x)
        mean[at : at + 2] = size / ARCSEC, math.degrees(turned) % 360.0
        slope[at, at : at + 2] = np.array([math.cos(turned), math.sin(turned)]) / ARCSEC
        slope[at + 1, at : at + 2] = np.degrees([-math.sin(turned), math.cos(turned)]) / max(size, LEAST_SIZE_RAD)
    return _turned_at_most(Estimate((*order_keys(orders), *others), mean, slope @ covariance @ slope.T))


def _turned_at_most(values: Estimate) -> Estimate:
    """Limit the standard error of each phase to half a turn, of which nothing is known then."""
    errors = np.sqrt(np.maximum(np.diag(values.covariance), 0.0))
    is_wide = (errors > 180.0) & [name.startswith("phi") for name in values.names]
    factors = np.where(is_wide, 180.0 / np.maximum(errors, 180.0), 1.0)
    return replace(values, covariance=values.covariance * np.outer(factors, factors))


def _agreement(model: RampsModel, matrix: Real, motion: Real, variance: float) -> tuple[Agreement, ...]:
    """A_k and φ_k of each direction alone."""
    sides = []
    for direction in (1, -1):
        rows = model.directions == direction
        own = matrix[rows]
        sides.append(polar(model.orders, least_squares(own, (model.signal - motion)[rows]), inverse(own.T @ own) * variance))
    forward, backward = sides
    off = forward.mean - backward.mean
    off[1::2] = (off[1::2] + 180.0) % 360.0 - 180.0
    sigmas = np.abs(off) / np.maximum(np.sqrt(np.diag(forward.covariance + backward.covariance)), 1e-30)
    numbers = zip(forward.names, *(each.tolist() for each in (forward.mean, backward.mean, sigmas)), strict=True)
    return tuple(Agreement(*each) for each in numbers)
