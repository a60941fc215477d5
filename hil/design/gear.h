/* An arm on its gear, along a motion of the motor side.
 *
 * The gear may be soft at small torsions and have hysteresis, and gravity may load it:
 *
 *     psi = b(t) - theta_l,       b = theta_m/N + theta_sync(theta_m)
 *     theta_l'' = w^2 psi (1 - r exp(-(psi/psi_s)^2)) + z + d_g psi' - d_l theta_l' - g_c cos theta_l - g_s sin theta_l
 *     z' = psi'/psi_h (F - sgn(psi') z)
 *
 * All torques are divided by J_l. Between two turns of psi, z depends on psi alone: z = s F + (z_0 - s F) exp(-|psi - psi_0|/psi_h)
 * with s = sgn(psi - psi_0).
 *
 * Source: the paper, Fig. 3, eq. (1); P. R. Dahl, A solid friction model, Aerospace Corporation TOR-158(3107-18) (1968).
 */
#ifndef HIL_GEAR_H
#define HIL_GEAR_H

#include "hil/control/real.h"

struct gear_law {
    real stiffness;       /* w^2 = K_g/J_l in 1/s^2 */
    real gear_damping;    /* d_g = D_g/J_l in 1/s */
    real arm_damping;     /* d_l = D_l/J_l in 1/s */
    real softness;        /* r */
    real per_wind_up;     /* 1/psi_s in 1/rad */
    real hysteresis;      /* F/J_l in rad/s^2 */
    real per_hysteresis;  /* 1/psi_h in 1/rad */
    real gravity_cosine;  /* g_c in rad/s^2 */
    real gravity_sine;    /* g_s in rad/s^2 */
    real wound;           /* z/F at rest before the motion: what the motions before have left */
    real ahead;           /* theta_l at the beginning in rad, over that at rest: the arm may still ring */
    real ahead_speed;     /* theta_l' at the beginning in rad/s, likewise */
};

/* The accelerations of count arms along motions of their base, from rest under gravity or ringing.
 *
 * base and speed hold b in rad and b' in rad/s at every half step, 2 steps + 1 of each; those of the next arm begin apart numbers
 * later, with 0 all have the same. acceleration becomes theta_l'' in rad/s^2 of each arm at every whole step, steps + 1 numbers.
 * Runge-Kutta steps of order 4 for theta_l, the closed form for z. */
void gear_follow(
    const struct gear_law *laws, integer count, const real *base, const real *speed, integer apart, integer steps, real step_s,
    real *acceleration);

#endif
