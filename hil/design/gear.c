#include "gear.h"

#include "hil/control/waves.h"

/* Steps to the torsion that carries gravity at rest: each leaves at most r of the error, 1e-20 of it at r = 0.3 in the end. */
enum { RESTING_STEPS = 40 };
/* Pairs of arms that go on side by side: each step of one waits for the step before, and meanwhile the processor works on the
 * others. */
enum { TOGETHER = 6 };
/* 2^54: what is less than one over it does not change 1. */
#define HALF_BIT 18014398509481984.0

/* Two arms on their way, and the step that they take: rates v and accelerations a of its parts. */
struct arms {
    pair stiffness, gear_damping, arm_damping, softness, per_wind_up, hysteresis, per_hysteresis, gravity_cosine, gravity_sine;
    pair felt;                  /* (psi/psi_s)^2 from which on the spring is stiff, to the last bit */
    pair there, slope;          /* gravity where the step began, and its rate of change by the angle */
    pair began, z;              /* torsion and hysteresis where the step began */
    pair torsion, soft, kept;   /* torsion, its part of the softness, and what it keeps of the hysteresis */
    pair angle, v, v2, v3, a1, a2, a3;
    const real *base[2], *speed[2];
    real *acceleration[2];
};

#define EACH for (struct arms *arms = together; arms < together + count; arms++)
#define OF_BOTH(laws, name) ((pair){(laws)[0]->name, (laws)[1]->name})
#define AT(numbers, n) ((pair){(numbers)[0][n], (numbers)[1][n]})

/* exp(-x) of each; 0 from a limit on. An arm beside itself is computed once. */
INLINED pair fallen(pair x, pair limit)
{
    const real first = x[0] > limit[0] ? 0.0 : EXP(-x[0]);
    return (pair){first, x[1] == x[0] ? first : x[1] > limit[1] ? 0.0 : EXP(-x[1])};
}

/* Exponents of the spring and of the hysteresis. */
INLINED void twist(struct arms *arms, pair torsion)
{
    const pair ratio = torsion * arms->per_wind_up, moved = torsion - arms->began;
    arms->torsion = torsion;
    arms->soft = ratio * ratio;
    arms->kept = (pair){FABS(moved[0]), FABS(moved[1])} * arms->per_hysteresis;
}

/* The exponentials themselves: calls of the library, one behind the other. */
INLINED void fall_springs(struct arms *together, integer count)
{
    EACH {
        arms->soft = fallen(arms->soft, arms->felt);
    }
}

INLINED void fall_hysteresis(struct arms *together, integer count)
{
    const pair never = {(real)INFINITY, (real)INFINITY};
    EACH {
        arms->kept = fallen(arms->kept, never);
    }
}

INLINED pair spring(const struct arms *arms)
{
    return arms->stiffness * (1.0 - arms->softness * arms->soft) * arms->torsion;
}

INLINED pair hysteresis(const struct arms *arms)
{
    const pair moved = arms->torsion - arms->began;
    const pair end = {COPYSIGN(arms->hysteresis[0], moved[0]), COPYSIGN(arms->hysteresis[1], moved[1])};
    const pair z = end + (arms->z - end) * arms->kept;
    return (pair){moved[0] == 0.0 ? arms->z[0] : z[0], moved[1] == 0.0 ? arms->z[1] : z[1]};
}

INLINED void weigh(struct arms *arms)
{
    const pair angle = arms->angle;
    pair c, s;
    c[0] = c[1] = COS(angle[0]);
    s[0] = s[1] = SIN(angle[0]);
    if (angle[1] != angle[0]) {
        c[1] = COS(angle[1]);
        s[1] = SIN(angle[1]);
    }
    arms->there = arms->gravity_cosine * c + arms->gravity_sine * s;
    arms->slope = arms->gravity_sine * c - arms->gravity_cosine * s;
}

/* Gravity not far from there: the error of the series is the angle to the fourth power over 24. */
INLINED pair beside(const struct arms *arms, pair moved)
{
    const pair square = moved * moved;
    return arms->there * (1.0 - 0.5 * square) + arms->slope * moved * (1.0 - square / 6.0);
}

/* Accelerations at the torsion: of spring and hysteresis, less damping and gravity. */
INLINED pair pushed(const struct arms *arms, pair base_speed, pair speed, pair z, pair weight)
{
    return spring(arms) + z + arms->gear_damping * (base_speed - speed) - arms->arm_damping * speed - weight;
}

