/* One axis over time: classical Runge-Kutta with fixed sub-steps, one control period after the other. */
#ifndef PLANT_INTEGRATION_H
#define PLANT_INTEGRATION_H

#include "angle_grid.h"

/* Make near the grid point nearest to a state, from which plant_period begins. */
void find_nearest(const struct constants *k, const struct plant_state *state, struct grid_point *near);

/* One control period under a constant torque command in N m; the arm's acceleration is left as it was.
 *
 * near is the grid point nearest to a state of a short while ago, and becomes that for the next period. braked: the brake holds
 * the motor. */
void plant_period(
    const struct constants *k, struct grid_point *near, struct plant_state *state, real command, int braked, real period_s,
    integer substeps);

/* Acceleration of the arm in a state; it does not depend on the torque command, which the motor feels first. near becomes the
 * grid point nearest to the state. */
real arm_acceleration(const struct constants *k, const struct plant_state *state, struct grid_point *near);

/* plant_period of one axis by itself, and the arm's acceleration after it: where tests compare the plant with other solvers. */
void plant_step(
    const struct plant *plant, struct plant_state *state, real command, int braked, real period_s, integer substeps);

#endif
