#include "integration.h"

void find_nearest(const struct constants *k, const struct plant_state *state, struct grid_point *near)
{
    real motor, arm;
    grid_angles(k, state->motor_angle_rad, state->arm_angle_rad, &motor, &arm);
    find_grid_point(k, motor, arm, near);
}

static struct axis_state state_of(const struct plant_state *s)
{
    return (struct axis_state){s->motor_angle_rad, s->motor_speed_rad_s, s->arm_angle_rad,
                               s->arm_speed_rad_s, s->hysteresis_nm,     s->torque_nm};
}

void plant_period(
    const struct constants *k, struct grid_point *near, struct plant_state *state, real command, int braked, real period_s,
    integer substeps)
{
    struct axis_state x = state_of(state);
    struct axis_state r1, r2, r3, r4, at;
    if (braked) {
        x.w_m = x.tau = 0.0;
    } else if (k->current_time_constant <= 0.0) {
        x.tau = command;
    }
    const real h = period_s / (real)substeps;
    const real half = 0.5 * h, sixth = h / 6.0;
    for (integer step = 0; step < substeps; step++) {
        move_near(k, x.theta_m, x.theta_l, near);
        rates(k, near, command, braked, &x, &r1);
        const real wm2 = x.w_m + half * r1.w_m, wl2 = x.w_l + half * r1.w_l;
        at = (struct axis_state){x.theta_m + half * x.w_m, wm2, x.theta_l + half * x.w_l, wl2,
                                 x.z + half * r1.z,        x.tau + half * r1.tau};
        rates(k, near, command, braked, &at, &r2);
        const real wm3 = x.w_m + half * r2.w_m, wl3 = x.w_l + half * r2.w_l;
        at = (struct axis_state){x.theta_m + half * wm2, wm3, x.theta_l + half * wl2, wl3, x.z + half * r2.z,
                                 x.tau + half * r2.tau};
        rates(k, near, command, braked, &at, &r3);
        const real wm4 = x.w_m + h * r3.w_m, wl4 = x.w_l + h * r3.w_l;
        at = (struct axis_state){x.theta_m + h * wm3, wm4, x.theta_l + h * wl3, wl4, x.z + h * r3.z, x.tau + h * r3.tau};
        rates(k, near, command, braked, &at, &r4);
        x.theta_m += sixth * (x.w_m + 2.0 * (wm2 + wm3) + wm4);
        x.theta_l += sixth * (x.w_l + 2.0 * (wl2 + wl3) + wl4);
        x.w_m += sixth * (r1.w_m + 2.0 * (r2.w_m + r3.w_m) + r4.w_m);
        x.w_l += sixth * (r1.w_l + 2.0 * (r2.w_l + r3.w_l) + r4.w_l);
        x.z += sixth * (r1.z + 2.0 * (r2.z + r3.z) + r4.z);
        x.tau += sixth * (r1.tau + 2.0 * (r2.tau + r3.tau) + r4.tau);
    }
    state->motor_angle_rad = x.theta_m;
    state->motor_speed_rad_s = x.w_m;
    state->arm_angle_rad = x.theta_l;
    state->arm_speed_rad_s = x.w_l;
    state->hysteresis_nm = x.z;
    state->torque_nm = x.tau;
}

real arm_acceleration(const struct constants *k, const struct plant_state *state, struct grid_point *near)
{
    const struct axis_state at = state_of(state);
    struct axis_state slope;
    move_near(k, state->motor_angle_rad, state->arm_angle_rad, near);
    rates(k, near, 0.0, 1, &at, &slope);
    return slope.w_l;
}

void plant_step(
    const struct plant *plant, struct plant_state *state, real command, int braked, real period_s, integer substeps)
{
    struct constants k;
    struct grid_point near;
    find_constants(plant, &k);
    find_nearest(&k, state, &near);
    plant_period(&k, &near, state, command, braked, period_s, substeps);
    state->arm_acceleration_rad_s2 = arm_acceleration(&k, state, &near);
}
