"""One axis: motor and arm, two inertias joined by a harmonic drive gearing with its angular transmission error."""

import math
from typing import Any

import numpy as np

from hil.control.compiled import compiled

PLANT = np.dtype([
    ("reduction_ratio", np.float64),
    ("motor_inertia_kg_m2", np.float64),
    ("motor_damping_nm_s_rad", np.float64),
    ("arm_inertia_kg_m2", np.float64),
    ("arm_damping_nm_s_rad", np.float64),
    ("gear_stiffness_nm_rad", np.float64),
    ("gear_damping_nm_s_rad", np.float64),
    ("coulomb_friction_nm", np.float64),
    ("static_friction_nm", np.float64),
    ("stribeck_velocity_rad_s", np.float64),
    ("gravity_moment_nm", np.float64),
    ("home_angle_rad", np.float64),
    ("a1_rad", np.float64), ("phi1_rad", np.float64),
    ("a2_rad", np.float64), ("phi2_rad", np.float64),
    ("a4_rad", np.float64), ("phi4_rad", np.float64),
    ("gear_reaction", np.float64),
    ("wind_up_softness", np.float64), ("wind_up_torsion_rad", np.float64),
    ("hysteresis_torque_nm", np.float64), ("hysteresis_torsion_rad", np.float64),
    ("current_time_constant_s", np.float64),
])  # fmt: skip
"""What an axis is. All in SI; gear and arm on the arm side, motor and friction on the motor side."""

PLANT_STATE = np.dtype([
    ("motor_angle", np.float64),
    ("motor_speed", np.float64),
    ("arm_angle", np.float64),
    ("arm_speed", np.float64),
    ("hysteresis_nm", np.float64),
    ("torque_nm", np.float64),
    ("arm_acceleration", np.float64),
])  # fmt: skip
"""Where an axis is: angles in rad, speeds in rad/s, Dahl torque on the gear, the motor's torque; θ̈_l for the tip."""

_FRICTION_WIDTH_RAD_S = 0.05
"""The speed over which the regularised friction turns round."""


@compiled
def synchronous_error(p: Any, motor_angle: float) -> tuple[float, float]:
    """θ_sync = Σ A_k cos(k θ_m + φ_k), k = 1, 2, 4, in rad on the arm side, and dθ_sync/dθ_m. Eq. (2)."""
    x1, x2, x4 = motor_angle + p.phi1_rad, 2.0 * motor_angle + p.phi2_rad, 4.0 * motor_angle + p.phi4_rad
    value = p.a1_rad * math.cos(x1) + p.a2_rad * math.cos(x2) + p.a4_rad * math.cos(x4)
    slope = -p.a1_rad * math.sin(x1) - 2.0 * p.a2_rad * math.sin(x2) - 4.0 * p.a4_rad * math.sin(x4)
    return value, slope


@compiled
def friction_torque(p: Any, speed: float) -> float:
    """τ_f = (τ_C + (τ_S − τ_C) exp(−(ω/ω_s)²)) tanh(ω/0.05): Coulomb and Stribeck friction on the motor side, N·m."""
    ratio = speed / p.stribeck_velocity_rad_s
    level = p.coulomb_friction_nm + (p.static_friction_nm - p.coulomb_friction_nm) * math.exp(-ratio * ratio)
    return float(level * math.tanh(speed / _FRICTION_WIDTH_RAD_S))


@compiled
def derivatives(
    p: Any, command: float, braked: bool, theta_m: float, w_m: float, theta_l: float, w_l: float, z: float, tau: float
) -> tuple[float, float, float, float]:
    """θ̈_m, θ̈_l, ż and τ̇ of one axis.

        ψ = θ_m/N + θ_sync(θ_m) − θ_l
        τ_g = K_g ψ (1 − r exp(−(ψ/ψ_s)²)) + z + D_g ψ̇          r: soft wind-up, z: Dahl hysteresis
        J_m θ̈_m = τ − D_m θ̇_m − τ_f(θ̇_m) − τ_g (1/N + dθ_sync/dθ_m)   the last term only with the gear's reaction
        J_l θ̈_l = τ_g − D_l θ̇_l − m g l cos(θ_l + q₀)
        ż = σ ψ̇ (1 − sgn(ψ̇) z/F),  σ = F/ψ_h
        τ̇ = (τ_command − τ)/T_c

    A closed brake holds the motor: θ̈_m = 0. Without a current-loop lag τ is the command.
    """
    n = p.reduction_ratio
    sync, slope = synchronous_error(p, theta_m)
    torsion = theta_m / n + sync - theta_l
    torsion_rate = w_m / n + slope * w_m - w_l
    stiffness = p.gear_stiffness_nm_rad
    if p.wind_up_softness > 0.0:
        ratio = torsion / p.wind_up_torsion_rad
        stiffness *= 1.0 - p.wind_up_softness * math.exp(-ratio * ratio)
    gear = stiffness * torsion + p.gear_damping_nm_s_rad * torsion_rate + z
    acceleration_l = (
        gear - p.arm_damping_nm_s_rad * w_l - p.gravity_moment_nm * math.cos(theta_l + p.home_angle_rad)
    ) / p.arm_inertia_kg_m2
    z_rate = 0.0
    if p.hysteresis_torque_nm > 0.0:
        sign = 1.0 if torsion_rate > 0.0 else -1.0
        z_rate = p.hysteresis_torque_nm / p.hysteresis_torsion_rad * torsion_rate * (1.0 - sign * z / p.hysteresis_torque_nm)
    if braked:
        return 0.0, acceleration_l, z_rate, 0.0
    torque, torque_rate = command, 0.0
    if p.current_time_constant_s > 0.0:
        torque, torque_rate = tau, (command - tau) / p.current_time_constant_s
    load = gear * (1.0 / n + p.gear_reaction * slope)
    acceleration_m = (torque - p.motor_damping_nm_s_rad * w_m - friction_torque(p, w_m) - load) / p.motor_inertia_kg_m2
    return acceleration_m, acceleration_l, z_rate, torque_rate


