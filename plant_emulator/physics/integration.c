#include "integration.h"

#include <string.h>

void prepare(const struct plant *plant, const struct plant_state *state, struct prepared *prepared)
{
    const struct plant_state *s = state;
    struct prepared *p = prepared;
    const int has_changed = memcmp(plant, &p->plant, sizeof p->plant) != 0;
    if (has_changed) {
        p->plant = *plant;
        find_constants(plant, &p->constants, &p->near);
    }
    if (has_changed || s->motor_angle_rad != p->pose.theta_m || s->arm_angle_rad != p->pose.theta_l) {
        find_pose(&p->constants, s->motor_angle_rad, s->arm_angle_rad, 0.5, &p->near, &p->pose);
    }
}

void plant_period(
    struct prepared *prepared, struct plant_state *state, real command, int braked, real period_s, integer substeps)
{
    const struct constants *k = &prepared->constants;
    struct grid_point *near = &prepared->near;
    struct pose here = prepared->pose, pose;
    pair angles = {state->motor_angle_rad, state->arm_angle_rad}, speeds = {state->motor_speed_rad_s, state->arm_speed_rad_s};
    pair lags = {state->hysteresis_nm, state->torque_nm}, w1, w2, w3, w4, z1, z2, z3, z4;
    if (braked) {
        speeds = (pair){0.0, speeds[1]};
        lags = (pair){lags[0], 0.0};
    } else if (k->current_time_constant <= 0.0) {
        lags = (pair){lags[0], command};
    }
    const real h = period_s / (real)substeps;
    const real half = 0.5 * h, sixth = h / 6.0;
    for (integer step = 0; step < substeps; step++) { /* Nystroem's form: angles of stages by earlier accelerations */
        rates(k, &here, command, braked, speeds, lags, &w1, &z1);
        const pair middle = angles + half * speeds, end = angles + h * speeds;
        find_pose(k, middle[0], middle[1], 1.0, near, &pose);
        rates(k, &pose, command, braked, speeds + half * w1, lags + half * z1, &w2, &z2);
        pair at = middle + half * half * w1;
        find_pose(k, at[0], at[1], 1.0, near, &pose);
        rates(k, &pose, command, braked, speeds + half * w2, lags + half * z2, &w3, &z3);
        at = end + h * half * w2;
        find_pose(k, at[0], at[1], 1.0, near, &pose);
        rates(k, &pose, command, braked, speeds + h * w3, lags + h * z3, &w4, &z4);
        angles = end + h * sixth * (w1 + w2) + h * sixth * w3;
        speeds += sixth * (w1 + 2.0 * (w2 + w3) + w4);
        lags += sixth * (z1 + 2.0 * (z2 + z3) + z4);
        find_pose(k, angles[0], angles[1], 0.5, near, &here);
    }
    prepared->pose = here;
    state->motor_angle_rad = angles[0];
    state->motor_speed_rad_s = speeds[0];
    state->arm_angle_rad = angles[1];
    state->arm_speed_rad_s = speeds[1];
    state->hysteresis_nm = lags[0];
    state->torque_nm = lags[1];
}

real arm_acceleration(const struct prepared *prepared, const struct plant_state *state)
{
    const pair speeds = {state->motor_speed_rad_s, state->arm_speed_rad_s}, lags = {state->hysteresis_nm, state->torque_nm};
    pair speed_rates, lag_rates;
    rates(&prepared->constants, &prepared->pose, 0.0, 1, speeds, lags, &speed_rates, &lag_rates);
    return speed_rates[1];
}

void plant_step(
    const struct plant *plant, struct plant_state *state, real command, int braked, real period_s, integer substeps)
{
    struct prepared prepared;
    memset(&prepared, 0, sizeof prepared);
    prepare(plant, state, &prepared);
    plant_period(&prepared, state, command, braked, period_s, substeps);
    state->arm_acceleration_rad_s2 = arm_acceleration(&prepared, state);
}
