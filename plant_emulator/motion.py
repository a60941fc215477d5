"""What a drive does in each of its control periods: set-point, servo law, limits; compiled, all axes in one call."""

import math
from typing import Any

from hil.control.cascade import cascade_start, hold_integrator
from hil.control.compensation import FADE_S, inner_compensation
from hil.control.compiled import compiled, inlined
from hil.control.servo import servo_step
from plant_emulator.motion_data import (
    BRAKED,
    EDGES,
    FOLLOWING,
    HOME_FALLING,
    HOME_RISING,
    HOME_SWITCH,
    IN_POSITION,
    IN_SPEED,
    INDEX,
    LIMITED_SPEED,
    LIMITED_TORQUE,
    MOTION,
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
)
from plant_emulator.motion_inputs import watch_inputs
from plant_emulator.motion_references import (
    interpolated_counts,
    interpolated_speed,
    profile_position,
    profile_torque,
    profile_velocity,
    ramp_down,
    set_point_share,
)
from plant_emulator.physics.axis import arm_acceleration, constants, nearby, plant_period

__all__ = [
    "BRAKED", "EDGES", "FOLLOWING", "HOME_FALLING", "HOME_RISING", "HOME_SWITCH", "INDEX", "IN_POSITION", "IN_SPEED",
    "LIMITED_SPEED", "LIMITED_TORQUE", "MOTION", "MOVING", "NEGATIVE_FALLING", "NEGATIVE_RISING", "NEGATIVE_SWITCH",
    "NO_SET_POINT", "OUT_OF_RANGE", "OVERSPEED", "POSITION", "POSITIVE_FALLING", "POSITIVE_RISING", "POSITIVE_SWITCH", "PROBE_1",
    "PROBE_1_FALLING", "PROBE_1_RISING", "PROBE_2", "PROBE_2_FALLING", "PROBE_2_RISING", "PROFILE", "PROFILE_TORQUE",
    "PROFILE_VELOCITY", "SET_POINT_LATE", "SET_POINT_RANGE", "SET_POINT_STEP", "STOPPED_RAD_S", "STOPPING", "TORQUE", "VELOCITY",
    "advance", "begin_mode", "begin_stop", "command", "measured_counts",
]  # fmt: skip


@inlined
def measured_counts(motor_angle: float, counts_per_rad: float) -> float:
    """What the encoder shows: the motor angle rounded to whole counts."""
    return math.floor(motor_angle * counts_per_rad + 0.5)


@compiled
def _watch(m: Any, speed: float, counts: float) -> None:
    """Hold the axis against its limits; what is broken is latched in `trip`."""
    if abs(m.following_error_rad) > m.following_window_rad:
        m.following_count += 1
        if m.following_count > m.following_ticks:
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


@compiled
def _windows(m: Any, speed: float, angle: float) -> None:
    """Whether target and rest are reached, and have been for as long as 6068h, 606Eh and 6070h ask."""
    reached = 0
    target = m.target_counts / m.counts_per_rad
    has_arrived = m.mode == PROFILE and m.reference_speed_rad_s == 0.0 and abs(target - m.reference_rad) < 1e-9
    if has_arrived and abs(target - angle) <= m.position_window_rad:
        reached |= IN_POSITION if m.position_window_count >= m.position_window_ticks else 0
        m.position_window_count += 1
    else:
        m.position_window_count = 0
    if m.mode == PROFILE_VELOCITY and abs(m.target_speed_rad_s - speed) <= m.velocity_window_rad_s:
        reached |= IN_SPEED if m.velocity_window_count >= m.velocity_window_ticks else 0
        m.velocity_window_count += 1
    else:
        m.velocity_window_count = 0
    if abs(speed) > m.velocity_threshold_rad_s:
        reached |= MOVING if m.velocity_threshold_count >= m.velocity_threshold_ticks else 0
        m.velocity_threshold_count += 1
    else:
        m.velocity_threshold_count = 0
    m.reached = reached


@inlined
def _forget_filters(notch_state: Any, row: int, torque_nm: float) -> None:
    """Filters that have followed a torque which nobody used start anew, on the one that acts."""
    for column in range(notch_state.shape[1]):
        notch_state[row, column].active = 0
        notch_state[row, column].mean_nm = torque_nm


