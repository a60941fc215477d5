#include "gear.h"

/* Steps to the torsion that carries gravity at rest: each leaves at most r of the error, 1e-20 of it at r = 0.3 in the end. */
enum { RESTING_STEPS = 40 };
/* Arms that go on side by side: each step of one waits for the step before, and meanwhile the processor works on the others. */
enum { TOGETHER = 8 };
/* 2^54: what is less than one over it does not change 1. */
#define HALF_BIT 18014398509481984.0

/* Where a step began: torsion and hysteresis. */
struct turn {
    real torsion;
    real z;
};

/* Gravity at an angle, and its rate of change by the angle. */
struct weight {
    real there;
    real slope;
};

/* An arm on its way, and the step that it takes: rates v and accelerations a of its parts. */
struct arm {
    const struct gear_law *law;
    real felt; /* (psi/psi_s)^2 from which on the spring is stiff, to the last bit */
    struct turn from;
    struct weight weight;
    real angle, v, v2, v3, a1, a2, a3;
};

static real hysteresis(const struct gear_law *law, const struct turn *from, real torsion)
{
    const real moved = torsion - from->torsion;
    if (law->hysteresis == 0.0 || moved == 0.0) {
        return from->z;
    }
    const real end = moved > 0.0 ? law->hysteresis : -law->hysteresis;
    return end + (from->z - end) * EXP(-FABS(moved) * law->per_hysteresis);
}

static real spring(const struct gear_law *law, real felt, real torsion)
{
    const real ratio = torsion * law->per_wind_up, square = ratio * ratio;
    if (square > felt) {
        return law->stiffness * torsion;
    }
    return law->stiffness * (1.0 - law->softness * EXP(-square)) * torsion;
}

static struct weight gravity(const struct gear_law *law, real angle)
{
    if (law->gravity_cosine == 0.0 && law->gravity_sine == 0.0) {
        return (struct weight){0.0, 0.0};
    }
    const real c = COS(angle), s = SIN(angle);
    return (struct weight){law->gravity_cosine * c + law->gravity_sine * s, law->gravity_sine * c - law->gravity_cosine * s};
}

/* Gravity not far from there: the error of the series is the angle to the fourth power over 24. */
static real beside(const struct weight *weight, real moved)
{
    const real square = moved * moved;
    return weight->there * (1.0 - 0.5 * square) + weight->slope * moved * (1.0 - square / 6.0);
}

/* Acceleration of the arm where it has moved since the step began. */
static real pushed(const struct arm *arm, real base, real base_speed, real moved, real speed)
{
    const struct gear_law *law = arm->law;
    const real torsion = base - (arm->angle + moved);
    return spring(law, arm->felt, torsion) + hysteresis(law, &arm->from, torsion) + law->gear_damping * (base_speed - speed) -
           law->arm_damping * speed - beside(&arm->weight, moved);
}

static struct arm at_rest(const struct gear_law *law, real base, real speed)
{
    /* 1 - r exp(-x) is 1 where r exp(-x) is below 2^-54; at the limit itself, a hair's breadth is left */
    const real felt = LOG(law->softness * HALF_BIT) + 1e-6;
    const real z = law->wound * law->hysteresis;
    real angle = base;
    for (int i = 0; i < RESTING_STEPS; i++) {
        angle += (spring(law, felt, base - angle) + z - gravity(law, angle).there) / law->stiffness;
    }
    angle += law->ahead;
    return (struct arm){.law = law, .felt = felt, .from = {base - angle, z}, .angle = angle, .v = speed + law->ahead_speed};
}

static void follow_some(
    const struct gear_law *laws, integer count, const real *base, const real *speed, integer apart, integer steps, real step_s,
    real *acceleration)
{
    struct arm arms[TOGETHER];
    const real half = 0.5 * step_s;
    for (integer i = 0; i < count; i++) {
        arms[i] = at_rest(&laws[i], base[i * apart], speed[i * apart]);
    }
    for (integer n = 0; n < steps; n++) {
        const real *b = base + 2 * n, *w = speed + 2 * n;
        for (integer i = 0; i < count; i++) {
            struct arm *arm = &arms[i];
            arm->weight = gravity(arm->law, arm->angle);
            arm->a1 = pushed(arm, b[i * apart], w[i * apart], 0.0, arm->v);
            acceleration[i * (steps + 1) + n] = arm->a1;
        }
        for (integer i = 0; i < count; i++) {
            struct arm *arm = &arms[i];
            arm->v2 = arm->v + half * arm->a1;
            arm->a2 = pushed(arm, b[i * apart + 1], w[i * apart + 1], half * arm->v, arm->v2);
        }
        for (integer i = 0; i < count; i++) {
            struct arm *arm = &arms[i];
            arm->v3 = arm->v + half * arm->a2;
            arm->a3 = pushed(arm, b[i * apart + 1], w[i * apart + 1], half * arm->v2, arm->v3);
        }
        for (integer i = 0; i < count; i++) {
            struct arm *arm = &arms[i];
            const real v4 = arm->v + step_s * arm->a3;
            const real a4 = pushed(arm, b[i * apart + 2], w[i * apart + 2], step_s * arm->v3, v4);
            arm->angle += step_s / 6.0 * (arm->v + 2.0 * arm->v2 + 2.0 * arm->v3 + v4);
            arm->v += step_s / 6.0 * (arm->a1 + 2.0 * arm->a2 + 2.0 * arm->a3 + a4);
            const real torsion = b[i * apart + 2] - arm->angle;
            arm->from = (struct turn){torsion, hysteresis(arm->law, &arm->from, torsion)};
        }
    }
    for (integer i = 0; i < count; i++) {
        const integer end = i * apart + 2 * steps;
        arms[i].weight = gravity(&laws[i], arms[i].angle);
        acceleration[i * (steps + 1) + steps] = pushed(&arms[i], base[end], speed[end], 0.0, arms[i].v);
    }
}

void gear_follow(
    const struct gear_law *laws, integer count, const real *base, const real *speed, integer apart, integer steps, real step_s,
    real *acceleration)
{
    for (integer i = 0; i < count; i += TOGETHER) {
        const integer some = count - i < TOGETHER ? count - i : TOGETHER;
        follow_some(laws + i, some, base + i * apart, speed + i * apart, apart, steps, step_s, acceleration + i * (steps + 1));
    }
}
