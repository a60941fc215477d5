"""One axis: motor and arm, two inertias joined by a harmonic drive gearing with its angular transmission error."""

import math
from typing import Any

import numpy as np

from hil.control.compiled import compiled, inlined

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

FRICTION_WIDTH_RAD_S = 0.05
"""The speed over which the regularised friction turns round."""

_SATURATED = 20.0
"""tanh x is 1 − 2 exp(−2x) …: from here on the difference to 1 is 8.5e-18, which no double shows."""

_DECAYED = 40.0
"""exp(−x) is 4.2e-18 here: a Stribeck part smaller than that of the static friction is left out."""

MOTOR_NEAR_RAD, ARM_NEAR_RAD = 1.0 / 16.0, 1.0 / 64.0
"""How far from an angle of known sine and cosine the short polynomials of `_motor_turn` and `_arm_turn` serve.

Also how far these angles lie apart. Which of them is used follows from the state alone, so that a run in many pieces gives the
bits of a run in one.
"""


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
def friction_torque(p: Any, speed: float) -> float:
    """`friction` of an axis."""
    return friction(p.coulomb_friction_nm, p.static_friction_nm - p.coulomb_friction_nm, 1.0 / p.stribeck_velocity_rad_s, speed)


@compiled
def synchronous_error(p: Any, motor_angle: float) -> tuple[float, float]:
    """θ_sync = Σ A_k cos(k θ_m + φ_k), k = 1, 2, 4, in rad on the arm side, and dθ_sync/dθ_m. Eq. (2)."""
    x1, x2, x4 = motor_angle + p.phi1_rad, 2.0 * motor_angle + p.phi2_rad, 4.0 * motor_angle + p.phi4_rad
    value = p.a1_rad * math.cos(x1) + p.a2_rad * math.cos(x2) + p.a4_rad * math.cos(x4)
    slope = -p.a1_rad * math.sin(x1) - 2.0 * p.a2_rad * math.sin(x2) - 4.0 * p.a4_rad * math.sin(x4)
    return value, slope


@inlined
def _motor_turn(d: float) -> tuple[float, float]:
    """Cos δ and sin δ of the motor's way δ.

    Taylor's polynomials to δ⁶ and δ⁷ leave less than δ⁸/8! and δ⁹/9!: 5.8e-15 at |δ| = 1/16. On an amplitude of A_k = 60″ that
    is 2e-18 rad, below the last digit of θ_m/N. Further away the library's functions take over.
    """
    if abs(d) > MOTOR_NEAR_RAD:
        return math.cos(d), math.sin(d)
    q = d * d
    cosine = 1.0 - q * (1.0 / 2.0 - q * (1.0 / 24.0 - q * (1.0 / 720.0)))
    return cosine, d * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0 - q * (1.0 / 5040.0))))


@inlined
def _arm_turn(d: float) -> tuple[float, float]:
    """Cos δ and sin δ of the arm's way δ.

    Taylor's polynomials to δ⁴ and δ⁵ leave less than δ⁶/6! and δ⁷/7!: 2.0e-14 at |δ| = 1/64. On a gravity moment of 52 N·m that
    is 1e-12 N·m; the last digit of an arm angle of 1 rad, times K_g, is 1e-11 N·m.
    """
    if abs(d) > ARM_NEAR_RAD:
        return math.cos(d), math.sin(d)
    q = d * d
    return 1.0 - q * (1.0 / 2.0 - q * (1.0 / 24.0)), d * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0)))


@inlined
def constants(p: Any) -> Any:
    """What the equations need of an axis, worked out once: reciprocals, the friction's rise, A_k cos φ_k and A_k sin φ_k."""
    return (
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
    )