@compiled
def begin_stop(
    motion: Any, cascade_config: Any, cascade_state: Any, notch_state: Any, row: int, deceleration_rad_s2: float
) -> None:
    """Turn to a ramp to rest from the present speed, without a jump of the torque.

    The position loop runs v/K_pp behind its reference, so the ramp starts that far ahead of the motor. The integrator takes
    over what comes from outside the law and ends with the stop: the torque offset, or the whole torque of a torque mode,
    in which the filters have been following a torque that nobody used and start anew.

    An infinite deceleration brakes with all the torque that the limits allow, and then holds the motor where it is; what the
    integrator has learnt of the load it keeps until then, but for a torque mode's.
    """
    m, s = motion[row], cascade_state[row]
    is_hard = math.isinf(deceleration_rad_s2)
    lag = s.speed_rad_s / max(1.0, cascade_config[row].position_gain_per_s)
    m.reference_rad = s.motor_angle_rad if is_hard else s.motor_angle_rad + lag
    m.reference_speed_rad_s = 0.0 if is_hard else s.speed_rad_s
    m.stop_deceleration_rad_s2 = deceleration_rad_s2
    m.stop_direction = math.copysign(1.0, s.speed_rad_s) if is_hard and abs(s.speed_rad_s) >= STOPPED_RAD_S else 0.0
    m.slowest_rad_s = math.inf
    m.stop_ticks, m.stopped = 0, 0
    if m.mode in (TORQUE, PROFILE_TORQUE):
        cascade_start(cascade_state, row, s.motor_angle_rad, s.speed_rad_s, 0.0 if is_hard else m.torque_nm)
        _forget_filters(notch_state, row, m.torque_nm)
    elif m.mode in (POSITION, PROFILE, VELOCITY):
        # a stop may begin twice: here when a limit breaks, and by the state machine's reaction to it
        s.integral_nm += m.torque_offset_nm
    m.mode = STOPPING


@compiled
def begin_mode(motion: Any, cascade_config: Any, cascade_state: Any, notch_state: Any, row: int, mode: int) -> None:
    """Turn from one mode to another while the motor is under torque, from its present motion and without a jump of the torque.

    Profiles go on from the present demand, cyclic modes from what is measured. The targets become what the motor does now:
    where it stands (POSITION), or can stop (PROFILE), its speed, its torque; the owner then gives new ones. The integrator takes
    what the new law would have the torque jump by, and gives it up with its own time constant.

    Args:
        motion: `MOTION` array, shape (n_axes,).
        cascade_config: `CASCADE_CONFIG` array, shape (n_axes,).
        cascade_state: `CASCADE_STATE` array, shape (n_axes,).
        notch_state: `NOTCH_STATE` array, shape (n_axes, NOTCHES).
        row: Axis.
        mode: Neither BRAKED, which `Axes.energise` leaves, nor STOPPING, which `begin_stop` enters.
    """
    m, s, c = motion[row], cascade_state[row], cascade_config[row]
    speed, angle, torque = s.speed_rad_s, s.motor_angle_rad, m.torque_nm
    is_unheard = m.mode in (TORQUE, PROFILE_TORQUE) or (m.mode == STOPPING and m.stop_direction != 0.0)
    demand_speed = speed if is_unheard else m.demand_speed_rad_s
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
        has_position = m.mode in (POSITION, PROFILE, STOPPING) and not is_unheard
        m.reference_rad = m.demand_rad if has_position else angle + speed / max(1.0, c.position_gain_per_s)
        m.reference_speed_rad_s = demand_speed
        down = min(m.profile_deceleration_rad_s2, m.max_deceleration_rad_s2)
        way = 0.5 * demand_speed * abs(demand_speed) / down if down > 0.0 else 0.0
        m.target_counts = math.floor((m.reference_rad + way) * m.counts_per_rad + 0.5)
        error = c.position_gain_per_s * (m.reference_rad - angle) - speed
    else:
        m.torque_demand_nm = torque
        m.target_torque_nm = torque - (torque_offset if mode == TORQUE else 0.0)
    s.integral_nm = torque - torque_offset - c.velocity_gain_nm_s_rad * error
    s.error_rad_s = error
    if is_unheard:
        _forget_filters(notch_state, row, torque)
    m.tick, m.late_ticks = NO_SET_POINT, 0
    m.demand_rad = m.reference_rad if mode == PROFILE else angle
    m.following_count = m.position_window_count = m.velocity_window_count = m.reached = m.stopped = 0
    m.stop_direction = 0.0
    m.mode = mode


