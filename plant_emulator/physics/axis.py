"""One axis: motor and arm, two inertias joined by a harmonic drive gearing with its angular transmission error.

`derivatives` states the equations of motion plainly; `plant_emulator.physics.angle_grid` has them once more in the form that
runs, and `plant_emulator.physics.integration` follows them over time.
"""

import math
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.control.compiled import compiled, inlined
from hil.control.records import record_dtype

Real = NDArray[np.float64]

MORE_LINES = 4
"""Orders beside 1, 2 and 4 for which an axis has room, orders of the joint, and orders of cogging.

`is_more`, `is_eccentric` and `is_cogging` are 0 where it has none, and they cost nothing.
"""


class PlantRow(Protocol):
    """The constants of an axis, all in SI; gear and arm on the arm side, motor and friction on the motor side.

    - `joint_orders`: in periods for a revolution of the motor: m/N for m of the joint.
    """

    reduction_ratio: float
    motor_inertia_kg_m2: float
    motor_damping_nm_s_rad: float
    arm_inertia_kg_m2: float
    arm_damping_nm_s_rad: float
    gear_stiffness_nm_rad: float
    gear_damping_nm_s_rad: float
    coulomb_friction_nm: float
    static_friction_nm: float
    stribeck_velocity_rad_s: float
    gravity_moment_nm: float
    home_angle_rad: float
    a1_rad: float
    phi1_rad: float
    a2_rad: float
    phi2_rad: float
    a4_rad: float
    phi4_rad: float
    is_more: float
    more_orders: Annotated[Real, (MORE_LINES,)]
    more_rad: Annotated[Real, (MORE_LINES,)]
    more_phi_rad: Annotated[Real, (MORE_LINES,)]
    is_eccentric: float
    joint_orders: Annotated[Real, (MORE_LINES,)]
    joint_rad: Annotated[Real, (MORE_LINES,)]
    joint_phi_rad: Annotated[Real, (MORE_LINES,)]
    is_cogging: float
    cogging_orders: Annotated[Real, (MORE_LINES,)]
    cogging_nm: Annotated[Real, (MORE_LINES,)]
    cogging_phi_rad: Annotated[Real, (MORE_LINES,)]
    gear_reaction: float
    wind_up_softness: float
    wind_up_torsion_rad: float
    hysteresis_torque_nm: float
    hysteresis_torsion_rad: float
    current_time_constant_s: float


class PlantStateRow(Protocol):
    """The state of an axis: θ_m, θ̇_m, θ_l, θ̇_l, the Dahl torque z on the gear, the motor's torque τ; and θ̈_l for the tip."""

    motor_angle_rad: float
    motor_speed_rad_s: float
    arm_angle_rad: float
    arm_speed_rad_s: float
    hysteresis_nm: float
    torque_nm: float
    arm_acceleration_rad_s2: float


PLANT = record_dtype(PlantRow)
PLANT_STATE = record_dtype(PlantStateRow)

FRICTION_WIDTH_RAD_S = 0.05
"""The speed over which the regularised friction turns round."""

_SATURATED = 20.0
"""tanh x is 1 − 2 exp(−2x) …: from here on the difference to 1 is 8.5e-18, which no double shows."""

_DECAYED = 40.0
"""exp(−x) is 4.2e-18 here: a Stribeck part smaller than that of the static friction is left out."""


@inlined
def friction(coulomb_nm: float, rise_nm: float, per_stribeck: float, speed: float) -> float:
    """τ_f = (τ_C + (τ_S − τ_C) exp(−(ω/ω_s)²)) tanh(ω/0.05): Coulomb and Stribeck friction on the motor side, N·m.

    With e = exp(−2|x|), tanh|x| = (1 − e)/(1 + e) to 2e-16; the exponentials are worked out only where they are above 1e-17.

    Args:
        coulomb_nm: τ_C.
        rise_nm: τ_S − τ_C.
        per_stribeck: 1/ω_s in s/rad.
        speed: ω in rad/s.
    """
    level = coulomb_nm
    ratio = speed * per_stribeck
    if ratio * ratio < _DECAYED:
        level += rise_nm * math.exp(-ratio * ratio)
    size = abs(speed) / FRICTION_WIDTH_RAD_S
    if size < _SATURATED:
        e = math.exp(-2.0 * size)
        level *= (1.0 - e) / (1.0 + e)
    return math.copysign(level, speed) if speed != 0.0 else 0.0


@compiled
def synchronous_error(p: PlantRow, motor_angle: float) -> tuple[float, float]:
    """θ_sync = Σ A_k cos(k θ_m + φ_k) in rad on the arm side, and dθ_sync/dθ_m; k = 1, 2, 4, others, and m/N. Eq. (2)."""
    x1, x2, x4 = motor_angle + p.phi1_rad, 2.0 * motor_angle + p.phi2_rad, 4.0 * motor_angle + p.phi4_rad
    value = p.a1_rad * math.cos(x1) + p.a2_rad * math.cos(x2) + p.a4_rad * math.cos(x4)
    slope = -p.a1_rad * math.sin(x1) - 2.0 * p.a2_rad * math.sin(x2) - 4.0 * p.a4_rad * math.sin(x4)
    if p.is_more > 0.0:
        for i in range(MORE_LINES):
            turned = p.more_orders[i] * motor_angle + p.more_phi_rad[i]
            value += p.more_rad[i] * math.cos(turned)
            slope -= p.more_orders[i] * p.more_rad[i] * math.sin(turned)
    if p.is_eccentric > 0.0:
        for i in range(MORE_LINES):
            turned = p.joint_orders[i] * motor_angle + p.joint_phi_rad[i]
            value += p.joint_rad[i] * math.cos(turned)
            slope -= p.joint_orders[i] * p.joint_rad[i] * math.sin(turned)
    return value, slope


