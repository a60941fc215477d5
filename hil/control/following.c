#include "following.h"
#include "notch.h"

/* Samples in which w follows d at least: faster than that, at 8 ms, it swings against the observer. */
#define LEAST_FOLLOW_SAMPLES 12.0
/* Time of rest over which the sensor's noise is measured. */
#define NOISE_S 0.15
/* Time over which the variance is measured. */
#define LOUD_S 0.1
/* Time that an order may want to leave its bounds before it is taken back. */
#define BEYOND_S 0.25
/* Standard errors by which a sample may be wrong and still count. */
#define MOST_SIGMAS 4.0
/* Twice the width of the band over f_al: noise in it is alike for the inverse of that. */
#define BAND_WIDTH 3.0
/* Part of an order against which a jolt is held at least. */
#define LEFT_AT_LEAST 0.1

integer following_room(integer n_axes, integer n_orders)
{
    const integer own = 2 * n_axes, n = own * (1 + n_orders);
    return own * n_orders + own * n + own + n;
}

static integer states_of(const struct following *f)
{
    return 2 * f->n_axes * (1 + f->n_orders);
}

/* Take angles and set-points; returns the speed of the fastest motor. */
static real take_angles(const struct following *f, const real *samples)
{
    const real period = f->config->period_s, blend = lowpass_blend(f->config->speed_lowpass_hz, period);
    const int begins = f->common->started == 0.0;
    real fastest = 0.0;
    for (integer i = 0; i < f->n_axes; i++) {
        struct following_axis *own = &f->axes[i];
        const real angle = samples[i], reference = samples[f->n_axes + i];
        if (begins) {
            own->angle_rad = angle;
            own->reference_rad = reference;
        }
        own->speed_rad_s += blend * ((angle - own->angle_rad) / period - own->speed_rad_s);
        own->slower_rad_s += blend * (own->speed_rad_s - own->slower_rad_s);
        own->turning_rad_s = 2.0 * own->speed_rad_s - own->slower_rad_s;
        const real planned = (reference - own->reference_rad) / period;
        own->planned_rad_s2 = (planned - own->reference_rad_s) / period;
        own->angle_rad = angle;
        own->reference_rad = reference;
        own->reference_rad_s = planned;
        fastest = most(fastest, FABS(own->turning_rad_s));
    }
    return fastest;
}

/* A sample through the band-pass. */
static real pass(const real *band, real *memory, real value)
{
    for (int section = 0; section < BAND_SECTIONS; section++) {
        const real out = band[0] * value + memory[2 * section];
        memory[2 * section] = band[1] * value - band[3] * out + memory[2 * section + 1];
        memory[2 * section + 1] = band[2] * value - band[4] * out;
        value = out;
    }
    return value;
}

/* What each order drives its arm with where d = 1, its two quadratures in the band; written to drive (n_axes, 2 n_orders). */
static void find_drive(const struct following *f, real *drive)
{
    for (integer i = 0; i < f->n_axes; i++) {
        const real speed = f->axes[i].turning_rad_s;
        for (integer m = 0; m < f->n_orders; m++) {
            const integer at = i * f->n_orders + m;
            const struct following_order *order = &f->orders[at];
            drive[2 * at] = drive[2 * at + 1] = 0.0;
            if (order->amplitude_rad == 0.0) {
                continue;
            }
            const real k = order->order, ratio = k * FABS(speed) / f->arms[i].f_al_rad_s;
            real size = 0.0;
            if (0.8 * f->config->low_ratio < ratio && ratio < 1.2 * f->config->high_ratio) {
                size = -order->amplitude_rad * ((k * speed) * (k * speed));
            }
            const real angle = k * (f->axes[i].angle_rad - speed * f->arms[i].delay_s) + order->phase_rad;
            for (int part = 0; part < 2; part++) {
                real *own = f->filters + BAND_MEMORY * (1 + 2 * at + part);
                const real value = pass(f->band, own, size * (part == 0 ? COS(angle) : SIN(angle)));
                const real middle = 0.5 * (value + own[BAND_MEMORY - 1]);
                own[BAND_MEMORY - 1] = value;
                drive[2 * at + part] = part == 0 ? middle : -middle;
            }
        }
    }
}

