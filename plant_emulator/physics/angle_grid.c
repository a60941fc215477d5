#include "angle_grid.h"

static struct harmonic wave(real order, real size, real phase)
{
    return (struct harmonic){order, size * COS(phase), size * SIN(phase)};
}

void find_constants(const struct plant *plant, struct constants *constants, struct grid_point *near)
{
    const struct plant *p = plant;
    struct constants *k = constants;
    k->per_ratio = 1.0 / p->reduction_ratio;
    k->per_motor_inertia = 1.0 / p->motor_inertia_kg_m2;
    k->motor_damping = p->motor_damping_nm_s_rad;
    k->per_arm_inertia = 1.0 / p->arm_inertia_kg_m2;
    k->arm_damping = p->arm_damping_nm_s_rad;
    k->gear_stiffness = p->gear_stiffness_nm_rad;
    k->gear_damping = p->gear_damping_nm_s_rad;
    k->coulomb_friction = p->coulomb_friction_nm;
    k->friction_rise = p->static_friction_nm - p->coulomb_friction_nm;
    k->per_stribeck_velocity = 1.0 / p->stribeck_velocity_rad_s;
    k->gear_reaction = p->gear_reaction;
    k->wind_up_softness = p->wind_up_softness;
    k->per_wind_up_torsion = p->wind_up_softness > 0.0 ? 1.0 / p->wind_up_torsion_rad : 0.0;
    k->hysteresis_torque = p->hysteresis_torque_nm;
    k->per_hysteresis_torsion = p->hysteresis_torque_nm > 0.0 ? 1.0 / p->hysteresis_torsion_rad : 0.0;
    k->current_time_constant = p->current_time_constant_s;
    k->gravity = wave(1.0, p->gravity_moment_nm, p->home_angle_rad);
    k->cogging_lines = p->is_cogging > 0.0 ? MORE_LINES : 0;
    for (int i = 0; i < k->cogging_lines; i++) {
        k->cogging[i] = wave(p->cogging_orders[i], p->cogging_nm[i], p->cogging_phi_rad[i]);
    }
    begin_waves(&k->gravity, 1, &near->gravity);
    begin_waves(k->cogging, k->cogging_lines, &near->cogging);
    take_error(p, k, near);
}

void take_error(const struct plant *plant, struct constants *constants, struct grid_point *near)
{
    const struct plant *p = plant;
    struct harmonic *line = constants->error;
    *line++ = wave(1.0, p->a1_rad, p->phi1_rad);
    *line++ = wave(2.0, p->a2_rad, p->phi2_rad);
    *line++ = wave(4.0, p->a4_rad, p->phi4_rad);
    for (int i = 0; i < MORE_LINES && p->has_more_orders > 0.0; i++) {
        *line++ = wave(p->more_orders[i], p->more_rad[i], p->more_phi_rad[i]);
    }
    for (int i = 0; i < MORE_LINES && p->is_eccentric > 0.0; i++) {
        *line++ = wave(p->joint_orders[i], p->joint_rad[i], p->joint_phi_rad[i]);
    }
    constants->lines = line - constants->error;
    begin_waves(constants->error, constants->lines, &near->error);
}
