"""The servo law and the cancellation in plain Python, readable beside the paper: what the core in C has to compute.

Records are objects with the fields of the structs of `hil/control/*.h`, see `tests.oracles.records`.
"""

import math
from typing import Any, NamedTuple

from hil.control.notch import NOTCH_FIXED, NOTCH_OFF, NOTCH_TRAPEZOID, NOTCHES

START_LOWPASS_HZ = 20.0
FRICTION_RAD_S = 0.5
FADE_S = 0.2


def notch_coefficients(
    zero_hz: float, pole_hz: float, zeta_rn: float, zeta_rd: float, period_s: float
) -> tuple[float, float, float, float, float]:
    """Coefficients b₀, b₁, b₂, a₁, a₂ of the notch, by the bilinear transform without prewarping.

    F_n(s) = (s² + 2 ζ_rn ω_rn s + ω_rn²) / (s² + 2 ζ_rd ω_rd s + ω_rd²) · ω_rd² / ω_rn²,  F_n(0) = 1,
    s = 2/T · (1 − z⁻¹)/(1 + z⁻¹),  y_n = b₀ u_n + b₁ u_{n−1} + b₂ u_{n−2} − a₁ y_{n−1} − a₂ y_{n−2}.

    Args:
        zero_hz: ω_rn / 2π.
        pole_hz: ω_rd / 2π.
        zeta_rn: Damping of the zeros.
        zeta_rd: Damping of the poles.
        period_s: Sampling time T.

    Source: the paper, eq. (6); bilinear transform from its section 5.1.
    """
    c = 2.0 / period_s
    wn = 2.0 * math.pi * zero_hz
    wd = 2.0 * math.pi * pole_hz
    gain = wd * wd / (wn * wn)
    n0, n1, n2 = gain * wn * wn, gain * 2.0 * zeta_rn * wn * c, gain * c * c
    d0, d1, d2 = wd * wd, 2.0 * zeta_rd * wd * c, c * c
    a0 = d2 + d1 + d0
    return (
        (n2 + n1 + n0) / a0,
        2.0 * (n0 - n2) / a0,
        (n2 - n1 + n0) / a0,
        2.0 * (d0 - d2) / a0,
        (d2 - d1 + d0) / a0,
    )


def notch_weight(mode: int, speed_rps: float, start_rps: float, end_rps: float, ramp_rps: float) -> float:
    """Weight of the filter at a speed, 0 … 1: always 1 where it switches, the height of the trapezoid where it has slopes.

    Args:
        mode: `NOTCH_SWITCHED` or `NOTCH_TRAPEZOID`.
        speed_rps: f_m.
        start_rps: f_s.
        end_rps: f_e.
        ramp_rps: Width of either slope.
    """
    if mode != NOTCH_TRAPEZOID:
        return 1.0
    rise = (speed_rps - start_rps) / ramp_rps
    fall = (end_rps - speed_rps) / ramp_rps
    return max(0.0, min(1.0, rise, fall))


def lowpass_blend(corner_hz: float, period_s: float) -> float:
    """The fraction of the new sample in a first-order low-pass x += blend (u − x); 1 where the corner is beyond reach."""
    w = math.pi * corner_hz * period_s
    return min(1.0, 2.0 * w / (1.0 + w))


def _fixed_step(c: Any, s: Any, u: float) -> float:
    """One sample of a fixed filter; it starts as if the low-passed torque ū had been its input for ever, ȳ = G(1) ū."""
    if s.active == 0:
        rest = (c.b0 + c.b1 + c.b2) / (1.0 + c.a1 + c.a2) * s.mean_nm
        s.s2 = c.b2 * s.mean_nm - c.a2 * rest
        s.s1 = c.b1 * s.mean_nm - c.a1 * rest + s.s2
        s.active = 1
    y = c.b0 * u + s.s1
    s.s1 = c.b1 * u - c.a1 * y + s.s2
    s.s2 = c.b2 * u - c.a2 * y
    return float(y)


