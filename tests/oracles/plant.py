"""The plant in plain Python: its equations of motion as they are, and in the form that the core in C has.

`derivatives` states the equations; `rates` has them as polynomials around grid angles, which is what runs. Records are objects
with the fields of the structs of `plant_emulator/physics/*.h`, see `tests.oracles.records`.
"""

import math
from typing import Any, NamedTuple

from plant_emulator.physics.axis import MORE_LINES

MOTOR_GRID_RAD, ARM_GRID_RAD = 1.0 / 16.0, 1.0 / 64.0
FRICTION_WIDTH_RAD_S = 0.05
_SATURATED, _DECAYED = 20.0, 40.0
NAMED_LINES = 3
SMOOTHING_S = 0.05
TURNING_RAD_S = 1.0

Lines = tuple[float, float, float, float]


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
    has_more_orders: float
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


def synchronous_error(p: Any, motor_angle: float) -> tuple[float, float]:
    """θ_sync = Σ A_k cos(k θ_m + φ_k) in rad on the arm side, and dθ_sync/dθ_m; k = 1, 2, 4, others, and m/N. Eq. (2)."""
    x1, x2, x4 = motor_angle + p.phi1_rad, 2.0 * motor_angle + p.phi2_rad, 4.0 * motor_angle + p.phi4_rad
    value = p.a1_rad * math.cos(x1) + p.a2_rad * math.cos(x2) + p.a4_rad * math.cos(x4)
    slope = -p.a1_rad * math.sin(x1) - 2.0 * p.a2_rad * math.sin(x2) - 4.0 * p.a4_rad * math.sin(x4)
    if p.has_more_orders > 0.0:
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


def cogging(p: Any, motor_angle: float) -> float:
    """τ_c = Σ T_j cos(j θ_m + χ_j): torque in N·m with which the motor's own magnets pull it on."""
    torque = 0.0
    if p.is_cogging > 0.0:
        for i in range(MORE_LINES):
            torque += p.cogging_nm[i] * math.cos(p.cogging_orders[i] * motor_angle + p.cogging_phi_rad[i])
    return torque


def derivatives(p: Any, s: Any, command: float, braked: bool) -> tuple[float, float, float, float]:
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
        stiffness *= 1.0 - p.wind_up_softness * math.exp(-(torsion / p.wind_up_torsion_rad) * (torsion / p.wind_up_torsion_rad))
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


def hang_at_rest(p: Any, s: Any) -> None:
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


def _arm_turn(d: float) -> tuple[float, float]:
    """Cos δ and sin δ of the arm's distance δ from its grid angle.

    Taylor's polynomials to δ⁴ and δ⁵ leave less than δ⁶/6! and δ⁷/7!: 2.0e-14 at |δ| = 1/64. On a gravity moment of 52 N·m that
    is 1e-12 N·m; the last digit of an arm angle of 1 rad, times K_g, is 1e-11 N·m.
    """
    if abs(d) > ARM_GRID_RAD:
        return math.cos(d), math.sin(d)
    q = d * d
    return 1.0 - q * (1.0 / 2.0 - q * (1.0 / 24.0)), d * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0)))


def constants(p: Any) -> "Constants":
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
        p.has_more_orders,
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


def grid_angles(k: Any, motor_angle: float, arm_angle: float) -> tuple[float, float]:
    """Nearest grid angles to θ_m and to θ_l + q₀."""
    return (
        round(motor_angle * (1.0 / MOTOR_GRID_RAD)) * MOTOR_GRID_RAD,
        round((arm_angle + k.home_angle) * (1.0 / ARM_GRID_RAD)) * ARM_GRID_RAD,
    )


def grid_point(k: Any, motor: float, arm: float) -> "GridPoint":
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


def nearest(k: Any, motor_angle: float, arm_angle: float) -> "GridPoint":
    """The grid point nearest to these angles."""
    motor, arm = grid_angles(k, motor_angle, arm_angle)
    return grid_point(k, motor, arm)


def rates(k: Any, near: Any, command: float, braked: bool, at: Any) -> tuple[float, float, float, float]:
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
    if k.has_more_orders > 0.0:  # any order, a fraction too: no grid leads there
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


