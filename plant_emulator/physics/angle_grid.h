/* The equations of motion in the form that runs: polynomials around grid angles instead of a sine and cosine for every rate.
 *
 * rates gives what axis.h states, twice as fast. Sine and cosine are worked out at angles that lie evenly apart, the grid; angle
 * sums and short polynomials lead from there to the angle itself, and angle doubling to the 2nd and 4th order. A control period
 * seldom leaves its grid angles. Which grid angle is used follows from the state alone, so that a run in many pieces gives the
 * bits of a run in one.
 */
#ifndef PLANT_ANGLE_GRID_H
#define PLANT_ANGLE_GRID_H

#include "axis.h"

/* Distance between grid angles, and the reach of the polynomials around each. */
#define MOTOR_GRID_RAD (1.0 / 16.0)
#define ARM_GRID_RAD (1.0 / 64.0)

/* Orders 1, 2 and 4. */
enum { ATE_ORDERS = 3 };

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
    real gravity_moment;
    real home_angle;
    real gear_reaction;
    real wind_up_softness;
    real wind_up_torsion;
    real hysteresis_torque;
    real hysteresis_torsion;
    real current_time_constant;
    real a1_cos; /* A_1 cos phi_1; the others alike */
    real a1_sin;
    real a2_cos;
    real a2_sin;
    real a4_cos;
    real a4_sin;
    real has_more_orders;
    real more_orders[MORE_LINES];
    real more_rad[MORE_LINES];
    real more_phi[MORE_LINES];
    real is_eccentric;
    real joint_orders[MORE_LINES];
    real joint_rad[MORE_LINES];
    real joint_phi[MORE_LINES];
    real is_cogging;
    real cogging_orders[MORE_LINES];
    real cogging_nm[MORE_LINES];
    real cogging_phi[MORE_LINES];
};

/* Sine and cosine at one grid angle of the motor and one of the arm, scaled: angle sums give the values around them.
 *
 * With x_k = A_k cos(k t0 + phi_k) and y_k = A_k sin(k t0 + phi_k):  A_k cos(k (t0 + d) + phi_k) = x_k cos kd - y_k sin kd,
 * where cos 2d = 1 - 2 sin^2 d and sin 2d = 2 sin d cos d, once more for 4d. Its slope is -k (y_k cos kd + x_k sin kd).
 * Gravity alike, with m g l and theta_l + q_0. */
struct grid_point {
    real motor;                    /* t0 of the motor */
    real of_cosine[ATE_ORDERS][2]; /* x_k, -k y_k: what cos kd counts in the error and in its slope */
    real of_sine[ATE_ORDERS][2];   /* -y_k, -k x_k */
    real arm;                      /* t0 of the arm's inclination theta_l + q_0 */
    real gravity_cos;
    real gravity_sin;
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
};

/* Constants of an axis. */
void find_constants(const struct plant *plant, struct constants *constants);

/* The grid point at these grid angles. */
void find_grid_point(const struct constants *k, real motor, real arm, struct grid_point *near);

/* The grid angles nearest to an angle of the motor and one of the arm. */
INLINED void grid_angles(const struct constants *k, real motor_angle, real arm_angle, real *motor, real *arm)
{
    *motor = nearest_whole(motor_angle * (1.0 / MOTOR_GRID_RAD)) * MOTOR_GRID_RAD;
    *arm = nearest_whole((arm_angle + k->home_angle) * (1.0 / ARM_GRID_RAD)) * ARM_GRID_RAD;
}

/* Make near the grid point nearest to these angles, if it is not. */
INLINED void move_near(const struct constants *k, real motor_angle, real arm_angle, struct grid_point *near)
{
    real motor, arm;
    grid_angles(k, motor_angle, arm_angle, &motor, &arm);
    if (motor != near->motor || arm != near->arm) {
        find_grid_point(k, motor, arm, near);
    }
}

/* Two numbers with which a processor calculates at once; each rounds as it would alone. */
#ifdef __GNUC__
typedef real pair __attribute__((vector_size(2 * sizeof(real))));
#endif

INLINED pair pair_at(const real *numbers)
{
    return (pair){numbers[0], numbers[1]};
}

/* Cosines and sines of the distances from the grid angles, of the motor and of the arm.
 *
 * The motor has Taylor's polynomials to d^6 and d^7, which leave less than d^8/8! and d^9/9!: 5.8e-15 at |d| = 1/16. On an
 * amplitude of A_k = 60" that is 2e-18 rad, below the last digit of theta_m/N. The arm has those to d^4 and d^5, which leave less
 * than d^6/6! and d^7/7!: 2.0e-14 at |d| = 1/64. On a gravity moment of 52 N m that is 1e-12 N m; the last digit of an arm angle
 * of 1 rad, times K_g, is 1e-11 N m. Further away the library's functions take over. */
