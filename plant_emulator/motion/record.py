"""A drive's process data between object dictionary and control period; see `record.h`."""

import math

from plant_emulator.core import CORE

BRAKED: int = CORE.call.BRAKED
POSITION: int = CORE.call.POSITION
TORQUE: int = CORE.call.TORQUE
PROFILE: int = CORE.call.PROFILE
STOPPING: int = CORE.call.STOPPING
VELOCITY: int = CORE.call.VELOCITY
PROFILE_VELOCITY: int = CORE.call.PROFILE_VELOCITY
PROFILE_TORQUE: int = CORE.call.PROFILE_TORQUE
"""Modes of the power stage.

Brake closed and no torque; cyclic position (CSP, IP); cyclic torque (CST); profile position (PP); ramp to rest; cyclic velocity
(CSV); profile velocity (PV, and the search moves of homing); profile torque (TQ).
"""

FOLLOWING: int = CORE.call.FOLLOWING
OVERSPEED: int = CORE.call.OVERSPEED
OUT_OF_RANGE: int = CORE.call.OUT_OF_RANGE
SET_POINT_RANGE: int = CORE.call.SET_POINT_RANGE
SET_POINT_STEP: int = CORE.call.SET_POINT_STEP
SET_POINT_LATE: int = CORE.call.SET_POINT_LATE
"""Bits of `trip`: which limit has been broken since the trip was last cleared."""

LIMITED_TORQUE: int = CORE.call.LIMITED_TORQUE
LIMITED_SPEED: int = CORE.call.LIMITED_SPEED
"""Bits of `limited`: the torque is at its limit; the speed that is asked for is above the greatest that is allowed."""

IN_POSITION: int = CORE.call.IN_POSITION
IN_SPEED: int = CORE.call.IN_SPEED
MOVING: int = CORE.call.MOVING
"""Bits of `reached`: within 6067h for 6068h; within 606Dh for 606Eh; above 606Fh for 6070h."""

NEGATIVE_SWITCH: int = CORE.call.NEGATIVE_SWITCH
POSITIVE_SWITCH: int = CORE.call.POSITIVE_SWITCH
HOME_SWITCH: int = CORE.call.HOME_SWITCH
PROBE_1: int = CORE.call.PROBE_1
PROBE_2: int = CORE.call.PROBE_2
"""Bits of `inputs`, `input_mask` and `forced_inputs`."""

HOME_RISING: int = CORE.call.HOME_RISING
HOME_FALLING: int = CORE.call.HOME_FALLING
INDEX: int = CORE.call.INDEX
NEGATIVE_RISING: int = CORE.call.NEGATIVE_RISING
NEGATIVE_FALLING: int = CORE.call.NEGATIVE_FALLING
POSITIVE_RISING: int = CORE.call.POSITIVE_RISING
POSITIVE_FALLING: int = CORE.call.POSITIVE_FALLING
PROBE_1_RISING: int = CORE.call.PROBE_1_RISING
PROBE_1_FALLING: int = CORE.call.PROBE_1_FALLING
PROBE_2_RISING: int = CORE.call.PROBE_2_RISING
PROBE_2_FALLING: int = CORE.call.PROBE_2_FALLING
"""Indices into `latch_counts`; bit ``1 << index`` of `edges` and `edge_mask` belongs to the same edge."""

EDGES: int = CORE.call.EDGES

NO_SET_POINT = int(CORE.constants["NO_SET_POINT"])
"""`elapsed_periods` before the first set-point of a cyclic mode: nothing is late that was never begun."""

STOPPED_RAD_S = CORE.constants["STOPPED_RAD_S"]
"""Below this speed a ramp to rest counts as done (0.08 motor revolutions per second)."""

OVERSHOOT = CORE.constants["OVERSHOOT"]
"""By how much the speed may exceed 6080h where the drive itself holds the demand to it: a speed loop overshoots and ripples."""

MOTION, AXIS = CORE.dtype("motion"), CORE.dtype("axis")

NEVER = 1 << 60
"""A number of control periods that no run reaches."""

UNTIL_WRITTEN: dict[str, float] = {
    "low_counts": -math.inf, "high_counts": math.inf,
    "max_speed_rad_s": math.inf, "max_profile_speed_rad_s": math.inf,
    "max_acceleration_rad_s2": math.inf, "max_deceleration_rad_s2": math.inf,
    "torque_slope_nm_s": math.inf,
    "profile_acceleration_rad_s2": 0.0, "profile_deceleration_rad_s2": 0.0,
    "following_window_rad": math.inf, "following_periods": NEVER,
    "position_window_rad": math.inf, "position_window_periods": 0,
    "velocity_window_rad_s": math.inf, "velocity_window_periods": 0,
    "velocity_threshold_rad_s": math.inf, "velocity_threshold_periods": 0,
    "negative_switch_counts": -math.inf, "positive_switch_counts": math.inf,
}  # fmt: skip
"""Value of each limit, ramp and window of `MOTION` in an axis whose drive has written none: as a rule, no limit.

The drive's table of limits takes no field that is not here (`plant_emulator.drive.dictionary.limit_table`): a limit of 0 would
stop the motion where no drive writes it.
"""
