/* Cancellation of the transmission error: an addition to the set-point that follows from the measured motor angle and speed.
 *
 * With theta_sync = sum A_k cos(k theta_m + phi_k) the gear's torsion does not feel the error any more where the motor moves by
 *
 *     -N sum A_k cos(k theta_m + phi_k).
 *
 * Each order asks for a sine of known angle k theta_m, whose frequency k f_m follows the motor. What a loop, its set-points and
 * the bus make of a sine at that frequency is one complex number G_k(f_m). It is a table over |f_m|, worked out beforehand,
 * delays included. Turning backwards, everything but k theta_m + phi_k changes the sign of its phase: G_k is then its own
 * conjugate. While the motor speeds up a sine is a chirp, for which G_k changes by -(j/2) k |w_m|' d2G_k/dw2.
 *
 * The measured angle contains what has been added. The sines are those of the angle without it, which turns smoothly:
 * theta_m + N sum A_k cos(k theta_m + phi_k).
 */
#ifndef HIL_CANCELLATION_H
#define HIL_CANCELLATION_H

#include "real.h"

/* Parameters of one axis' cancellation. */
struct cancellation_config {
    real step_rps;         /* distance of the table's speeds */
    real speed_lowpass_hz; /* corner of the low-pass that gives f_m */
    real fade_rev;         /* revolutions in which the first addition is forgotten */
    real torque_step_nm;   /* step to which a torque is rounded; 0: it is not */
    real most_rad_s2;      /* largest acceleration for which G changes */
    /* how the gear's torque is told from the motor's */
    real load_lowpass_hz;
    real reduction_ratio;
    real motor_inertia_kg_m2;
    real motor_damping_nm_s_rad;
    real coulomb_friction_nm;
    real reaction;
    real most_nm; /* largest load */
};

/* Memory of one axis' cancellation. */
struct cancellation_state {
    real smooth_angle_rad; /* last angle without what was added */
    real speed_rad_s;      /* low-passed speed, and once more */
    real slower_rad_s;
    real offset_rad; /* what is left of the first addition */
    real left_nm;    /* remainder that rounding has left of the torque */
    real torque_nm;  /* low-passed torque of the motor, and once more */
    real slower_nm;
    integer is_running;
};

/* Numbers of a wave in the table: Re and Im of G for the set-point, then for the torque; Re of the motor's part, 0 for mixed
 * waves; Re and Im of the bend of either; Re and Im for each N m of the gear's torque, of either; Im of the motor's part. */
enum { WAVE_COLUMNS = 14 };

/* Amplitudes and phases at the motor (N A_k, phi_k) of orders 1, 2 and 4, and the motor, of the cancellation in a drive. */
struct inner_cancellation {
    real a2_rad;
    real phi2_rad;
    real a4_rad;
    real phi4_rad;
    real inertia_kg_m2;
    real damping_nm_s_rad;
    real a1_rad;
    real phi1_rad;
};

/* Motor speed from which on Coulomb friction is whole. */
#define FRICTION_RAD_S 0.5

/* Time to full strength inside a drive: a cancellation that began at once would be a step of N A_k, 3 mrad at the motor. */
#define CANCELLATION_FADE_S 0.2

/* One sample of one axis: values[0] in rad and values[1] in N m become the additions to its set-point and to its torque.
 *
 * waves holds order, phase and factor of the amplitude of each wave; table holds WAVE_COLUMNS numbers for each of speeds speeds
 * (at least 2) of each wave. values comes with theta_m in rad and the motor torque in N m, as measured. */
void cancellation_step(
    const struct cancellation_config *config, struct cancellation_state *state, const real *waves, const real *table,
    integer wave_count, integer speeds, real period_s, real values[2]);

/* The cancellations of some axes: waves and table hold those of each axis, one behind the other. */
struct cancellation {
    const struct cancellation_config *configs;
    struct cancellation_state *states;
    const real *waves;
    const real *table;
    integer count; /* of axes */
    integer wave_count;
    integer speeds;
    real period_s;
};

/* cancellation_step for every axis. values has a row of angles and a row of torques, which become the additions. */
void cancel(const struct cancellation *all, real *values);

/* One sample inside a drive, which knows angle and speed: additions to set-point in rad, speed in rad/s and torque in N m.
 *
 * With d = -sum a_k cos(k theta_m + phi_k), a_k = N A_k, the set-point moves by d, so that the position loop sees nothing of
 * it; the velocity offset is F_lp s d, as the loop measures it (F_lp as its delay, 1/2 pi f); the torque is J_m d'' + D_m d',
 * half a period ahead for its hold. What the motion's own acceleration adds to d'', a fraction a/(k w_m^2), is left out. */
void inner_cancellation(
    const struct inner_cancellation *known, real lowpass_hz, real period_s, real angle, real speed_rad_s, real additions[3]);

#endif
