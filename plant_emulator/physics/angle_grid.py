"""The equations of motion in the form that runs: polynomials around grid angles instead of a sine and cosine for every rate.

`rates` gives what `plant_emulator.physics.axis.derivatives` states, twice as fast. Sine and cosine are worked out at angles that
lie evenly apart, the grid; angle sums and short polynomials lead from there to the angle itself, and angle doubling to the 2nd
and 4th order. A control period seldom leaves its grid angles.
"""

import math
from typing import NamedTuple

import numpy as np

from hil.control.compiled import inlined
from plant_emulator.physics.axis import MORE_LINES, PlantRow, friction

MOTOR_GRID_RAD, ARM_GRID_RAD = 1.0 / 16.0, 1.0 / 64.0
"""Distance between grid angles, and the reach of the polynomials of `_motor_turn` and `_arm_turn` around each.

Which grid angle is used follows from the state alone, so that a run in many pieces gives the bits of a run in one.
"""


Lines = tuple[float, float, float, float]
"""A number for each of the other orders of the transmission error, of the joint's orders, or of those of cogging."""


class Constants(NamedTuple):
    """Constants of an axis as `rates` needs them, worked out once: reciprocals, products, and the harmonics by their parts."""

    per_ratio: float
    """1/N."""
    per_motor_inertia: float
    motor_damping: float
    per_arm_inertia: float
    arm_damping: float
    gear_stiffness: float
    gear_damping: float
    coulomb_friction: float
    friction_rise: float
    """τ_S − τ_C."""
    per_stribeck_velocity: float
    gravity_moment: float
    home_angle: float
    gear_reaction: float
    wind_up_softness: float
    wind_up_torsion: float
    hysteresis_torque: float
    hysteresis_torsion: float
    current_time_constant: float
    a1_cos: float
    """A_1 cos φ_1; the others alike."""
    a1_sin: float
    a2_cos: float
    a2_sin: float
    a4_cos: float
    a4_sin: float
    is_more: float
    more_orders: Lines
    more_rad: Lines
    more_phi: Lines
    is_eccentric: float
    joint_orders: Lines
    joint_rad: Lines
    joint_phi: Lines
    is_cogging: float
    cogging_orders: Lines
    cogging_nm: Lines
    cogging_phi: Lines


class GridPoint(NamedTuple):
    """Sine and cosine at one grid angle of the motor and one of the arm, scaled: angle sums give the values around them.

    With x_k = A_k cos(k θ₀ + φ_k) and y_k = A_k sin(k θ₀ + φ_k):  A_k cos(k (θ₀ + δ) + φ_k) = x_k cos kδ − y_k sin kδ, where
    cos 2δ = 1 − 2 sin² δ and sin 2δ = 2 sin δ cos δ, once more for 4δ. Gravity alike, with m g l and θ_l + q₀.
    """

    motor: float
    """θ₀ of the motor."""
    x1: float
    y1: float
    x2: float
    y2: float
    x4: float
    y4: float
    arm: float
    """θ₀ of the arm's inclination θ_l + q₀."""
    gravity_cos: float
    """m g l cos θ₀."""
    gravity_sin: float


class AxisState(NamedTuple):
    """The state of an axis as numbers: θ_m, θ̇_m, θ_l, θ̇_l, z and τ."""

    theta_m: float
    w_m: float
    theta_l: float
    w_l: float
    z: float
    tau: float


@inlined
def _motor_turn(d: float) -> tuple[float, float]:
    """Cos δ and sin δ of the motor's distance δ from its grid angle.

    Taylor's polynomials to δ⁶ and δ⁷ leave less than δ⁸/8! and δ⁹/9!: 5.8e-15 at |δ| = 1/16. On an amplitude of A_k = 60″ that
    is 2e-18 rad, below the last digit of θ_m/N. Further away the library's functions take over.
    """
    if abs(d) > MOTOR_GRID_RAD:
        return math.cos(d), math.sin(d)
    q = d * d
    cosine = 1.0 - q * (1.0 / 2.0 - q * (1.0 / 24.0 - q * (1.0 / 720.0)))
    return cosine, d * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0 - q * (1.0 / 5040.0))))


