/* The closed loop of plant_emulator.motion.advance in C: cyclic position, servo law, notches that are off, plant. The limit.
 * The records are those of the numpy dtypes MOTION, PLANT, PLANT_STATE, CASCADE_* and NOTCH_*, field by field. */
#include <math.h>
#include <stdint.h>

typedef struct {
    double n, j_m, d_m, j_l, d_l, k_g, d_g, coulomb, stiction, stribeck, gravity, home;
    double a1, phi1, a2, phi2, a4, phi4, reaction, softness, psi_s, dahl, psi_h, t_c;
} Plant;
typedef struct { double th, wm, tl, wl, z, tau, arm_acceleration; } State;
typedef struct {
    int64_t mode;
    double counts_per_rad, previous, target;
    int64_t tick, span;
    double velocity_offset, torque_offset, target_torque, torque_limit;
    double profile_speed, profile_acceleration, profile_deceleration, stop_deceleration, reference, reference_speed;
    int64_t stop_ticks;
    double low, high, max_speed, window;
    int64_t following_ticks, following_count, trip, stopped;
    double torque, following_error;
} Motion;
typedef struct { double kpp, kvp, kvi, lowpass_hz; } Gains;
typedef struct { double angle, speed, error, integral; } Cascade;
typedef struct { double s1, s2, speed_rps, mean; int64_t active; double frequency, zeta; } NotchState;
typedef struct { int64_t mode; double order, start, end, offset, zeta_rn, zeta_rdth, hysteresis, lowpass_hz, ramp, b[5]; } Notch;
enum { NOTCHES = 2, POSITION = 1 };

static void derivatives(const Plant *p, double command, const double *x, double *rate)
{
    double th = x[0], wm = x[1], tl = x[2], wl = x[3], z = x[4], tau = x[5];
    double x1 = th + p->phi1, x2 = 2.0 * th + p->phi2, x4 = 4.0 * th + p->phi4;
    double sync = p->a1 * cos(x1) + p->a2 * cos(x2) + p->a4 * cos(x4);
    double slope = -p->a1 * sin(x1) - 2.0 * p->a2 * sin(x2) - 4.0 * p->a4 * sin(x4);
    double torsion = th / p->n + sync - tl, torsion_rate = wm / p->n + slope * wm - wl, stiffness = p->k_g;
    if (p->softness > 0.0) {
        double ratio = torsion / p->psi_s;
        stiffness *= 1.0 - p->softness * exp(-ratio * ratio);
    }
    double gear = stiffness * torsion + p->d_g * torsion_rate + z;
    rate[3] = (gear - p->d_l * wl - p->gravity * cos(tl + p->home)) / p->j_l;
    rate[4] = 0.0;
    if (p->dahl > 0.0)
        rate[4] = p->dahl / p->psi_h * torsion_rate * (1.0 - (torsion_rate > 0.0 ? 1.0 : -1.0) * z / p->dahl);
    double torque = command;
    rate[5] = 0.0;
    if (p->t_c > 0.0) {
        torque = tau;
        rate[5] = (command - tau) / p->t_c;
    }
    double v = wm / p->stribeck, level = p->coulomb + (p->stiction - p->coulomb) * exp(-v * v);
    double load = gear * (1.0 / p->n + p->reaction * slope);
    rate[1] = (torque - p->d_m * wm - level * tanh(wm / 0.05) - load) / p->j_m;
    rate[0] = wm;
    rate[2] = wl;
}

static void plant_step(const Plant *p, State *s, double command, double period, int64_t substeps)
{
    double x[6] = {s->th, s->wm, s->tl, s->wl, s->z, p->t_c > 0.0 ? s->tau : command}, k[4][6], y[6];
    double h = period / (double)substeps;
    for (int64_t i = 0; i < substeps; i++) {
        derivatives(p, command, x, k[0]);
        for (int j = 0; j < 6; j++) y[j] = x[j] + 0.5 * h * k[0][j];
        derivatives(p, command, y, k[1]);
        for (int j = 0; j < 6; j++) y[j] = x[j] + 0.5 * h * k[1][j];
        derivatives(p, command, y, k[2]);
        for (int j = 0; j < 6; j++) y[j] = x[j] + h * k[2][j];
        derivatives(p, command, y, k[3]);
        for (int j = 0; j < 6; j++) x[j] += h / 6.0 * (k[0][j] + 2.0 * (k[1][j] + k[2][j]) + k[3][j]);
    }
    derivatives(p, command, x, k[0]);
    *s = (State){x[0], x[1], x[2], x[3], x[4], x[5], k[0][3]};
}

static double blend(double corner, double period)
{
    double w = M_PI * corner * period;
    return fmin(1.0, 2.0 * w / (1.0 + w));
}

static double law(const Gains *g, Cascade *s, const Notch *c, NotchState *f, const Motion *m, double period, double position,
                  double angle)
{
    double k = 2.0 / period, w = 2.0 * M_PI * g->lowpass_hz;
    s->speed = ((k - w) * s->speed + w * k * (angle - s->angle)) / (k + w);
    s->angle = angle;
    double error = g->kpp * (position - angle) + m->velocity_offset - s->speed, before = s->integral;
    s->integral += g->kvi * 0.5 * period * (error + s->error);
    s->error = error;
    double u = g->kvp * error + s->integral;
    for (int j = 0; j < NOTCHES; j++) { /* off: each still follows torque and speed */
        f[j].mean += blend(20.0, period) * (u - f[j].mean);
        f[j].speed_rps += blend(c[j].lowpass_hz, period) * (fabs(s->speed) / (2.0 * M_PI) - f[j].speed_rps);
        f[j].active = 0;
    }
    double wanted = u + m->torque_offset, torque = fmin(m->torque_limit, fmax(-m->torque_limit, wanted));
    if (torque != wanted && (wanted - torque) * s->error > 0.0)
        s->integral = before;
    return torque;
}

void advance(int64_t axes, int64_t ticks, double period, int64_t substeps, const Plant *plant, State *state, Motion *motion,
             const Gains *gains, Cascade *cascade, const Notch *notch, NotchState *notch_state)
{
    for (int64_t t = 0; t < ticks; t++)
        for (int64_t row = 0; row < axes; row++) {
            Motion *m = motion + row;
            double counts = floor(state[row].th * m->counts_per_rad + 0.5), angle = counts / m->counts_per_rad;
            double share = fmin(1.0, ((double)m->tick + 1.0) / (double)m->span);
            double position = (m->previous + (m->target - m->previous) * share) / m->counts_per_rad;
            m->tick++;
            m->torque = law(gains + row, cascade + row, notch + row * NOTCHES, notch_state + row * NOTCHES, m, period, position, angle);
            m->following_error = position - angle;
            if (fabs(m->following_error) > m->window) {
                if (++m->following_count > m->following_ticks) m->trip |= 1;
            } else
                m->following_count = 0;
            if (fabs(cascade[row].speed) > m->max_speed) m->trip |= 2;
            if (!(m->low <= counts && counts <= m->high)) m->trip |= 4;
            plant_step(plant + row, state + row, m->torque, period, substeps);
        }
}
