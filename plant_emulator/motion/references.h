/* Demands of a control period: interpolated set-points, profiles and ramps. */
#pragma once

#include "record.h"

/* The fraction of the distance between the last two set-points that is gone at the end of this period.
 *
 * 1 is reached with the last period of the interval. Beyond it the newest set-point is held. With extrapolation_periods the
 * motion instead goes on at the same speed for so many periods, and then trips: the next set-point is late. */
real set_point_fraction(struct motion *motion);

/* The cyclic position set-point in this period, in counts: straight from the last to the newest. */
real interpolated_counts(struct motion *motion);

/* The cyclic velocity set-point in this period; beyond the interval the newest is held, which is the last velocity. */
real interpolated_speed(struct motion *motion);

/* One period of the trapezoidal profile towards a target: never faster than it can still brake from.
 *
 * In whole periods T a stop from v takes v^2/2a + v T/2: solved for v, so that the last step ends on the target. Where a new
 * target lies closer than that, the reference passes it and comes back. */
void profile_position(struct motion *motion, real target_rad, real period_s);

/* One period of the ramp towards the target velocity; returns the speed. */
real profile_velocity(struct motion *motion, real period_s);

/* One period of the slope towards the target torque; 60B2h is for cyclic modes and has no part in it. */
real profile_torque(const struct motion *motion, real period_s);

/* One period of the ramp to rest. */
void ramp_down(struct motion *motion, real period_s);
