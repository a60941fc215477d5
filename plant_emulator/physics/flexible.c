#include "flexible.h"
#include "rates.h"

void joint_constants(const struct plant *plant, struct constants *joint, struct grid_point *near)
{
    struct plant own = *plant;
    own.arm_inertia_kg_m2 = 1.0;
    own.gravity_moment_nm = 0.0;
    own.home_angle_rad = 0.0;
    find_constants(&own, joint, near);
}

/* Plane to = plane first + weight * plane second. */
static void add_planes(const struct flexible *arm, int to, int first, int second, real weight)
{
    struct axis_state *sum = &arm->stages[to * arm->count];
    const struct axis_state *a = &arm->stages[first * arm->count], *b = &arm->stages[second * arm->count];
    for (integer i = 0; i < arm->count; i++) {
        sum[i].theta_m = a[i].theta_m + weight * b[i].theta_m;
        sum[i].w_m = a[i].w_m + weight * b[i].w_m;
        sum[i].theta_l = a[i].theta_l + weight * b[i].theta_l;
        sum[i].w_l = a[i].w_l + weight * b[i].w_l;
        sum[i].z = a[i].z + weight * b[i].z;
        sum[i].tau = a[i].tau + weight * b[i].tau;
    }
}

/* The rates of all states of plane STATE or STAGE, written to SLOPE; part: see find_pose. */
static void flexible_rates(const struct flexible *arm, int plane, real part)
{
    const integer count = arm->count;
    real *angles = arm->turning + JOINT_ANGLE * count, *speeds = arm->turning + JOINT_SPEED * count;
    real *torques = arm->turning + JOINT_TORQUE * count;
    for (integer i = 0; i < count; i++) {
        const struct axis_state *x = &arm->stages[plane * count + i];
        struct axis_state *slope = &arm->stages[SLOPE * count + i];
        struct pose pose;
        struct group alone;
        join(&alone, 0, &arm->joints[i], &arm->near[i]);
        find_pose(&alone, x->theta_m, x->theta_l, part, &pose);
        rates(&alone, &pose, arm->commands[i], arm->brakes[i] > 0.0, x, slope);
        slope->theta_m = x->w_m;
        slope->theta_l = x->w_l;
        angles[i] = arm->links[i + 1].home_rad + x->theta_l;
        speeds[i] = x->w_l;
        torques[i] = slope->w_l;
    }
    accelerations(arm->links, count, arm->turning);
    for (integer i = 0; i < count; i++) {
        arm->stages[SLOPE * count + i].w_l = arm->turning[JOINT_ACCELERATION * count + i];
    }
}

void flexible_period(const struct flexible *arm, real period_s, integer substeps)
{
    const real h = period_s / (real)substeps;
    for (integer i = 0; i < arm->count; i++) {
        struct axis_state *x = &arm->stages[STATE * arm->count + i];
        if (arm->brakes[i] > 0.0) {
            x->w_m = x->tau = 0.0;
        } else if (arm->joints[i].current_time_constant <= 0.0) {
            x->tau = arm->commands[i];
        }
    }
    for (integer step = 0; step < substeps; step++) {
        add_planes(arm, SUM, SUM, SUM, -1.0);
        add_planes(arm, STAGE, STATE, STATE, 0.0);
        for (int stage = 0; stage < 4; stage++) {
            flexible_rates(arm, STAGE, stage == 0 ? 0.5 : 1.0);
            add_planes(arm, SUM, SUM, SLOPE, stage == 1 || stage == 2 ? 2.0 : 1.0);
            add_planes(arm, STAGE, STATE, SLOPE, stage == 2 ? h : 0.5 * h);
        }
        add_planes(arm, STATE, STATE, SUM, h / 6.0);
    }
}

void flexible_rest(const struct flexible *arm)
{
    flexible_rates(arm, STATE, 0.5);
}