static void begin(struct arms *arms, const struct gear_law *const laws[2])
{
    arms->stiffness = OF_BOTH(laws, stiffness);
    arms->gear_damping = OF_BOTH(laws, gear_damping);
    arms->arm_damping = OF_BOTH(laws, arm_damping);
    arms->softness = OF_BOTH(laws, softness);
    arms->per_wind_up = OF_BOTH(laws, per_wind_up);
    arms->hysteresis = OF_BOTH(laws, hysteresis);
    arms->per_hysteresis = OF_BOTH(laws, per_hysteresis);
    arms->gravity_cosine = OF_BOTH(laws, gravity_cosine);
    arms->gravity_sine = OF_BOTH(laws, gravity_sine);
    /* 1 - r exp(-x) is 1 where r exp(-x) is below 2^-54; at the limit itself, a hair's breadth is left */
    arms->felt = (pair){LOG(laws[0]->softness * HALF_BIT), LOG(laws[1]->softness * HALF_BIT)} + 1e-6;
    const pair base = AT(arms->base, 0);
    arms->began = (pair){0.0, 0.0};
    arms->z = OF_BOTH(laws, wound) * arms->hysteresis;
    arms->angle = base;
    for (int i = 0; i < RESTING_STEPS; i++) {
        weigh(arms);
        twist(arms, base - arms->angle);
        fall_springs(arms, 1);
        arms->angle += (spring(arms) + arms->z - arms->there) / arms->stiffness;
    }
    arms->angle += OF_BOTH(laws, ahead);
    arms->v = AT(arms->speed, 0) + OF_BOTH(laws, ahead_speed);
    arms->began = base - arms->angle;
}

static void follow_some(struct arms *together, integer count, integer steps, real step_s)
{
    const real half = 0.5 * step_s;
    for (integer n = 0;; n++) {
        EACH {
            weigh(arms);
            twist(arms, arms->began);
        }
        fall_springs(together, count);
        EACH {
            arms->a1 = pushed(arms, AT(arms->speed, 2 * n), arms->v, arms->z, arms->there);
            arms->acceleration[0][n] = arms->a1[0];
            arms->acceleration[1][n] = arms->a1[1];
        }
        if (n == steps) {
            return;
        }
        EACH {
            arms->v2 = arms->v + half * arms->a1;
            twist(arms, AT(arms->base, 2 * n + 1) - (arms->angle + half * arms->v));
        }
        fall_springs(together, count);
        fall_hysteresis(together, count);
        EACH {
            arms->a2 = pushed(arms, AT(arms->speed, 2 * n + 1), arms->v2, hysteresis(arms), beside(arms, half * arms->v));
            arms->v3 = arms->v + half * arms->a2;
            twist(arms, AT(arms->base, 2 * n + 1) - (arms->angle + half * arms->v2));
        }
        fall_springs(together, count);
        fall_hysteresis(together, count);
        EACH {
            arms->a3 = pushed(arms, AT(arms->speed, 2 * n + 1), arms->v3, hysteresis(arms), beside(arms, half * arms->v2));
            twist(arms, AT(arms->base, 2 * n + 2) - (arms->angle + step_s * arms->v3));
        }
        fall_springs(together, count);
        fall_hysteresis(together, count);
        EACH {
            const pair v4 = arms->v + step_s * arms->a3;
            const pair a4 = pushed(arms, AT(arms->speed, 2 * n + 2), v4, hysteresis(arms), beside(arms, step_s * arms->v3));
            arms->angle += step_s / 6.0 * (arms->v + 2.0 * arms->v2 + 2.0 * arms->v3 + v4);
            arms->v += step_s / 6.0 * (arms->a1 + 2.0 * arms->a2 + 2.0 * arms->a3 + a4);
            twist(arms, AT(arms->base, 2 * n + 2) - arms->angle);
        }
        fall_hysteresis(together, count);
        EACH {
            arms->z = hysteresis(arms);
            arms->began = arms->torsion;
        }
    }
}

void gear_follow(
    const struct gear_law *laws, integer count, const real *base, const real *speed, integer apart, integer steps, real step_s,
    real *acceleration)
{
    struct arms together[TOGETHER];
    integer pairs = 0;
    for (integer i = 0; i < count; i += 2) {
        struct arms *arms = &together[pairs++];
        const struct gear_law *both[2];
        for (integer j = 0; j < 2; j++) {
            const integer which = i + j < count ? i + j : i; /* the last of an odd number goes beside itself */
            both[j] = &laws[which];
            arms->base[j] = base + which * apart;
            arms->speed[j] = speed + which * apart;
            arms->acceleration[j] = acceleration + which * (steps + 1);
        }
        begin(arms, both);
        if (pairs == TOGETHER || i + 2 >= count) {
            follow_some(together, pairs, steps, step_s);
            pairs = 0;
        }
    }
}
