#include "integration.h"
#include "rates.h"

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
        struct group alone;
        join(&alone, 0, &p->constants, &p->near);
        find_pose(&alone, s->motor_angle_rad, s->arm_angle_rad, 0.5, &p->pose);
    }
}

struct axis_state state_of(const struct plant_state *state)
{
    const struct plant_state *s = state;
    return (struct axis_state){
        s->motor_angle_rad, s->arm_angle_rad, s->motor_speed_rad_s, s->arm_speed_rad_s, s->hysteresis_nm, s->torque_nm};
}

void put_back(struct plant_state *state, const struct axis_state *x)
{
    state->motor_angle_rad = x->theta_m;
    state->motor_speed_rad_s = x->w_m;
    state->arm_angle_rad = x->theta_l;
    state->arm_speed_rad_s = x->w_l;
    state->hysteresis_nm = x->z;
    state->torque_nm = x->tau;
}

void plant_period(
    struct prepared *prepared, struct plant_state *state, real command, int braked, real period_s, integer substeps)
{
    struct axis_state x = state_of(state);
    struct group alone;
    join(&alone, 0, &prepared->constants, &prepared->near);
    run_period(&alone, &prepared->pose, &x, command, braked, period_s, substeps);
    put_back(state, &x);
}

real arm_acceleration(const struct prepared *prepared, const struct plant_state *state)
{
    const struct axis_state x = state_of(state);
    struct axis_state slope;
    struct group alone;
    join(&alone, 0, &prepared->constants, 0);
    rates(&alone, &prepared->pose, 0.0, 1, &x, &slope);
    return slope.w_l;
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
