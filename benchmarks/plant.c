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
    int64_t following_ticks, following_count, cancel_mode; /* no cancellation here: it is off */
    double cancel[7];
    int64_t trip, stopped;
    double torque, following_error;
} Motion;
typedef struct { double kpp, kvp, kvi, lowpass_hz; } Gains;
typedef struct { double angle, speed, error, integral; } Cascade;
typedef struct { double s1, s2, speed_rps, mean; int64_t active; double frequency, zeta; } NotchState;
typedef struct { int64_t mode; double order, start, end, offset, zeta_rn, zeta_rdth, hysteresis, lowpass_hz, ramp, b[5]; } Notch;
enum { NOTCHES = 2, POSITION = 1 };

typedef struct { double per_n, per_jm, per_jl, rise, per_stribeck, c[3], s[3]; } Constants; /* orders 1, 2, 4 */
typedef struct { double motor, x[3], y[3], arm, along, across; } Near;

static const double MOTOR_NEAR = 1.0 / 16.0, ARM_NEAR = 1.0 / 64.0;

static Constants constants(const Plant *p)
{
    return (Constants){1.0 / p->n, 1.0 / p->j_m, 1.0 / p->j_l, p->stiction - p->coulomb, 1.0 / p->stribeck,
                       {p->a1 * cos(p->phi1), p->a2 * cos(p->phi2), p->a4 * cos(p->phi4)},
                       {p->a1 * sin(p->phi1), p->a2 * sin(p->phi2), p->a4 * sin(p->phi4)}};
}

static void places(const Plant *p, double th, double tl, double *motor, double *arm)
{
    *motor = rint(th * (1.0 / MOTOR_NEAR)) * MOTOR_NEAR;
    *arm = rint((tl + p->home) * (1.0 / ARM_NEAR)) * ARM_NEAR;
}

static Near known(const Plant *p, const Constants *k, double motor, double arm)
{
    Near near = {.motor = motor, .arm = arm, .along = p->gravity * cos(arm), .across = p->gravity * sin(arm)};
    double cosine = cos(motor), sine = sin(motor);
    for (int j = 0; j < 3; j++) {
        near.x[j] = k->c[j] * cosine - k->s[j] * sine;
        near.y[j] = k->s[j] * cosine + k->c[j] * sine;
        double twice = 2.0 * sine * cosine;
        cosine = 1.0 - 2.0 * sine * sine;
        sine = twice;
    }
    return near;
}

static double friction(const Plant *p, const Constants *k, double speed)
{
    double level = p->coulomb, ratio = speed * k->per_stribeck, size = fabs(speed) / 0.05;
    if (ratio * ratio < 40.0)
        level += k->rise * exp(-ratio * ratio);
    if (size < 20.0) {
        double e = exp(-2.0 * size);
        level *= (1.0 - e) / (1.0 + e);
    }
    return speed != 0.0 ? copysign(level, speed) : 0.0;
}