@compiled
def cogging(p: PlantRow, motor_angle: float) -> float:
    """τ_c = Σ T_j cos(j θ_m + χ_j): torque in N·m with which the motor's own magnets pull it on."""
    torque = 0.0
    if p.is_cogging > 0.0:
        for i in range(MORE_LINES):
            torque += p.cogging_nm[i] * math.cos(p.cogging_orders[i] * motor_angle + p.cogging_phi_rad[i])
    return torque


@compiled
def derivatives(p: PlantRow, s: PlantStateRow, command: float, braked: bool) -> tuple[float, float, float, float]:
    """θ̈_m, θ̈_l, ż and τ̇ of one axis.

        ψ = θ_m/N + θ_sync(θ_m) − θ_l
        τ_g = K_g ψ (1 − r exp(−(ψ/ψ_s)²)) + z + D_g ψ̇          r: soft wind-up, z: Dahl hysteresis
        J_m θ̈_m = τ + τ_c(θ_m) − D_m θ̇_m − τ_f(θ̇_m) − τ_g (1/N + dθ_sync/dθ_m)   the last term only with the gear's reaction
        J_l θ̈_l = τ_g − D_l θ̇_l − m g l cos(θ_l + q₀)
        ż = σ ψ̇ (1 − sgn(ψ̇) z/F),  σ = F/ψ_h
        τ̇ = (τ_command − τ)/T_c

    A closed brake holds the motor: θ̈_m = 0. Without a current-loop lag τ is the command.

    Args:
        p: The axis' constants.
        s: Its state.
        command: Torque command in N·m.
        braked: Whether the brake holds the motor.
    """
    sync, slope = synchronous_error(p, s.motor_angle_rad)
    torsion = s.motor_angle_rad / p.reduction_ratio + sync - s.arm_angle_rad
    torsion_rate = s.motor_speed_rad_s * (1.0 / p.reduction_ratio + slope) - s.arm_speed_rad_s
    stiffness = p.gear_stiffness_nm_rad
    if p.wind_up_softness > 0.0:
        stiffness *= 1.0 - p.wind_up_softness * math.exp(-((torsion / p.wind_up_torsion_rad) ** 2))
    gear = stiffness * torsion + s.hysteresis_nm + p.gear_damping_nm_s_rad * torsion_rate
    gravity = p.gravity_moment_nm * math.cos(s.arm_angle_rad + p.home_angle_rad)
    acceleration_l = (gear - p.arm_damping_nm_s_rad * s.arm_speed_rad_s - gravity) / p.arm_inertia_kg_m2
    z_rate = 0.0
    if p.hysteresis_torque_nm > 0.0:
        sign = 1.0 if torsion_rate > 0.0 else -1.0
        z_rate = torsion_rate / p.hysteresis_torsion_rad * (p.hysteresis_torque_nm - sign * s.hysteresis_nm)
    if braked:
        return 0.0, acceleration_l, z_rate, 0.0
    torque, torque_rate = command, 0.0
    if p.current_time_constant_s > 0.0:
        torque, torque_rate = s.torque_nm, (command - s.torque_nm) / p.current_time_constant_s
    rise, speed = p.static_friction_nm - p.coulomb_friction_nm, s.motor_speed_rad_s
    lost = p.motor_damping_nm_s_rad * speed + friction(p.coulomb_friction_nm, rise, 1.0 / p.stribeck_velocity_rad_s, speed)
    load = gear * (1.0 / p.reduction_ratio + p.gear_reaction * slope)
    return (torque + cogging(p, s.motor_angle_rad) - lost - load) / p.motor_inertia_kg_m2, acceleration_l, z_rate, torque_rate


@compiled
def settle(p: PlantRow, s: PlantStateRow) -> None:
    """Put a braked axis at rest under gravity: the gear carries the load, so θ_l hangs below θ_m/N + θ_sync."""
    rigid = s.motor_angle_rad / p.reduction_ratio + synchronous_error(p, s.motor_angle_rad)[0]
    arm = rigid
    for _ in range(50):
        torsion = rigid - arm
        stiffness = p.gear_stiffness_nm_rad
        if p.wind_up_softness > 0.0:
            ratio = torsion / p.wind_up_torsion_rad
            stiffness *= 1.0 - p.wind_up_softness * math.exp(-ratio * ratio)
        arm = rigid - (p.gravity_moment_nm * math.cos(arm + p.home_angle_rad) - s.hysteresis_nm) / stiffness
    s.arm_angle_rad, s.arm_speed_rad_s, s.arm_acceleration_rad_s2 = arm, 0.0, 0.0
    s.motor_speed_rad_s, s.torque_nm = 0.0, 0.0