@compiled
def plant_step(plant: Any, state: Any, row: int, command: float, braked: bool, period_s: float, substeps: int) -> None:
    """Advance one axis by one control period under a constant torque command: classical Runge-Kutta, fixed sub-steps.

    Args:
        plant: `PLANT` array, shape (n_axes,).
        state: `PLANT_STATE` array, shape (n_axes,); changed in place.
        row: Axis.
        command: Torque command in N·m, held over the period.
        braked: Whether the brake holds the motor.
        period_s: The control period.
        substeps: Runge-Kutta steps per period.
    """
    p, s = plant[row], state[row]
    th, wm, tl, wl, z, tau = s.motor_angle, s.motor_speed, s.arm_angle, s.arm_speed, s.hysteresis_nm, s.torque_nm
    if braked:
        wm, tau = 0.0, 0.0
    elif p.current_time_constant_s <= 0.0:
        tau = command
    h = period_s / substeps
    half, sixth = 0.5 * h, h / 6.0
    for _ in range(substeps):
        a1, b1, c1, d1 = derivatives(p, command, braked, th, wm, tl, wl, z, tau)
        wm2, wl2 = wm + half * a1, wl + half * b1
        a2, b2, c2, d2 = derivatives(p, command, braked, th + half * wm, wm2, tl + half * wl, wl2, z + half * c1, tau + half * d1)
        wm3, wl3 = wm + half * a2, wl + half * b2
        a3, b3, c3, d3 = derivatives(
            p, command, braked, th + half * wm2, wm3, tl + half * wl2, wl3, z + half * c2, tau + half * d2
        )
        wm4, wl4 = wm + h * a3, wl + h * b3
        a4, b4, c4, d4 = derivatives(p, command, braked, th + h * wm3, wm4, tl + h * wl3, wl4, z + h * c3, tau + h * d3)
        th += sixth * (wm + 2.0 * (wm2 + wm3) + wm4)
        tl += sixth * (wl + 2.0 * (wl2 + wl3) + wl4)
        wm += sixth * (a1 + 2.0 * (a2 + a3) + a4)
        wl += sixth * (b1 + 2.0 * (b2 + b3) + b4)
        z += sixth * (c1 + 2.0 * (c2 + c3) + c4)
        tau += sixth * (d1 + 2.0 * (d2 + d3) + d4)
    s.motor_angle, s.motor_speed, s.arm_angle, s.arm_speed, s.hysteresis_nm, s.torque_nm = th, wm, tl, wl, z, tau
    s.arm_acceleration = derivatives(p, command, braked, th, wm, tl, wl, z, tau)[1]


@compiled
def settle(plant: Any, state: Any, row: int) -> None:
    """Put a braked axis at rest under gravity: the gear carries the load, so θ_l hangs below θ_m/N + θ_sync."""
    p, s = plant[row], state[row]
    rigid = s.motor_angle / p.reduction_ratio + synchronous_error(p, s.motor_angle)[0]
    arm = rigid
    for _ in range(50):
        torsion = rigid - arm
        stiffness = p.gear_stiffness_nm_rad
        if p.wind_up_softness > 0.0:
            ratio = torsion / p.wind_up_torsion_rad
            stiffness *= 1.0 - p.wind_up_softness * math.exp(-ratio * ratio)
        arm = rigid - (p.gravity_moment_nm * math.cos(arm + p.home_angle_rad) - s.hysteresis_nm) / stiffness
    s.arm_angle, s.arm_speed, s.motor_speed, s.torque_nm, s.arm_acceleration = arm, 0.0, 0.0, 0.0, 0.0
