"""Reaction of a gear's torque on its motor.

It is measured from motor torque and motor angle, and is due to the transmission error.

What goes into a gear as power comes out, so a gear whose output turns with θ_m/N + θ_sync(θ_m) loads its motor with

    τ_g (1/N + r dθ_sync/dθ_m),    r = 1 where no power is lost.

Below the arm's resonance the motor's torque has at each order k: what moves the motor, A θ_m; what moves the arm,
J_l s² X (θ_m/N + θ_sync)/N with X the response of the arm on its gear; and r τ_g dθ_sync/dθ_m, of which τ_g is the slow load of
gravity, acceleration and friction. The first two are known, and of what is left r is the part that goes with the third. How
large the arm's part is, is left open for each order, since it is the larger one as the resonance comes near.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.control.arrays import Complex, Real
from hil.design.estimation import FAR_SIGMAS, PROBABILITY
from hil.design.frequency import Loop
from hil.design.order_map import STEP, order_tracks
from hil.design.transmission_error import TransmissionError

SHOWN_OVER_RESONANCE = 0.6
"""k f_m up to which a window counts, in units of f_a: nearer, the arm's own part hides the reaction."""
SMOOTHED_S = 0.5
"""Accuracy: time to either side over which the slow load is averaged: a factor of 2 changes 0.3, errors by 9 %."""
LOSSLESS_ERROR = 0.1
"""Bound: standard deviation of the reaction of a gear from 1, that without losses; harmonic drives give back 80 to 95 %."""
REACTS = 0.5
"""Probability: prior that a gear reacts on its motor: neither is preferred."""
BLOCK = round(2.0 / STEP)
"""Windows of a block: those that overlap, and as many again. Two at least: a jackknife of one has no spread."""
ARM_MISFIT = 0.05
"""Accuracy: error of the arm's part, as a fraction of it, so far may the arm's response be wrong: a factor of 2 changes 0.05,
errors by 1 %."""


@dataclass(frozen=True)
class MotorSide:
    """Known values of a motor and the arm that it moves.

    Attributes:
        reduction_ratio: N.
        motor_inertia_kg_m2: J_m.
        motor_damping_nm_s_rad: D_m.
        coulomb_friction_nm: τ_C.
        torque_lag_s: Lag of the current loop.
        arm_inertia_kg_m2: J_l.
        antiresonance_hz: f_a.
        damping: ζ.
    """

    reduction_ratio: float
    motor_inertia_kg_m2: float
    motor_damping_nm_s_rad: float
    coulomb_friction_nm: float
    torque_lag_s: float
    arm_inertia_kg_m2: float
    antiresonance_hz: float
    damping: float


@dataclass(frozen=True)
class SlowMotion:
    """Motion of a motor and its gear's load without vibration.

    Attributes:
        speed_rad_s: Motor speed; shape (n,).
        load_nm: Torque τ_g of the gear, that of gravity and acceleration; shape (n,).
    """

    speed_rad_s: Real
    load_nm: Real


@dataclass(frozen=True)
class Turning:
    """Motion of the motor.

    Attributes:
        motor_angle_rad: θ_m, equally spaced; shape (n,).
        torque_nm: Motor torque, sampled with it; shape (n,).
    """

    motor_angle_rad: Real
    torque_nm: Real
    period_s: float

    def slow(self, known: MotorSide) -> SlowMotion:
        """Motion and load averaged over `SMOOTHED_S` to either side."""
        width = max(1, round(SMOOTHED_S / self.period_s))
        speed = np.gradient(self.motor_angle_rad, self.period_s)
        slow_speed, slow_torque = averaged(speed, width), averaged(self.torque_nm, width)
        acceleration = averaged(np.gradient(speed, self.period_s), width)
        own = known.motor_inertia_kg_m2 * acceleration + known.motor_damping_nm_s_rad * slow_speed
        friction = known.coulomb_friction_nm * np.sign(slow_speed)
        return SlowMotion(slow_speed, known.reduction_ratio * (slow_torque - own - friction))


