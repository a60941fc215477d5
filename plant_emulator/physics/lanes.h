/* Numbers of one axis, or of four axes in lock-step: the sources of the physics are compiled for both, and give the same bits.
 *
 * A source that defines FOUR_LANES before it includes anything works on four axes, each in a lane of a vector. It needs a processor
 * with AVX2; there two vectors take hardly longer than two numbers, and what waits for one axis works on the others.
 */
#pragma once

#include "angle_grid.h"

#include <stddef.h>

#ifdef FOUR_LANES

enum { LANES = 4 };
#define LANED __attribute__((target("avx2")))
#define LANE(numbers, lane) ((numbers)[lane])
#define EVERY(type, number) ((type){number, number, number, number})
typedef real lanes __attribute__((vector_size(LANES * sizeof(real))));
typedef integer marks __attribute__((vector_size(LANES * sizeof(integer))));

INLINED LANED int any(marks m)
{
    return (m[0] | m[1] | m[2] | m[3]) != 0;
}

INLINED LANED marks no(marks m)
{
    return ~m;
}

INLINED LANED lanes choose(marks m, lanes a, lanes b)
{
    return (lanes)(((marks)a & m) | ((marks)b & ~m));
}

INLINED LANED lanes size_of(lanes x)
{
    return (lanes)((marks)x & INT64_MAX);
}

INLINED LANED lanes signed_as(lanes size, lanes x)
{
    return (lanes)((marks)size | ((marks)x & INT64_MIN));
}

/* exp(-x), as a single axis has it. */
INLINED LANED lanes decay(lanes x)
{
    return (lanes){EXP(-x[0]), EXP(-x[1]), EXP(-x[2]), EXP(-x[3])};
}

/* The first numbers of constants and all of the others; transposed, see gather. */
struct lane_constants {
    lanes per_ratio, per_motor_inertia, motor_damping, per_arm_inertia, arm_damping, gear_stiffness, gear_damping;
    lanes coulomb_friction, friction_rise, per_stribeck_velocity, gear_reaction, wind_up_softness, per_wind_up_torsion;
    lanes hysteresis_torque, per_hysteresis_torsion, current_time_constant;
};

struct lane_waves {
    lanes spacing, angle, terms[WAVE_TERMS][2];
};

struct lane_pose {
    lanes theta_m, theta_l, steepness, spring, gravity, cogging;
};

struct lane_state {
    lanes theta_m, theta_l, w_m, w_l, z, tau;
};

#else

enum { LANES = 1 };
#define LANED
#define LANE(numbers, lane) (*((void)(lane), &(numbers)))
#define EVERY(type, number) ((type)(number))
typedef real lanes;
typedef int marks;

INLINED int any(marks m)
{
    return m;
}

INLINED marks no(marks m)
{
    return !m;
}

INLINED lanes choose(marks m, lanes a, lanes b)
{
    return m ? a : b;
}

INLINED lanes size_of(lanes x)
{
    return FABS(x);
}

INLINED lanes signed_as(lanes size, lanes x)
{
    return COPYSIGN(size, x);
}

INLINED lanes decay(lanes x)
{
    return EXP(-x);
}

#define lane_constants constants
#define lane_pose pose
#define lane_state axis_state

#endif

/* Write count numbers of an axis into its lane, and back. */
INLINED LANED void gather(lanes *to, const real *from, size_t count, int lane)
{
    for (size_t i = 0; i < count; i++) {
        LANE(to[i], lane) = from[i];
    }
}

INLINED LANED void scatter(real *to, const lanes *from, size_t count, int lane)
{
    for (size_t i = 0; i < count; i++) {
        to[i] = LANE(from[i], lane);
    }
}

#ifdef FOUR_LANES

/* Axes in lock-step. */
struct group {
    struct lane_constants constants;
    struct lane_waves error, cogging, gravity;
    const struct constants *own[LANES];
    struct grid_point *near[LANES];
    int is_cogging, is_soft, has_hysteresis, has_lag; /* of any */
};

INLINED LANED void gather_waves(struct lane_waves *to, const struct waves *from, int lane)
{
    gather(&to->spacing, &from->spacing, sizeof *from / sizeof(real), lane);
}