def notch_step(c: Any, s: Any, period_s: float, speed_rad_s: float, u: float) -> float:
    """One sample of the filter: follow the speed, switch with hysteresis, filter the torque command. A fixed one is always on.

    f_m = |θ̇_m| / 2π behind a first-order low-pass; ω_rn = 2π k f_m; ω_rd = ω_rn + w ω_d and
    ζ_rd = ζ_rn + w (ζ_rdth − ζ_rn) with the weight w of `notch_weight` (at w = 0 poles and zeros are equal: no filter,
    hence no step at the trapezoid's feet).

    The filter runs in transposed direct form II and starts DC-consistent, s₂ = (b₂ − a₂) ū, s₁ = (b₁ − a₁) ū + s₂: as
    if the low-passed torque ū had stood there for ever. Its high-frequency gain is (ω_rd/ω_rn)² > 1, so any other start
    would kick the arm.

    Args:
        c: The filter's parameters.
        s: The filter's memory; changed in place.
        period_s: Sampling time.
        speed_rad_s: Measured motor speed, behind the velocity low-pass.
        u: Torque command of the PI, in N·m.

    Returns:
        The filtered torque command in N·m.
    """
    s.mean_nm += lowpass_blend(START_LOWPASS_HZ, period_s) * (u - s.mean_nm)
    if c.mode == NOTCH_FIXED:
        return float(_fixed_step(c, s, u))
    s.speed_rps += lowpass_blend(c.speed_lowpass_hz, period_s) * (abs(speed_rad_s) / (2.0 * math.pi) - s.speed_rps)
    f_m = s.speed_rps
    was_active = s.active != 0
    margin = c.hysteresis_rps if was_active else 0.0
    if c.mode == NOTCH_OFF or not c.start_rps - margin <= f_m <= c.end_rps + margin:
        s.active = 0
        return u
    weight = notch_weight(c.mode, f_m, c.start_rps, c.end_rps, c.ramp_rps)
    zero_hz = c.order * f_m
    s.frequency_hz = zero_hz
    s.zeta_rd = c.zeta_rn + weight * (c.zeta_rdth - c.zeta_rn)
    b0, b1, b2, a1, a2 = notch_coefficients(zero_hz, zero_hz + weight * c.offset_hz, c.zeta_rn, s.zeta_rd, period_s)
    if not was_active:
        s.s2 = (b2 - a2) * s.mean_nm
        s.s1 = (b1 - a1) * s.mean_nm + s.s2
        s.active = 1
    y = b0 * u + s.s1
    s.s1 = b1 * u - a1 * y + s.s2
    s.s2 = b2 * u - a2 * y
    return float(y)


def cascade_start(state: Any, motor_angle: float, speed_rad_s: float, torque_nm: float) -> None:
    """Start without a step in the torque: the speed is known, and the integrator holds the torque that acts already.

    Args:
        state: The cascade's memory; changed in place.
        motor_angle: θ_m in rad.
        speed_rad_s: The motor's speed.
        torque_nm: The torque that acts now.
    """
    state.motor_angle_rad = motor_angle
    state.speed_rad_s = speed_rad_s
    state.error_rad_s = 0.0
    state.integral_nm = torque_nm


def observe_speed(config: Any, state: Any, period_s: float, motor_angle: float) -> float:
    """Low-passed motor speed v̂ = F_lp s θ_m in rad/s, bilinear; call it once per sample.

    Args:
        config: The cascade's gains.
        state: The cascade's memory; changed in place.
        period_s: Sampling time.
        motor_angle: θ_m in rad, as measured.
    """
    c = 2.0 / period_s
    w = 2.0 * math.pi * config.lowpass_hz
    state.speed_rad_s = ((c - w) * state.speed_rad_s + w * c * (motor_angle - state.motor_angle_rad)) / (c + w)
    state.motor_angle_rad = motor_angle
    return float(state.speed_rad_s)


def cascade_step(config: Any, state: Any, period_s: float, position: float, velocity_offset: float) -> tuple[float, float]:
    """One sample of u = (K_vp + K_vi/s)(K_pp (θ_ref − θ_m) + θ̇_ff − v̂), bilinear; call `observe_speed` first.

    Args:
        config: The cascade's gains.
        state: The cascade's memory; changed in place.
        period_s: Sampling time.
        position: θ_ref in rad.
        velocity_offset: θ̇_ff in rad/s.

    Returns:
        u in N·m, and the integrator as it was before, for `hold_integrator`.
    """
    error = config.position_gain_per_s * (position - state.motor_angle_rad) + velocity_offset - state.speed_rad_s
    before = state.integral_nm
    state.integral_nm += config.velocity_integral_gain_nm_rad * 0.5 * period_s * (error + state.error_rad_s)
    state.error_rad_s = error
    return config.velocity_gain_nm_s_rad * error + state.integral_nm, before


def hold_integrator(state: Any, before: float, excess_nm: float) -> None:
    """Anti-windup: where the torque was cut and the error would wind the integrator further, it stays where it was."""
    if excess_nm * state.error_rad_s > 0.0:
        state.integral_nm = before