@inlined
def _rates(
    k: Any,
    near: Any,
    command: float,
    braked: bool,
    theta_m: float,
    w_m: float,
    theta_l: float,
    w_l: float,
    z: float,
    tau: float,
) -> tuple[float, float, float, float]:
    """`derivatives`, from `constants` and `nearby`."""
    per_n, per_jm, d_m, per_jl, d_l, k_g, d_g, coulomb, rise, per_stribeck = k[:10]
    home, reaction, soft, psi_s, dahl, psi_h, t_c = k[11:18]
    motor, x1, y1, x2, y2, x4, y4, arm, along, across = near
    cosine, sine = _motor_turn(theta_m - motor)
    cosine2, sine2 = 1.0 - 2.0 * sine * sine, 2.0 * sine * cosine
    cosine4, sine4 = 1.0 - 2.0 * sine2 * sine2, 2.0 * sine2 * cosine2
    sync = (x1 * cosine - y1 * sine) + (x2 * cosine2 - y2 * sine2) + (x4 * cosine4 - y4 * sine4)
    slope = -(x1 * sine + y1 * cosine) - 2.0 * (x2 * sine2 + y2 * cosine2) - 4.0 * (x4 * sine4 + y4 * cosine4)
    torsion = theta_m * per_n + sync - theta_l
    torsion_rate = w_m * (per_n + slope) - w_l
    if soft > 0.0:
        ratio = torsion / psi_s
        k_g *= 1.0 - soft * math.exp(-ratio * ratio)
    gear = k_g * torsion + d_g * torsion_rate + z
    cosine, sine = _arm_turn(theta_l + home - arm)
    acceleration_l = (gear - d_l * w_l - (along * cosine - across * sine)) * per_jl
    z_rate = 0.0
    if dahl > 0.0:
        sign = 1.0 if torsion_rate > 0.0 else -1.0
        z_rate = torsion_rate / psi_h * (dahl - sign * z)
    if braked:
        return 0.0, acceleration_l, z_rate, 0.0
    torque, torque_rate = command, 0.0
    if t_c > 0.0:
        torque, torque_rate = tau, (command - tau) / t_c
    load = gear * (per_n + reaction * slope)
    acceleration_m = (torque - d_m * w_m - friction(coulomb, rise, per_stribeck, w_m) - load) * per_jm
    return acceleration_m, acceleration_l, z_rate, torque_rate


@inlined
def _places(k: Any, motor_angle: float, arm_angle: float) -> tuple[float, float]:
    """The angles, of those that lie evenly apart, which are closest to the motor's and to the arm's inclination θ_l + q₀."""
    return (
        float(np.rint(motor_angle * (1.0 / MOTOR_NEAR_RAD))) * MOTOR_NEAR_RAD,
        float(np.rint((arm_angle + k[11]) * (1.0 / ARM_NEAR_RAD))) * ARM_NEAR_RAD,
    )


@inlined
def _known(k: Any, motor: float, arm: float) -> Any:
    """What a turn δ of the motor, or of the arm, away from here is reckoned from: one sine and cosine each, here, for many δ.

    With x_k = A_k cos(k θ₀ + φ_k) and y_k = A_k sin(k θ₀ + φ_k):  A_k cos(k (θ₀ + δ) + φ_k) = x_k cos kδ − y_k sin kδ, where
    cos 2δ = 1 − 2 sin² δ and sin 2δ = 2 sin δ cos δ, once more for 4δ. Gravity alike, with m g l and θ_l + q₀.

    Returns:
        θ₀, x₁, y₁, x₂, y₂, x₄, y₄; the arm's inclination, and m g l times its cosine and sine.
    """
    gravity, c1, s1, c2, s2, c4, s4 = k[10], k[18], k[19], k[20], k[21], k[22], k[23]
    cosine, sine = math.cos(motor), math.sin(motor)
    cosine2, sine2 = 1.0 - 2.0 * sine * sine, 2.0 * sine * cosine
    cosine4, sine4 = 1.0 - 2.0 * sine2 * sine2, 2.0 * sine2 * cosine2
    return (
        motor,
        c1 * cosine - s1 * sine,
        s1 * cosine + c1 * sine,
        c2 * cosine2 - s2 * sine2,
        s2 * cosine2 + c2 * sine2,
        c4 * cosine4 - s4 * sine4,
        s4 * cosine4 + c4 * sine4,
        arm,
        gravity * math.cos(arm),
        gravity * math.sin(arm),
    )


