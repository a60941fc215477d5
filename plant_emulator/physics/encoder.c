#include "encoder.h"

/* A uniform number in (0, 1): SplitMix64 (Steele, Lea, Flood: Fast splittable pseudorandom number generators, 2014). */
static real uniform(uint64_t *state)
{
    *state += 0x9E3779B97F4A7C15u;
    uint64_t z = *state;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    z ^= z >> 31;
    return ((real)(z >> 11) + 0.5) / 9007199254740992.0; /* 2^53 */
}

void draw_noise(struct encoder *e)
{
    if (e->noise_rad > 0.0) { /* Box and Muller's transform of two */
        const real distance = SQRT(-2.0 * log(uniform(&e->draws)));
        e->present_rad = e->noise_rad * distance * COS(2.0 * PI * uniform(&e->draws));
    }
}