@compiled
def _brake_hard(m: Any, s: Any, notch_state: Any, row: int, kept_nm: float, angle: float) -> float:
    """All the torque against the motion until it has ended, or turned round; the loop then holds the motor where it is.

    `stop_ticks` counts the periods without progress: limits may leave too little torque for a stop.
    """
    s.integral_nm = kept_nm
    speed = s.speed_rad_s * m.stop_direction
    if speed < m.slowest_rad_s:
        m.slowest_rad_s = speed
    else:
        m.stop_ticks += 1
    torque = float(m.torque_low_nm if m.stop_direction > 0.0 else m.torque_high_nm)
    if speed < STOPPED_RAD_S:
        m.reference_rad, m.stop_direction = angle, 0.0
        _forget_filters(notch_state, row, kept_nm)
    return torque


@inlined
def _rest(m: Any, angle: float) -> None:
    """What comes out behind a closed brake."""
    m.torque_nm, m.following_error_rad, m.cancel_share = 0.0, 0.0, 0.0
    m.demand_rad, m.demand_speed_rad_s, m.torque_demand_nm = angle, 0.0, 0.0
    m.limited = m.reached = m.late_ticks = 0


@inlined
def _demand(m: Any, angle: float, period_s: float) -> tuple[float, float, float]:
    """What the mode asks of the law in this period: position, velocity offset, torque offset."""
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
    elif m.mode == TORQUE and m.extrapolate_ticks > 0:
        set_point_share(m)  # the torque acts at once: all that counts of the interval is its end
    m.demand_rad, m.demand_speed_rad_s = position, demand_speed
    return position, velocity_offset, torque_offset


@inlined
def _used_torque(m: Any, s: Any, notch_state: Any, row: int, period_s: float, kept_nm: float, torque_nm: float) -> float:
    """What the mode makes of the law's torque."""
    if m.mode == TORQUE:
        return float(m.target_torque_nm + m.torque_offset_nm)
    if m.mode == PROFILE_TORQUE:
        return profile_torque(m, period_s)
    if m.mode == STOPPING and m.stop_direction != 0.0:
        return _brake_hard(m, s, notch_state, row, kept_nm, s.motor_angle_rad)
    return torque_nm


@inlined
def _limited_torque(m: Any, cascade_state: Any, row: int, kept_nm: float, torque_nm: float) -> float:
    """The torque within its limits; where these cut it, the integrator does not wind up."""
    if m.torque_low_nm < torque_nm < m.torque_high_nm:
        return torque_nm
    limited = float(min(m.torque_high_nm, max(m.torque_low_nm, torque_nm)))
    if torque_nm != limited:
        hold_integrator(cascade_state, row, kept_nm, torque_nm - limited)
    m.limited |= LIMITED_TORQUE
    return limited


