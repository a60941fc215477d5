"""What a drive does in each of its control periods: set-point, servo law, limits; compiled, all axes in one call."""

import math
from typing import Any

import numpy as np

from hil.control.cascade import cascade_start
from hil.control.compensation import FADE_S, inner_compensation
from hil.control.compiled import compiled, inlined
from hil.control.servo import servo_step
from plant_emulator.physics.axis import arm_acceleration, constants, nearby, plant_period

BRAKED, POSITION, TORQUE, PROFILE, STOPPING = 0, 1, 2, 3, 4
"""What the power stage does: brake closed and no torque; cyclic position; cyclic torque; profile position; ramp to rest."""

FOLLOWING, OVERSPEED, OUT_OF_RANGE, SET_POINT_RANGE, SET_POINT_STEP = 1, 2, 4, 8, 16
"""Bits of `trip`: which limit has been broken since the trip was last cleared."""

STOPPED_RAD_S = 0.5
"""Below this speed a ramp to rest counts as done (0.08 motor revolutions per second)."""

MOTION = np.dtype([
    ("mode", np.int64),
    ("counts_per_rad", np.float64),
    # cyclic position: the last two set-points, and how far the way between them has been gone
    ("previous_counts", np.float64), ("target_counts", np.float64),
    ("tick", np.int64), ("ticks_per_set_point", np.int64),
    ("velocity_offset_rad_s", np.float64), ("torque_offset_nm", np.float64),
    ("target_torque_nm", np.float64), ("torque_limit_nm", np.float64),
    # profile position and ramps
    ("profile_speed_rad_s", np.float64), ("profile_acceleration_rad_s2", np.float64),
    ("profile_deceleration_rad_s2", np.float64), ("stop_deceleration_rad_s2", np.float64),
    ("reference_rad", np.float64), ("reference_speed_rad_s", np.float64), ("stop_ticks", np.int64),
    # limits
    ("low_counts", np.float64), ("high_counts", np.float64), ("max_speed_rad_s", np.float64),
    ("following_window_rad", np.float64), ("following_ticks", np.int64), ("following_count", np.int64),
    # cancellation of the transmission error: amplitudes N A_k at the motor, and how far it is faded in
    ("cancel_mode", np.int64), ("cancel_share", np.float64),
    ("cancel_a2_rad", np.float64), ("cancel_phi2_rad", np.float64),
    ("cancel_a4_rad", np.float64), ("cancel_phi4_rad", np.float64),
    ("cancel_inertia_kg_m2", np.float64), ("cancel_damping_nm_s_rad", np.float64),
    # what comes out
    ("trip", np.int64), ("stopped", np.int64), ("torque_nm", np.float64), ("following_error_rad", np.float64),
])  # fmt: skip
"""A drive's process data, between its object dictionary and the compiled period."""


@inlined
def measured_counts(motor_angle: float, counts_per_rad: float) -> float:
    """What the encoder shows: the motor angle rounded to whole counts."""
    return math.floor(motor_angle * counts_per_rad + 0.5)


@inlined
def _interpolated(m: Any) -> float:
    """The cyclic set-point in this period: straight from the last to the newest, which is reached with the last period."""
    share = min(1.0, (m.tick + 1.0) / m.ticks_per_set_point)
    return float(m.previous_counts + (m.target_counts - m.previous_counts) * share)


@compiled
def _profile(m: Any, target_rad: float, period_s: float) -> None:
    """One period of the trapezoidal profile towards a target: never faster than it can still brake from.

    In whole periods T a stop from v takes v²/2a + v T/2: solved for v, so that the last step ends on the target. Where a new
    target lies closer than that, the reference passes it and comes back.
    """
    distance = target_rad - m.reference_rad
    loss = m.profile_deceleration_rad_s2 * period_s
    braking = math.sqrt(0.25 * loss * loss + 2.0 * m.profile_deceleration_rad_s2 * abs(distance)) - 0.5 * loss
    allowed = min(m.profile_speed_rad_s, braking)
    wanted = math.copysign(allowed, distance)
    slowing = abs(wanted) < abs(m.reference_speed_rad_s) or wanted * m.reference_speed_rad_s < 0.0
    rate = m.profile_deceleration_rad_s2 if slowing else m.profile_acceleration_rad_s2
    change = min(rate * period_s, max(-rate * period_s, wanted - m.reference_speed_rad_s))
    m.reference_speed_rad_s += change
    step = m.reference_speed_rad_s * period_s
    arrives = abs(distance) <= abs(step) * (1.0 + 1e-9) or abs(distance) < 0.5 / m.counts_per_rad
    if arrives and abs(m.reference_speed_rad_s) <= 1.5 * loss:
        m.reference_rad, m.reference_speed_rad_s = target_rad, 0.0
    else:
        m.reference_rad += step


