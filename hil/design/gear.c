#include "gear.h"

/* Steps to the torsion that carries gravity at rest: each leaves at most r of the error, 1e-20 of it at r = 0.3 in the end. */
enum { RESTING_STEPS = 40 };

/* Where a step began: torsion and hysteresis. */
struct turn {
    real torsion;
    real z;
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

static real spring(const struct gear_law *law, real torsion)
{
    real stiffness = law->stiffness;
    if (law->softness != 0.0) {
        const real ratio = torsion * law->per_wind_up;
        stiffness *= 1.0 - law->softness * EXP(-ratio * ratio);
    }
    return stiffness * torsion;
}

/* Gravity at an angle, and its rate of change by the angle. */
struct weight {
    real there;
    real slope;
};

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

static real pushed(
    const struct gear_law *law, const struct turn *from, const struct weight *weight, real base, real base_speed, real angle,
    real moved, real speed)
{
    const real torsion = base - (angle + moved);
    return spring(law, torsion) + hysteresis(law, from, torsion) + law->gear_damping * (base_speed - speed) -
           law->arm_damping * speed - beside(weight, moved);
}

void gear_follow(
    const struct gear_law *law, const real *base, const real *speed, integer steps, real step_s, real *acceleration)
{
    real angle = base[0], v = speed[0];
    const real z = law->wound * law->hysteresis;
    for (int i = 0; i < RESTING_STEPS; i++) {
        angle += (spring(law, base[0] - angle) + z - gravity(law, angle).there) / law->stiffness;
    }
    angle += law->ahead;
    v += law->ahead_speed;
    struct turn from = {base[0] - angle, z};
    const real half = 0.5 * step_s;
    for (integer n = 0; n < steps; n++) {
        const real *b = base + 2 * n, *w = speed + 2 * n;
        const struct weight weight = gravity(law, angle);
        const real a1 = pushed(law, &from, &weight, b[0], w[0], angle, 0.0, v);
        const real v2 = v + half * a1;
        const real a2 = pushed(law, &from, &weight, b[1], w[1], angle, half * v, v2);
        const real v3 = v + half * a2;
        const real a3 = pushed(law, &from, &weight, b[1], w[1], angle, half * v2, v3);
        const real v4 = v + step_s * a3;
        const real a4 = pushed(law, &from, &weight, b[2], w[2], angle, step_s * v3, v4);
        acceleration[n] = a1;
        angle += step_s / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4);
        v += step_s / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4);
        const struct turn next = {b[2] - angle, hysteresis(law, &from, b[2] - angle)};
        from = next;
    }
    const struct weight weight = gravity(law, angle);
    acceleration[steps] = pushed(law, &from, &weight, base[2 * steps], speed[2 * steps], angle, 0.0, v);
}
