/* An arm on elastic joints over time: motors, gears and transmission errors of angle_grid, links of articulated.
 *
 * Gears couple both: the torque of a gear turns its link, and acts back on its motor. A motor's spin counts about its own axis
 * only, and its mass belongs to the link that carries it.
 *
 * Source: M. W. Spong, Modeling and Control of Elastic Joint Robots, ASME Journal of Dynamic Systems, Measurement, and Control
 * 109, 1987.
 */
#pragma once

#include "angle_grid.h"
#include "articulated.h"

/* Planes of the states on which the integration works: state, state of a stage, its rates, and their weighted sum. */
enum { STATE, STAGE, SLOPE, SUM, PLANES };

/* Arrays of an arm of count joints, from the base on; joint_constants makes the constants. */
struct flexible {
    integer count;
    struct constants *joints;  /* count */
    struct link *links;        /* count + 1; what belongs to one evaluation is written */
    struct grid_point *near;   /* count; grid points near to the state */
    real *commands;            /* count; torque commands in N m */
    real *brakes;              /* count; 1 where the brake holds the motor */
    real *turning;             /* JOINT_ROWS, count; joints of the links */
    struct axis_state *stages; /* PLANES, count */
};

/* Constants of a joint, from an axis whose own inertia and gravity give way to those of the links.
 *
 * An arm of 1 kg m^2 without gravity makes of rates the torque on the link. */
void joint_constants(const struct plant *plant, struct constants *joint, struct grid_point *near);

/* One control period of an arm under constant torque commands: classical Runge-Kutta, fixed sub-steps. */
void flexible_period(const struct flexible *arm, real period_s, integer substeps);

/* Everything that follows from the plane STATE: its rates in SLOPE, and the links as they move. */
void flexible_rest(const struct flexible *arm);
