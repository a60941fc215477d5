/* Friction of a motor. */
#pragma once

#include "lanes.h"

/* The speed over which the regularised friction turns round. */
#define FRICTION_WIDTH_RAD_S 0.05

/* tanh x is 1 - 2 exp(-2x) ...: from here on the difference to 1 is 8.5e-18, which no double shows. */
#define TANH_SATURATED 20.0

/* exp(-x) is 4.2e-18 here: a Stribeck part smaller than that of the static friction is left out. */
#define STRIBECK_DECAYED 40.0

/* t_f = (t_C + (t_S - t_C) exp(-(w/w_s)^2)) tanh(w/0.05): Coulomb and Stribeck friction on the motor side, N m.
 *
 * With e = exp(-2|x|), tanh|x| = (1 - e)/(1 + e) to 2e-16; exponentials are worked out only where they are above 1e-17. */
INLINED LANED lanes friction(lanes coulomb_nm, lanes rise_nm, lanes per_stribeck, lanes speed)
{
    lanes level = coulomb_nm;
    const lanes ratio = speed * per_stribeck, square = ratio * ratio;
    if (any(square < STRIBECK_DECAYED)) {
        level += choose(square < STRIBECK_DECAYED, rise_nm * decay(square), EVERY(lanes, 0.0));
    }
    const lanes size = size_of(speed) / FRICTION_WIDTH_RAD_S;
    if (any(size < TANH_SATURATED)) {
        const lanes e = decay(2.0 * size);
        level *= (1.0 - e) / (1.0 + e);
    }
    return signed_as(level, speed);
}
