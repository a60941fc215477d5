/* The pose of an axis, its rates, and its control period: classical Runge-Kutta with fixed sub-steps. For one axis or for several in
 * lock-step, see lanes.h. */
#pragma once

#include "friction.h"

/* The pose at an angle of the motor and one of the arm. part, see sum_waves, is 1/2 for a state and 1 for a stage after it. */
INLINED LANED void find_pose(struct group *g, lanes theta_m, lanes theta_l, real part, struct lane_pose *pose)
{
    const struct lane_constants *k = constants_of(g);
    lanes error;
    pose_waves(g, theta_m, theta_l, part, &error, pose);
    const lanes torsion = theta_m * k->per_ratio + error - theta_l;
    pose->theta_m = theta_m;
    pose->theta_l = theta_l;
    pose->spring = k->gear_stiffness * torsion;
    if (g->is_soft) {
        const lanes ratio = torsion * k->per_wind_up_torsion;
        pose->spring -= k->wind_up_softness * pose->spring * decay(ratio * ratio);
    }
}

/* w_m' and w_l', z' and t' of an axis in a pose, written to slope; of x the pose has the angles.
 *
 * command is the torque command in N m; braked: the brake holds the motor. */
INLINED LANED void rates(
    const struct group *g, const struct lane_pose *pose, lanes command, marks braked, const struct lane_state *x,
    struct lane_state *slope)
{
    const struct lane_constants *k = constants_of(g);
    const lanes zero = EVERY(lanes, 0.0), w_m = x->w_m;
    const lanes torsion_rate = w_m * (k->per_ratio + pose->steepness) - x->w_l;
    const lanes gear = (k->gear_damping * torsion_rate + x->z) + pose->spring;
    slope->w_l = (gear - k->arm_damping * x->w_l - pose->gravity) * k->per_arm_inertia;
    slope->w_m = slope->z = slope->tau = zero;
    if (g->has_hysteresis) {
        slope->z = (torsion_rate * k->hysteresis_torque - size_of(torsion_rate) * x->z) * k->per_hysteresis_torsion;
    }
    if (!any(no(braked))) {
        return;
    }
    lanes torque = command;
    if (g->has_lag) {
        const marks lags = k->current_time_constant > 0.0;
        torque = choose(lags, x->tau, command);
        slope->tau = choose(lags & no(braked), (command - x->tau) / k->current_time_constant, zero);
    }
    const lanes load = gear * (k->per_ratio + k->gear_reaction * pose->steepness);
    const lanes lost = friction(k->coulomb_friction, k->friction_rise, k->per_stribeck_velocity, w_m);
    const lanes left = torque + pose->cogging - k->motor_damping * w_m - lost - load;
    slope->w_m = choose(braked, zero, left * k->per_motor_inertia);
}

/* The speeds and lags of a stage: those of x, and step times a slope. */
INLINED LANED void follow_slope(const struct lane_state *x, real step, const struct lane_state *slope, struct lane_state *stage)
{
    stage->w_m = x->w_m + step * slope->w_m;
    stage->w_l = x->w_l + step * slope->w_l;
    stage->z = x->z + step * slope->z;
    stage->tau = x->tau + step * slope->tau;
}

/* One control period of state x under a constant torque command in N m; pose is that of x, and becomes that of the new one. */
INLINED LANED void run_period(
    struct group *g, struct lane_pose *pose, struct lane_state *x, lanes command, marks braked, real period_s, integer substeps)
{
    const lanes zero = EVERY(lanes, 0.0);
    struct lane_pose here = *pose, there;
    struct lane_state s = *x, stage, one, two, three, four;
    s.w_m = choose(braked, zero, s.w_m);
    s.tau = choose(braked, zero, choose(constants_of(g)->current_time_constant <= 0.0, command, s.tau));
    const real h = period_s / (real)substeps;
    const real half = 0.5 * h, sixth = h / 6.0;
    for (integer step = 0; step < substeps; step++) { /* Nystroem's form: angles of stages by earlier accelerations */
        rates(g, &here, command, braked, &s, &one);
        const lanes middle_m = s.theta_m + half * s.w_m, middle_l = s.theta_l + half * s.w_l;
        const lanes end_m = s.theta_m + h * s.w_m, end_l = s.theta_l + h * s.w_l;
        find_pose(g, middle_m, middle_l, 1.0, &there);
        follow_slope(&s, half, &one, &stage);
        rates(g, &there, command, braked, &stage, &two);
        find_pose(g, middle_m + half * half * one.w_m, middle_l + half * half * one.w_l, 1.0, &there);
        follow_slope(&s, half, &two, &stage);
        rates(g, &there, command, braked, &stage, &three);
        find_pose(g, end_m + h * half * two.w_m, end_l + h * half * two.w_l, 1.0, &there);
        follow_slope(&s, h, &three, &stage);
        rates(g, &there, command, braked, &stage, &four);
        s.theta_m = end_m + h * sixth * (one.w_m + two.w_m) + h * sixth * three.w_m;
        s.theta_l = end_l + h * sixth * (one.w_l + two.w_l) + h * sixth * three.w_l;
        s.w_m = s.w_m + sixth * (one.w_m + 2.0 * (two.w_m + three.w_m) + four.w_m);
        s.w_l = s.w_l + sixth * (one.w_l + 2.0 * (two.w_l + three.w_l) + four.w_l);
        s.z = s.z + sixth * (one.z + 2.0 * (two.z + three.z) + four.z);
        s.tau = s.tau + sixth * (one.tau + 2.0 * (two.tau + three.tau) + four.tau);
        find_pose(g, s.theta_m, s.theta_l, 0.5, &here);
    }
    *pose = here;
    *x = s;
}
