#include "margins.h"

static struct complex_real times(struct complex_real a, struct complex_real b)
{
    return (struct complex_real){a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}

/* Smith's division, which neither overflows nor loses digits where a plain one would. */
static struct complex_real over(struct complex_real a, struct complex_real b)
{
    if (FABS(b.re) >= FABS(b.im)) {
        const real ratio = b.im / b.re, divisor = b.re + b.im * ratio;
        return (struct complex_real){(a.re + a.im * ratio) / divisor, (a.im - a.re * ratio) / divisor};
    }
    const real ratio = b.re / b.im, divisor = b.re * ratio + b.im;
    return (struct complex_real){(a.re * ratio + a.im) / divisor, (a.im * ratio - a.re) / divisor};
}

/* Response c0 + z (c1 + z c2) of one side of a filter. */
static struct complex_real polynomial(real c0, real c1, real c2, struct complex_real z)
{
    const struct complex_real inner = {c1 + z.re * c2, z.im * c2};
    struct complex_real value = times(z, inner);
    value.re += c0;
    return value;
}

/* The four margins of one open loop. */
static void scan_loop(
    const struct complex_real *bare, const struct complex_real *response, integer count, real margins[MARGIN_COLUMNS])
{
    real nearest = (real)INFINITY, gain_db = (real)INFINITY, phase = PI, last_power = 0.0, last_side = 0.0, turned = 0.0;
    struct complex_real last = {0.0, 0.0};
    for (integer f = 0; f < count; f++) {
        const struct complex_real here = times(bare[f], response[f]);
        const real x = 1.0 + here.re, y = here.im;
        const real power = here.re * here.re + y * y;
        nearest = least(nearest, x * x + y * y);
        /* (1 + L) over 1 + L without filters, but for a positive factor; it turns where it crosses the negative real axis */
        const real u = 1.0 + bare[f].re, w = bare[f].im;
        const real side = y * u - x * w;
        if (side * last_side < 0.0 && x * u + y * w < 0.0) {
            turned += side < 0.0 ? 1.0 : -1.0;
        }
        if (side != 0.0) {
            last_side = side;
        }
        if (f > 0) {
            if ((power - 1.0) * (last_power - 1.0) <= 0.0 && power != last_power) {
                const real fraction = (1.0 - last_power) / (power - last_power);
                const real re = last.re + fraction * (here.re - last.re), im = last.im + fraction * (here.im - last.im);
                phase = least(phase, FABS(ATAN2(-im, -re)));
            }
            if (here.im * last.im < 0.0) {
                const real fraction = last.im / (last.im - here.im);
                const real re = last.re + fraction * (here.re - last.re);
                if (re < 0.0) {
                    gain_db = least(gain_db, FABS(20.0 * IN_REAL(log10)(-re)));
                }
            }
        }
        last = here;
        last_power = power;
    }
    margins[MARGIN_SENSITIVITY] = 1.0 / SQRT(nearest);
    margins[MARGIN_GAIN] = gain_db;
    margins[MARGIN_PHASE] = phase * (180.0 / PI);
    margins[MARGIN_TURNS] = turned;
}

void scan_margins(
    const struct complex_real *delay, const struct complex_real *bare, integer count, integer plants,
    const real *coefficients, integer speeds, integer filters, struct complex_real *response, real *margins)
{
    for (integer s = 0; s < speeds; s++) {
        for (integer f = 0; f < count; f++) {
            response[f] = (struct complex_real){1.0, 0.0};
            for (integer i = 0; i < filters; i++) {
                const real *c = coefficients + 5 * (s * filters + i);
                const struct complex_real above = polynomial(c[0], c[1], c[2], delay[f]);
                const struct complex_real below = polynomial(1.0, c[3], c[4], delay[f]);
                response[f] = times(response[f], over(above, below));
            }
        }
        for (integer p = 0; p < plants; p++) {
            scan_loop(bare + p * count, response, count, margins + MARGIN_COLUMNS * (p * speeds + s));
        }
    }
}
