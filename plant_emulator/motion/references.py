"""Demands of a control period: interpolated set-points, profiles and ramps; compiled."""

import math

from hil.control.compiled import compiled, inlined
from plant_emulator.motion.record import LIMITED_SPEED, SET_POINT_LATE, MotionRow


@inlined
def set_point_fraction(m: MotionRow) -> float:
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


@inlined
def interpolated_counts(m: MotionRow) -> float:
    """The cyclic position set-point in this period: straight from the last to the newest."""
    fraction = set_point_fraction(m)
    return float(m.previous_counts + (m.target_counts - m.previous_counts) * fraction)


@compiled
def interpolated_speed(m: MotionRow) -> float:
    """The cyclic velocity set-point in this period; beyond the interval the newest is held, which is the last velocity."""
    fraction = min(1.0, set_point_fraction(m))
    wanted = m.previous_speed_rad_s + (m.target_speed_rad_s - m.previous_speed_rad_s) * fraction + m.velocity_offset_rad_s
    if abs(wanted) > m.max_speed_rad_s:
        m.limited |= LIMITED_SPEED
        return math.copysign(float(m.max_speed_rad_s), wanted)
    return float(wanted)


@inlined
def _greatest_speed(m: MotionRow) -> float:
    """The greatest speed that 607Fh and 6080h leave to a profile."""
    return float(min(m.max_profile_speed_rad_s, m.max_speed_rad_s))


@inlined
def _towards(speed: float, wanted: float, up: float, down: float, period_s: float) -> float:
    """One period of a ramp between two speeds: `down` while the speed falls, to 0 where it turns round, and `up` from there."""
    turns = wanted * speed < 0.0
    change = (down if turns or abs(wanted) < abs(speed) else up) * period_s
    return speed + min(change, max(-change, (0.0 if turns else wanted) - speed))


@compiled
def profile_position(m: MotionRow, target_rad: float, period_s: float) -> None:
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


@compiled
def profile_velocity(m: MotionRow, period_s: float) -> float:
    """One period of the ramp towards the target velocity."""
    wanted, greatest = m.target_speed_rad_s, _greatest_speed(m)
    if abs(wanted) > greatest:
        m.limited |= LIMITED_SPEED
        wanted = math.copysign(greatest, wanted)
    up = min(m.profile_acceleration_rad_s2, m.max_acceleration_rad_s2)
    down = min(m.profile_deceleration_rad_s2, m.max_deceleration_rad_s2)
    m.reference_speed_rad_s = _towards(m.reference_speed_rad_s, wanted, up, down, period_s)
    return float(m.reference_speed_rad_s)


@compiled
def profile_torque(m: MotionRow, period_s: float) -> float:
    """One period of the slope towards the target torque; 60B2h is for cyclic modes and has no part in it."""
    change = m.torque_slope_nm_s * period_s
    return float(m.torque_demand_nm + min(change, max(-change, m.target_torque_nm - m.torque_demand_nm)))


@compiled
def ramp_down(m: MotionRow, period_s: float) -> None:
    """One period of the ramp to rest."""
    drop = min(m.stop_deceleration_rad_s2, m.max_deceleration_rad_s2) * period_s
    speed = m.reference_speed_rad_s
    m.reference_speed_rad_s = math.copysign(max(0.0, abs(speed) - drop), speed)
    m.reference_rad += m.reference_speed_rad_s * period_s
    if m.reference_speed_rad_s == 0.0:
        m.stop_periods += 1
