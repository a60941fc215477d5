#include "ramp.h"

#include <string.h>

/* Ramps that go on side by side: each step of one waits for the step before, and meanwhile the processor works on the others. */
enum { TOGETHER = 8 };
/* Grid angles at which the waves of an error stay developed: axes along the same motion come to them at nearly the same time. */
enum { KEPT = 16 };

struct passing {
    real v[7];
    real error[2]; /* theta_sync, and its slope */
    real sync, last;
    struct waves *kept, *near; /* the waves, and those at the grid angle */
    real grid_angle;
};

/* theta_sync and its slope at an angle, as wave_sums gives them. */
static void find_error(const struct harmonic *harmonics, integer orders, real angle, struct passing *passing)
{
    struct passing *p = passing;
    const real spacing = p->kept->spacing;
    if (!(FABS(angle - p->grid_angle) < spacing)) {
        const real place = nearest_whole(angle / spacing);
        p->grid_angle = place * spacing;
        p->near = &p->kept[FABS(place) < WHOLE ? (integer)place & (KEPT - 1) : 0];
    }
    if (p->near->angle != p->grid_angle) {
        develop_waves(harmonics, orders, p->grid_angle, p->near);
    }
    const pair found = sum_waves(harmonics, orders, angle, 1.0, p->near);
    p->error[0] = found[0];
    p->error[1] = found[1];
}

static void begin(
    const struct ramp_plant *plant, const struct harmonic *harmonics, integer orders, struct law *law, real torque_nm, real angle,
    struct passing *passing)
{
    struct passing *p = passing;
    find_error(harmonics, orders, angle, p);
    p->sync = p->error[0];
    p->v[0] = angle;
    p->v[2] = angle / plant->ratio + p->sync; /* at rest and unloaded the gear is without torsion: eq. (1) */
    servo_start(law, angle, 0.0, torque_nm);
}

/* The plant one period on. */
static void move(const struct ramp_plant *plant, struct passing *passing)
{
    real *v = passing->v;
    pair motor = {0.0, 0.0}, arm = {0.0, 0.0};
    for (int j = 0; j < 7; j++) {
        motor += pair_at(plant->step[j]) * v[j];
        arm += pair_at(plant->step[j] + 2) * v[j];
    }
    v[0] = motor[0];
    v[1] = motor[1];
    v[2] = arm[0];
    v[3] = arm[1];
    passing->sync = passing->error[0];
}

static void run_some(
    const struct ramp_plant *plants, const struct harmonic *harmonics, integer orders, struct law *laws, integer count,
    real period_s, real friction_nm, real gravity_nm, real *waiting, integer delay, integer every, const real *reference,
    integer samples, real *speed_rps, real *arm_acceleration)
{
    struct passing passing[TOGETHER];
    struct waves kept[TOGETHER][KEPT];
    const integer shown = (samples + every - 1) / every;
    const size_t size = (size_t)orders * sizeof *harmonics;
    for (integer i = 0; i < count; i++) {
        integer alike = 0;
        while (alike < i && memcmp(harmonics + alike * orders, harmonics + i * orders, size) != 0) {
            alike++;
        }
        for (integer place = 0; alike == i && place < KEPT; place++) {
            begin_waves(harmonics + i * orders, orders, &kept[i][place]);
        }
        passing[i] = (struct passing){.grid_angle = (real)INFINITY, .kept = kept[alike]};
        begin(&plants[i], harmonics + i * orders, orders, &laws[i], friction_nm + gravity_nm, reference[0], &passing[i]);
    }
    for (integer n = 0; n < samples; n++) {
        real torque[TOGETHER];
        for (integer i = 0; i < count; i++) {
            torque[i] = servo_step(&laws[i], period_s, (real)INFINITY, reference[n], 0.0, 0.0, passing[i].v[0]);
            if (delay > 0) {
                real *oldest = &waiting[i * delay + n % delay];
                const real command = torque[i];
                torque[i] = *oldest;
                *oldest = command;
            }
        }
        for (integer i = 0; i < count; i++) {
            struct passing *p = &passing[i];
            real load = friction_nm;
            if (gravity_nm != 0.0) {
                load += gravity_nm * (1.0 + plants[i].ratio * p->error[1]);
            }
            /* the motor's angle one period ahead is known to 1e-6 rad from its speed and last acceleration */
            const real ahead = p->v[0] + period_s * (p->v[1] + 0.5 * (p->v[1] - p->last));
            find_error(harmonics + i * orders, orders, ahead, p);
            p->last = p->v[1];
            p->v[4] = torque[i] - load;
            p->v[5] = p->sync;
            p->v[6] = p->error[0] - p->sync;
        }
        for (integer i = 0; i < count; i++) {
            struct passing *p = &passing[i];
            if (n % every == 0) {
                real total = 0.0;
                for (int j = 0; j < 7; j++) {
                    total += plants[i].arm[j] * p->v[j];
                }
                speed_rps[i * shown + n / every] = p->v[1] / (2.0 * PI);
                arm_acceleration[i * shown + n / every] = total;
            }
            move(&plants[i], p);
        }
    }
}

void ramp_run(
    const struct ramp_plant *plants, const struct harmonic *harmonics, integer orders, struct law *laws, integer count,
    real period_s, real friction_nm, real gravity_nm, real *waiting, integer delay, integer every, const real *reference,
    integer samples, real *speed_rps, real *arm_acceleration)
{
    if (samples <= 0) {
        return;
    }
    const integer shown = (samples + every - 1) / every;
    for (integer i = 0; i < count; i += TOGETHER) {
        run_some(
            plants + i, harmonics + i * orders, orders, laws + i, count - i < TOGETHER ? count - i : TOGETHER, period_s,
            friction_nm, gravity_nm, waiting + i * delay, delay, every, reference, samples, speed_rps + i * shown,
            arm_acceleration + i * shown);
    }
}
