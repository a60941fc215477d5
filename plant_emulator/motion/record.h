/* A drive's process data: what the object dictionary and the control period say to each other, in SI and counts. */
#pragma once

#include "hil/control/servo.h"
#include "plant_emulator/physics/axis.h"
#include "plant_emulator/physics/changing.h"
#include "plant_emulator/physics/encoder.h"

/* Modes of the power stage: brake closed and no torque; cyclic position (CSP, IP); cyclic torque (CST); profile position (PP);
 * ramp to rest; cyclic velocity (CSV); profile velocity (PV, and the search moves of homing); profile torque (TQ). */
enum { BRAKED, POSITION, TORQUE, PROFILE, STOPPING, VELOCITY, PROFILE_VELOCITY, PROFILE_TORQUE };

/* Bits of trip: which limit has been broken since the trip was last cleared. */
enum {
    FOLLOWING = 1,
    OVERSPEED = 2,
    OUT_OF_RANGE = 4,
    SET_POINT_RANGE = 8,
    SET_POINT_STEP = 16,
    SET_POINT_LATE = 32
};

/* Bits of limited: the torque is at its limit; the speed that is asked for is above the greatest that is allowed. */
enum { LIMITED_TORQUE = 1, LIMITED_SPEED = 2 };

/* Bits of reached: within 6067h for 6068h; within 606Dh for 606Eh; above 606Fh for 6070h. */
enum { IN_POSITION = 1, IN_SPEED = 2, MOVING = 4 };

/* Bits of inputs, input_mask and forced_inputs. */
enum { NEGATIVE_SWITCH = 1, POSITIVE_SWITCH = 2, HOME_SWITCH = 4, PROBE_1 = 8, PROBE_2 = 16 };

/* Indices into latch_counts; bit 1 << index of edges and edge_mask belongs to the same edge. */
enum {
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
    EDGES
};

/* elapsed_periods before the first set-point of a cyclic mode, -2^40: nothing is late that was never begun. */
#define NO_SET_POINT -1099511627776

/* Below this speed a ramp to rest counts as done (0.08 motor revolutions per second). */
#define STOPPED_RAD_S 0.5

/* By how much the speed may exceed 6080h where the drive itself holds the demand to it: a speed loop overshoots and ripples. */
#define OVERSHOOT 1.1

/* Process data of one axis. Positions are the encoder's own counts: homing and units act in front of it, never in here.
 *
 * extrapolation_periods: control periods for which a cyclic mode goes on with the last velocity when no set-point comes in time,
 * before it trips with SET_POINT_LATE; 0 holds the last set-point for ever. Cyclic torque holds the last torque until it trips.
 * torque_high_nm, torque_low_nm: limits in both directions, low at or below 0; torque_limit_nm is the larger of both.
 * stop_deceleration_rad_s2: infinite brakes with all the torque that the limits allow.
 * cancel_fraction: the fraction to which the cancellation is faded in.
 * input_mask: which inputs exist, 0 costs nothing; forced_inputs: which are held active whatever the position.
 * edge_mask: which edges make an event; any edge of an input that is watched is latched. The owner clears edges and event.
 * event: the bits of edge_mask that were seen; wake: 1 if the owner has a trip or an event to look at.
 * late_periods: control periods since the set-point that is missing was due. */
struct motion {
    /* parameters: the object dictionary writes them, the control period reads them */

    real counts_per_rad;
    real counts_per_rev;
    /* cyclic modes, in control periods */
    integer periods_per_set_point;
    integer extrapolation_periods;
    /* profiles and ramps */
    real profile_speed_rad_s;
    real profile_acceleration_rad_s2;
    real profile_deceleration_rad_s2;
    real torque_slope_nm_s;
    /* limits */
    real torque_limit_nm;
    real torque_high_nm;
    real torque_low_nm;
    real low_counts;
    real high_counts;
    real max_speed_rad_s;
    real max_profile_speed_rad_s;
    real max_acceleration_rad_s2;
    real max_deceleration_rad_s2;
    real following_window_rad;
    integer following_periods;
    /* windows: how wide, and for how many control periods */
    real position_window_rad;
    integer position_window_periods;
    real velocity_window_rad_s;
    integer velocity_window_periods;
    real velocity_threshold_rad_s;
    integer velocity_threshold_periods;
    /* cancellation of the transmission error: amplitudes N A_k at the motor */
    integer cancel_mode;
    real cancel_a2_rad;
    real cancel_phi2_rad;
    real cancel_a4_rad;
    real cancel_phi4_rad;
    real cancel_inertia_kg_m2;
    real cancel_damping_nm_s_rad;
    real cancel_a1_rad;
    real cancel_phi1_rad;
    /* switches, index pulse and probes: which there are, and where they are active */
    integer input_mask;
    integer forced_inputs;
    integer edge_mask;
    real negative_switch_counts;
    real positive_switch_counts;
    real home_low_counts;
    real home_high_counts;
    real index_counts;
    real probe_1_low_counts;
    real probe_1_high_counts;
    real probe_2_low_counts;
    real probe_2_high_counts;

    /* set-points: the modes of operation write them, the control period reads them */

    integer mode;
    /* cyclic modes: the last two set-points; the control period counts the time since the last one in elapsed_periods */
    real previous_counts;
    real target_counts;
    real previous_speed_rad_s;
    real target_speed_rad_s;
    real target_torque_nm;
    real velocity_offset_rad_s;
    real torque_offset_nm;
    real stop_deceleration_rad_s2;

    /* state: what the control period remembers */

    integer elapsed_periods;
    real reference_rad;
    real reference_speed_rad_s;
    integer stop_periods;
    real stop_direction;
    real slowest_rad_s;
    integer following_count;
    integer position_window_count;
    integer velocity_window_count;
    integer velocity_threshold_count;
    real cancel_fraction;
    integer is_watching;
    real seen_counts;

    /* outputs: the object dictionary and the state machine read them */

    integer inputs;
    integer edges;
    real latch_counts[EDGES];
    integer trip;
    integer event;
    integer wake;
    integer stopped;
    integer limited;
    integer reached;
    integer late_periods;
    real demand_rad;
    real demand_speed_rad_s;
    real torque_demand_nm;
    real torque_nm;
    real following_error_rad;
};

/* All of one axis: the mechanics, the process data of its drive, the law that the drive runs, how its gear changes, and the encoder
 * on its motor. */
struct axis {
    struct plant plant;
    struct plant_state plant_state;
    struct motion motion;
    struct law law;
    struct change change;
    struct past past;
    struct encoder encoder;
};
