/* Motion of an arm's tip, and what an accelerometer feels that is fixed to a link of the arm. */
#pragma once

#include "articulated.h"

/* Rows of three that tool_motion writes: position, velocity and acceleration in the frame of the base, and the specific force
 * a - g along the axes of the tool. */
enum { TOOL_POSITION, TOOL_VELOCITY, TOOL_ACCELERATION, TOOL_SPECIFIC_FORCE, TOOL_ROWS };

/* Rows of three of a sensor: its origin, three of its frame, and what it is: number of its link (0: none, an ideal sensor at the
 * tip), 1 where it feels its weight. */
enum { SENSOR_ROWS = 5 };

/* Motion of a tool whose place and frame in the frame of link number are the first four rows of tool. */
void tool_motion(const struct link *links, integer number, const real *tool, real *moved);

/* What a sensor feels along its own axes: R_s^T (a - g), without g where it does not feel its weight.
 *
 * tip is the acceleration of the tip in the frame of the base, which an ideal sensor shows; room holds TOOL_ROWS rows; count
 * links follow the base. */
void feel(const struct link *links, integer count, const real *sensor, const real *tip, real *room, real *felt);
