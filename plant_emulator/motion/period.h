/* The control period of all axes of a robot: set-points, servo law, limits and plant. */
#ifndef PLANT_PERIOD_H
#define PLANT_PERIOD_H

#include "plant_emulator/physics/flexible.h"
#include "plant_emulator/physics/sensing.h"
#include "plant_emulator/physics/tip.h"
#include "record.h"

/* An angle in whole counts, as an encoder gives it. */
INLINED real measured_counts(real motor_angle, real counts_per_rad)
{
    return round_down(motor_angle * counts_per_rad + 0.5);
}

/* The position of the motor that the drive has measured, in counts. */
INLINED real axis_counts(const struct axis *axis)
{
    return measured_counts(shown_angle(&axis->encoder, axis->plant_state.motor_angle_rad), axis->motion.counts_per_rad);
}

/* axis_counts, to be called. */
real read_counts(const struct axis *axis);

/* One control period of a drive: measure, set-point, law, limits. Returns the torque in N m, 0 behind a closed brake. */
real command(struct axis *axis, real period_s);

/* Give the gear of an axis the error that it has after this control period; only for one that changes. */
void age(struct axis *axis, real period_s);

/* Advance all axes by some control periods of period_s, with substeps Runge-Kutta steps of the plant each.
 *
 * A broken limit turns the axis to its stop ramp in the very period in which it is seen; the drive's state machine follows.
 * trace, where it is not null, becomes theta_l, w_l and w_l' of each axis after every period; periods rows of 3 count. */
void advance(integer periods, real period_s, integer substeps, struct axis *axes, integer count, real *trace);

/* The row that alone moves the tip: its brake alone is open, or it is the only one. -1 where several do, or none. */
integer single_row(const struct tip *tip, const struct axis *axes, integer count);

/* Acceleration of the tip at this instant, where no links couple the axes. */
void tip_now(const struct tip *tip, const struct axis *axes, integer count, real *acceleration);

/* advance, the tip that the axes move, and the sensor that feels it.
 *
 * tips becomes the tip's acceleration after each period; sections, ring, size and sensed are those of sense. */
void advance_sensed(
    integer periods, real period_s, integer substeps, struct axis *axes, integer count, real *trace, const struct tip *tip,
    real *tips, struct sections *sections, real *ring, integer size, real *sensed);

/* The next set-point of an axis in cyclic position mode, in counts of its encoder.
 *
 * The axis goes there from its present demand in one interpolation period. A set-point outside the position limits, or faster than
 * the motor may turn, trips the axis and is not followed. A SYNC that falls a control period early, as those of a busy bus do,
 * finds the axis that much behind its last set-point: what counts is the step from that. */
void set_point(struct axis *axis, real target_counts, real period_s);

/* Arrays of an arm whose links couple its axes, beside those of the joints. */
struct arm {
    struct flexible joints;
    const real *tool;   /* place and frame of the tool in the last link */
    real *moved;        /* tool_motion after the last period, written */
    const real *sensor; /* SENSOR_ROWS rows of its accelerometer */
    real *room;         /* TOOL_ROWS rows */
};

/* Advance all axes of an arm: they go through each period together, since the links couple them.
 *
 * tips becomes what the sensor feels after each of the last rows periods. */
void advance_arm(
    integer periods, real period_s, integer substeps, struct axis *axes, const struct arm *arm, real *tips, integer rows);

#endif
