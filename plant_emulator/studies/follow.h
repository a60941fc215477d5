/* A whole run of cyclic set-points in one call, for studies of hundreds of runs. */
#ifndef PLANT_FOLLOW_H
#define PLANT_FOLLOW_H

#include "plant_emulator/motion/period.h"

/* Columns of a trace. */
enum { TRACE_COUNTS, TRACE_ARM_ANGLE, TRACE_ARM_SPEED, TRACE_ARM_ACCELERATION, TRACE_TORQUE, TRACE_COLUMNS };

/* All SYNC periods of a run: state at each SYNC, its set-point, and the control periods up to the next.
 *
 * The same as a set-point and advance in turn, to the bit, while no limit is set. set_points holds samples rows of count set-points
 * in counts; noise the encoder's noise in rad instead of its own, samples * periods numbers for each axis; trace becomes samples
 * rows of TRACE_COLUMNS numbers for each axis. */
void follow(
    integer periods, real period_s, integer substeps, struct axis *axes, integer count, integer samples,
    const real *set_points, const real *noise, real *trace);

#endif