@inlined
def _arm_turn(d: float) -> tuple[float, float]:
    """Cos δ and sin δ of the arm's distance δ from its grid angle.

    Taylor's polynomials to δ⁴ and δ⁵ leave less than δ⁶/6! and δ⁷/7!: 2.0e-14 at |δ| = 1/64. On a gravity moment of 52 N·m that
    is 1e-12 N·m; the last digit of an arm angle of 1 rad, times K_g, is 1e-11 N·m.
    """
    if abs(d) > ARM_GRID_RAD:
        return math.cos(d), math.sin(d)
    q = d * d
    return 1.0 - q * (1.0 / 2.0 - q * (1.0 / 24.0)), d * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0)))


@inlined
def constants(p: PlantRow) -> Constants:
    """`Constants` of an axis."""
    return Constants(
        1.0 / p.reduction_ratio,
        1.0 / p.motor_inertia_kg_m2,
        p.motor_damping_nm_s_rad,
        1.0 / p.arm_inertia_kg_m2,
        p.arm_damping_nm_s_rad,
        p.gear_stiffness_nm_rad,
        p.gear_damping_nm_s_rad,
        p.coulomb_friction_nm,
        p.static_friction_nm - p.coulomb_friction_nm,
        1.0 / p.stribeck_velocity_rad_s,
        p.gravity_moment_nm,
        p.home_angle_rad,
        p.gear_reaction,
        p.wind_up_softness,
        p.wind_up_torsion_rad,
        p.hysteresis_torque_nm,
        p.hysteresis_torsion_rad,
        p.current_time_constant_s,
        p.a1_rad * math.cos(p.phi1_rad),
        p.a1_rad * math.sin(p.phi1_rad),
        p.a2_rad * math.cos(p.phi2_rad),
        p.a2_rad * math.sin(p.phi2_rad),
        p.a4_rad * math.cos(p.phi4_rad),
        p.a4_rad * math.sin(p.phi4_rad),
        p.is_more,
        (p.more_orders[0], p.more_orders[1], p.more_orders[2], p.more_orders[3]),
        (p.more_rad[0], p.more_rad[1], p.more_rad[2], p.more_rad[3]),
        (p.more_phi_rad[0], p.more_phi_rad[1], p.more_phi_rad[2], p.more_phi_rad[3]),
        p.is_eccentric,
        (p.joint_orders[0], p.joint_orders[1], p.joint_orders[2], p.joint_orders[3]),
        (p.joint_rad[0], p.joint_rad[1], p.joint_rad[2], p.joint_rad[3]),
        (p.joint_phi_rad[0], p.joint_phi_rad[1], p.joint_phi_rad[2], p.joint_phi_rad[3]),
        p.is_cogging,
        (p.cogging_orders[0], p.cogging_orders[1], p.cogging_orders[2], p.cogging_orders[3]),
        (p.cogging_nm[0], p.cogging_nm[1], p.cogging_nm[2], p.cogging_nm[3]),
        (p.cogging_phi_rad[0], p.cogging_phi_rad[1], p.cogging_phi_rad[2], p.cogging_phi_rad[3]),
    )


@inlined
def grid_angles(k: Constants, motor_angle: float, arm_angle: float) -> tuple[float, float]:
    """Nearest grid angles to θ_m and to θ_l + q₀."""
    return (
        float(np.rint(motor_angle * (1.0 / MOTOR_GRID_RAD))) * MOTOR_GRID_RAD,
        float(np.rint((arm_angle + k.home_angle) * (1.0 / ARM_GRID_RAD))) * ARM_GRID_RAD,
    )


@inlined
def grid_point(k: Constants, motor: float, arm: float) -> GridPoint:
    """`GridPoint` of these grid angles."""
    cosine, sine = math.cos(motor), math.sin(motor)
    cosine2, sine2 = 1.0 - 2.0 * sine * sine, 2.0 * sine * cosine
    cosine4, sine4 = 1.0 - 2.0 * sine2 * sine2, 2.0 * sine2 * cosine2
    return GridPoint(
        motor,
        k.a1_cos * cosine - k.a1_sin * sine,
        k.a1_sin * cosine + k.a1_cos * sine,
        k.a2_cos * cosine2 - k.a2_sin * sine2,
        k.a2_sin * cosine2 + k.a2_cos * sine2,
        k.a4_cos * cosine4 - k.a4_sin * sine4,
        k.a4_sin * cosine4 + k.a4_cos * sine4,
        arm,
        k.gravity_moment * math.cos(arm),
        k.gravity_moment * math.sin(arm),
    )