def servo_start(law: Any, motor_angle: float, speed_rad_s: float, torque_nm: float) -> None:
    """Take over at this angle and speed while this torque acts, without a step in the torque.

    Args:
        law: The axis' law; its memory is changed in place.
        motor_angle: θ_m in rad.
        speed_rad_s: The motor's speed.
        torque_nm: The torque that acts now.
    """
    cascade_start(law.cascade_state, motor_angle, speed_rad_s, torque_nm)
    for column in range(NOTCHES):
        s = law.notch_state[column]
        s.s1 = s.s2 = s.frequency_hz = s.zeta_rd = 0.0
        s.active = 0
        # a filter that acts at this speed starts at once, on this torque
        s.speed_rps = abs(speed_rad_s) / (2.0 * math.pi)
        s.mean_nm = torque_nm


def servo_step(
    law: Any,
    period_s: float,
    torque_limit_nm: float,
    position: float,
    velocity_offset: float,
    torque_offset: float,
    motor_angle: float,
) -> float:
    """One sample of the law of one axis: τ = F_n(s) u + τ_offset, limited to ±τ_max.

    F_n stands on the torque command, behind the PI: that is where it opens the loop at the anti-resonance and lets the
    motor give way to the transmission error. No allocation; all state is in the record.

    Args:
        law: The axis' law; its memory is changed in place.
        period_s: Sampling time T_s of the loop.
        torque_limit_nm: τ_max.
        position: θ_ref in rad, motor side.
        velocity_offset: θ̇_ff in rad/s.
        torque_offset: Added behind the filter, in N·m.
        motor_angle: θ_m in rad, as measured.

    Returns:
        The torque command in N·m.
    """
    cascade, state = law.cascade_config, law.cascade_state
    speed = observe_speed(cascade, state, period_s, motor_angle)
    u, before = cascade_step(cascade, state, period_s, position, velocity_offset)
    for column in range(NOTCHES):
        u = notch_step(law.notch_config[column], law.notch_state[column], period_s, speed, u)
    wanted = u + torque_offset
    torque = min(torque_limit_nm, max(-torque_limit_nm, wanted))
    if torque != wanted:
        hold_integrator(state, before, wanted - torque)
    return torque


def bank_step(laws: Any, period_s: float, values: Any) -> None:
    """One sample of `servo_step` for every axis.

    Args:
        laws: `LAW` array, shape (n_axes,).
        period_s: Sampling time.
        values: Rows θ_ref, θ_m and τ_max in, then τ and the zero frequency of the first filter (0 while it is out) out;
            shape (5, n_axes).
    """
    for row in range(len(laws)):
        law = laws[row]
        values[3][row] = servo_step(law, period_s, values[2][row], values[0][row], 0.0, 0.0, values[1][row])
        first = law.notch_state[0]
        values[4][row] = first.frequency_hz if first.active != 0 else 0.0


def gear_torque(c: Any, s: Any, period_s: float, torque: float, speed: float, gained: float) -> float:
    """τ_g as its slow part shows in the motor's torque, in N·m at the arm, within what counts.

    Args:
        c: The axis' parameters.
        s: The axis' memory; changed in place.
        period_s: Sampling time.
        torque: Motor torque as measured.
        speed: θ̇_m.
        gained: θ̈_m.
    """
    if s.is_running == 0:
        s.torque_nm, s.slower_nm = torque, torque
    blend = lowpass_blend(c.load_lowpass_hz, period_s)
    s.torque_nm += blend * (torque - s.torque_nm)
    s.slower_nm += blend * (s.torque_nm - s.slower_nm)
    friction = c.coulomb_friction_nm * min(max(speed / FRICTION_RAD_S, -1.0), 1.0)
    own = c.motor_inertia_kg_m2 * gained + c.motor_damping_nm_s_rad * speed + friction
    return min(max(c.reduction_ratio * (2.0 * s.torque_nm - s.slower_nm - own), -c.most_nm), c.most_nm)


def speed_column(c: Any, table: Any, speed: float) -> tuple[int, float]:
    """Column of a table at or below a motor speed, and the fraction of the way to the next."""
    column = min(abs(speed) / (2.0 * math.pi * c.step_rps), len(table[0]) - 1.0)
    low = min(int(column), len(table[0]) - 2)
    return low, column - low