INLINED void turn(pair d, pair *cosine, pair *sine)
{
    const pair q = -d * d, last_cosine = {1.0 / 720.0, 0.0}, last_sine = {1.0 / 5040.0, 0.0};
    *cosine = 1.0 + q * (1.0 / 2.0 + q * (1.0 / 24.0 + q * last_cosine));
    *sine = d * (1.0 + q * (1.0 / 6.0 + q * (1.0 / 120.0 + q * last_sine)));
    const int is_far_motor = FABS(d[0]) > MOTOR_GRID_RAD, is_far_arm = FABS(d[1]) > ARM_GRID_RAD;
    if (is_far_motor || is_far_arm) {
        *cosine = (pair){is_far_motor ? COS(d[0]) : (*cosine)[0], is_far_arm ? COS(d[1]) : (*cosine)[1]};
        *sine = (pair){is_far_motor ? SIN(d[0]) : (*sine)[0], is_far_arm ? SIN(d[1]) : (*sine)[1]};
    }
}

/* The pose at an angle of the motor and one of the arm; near is a grid point: the nearer, the smaller the error. */
INLINED void find_pose(
    const struct constants *k, const struct grid_point *near, real theta_m, real theta_l, struct pose *pose)
{
    pair cosines, sines;
    turn((pair){theta_m, theta_l + k->home_angle} - (pair){near->motor, near->arm}, &cosines, &sines);
    const real cosine = cosines[0], sine = sines[0];
    const real cosine2 = 1.0 - 2.0 * sine * sine, sine2 = 2.0 * sine * cosine;
    const real cosine4 = 1.0 - 2.0 * sine2 * sine2, sine4 = 2.0 * sine2 * cosine2;
    const pair error = (pair_at(near->of_cosine[0]) * cosine + pair_at(near->of_sine[0]) * sine) +
                       (pair_at(near->of_cosine[1]) * cosine2 + pair_at(near->of_sine[1]) * sine2) +
                       (pair_at(near->of_cosine[2]) * cosine4 + pair_at(near->of_sine[2]) * sine4);
    real sync = error[0], steepness = error[1];
    if (k->has_more_orders > 0.0) { /* any order, a fraction too: no grid leads there */
        for (int i = 0; i < MORE_LINES; i++) {
            const real turned = k->more_orders[i] * theta_m + k->more_phi[i];
            sync += k->more_rad[i] * COS(turned);
            steepness -= k->more_orders[i] * k->more_rad[i] * SIN(turned);
        }
    }
    if (k->is_eccentric > 0.0) {
        for (int i = 0; i < MORE_LINES; i++) {
            const real turned = k->joint_orders[i] * theta_m + k->joint_phi[i];
            sync += k->joint_rad[i] * COS(turned);
            steepness -= k->joint_orders[i] * k->joint_rad[i] * SIN(turned);
        }
    }
    const real torsion = theta_m * k->per_ratio + sync - theta_l;
    real stiffness = k->gear_stiffness;
    pose->theta_m = theta_m;
    pose->theta_l = theta_l;
    pose->steepness = steepness;
    pose->gravity = near->gravity_cos * cosines[1] - near->gravity_sin * sines[1];
    if (k->wind_up_softness > 0.0) {
        const real ratio = torsion / k->wind_up_torsion;
        stiffness *= 1.0 - k->wind_up_softness * EXP(-ratio * ratio);
    }
    pose->spring = stiffness * torsion;
}

/* w_m' and w_l', z' and t' of an axis in a pose; speeds are w_m and w_l, lags z and t.
 *
 * command is the torque command in N m; braked: the brake holds the motor. */
INLINED void rates(
    const struct constants *k, const struct pose *pose, real command, int braked, pair speeds, pair lags, pair *speed_rates,
    pair *lag_rates)
{
    const real torsion_rate = speeds[0] * (k->per_ratio + pose->steepness) - speeds[1];
    const real gear = pose->spring + k->gear_damping * torsion_rate + lags[0];
    *lag_rates = (pair){0.0, 0.0};
    if (k->hysteresis_torque > 0.0) {
        const real sign = torsion_rate > 0.0 ? 1.0 : -1.0;
        *lag_rates = (pair){torsion_rate / k->hysteresis_torsion * (k->hysteresis_torque - sign * lags[0]), 0.0};
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
    if (k->is_cogging > 0.0) {
        for (int i = 0; i < MORE_LINES; i++) {
            torque += k->cogging_nm[i] * COS(k->cogging_orders[i] * pose->theta_m + k->cogging_phi[i]);
        }
    }
    const real load = gear * (k->per_ratio + k->gear_reaction * pose->steepness);
    const real lost = friction(k->coulomb_friction, k->friction_rise, k->per_stribeck_velocity, speeds[0]);
    *speed_rates = (pair){
        (torque - k->motor_damping * speeds[0] - lost - load) * k->per_motor_inertia,
        (gear - k->arm_damping * speeds[1] - pose->gravity) * k->per_arm_inertia,
    };
}

#endif