static inline __attribute__((always_inline)) void derivatives(const Plant *p, const Constants *k, const Near *near, double command,
                                                              const double *x, double *rate)
{
    double th = x[0], wm = x[1], tl = x[2], wl = x[3], z = x[4], tau = x[5], d = th - near->motor, q = d * d, c, s;
    if (fabs(d) > MOTOR_NEAR) {
        c = cos(d);
        s = sin(d);
    } else {
        c = 1.0 - q * (1.0 / 2.0 - q * (1.0 / 24.0 - q * (1.0 / 720.0)));
        s = d * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0 - q * (1.0 / 5040.0))));
    }
    double c2 = 1.0 - 2.0 * s * s, s2 = 2.0 * s * c, c4 = 1.0 - 2.0 * s2 * s2, s4 = 2.0 * s2 * c2;
    const double *u = near->x, *v = near->y;
    double sync = (u[0] * c - v[0] * s) + (u[1] * c2 - v[1] * s2) + (u[2] * c4 - v[2] * s4);
    double slope = -(u[0] * s + v[0] * c) - 2.0 * (u[1] * s2 + v[1] * c2) - 4.0 * (u[2] * s4 + v[2] * c4);
    double torsion = th * k->per_n + sync - tl, torsion_rate = wm * (k->per_n + slope) - wl, stiffness = p->k_g;
    if (p->softness > 0.0) {
        double ratio = torsion / p->psi_s;
        stiffness *= 1.0 - p->softness * exp(-ratio * ratio);
    }
    double gear = stiffness * torsion + p->d_g * torsion_rate + z;
    d = tl + p->home - near->arm;
    q = d * d;
    if (fabs(d) > ARM_NEAR) {
        c = cos(d);
        s = sin(d);
    } else {
        c = 1.0 - q * (1.0 / 2.0 - q * (1.0 / 24.0));
        s = d * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0)));
    }
    rate[3] = (gear - p->d_l * wl - (near->along * c - near->across * s)) * k->per_jl;
    rate[4] = p->dahl > 0.0 ? torsion_rate / p->psi_h * (p->dahl - (torsion_rate > 0.0 ? 1.0 : -1.0) * z) : 0.0;
    double torque = command;
    rate[5] = 0.0;
    if (p->t_c > 0.0) {
        torque = tau;
        rate[5] = (command - tau) / p->t_c;
    }
    rate[1] = (torque - p->d_m * wm - friction(p, k, wm) - gear * (k->per_n + p->reaction * slope)) * k->per_jm;
    rate[0] = wm;
    rate[2] = wl;
}

static void plant_step(const Plant *p, const Constants *k, Near *near, State *s, double command, double period, int64_t substeps)
{
    double x[6] = {s->th, s->wm, s->tl, s->wl, s->z, p->t_c > 0.0 ? s->tau : command}, r[4][6], y[6];
    double h = period / (double)substeps;
    for (int64_t i = 0; i < substeps; i++) {
        double motor, arm;
        places(p, x[0], x[2], &motor, &arm);
        if (motor != near->motor || arm != near->arm)
            *near = known(p, k, motor, arm);
        derivatives(p, k, near, command, x, r[0]);
        for (int j = 0; j < 6; j++) y[j] = x[j] + 0.5 * h * r[0][j];
        derivatives(p, k, near, command, y, r[1]);
        for (int j = 0; j < 6; j++) y[j] = x[j] + 0.5 * h * r[1][j];
        derivatives(p, k, near, command, y, r[2]);
        for (int j = 0; j < 6; j++) y[j] = x[j] + h * r[2][j];
        derivatives(p, k, near, command, y, r[3]);
        for (int j = 0; j < 6; j++) x[j] += h / 6.0 * (r[0][j] + 2.0 * (r[1][j] + r[2][j]) + r[3][j]);
    }
    s->th = x[0], s->wm = x[1], s->tl = x[2], s->wl = x[3], s->z = x[4], s->tau = x[5];
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
    for (int64_t row = 0; row < axes; row++) {
        const Plant *p = plant + row;
        State *s = state + row;
        Motion *m = motion + row;
        Constants k = constants(p);
        double arm_place, motor_place, rate[6];
        places(p, s->th, s->tl, &motor_place, &arm_place);
        Near near = known(p, &k, motor_place, arm_place);
        for (int64_t t = 0; t < ticks; t++) {
            double counts = floor(s->th * m->counts_per_rad + 0.5), angle = counts / m->counts_per_rad;
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
            plant_step(p, &k, &near, s, m->torque, period, substeps);
        }
        places(p, s->th, s->tl, &motor_place, &arm_place);
        near = known(p, &k, motor_place, arm_place);
        derivatives(p, &k, &near, m->torque, (double[]){s->th, s->wm, s->tl, s->wl, s->z, s->tau}, rate);
        s->arm_acceleration = rate[3];
    }
}