def smooth_angle(waves: Any, table: Any, angle: float, low: int, part: float, side: float) -> float:
    """The angle without what has been added: θ_m less the motor's sampled part of every order of the error itself.

    Args:
        waves: As in `cancellation_step`, like `table`.
        table: G by wave and speed.
        angle: θ_m.
        low: Column at or below the speed.
        part: Fraction of the way to the next.
        side: −1 backwards, otherwise 1.
    """
    smooth = angle
    for i in range(len(table)):
        if table[i][0][4] > 0.0:
            turned = waves[i][0] * angle + waves[i][1]
            real = table[i][low][4] + part * (table[i][low + 1][4] - table[i][low][4])
            imaginary = table[i][low][13] + part * (table[i][low + 1][13] - table[i][low][13])
            smooth += waves[i][2] * (real * math.cos(turned) - imaginary * side * math.sin(turned))
    return smooth


def added(
    waves: Any, table: Any, low: int, part: float, smooth: float, side: float, gained: float, load: float
) -> tuple[float, float]:
    """All waves together: addition to the set-point in rad, torque offset in N·m.

    Args:
        waves: As in `cancellation_step`, like `table`.
        table: G by wave and speed.
        low: Column at or below the speed.
        part: Fraction of the way to the next.
        smooth: Angle without what was added.
        side: −1 backwards, else 1.
        gained: What |θ̇_m| gains, rad/s².
        load: r τ_g, turned round backwards: its sine is of the angle alone, and knows no direction as what delays it does.
    """
    reference, torque = 0.0, 0.0
    for i in range(len(table)):
        below, above = table[i][low], table[i][low + 1]
        turned = waves[i][0] * smooth + waves[i][1]
        cosine, sine = waves[i][2] * math.cos(turned), waves[i][2] * side * math.sin(turned)
        real = below[0] + part * (above[0] - below[0]) + gained * (below[5] + part * (above[5] - below[5]))
        imaginary = below[1] + part * (above[1] - below[1]) + gained * (below[6] + part * (above[6] - below[6]))
        real += load * (below[9] + part * (above[9] - below[9]))
        imaginary += load * (below[10] + part * (above[10] - below[10]))
        reference += real * cosine - imaginary * sine
        real = below[2] + part * (above[2] - below[2]) + gained * (below[7] + part * (above[7] - below[7]))
        imaginary = below[3] + part * (above[3] - below[3]) + gained * (below[8] + part * (above[8] - below[8]))
        real += load * (below[11] + part * (above[11] - below[11]))
        imaginary += load * (below[12] + part * (above[12] - below[12]))
        torque += real * cosine - imaginary * sine
    return reference, torque


def cancellation_step(
    c: Any,
    s: Any,
    waves: Any,
    table: Any,
    period_s: float,
    angle: float,
    measured_nm: float,
) -> tuple[float, float]:
    """One sample of one axis: the additions to its set-point in rad, and to its torque in N·m.

    Args:
        c: The axis' parameters.
        s: The axis' memory; changed in place.
        waves: Order, phase, and factor of the amplitude; shape (n_waves, 3).
        table: Re and Im of G for the set-point, then for the torque; Re of the motor's part, which is 0 for mixed waves; Re and
            Im of the bend of either; Re and Im for each N·m of τ_g, of either; Im of the motor's part; shape (n_waves, n_speeds,
            14).
        period_s: Sampling time.
        angle: θ_m in rad, as measured.
        measured_nm: Motor torque, as measured.
    """
    if s.is_running == 0:
        s.speed_rad_s, s.slower_rad_s, s.left_nm = 0.0, 0.0, 0.0
    before = 2.0 * s.speed_rad_s - s.slower_rad_s
    low, part = speed_column(c, table, before)
    smooth = smooth_angle(waves, table, angle, low, part, -1.0 if before < 0.0 else 1.0)
    if s.is_running == 0:
        s.smooth_angle_rad = smooth
    turned_rad = abs(smooth - s.smooth_angle_rad)
    blend = lowpass_blend(c.speed_lowpass_hz, period_s)
    s.speed_rad_s += blend * ((smooth - s.smooth_angle_rad) / period_s - s.speed_rad_s)
    s.slower_rad_s += blend * (s.speed_rad_s - s.slower_rad_s)
    mean = 2.0 * s.speed_rad_s - s.slower_rad_s  # over the last period, on a ramp as late as neither
    s.smooth_angle_rad = smooth
    side = -1.0 if mean < 0.0 else 1.0
    # the difference of both is what a speed gains in the time by which the low-pass follows a ramp
    late_s = period_s * (1.0 - blend) / blend
    gained = side * (s.speed_rad_s - s.slower_rad_s) / late_s if late_s > 0.0 else 0.0
    gained = min(max(gained, -c.most_rad_s2), c.most_rad_s2)
    speed = mean + 0.5 * period_s * side * gained
    low, part = speed_column(c, table, speed)
    load = side * c.reaction * gear_torque(c, s, period_s, measured_nm, speed, side * gained)
    reference, torque = added(waves, table, low, part, smooth, side, gained, load)
    if s.is_running == 0:
        s.offset_rad, s.is_running = reference, 1
    s.offset_rad -= s.offset_rad * min(1.0, turned_rad / (2.0 * math.pi * c.fade_rev))
    reference -= s.offset_rad
    if c.torque_step_nm > 0.0:  # what is rounded off now is added next time: below 25 Hz nothing of it is left
        wanted = torque + s.left_nm
        torque = math.floor(wanted / c.torque_step_nm + 0.5) * c.torque_step_nm
        s.left_nm = wanted - torque
    return reference, torque