/* What the motion itself shakes, as its set-points have it: its size is not known well, so it only counts against d. */
static void find_jolt(const struct following *f, const real *samples)
{
    const integer first = 1 + 2 * f->n_axes * f->n_orders;
    real shakes = 0.0, decay = f->arms[0].damping;
    for (integer i = 0; i < f->n_axes; i++) {
        const struct following_arm *a = &f->arms[i];
        struct following_axis *own = &f->axes[i];
        const real value =
            pass(f->band, f->filters + BAND_MEMORY * (first + i), own->planned_rad_s2 / a->reduction_ratio);
        const real x = own->shaken, v = own->shaking;
        own->shaken = a->a11 * x + a->a12 * v + a->b1 * value;
        own->shaking = a->a21 * x + a->a22 * v + a->b2 * value;
        shakes += samples[2 * f->n_axes + i] * (a->spring * own->shaken + a->dashpot * own->shaking);
        decay = least(decay, a->damping);
    }
    f->common->jolted =
        most(shakes * shakes, f->common->jolted * (1.0 - least(1.0, decay * f->config->period_s)));
}

/* States of the arms one sample on, from those before and from the orders; and what is known of them. */
static void predict(const struct following *f, const real *drive, real *moved, real *fresh)
{
    const integer n = states_of(f), own = 2 * f->n_axes, width = 2 * f->n_orders;
    real *states = f->states, *covariance = f->covariance;
    for (integer row = 0; row < own; row++) {
        const integer i = row / 2, first = own + i * width;
        const struct following_arm *a = &f->arms[i];
        const real p = row % 2 == 0 ? a->a11 : a->a21, q = row % 2 == 0 ? a->a12 : a->a22;
        const real b = row % 2 == 0 ? a->b1 : a->b2;
        const real *position = covariance + n * (2 * i), *speed = covariance + n * (2 * i + 1);
        fresh[row] = p * states[2 * i] + q * states[2 * i + 1];
        for (integer column = 0; column < n; column++) {
            moved[row * n + column] = p * position[column] + q * speed[column];
        }
        for (integer m = 0; m < width; m++) {
            const real gain = b * drive[i * width + m];
            const real *of = covariance + n * (first + m);
            fresh[row] += gain * states[first + m];
            for (integer column = 0; column < n; column++) {
                moved[row * n + column] += gain * of[column];
            }
        }
    }
    for (integer row = 0; row < own; row++) {
        states[row] = fresh[row];
        for (integer column = own; column < n; column++) {
            covariance[row * n + column] = covariance[column * n + row] = moved[row * n + column];
        }
    }
    for (integer column = 0; column < own; column++) {
        const integer i = column / 2, first = own + i * width;
        const struct following_arm *a = &f->arms[i];
        const real p = column % 2 == 0 ? a->a11 : a->a21, q = column % 2 == 0 ? a->a12 : a->a22;
        const real b = column % 2 == 0 ? a->b1 : a->b2;
        for (integer row = 0; row < own; row++) {
            real total = p * moved[row * n + 2 * i] + q * moved[row * n + 2 * i + 1];
            for (integer m = 0; m < width; m++) {
                total += b * drive[i * width + m] * moved[row * n + first + m];
            }
            covariance[row * n + column] = total;
        }
    }
}

/* Let each d walk where it shows: faster where something has just changed, since little is known of it then. */
static void walk_all(const struct following *f)
{
    const struct following_config *c = f->config;
    const integer n = states_of(f);
    for (integer i = 0; i < f->n_axes; i++) {
        for (integer m = 0; m < f->n_orders; m++) {
            const struct following_order *order = &f->orders[i * f->n_orders + m];
            const struct following_order_state *order_state = &f->order_states[i * f->n_orders + m];
            const real ratio = order->order * FABS(f->axes[i].turning_rad_s) / f->arms[i].f_al_rad_s;
            if (order->amplitude_rad == 0.0 || !(c->low_ratio < ratio && ratio < c->high_ratio)) {
                continue;
            }
            real walk = c->walk_per_root_s;
            if (order_state->open > 0.0) {
                walk *= c->steady + c->quick * EXP(-order_state->since_s / c->quick_s);
            }
            for (integer part = 0; part < 2; part++) {
                const integer at = 2 * (f->n_axes + i * f->n_orders + m) + part;
                real *variance = &f->covariance[at * n + at];
                *variance = least(*variance + walk * walk * c->period_s, c->most_error * c->most_error);
            }
        }
    }
}

