#include "changing.h"
#include "friction.h"

/* The gear's torque without its damping, K_g psi (1 - r exp(-(psi/psi_s)^2)) + z, N m. */
static real spring_nm(const struct plant *p, const struct plant_state *s)
{
    real slope;
    const real torsion =
        s->motor_angle_rad / p->reduction_ratio + synchronous_error(p, s->motor_angle_rad, &slope) - s->arm_angle_rad;
    real stiffness = p->gear_stiffness_nm_rad;
    if (p->wind_up_softness > 0.0) {
        const real ratio = torsion / p->wind_up_torsion_rad;
        stiffness *= 1.0 - p->wind_up_softness * EXP(-ratio * ratio);
    }
    return stiffness * torsion + s->hysteresis_nm;
}

void go_through(
    const struct change *change, struct past *past, const struct plant *plant, const struct plant_state *state, int braked,
    real period_s)
{
    const struct plant *p = plant;
    const real speed = braked ? 0.0 : state->motor_speed_rad_s;
    if (!braked) {
        past->operating_periods += 1;
        past->operating_s = (real)past->operating_periods * period_s;
        past->turned_rad += FABS(speed) * period_s;
    }
    const real part = 1.0 - EXP(-period_s / SMOOTHING_S);
    past->load_nm += part * (spring_nm(p, state) - past->load_nm);
    past->direction += part * (speed / SQRT(speed * speed + TURNING_RAD_S * TURNING_RAD_S) - past->direction);
    const real rise = p->static_friction_nm - p->coulomb_friction_nm;
    const real lost = p->motor_damping_nm_s_rad * speed +
                      friction(p->coulomb_friction_nm, rise, 1.0 / p->stribeck_velocity_rad_s, speed);
    const real warm = change->ambient_c + change->resistance_k_w * lost * speed;
    past->temperature_c += (1.0 - EXP(-period_s / change->thermal_constant_s)) * (warm - past->temperature_c);
}

/* Amplitude and phase of one order now, in rad. */
static void find_line(const struct change *c, const struct past *past, int i, real *amplitude, real *phase)
{
    const real warmer = past->temperature_c - c->reference_c;
    real size = 1.0 + c->growth_per_s[i] * past->operating_s + c->growth_per_rad[i] * past->turned_rad;
    size += c->load_per_nm[i] * past->load_nm + c->direction_part[i] * past->direction + c->warmth_per_k[i] * warmer;
    *phase = c->phi_rad[i] + c->drift_rad_s[i] * past->operating_s + c->load_rad_nm[i] * past->load_nm;
    *phase += c->direction_rad[i] * past->direction + c->warmth_rad_k[i] * warmer;
    if (past->operating_s >= c->step_s[i]) {
        *phase += c->step_rad[i];
    }
    *amplitude = c->a_rad[i] * most(0.0, size);
}

void put_error(const struct change *change, const struct past *past, struct plant *plant)
{
    find_line(change, past, 0, &plant->a1_rad, &plant->phi1_rad);
    find_line(change, past, 1, &plant->a2_rad, &plant->phi2_rad);
    find_line(change, past, 2, &plant->a4_rad, &plant->phi4_rad);
    if (plant->has_more_orders > 0.0) {
        for (int i = 0; i < MORE_LINES; i++) {
            find_line(change, past, NAMED_LINES + i, &plant->more_rad[i], &plant->more_phi_rad[i]);
        }
    }
}