@inlined
def command(
    motion: Any,
    row: int,
    motor_angle: float,
    period_s: float,
    cascade_config: Any,
    cascade_state: Any,
    notch_config: Any,
    notch_state: Any,
) -> float:
    """What a drive makes of a control period: measure, set-point, law, limits; the torque in N·m, 0 behind a closed brake."""
    m = motion[row]
    counts = measured_counts(motor_angle, m.counts_per_rad)
    angle = counts / m.counts_per_rad
    if m.input_mask != 0 or m.edge_mask != 0:
        watch_inputs(m, counts)
    elif m.is_watching != 0:
        m.is_watching = 0
    if m.mode == BRAKED:
        cascade_start(cascade_state, row, angle, 0.0, 0.0)
        for column in range(notch_state.shape[1]):
            notch_state[row, column].active = 0
            notch_state[row, column].speed_rps = 0.0
            notch_state[row, column].mean_nm = 0.0
        _rest(m, angle)
        return 0.0
    before = m.mode
    m.limited = 0
    position, velocity_offset, torque_offset = _demand(m, angle, period_s)
    if m.cancel_mode != 0 or m.cancel_share > 0.0:
        m.cancel_share = min(1.0, max(0.0, m.cancel_share + math.copysign(period_s / FADE_S, m.cancel_mode - 0.5)))
        if m.mode in (POSITION, PROFILE):
            reference, rate, more = inner_compensation(
                m.cancel_a2_rad,
                m.cancel_phi2_rad,
                m.cancel_a4_rad,
                m.cancel_phi4_rad,
                m.cancel_inertia_kg_m2,
                m.cancel_damping_nm_s_rad,
                cascade_config[row].lowpass_hz,
                period_s,
                angle,
                cascade_state[row].speed_rad_s,
            )
            position += m.cancel_share * reference
            velocity_offset += m.cancel_share * rate
            torque_offset += m.cancel_share * more
    s = cascade_state[row]
    kept_nm = s.integral_nm
    # the law runs in torque modes too: it keeps the speed estimate, and its torque is passed over
    torque = servo_step(
        cascade_config,
        cascade_state,
        notch_config,
        notch_state,
        row,
        period_s,
        m.torque_limit_nm,
        position,
        velocity_offset,
        torque_offset,
        angle,
    )
    torque = _limited_torque(m, cascade_state, row, kept_nm, _used_torque(m, s, notch_state, row, period_s, kept_nm, torque))
    m.torque_nm, m.torque_demand_nm, m.following_error_rad = torque, torque, position - angle
    if m.mode not in (POSITION, TORQUE, VELOCITY):
        _windows(m, s.speed_rad_s, angle)
    if m.mode == STOPPING:
        if m.reference_speed_rad_s == 0.0 and m.stop_direction == 0.0 and abs(s.speed_rad_s) < STOPPED_RAD_S:
            m.stopped = 1
    else:
        _watch(m, s.speed_rad_s, counts)
        if m.trip != 0 and before != STOPPING:
            begin_stop(motion, cascade_config, cascade_state, notch_state, row, m.stop_deceleration_rad_s2)
    return float(torque)


@compiled
def advance(
    ticks: int,
    period_s: float,
    substeps: int,
    plant: Any,
    plant_state: Any,
    motion: Any,
    cascade_config: Any,
    cascade_state: Any,
    notch_config: Any,
    notch_state: Any,
) -> None:
    """Advance all axes by some control periods: measure, set-point, servo law, limits, plant.

    A broken limit turns the axis to its stop ramp in the very period in which it is seen; the drive's state machine follows.

    Args:
        ticks: How many control periods.
        period_s: The control period, 250 µs.
        substeps: Runge-Kutta steps of the plant per period.
        plant: `PLANT` array, shape (n_axes,).
        plant_state: `PLANT_STATE` array, shape (n_axes,).
        motion: `MOTION` array, shape (n_axes,).
        cascade_config: `CASCADE_CONFIG` array, shape (n_axes,).
        cascade_state: `CASCADE_STATE` array, shape (n_axes,).
        notch_config: `NOTCH_CONFIG` array, shape (n_axes, NOTCHES).
        notch_state: `NOTCH_STATE` array, shape (n_axes, NOTCHES).
    """
    for row in range(plant.shape[0]):  # an axis feels nothing of the others: each goes its whole way alone
        m, mechanics = motion[row], plant_state[row]
        k = constants(plant[row])
        near = nearby(k, mechanics.motor_angle, mechanics.arm_angle)
        for _ in range(ticks):
            angle = mechanics.motor_angle
            torque = command(motion, row, angle, period_s, cascade_config, cascade_state, notch_config, notch_state)
            near = plant_period(k, near, mechanics, torque, m.mode == BRAKED, period_s, substeps)
        if m.trip != 0 or m.event != 0:
            m.wake = 1
        else:
            m.wake = 0
        if ticks > 0:
            mechanics.arm_acceleration = arm_acceleration(k, mechanics)
