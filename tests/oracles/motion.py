"""The control period of a drive in plain Python: what the core in C has to compute.

Records are objects with the fields of the structs of `plant_emulator/motion/record.h`, see `tests.oracles.records`.
"""

import math
from typing import Any

from hil.control.notch import NOTCHES
from plant_emulator.motion.record import (
    BRAKED,
    FOLLOWING,
    HOME_FALLING,
    HOME_RISING,
    HOME_SWITCH,
    IN_POSITION,
    IN_SPEED,
    INDEX,
    LIMITED_SPEED,
    LIMITED_TORQUE,
    MOVING,
    NEGATIVE_FALLING,
    NEGATIVE_RISING,
    NEGATIVE_SWITCH,
    NO_SET_POINT,
    OUT_OF_RANGE,
    OVERSHOOT,
    OVERSPEED,
    POSITION,
    POSITIVE_FALLING,
    POSITIVE_RISING,
    POSITIVE_SWITCH,
    PROBE_1,
    PROBE_1_FALLING,
    PROBE_1_RISING,
    PROBE_2,
    PROBE_2_FALLING,
    PROBE_2_RISING,
    PROFILE,
    PROFILE_TORQUE,
    PROFILE_VELOCITY,
    SET_POINT_LATE,
    SET_POINT_RANGE,
    SET_POINT_STEP,
    STOPPED_RAD_S,
    STOPPING,
    TORQUE,
    VELOCITY,
)  # fmt: skip
from tests.oracles.law import FADE_S, InnerCancellation, cascade_start, hold_integrator, inner_cancellation, servo_step
from tests.oracles.plant import arm_acceleration, constants, go_through, grid_point, plant_period, put_error


def set_point_fraction(m: Any) -> float:
    """The fraction of the distance between the last two set-points that is gone at the end of this period.

    1 is reached with the last period of the interval. Beyond it the newest set-point is held. With `extrapolation_periods` the
    motion instead goes on at the same speed for so many periods, and then trips: the next set-point is late.
    """
    fraction = float((m.elapsed_periods + 1.0) / m.periods_per_set_point)
    m.elapsed_periods += 1
    if fraction <= 1.0:
        m.late_periods = 0
        return fraction
    if m.extrapolation_periods <= 0:
        return 1.0
    late = m.elapsed_periods - m.periods_per_set_point
    m.late_periods = late
    if late > m.extrapolation_periods:
        m.trip |= SET_POINT_LATE
        return 1.0 + float(m.extrapolation_periods / m.periods_per_set_point)
    return fraction


def interpolated_counts(m: Any) -> float:
    """The cyclic position set-point in this period: straight from the last to the newest."""
    fraction = set_point_fraction(m)
    return float(m.previous_counts + (m.target_counts - m.previous_counts) * fraction)


def interpolated_speed(m: Any) -> float:
    """The cyclic velocity set-point in this period; beyond the interval the newest is held, which is the last velocity."""
    fraction = min(1.0, set_point_fraction(m))
    wanted = m.previous_speed_rad_s + (m.target_speed_rad_s - m.previous_speed_rad_s) * fraction + m.velocity_offset_rad_s
    if abs(wanted) > m.max_speed_rad_s:
        m.limited |= LIMITED_SPEED
        return math.copysign(float(m.max_speed_rad_s), wanted)
    return float(wanted)


def _greatest_speed(m: Any) -> float:
    """The greatest speed that 607Fh and 6080h leave to a profile."""
    return float(min(m.max_profile_speed_rad_s, m.max_speed_rad_s))


def _towards(speed: float, wanted: float, up: float, down: float, period_s: float) -> float:
    """One period of a ramp between two speeds: `down` while the speed falls, to 0 where it turns round, and `up` from there."""
    turns = wanted * speed < 0.0
    change = (down if turns or abs(wanted) < abs(speed) else up) * period_s
    return speed + min(change, max(-change, (0.0 if turns else wanted) - speed))


