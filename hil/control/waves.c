#include "waves.h"

#include <string.h>

void begin_waves(const struct harmonic *harmonics, integer count, struct waves *near)
{
    near->spacing = 1.0;
    near->angle = (real)INFINITY;
    for (integer i = 0; i < count; i++) {
        while (near->spacing * harmonics[i].order > 0.5) {
            near->spacing *= 0.5;
        }
    }
}

void develop_waves(const struct harmonic *harmonics, integer count, real angle, struct waves *near)
{
    pair terms[WAVE_TERMS] = {{0.0, 0.0}};
    near->angle = nearest_whole(angle / near->spacing) * near->spacing;
    for (integer i = 0; i < count; i++) {
        const struct harmonic *h = &harmonics[i];
        if (h->cosine == 0.0 && h->sine == 0.0) {
            continue;
        }
        const real re = COS(h->order * near->angle), im = SIN(h->order * near->angle);
        const pair turn = {1.0, -h->order * h->order}; /* of the derivatives of sum and slope, by n! */
        pair term = {h->cosine * re - h->sine * im, -h->order * (h->cosine * im + h->sine * re)};
        for (int n = 0; n < WAVE_TERMS; n++) {
            terms[n] += term;
            term = (pair){term[1], term[0]} * (turn * (1.0 / (real)(n + 1)));
        }
    }
    memcpy(near->terms, terms, sizeof near->terms);
}

void wave_sums(const struct harmonic *harmonics, integer count, real angle, struct waves *near, real sums[2])
{
    const pair found = sum_waves(harmonics, count, angle, 1.0, near);
    sums[0] = found[0];
    sums[1] = found[1];
}
