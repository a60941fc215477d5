"""Transitions of an axis under torque to another mode, or to a stop, without a jump of the torque; compiled."""

import math

from hil.control.cascade import cascade_start
from hil.control.compiled import compiled, inlined
from hil.control.notch import NOTCHES
from hil.control.servo import LawRow
from plant_emulator.motion.record import (
    NO_SET_POINT,
    POSITION,
    PROFILE,
    PROFILE_TORQUE,
    PROFILE_VELOCITY,
    STOPPED_RAD_S,
    STOPPING,
    TORQUE,
    VELOCITY,
    AxisRow,
    MotionRow,
)


@inlined
def restart_filters(law: LawRow, torque_nm: float) -> None:
    """Let the filters start anew on the torque that acts: they have been tracking one that was not applied."""
    for column in range(NOTCHES):
        law.notch_state[column].active = 0
        law.notch_state[column].mean_nm = torque_nm


@inlined  # a door of its own besides: numba's cache would keep what `advance` has of a compiled one, and then serve the door
def begin_stop(axis: AxisRow, deceleration_rad_s2: float) -> None:
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


@inlined
def _stopping_distance_rad(m: MotionRow, speed_rad_s: float) -> float:
    """The distance in which a profile comes to rest from a speed, with its sign."""
    down = min(m.profile_deceleration_rad_s2, m.max_deceleration_rad_s2)
    return float(0.5 * speed_rad_s * abs(speed_rad_s) / down) if down > 0.0 else 0.0


@compiled
def begin_mode(axis: AxisRow, mode: int) -> None:
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


@compiled
def brake_hard(axis: AxisRow, previous_integral_nm: float) -> float:
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
