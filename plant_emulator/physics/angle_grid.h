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
 * where cos 2d = 1 - 2 sin^2 d and sin 2d = 2 sin d cos d, once more for 4d. Gravity alike, with m g l and theta_l + q_0. */
struct grid_point {
    real motor; /* t0 of the motor */
    real x1;
    real y1;
    real x2;
    real y2;
    real x4;
    real y4;
    real arm; /* t0 of the arm's inclination theta_l + q_0 */
    real gravity_cos;
    real gravity_sin;
};

/* theta_m, w_m, theta_l, w_l, z and t; or their rates. */
struct axis_state {
    real theta_m;
    real w_m;
    real theta_l;
    real w_l;
    real z;
    real tau;
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

/* Cosine and sine of the motor's distance from its grid angle.
 *
 * Taylor's polynomials to d^6 and d^7 leave less than d^8/8! and d^9/9!: 5.8e-15 at |d| = 1/16. On an amplitude of A_k = 60" that
 * is 2e-18 rad, below the last digit of theta_m/N. Further away the library's functions take over. */
INLINED void motor_turn(real d, real *cosine, real *sine)
{
    if (FABS(d) > MOTOR_GRID_RAD) {
        *cosine = COS(d);
        *sine = SIN(d);
        return;
    }
    const real q = d * d;
    *cosine = 1.0 - q * (1.0 / 2.0 - q * (1.0 / 24.0 - q * (1.0 / 720.0)));
    *sine = d * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0 - q * (1.0 / 5040.0))));
}

/* Cosine and sine of the arm's distance from its grid angle.
 *
 * Taylor's polynomials to d^4 and d^5 leave less than d^6/6! and d^7/7!: 2.0e-14 at |d| = 1/64. On a gravity moment of 52 N m
 * that is 1e-12 N m; the last digit of an arm angle of 1 rad, times K_g, is 1e-11 N m. */
INLINED void arm_turn(real d, real *cosine, real *sine)
{
    if (FABS(d) > ARM_GRID_RAD) {
        *cosine = COS(d);
        *sine = SIN(d);
        return;
    }
    const real q = d * d;
    *cosine = 1.0 - q * (1.0 / 2.0 - q * (1.0 / 24.0));
    *sine = d * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0)));
}

/* w_m', w_l', z' and t' of an axis in the fields w_m, w_l, z and tau of slope; the angles' rates are the speeds of at.
 *
 * near is a grid point: the nearer, the smaller the error. command is the torque command in N m; braked: the brake holds the
 * motor. */
INLINED void rates(
    const struct constants *k, const struct grid_point *near, real command, int braked, const struct axis_state *at,
    struct axis_state *slope)
{
    real cosine, sine;
    motor_turn(at->theta_m - near->motor, &cosine, &sine);
    const real cosine2 = 1.0 - 2.0 * sine * sine, sine2 = 2.0 * sine * cosine;
    const real cosine4 = 1.0 - 2.0 * sine2 * sine2, sine4 = 2.0 * sine2 * cosine2;
    real sync = (near->x1 * cosine - near->y1 * sine) + (near->x2 * cosine2 - near->y2 * sine2) +
                (near->x4 * cosine4 - near->y4 * sine4);
    const real slope1 = near->x1 * sine + near->y1 * cosine, slope2 = near->x2 * sine2 + near->y2 * cosine2;
    const real slope4 = near->x4 * sine4 + near->y4 * cosine4;
    real steepness = -slope1 - 2.0 * slope2 - 4.0 * slope4;
    if (k->has_more_orders > 0.0) { /* any order, a fraction too: no grid leads there */
        for (int i = 0; i < MORE_LINES; i++) {
            const real turned = k->more_orders[i] * at->theta_m + k->more_phi[i];
            sync += k->more_rad[i] * COS(turned);
            steepness -= k->more_orders[i] * k->more_rad[i] * SIN(turned);
        }
    }
    if (k->is_eccentric > 0.0) {
        for (int i = 0; i < MORE_LINES; i++) {
            const real turned = k->joint_orders[i] * at->theta_m + k->joint_phi[i];
            sync += k->joint_rad[i] * COS(turned);
            steepness -= k->joint_orders[i] * k->joint_rad[i] * SIN(turned);
        }
    }
    const real torsion = at->theta_m * k->per_ratio + sync - at->theta_l;
    const real torsion_rate = at->w_m * (k->per_ratio + steepness) - at->w_l;
    real stiffness = k->gear_stiffness;
    if (k->wind_up_softness > 0.0) {
        const real ratio = torsion / k->wind_up_torsion;
        stiffness *= 1.0 - k->wind_up_softness * EXP(-ratio * ratio);
    }
    const real gear = stiffness * torsion + k->gear_damping * torsion_rate + at->z;
    arm_turn(at->theta_l + k->home_angle - near->arm, &cosine, &sine);
    const real gravity = near->gravity_cos * cosine - near->gravity_sin * sine;
    slope->w_l = (gear - k->arm_damping * at->w_l - gravity) * k->per_arm_inertia;
    slope->z = 0.0;
    if (k->hysteresis_torque > 0.0) {
        const real sign = torsion_rate > 0.0 ? 1.0 : -1.0;
        slope->z = torsion_rate / k->hysteresis_torsion * (k->hysteresis_torque - sign * at->z);
    }
    if (braked) {
        slope->w_m = slope->tau = 0.0;
        return;
    }
    real torque = command;
    slope->tau = 0.0;
    if (k->current_time_constant > 0.0) {
        torque = at->tau;
        slope->tau = (command - at->tau) / k->current_time_constant;
    }
    if (k->is_cogging > 0.0) {
        for (int i = 0; i < MORE_LINES; i++) {
            torque += k->cogging_nm[i] * COS(k->cogging_orders[i] * at->theta_m + k->cogging_phi[i]);
        }
    }
    const real load = gear * (k->per_ratio + k->gear_reaction * steepness);
    const real lost = friction(k->coulomb_friction, k->friction_rise, k->per_stribeck_velocity, at->w_m);
    slope->w_m = (torque - k->motor_damping * at->w_m - lost - load) * k->per_motor_inertia;
}

#endif