def nearest_to(k: Any, s: Any) -> "GridPoint":
    """The grid point nearest to a state, from which `plant_period` begins."""
    return nearest(k, s.motor_angle_rad, s.arm_angle_rad)


def plant_period(k: Any, near: Any, s: Any, command: float, braked: bool, period_s: float, substeps: int) -> "GridPoint":
    """One control period under a constant torque command: classical Runge-Kutta, fixed sub-steps; θ̈_l is left as it was.

    Args:
        k: `constants` of the axis.
        near: The grid point nearest to a state of a short while ago.
        s: The state; changed in place.
        command: Torque command in N·m, held over the period.
        braked: Whether the brake holds the motor.
        period_s: The control period.
        substeps: Runge-Kutta steps per period.

    Returns:
        The grid point for the next period.
    """
    th, wm, tl, wl = s.motor_angle_rad, s.motor_speed_rad_s, s.arm_angle_rad, s.arm_speed_rad_s
    z, tau = s.hysteresis_nm, s.torque_nm
    if braked:
        wm, tau = 0.0, 0.0
    elif k.current_time_constant <= 0.0:
        tau = command
    h = period_s / substeps
    half, sixth = 0.5 * h, h / 6.0
    for _ in range(substeps):
        motor, arm = grid_angles(k, th, tl)
        if motor != near.motor or arm != near.arm:
            near = grid_point(k, motor, arm)
        a1, b1, c1, d1 = rates(k, near, command, braked, AxisState(th, wm, tl, wl, z, tau))
        wm2, wl2 = wm + half * a1, wl + half * b1
        at = AxisState(th + half * wm, wm2, tl + half * wl, wl2, z + half * c1, tau + half * d1)
        a2, b2, c2, d2 = rates(k, near, command, braked, at)
        wm3, wl3 = wm + half * a2, wl + half * b2
        at = AxisState(th + half * wm2, wm3, tl + half * wl2, wl3, z + half * c2, tau + half * d2)
        a3, b3, c3, d3 = rates(k, near, command, braked, at)
        wm4, wl4 = wm + h * a3, wl + h * b3
        at = AxisState(th + h * wm3, wm4, tl + h * wl3, wl4, z + h * c3, tau + h * d3)
        a4, b4, c4, d4 = rates(k, near, command, braked, at)
        th += sixth * (wm + 2.0 * (wm2 + wm3) + wm4)
        tl += sixth * (wl + 2.0 * (wl2 + wl3) + wl4)
        wm += sixth * (a1 + 2.0 * (a2 + a3) + a4)
        wl += sixth * (b1 + 2.0 * (b2 + b3) + b4)
        z += sixth * (c1 + 2.0 * (c2 + c3) + c4)
        tau += sixth * (d1 + 2.0 * (d2 + d3) + d4)
    s.motor_angle_rad, s.motor_speed_rad_s, s.arm_angle_rad, s.arm_speed_rad_s = th, wm, tl, wl
    s.hysteresis_nm, s.torque_nm = z, tau
    return near


def arm_acceleration(k: Any, s: Any) -> float:
    """θ̈_l of a state; it does not depend on the torque command, which the motor feels first."""
    at = AxisState(s.motor_angle_rad, s.motor_speed_rad_s, s.arm_angle_rad, s.arm_speed_rad_s, s.hysteresis_nm, s.torque_nm)
    _, acceleration, _, _ = rates(k, nearest_to(k, s), 0.0, True, at)
    return acceleration


def plant_step(p: Any, s: Any, command: float, braked: bool, period_s: float, substeps: int) -> None:
    """`plant_period` of one axis by itself, and θ̈_l after it: the seam at which tests hold the plant against other solvers.

    Args:
        p: The axis' constants.
        s: Its state; changed in place.
        command: Torque command in N·m, held over the period.
        braked: Whether the brake holds the motor.
        period_s: The control period.
        substeps: Runge-Kutta steps per period.
    """
    k = constants(p)
    plant_period(k, nearest_to(k, s), s, command, braked, period_s, substeps)
    s.arm_acceleration_rad_s2 = arm_acceleration(k, s)


