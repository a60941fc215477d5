/* The equations of motion in the form that runs: axis.h with few sines, divisions and exponentials; rates.h runs it.
 *
 * Transmission error, cogging and gravity are developed around grid angles, see waves.h. Of an error of 60" 6e-18 rad are left
 * out: less than the last digit of theta_m/N, and 1e-10 of a count of a 20-bit encoder. Of a gravity moment of 52 N m 1e-12 N m
 * are; the last digit of an arm angle of 1 rad, times K_g, is 1e-11 N m. A control period seldom leaves its grid angles. Which
 * they are follows from the state alone, so that a run in many pieces gives the bits of a run in one.
 */
#pragma once

#include "axis.h"
#include "hil/control/waves.h"

/* Lines of the transmission error: orders 1, 2 and 4, others, and those of the joint. */
enum { ERROR_LINES = 3 + 2 * MORE_LINES };

/* Constants of an axis as rates needs them: reciprocals, products, and the harmonics by their parts. lanes.h has the first of them. */
struct constants {
    real per_ratio; /* 1/N */
    real per_motor_inertia;
    real motor_damping;
    real per_arm_inertia;
    real arm_damping;
    real gear_stiffness;
    real gear_damping;
    real coulomb_friction;
    real friction_rise; /* t_S - t_C */
    real per_stribeck_velocity;
    real gear_reaction;
    real wind_up_softness;
    real per_wind_up_torsion; /* 0 without one; that of the hysteresis alike */
    real hysteresis_torque;
    real per_hysteresis_torsion;
    real current_time_constant;
    integer lines; /* of the error */
    struct harmonic error[ERROR_LINES];
    struct harmonic gravity;
    integer cogging_lines;
    struct harmonic cogging[MORE_LINES];
};

/* Error and cogging around angles of the motor, gravity around one of the arm. */
struct grid_point {
    struct waves error;
    struct waves cogging;
    struct waves gravity;
};

/* theta_m, theta_l, w_m, w_l, z and t; or their rates. */
struct axis_state {
    real theta_m;
    real theta_l;
    real w_m;
    real w_l;
    real z;
    real tau;
};

/* What follows from the angles of an axis alone. */
struct pose {
    real theta_m;
    real theta_l;
    real steepness; /* dtheta_sync/dtheta_m */
    real spring;    /* the gear's torque without damping and hysteresis */
    real gravity;
    real cogging;
};

/* Constants of an axis, and a grid point at which nothing is developed yet. */
void find_constants(const struct plant *plant, struct constants *constants, struct grid_point *near);

/* Give an axis the transmission error of a plant. */
void take_error(const struct plant *plant, struct constants *constants, struct grid_point *near);