/* The sensor's noise, at the quietest moment of rest: what rings there from a motion before is no noise. */
static void measure_rest(const struct following *f, real tip)
{
    struct following_common *common = f->common;
    const real period = f->config->period_s;
    common->count += 1.0;
    common->resting += (tip * tip - common->resting) * most(1.0 / common->count, period / NOISE_S);
    if (common->count * period > NOISE_S && (common->quiet == 0.0 || common->resting < common->quiet)) {
        common->quiet = common->resting;
    }
    common->loud = common->quiet;
}

/* Take the tip's acceleration: the Kalman filter's correction. */
static void correct(const struct following *f, const real *samples, real tip, real quiet, real alike_s, real *seen)
{
    const struct following_config *c = f->config;
    const integer n = states_of(f);
    const real *lever = samples + 2 * f->n_axes, period = c->period_s;
    f->common->loud += (tip * tip - f->common->loud) * least(1.0, period / LOUD_S);
    const real own = f->common->jolted + c->model_error * c->model_error * most(f->common->loud - quiet, 0.0);
    const real noise = quiet * most(1.0, alike_s / period) + own * most(1.0, c->correlated_s / period);
    real guess = 0.0, spread = noise;
    for (integer row = 0; row < n; row++) {
        seen[row] = 0.0;
    }
    for (integer i = 0; i < f->n_axes; i++) {
        const real spring = lever[i] * f->arms[i].spring, dashpot = lever[i] * f->arms[i].dashpot;
        guess += spring * f->states[2 * i] + dashpot * f->states[2 * i + 1];
        for (integer row = 0; row < n; row++) {
            seen[row] += spring * f->covariance[row * n + 2 * i] + dashpot * f->covariance[row * n + 2 * i + 1];
        }
    }
    for (integer i = 0; i < f->n_axes; i++) {
        spread += lever[i] * (f->arms[i].spring * seen[2 * i] + f->arms[i].dashpot * seen[2 * i + 1]);
    }
    const real limit = MOST_SIGMAS * SQRT(spread);
    const real wrong = least(most(tip - guess, -limit), limit);
    for (integer row = 0; row < n; row++) {
        f->states[row] += seen[row] * wrong / spread;
        for (integer column = 0; column < n; column++) {
            f->covariance[row * n + column] -= seen[row] * seen[column] / spread;
        }
    }
}

/* True if w follows: d is told from nothing, and is more than a tip may shake, in the window, with no jolt beside it.
 *
 * left is |d|, known its standard error by the observer, spectrum the root of the noise's spectral density. */
static int opens(
    const struct following *f, const struct following_arm *arm, const struct following_order *order,
    struct following_order_state *order_state, real speed, real lever_m, real left, real known, real spectrum)
{
    const struct following_config *c = f->config;
    const real omega = order->order * speed;
    const real re = arm->stiff - omega * omega, im = arm->damping * omega;
    const real spring = arm->spring, dashpot = arm->dashpot * omega;
    const real gain = SQRT((spring * spring + dashpot * dashpot) / (re * re + im * im));
    const real reach = order->amplitude_rad * FABS(lever_m) * gain;
    const real felt = most(reach * omega * omega, 1e-9);
    /* of d beside the sensor's noise alone: what a wrong model explains wrongly does not make something of nothing */
    const real sigma = SQRT(c->walk_per_root_s * spectrum / felt);
    const real ratio = omega / arm->f_al_rad_s;
    int inside = c->low_ratio < ratio && ratio < c->high_ratio && speed > c->slowest_rad_s;
    const real jolts = SQRT(f->common->jolted) / (c->jolt_part * most(left, LEFT_AT_LEAST) * felt);
    const real told = c->begin_sigmas * most(sigma, known);
    if (inside && jolts < BEGIN_MARGIN && BEGIN_MARGIN * left > told && BEGIN_MARGIN * left * reach > c->begin_m) {
        order_state->nearest = most(order_state->nearest, left);
    }
    inside = inside && jolts < 1.0;
    const int is_much = left > most(most(c->begin_part, order->begin_part), told) && left * reach > c->begin_m;
    if (inside && is_much) {
        order_state->open = 1.0;
    }
    const int is_little =
        left < most(c->end_sigmas * sigma, order->begin_part / BEGIN_MARGIN) || left * reach < c->end_m;
    order_state->small_s = is_little ? order_state->small_s + c->period_s : 0.0;
    if (!inside || order_state->small_s > c->end_s) {
        order_state->open = 0.0;
    }
    order_state->since_s = order_state->open > 0.0 ? order_state->since_s + c->period_s : 0.0;
    return order_state->open > 0.0;
}

