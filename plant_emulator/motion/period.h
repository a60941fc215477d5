/* The control period of all axes of a robot: set-points, servo law, limits and plant. */
#pragma once

#include "plant_emulator/physics/flexible.h"
#include "plant_emulator/physics/integration.h"
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
 * prepared has one for each axis. trace, where it is not null, becomes theta_l, w_l and w_l' of each axis after every period;
 * periods rows of 3 count. */
void advance(
    integer periods, real period_s, integer substeps, struct axis *axes, struct prepared *prepared, integer count, real *trace);

/* An axis on its way through some control periods. */
struct advancing {
    struct axis *axis;
    struct prepared *prepared;
    real *trace;    /* its row in the first of them, or null; see advance */
    integer stride; /* numbers from there to the next period's */
};

/* Most axes that may go in lock-step. */
enum { MOST_IN_STEP = 4 };

/* Advance up to MOST_IN_STEP axes in lock-step; 0 where the processor has no vectors for it, or there is a single axis. */
int advance_in_lock_step(integer periods, real period_s, integer substeps, const struct advancing *axes, int count);

/* The row that alone moves the tip: its brake alone is open, or it is the only one. -1 where several do, or none. */
integer single_row(const struct tip *tip, const struct axis *axes, integer count);

/* Acceleration of the tip at this instant, where no links couple the axes. */
void tip_now(const struct tip *tip, const struct axis *axes, integer count, real *acceleration);

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

/* All axes of a robot, the tip that they move, and the sensor that feels it. */
struct mechanics {
    struct axis *axes;
    struct prepared *prepared; /* of each axis; where links couple them, unused */
    integer count;
    real period_s;     /* control period */
    integer substeps;  /* Runge-Kutta steps of the plant in it */
    const struct tip *tip;
    const struct arm *arm;     /* null: no links couple the axes */
    struct sections *sections; /* null: the sensor shows the acceleration of the instant */
    real *ring;                /* of size rows, for sense */
    integer size;
    real *sensed; /* what the sensor shows where it filters, or links couple the axes; else null */
    real *trace;  /* where it filters: room for the arms after each control period, and for the tip; else null */
    real *tips;
};

/* Let some control periods pass for some robots of the same periods, for which trace and tips have room. */
void advance_all(const struct mechanics *const *robots, integer number, integer periods);

/* What the sensor shows now of the tip's acceleration, before its noise. */
void sense_now(const struct mechanics *m, real *acceleration);

/* What follow shows of each axis at a SYNC. */
enum { TRACE_COUNTS, TRACE_ARM_ANGLE, TRACE_TORQUE, TRACE_COLUMNS };

/* A whole run of cyclic set-points, of some robots alike: at each of samples SYNCs what is there is shown, then the set-points, one
 * for each of moving rows, take effect, and some control periods pass.
 *
 * trace becomes, for each robot, samples rows of moving rows of TRACE_COLUMNS; tips and sensed become samples rows of CHANNELS, the
 * true acceleration of the tip and what the sensor shows of it. */
void follow(
    const struct mechanics *const *robots, integer number, integer periods, integer samples, const integer *rows, integer moving, const real *set_points,
    real *trace, real *tips, real *sensed);
