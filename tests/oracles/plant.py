"""The plant in plain Python: its equations of motion as they are, and in the form that the core in C has.

`derivatives` states the equations; `rates` has them with few sines and divisions, which is what runs. Records are objects
with the fields of the structs of `plant_emulator/physics/*.h`, see `tests.oracles.records`.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from plant_emulator.physics.axis import MORE_LINES

FRICTION_WIDTH_RAD_S = 0.05
_SATURATED, _DECAYED = 20.0, 40.0
NAMED_LINES = 3
SMOOTHING_S = 0.05
TURNING_RAD_S = 1.0


class Harmonic(NamedTuple):
    """One wave A cos(k θ + φ)."""

    order: float
    cosine: float
    """A cos φ."""
    sine: float


class Waves:
    """A sum of waves near a grid angle, as `hil/control/waves.h` has it."""

    TERMS = 13

    def __init__(self, harmonics: Sequence[Harmonic]) -> None:
        """Begin with waves that are developed nowhere."""
        self.harmonics, self.spacing, self.angle = harmonics, 1.0, math.inf
        while any(self.spacing * each.order > 0.5 for each in harmonics):
            self.spacing *= 0.5

    def _develop(self, angle: float) -> None:
        self.angle = round(angle / self.spacing) * self.spacing
        terms = [[0.0] * self.TERMS, [0.0] * self.TERMS]
        for wave in self.harmonics:
            k, re, im = wave.order, math.cos(wave.order * self.angle), math.sin(wave.order * self.angle)
            term, slope = wave.cosine * re - wave.sine * im, -k * (wave.cosine * im + wave.sine * re)
            for n in range(self.TERMS):
                terms[0][n] += term
                terms[1][n] += slope
                term, slope = slope * (1.0 / (n + 1)), term * (-k * k * (1.0 / (n + 1)))
        self.terms = terms

    def sums(self, angle: float, part: float) -> list[float]:
        """Sum and slope at an angle, developed anew where the grid angle is not nearer than a part of the spacing."""
        if not abs(angle - self.angle) < part * self.spacing:
            self._develop(angle)
        d = angle - self.angle
        q = d * d
        q2 = q * q
        found = []
        for c in self.terms:
            even = ((c[0] + q * c[2]) + q2 * (c[4] + q * c[6])) + q2 * q2 * ((c[8] + q * c[10]) + q2 * c[12])
            odd = ((c[1] + q * c[3]) + q2 * (c[5] + q * c[7])) + q2 * q2 * (c[9] + q * c[11])
            found.append(even + d * odd)
        return found


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
    gear_reaction: float
    wind_up_softness: float
    per_wind_up_torsion: float
    hysteresis_torque: float
    per_hysteresis_torsion: float
    current_time_constant: float
    lines: int
    """Of the error."""
    error: Sequence[Harmonic]
    gravity: Harmonic
    cogging_lines: int
    cogging: Sequence[Harmonic]


class GridPoint(NamedTuple):
    """Error and cogging around angles of the motor, gravity around one of the arm."""

    error: Waves
    cogging: Waves
    gravity: Waves


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


def constants(p: Any) -> Constants:
    """`Constants` of an axis."""

    def wave(order: float, size: float, phase: float) -> Harmonic:
        return Harmonic(order, size * math.cos(phase), size * math.sin(phase))

    error = [wave(1.0, p.a1_rad, p.phi1_rad), wave(2.0, p.a2_rad, p.phi2_rad), wave(4.0, p.a4_rad, p.phi4_rad)]
    if p.has_more_orders > 0.0:
        error += map(wave, p.more_orders, p.more_rad, p.more_phi_rad)
    if p.is_eccentric > 0.0:
        error += map(wave, p.joint_orders, p.joint_rad, p.joint_phi_rad)
    magnets = list(map(wave, p.cogging_orders, p.cogging_nm, p.cogging_phi_rad)) if p.is_cogging > 0.0 else []
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
        p.gear_reaction,
        p.wind_up_softness,
        1.0 / (p.wind_up_torsion_rad or math.nan),
        p.hysteresis_torque_nm,
        1.0 / (p.hysteresis_torsion_rad or math.nan),
        p.current_time_constant_s,
        len(error),
        error,
        wave(1.0, p.gravity_moment_nm, p.home_angle_rad),
        len(magnets),
        magnets,
    )


def grid_point(k: Any) -> GridPoint:
    """A grid point at which nothing is developed yet."""
    return GridPoint(Waves(k.error[: k.lines]), Waves(k.cogging[: k.cogging_lines]), Waves([k.gravity]))


def rates(k: Any, near: GridPoint, command: float, braked: bool, at: Any, part: float) -> tuple[float, float, float, float]:
    """θ̈_m, θ̈_l, ż and τ̇ of one axis, see `derivatives`.

    Args:
        k: `constants` of the axis.
        near: A grid point; moved where it is too far away.
        command: Torque command in N·m.
        braked: Whether the brake holds the motor.
        at: The state.
        part: 1/2 for a state; 1 for a stage, which is near to one.
    """
    sync, slope = near.error.sums(at.theta_m, part)
    gravity, _ = near.gravity.sums(at.theta_l, part)
    torsion = at.theta_m * k.per_ratio + sync - at.theta_l
    torsion_rate = at.w_m * (k.per_ratio + slope) - at.w_l
    spring = k.gear_stiffness * torsion
    if k.wind_up_softness > 0.0:
        ratio = torsion * k.per_wind_up_torsion
        spring -= k.wind_up_softness * spring * math.exp(-ratio * ratio)
    gear = (k.gear_damping * torsion_rate + at.z) + spring
    acceleration_l = (gear - k.arm_damping * at.w_l - gravity) * k.per_arm_inertia
    z_rate = 0.0
    if k.hysteresis_torque > 0.0:
        z_rate = (torsion_rate * k.hysteresis_torque - abs(torsion_rate) * at.z) * k.per_hysteresis_torsion
    if braked:
        return 0.0, acceleration_l, z_rate, 0.0
    torque, torque_rate = command, 0.0
    if k.current_time_constant > 0.0:
        torque, torque_rate = at.tau, (command - at.tau) / k.current_time_constant
    magnets = near.cogging.sums(at.theta_m, part)[0] if k.cogging_lines > 0 else 0.0
    load = gear * (k.per_ratio + k.gear_reaction * slope)
    lost = friction(k.coulomb_friction, k.friction_rise, k.per_stribeck_velocity, at.w_m)
    acceleration_m = (torque + magnets - k.motor_damping * at.w_m - lost - load) * k.per_motor_inertia
    return acceleration_m, acceleration_l, z_rate, torque_rate


def plant_period(k: Any, near: GridPoint, s: Any, command: float, braked: bool, period_s: float, substeps: int) -> None:
    """One control period under a constant torque command: classical Runge-Kutta, fixed sub-steps; θ̈_l is left as it was.

    Args:
        k: `constants` of the axis.
        near: A grid point, which moves along.
        s: The state; changed in place.
        command: Torque command in N·m, held over the period.
        braked: Whether the brake holds the motor.
        period_s: The control period.
        substeps: Runge-Kutta steps per period.
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
        a1, b1, c1, d1 = rates(k, near, command, braked, AxisState(th, wm, tl, wl, z, tau), 0.5)
        middle_m, middle_l, end_m, end_l = th + half * wm, tl + half * wl, th + h * wm, tl + h * wl
        at = AxisState(middle_m, wm + half * a1, middle_l, wl + half * b1, z + half * c1, tau + half * d1)
        a2, b2, c2, d2 = rates(k, near, command, braked, at, 1.0)
        turned_m, turned_l = middle_m + half * half * a1, middle_l + half * half * b1
        at = AxisState(turned_m, wm + half * a2, turned_l, wl + half * b2, z + half * c2, tau + half * d2)
        a3, b3, c3, d3 = rates(k, near, command, braked, at, 1.0)
        turned_m, turned_l = end_m + h * half * a2, end_l + h * half * b2
        at = AxisState(turned_m, wm + h * a3, turned_l, wl + h * b3, z + h * c3, tau + h * d3)
        a4, b4, c4, d4 = rates(k, near, command, braked, at, 1.0)
        th = end_m + h * sixth * (a1 + a2) + h * sixth * a3
        tl = end_l + h * sixth * (b1 + b2) + h * sixth * b3
        wm += sixth * (a1 + 2.0 * (a2 + a3) + a4)
        wl += sixth * (b1 + 2.0 * (b2 + b3) + b4)
        z += sixth * (c1 + 2.0 * (c2 + c3) + c4)
        tau += sixth * (d1 + 2.0 * (d2 + d3) + d4)
    s.motor_angle_rad, s.motor_speed_rad_s, s.arm_angle_rad, s.arm_speed_rad_s = th, wm, tl, wl
    s.hysteresis_nm, s.torque_nm = z, tau


def arm_acceleration(k: Any, s: Any) -> float:
    """θ̈_l of a state; it does not depend on the torque command, which the motor feels first."""
    at = AxisState(s.motor_angle_rad, s.motor_speed_rad_s, s.arm_angle_rad, s.arm_speed_rad_s, s.hysteresis_nm, s.torque_nm)
    _, acceleration, _, _ = rates(k, grid_point(k), 0.0, True, at, 0.5)
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
    plant_period(k, grid_point(k), s, command, braked, period_s, substeps)
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
