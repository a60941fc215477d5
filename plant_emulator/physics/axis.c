#include "axis.h"

real synchronous_error(const struct plant *plant, real motor_angle, real *slope)
{
    const struct plant *p = plant;
    const real x1 = motor_angle + p->phi1_rad, x2 = 2.0 * motor_angle + p->phi2_rad, x4 = 4.0 * motor_angle + p->phi4_rad;
    real value = p->a1_rad * COS(x1) + p->a2_rad * COS(x2) + p->a4_rad * COS(x4);
    *slope = -p->a1_rad * SIN(x1) - 2.0 * p->a2_rad * SIN(x2) - 4.0 * p->a4_rad * SIN(x4);
    if (p->has_more_orders > 0.0) {
        for (int i = 0; i < MORE_LINES; i++) {
            const real turned = p->more_orders[i] * motor_angle + p->more_phi_rad[i];
            value += p->more_rad[i] * COS(turned);
            *slope -= p->more_orders[i] * p->more_rad[i] * SIN(turned);
        }
    }
    if (p->is_eccentric > 0.0) {
        for (int i = 0; i < MORE_LINES; i++) {
            const real turned = p->joint_orders[i] * motor_angle + p->joint_phi_rad[i];
            value += p->joint_rad[i] * COS(turned);
            *slope -= p->joint_orders[i] * p->joint_rad[i] * SIN(turned);
        }
    }
    return value;
}

real cogging(const struct plant *plant, real motor_angle)
{
    const struct plant *p = plant;
    real torque = 0.0;
    if (p->is_cogging > 0.0) {
        for (int i = 0; i < MORE_LINES; i++) {
            torque += p->cogging_nm[i] * COS(p->cogging_orders[i] * motor_angle + p->cogging_phi_rad[i]);
        }
    }
    return torque;
}

void hang_at_rest(const struct plant *plant, struct plant_state *state)
{
    const struct plant *p = plant;
    struct plant_state *s = state;
    real slope;
    const real rigid = s->motor_angle_rad / p->reduction_ratio + synchronous_error(p, s->motor_angle_rad, &slope);
    real arm = rigid;
    for (int round = 0; round < 50; round++) {
        const real torsion = rigid - arm;
        real stiffness = p->gear_stiffness_nm_rad;
        if (p->wind_up_softness > 0.0) {
            const real ratio = torsion / p->wind_up_torsion_rad;
            stiffness *= 1.0 - p->wind_up_softness * EXP(-ratio * ratio);
        }
        arm = rigid - (p->gravity_moment_nm * COS(arm + p->home_angle_rad) - s->hysteresis_nm) / stiffness;
    }
    s->arm_angle_rad = arm;
    s->arm_speed_rad_s = s->arm_acceleration_rad_s2 = 0.0;
    s->motor_speed_rad_s = s->torque_nm = 0.0;
}