@compiled
def _ramp_down(m: Any, period_s: float) -> None:
    """One period of the ramp to rest."""
    drop = m.stop_deceleration_rad_s2 * period_s
    speed = m.reference_speed_rad_s
    m.reference_speed_rad_s = math.copysign(max(0.0, abs(speed) - drop), speed)
    m.reference_rad += m.reference_speed_rad_s * period_s
    if m.reference_speed_rad_s == 0.0:
        m.stop_ticks += 1


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
        m.trip |= OVERSPEED
    if not m.low_counts <= counts <= m.high_counts:
        m.trip |= OUT_OF_RANGE


@compiled
def begin_stop(
    motion: Any, cascade_config: Any, cascade_state: Any, notch_state: Any, row: int, deceleration_rad_s2: float
) -> None:
    """Turn to a ramp to rest from the present speed, without a jump of the torque.

    The position loop runs v/K_pp behind its reference, so the ramp starts that far ahead of the motor. The integrator takes
    over what comes from outside the law and ends with the stop: the torque offset, or the whole torque of a cyclic torque mode,
    in which the filters have been following a torque that nobody used and start anew.
    """
    m, s = motion[row], cascade_state[row]
    lag = s.speed_rad_s / max(1.0, cascade_config[row].position_gain_per_s)
    m.reference_rad = s.motor_angle_rad + lag
    m.reference_speed_rad_s = s.speed_rad_s
    m.stop_deceleration_rad_s2 = deceleration_rad_s2
    m.stop_ticks, m.stopped = 0, 0
    if m.mode == TORQUE:
        cascade_start(cascade_state, row, s.motor_angle_rad, s.speed_rad_s, m.torque_nm)
        for column in range(notch_state.shape[1]):
            notch_state[row, column].active = 0
            notch_state[row, column].mean_nm = m.torque_nm
    elif m.mode != STOPPING:  # a stop may begin twice: here when a limit breaks, and by the state machine's reaction to it
        s.integral_nm += m.torque_offset_nm
    m.mode = STOPPING


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
    if m.mode == BRAKED:
        cascade_start(cascade_state, row, angle, 0.0, 0.0)
        for column in range(notch_state.shape[1]):
            notch_state[row, column].active = 0
            notch_state[row, column].speed_rps = 0.0
            notch_state[row, column].mean_nm = 0.0
        m.torque_nm, m.following_error_rad, m.cancel_share = 0.0, 0.0, 0.0
        return 0.0
    before = m.mode
    position, velocity_offset, torque_offset = angle, 0.0, m.torque_offset_nm
    if m.mode == POSITION:
        position = _interpolated(m) / m.counts_per_rad
        velocity_offset = m.velocity_offset_rad_s
        m.tick += 1
    elif m.mode == PROFILE:
        _profile(m, m.target_counts / m.counts_per_rad, period_s)
        position = m.reference_rad
    elif m.mode == STOPPING:
        _ramp_down(m, period_s)
        position, torque_offset = m.reference_rad, 0.0
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
    # the law runs in torque mode too: it keeps the speed estimate, and its torque is passed over
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
    speed = cascade_state[row].speed_rad_s
    if m.mode == TORQUE:
        wanted = m.target_torque_nm + m.torque_offset_nm
        torque = min(m.torque_limit_nm, max(-m.torque_limit_nm, wanted))
    m.torque_nm, m.following_error_rad = torque, position - angle
    if m.mode == STOPPING:
        if m.reference_speed_rad_s == 0.0 and abs(speed) < STOPPED_RAD_S:
            m.stopped = 1
    else:
        _watch(m, speed, counts)
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
        if ticks > 0:
            mechanics.arm_acceleration = arm_acceleration(k, mechanics)
