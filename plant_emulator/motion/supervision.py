"""Limits and windows of an axis: which limit is broken, and whether target, speed and rest are reached; compiled."""

from hil.control.compiled import compiled
from plant_emulator.motion.record import (
    FOLLOWING,
    IN_POSITION,
    IN_SPEED,
    MOVING,
    OUT_OF_RANGE,
    OVERSHOOT,
    OVERSPEED,
    PROFILE,
    PROFILE_VELOCITY,
    VELOCITY,
    MotionRow,
)


@compiled
def watch_limits(m: MotionRow, speed: float, counts: float) -> None:
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


@compiled
def watch_windows(m: MotionRow, speed: float, angle: float) -> None:
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
