/* Sums of waves A cos(k theta + phi) that are needed again and again while the angle moves on little by little.
 *
 * Taylor's polynomials of the sum and of its slope are developed around grid angles, which lie evenly apart: by no more than
 * 1/(2 k) at the highest order k. Powers go to the twelfth, so that less than A (1/2)^13/13! = 2.0e-14 A is left out of the sum,
 * and k times as much of the slope.
 */
#ifndef HIL_WAVES_H
#define HIL_WAVES_H

#include "real.h"

/* One wave. */
struct harmonic {
    real order;  /* k */
    real cosine; /* A cos phi */
    real sine;   /* A sin phi */
};

enum { WAVE_TERMS = 13 };

/* A sum of waves near a grid angle. */
struct waves {
    real spacing; /* of the grid: a power of 2, so that the distance from a grid angle has no error */
    real angle;
    real terms[WAVE_TERMS][2]; /* what the powers of the distance count in the sum and in its slope */
};

/* Begin with waves that are developed nowhere. */
void begin_waves(const struct harmonic *harmonics, integer count, struct waves *near);

/* Develop around the grid angle nearest to an angle. */
void develop_waves(const struct harmonic *harmonics, integer count, real angle, struct waves *near);

/* sums becomes what sum_waves gives within the whole spacing. */
void wave_sums(const struct harmonic *harmonics, integer count, real angle, struct waves *near, real sums[2]);

/* Two numbers with which a processor calculates at once; each rounds as it would alone. */
#ifdef __GNUC__
typedef real pair __attribute__((vector_size(2 * sizeof(real))));
#endif

INLINED pair pair_at(const real *numbers)
{
    return (pair){numbers[0], numbers[1]};
}

/* What the even powers of a distance count, and the odd ones by the distance, in terms t; q is its square and r that of q. */
#define EVEN_POWERS(t, q, r) (((t(0) + q * t(2)) + r * (t(4) + q * t(6))) + r * r * ((t(8) + q * t(10)) + r * t(12)))
#define ODD_POWERS(t, q, r) (((t(1) + q * t(3)) + r * (t(5) + q * t(7))) + r * r * (t(9) + q * t(11)))

/* Sum and slope at an angle; developed anew where the grid angle is not nearer than part, 1/2 or 1, of the spacing. */
INLINED pair sum_waves(const struct harmonic *harmonics, integer count, real angle, real part, struct waves *near)
{
    if (!(FABS(angle - near->angle) < part * near->spacing)) { /* NaN too */
        develop_waves(harmonics, count, angle, near);
    }
    const real d = angle - near->angle, q = d * d, r = q * q;
#define TERM(n) pair_at(near->terms[n])
    return EVEN_POWERS(TERM, q, r) + d * ODD_POWERS(TERM, q, r);
#undef TERM
}

#endif
