/* The closed loop of plant_emulator.motion.advance in C: cyclic position, servo law, notches that are off, plant. The limit.
 * The records and constants are in a header that benchmarks/records.py makes from the numpy dtypes when this is compiled. */
#include <math.h>

#include "records.h"

typedef struct { double per_n, per_jm, per_jl, rise, per_stribeck, c[3], s[3]; } Constants; /* orders 1, 2, 4 */
typedef struct { double motor, x[3], y[3], arm, along, across; } Near;

static Constants constants(const Plant *p)
{
    return (Constants){1.0 / p->reduction_ratio, 1.0 / p->motor_inertia_kg_m2, 1.0 / p->arm_inertia_kg_m2,
                       p->static_friction_nm - p->coulomb_friction_nm, 1.0 / p->stribeck_velocity_rad_s,
                       {p->a1_rad * cos(p->phi1_rad), p->a2_rad * cos(p->phi2_rad), p->a4_rad * cos(p->phi4_rad)},
                       {p->a1_rad * sin(p->phi1_rad), p->a2_rad * sin(p->phi2_rad), p->a4_rad * sin(p->phi4_rad)}};
}

static void places(const Plant *p, double th, double tl, double *motor, double *arm)
{
    *motor = rint(th * (1.0 / MOTOR_GRID_RAD)) * MOTOR_GRID_RAD;
    *arm = rint((tl + p->home_angle_rad) * (1.0 / ARM_GRID_RAD)) * ARM_GRID_RAD;
}

static Near known(const Plant *p, const Constants *k, double motor, double arm)
{
    Near near = {.motor = motor, .arm = arm, .along = p->gravity_moment_nm * cos(arm), .across = p->gravity_moment_nm * sin(arm)};
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
    double level = p->coulomb_friction_nm, ratio = speed * k->per_stribeck, size = fabs(speed) / FRICTION_WIDTH_RAD_S;
    if (ratio * ratio < 40.0)
        level += k->rise * exp(-ratio * ratio);
    if (size < 20.0) {
        double e = exp(-2.0 * size);
        level *= (1.0 - e) / (1.0 + e);
    }
    return speed != 0.0 ? copysign(level, speed) : 0.0;
}

static inline __attribute__((always_inline)) void derivatives(const Plant *p, const Constants *k, const Near *near,
                                                              double command, const double *x, double *rate)
{
    double th = x[0], wm = x[1], tl = x[2], wl = x[3], z = x[4], tau = x[5], d = th - near->motor, q = d * d, c, s;
    if (fabs(d) > MOTOR_GRID_RAD) {
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
    double torsion = th * k->per_n + sync - tl, torsion_rate = wm * (k->per_n + slope) - wl, stiffness = p->gear_stiffness_nm_rad;
    if (p->wind_up_softness > 0.0) {
        double ratio = torsion / p->wind_up_torsion_rad;
        stiffness *= 1.0 - p->wind_up_softness * exp(-ratio * ratio);
    }
    double gear = stiffness * torsion + p->gear_damping_nm_s_rad * torsion_rate + z;
    d = tl + p->home_angle_rad - near->arm;
    q = d * d;
    if (fabs(d) > ARM_GRID_RAD) {
        c = cos(d);
        s = sin(d);
    } else {
        c = 1.0 - q * (1.0 / 2.0 - q * (1.0 / 24.0));
        s = d * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0)));
    }
    rate[3] = (gear - p->arm_damping_nm_s_rad * wl - (near->along * c - near->across * s)) * k->per_jl;
    rate[4] = 0.0;
    if (p->hysteresis_torque_nm > 0.0) {
        double sign = torsion_rate > 0.0 ? 1.0 : -1.0;
        rate[4] = torsion_rate / p->hysteresis_torsion_rad * (p->hysteresis_torque_nm - sign * z);
    }
    double torque = command;
    rate[5] = 0.0;
    if (p->current_time_constant_s > 0.0) {
        torque = tau;
        rate[5] = (command - tau) / p->current_time_constant_s;
    }
    double load = gear * (k->per_n + p->gear_reaction * slope);
    rate[1] = (torque - p->motor_damping_nm_s_rad * wm - friction(p, k, wm) - load) * k->per_jm;
    rate[0] = wm;
    rate[2] = wl;
}

static void plant_step(const Plant *p, const Constants *k, Near *near, PlantState *s, double command, double period,
                       int64_t substeps)
{
    double tau = p->current_time_constant_s > 0.0 ? s->torque_nm : command;
    double x[6] = {s->motor_angle_rad, s->motor_speed_rad_s, s->arm_angle_rad, s->arm_speed_rad_s, s->hysteresis_nm, tau}, r[4][6], y[6];
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
    s->motor_angle_rad = x[0], s->motor_speed_rad_s = x[1], s->arm_angle_rad = x[2], s->arm_speed_rad_s = x[3];
    s->hysteresis_nm = x[4], s->torque_nm = x[5];
}

static double blend(double corner, double period)
{
    double w = M_PI * corner * period;
    return fmin(1.0, 2.0 * w / (1.0 + w));
}