@dataclass(frozen=True)
class Reaction:
    """Reaction r with its standard error."""

    value: float
    standard_error: float

    @property
    def is_neither(self) -> bool:
        """True if the value is that of no gear, whether it reacts or not."""
        far = FAR_SIGMAS * math.hypot(self.standard_error, LOSSLESS_ERROR)
        return abs(self.value - 1.0) > far and abs(self.value) > FAR_SIGMAS * self.standard_error

    def probability(self, before: float = REACTS) -> float:
        """Posterior probability that the gear reacts on its motor.

        r is that of a gear almost without losses if it does, and 0 if it does not.
        """

        def log_density(mean: float, sigma: float) -> float:
            return -0.5 * ((self.value - mean) / sigma) ** 2 - math.log(sigma)

        odds = log_density(1.0, math.hypot(self.standard_error, LOSSLESS_ERROR)) - log_density(0.0, self.standard_error)
        return float(scipy.special.expit(odds + scipy.special.logit(before)))

    def posterior(self, before: float = REACTS) -> "Reaction":
        """Posterior mean of r with its standard deviation.

        A value that is that of no gear says nothing of one: the prior stays.
        """
        if self.is_neither:
            return Reaction(before, math.sqrt(before * (1.0 - before)))
        reacts = self.probability(before)
        if reacts < 1.0 - PROBABILITY:
            return Reaction(0.0, self.standard_error)
        measured, known = self.standard_error**-2, LOSSLESS_ERROR**-2
        there = (measured * self.value + known) / (measured + known)
        square = reacts * (1.0 / (measured + known) + there**2) - (reacts * there) ** 2
        return Reaction(reacts * there, math.sqrt(square))


def felt_as(loop: Loop, order: float, frequency_hz: Real, way: Real, load_nm: Real) -> Complex:
    """Correction that a whole reaction equals, as a fraction of the error.

    q/A = j k τ_g/(N (J_m s² + D_m s + C)) of an order k, C being the law: so far the reaction's torque turns the motor.

    Args:
        loop: Law and motor.
        frequency_hz: Frequency k f_m above 0; shape (n,).
        way: Direction of turning, of which the sign counts; shape (n,).
        load_nm: Torque τ_g of the gear; shape (n,).
    """
    stiff = loop.plant.terms(2j * math.pi * frequency_hz)[0] + loop.controller(frequency_hz)
    stiff = np.where(way < 0.0, stiff.conj(), stiff)  # backwards time runs against the angle
    return np.asarray(1j * order * load_nm / (loop.plant.reduction_ratio * stiff))


def gear_reaction(motions: Sequence[Turning], known: MotorSide, error: TransmissionError) -> Reaction | None:
    """Estimate the reaction r with its standard error.

    Returns None if no motion turns slowly enough to show it.
    """
    orders = tuple(order for order, size in error.amplitude_arcsec.items() if size > 0.0)
    if not orders:
        return None
    parts: list[_Windows] = []
    for motion in motions:
        try:
            parts += _windows(motion, known, error, orders)
        except ValueError:  # it never turns far enough one way
            continue
    if sum(len(part.left) for part in parts) < 2 * BLOCK:
        return None
    return _fitted(parts, len(orders))


@dataclass(frozen=True)
class _Windows:
    """Windows of one order, direction and motion, by speed.

    Torque that is left, slow load times slope, and the arm's part, in N·m at the motor; standard error; row of the order.
    """

    left: Complex
    load: Complex
    arm: Complex
    sigma: Real
    row: int