/* Give a lane to an axis whose waves are developed near to it. */
INLINED LANED void join(struct group *g, int lane, const struct constants *constants, struct grid_point *near)
{
    const struct constants *k = constants;
    g->own[lane] = k;
    g->near[lane] = near;
    gather(&g->constants.per_ratio, &k->per_ratio, sizeof g->constants / sizeof(lanes), lane);
    gather_waves(&g->error, &near->error, lane);
    gather_waves(&g->gravity, &near->gravity, lane);
    gather_waves(&g->cogging, &near->cogging, lane);
    if (k->cogging_lines == 0) { /* zeros, wherever it is */
        g->cogging.spacing[lane] = (real)INFINITY;
        g->cogging.angle[lane] = 0.0;
    }
    g->is_cogging |= k->cogging_lines > 0;
    g->is_soft |= k->wind_up_softness > 0.0;
    g->has_hysteresis |= k->hysteresis_torque > 0.0;
    g->has_lag |= k->current_time_constant > 0.0;
}

/* Develop the waves of an axis anew where they are too far away, and put them into its lane. */
INLINED LANED void renew(
    const struct harmonic *harmonics, integer count, real angle, real part, struct waves *near, struct lane_waves *to, int lane)
{
    sum_waves(harmonics, count, angle, part, near);
    if (near->angle != to->angle[lane]) {
        gather_waves(to, near, lane);
    }
}

LANED static __attribute__((noinline)) void move_on(struct group *g, const lanes *theta_m, const lanes *theta_l, real part)
{
    for (int lane = 0; lane < LANES; lane++) {
        const struct constants *k = g->own[lane];
        struct grid_point *near = g->near[lane];
        renew(k->error, k->lines, (*theta_m)[lane], part, &near->error, &g->error, lane);
        renew(&k->gravity, 1, (*theta_l)[lane], part, &near->gravity, &g->gravity, lane);
        if (k->cogging_lines > 0) {
            renew(k->cogging, k->cogging_lines, (*theta_m)[lane], part, &near->cogging, &g->cogging, lane);
        }
    }
}

INLINED LANED marks are_far(const struct lane_waves *near, lanes angle, real part)
{
    return ~(size_of(angle - near->angle) < part * near->spacing);
}

/* Sum, or slope, at angles that are near. */
INLINED LANED lanes sum_of(const struct lane_waves *near, lanes angle, int which)
{
    const lanes d = angle - near->angle, q = d * d, r = q * q;
#define TERM(n) near->terms[n][which]
    return EVEN_POWERS(TERM, q, r) + d * ODD_POWERS(TERM, q, r);
#undef TERM
}

/* See the one of a single axis. */
INLINED LANED void pose_waves(struct group *g, lanes theta_m, lanes theta_l, real part, lanes *error, struct lane_pose *pose)
{
    marks far = are_far(&g->error, theta_m, part) | are_far(&g->gravity, theta_l, part);
    if (g->is_cogging) {
        far |= are_far(&g->cogging, theta_m, part);
    }
    if (any(far)) {
        const lanes at_m = theta_m, at_l = theta_l;
        move_on(g, &at_m, &at_l, part);
    }
    *error = sum_of(&g->error, theta_m, 0);
    pose->steepness = sum_of(&g->error, theta_m, 1);
    pose->gravity = sum_of(&g->gravity, theta_l, 0);
    pose->cogging = g->is_cogging ? sum_of(&g->cogging, theta_m, 0) : EVERY(lanes, 0.0);
}

#else

struct group {
    const struct constants *own;
    struct grid_point *near;
    int is_cogging, is_soft, has_hysteresis, has_lag;
};

INLINED void join(struct group *g, int lane, const struct constants *constants, struct grid_point *near)
{
    const struct constants *k = constants;
    (void)lane;
    *g = (struct group){
        k, near, k->cogging_lines > 0, k->wind_up_softness > 0.0, k->hysteresis_torque > 0.0, k->current_time_constant > 0.0};
}

/* What find_pose needs of the waves: error becomes theta_sync; part as there. */
INLINED void pose_waves(struct group *g, lanes theta_m, lanes theta_l, real part, lanes *error, struct pose *pose)
{
    const struct constants *k = g->own;
    struct grid_point *near = g->near;
    const pair found = sum_waves(k->error, k->lines, theta_m, part, &near->error);
    *error = found[0];
    pose->steepness = found[1];
    pose->gravity = sum_waves(&k->gravity, 1, theta_l, part, &near->gravity)[0];
    pose->cogging = g->is_cogging ? sum_waves(k->cogging, k->cogging_lines, theta_m, part, &near->cogging)[0] : 0.0;
}

#endif

INLINED LANED const struct lane_constants *constants_of(const struct group *g)
{
#ifdef FOUR_LANES
    return &g->constants;
#else
    return g->own;
#endif
}