def profile_position(m: Any, target_rad: float, period_s: float) -> None:
    """One period of the trapezoidal profile towards a target: never faster than it can still brake from.

    In whole periods T a stop from v takes v²/2a + v T/2: solved for v, so that the last step ends on the target. Where a new
    target lies closer than that, the reference passes it and comes back.
    """
    up = min(m.profile_acceleration_rad_s2, m.max_acceleration_rad_s2)
    down = min(m.profile_deceleration_rad_s2, m.max_deceleration_rad_s2)
    distance = target_rad - m.reference_rad
    loss = down * period_s
    braking = math.sqrt(0.25 * loss * loss + 2.0 * down * abs(distance)) - 0.5 * loss
    greatest = m.profile_speed_rad_s
    if greatest > _greatest_speed(m):
        greatest = _greatest_speed(m)
        if braking > greatest:
            m.limited |= LIMITED_SPEED
    wanted = math.copysign(min(greatest, braking), distance)
    m.reference_speed_rad_s = _towards(m.reference_speed_rad_s, wanted, up, down, period_s)
    step = m.reference_speed_rad_s * period_s
    arrives = abs(distance) <= abs(step) * (1.0 + 1e-9) or abs(distance) < 0.5 / m.counts_per_rad
    if arrives and abs(m.reference_speed_rad_s) <= 1.5 * loss:
        m.reference_rad, m.reference_speed_rad_s = target_rad, 0.0
    else:
        m.reference_rad += step


def profile_velocity(m: Any, period_s: float) -> float:
    """One period of the ramp towards the target velocity."""
    wanted, greatest = m.target_speed_rad_s, _greatest_speed(m)
    if abs(wanted) > greatest:
        m.limited |= LIMITED_SPEED
        wanted = math.copysign(greatest, wanted)
    up = min(m.profile_acceleration_rad_s2, m.max_acceleration_rad_s2)
    down = min(m.profile_deceleration_rad_s2, m.max_deceleration_rad_s2)
    m.reference_speed_rad_s = _towards(m.reference_speed_rad_s, wanted, up, down, period_s)
    return float(m.reference_speed_rad_s)


def profile_torque(m: Any, period_s: float) -> float:
    """One period of the slope towards the target torque; 60B2h is for cyclic modes and has no part in it."""
    change = m.torque_slope_nm_s * period_s
    return float(m.torque_demand_nm + min(change, max(-change, m.target_torque_nm - m.torque_demand_nm)))


def ramp_down(m: Any, period_s: float) -> None:
    """One period of the ramp to rest."""
    drop = min(m.stop_deceleration_rad_s2, m.max_deceleration_rad_s2) * period_s
    speed = m.reference_speed_rad_s
    m.reference_speed_rad_s = math.copysign(max(0.0, abs(speed) - drop), speed)
    m.reference_rad += m.reference_speed_rad_s * period_s
    if m.reference_speed_rad_s == 0.0:
        m.stop_periods += 1


def watch_limits(m: Any, speed: float, counts: float) -> None:
    """Hold the axis against its limits; what is broken is latched in `trip`."""
    if abs(m.following_error_rad) > m.following_window_rad:
        m.following_count += 1
        if m.following_count > m.following_periods:
            m.trip |= FOLLOWING
    else:
        m.following_count = 0
    if abs(speed) > m.max_speed_rad_s:
        # where the drive itself holds the demand to this speed, the loop's overshoot is no overspeed
        is_held = m.mode in (PROFILE, VELOCITY, PROFILE_VELOCITY)
        if not is_held or abs(speed) > OVERSHOOT * m.max_speed_rad_s:
            m.trip |= OVERSPEED
    if not m.low_counts <= counts <= m.high_counts:
        m.trip |= OUT_OF_RANGE


def watch_windows(m: Any, speed: float, angle: float) -> None:
    """Note which of target, speed and rest have been reached for as long as 6068h, 606Eh and 6070h ask."""
    reached = 0
    target = m.target_counts / m.counts_per_rad
    has_arrived = m.mode == PROFILE and m.reference_speed_rad_s == 0.0 and abs(target - m.reference_rad) < 1e-9
    if has_arrived and abs(target - angle) <= m.position_window_rad:
        reached |= IN_POSITION if m.position_window_count >= m.position_window_periods else 0
        m.position_window_count += 1
    else:
        m.position_window_count = 0
    if m.mode == PROFILE_VELOCITY and abs(m.target_speed_rad_s - speed) <= m.velocity_window_rad_s:
        reached |= IN_SPEED if m.velocity_window_count >= m.velocity_window_periods else 0
        m.velocity_window_count += 1
    else:
        m.velocity_window_count = 0
    if abs(speed) > m.velocity_threshold_rad_s:
        reached |= MOVING if m.velocity_threshold_count >= m.velocity_threshold_periods else 0
        m.velocity_threshold_count += 1
    else:
        m.velocity_threshold_count = 0
    m.reached = reached


