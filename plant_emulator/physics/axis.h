/* One axis: motor and arm, two inertias joined by a harmonic drive gearing with its angular transmission error.
 *
 *     psi = theta_m/N + theta_sync(theta_m) - theta_l
 *     t_g = K_g psi (1 - r exp(-(psi/psi_s)^2)) + z + D_g psi'            r: soft wind-up, z: Dahl hysteresis
 *     J_m w_m' = t + t_c(theta_m) - D_m w_m - t_f(w_m) - t_g (1/N + dtheta_sync/dtheta_m)
 *     J_l w_l' = t_g - D_l w_l - m g l cos(theta_l + q_0)
 *     z' = s psi' (1 - sgn(psi') z/F),    s = F/psi_h
 *     t' = (t_command - t)/T_c
 *
 * dtheta_sync/dtheta_m counts only with the gear's reaction. A closed brake holds the motor: w_m' = 0. Without a current-loop
 * lag t is the command.
 *
 * Source: the paper, Fig. 3, eq. (1) and (2).
 */
#pragma once

#include "hil/control/real.h"

/* Orders besides 1, 2 and 4 for which an axis has room, orders of the joint, and orders of cogging. has_more_orders, is_eccentric
 * and is_cogging are 0 if it has none; these then cost nothing. */
enum { MORE_LINES = 4 };

/* Constants of an axis, all in SI; gear and arm on the arm side, motor and friction on the motor side. */
struct plant {
    real reduction_ratio; /* N */
    real motor_inertia_kg_m2;
    real motor_damping_nm_s_rad;
    real arm_inertia_kg_m2;
    real arm_damping_nm_s_rad;
    real gear_stiffness_nm_rad;
    real gear_damping_nm_s_rad;
    real coulomb_friction_nm;
    real static_friction_nm;
    real stribeck_velocity_rad_s;
    real gravity_moment_nm;
    real home_angle_rad; /* q_0 */
    real a1_rad;
    real phi1_rad;
    real a2_rad;
    real phi2_rad;
    real a4_rad;
    real phi4_rad;
    real has_more_orders;
    real more_orders[MORE_LINES];
    real more_rad[MORE_LINES];
    real more_phi_rad[MORE_LINES];
    real is_eccentric;
    real joint_orders[MORE_LINES]; /* in periods for a revolution of the motor: m/N for m of the joint */
    real joint_rad[MORE_LINES];
    real joint_phi_rad[MORE_LINES];
    real is_cogging;
    real cogging_orders[MORE_LINES];
    real cogging_nm[MORE_LINES];
    real cogging_phi_rad[MORE_LINES];
    real gear_reaction;
    real wind_up_softness;
    real wind_up_torsion_rad;
    real hysteresis_torque_nm;
    real hysteresis_torsion_rad;
    real current_time_constant_s;
};

/* State of an axis. */
struct plant_state {
    real motor_angle_rad; /* theta_m */
    real motor_speed_rad_s;
    real arm_angle_rad; /* theta_l */
    real arm_speed_rad_s;
    real hysteresis_nm; /* z, at the gear */
    real torque_nm;     /* t, of the motor */
    real arm_acceleration_rad_s2;
};

/* theta_sync = sum A_k cos(k theta_m + phi_k) in rad on the arm side, eq. (2); slope becomes dtheta_sync/dtheta_m. */
real synchronous_error(const struct plant *plant, real motor_angle, real *slope);

/* t_c = sum T_j cos(j theta_m + chi_j): torque in N m with which the motor's own magnets pull it on. */
real cogging(const struct plant *plant, real motor_angle);

/* Put a braked axis at rest under gravity: the gear carries the load, so theta_l hangs below theta_m/N + theta_sync. */
void hang_at_rest(const struct plant *plant, struct plant_state *state);
