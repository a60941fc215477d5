/* One axis over time: classical Runge-Kutta with fixed sub-steps, one control period after the other. */
#pragma once

#include "angle_grid.h"

/* What the motion of an axis needs, worked out: constants, the grid point nearest to a state, and the pose in it.
 *
 * Zeros at first; prepare works out what has changed since. */
struct prepared {
    struct plant plant; /* from which the constants are */
    struct constants constants;
    struct grid_point near;
    struct pose pose;
};

/* Make prepared that of a plant in a state. */
void prepare(const struct plant *plant, const struct plant_state *state, struct prepared *prepared);

/* The state of an axis as rates has it, and back. */
struct axis_state state_of(const struct plant_state *state);
void put_back(struct plant_state *state, const struct axis_state *x);

/* One control period under a constant torque command in N m; the arm's acceleration is left as it was.
 *
 * prepared is that of the state, and becomes that of the new one. braked: the brake holds the motor. */
void plant_period(
    struct prepared *prepared, struct plant_state *state, real command, int braked, real period_s, integer substeps);

/* Acceleration of the arm in a state; it does not depend on the torque command, which the motor feels first. */
real arm_acceleration(const struct prepared *prepared, const struct plant_state *state);

/* plant_period of one axis by itself, and the arm's acceleration after it: where tests compare the plant with other solvers. */
void plant_step(
    const struct plant *plant, struct plant_state *state, real command, int braked, real period_s, integer substeps);