class InnerCancellation(NamedTuple):
    """The cancellation inside a drive: N A_k and φ_k of the orders 1, 2 and 4, J_m and D_m."""

    a2_rad: float
    phi2_rad: float
    a4_rad: float
    phi4_rad: float
    inertia_kg_m2: float
    damping_nm_s_rad: float
    a1_rad: float
    phi1_rad: float


def inner_cancellation(
    known: Any, lowpass_hz: float, period_s: float, angle: float, speed_rad_s: float
) -> tuple[float, float, float]:
    """One sample inside a drive, which knows angle and speed: Δθ_ref, Δθ̇_ff and Δτ, without a table.

    With Δθ_m = −Σ a_k cos(k θ_m + φ_k), a_k = N A_k: the set-point moves by Δθ_m, so that the position loop sees nothing of it;
    the velocity offset is F_lp s Δθ_m, as the loop measures it (F_lp as its delay, 1/2πf); the torque is J_m Δθ̈_m + D_m Δθ̇_m,
    half a period ahead for its hold. What the motion's own acceleration θ̈_0 adds to Δθ̈_m, a fraction of θ̈_0/(k θ̇_m²), is left
    out.

    Args:
        known: Amplitudes and phases, and the motor.
        lowpass_hz: Corner of F_lp.
        period_s: The drive's own sampling time.
        angle: θ_m as measured.
        speed_rad_s: θ̇_m as measured.
    """
    a2_rad, phi2_rad, a4_rad, phi4_rad, inertia_kg_m2, damping_nm_s_rad, a1_rad, phi1_rad = known
    reference = -a2_rad * math.cos(2.0 * angle + phi2_rad) - a4_rad * math.cos(4.0 * angle + phi4_rad)
    reference -= a1_rad * math.cos(angle + phi1_rad)
    late = angle - speed_rad_s / (2.0 * math.pi * lowpass_hz)
    rate = 2.0 * a2_rad * math.sin(2.0 * late + phi2_rad) + 4.0 * a4_rad * math.sin(4.0 * late + phi4_rad)
    rate += a1_rad * math.sin(late + phi1_rad)
    ahead = angle + 0.5 * period_s * speed_rad_s
    x1, x2, x4 = ahead + phi1_rad, 2.0 * ahead + phi2_rad, 4.0 * ahead + phi4_rad
    bend = 4.0 * a2_rad * math.cos(x2) + 16.0 * a4_rad * math.cos(x4) + a1_rad * math.cos(x1)
    slope = 2.0 * a2_rad * math.sin(x2) + 4.0 * a4_rad * math.sin(x4) + a1_rad * math.sin(x1)
    # θ_m + Σ a_k cos(k θ_m + φ_k) turns smoothly: θ̈_m (1 − slope) = θ̇_m² bend
    torque = inertia_kg_m2 * speed_rad_s * speed_rad_s * bend / max(1.0 - slope, 0.5) + damping_nm_s_rad * speed_rad_s * slope
    return reference, speed_rad_s * rate, torque


def cancel(
    configs: Any,
    states: Any,
    waves: Any,
    table: Any,
    period_s: float,
    values: Any,
) -> None:
    """Run `cancellation_step` for every axis.

    Args:
        configs: `CANCELLATION_CONFIG` array, shape (n_axes,).
        states: `CANCELLATION_STATE` array, shape (n_axes,).
        waves: Order, phase and factor; shape (n_axes, n_waves, 3).
        table: As in `cancellation_step`; shape (n_axes, n_waves, n_speeds, 13).
        period_s: Sampling time.
        values: Rows θ_m and measured torque in, which become Δθ_ref and Δτ; shape (2, n_axes).
    """
    for row in range(len(configs)):
        angle, measured_nm = values[0][row], values[1][row]
        reference, torque = cancellation_step(configs[row], states[row], waves[row], table[row], period_s, angle, measured_nm)
        values[0][row], values[1][row] = reference, torque
