#include "cancellation.h"
#include "notch.h"

/* Torque in the gear as its slow part shows in the motor's torque, in N m at the arm, within what counts. */
static real gear_torque(
    const struct cancellation_config *c, struct cancellation_state *s, real period_s, real torque, real speed, real gained)
{
    if (s->is_running == 0) {
        s->torque_nm = torque;
        s->slower_nm = torque;
    }
    const real blend = lowpass_blend(c->load_lowpass_hz, period_s);
    s->torque_nm += blend * (torque - s->torque_nm);
    s->slower_nm += blend * (s->torque_nm - s->slower_nm);
    const real friction = c->coulomb_friction_nm * least(most(speed / FRICTION_RAD_S, -1.0), 1.0);
    const real own = c->motor_inertia_kg_m2 * gained + c->motor_damping_nm_s_rad * speed + friction;
    return least(most(c->reduction_ratio * (2.0 * s->torque_nm - s->slower_nm - own), -c->most_nm), c->most_nm);
}

/* Column of a table at or below a motor speed; part becomes the fraction of the way to the next. */
static integer speed_column(const struct cancellation_config *c, integer speeds, real speed, real *part)
{
    const real last = (real)speeds - 1.0;
    real column = FABS(speed) / (2.0 * PI * c->step_rps);
    if (!(column < last)) { /* NaN too */
        column = last;
    } else if (column < 0.0) { /* a distance of speeds below 0 */
        column = 0.0;
    }
    integer low = (integer)column;
    if (low > speeds - 2) {
        low = speeds - 2;
    }
    *part = column - (real)low;
    return low;
}

/* The angle without what has been added: theta_m less the motor's part of every order of the error itself, as it is sampled:
 * with the images of slow set-points. side is -1 backwards, else 1. */
static real smooth_angle(
    const real *waves, const real *table, integer wave_count, integer speeds, real angle, integer low, real part, real side)
{
    real smooth = angle;
    for (integer i = 0; i < wave_count; i++) {
        const real *wave = waves + 3 * i, *row = table + WAVE_COLUMNS * speeds * i;
        if (row[4] > 0.0) {
            const real *below = row + WAVE_COLUMNS * low, *above = below + WAVE_COLUMNS;
            const real turned = wave[0] * angle + wave[1];
            const real re = below[4] + part * (above[4] - below[4]), im = below[13] + part * (above[13] - below[13]);
            smooth += wave[2] * (re * COS(turned) - im * side * SIN(turned));
        }
    }
    return smooth;
}

/* All waves together: addition to the set-point in rad, torque offset in N m.
 *
 * side is -1 backwards, else 1; gained is what |w_m| gains in rad/s^2; load is the gear's torque times its reaction, turned
 * round backwards: its sine is of the angle alone, and knows no direction as what delays it does. */
static void add_waves(
    const real *waves, const real *table, integer wave_count, integer speeds, integer low, real part, real smooth, real side,
    real gained, real load, real sums[2])
{
    real reference = 0.0, torque = 0.0;
    for (integer i = 0; i < wave_count; i++) {
        const real *wave = waves + 3 * i;
        const real *below = table + WAVE_COLUMNS * (speeds * i + low), *above = below + WAVE_COLUMNS;
        const real turned = wave[0] * smooth + wave[1];
        const real cosine = wave[2] * COS(turned), sine = wave[2] * side * SIN(turned);
        real re = below[0] + part * (above[0] - below[0]) + gained * (below[5] + part * (above[5] - below[5]));
        real im = below[1] + part * (above[1] - below[1]) + gained * (below[6] + part * (above[6] - below[6]));
        re += load * (below[9] + part * (above[9] - below[9]));
        im += load * (below[10] + part * (above[10] - below[10]));
        reference += re * cosine - im * sine;
        re = below[2] + part * (above[2] - below[2]) + gained * (below[7] + part * (above[7] - below[7]));
        im = below[3] + part * (above[3] - below[3]) + gained * (below[8] + part * (above[8] - below[8]));
        re += load * (below[11] + part * (above[11] - below[11]));
        im += load * (below[12] + part * (above[12] - below[12]));
        torque += re * cosine - im * sine;
    }
    sums[0] = reference;
    sums[1] = torque;
}