def _boundary(low: float, high: float, before: float, counts: float) -> float:
    """The end of a switch's range that the motor has passed; the present position where the switch changed by itself."""
    if min(before, counts) < low <= max(before, counts) and not min(before, counts) <= high < max(before, counts):
        return low
    if min(before, counts) <= high < max(before, counts) and not min(before, counts) < low <= max(before, counts):
        return high
    return counts


def _latch(m: Any, bit: int, rising: int, falling: int, now: int, low: float, high: float, counts: float) -> None:
    """Keep what an input's edge has seen, until the owner has taken it."""
    if (now ^ m.inputs) & bit:
        edge = rising if now & bit else falling
        if not m.edges & (1 << edge):
            m.edges |= 1 << edge
            m.latch_counts[edge] = _boundary(low, high, m.seen_counts, counts)


def watch_inputs(m: Any, counts: float) -> None:
    """Look at all inputs once: their state, their edges, and the counts latched at these.

    A switch's edge lies where the switch does, as a capture unit in hardware has it; an input that is forced changes where the
    motor stands. Of several equal edges the first is kept until its bit of `edges` is cleared. The first look makes no edges.
    """
    mask = m.input_mask
    now = m.forced_inputs
    if mask & NEGATIVE_SWITCH and counts <= m.negative_switch_counts:
        now |= NEGATIVE_SWITCH
    if mask & POSITIVE_SWITCH and counts >= m.positive_switch_counts:
        now |= POSITIVE_SWITCH
    if mask & HOME_SWITCH and m.home_low_counts <= counts <= m.home_high_counts:
        now |= HOME_SWITCH
    if mask & PROBE_1 and m.probe_1_low_counts <= counts <= m.probe_1_high_counts:
        now |= PROBE_1
    if mask & PROBE_2 and m.probe_2_low_counts <= counts <= m.probe_2_high_counts:
        now |= PROBE_2
    if m.is_watching:
        known = m.edges
        if now != m.inputs:
            low, high = -math.inf, math.inf
            _latch(m, NEGATIVE_SWITCH, NEGATIVE_RISING, NEGATIVE_FALLING, now, low, m.negative_switch_counts, counts)
            _latch(m, POSITIVE_SWITCH, POSITIVE_RISING, POSITIVE_FALLING, now, m.positive_switch_counts, high, counts)
            _latch(m, HOME_SWITCH, HOME_RISING, HOME_FALLING, now, m.home_low_counts, m.home_high_counts, counts)
            _latch(m, PROBE_1, PROBE_1_RISING, PROBE_1_FALLING, now, m.probe_1_low_counts, m.probe_1_high_counts, counts)
            _latch(m, PROBE_2, PROBE_2_RISING, PROBE_2_FALLING, now, m.probe_2_low_counts, m.probe_2_high_counts, counts)
        turn = math.floor((counts - m.index_counts) / m.counts_per_rev)
        before = math.floor((m.seen_counts - m.index_counts) / m.counts_per_rev)
        if turn != before and not m.edges & (1 << INDEX):
            m.edges |= 1 << INDEX
            m.latch_counts[INDEX] = m.index_counts + max(turn, before) * m.counts_per_rev
        m.event |= m.edges & ~known & m.edge_mask
    m.inputs, m.seen_counts, m.is_watching = now, counts, 1


def restart_filters(law: Any, torque_nm: float) -> None:
    """Let the filters start anew on the torque that acts: they have been tracking one that was not applied."""
    for column in range(NOTCHES):
        law.notch_state[column].active = 0
        law.notch_state[column].mean_nm = torque_nm