/* Move w towards w + d within its bounds; an order that wants to leave them, or wanders, is taken back for good.
 *
 * factor is Re and Im of w; left is Re and Im of d, which becomes less by what w becomes more. */
static void move_factor(const struct following_config *c, struct following_order_state *order_state, real *factor, real *left)
{
    const real part = least(c->period_s / c->follow_s, 1.0 / LEAST_FOLLOW_SAMPLES);
    real re = factor[0] + part * left[0], im = factor[1] + part * left[1];
    const real gain = SQRT(re * re + im * im), angle = ATAN2(im, re);
    const real kept = least(most(gain, c->least_gain), c->most_gain);
    const real kept_angle = least(most(angle, -c->most_angle_rad), c->most_angle_rad);
    if (kept != gain || kept_angle != angle) {
        order_state->beyond_s += c->period_s;
        re = kept * COS(kept_angle);
        im = kept * SIN(kept_angle);
    }
    const real by_re = re - factor[0], by_im = im - factor[1];
    order_state->wandered += SQRT(by_re * by_re + by_im * by_im);
    if (order_state->beyond_s > BEYOND_S || order_state->wandered > c->wander) {
        order_state->open = 0.0;
        order_state->given_up = 1.0;
    }
    left[0] -= re - factor[0];
    left[1] -= im - factor[1];
    factor[0] = re;
    factor[1] = im;
}

/* Move the factors of all orders; those that were taken back go to 1. */
static void move_factors(const struct following *f, const real *samples, int has_heard, real spectrum)
{
    const struct following_config *c = f->config;
    const integer n = states_of(f);
    for (integer i = 0; i < f->n_axes; i++) {
        const real speed = FABS(f->axes[i].turning_rad_s), lever = samples[2 * f->n_axes + i];
        for (integer m = 0; m < f->n_orders; m++) {
            const integer row = i * f->n_orders + m, at = 2 * (f->n_axes + row);
            const struct following_order *order = &f->orders[row];
            struct following_order_state *own = &f->order_states[row];
            real *factor = f->factors + 2 * row;
            if (order->amplitude_rad == 0.0) {
                continue;
            }
            own->wandered = most(0.0, own->wandered - c->wander_per_s * c->period_s);
            if (own->given_up > 0.0) {
                const real part = least(1.0, c->period_s / (4.0 * c->follow_s));
                factor[0] -= part * (factor[0] - 1.0);
                factor[1] -= part * factor[1];
                continue;
            }
            const real re = f->states[at], im = f->states[at + 1];
            const real left = SQRT(re * re + im * im);
            const real *variance = f->covariance + at * n + at;
            const real known = SQRT(most(most(variance[0], variance[n + 1]), 0.0));
            if (has_heard && opens(f, &f->arms[i], order, own, speed, lever, left, known, spectrum)) {
                move_factor(c, own, factor, f->states + at);
            }
        }
    }
}

void follow_step(const struct following *f, const real *samples, const real heard[2])
{
    const struct following_config *c = f->config;
    const integer n = states_of(f), own = 2 * f->n_axes;
    real *drive = f->room, *moved = drive + own * f->n_orders, *fresh = moved + own * n, *seen = fresh + own;
    const real fastest = take_angles(f, samples);
    if (f->common->started == 0.0) { /* gravity is there from the start */
        f->filters[0] = (f->band[1] + f->band[2]) * heard[0];
        f->filters[1] = f->band[2] * heard[0];
        f->common->started = 1.0;
    }
    const real tip = pass(f->band, f->filters, heard[0]);
    find_drive(f, drive);
    find_jolt(f, samples);
    predict(f, drive, moved, fresh);
    walk_all(f);
    real lowest = f->arms[0].f_al_rad_s;
    for (integer i = 0; i < f->n_axes; i++) {
        lowest = least(lowest, f->arms[i].f_al_rad_s);
    }
    const real alike_s = 2.0 * PI / (BAND_WIDTH * lowest);
    const int has_heard = heard[1] > 0.0;
    if (has_heard && fastest < c->slowest_rad_s) {
        measure_rest(f, tip);
    }
    const real quiet = most(f->common->quiet, c->least_noise_m_s2 * c->least_noise_m_s2);
    if (has_heard && fastest >= c->slowest_rad_s) {
        correct(f, samples, tip, quiet, alike_s, seen);
    }
    const real spectrum = SQRT(2.0 * quiet * most(c->period_s, alike_s));
    move_factors(f, samples, has_heard, spectrum);
}