void cancellation_step(
    const struct cancellation_config *config, struct cancellation_state *state, const real *waves, const real *table,
    integer wave_count, integer speeds, real period_s, real values[2])
{
    const struct cancellation_config *c = config;
    struct cancellation_state *s = state;
    const real angle = values[0], measured_nm = values[1];
    real part;
    if (s->is_running == 0) {
        s->speed_rad_s = s->slower_rad_s = s->left_nm = 0.0;
    }
    const real before = 2.0 * s->speed_rad_s - s->slower_rad_s;
    integer low = speed_column(c, speeds, before, &part);
    const real smooth = smooth_angle(waves, table, wave_count, speeds, angle, low, part, before < 0.0 ? -1.0 : 1.0);
    if (s->is_running == 0) {
        s->smooth_angle_rad = smooth;
    }
    const real turned_rad = FABS(smooth - s->smooth_angle_rad);
    const real blend = lowpass_blend(c->speed_lowpass_hz, period_s);
    s->speed_rad_s += blend * ((smooth - s->smooth_angle_rad) / period_s - s->speed_rad_s);
    s->slower_rad_s += blend * (s->speed_rad_s - s->slower_rad_s);
    const real mean = 2.0 * s->speed_rad_s - s->slower_rad_s; /* over the last period, on a ramp as late as neither */
    s->smooth_angle_rad = smooth;
    const real side = mean < 0.0 ? -1.0 : 1.0;
    /* the difference of both is what a speed gains in the time by which the low-pass follows a ramp */
    const real late_s = period_s * (1.0 - blend) / blend;
    real gained = late_s > 0.0 ? side * (s->speed_rad_s - s->slower_rad_s) / late_s : 0.0;
    gained = least(most(gained, -c->most_rad_s2), c->most_rad_s2);
    const real speed = mean + 0.5 * period_s * side * gained;
    low = speed_column(c, speeds, speed, &part);
    const real load = side * c->reaction * gear_torque(c, s, period_s, measured_nm, speed, side * gained);
    real sums[2];
    add_waves(waves, table, wave_count, speeds, low, part, smooth, side, gained, load, sums);
    if (s->is_running == 0) {
        s->offset_rad = sums[0];
        s->is_running = 1;
    }
    s->offset_rad -= s->offset_rad * least(1.0, turned_rad / (2.0 * PI * c->fade_rev));
    values[0] = sums[0] - s->offset_rad;
    values[1] = sums[1];
    if (c->torque_step_nm > 0.0) { /* what is rounded off now is added next time: below 25 Hz nothing of it is left */
        const real wanted = sums[1] + s->left_nm;
        values[1] = round_down(wanted / c->torque_step_nm + 0.5) * c->torque_step_nm;
        s->left_nm = wanted - values[1];
    }
}

void cancel(const struct cancellation *all, real *values)
{
    const integer count = all->count, wave_count = all->wave_count;
    for (integer row = 0; row < count; row++) {
        real own[2] = {values[row], values[count + row]};
        cancellation_step(
            &all->configs[row], &all->states[row], all->waves + 3 * wave_count * row,
            all->table + WAVE_COLUMNS * all->speeds * wave_count * row, wave_count, all->speeds, all->period_s, own);
        values[row] = own[0];
        values[count + row] = own[1];
    }
}

void inner_cancellation(
    const struct inner_cancellation *known, real lowpass_hz, real period_s, real angle, real speed_rad_s, real additions[3])
{
    const struct inner_cancellation *k = known;
    real reference = -k->a2_rad * COS(2.0 * angle + k->phi2_rad) - k->a4_rad * COS(4.0 * angle + k->phi4_rad);
    reference -= k->a1_rad * COS(angle + k->phi1_rad);
    const real late = angle - speed_rad_s / (2.0 * PI * lowpass_hz);
    real rate = 2.0 * k->a2_rad * SIN(2.0 * late + k->phi2_rad) + 4.0 * k->a4_rad * SIN(4.0 * late + k->phi4_rad);
    rate += k->a1_rad * SIN(late + k->phi1_rad);
    const real ahead = angle + 0.5 * period_s * speed_rad_s;
    const real x1 = ahead + k->phi1_rad, x2 = 2.0 * ahead + k->phi2_rad, x4 = 4.0 * ahead + k->phi4_rad;
    const real bend = 4.0 * k->a2_rad * COS(x2) + 16.0 * k->a4_rad * COS(x4) + k->a1_rad * COS(x1);
    const real slope = 2.0 * k->a2_rad * SIN(x2) + 4.0 * k->a4_rad * SIN(x4) + k->a1_rad * SIN(x1);
    /* theta_m + sum a_k cos(k theta_m + phi_k) turns smoothly: its second derivative gives w_m' (1 - slope) = w_m^2 bend */
    additions[0] = reference;
    additions[1] = speed_rad_s * rate;
    additions[2] = k->inertia_kg_m2 * speed_rad_s * speed_rad_s * bend / most(1.0 - slope, 0.5) +
                   k->damping_nm_s_rad * speed_rad_s * slope;
}
