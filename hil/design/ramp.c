#include "ramp.h"

real wave_sum(const struct harmonic *harmonics, integer count, real angle, real *slope)
{
    const real base = count > 0 && harmonics[0].multiple > 0.0 ? harmonics[0].order / harmonics[0].multiple : 0.0;
    const real once_re = COS(base * angle), once_im = SIN(base * angle);
    real error = 0.0, change = 0.0, re = once_re, im = once_im, there = 1.0;
    for (integer i = 0; i < count; i++) {
        const struct harmonic *h = &harmonics[i];
        if (base > 0.0) {
            for (; there < h->multiple; there += 1.0) {
                const real turned = re * once_re - im * once_im;
                im = re * once_im + im * once_re;
                re = turned;
            }
        } else {
            re = COS(h->order * angle);
            im = SIN(h->order * angle);
        }
        error += h->cosine * re - h->sine * im;
        change -= h->order * (h->cosine * im + h->sine * re);
    }
    *slope = change;
    return error;
}

/* Sum of the products, always in the same order. */
static real product(const real row[7], const real values[7])
{
    real total = 0.0;
    for (int j = 0; j < 7; j++) {
        total += row[j] * values[j];
    }
    return total;
}

void ramp_run(
    const struct ramp_plant *plant, const struct harmonic *harmonics, integer orders, struct law *law, real period_s,
    real friction_nm, real gravity_nm, real *waiting, integer delay, integer every, const real *reference, integer samples,
    real *speed_rps, real *arm_acceleration)
{
    if (samples <= 0) {
        return;
    }
    real v[7] = {reference[0], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    real slope, last = 0.0;
    real sync = wave_sum(harmonics, orders, v[0], &slope);
    v[2] = v[0] / plant->ratio + sync; /* at rest and unloaded the gear is without torsion: eq. (1) */
    servo_start(law, v[0], 0.0, friction_nm + gravity_nm);
    for (integer n = 0; n < samples; n++) {
        const real command = servo_step(law, period_s, (real)INFINITY, reference[n], 0.0, 0.0, v[0]);
        real torque = command, load = friction_nm;
        if (delay > 0) {
            torque = waiting[n % delay];
            waiting[n % delay] = command;
        }
        if (gravity_nm != 0.0) {
            load += gravity_nm * (1.0 + plant->ratio * slope);
        }
        /* the motor's angle one period ahead is known to 1e-6 rad from its speed and last acceleration */
        const real ahead = wave_sum(harmonics, orders, v[0] + period_s * (v[1] + 0.5 * (v[1] - last)), &slope);
        last = v[1];
        v[4] = torque - load;
        v[5] = sync;
        v[6] = ahead - sync;
        if (n % every == 0) {
            speed_rps[n / every] = v[1] / (2.0 * PI);
            arm_acceleration[n / every] = product(plant->arm, v);
        }
        real next[4];
        for (int i = 0; i < 4; i++) {
            next[i] = product(plant->step[i], v);
        }
        for (int i = 0; i < 4; i++) {
            v[i] = next[i];
        }
        sync = ahead;
    }
}