def begin_stop(axis: Any, deceleration_rad_s2: float) -> None:
    """Turn to a ramp to rest from the present speed, without a jump of the torque.

    The position loop runs v/K_pp behind its reference, so the ramp starts that far ahead of the motor. So that the torque does
    not jump, the integrator absorbs the torque offset, or in torque modes the whole torque. In torque modes the filters restart
    too: they have been tracking a torque that was not applied.

    An infinite deceleration brakes with all the torque that the limits allow, and then holds the motor where it is; what the
    integrator has learnt of the load it keeps until then, but for a torque mode's.
    """
    m, s = axis.motion, axis.law.cascade_state
    is_hard = math.isinf(deceleration_rad_s2)
    lag = s.speed_rad_s / max(1.0, axis.law.cascade_config.position_gain_per_s)
    m.reference_rad = s.motor_angle_rad if is_hard else s.motor_angle_rad + lag
    m.reference_speed_rad_s = 0.0 if is_hard else s.speed_rad_s
    m.stop_deceleration_rad_s2 = deceleration_rad_s2
    m.stop_direction = math.copysign(1.0, s.speed_rad_s) if is_hard and abs(s.speed_rad_s) >= STOPPED_RAD_S else 0.0
    m.slowest_rad_s = math.inf
    m.stop_periods, m.stopped = 0, 0
    if m.mode in (TORQUE, PROFILE_TORQUE):
        cascade_start(s, s.motor_angle_rad, s.speed_rad_s, 0.0 if is_hard else m.torque_nm)
        restart_filters(axis.law, m.torque_nm)
    elif m.mode in (POSITION, PROFILE, VELOCITY):
        # a stop may begin twice: here when a limit breaks, and by the state machine's reaction to it
        s.integral_nm += m.torque_offset_nm
    m.mode = STOPPING


def _stopping_distance_rad(m: Any, speed_rad_s: float) -> float:
    """The distance in which a profile comes to rest from a speed, with its sign."""
    down = min(m.profile_deceleration_rad_s2, m.max_deceleration_rad_s2)
    return float(0.5 * speed_rad_s * abs(speed_rad_s) / down) if down > 0.0 else 0.0


def begin_mode(axis: Any, mode: int) -> None:
    """Turn from one mode to another while the motor is under torque, from its present motion and without a jump of the torque.

    Profiles go on from the present demand, cyclic modes from what is measured. The targets become what the motor does now:
    where it stands (POSITION), or can stop (PROFILE), its speed, its torque; the owner then gives new ones. The integrator takes
    what the new law would have the torque jump by, and gives it up with its own time constant.

    Args:
        axis: The axis; changed in place.
        mode: Neither BRAKED, which `Axes.open_brake` leaves, nor STOPPING, which `begin_stop` enters.
    """
    m, s, c = axis.motion, axis.law.cascade_state, axis.law.cascade_config
    speed, angle, torque = s.speed_rad_s, s.motor_angle_rad, m.torque_nm
    # in these the torque was not the law's own: its demand says nothing
    is_foreign = m.mode in (TORQUE, PROFILE_TORQUE) or (m.mode == STOPPING and m.stop_direction != 0.0)
    demand_speed = speed if is_foreign else m.demand_speed_rad_s
    error, torque_offset = 0.0, m.torque_offset_nm
    if mode == POSITION:
        m.previous_counts = m.target_counts = math.floor(angle * m.counts_per_rad + 0.5)
        error = m.velocity_offset_rad_s - speed
    elif mode == VELOCITY:
        m.previous_speed_rad_s = m.target_speed_rad_s = speed - m.velocity_offset_rad_s
    elif mode == PROFILE_VELOCITY:
        m.reference_speed_rad_s = m.target_speed_rad_s = demand_speed
        error, torque_offset = demand_speed - speed, 0.0
    elif mode == PROFILE:
        has_position = m.mode in (POSITION, PROFILE, STOPPING) and not is_foreign
        m.reference_rad = m.demand_rad if has_position else angle + speed / max(1.0, c.position_gain_per_s)
        m.reference_speed_rad_s = demand_speed
        target = m.reference_rad + _stopping_distance_rad(m, demand_speed)
        m.target_counts = math.floor(target * m.counts_per_rad + 0.5)
        error = c.position_gain_per_s * (m.reference_rad - angle) - speed
    else:
        m.torque_demand_nm = torque
        m.target_torque_nm = torque - (torque_offset if mode == TORQUE else 0.0)
    s.integral_nm = torque - torque_offset - c.velocity_gain_nm_s_rad * error
    s.error_rad_s = error
    if is_foreign:
        restart_filters(axis.law, torque)
    m.elapsed_periods, m.late_periods = NO_SET_POINT, 0
    m.demand_rad = m.reference_rad if mode == PROFILE else angle
    m.following_count = m.position_window_count = m.velocity_window_count = m.reached = m.stopped = 0
    m.stop_direction = 0.0
    m.mode = mode


