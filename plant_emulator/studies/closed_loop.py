"""One axis and its loop, linearised.

The module finds the decay or growth of the slowest motion of the closed loop. `hil.design.frequency` has the paper's axis; here
are soft wind-up, hysteresis and the lag of the current loop, and many speeds at once.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from hil.control.angles import ARCSEC
from hil.control.cascade import Cascade
from hil.control.notch import NOTCH_OFF, NOTCHES, Notch, notch_coefficients, notch_weight
from hil.design.frequency import TwoInertia
from plant_emulator.robots.robot import RobotAxis

Real = NDArray[np.float64]
Block = tuple[Real, Real, Real, float]
"""A (n × n), b (n,), c (n,) and d of a discrete block with one input and one output."""


def linear_plant(axis: RobotAxis) -> TwoInertia:
    """Return the linear part of an axis."""
    return TwoInertia(**{each.name: getattr(axis, each.name) for each in fields(TwoInertia)})


@dataclass(frozen=True)
class Law:
    """The law of one axis with frozen filters.

    It leads from the motor angle to −torque; the filters are frozen at each of some motor speeds.

    Attributes:
        a: Shape (speeds, n, n).
        b: Shape (speeds, n).
        c: Shape (speeds, n).
        d: Shape (speeds,).
        period_s: Its sampling time.
    """

    a: Real
    b: Real
    c: Real
    d: Real
    period_s: float


def frozen_law(cascade: Cascade, notches: Sequence[Notch], speeds_rps: Iterable[float], period_s: float) -> Law:
    """Return the law at each speed.

    Filters that do not act there pass everything.

    Args:
        cascade: Gains.
        notches: Filters, at most `NOTCHES`.
        speeds_rps: Motor speeds; shape (speeds,).
        period_s: Sampling time of the law.
    """
    found = [_law_at(cascade, notches, float(speed), period_s) for speed in speeds_rps]
    a, b, c, d = zip(*found, strict=True)
    return Law(np.array(a), np.array(b), np.array(c), np.array(d), period_s)


def _law_at(cascade: Cascade, notches: Sequence[Notch], speed_rps: float, period_s: float) -> Block:
    """Return the law at one speed as blocks in series.

    It is (K_vp + K_vi/s)(K_pp + F_lp s) F_n, all bilinear; expanded it would lose its digits near z = 1.
    """
    c, w = 2.0 / period_s, 2.0 * math.pi * cascade.lowpass_hz
    pole, gain = (c - w) / (c + w), w * c / (c + w)
    ki = cascade.velocity_integral_gain_nm_rad * period_s
    one = np.ones((1, 1))
    whole: Block = (pole * one, np.ones(1), np.array([gain * (pole - 1.0)]), gain + cascade.position_gain_per_s)
    whole = _series(whole, (one, np.ones(1), np.array([ki]), cascade.velocity_gain_nm_s_rad + 0.5 * ki))
    for number in range(NOTCHES):
        values = _acting(notches[number], speed_rps, period_s) if number < len(notches) else None
        b0, b1, b2, a1, a2 = values or (1.0, 0.0, 0.0, 0.0, 0.0)
        block = (np.array([[-a1, -a2], [1.0, 0.0]]), np.array([1.0, 0.0]), np.array([b1 - a1 * b0, b2 - a2 * b0]), b0)
        whole = _series(whole, block)
    return whole


def _acting(notch: Notch, speed_rps: float, period_s: float) -> tuple[float, float, float, float, float] | None:
    """Return a filter's coefficients at a speed; None if inactive."""
    if notch.mode == NOTCH_OFF or not notch.start_rps <= speed_rps <= notch.end_rps:
        return None
    weight = notch_weight(notch.mode, speed_rps, notch.start_rps, notch.end_rps, notch.ramp_rps)
    zero_hz = notch.order * speed_rps
    zeta_rd = notch.zeta_rn + weight * (notch.zeta_rdth - notch.zeta_rn)
    return notch_coefficients(zero_hz, zero_hz + weight * notch.offset_hz, notch.zeta_rn, zeta_rd, period_s)


