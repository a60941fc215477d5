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

/* Sum and slope at an angle; developed anew where the grid angle is not nearer than part, 1/2 or 1, of the spacing. */
INLINED pair sum_waves(const struct harmonic *harmonics, integer count, real angle, real part, struct waves *near)
{
    if (!(FABS(angle - near->angle) < part * near->spacing)) { /* NaN too */
        develop_waves(harmonics, count, angle, near);
    }
    const real d = angle - near->angle, q = d * d, q2 = q * q, q4 = q2 * q2;
    real(*c)[2] = near->terms;
    const pair even = ((pair_at(c[0]) + q * pair_at(c[2])) + q2 * (pair_at(c[4]) + q * pair_at(c[6]))) +
                      q4 * ((pair_at(c[8]) + q * pair_at(c[10])) + q2 * pair_at(c[12]));
    const pair odd = ((pair_at(c[1]) + q * pair_at(c[3])) + q2 * (pair_at(c[5]) + q * pair_at(c[7]))) +
                     q4 * (pair_at(c[9]) + q * pair_at(c[11]));
    return even + d * odd;
}

#endif