def _spring_nm(p: Any, s: Any) -> float:
    """The gear's torque without its damping, K_g ψ (1 − r exp(−(ψ/ψ_s)²)) + z, N·m."""
    torsion = s.motor_angle_rad / p.reduction_ratio + synchronous_error(p, s.motor_angle_rad)[0] - s.arm_angle_rad
    stiffness = p.gear_stiffness_nm_rad
    if p.wind_up_softness > 0.0:
        ratio = torsion / p.wind_up_torsion_rad
        stiffness *= 1.0 - p.wind_up_softness * math.exp(-ratio * ratio)
    return stiffness * torsion + s.hysteresis_nm


def go_through(c: Any, past: Any, p: Any, s: Any, braked: bool, period_s: float) -> None:
    """What a gear goes through in a control period.

        d/dt τ_L = (τ_g − τ_L)/T_s,   d/dt s = (ω/√(ω² + ω_0²) − s)/T_s
        d/dt ϑ = (ϑ_a + R (τ_f(ω) + D_m ω) ω − ϑ)/T_th

    each exact for a right-hand side that is held over the period.

    Args:
        c: How the error changes.
        past: What the gear has gone through; changed in place.
        p: The axis' constants.
        s: Its state at the end of the period.
        braked: Whether the brake holds the motor: then nothing wears.
        period_s: The control period.
    """
    speed = 0.0 if braked else s.motor_speed_rad_s
    if not braked:
        past.operating_periods += 1
        past.operating_s = past.operating_periods * period_s
        past.turned_rad += abs(speed) * period_s
    part = 1.0 - math.exp(-period_s / SMOOTHING_S)
    past.load_nm += part * (_spring_nm(p, s) - past.load_nm)
    past.direction += part * (speed / math.sqrt(speed * speed + TURNING_RAD_S * TURNING_RAD_S) - past.direction)
    rise = p.static_friction_nm - p.coulomb_friction_nm
    lost = p.motor_damping_nm_s_rad * speed + friction(p.coulomb_friction_nm, rise, 1.0 / p.stribeck_velocity_rad_s, speed)
    warm = c.ambient_c + c.resistance_k_w * lost * speed
    past.temperature_c += (1.0 - math.exp(-period_s / c.thermal_constant_s)) * (warm - past.temperature_c)


def _line(c: Any, past: Any, i: int) -> tuple[float, float]:
    """Amplitude and phase of one order now, in rad.

    Args:
        c: How the error changes.
        past: What the gear has gone through.
        i: Any of the order.
    """
    warmer = past.temperature_c - c.reference_c
    size = 1.0 + c.growth_per_s[i] * past.operating_s + c.growth_per_rad[i] * past.turned_rad
    size += c.load_per_nm[i] * past.load_nm + c.direction_part[i] * past.direction + c.warmth_per_k[i] * warmer
    phase = c.phi_rad[i] + c.drift_rad_s[i] * past.operating_s + c.load_rad_nm[i] * past.load_nm
    phase += c.direction_rad[i] * past.direction + c.warmth_rad_k[i] * warmer
    if past.operating_s >= c.step_s[i]:
        phase += c.step_rad[i]
    return c.a_rad[i] * max(0.0, size), phase


def put_error(c: Any, past: Any, p: Any) -> None:
    """The transmission error as it is now, into the axis' constants.

        A_k = A_k0 (1 + g t + w n + a_L τ_L + a_s s + a_ϑ (ϑ − ϑ_0)), not below 0
        φ_k = φ_k0 + Δφ (from t_s on) + d t + b_L τ_L + b_s s + b_ϑ (ϑ − ϑ_0)

    Args:
        c: How the error changes.
        past: What the gear has gone through: t, n, τ_L, s, ϑ.
        p: The axis' constants; A_k and φ_k are changed in place.
    """
    p.a1_rad, p.phi1_rad = _line(c, past, 0)
    p.a2_rad, p.phi2_rad = _line(c, past, 1)
    p.a4_rad, p.phi4_rad = _line(c, past, 2)
    if p.has_more_orders > 0.0:
        for i in range(MORE_LINES):
            p.more_rad[i], p.more_phi_rad[i] = _line(c, past, NAMED_LINES + i)
