"""A drive's process data: what the object dictionary and the compiled control period say to each other, in SI and counts."""

import numpy as np

BRAKED, POSITION, TORQUE, PROFILE, STOPPING, VELOCITY, PROFILE_VELOCITY, PROFILE_TORQUE = range(8)
"""What the power stage does.

Brake closed and no torque; cyclic position (CSP, IP); cyclic torque (CST); profile position (PP); ramp to rest; cyclic velocity
(CSV); profile velocity (PV, and the search moves of homing); profile torque (TQ).
"""

FOLLOWING, OVERSPEED, OUT_OF_RANGE, SET_POINT_RANGE, SET_POINT_STEP, SET_POINT_LATE = 1, 2, 4, 8, 16, 32
"""Bits of `trip`: which limit has been broken since the trip was last cleared."""

LIMITED_TORQUE, LIMITED_SPEED = 1, 2
"""Bits of `limited`: the torque stands at its limit; the speed that is asked for is above the greatest that is allowed."""

IN_POSITION, IN_SPEED, MOVING = 1, 2, 4
"""Bits of `reached`: within 6067h for 6068h; within 606Dh for 606Eh; above 606Fh for 6070h."""

NEGATIVE_SWITCH, POSITIVE_SWITCH, HOME_SWITCH, PROBE_1, PROBE_2 = 1, 2, 4, 8, 16
"""Bits of `inputs`, `input_mask` and `forced_inputs`."""

(
    HOME_RISING,
    HOME_FALLING,
    INDEX,
    NEGATIVE_RISING,
    NEGATIVE_FALLING,
    POSITIVE_RISING,
    POSITIVE_FALLING,
    PROBE_1_RISING,
    PROBE_1_FALLING,
    PROBE_2_RISING,
    PROBE_2_FALLING,
) = range(11)
"""Places in `latch_counts`; bit ``1 << place`` of `edges` and `edge_mask` belongs to the same edge."""

EDGES = 11

NO_SET_POINT = -(1 << 40)
"""`tick` before the first set-point of a cyclic mode: nothing is late that was never begun."""

STOPPED_RAD_S = 0.5
"""Below this speed a ramp to rest counts as done (0.08 motor revolutions per second)."""

OVERSHOOT = 1.1
"""By how much the speed may exceed 6080h where the drive itself holds the demand to it: a speed loop overshoots and ripples."""

MOTION = np.dtype([
    ("mode", np.int64),
    ("counts_per_rad", np.float64), ("counts_per_rev", np.float64),
    # cyclic position: the last two set-points, and how far the way between them has been gone
    ("previous_counts", np.float64), ("target_counts", np.float64),
    ("tick", np.int64), ("ticks_per_set_point", np.int64), ("extrapolate_ticks", np.int64),
    ("velocity_offset_rad_s", np.float64), ("torque_offset_nm", np.float64),
    # cyclic and profile velocity
    ("previous_speed_rad_s", np.float64), ("target_speed_rad_s", np.float64),
    # cyclic and profile torque
    ("target_torque_nm", np.float64), ("torque_slope_nm_s", np.float64),
    ("torque_limit_nm", np.float64), ("torque_high_nm", np.float64), ("torque_low_nm", np.float64),
    # profiles and ramps
    ("profile_speed_rad_s", np.float64), ("profile_acceleration_rad_s2", np.float64),
    ("profile_deceleration_rad_s2", np.float64), ("stop_deceleration_rad_s2", np.float64),
    ("reference_rad", np.float64), ("reference_speed_rad_s", np.float64), ("stop_ticks", np.int64),
    ("stop_direction", np.float64), ("slowest_rad_s", np.float64),
    # limits
    ("low_counts", np.float64), ("high_counts", np.float64), ("max_speed_rad_s", np.float64),
    ("max_profile_speed_rad_s", np.float64),
    ("max_acceleration_rad_s2", np.float64), ("max_deceleration_rad_s2", np.float64),
    ("following_window_rad", np.float64), ("following_ticks", np.int64), ("following_count", np.int64),
    # windows: how far, for how many control periods, and for how many it has been so
    ("position_window_rad", np.float64), ("position_window_ticks", np.int64), ("position_window_count", np.int64),
    ("velocity_window_rad_s", np.float64), ("velocity_window_ticks", np.int64), ("velocity_window_count", np.int64),
    ("velocity_threshold_rad_s", np.float64), ("velocity_threshold_ticks", np.int64), ("velocity_threshold_count", np.int64),
    # cancellation of the transmission error: amplitudes N A_k at the motor, and how far it is faded in
    ("cancel_mode", np.int64), ("cancel_share", np.float64),
    ("cancel_a2_rad", np.float64), ("cancel_phi2_rad", np.float64),
    ("cancel_a4_rad", np.float64), ("cancel_phi4_rad", np.float64),
    ("cancel_inertia_kg_m2", np.float64), ("cancel_damping_nm_s_rad", np.float64),
    # switches, index pulse and probes: which there are, where they are active, and what has been seen of them
    ("input_mask", np.int64), ("forced_inputs", np.int64), ("edge_mask", np.int64),
    ("negative_switch_counts", np.float64), ("positive_switch_counts", np.float64),
    ("home_low_counts", np.float64), ("home_high_counts", np.float64), ("index_counts", np.float64),
    ("probe_1_low_counts", np.float64), ("probe_1_high_counts", np.float64),
    ("probe_2_low_counts", np.float64), ("probe_2_high_counts", np.float64),
    ("is_watching", np.int64), ("seen_counts", np.float64),
    ("inputs", np.int64), ("edges", np.int64), ("latch_counts", np.float64, (EDGES,)),
    # what comes out
    ("trip", np.int64), ("event", np.int64), ("wake", np.int64), ("stopped", np.int64),
    ("limited", np.int64), ("reached", np.int64), ("late_ticks", np.int64),
    ("demand_rad", np.float64), ("demand_speed_rad_s", np.float64), ("torque_demand_nm", np.float64),
    ("torque_nm", np.float64), ("following_error_rad", np.float64),
])  # fmt: skip
"""One row per axis. Positions are the encoder's own counts: homing and units act in front of it, never in here.

- `extrapolate_ticks`: for how many control periods a cyclic mode goes on with the last velocity when no set-point comes in time,
  before it trips with SET_POINT_LATE; 0 holds the last set-point for ever. Cyclic torque holds the last torque until it trips.
- `torque_high_nm`, `torque_low_nm`: the limits either way, low at or below 0; `torque_limit_nm` is the larger of both.
- `stop_deceleration_rad_s2`: infinite brakes with all the torque that the limits allow.
- `input_mask`: which inputs exist, 0 costs nothing; `forced_inputs`: which are held active whatever the position.
- `edge_mask`: which edges make an event; any edge of an input that is watched is latched. The owner clears `edges` and `event`.
- `event`: the bits of `edge_mask` that were seen; `wake`: whether the owner has a trip or an event to look at.
- `late_ticks`: control periods since the set-point that is missing was due.
"""
