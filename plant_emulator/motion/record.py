"""A drive's process data: what the object dictionary and the compiled control period say to each other, in SI and counts."""

import math
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.control.records import record_dtype
from hil.control.servo import LawRow
from plant_emulator.physics.axis import PlantRow, PlantStateRow
from plant_emulator.physics.changing import ChangeRow, PastRow

BRAKED, POSITION, TORQUE, PROFILE, STOPPING, VELOCITY, PROFILE_VELOCITY, PROFILE_TORQUE = range(8)
"""Modes of the power stage.

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
"""Indices into `latch_counts`; bit ``1 << index`` of `edges` and `edge_mask` belongs to the same edge."""

EDGES = 11

NO_SET_POINT = -(1 << 40)
"""`elapsed_periods` before the first set-point of a cyclic mode: nothing is late that was never begun."""

STOPPED_RAD_S = 0.5
"""Below this speed a ramp to rest counts as done (0.08 motor revolutions per second)."""

OVERSHOOT = 1.1
"""By how much the speed may exceed 6080h where the drive itself holds the demand to it: a speed loop overshoots and ripples."""


class MotionRow(Protocol):
    """The process data of one axis. Positions are the encoder's own counts: homing and units act in front of it, never in here.

    - `extrapolation_periods`: control periods for which a cyclic mode goes on with the last velocity when no set-point comes in
      time, before it trips with SET_POINT_LATE; 0 holds the last set-point for ever. Cyclic torque holds the last torque until it
      trips.
    - `torque_high_nm`, `torque_low_nm`: limits in both directions, low at or below 0; `torque_limit_nm` is the larger of both.
    - `stop_deceleration_rad_s2`: infinite brakes with all the torque that the limits allow.
    - `cancel_fraction`: the fraction to which the cancellation is faded in.
    - `input_mask`: which inputs exist, 0 costs nothing; `forced_inputs`: which are held active whatever the position.
    - `edge_mask`: which edges make an event; any edge of an input that is watched is latched. The owner clears `edges` and
      `event`.
    - `event`: the bits of `edge_mask` that were seen; `wake`: whether the owner has a trip or an event to look at.
    - `late_periods`: control periods since the set-point that is missing was due.
    """

    # -- parameters: the object dictionary writes them, the control period reads them

    counts_per_rad: float
    counts_per_rev: float
    # cyclic modes, in control periods
    periods_per_set_point: int
    extrapolation_periods: int
    # profiles and ramps
    profile_speed_rad_s: float
    profile_acceleration_rad_s2: float
    profile_deceleration_rad_s2: float
    torque_slope_nm_s: float
    # limits
    torque_limit_nm: float
    torque_high_nm: float
    torque_low_nm: float
    low_counts: float
    high_counts: float
    max_speed_rad_s: float
    max_profile_speed_rad_s: float
    max_acceleration_rad_s2: float
    max_deceleration_rad_s2: float
    following_window_rad: float
    following_periods: int
    # windows: how wide, and for how many control periods
    position_window_rad: float
    position_window_periods: int
    velocity_window_rad_s: float
    velocity_window_periods: int
    velocity_threshold_rad_s: float
    velocity_threshold_periods: int
    # cancellation of the transmission error: amplitudes N A_k at the motor
    cancel_mode: int
    cancel_a2_rad: float
    cancel_phi2_rad: float
    cancel_a4_rad: float
    cancel_phi4_rad: float
    cancel_inertia_kg_m2: float
    cancel_damping_nm_s_rad: float
    cancel_a1_rad: float
    cancel_phi1_rad: float
    # switches, index pulse and probes: which there are, and where they are active
    input_mask: int
    forced_inputs: int
    edge_mask: int
    negative_switch_counts: float
    positive_switch_counts: float
    home_low_counts: float
    home_high_counts: float
    index_counts: float
    probe_1_low_counts: float
    probe_1_high_counts: float
    probe_2_low_counts: float
    probe_2_high_counts: float

    # -- set-points: the modes of operation write them, the control period reads them

    mode: int
    # cyclic modes: the last two set-points; the control period counts the time since the last one in `elapsed_periods`
    previous_counts: float
    target_counts: float
    previous_speed_rad_s: float
    target_speed_rad_s: float
    target_torque_nm: float
    velocity_offset_rad_s: float
    torque_offset_nm: float
    stop_deceleration_rad_s2: float

    # -- state: what the control period remembers

    elapsed_periods: int
    reference_rad: float
    reference_speed_rad_s: float
    stop_periods: int
    stop_direction: float
    slowest_rad_s: float
    following_count: int
    position_window_count: int
    velocity_window_count: int
    velocity_threshold_count: int
    cancel_fraction: float
    is_watching: int
    seen_counts: float

    # -- outputs: the object dictionary and the state machine read them

    inputs: int
    edges: int
    latch_counts: Annotated[NDArray[np.float64], (EDGES,)]
    trip: int
    event: int
    wake: int
    stopped: int
    limited: int
    reached: int
    late_periods: int
    demand_rad: float
    demand_speed_rad_s: float
    torque_demand_nm: float
    torque_nm: float
    following_error_rad: float


class AxisRow(Protocol):
    """All of one axis: the mechanics, the process data of its drive, the law that the drive runs, and how its gear changes."""

    plant: PlantRow
    plant_state: PlantStateRow
    motion: MotionRow
    law: LawRow
    change: ChangeRow
    past: PastRow


MOTION = record_dtype(MotionRow)
AXIS = record_dtype(AxisRow)

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