static double law(Law *servo, const Motion *m, double period, double position, double angle)
{
    const CascadeConfig *g = &servo->cascade_config;
    CascadeState *s = &servo->cascade_state;
    const NotchConfig *c = servo->notch_config;
    NotchState *f = servo->notch_state;
    double k = 2.0 / period, w = 2.0 * M_PI * g->lowpass_hz;
    s->speed_rad_s = ((k - w) * s->speed_rad_s + w * k * (angle - s->motor_angle_rad)) / (k + w);
    s->motor_angle_rad = angle;
    double error = g->position_gain_per_s * (position - angle) + m->velocity_offset_rad_s - s->speed_rad_s;
    double before = s->integral_nm;
    s->integral_nm += g->velocity_integral_gain_nm_rad * 0.5 * period * (error + s->error_rad_s);
    s->error_rad_s = error;
    double u = g->velocity_gain_nm_s_rad * error + s->integral_nm;
    for (int j = 0; j < NOTCHES; j++) { /* off: each still follows torque and speed */
        f[j].mean_nm += blend(START_LOWPASS_HZ, period) * (u - f[j].mean_nm);
        f[j].speed_rps += blend(c[j].speed_lowpass_hz, period) * (fabs(s->speed_rad_s) / (2.0 * M_PI) - f[j].speed_rps);
        f[j].active = 0;
    }
    double wanted = u + m->torque_offset_nm, torque = fmin(m->torque_limit_nm, fmax(-m->torque_limit_nm, wanted));
    if (torque != wanted && (wanted - torque) * s->error_rad_s > 0.0)
        s->integral_nm = before;
    return torque;
}

static double limited(Motion *m, CascadeState *s, double before, double torque)
{
    if (m->torque_low_nm < torque && torque < m->torque_high_nm)
        return torque;
    double within = fmin(m->torque_high_nm, fmax(m->torque_low_nm, torque));
    if (torque != within && (torque - within) * s->error_rad_s > 0.0)
        s->integral_nm = before;
    m->limited |= LIMITED_TORQUE;
    return within;
}

static int is_known(const Motion *m, const NotchConfig *notch)
{
    for (int j = 0; j < NOTCHES; j++)
        if (notch[j].mode != NOTCH_OFF)
            return 0;
    return m->mode == POSITION && m->extrapolation_periods == 0 && m->cancel_mode == 0 && !(m->cancel_fraction > 0.0) &&
           m->input_mask == 0 && m->edge_mask == 0 && m->is_watching == 0 && m->event == 0;
}

/* 0, or the axis, from 1 on, that was asked for what this does not do: another mode, a filter, inputs, a limit that breaks. */
int64_t advance(int64_t count, int64_t periods, double period, int64_t substeps, Axis *axes)
{
    for (int64_t row = 0; row < count; row++) {
        const Plant *p = &axes[row].plant;
        PlantState *s = &axes[row].plant_state;
        Motion *m = &axes[row].motion;
        Law *servo = &axes[row].law;
        if (!is_known(m, servo->notch_config))
            return row + 1;
        Constants k = constants(p);
        double arm_place, motor_place, rate[6];
        places(p, s->motor_angle_rad, s->arm_angle_rad, &motor_place, &arm_place);
        Near near = known(p, &k, motor_place, arm_place);
        for (int64_t t = 0; t < periods; t++) {
            double counts = floor(s->motor_angle_rad * m->counts_per_rad + 0.5), angle = counts / m->counts_per_rad;
            double fraction = ((double)m->elapsed_periods + 1.0) / (double)m->periods_per_set_point, before = servo->cascade_state.integral_nm;
            m->elapsed_periods++;
            if (fraction <= 1.0)
                m->late_periods = 0;
            else
                fraction = 1.0;
            double position = (m->previous_counts + (m->target_counts - m->previous_counts) * fraction) / m->counts_per_rad;
            m->limited = 0;
            m->demand_speed_rad_s = (position - m->demand_rad) / period;
            m->demand_rad = position;
            double torque = law(servo, m, period, position, angle);
            torque = limited(m, &servo->cascade_state, before, torque);
            m->torque_nm = m->torque_demand_nm = torque;
            m->following_error_rad = position - angle;
            if (fabs(m->following_error_rad) > m->following_window_rad) {
                if (++m->following_count > m->following_periods) m->trip |= FOLLOWING;
            } else
                m->following_count = 0;
            if (fabs(servo->cascade_state.speed_rad_s) > m->max_speed_rad_s) m->trip |= OVERSPEED;
            if (!(m->low_counts <= counts && counts <= m->high_counts)) m->trip |= OUT_OF_RANGE;
            if (m->trip != 0)
                return row + 1;
            plant_step(p, &k, &near, s, torque, period, substeps);
        }
        m->wake = 0;
        places(p, s->motor_angle_rad, s->arm_angle_rad, &motor_place, &arm_place);
        near = known(p, &k, motor_place, arm_place);
        double x[6] = {s->motor_angle_rad, s->motor_speed_rad_s, s->arm_angle_rad, s->arm_speed_rad_s, s->hysteresis_nm, s->torque_nm};
        derivatives(p, &k, &near, m->torque_nm, x, rate);
        s->arm_acceleration_rad_s2 = rate[3];
    }
    return 0;
}