def brake_hard(axis: Any, previous_integral_nm: float) -> float:
    """All the torque against the motion until it has ended, or turned round; the loop then holds the motor where it is.

    `stop_periods` counts the periods without progress: limits may leave too little torque for a stop.

    Args:
        axis: The axis; changed in place.
        previous_integral_nm: The integrator before this period, in N·m.

    Returns:
        The torque in N·m.
    """
    m, s = axis.motion, axis.law.cascade_state
    s.integral_nm = previous_integral_nm
    speed = s.speed_rad_s * m.stop_direction
    if speed < m.slowest_rad_s:
        m.slowest_rad_s = speed
    else:
        m.stop_periods += 1
    torque = m.torque_low_nm if m.stop_direction > 0.0 else m.torque_high_nm
    if speed < STOPPED_RAD_S:
        m.reference_rad, m.stop_direction = s.motor_angle_rad, 0.0
        restart_filters(axis.law, previous_integral_nm)
    return torque


def measured_counts(motor_angle: float, counts_per_rad: float) -> float:
    """The encoder's reading: the motor angle rounded to whole counts."""
    return math.floor(motor_angle * counts_per_rad + 0.5)


def _rest(axis: Any, angle: float) -> None:
    """Set law and outputs to those of a motor at rest behind a closed brake."""
    m, law = axis.motion, axis.law
    cascade_start(law.cascade_state, angle, 0.0, 0.0)
    for column in range(NOTCHES):
        law.notch_state[column].active = 0
        law.notch_state[column].speed_rps = 0.0
        law.notch_state[column].mean_nm = 0.0
    m.torque_nm, m.following_error_rad, m.cancel_fraction = 0.0, 0.0, 0.0
    m.demand_rad, m.demand_speed_rad_s, m.torque_demand_nm = angle, 0.0, 0.0
    m.limited = m.reached = m.late_periods = 0


def _demand(m: Any, angle: float, period_s: float) -> tuple[float, float, float]:
    """The mode's demand on the law in this period: position, velocity offset, torque offset."""
    position, velocity_offset, torque_offset, demand_speed = angle, 0.0, m.torque_offset_nm, 0.0
    if m.mode == POSITION:
        position = interpolated_counts(m) / m.counts_per_rad
        velocity_offset = m.velocity_offset_rad_s
        demand_speed = (position - m.demand_rad) / period_s
    elif m.mode == PROFILE:
        profile_position(m, m.target_counts / m.counts_per_rad, period_s)
        position, demand_speed = m.reference_rad, m.reference_speed_rad_s
    elif m.mode == STOPPING:
        torque_offset = 0.0
        if m.stop_direction == 0.0:
            ramp_down(m, period_s)
            position, demand_speed = m.reference_rad, m.reference_speed_rad_s
    elif m.mode == VELOCITY:
        velocity_offset = demand_speed = interpolated_speed(m)
    elif m.mode == PROFILE_VELOCITY:
        velocity_offset = demand_speed = profile_velocity(m, period_s)
        torque_offset = 0.0
    elif m.mode == TORQUE and m.extrapolation_periods > 0:
        set_point_fraction(m)  # the torque acts at once: all that counts of the interval is its end
    m.demand_rad, m.demand_speed_rad_s = position, demand_speed
    return position, velocity_offset, torque_offset