@inlined
def nearest(k: Constants, motor_angle: float, arm_angle: float) -> GridPoint:
    """The grid point nearest to these angles."""
    motor, arm = grid_angles(k, motor_angle, arm_angle)
    return grid_point(k, motor, arm)


@inlined
def rates(k: Constants, near: GridPoint, command: float, braked: bool, at: AxisState) -> tuple[float, float, float, float]:
    """θ̈_m, θ̈_l, ż and τ̇ of one axis, see `derivatives`.

    Args:
        k: `constants` of the axis.
        near: A grid point; the nearer, the smaller the error.
        command: Torque command in N·m.
        braked: Whether the brake holds the motor.
        at: The state.
    """
    cosine, sine = _motor_turn(at.theta_m - near.motor)
    cosine2, sine2 = 1.0 - 2.0 * sine * sine, 2.0 * sine * cosine
    cosine4, sine4 = 1.0 - 2.0 * sine2 * sine2, 2.0 * sine2 * cosine2
    sync = (near.x1 * cosine - near.y1 * sine) + (near.x2 * cosine2 - near.y2 * sine2) + (near.x4 * cosine4 - near.y4 * sine4)
    slope1, slope2 = near.x1 * sine + near.y1 * cosine, near.x2 * sine2 + near.y2 * cosine2
    slope4 = near.x4 * sine4 + near.y4 * cosine4
    slope = -slope1 - 2.0 * slope2 - 4.0 * slope4
    if k.is_more > 0.0:  # any order, a fraction too: no grid leads there
        for i in range(MORE_LINES):
            turned = k.more_orders[i] * at.theta_m + k.more_phi[i]
            sync += k.more_rad[i] * math.cos(turned)
            slope -= k.more_orders[i] * k.more_rad[i] * math.sin(turned)
    if k.is_eccentric > 0.0:
        for i in range(MORE_LINES):
            turned = k.joint_orders[i] * at.theta_m + k.joint_phi[i]
            sync += k.joint_rad[i] * math.cos(turned)
            slope -= k.joint_orders[i] * k.joint_rad[i] * math.sin(turned)
    torsion = at.theta_m * k.per_ratio + sync - at.theta_l
    torsion_rate = at.w_m * (k.per_ratio + slope) - at.w_l
    stiffness = k.gear_stiffness
    if k.wind_up_softness > 0.0:
        ratio = torsion / k.wind_up_torsion
        stiffness *= 1.0 - k.wind_up_softness * math.exp(-ratio * ratio)
    gear = stiffness * torsion + k.gear_damping * torsion_rate + at.z
    cosine, sine = _arm_turn(at.theta_l + k.home_angle - near.arm)
    gravity = near.gravity_cos * cosine - near.gravity_sin * sine
    acceleration_l = (gear - k.arm_damping * at.w_l - gravity) * k.per_arm_inertia
    z_rate = 0.0
    if k.hysteresis_torque > 0.0:
        sign = 1.0 if torsion_rate > 0.0 else -1.0
        z_rate = torsion_rate / k.hysteresis_torsion * (k.hysteresis_torque - sign * at.z)
    if braked:
        return 0.0, acceleration_l, z_rate, 0.0
    torque, torque_rate = command, 0.0
    if k.current_time_constant > 0.0:
        torque, torque_rate = at.tau, (command - at.tau) / k.current_time_constant
    if k.is_cogging > 0.0:
        for i in range(MORE_LINES):
            torque += k.cogging_nm[i] * math.cos(k.cogging_orders[i] * at.theta_m + k.cogging_phi[i])
    load = gear * (k.per_ratio + k.gear_reaction * slope)
    lost = friction(k.coulomb_friction, k.friction_rise, k.per_stribeck_velocity, at.w_m)
    acceleration_m = (torque - k.motor_damping * at.w_m - lost - load) * k.per_motor_inertia
    return acceleration_m, acceleration_l, z_rate, torque_rate