def _fitted(parts: Sequence[_Windows], count: int) -> Reaction:
    """Fit r by weighted least squares, with complex factors of the arm's parts.

    The residual is not white noise, and windows overlap, so the standard error is that of the jackknife over blocks of windows:
    few blocks leave no more of their error in the residual than their factors allow.

    Source: B. Efron, The Jackknife, the Bootstrap and Other Resampling Plans, SIAM 1982, chapter 3.
    """
    squares, products = [], []
    for part in parts:
        columns = np.zeros((len(part.left), 1 + 2 * count), dtype=np.complex128)
        columns[:, 0], columns[:, 1 + 2 * part.row], columns[:, 2 + 2 * part.row] = part.load, part.arm, 1j * part.arm
        columns, wanted = columns / part.sigma[:, None], part.left / part.sigma
        for first in range(0, len(wanted), BLOCK):
            block, value = columns[first : first + BLOCK], wanted[first : first + BLOCK]
            squares.append((block.conj().T @ block).real)
            products.append((block.conj().T @ value).real)
    square, product = np.sum(squares, axis=0), np.sum(products, axis=0)
    found = float((np.linalg.pinv(square, hermitian=True) @ product)[0])
    without = np.array([
        (np.linalg.pinv(square - one, hermitian=True) @ (product - other))[0]
        for one, other in zip(squares, products, strict=True)
    ])  # fmt: skip
    variance = float(np.mean((without - found) ** 2)) * (len(without) - 1)
    return Reaction(found, max(math.sqrt(variance), 1e-9))


def _windows(motion: Turning, known: MotorSide, error: TransmissionError, orders: Sequence[float]) -> list[_Windows]:
    """Windows of each order and direction below the resonance."""
    angle, period_s, n = motion.motor_angle_rad, motion.period_s, known.reduction_ratio
    phase = {k: math.radians(error.phase_deg[k]) for k in orders}
    size = {k: error.amplitude_arcsec[k] / 3600.0 * math.pi / 180.0 for k in orders}
    acceleration, slow_load = np.gradient(np.gradient(angle, period_s), period_s), motion.slow(known).load_nm
    slope = -np.sum([k * size[k] * np.sin(k * angle + phase[k]) for k in orders], axis=0)
    signals = (motion.torque_nm, acceleration, slow_load * slope)
    torque, moved, loaded = order_tracks(angle, signals, period_s, orders)
    parts: list[_Windows] = []
    for row, k in enumerate(orders):
        jw = 2j * math.pi * k * torque.speed_rps
        back = torque.direction < 0.0

        def in_time(values: Complex, back: NDArray[np.bool_] = back) -> Complex:
            """Components by time of those by angle, conjugated where it turns backwards."""
            return np.asarray(np.where(back, values.conj(), values), dtype=np.complex128)

        seen = in_time(torque.component[:, row]) / (1.0 + known.torque_lag_s * jw)
        motor = in_time(moved.component[:, row])
        sync = in_time(np.full(len(jw), size[k] * np.exp(1j * phase[k])))
        omega = 2.0 * math.pi * known.antiresonance_hz
        response = (2.0 * known.damping * omega * jw + omega**2) / (jw**2 + 2.0 * known.damping * omega * jw + omega**2)
        arm = known.arm_inertia_kg_m2 * jw**2 * response / n
        of_motor = (known.motor_inertia_kg_m2 + known.motor_damping_nm_s_rad / jw) * motor + arm * motor / jw**2 / n
        used = (k * torque.speed_rps <= SHOWN_OVER_RESONANCE * known.antiresonance_hz) & np.isfinite(seen) & np.isfinite(motor)
        left, load, of_arm = seen - of_motor, in_time(loaded.component[:, row]), arm * sync
        sigma = np.hypot(torque.standard_error[:, row], ARM_MISFIT * np.abs(of_arm)) + 1e-12
        parts += [_Windows(left[way], load[way], of_arm[way], sigma[way], row) for way in (used & back, used & ~back)]
    return parts


def averaged(values: Real, width: int) -> Real:
    """Running mean over 2 width + 1 samples, the ends held."""
    padded = np.concatenate([np.full(width, values[0]), values, np.full(width, values[-1])])
    sums = np.cumsum(np.concatenate([[0.0], padded]))
    return np.asarray((sums[2 * width + 1 :] - sums[: -2 * width - 1]) / (2 * width + 1))