def _with_cancellation(
    axis: Any, angle: float, period_s: float, position: float, velocity_offset: float, torque_offset: float
) -> tuple[float, float, float]:
    """The demand with the drive's own cancellation of the transmission error, faded in or out.

    Args:
        axis: The axis; the fraction to which the cancellation is faded in moves on.
        angle: θ_m in rad, as measured.
        period_s: The control period.
        position: Demand without cancellation, in rad.
        velocity_offset: The same in rad/s.
        torque_offset: The same in N·m.
    """
    m = axis.motion
    m.cancel_fraction = min(1.0, max(0.0, m.cancel_fraction + math.copysign(period_s / FADE_S, m.cancel_mode - 0.5)))
    if m.mode in (POSITION, PROFILE):
        known = InnerCancellation(
            m.cancel_a2_rad,
            m.cancel_phi2_rad,
            m.cancel_a4_rad,
            m.cancel_phi4_rad,
            m.cancel_inertia_kg_m2,
            m.cancel_damping_nm_s_rad,
            m.cancel_a1_rad,
            m.cancel_phi1_rad,
        )
        speed = axis.law.cascade_state.speed_rad_s
        reference, rate, more = inner_cancellation(known, axis.law.cascade_config.lowpass_hz, period_s, angle, speed)
        position += m.cancel_fraction * reference
        velocity_offset += m.cancel_fraction * rate
        torque_offset += m.cancel_fraction * more
    return position, velocity_offset, torque_offset


def _used_torque(axis: Any, period_s: float, previous_integral_nm: float, torque_nm: float) -> float:
    """The torque that the mode uses: the law's, or its own.

    Args:
        axis: The axis.
        period_s: The control period.
        previous_integral_nm: The integrator before this period, in N·m.
        torque_nm: The law's torque.
    """
    m = axis.motion
    if m.mode == TORQUE:
        return float(m.target_torque_nm + m.torque_offset_nm)
    if m.mode == PROFILE_TORQUE:
        return profile_torque(m, period_s)
    if m.mode == STOPPING and m.stop_direction != 0.0:
        return brake_hard(axis, previous_integral_nm)
    return torque_nm


def _limited_torque(axis: Any, previous_integral_nm: float, torque_nm: float) -> float:
    """The torque within its limits; where these cut it, the integrator does not wind up."""
    m = axis.motion
    if m.torque_low_nm < torque_nm < m.torque_high_nm:
        return torque_nm
    limited = float(min(m.torque_high_nm, max(m.torque_low_nm, torque_nm)))
    if torque_nm != limited:
        hold_integrator(axis.law.cascade_state, previous_integral_nm, torque_nm - limited)
    m.limited |= LIMITED_TORQUE
    return limited


def _supervise(axis: Any, was_stopping: bool, counts: float, angle: float) -> None:
    """Note what is reached; hold the axis against its limits, and begin a stop where one is broken."""
    m, s = axis.motion, axis.law.cascade_state
    if m.mode not in (POSITION, TORQUE, VELOCITY):
        watch_windows(m, s.speed_rad_s, angle)
    if m.mode == STOPPING:
        if m.reference_speed_rad_s == 0.0 and m.stop_direction == 0.0 and abs(s.speed_rad_s) < STOPPED_RAD_S:
            m.stopped = 1
    else:
        watch_limits(m, s.speed_rad_s, counts)
        if m.trip != 0 and not was_stopping:
            begin_stop(axis, m.stop_deceleration_rad_s2)


def shown_angle(encoder: Any, angle: float) -> float:
    """What the encoder shows of a motor angle, before it is rounded to counts."""
    shown = angle + encoder.present_rad
    if encoder.e1_rad != 0.0 or encoder.e2_rad != 0.0:
        at_home = encoder.e1_rad * math.cos(encoder.phi1_rad) + encoder.e2_rad * math.cos(encoder.phi2_rad)
        error = encoder.e1_rad * math.cos(angle + encoder.phi1_rad) + encoder.e2_rad * math.cos(2.0 * angle + encoder.phi2_rad)
        shown += error - at_home
    return float(shown)


