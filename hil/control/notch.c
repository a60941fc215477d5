#include "notch.h"

void notch_coefficients(real zero_hz, real pole_hz, real zeta_rn, real zeta_rd, real period_s, real coefficients[5])
{
    const real c = 2.0 / period_s;
    const real wn = 2.0 * PI * zero_hz;
    const real wd = 2.0 * PI * pole_hz;
    const real gain = wd * wd / (wn * wn);
    const real n0 = gain * wn * wn, n1 = gain * 2.0 * zeta_rn * wn * c, n2 = gain * c * c;
    const real d0 = wd * wd, d1 = 2.0 * zeta_rd * wd * c, d2 = c * c;
    const real a0 = d2 + d1 + d0;
    coefficients[0] = (n2 + n1 + n0) / a0;
    coefficients[1] = 2.0 * (n0 - n2) / a0;
    coefficients[2] = (n2 - n1 + n0) / a0;
    coefficients[3] = 2.0 * (d0 - d2) / a0;
    coefficients[4] = (d2 - d1 + d0) / a0;
}

real notch_weight(integer mode, real speed_rps, real start_rps, real end_rps, real ramp_rps)
{
    if (mode != NOTCH_TRAPEZOID) {
        return 1.0;
    }
    const real rise = (speed_rps - start_rps) / ramp_rps;
    const real fall = (end_rps - speed_rps) / ramp_rps;
    return most(0.0, least(least(1.0, rise), fall));
}

real lowpass_blend(real corner_hz, real period_s)
{
    const real w = PI * corner_hz * period_s;
    return least(1.0, 2.0 * w / (1.0 + w));
}

/* One sample of a fixed filter; it starts as if the low-passed torque u' had been its input for ever, y' = G(1) u'. */
static real fixed_step(const struct notch_config *c, struct notch_state *s, real u)
{
    if (s->active == 0) {
        const real rest = (c->b0 + c->b1 + c->b2) / (1.0 + c->a1 + c->a2) * s->mean_nm;
        s->s2 = c->b2 * s->mean_nm - c->a2 * rest;
        s->s1 = c->b1 * s->mean_nm - c->a1 * rest + s->s2;
        s->active = 1;
    }
    const real y = c->b0 * u + s->s1;
    s->s1 = c->b1 * u - c->a1 * y + s->s2;
    s->s2 = c->b2 * u - c->a2 * y;
    return y;
}

real notch_step(const struct notch_config *config, struct notch_state *state, real period_s, real speed_rad_s, real u)
{
    const struct notch_config *c = config;
    struct notch_state *s = state;
    s->mean_nm += lowpass_blend(START_LOWPASS_HZ, period_s) * (u - s->mean_nm);
    if (c->mode == NOTCH_FIXED) {
        return fixed_step(c, s, u);
    }
    s->speed_rps += lowpass_blend(c->speed_lowpass_hz, period_s) * (FABS(speed_rad_s) / (2.0 * PI) - s->speed_rps);
    const real f_m = s->speed_rps;
    const int was_active = s->active != 0;
    const real margin = was_active ? c->hysteresis_rps : 0.0;
    if (c->mode == NOTCH_OFF || !(c->start_rps - margin <= f_m && f_m <= c->end_rps + margin)) {
        s->active = 0;
        return u;
    }
    const real weight = notch_weight(c->mode, f_m, c->start_rps, c->end_rps, c->ramp_rps);
    const real zero_hz = c->order * f_m;
    real b[5];
    s->frequency_hz = zero_hz;
    s->zeta_rd = c->zeta_rn + weight * (c->zeta_rdth - c->zeta_rn);
    notch_coefficients(zero_hz, zero_hz + weight * c->offset_hz, c->zeta_rn, s->zeta_rd, period_s, b);
    const real b0 = b[0], b1 = b[1], b2 = b[2], a1 = b[3], a2 = b[4];
    if (!was_active) {
        s->s2 = (b2 - a2) * s->mean_nm;
        s->s1 = (b1 - a1) * s->mean_nm + s->s2;
        s->active = 1;
    }
    const real y = b0 * u + s->s1;
    s->s1 = b1 * u - a1 * y + s->s2;
    s->s2 = b2 * u - a2 * y;
    return y;
}
