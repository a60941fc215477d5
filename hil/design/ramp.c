#include "ramp.h"

void ramp_run(
    const struct ramp_plant *plant, const struct harmonic *harmonics, integer orders, struct law *law, real period_s,
    real friction_nm, real gravity_nm, real *waiting, integer delay, integer every, const real *reference, integer samples,
    real *speed_rps, real *arm_acceleration)
{
    if (samples <= 0) {
        return;
    }
    real v[7] = {reference[0], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    struct waves near;
    begin_waves(harmonics, orders, &near);
    real error[2], last = 0.0; /* theta_sync, and its slope */
    wave_sums(harmonics, orders, v[0], &near, error);
    real sync = error[0];
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
            load += gravity_nm * (1.0 + plant->ratio * error[1]);
        }
        /* the motor's angle one period ahead is known to 1e-6 rad from its speed and last acceleration */
        wave_sums(harmonics, orders, v[0] + period_s * (v[1] + 0.5 * (v[1] - last)), &near, error);
        last = v[1];
        v[4] = torque - load;
        v[5] = sync;
        v[6] = error[0] - sync;
        if (n % every == 0) {
            speed_rps[n / every] = v[1] / (2.0 * PI);
            real total = 0.0;
            for (int j = 0; j < 7; j++) {
                total += plant->arm[j] * v[j];
            }
            arm_acceleration[n / every] = total;
        }
        pair motor = {0.0, 0.0}, arm = {0.0, 0.0};
        for (int j = 0; j < 7; j++) {
            motor += pair_at(plant->step[j]) * v[j];
            arm += pair_at(plant->step[j] + 2) * v[j];
        }
        v[0] = motor[0];
        v[1] = motor[1];
        v[2] = arm[0];
        v[3] = arm[1];
        sync = error[0];
    }
}
