/* Friction of a motor, and the exponential that it is made of. */
#ifndef PLANT_FRICTION_H
#define PLANT_FRICTION_H

#include "lanes.h"

/* The speed over which the regularised friction turns round. */
#define FRICTION_WIDTH_RAD_S 0.05

/* tanh x is 1 - 2 exp(-2x) ...: from here on the difference to 1 is 8.5e-18, which no double shows. */
#define TANH_SATURATED 20.0

/* exp(-x) is 4.2e-18 here: a Stribeck part smaller than that of the static friction is left out. */
#define STRIBECK_DECAYED 40.0

/* exp(-x) is a normal number up to here, and taken for constant beyond. */
#define LEAST_DECAY 700.0

/* exp(-x) for x of 0 and above, at most 1.01 units in the last place away: 2^n exp(r), |r| <= (ln 2)/2, without a branch.
 *
 * The polynomial takes up exp to 6e-18; ln 2 is subtracted in two parts, the first of 33 digits. Its rounding is the same wherever
 * it runs, unlike that of a library. */
INLINED LANED lanes decay(lanes x)
{
    const lanes bounded = choose(x < LEAST_DECAY, x, EVERY(lanes, LEAST_DECAY));
    const lanes whole = (1.5 * WHOLE) - bounded * 1.4426950408889634; /* its last bits count n */
    const lanes n = whole - (1.5 * WHOLE);
    const lanes r = (-bounded - n * 0.6931471803691238) - n * 1.9082149292705877e-10;
    const lanes q = r * r;
    const lanes low = (0.5 + r * 0.16666666666666666) + q * (0.04166666666661244 + r * 0.008333333333391639);
    const lanes high = (0.0013888888923730392 + r * 0.0001984126964391054) + q * (2.480151220478228e-05 + r * 2.755751751329383e-06);
    const lanes top = 2.7623886663851975e-07 + r * 2.5009223989551466e-08;
    return scaled(1.0 + (r + q * (low + q * q * (high + q * q * top))), whole);
}

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
    const lanes twice = size_of(speed) * (2.0 / FRICTION_WIDTH_RAD_S);
    if (any(twice < 2.0 * TANH_SATURATED)) {
        const lanes e = decay(twice);
        level *= (1.0 - e) / (1.0 + e);
    }
    return signed_as(level, speed);
}

#endif
