/* The equations of motion in the form that runs: axis.h with few sines, divisions and exponentials.
 *
 * Transmission error, cogging and gravity are developed around grid angles, see waves.h. Of an error of 60" 6e-18 rad are left
 * out: less than the last digit of theta_m/N, and 1e-10 of a count of a 20-bit encoder. Of a gravity moment of 52 N m 1e-12 N m
 * are; the last digit of an arm angle of 1 rad, times K_g, is 1e-11 N m. A control period seldom leaves its grid angles. Which
 * they are follows from the state alone, so that a run in many pieces gives the bits of a run in one.
 */
#ifndef PLANT_ANGLE_GRID_H
#define PLANT_ANGLE_GRID_H

#include "axis.h"
#include "hil/control/waves.h"

/* Lines of the transmission error: orders 1, 2 and 4, others, and those of the joint. */
enum { ERROR_LINES = 3 + 2 * MORE_LINES };

/* Constants of an axis as rates needs them: reciprocals, products, and the harmonics by their parts. */
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
    real per_wind_up_torsion; /* infinite and unused without one; that of the hysteresis alike */
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

/* The pose at an angle of the motor and one of the arm. part, see sum_waves, is 1/2 for a state and 1 for a stage after it. */
INLINED void find_pose(
    const struct constants *k, real theta_m, real theta_l, real part, struct grid_point *near, struct pose *pose)
{
    const pair error = sum_waves(k->error, k->lines, theta_m, part, &near->error);
    const real torsion = theta_m * k->per_ratio + error[0] - theta_l;
    pose->theta_m = theta_m;
    pose->theta_l = theta_l;
    pose->steepness = error[1];
    pose->gravity = sum_waves(&k->gravity, 1, theta_l, part, &near->gravity)[0];
    pose->cogging = k->cogging_lines > 0 ? sum_waves(k->cogging, k->cogging_lines, theta_m, part, &near->cogging)[0] : 0.0;
    pose->spring = k->gear_stiffness * torsion;
    if (k->wind_up_softness > 0.0) {
        const real ratio = torsion * k->per_wind_up_torsion;
        pose->spring -= k->wind_up_softness * pose->spring * EXP(-ratio * ratio);
    }
}

/* w_m' and w_l', z' and t' of an axis in a pose; speeds are w_m and w_l, lags z and t.
 *
 * command is the torque command in N m; braked: the brake holds the motor. */
INLINED void rates(
    const struct constants *k, const struct pose *pose, real command, int braked, pair speeds, pair lags, pair *speed_rates,
    pair *lag_rates)
{
    const real torsion_rate = speeds[0] * (k->per_ratio + pose->steepness) - speeds[1];
    const real gear = (k->gear_damping * torsion_rate + lags[0]) + pose->spring;
    *lag_rates = (pair){0.0, 0.0};
    if (k->hysteresis_torque > 0.0) {
        const real pulled = torsion_rate * k->hysteresis_torque - FABS(torsion_rate) * lags[0];
        *lag_rates = (pair){pulled * k->per_hysteresis_torsion, 0.0};
    }
    if (braked) {
        *speed_rates = (pair){0.0, (gear - k->arm_damping * speeds[1] - pose->gravity) * k->per_arm_inertia};
        return;
    }
    real torque = command;
    if (k->current_time_constant > 0.0) {
        torque = lags[1];
        *lag_rates = (pair){(*lag_rates)[0], (command - lags[1]) / k->current_time_constant};
    }
    const real load = gear * (k->per_ratio + k->gear_reaction * pose->steepness);
    const real lost = friction(k->coulomb_friction, k->friction_rise, k->per_stribeck_velocity, speeds[0]);
    *speed_rates = (pair){
        (torque + pose->cogging - k->motor_damping * speeds[0] - lost - load) * k->per_motor_inertia,
        (gear - k->arm_damping * speeds[1] - pose->gravity) * k->per_arm_inertia,
    };
}

#endif