def draw_noise(encoder: Any) -> None:
    """The encoder's noise of the next control period: SplitMix64, and Box and Muller's transform of two."""

    def uniform() -> float:
        encoder.draws = z = encoder.draws + 0x9E3779B97F4A7C15 & 2**64 - 1
        z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 & 2**64 - 1
        z = (z ^ z >> 27) * 0x94D049BB133111EB & 2**64 - 1
        return ((z ^ z >> 31) // 2**11 + 0.5) / 2.0**53

    if encoder.noise_rad > 0.0:
        distance = math.sqrt(-2.0 * math.log(uniform()))
        encoder.present_rad = encoder.noise_rad * distance * math.cos(2.0 * math.pi * uniform())


def set_point(axis: Any, target_counts: float, period_s: float) -> None:
    """The next set-point of an axis in cyclic position mode: from its present demand, within the limits of place and speed."""
    m = axis.motion
    span, elapsed = m.periods_per_set_point, m.elapsed_periods
    fraction, last, start = elapsed / span, m.target_counts, m.previous_counts
    if fraction > 1.0:  # late: it has been held, or led on
        fraction = min(fraction, 1.0 + m.extrapolation_periods / span)
    start += (last - start) * fraction
    reach = m.max_speed_rad_s * m.counts_per_rad * span * period_s
    if not m.low_counts <= target_counts <= m.high_counts:
        m.trip |= SET_POINT_RANGE
        target_counts = start
    elif abs(target_counts - (last if elapsed >= span - 1 else start)) > reach + 1.0:
        m.trip |= SET_POINT_STEP
        target_counts = start
    m.previous_counts, m.target_counts, m.elapsed_periods = start, target_counts, 0


def command(axis: Any, period_s: float) -> float:
    """One control period of a drive: measure, set-point, law, limits; the torque in N·m, 0 behind a closed brake."""
    m = axis.motion
    counts = measured_counts(shown_angle(axis.encoder, axis.plant_state.motor_angle_rad), m.counts_per_rad)
    angle = counts / m.counts_per_rad
    if m.input_mask != 0 or m.edge_mask != 0:
        watch_inputs(m, counts)
    elif m.is_watching != 0:
        m.is_watching = 0
    if m.mode == BRAKED:
        _rest(axis, angle)
        return 0.0
    was_stopping = m.mode == STOPPING
    m.limited = 0
    position, velocity_offset, torque_offset = _demand(m, angle, period_s)
    if m.cancel_mode != 0 or m.cancel_fraction > 0.0:
        position, velocity_offset, torque_offset = _with_cancellation(
            axis, angle, period_s, position, velocity_offset, torque_offset
        )
    previous_integral_nm = axis.law.cascade_state.integral_nm
    # the law runs in torque modes too: it keeps the speed estimate, and its torque is passed over
    torque = servo_step(axis.law, period_s, m.torque_limit_nm, position, velocity_offset, torque_offset, angle)
    torque = _limited_torque(axis, previous_integral_nm, _used_torque(axis, period_s, previous_integral_nm, torque))
    m.torque_nm, m.torque_demand_nm, m.following_error_rad = torque, torque, position - angle
    _supervise(axis, was_stopping, counts, angle)
    return torque


def age(axis: Any, period_s: float) -> None:
    """Give the gear of an axis the error that it has after this control period; only for one that changes."""
    go_through(axis.change, axis.past, axis.plant, axis.plant_state, axis.motion.mode == BRAKED, period_s)
    put_error(axis.change, axis.past, axis.plant)


def advance(periods: int, period_s: float, substeps: int, axes: Any) -> None:
    """Advance all axes by some control periods: measure, set-point, servo law, limits, plant.

    A broken limit turns the axis to its stop ramp in the very period in which it is seen; the drive's state machine follows.

    Args:
        periods: Number of control periods.
        period_s: The control period, 250 µs.
        substeps: Runge-Kutta steps of the plant per period.
        axes: `AXIS` array, shape (n_axes,); changed in place.
    """
    for row in range(len(axes)):  # an axis feels nothing of the others: each goes through all periods alone
        axis = axes[row]
        m, mechanics = axis.motion, axis.plant_state
        k = constants(axis.plant)
        near = grid_point(k)
        for _ in range(periods):
            torque = command(axis, period_s)
            plant_period(k, near, mechanics, torque, m.mode == BRAKED, period_s, substeps)
            draw_noise(axis.encoder)
            if axis.change.is_changing > 0.0:
                age(axis, period_s)
                k = constants(axis.plant)
                near = grid_point(k)
        if m.trip != 0 or m.event != 0:
            m.wake = 1
        else:
            m.wake = 0
        if periods > 0:
            mechanics.arm_acceleration_rad_s2 = arm_acceleration(k, mechanics)