def _series(first: Block, second: Block) -> Block:
    """Return two blocks in series, `second` after the first."""
    (a1, b1, c1, d1), (a2, b2, c2, d2) = first, second
    a = np.block([[a1, np.zeros((len(b1), len(b2)))], [np.outer(b2, c1), a2]])
    return a, np.concatenate([b1, b2 * d1]), np.concatenate([d2 * c1, c2]), d2 * d1


def growth_per_s(axis: RobotAxis, law: Law) -> float:
    """Return the closed loop's fastest growth, in 1/s.

    It is the largest ln |z|/T_s of the poles over the law's speeds; below 0 everything decays.

    Friction, gravity and the ATE's own slope are left out. The gear is evaluated at each of its stiffnesses: K_g, K_g less
    soft wind-up near no torsion, and K_g plus the F/ψ_h of hysteresis for small motions.
    """
    full = axis.gear_stiffness_nm_rad
    stiffnesses = {full, full * (1.0 - axis.wind_up_softness)}
    stiffnesses.add(full + axis.hysteresis_torque_nm / (axis.hysteresis_torsion_arcsec * ARCSEC))
    largest = max(_radius(axis, stiffness, law) for stiffness in sorted(stiffnesses))
    return math.log(largest) / law.period_s


def _radius(axis: RobotAxis, stiffness_nm_rad: float, law: Law) -> float:
    """Return the largest |z| over all speeds for one stiffness."""
    plant, drive = _discrete_plant(axis, stiffness_nm_rad, law.period_s)
    n, m = len(drive), law.b.shape[1]
    closed = np.zeros((len(law.d), n + m, n + m))
    closed[:, :n, :n] = plant
    closed[:, :n, 0] -= law.d[:, np.newaxis] * drive
    closed[:, :n, n:] = -drive[:, np.newaxis] * law.c[:, np.newaxis, :]
    closed[:, n:, 0] = law.b
    closed[:, n:, n:] = law.a
    return float(np.max(np.abs(np.linalg.eigvals(closed))))


def _discrete_plant(axis: RobotAxis, stiffness_nm_rad: float, period_s: float) -> tuple[Real, Real]:
    """Return A and B over one period, exactly.

    The torque command is held. The states are θ_m, θ̇_m, N θ_l, N θ̇_l, and τ if it lags.
    """
    n2 = axis.reduction_ratio**2
    k, d = stiffness_nm_rad / n2, axis.gear_damping_nm_s_rad / n2
    jm, jl, dl = axis.motor_inertia_kg_m2, axis.arm_inertia_kg_m2 / n2, axis.arm_damping_nm_s_rad / n2
    lag = axis.current_time_constant_s
    count = 5 if lag > 0.0 else 4
    rates = np.zeros((count + 1, count + 1))  # the command is the last
    rates[0, 1] = rates[2, 3] = 1.0
    rates[1, :4] = -k / jm, -(d + axis.motor_damping_nm_s_rad) / jm, k / jm, d / jm
    rates[3, :4] = k / jl, d / jl, -k / jl, -(d + dl) / jl
    rates[1, 4] = 1.0 / jm  # of the torque: the command itself, or the fifth state behind it
    if lag > 0.0:
        rates[4, 4], rates[4, 5] = -1.0 / lag, 1.0 / lag
    step = _exponential(rates * period_s)
    return step[:count, :count], step[:count, count]


def _exponential(a: Real) -> Real:
    """Return e^A of a small matrix.

    It is the Taylor series to the 14th order of A/2ⁿ with a norm below 1/2, squared n times.

    scipy's function uses all threads of the linear algebra: 7 ms on a busy machine, instead of 50 µs.
    """
    squarings = max(0, math.frexp(float(np.max(np.sum(np.abs(a), axis=0))))[1] + 1)
    scaled = a / 2.0**squarings
    term = np.eye(len(a))
    whole = term
    for order in range(1, 15):
        term = term @ scaled / order
        whole = whole + term
    for _ in range(squarings):
        whole = whole @ whole
    return whole
