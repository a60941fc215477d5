#include "angle_grid.h"

void find_constants(const struct plant *plant, struct constants *constants)
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
    k->gravity_moment = p->gravity_moment_nm;
    k->home_angle = p->home_angle_rad;
    k->gear_reaction = p->gear_reaction;
    k->wind_up_softness = p->wind_up_softness;
    k->wind_up_torsion = p->wind_up_torsion_rad;
    k->hysteresis_torque = p->hysteresis_torque_nm;
    k->hysteresis_torsion = p->hysteresis_torsion_rad;
    k->current_time_constant = p->current_time_constant_s;
    k->a1_cos = p->a1_rad * COS(p->phi1_rad);
    k->a1_sin = p->a1_rad * SIN(p->phi1_rad);
    k->a2_cos = p->a2_rad * COS(p->phi2_rad);
    k->a2_sin = p->a2_rad * SIN(p->phi2_rad);
    k->a4_cos = p->a4_rad * COS(p->phi4_rad);
    k->a4_sin = p->a4_rad * SIN(p->phi4_rad);
    k->has_more_orders = p->has_more_orders;
    k->is_eccentric = p->is_eccentric;
    k->is_cogging = p->is_cogging;
    for (int i = 0; i < MORE_LINES; i++) {
        k->more_orders[i] = p->more_orders[i];
        k->more_rad[i] = p->more_rad[i];
        k->more_phi[i] = p->more_phi_rad[i];
        k->joint_orders[i] = p->joint_orders[i];
        k->joint_rad[i] = p->joint_rad[i];
        k->joint_phi[i] = p->joint_phi_rad[i];
        k->cogging_orders[i] = p->cogging_orders[i];
        k->cogging_nm[i] = p->cogging_nm[i];
        k->cogging_phi[i] = p->cogging_phi_rad[i];
    }
}

/* Put what an order counts; the factor is a power of two, so that no digit of the slope is lost. */
static void put_order(struct grid_point *near, int row, real order, real x, real y)
{
    near->of_cosine[row][0] = x;
    near->of_cosine[row][1] = -order * y;
    near->of_sine[row][0] = -y;
    near->of_sine[row][1] = -order * x;
}

void find_grid_point(const struct constants *k, real motor, real arm, struct grid_point *near)
{
    const real cosine = COS(motor), sine = SIN(motor);
    const real cosine2 = 1.0 - 2.0 * sine * sine, sine2 = 2.0 * sine * cosine;
    const real cosine4 = 1.0 - 2.0 * sine2 * sine2, sine4 = 2.0 * sine2 * cosine2;
    near->motor = motor;
    put_order(near, 0, 1.0, k->a1_cos * cosine - k->a1_sin * sine, k->a1_sin * cosine + k->a1_cos * sine);
    put_order(near, 1, 2.0, k->a2_cos * cosine2 - k->a2_sin * sine2, k->a2_sin * cosine2 + k->a2_cos * sine2);
    put_order(near, 2, 4.0, k->a4_cos * cosine4 - k->a4_sin * sine4, k->a4_sin * cosine4 + k->a4_cos * sine4);
    near->arm = arm;
    near->gravity_cos = k->gravity_moment * COS(arm);
    near->gravity_sin = k->gravity_moment * SIN(arm);
}