@inlined
def nearby(k: Any, motor_angle: float, arm_angle: float) -> Any:
    """What `plant_period` reckons from around these angles."""
    motor, arm = _places(k, motor_angle, arm_angle)
    return _known(k, motor, arm)


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
    k = constants(p)
    return _rates(k, nearby(k, theta_m, theta_l), command, braked, theta_m, w_m, theta_l, w_l, z, tau)


@inlined
def plant_period(k: Any, near: Any, s: Any, command: float, braked: bool, period_s: float, substeps: int) -> Any:
    """One control period under a constant torque command: classical Runge-Kutta, fixed sub-steps; θ̈_l is left as it was.

    Args:
        k: `constants` of the axis.
        near: `nearby`, of wherever the axis was a short while ago.
        s: Its record of a `PLANT_STATE` array; changed in place.
        command: Torque command in N·m, held over the period.
        braked: Whether the brake holds the motor.
        period_s: The control period.
        substeps: Runge-Kutta steps per period.

    Returns:
        `nearby` for the next period.
    """
    th, wm, tl, wl, z, tau = s.motor_angle, s.motor_speed, s.arm_angle, s.arm_speed, s.hysteresis_nm, s.torque_nm
    if braked:
        wm, tau = 0.0, 0.0
    elif k[17] <= 0.0:
        tau = command
    h = period_s / substeps
    half, sixth = 0.5 * h, h / 6.0
    for _ in range(substeps):
        motor, arm = _places(k, th, tl)
        if motor != near[0] or arm != near[7]:
            near = _known(k, motor, arm)
        a1, b1, c1, d1 = _rates(k, near, command, braked, th, wm, tl, wl, z, tau)
        wm2, wl2 = wm + half * a1, wl + half * b1
        a2, b2, c2, d2 = _rates(
            k, near, command, braked, th + half * wm, wm2, tl + half * wl, wl2, z + half * c1, tau + half * d1
        )
        wm3, wl3 = wm + half * a2, wl + half * b2
        a3, b3, c3, d3 = _rates(
            k, near, command, braked, th + half * wm2, wm3, tl + half * wl2, wl3, z + half * c2, tau + half * d2
        )
        wm4, wl4 = wm + h * a3, wl + h * b3
        a4, b4, c4, d4 = _rates(k, near, command, braked, th + h * wm3, wm4, tl + h * wl3, wl4, z + h * c3, tau + h * d3)
        th += sixth * (wm + 2.0 * (wm2 + wm3) + wm4)
        tl += sixth * (wl + 2.0 * (wl2 + wl3) + wl4)
        wm += sixth * (a1 + 2.0 * (a2 + a3) + a4)
        wl += sixth * (b1 + 2.0 * (b2 + b3) + b4)
        z += sixth * (c1 + 2.0 * (c2 + c3) + c4)
        tau += sixth * (d1 + 2.0 * (d2 + d3) + d4)
    s.motor_angle, s.motor_speed, s.arm_angle, s.arm_speed, s.hysteresis_nm, s.torque_nm = th, wm, tl, wl, z, tau
    return near


@inlined
def arm_acceleration(k: Any, s: Any) -> float:
    """θ̈_l of a state; it does not depend on the torque command, which the motor feels first."""
    near = nearby(k, s.motor_angle, s.arm_angle)
    rates = _rates(k, near, 0.0, True, s.motor_angle, s.motor_speed, s.arm_angle, s.arm_speed, s.hysteresis_nm, s.torque_nm)
    return float(rates[1])


@compiled
def plant_step(plant: Any, state: Any, row: int, command: float, braked: bool, period_s: float, substeps: int) -> None:
    """`plant_period` of one axis by itself, and θ̈_l after it.

    Args:
        plant: `PLANT` array, shape (n_axes,).
        state: `PLANT_STATE` array, shape (n_axes,); changed in place.
        row: Axis.
        command: Torque command in N·m, held over the period.
        braked: Whether the brake holds the motor.
        period_s: The control period.
        substeps: Runge-Kutta steps per period.
    """
    k, s = constants(plant[row]), state[row]
    plant_period(k, nearby(k, s.motor_angle, s.arm_angle), s, command, braked, period_s, substeps)
    s.arm_acceleration = arm_acceleration(k, s)


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
