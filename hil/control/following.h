/* A cancellation that follows: an observer of what the cancellation leaves, and the factors by which it is multiplied.
 *
 * Of an order k the cancellation leaves d_k c_k e^{j k theta_m}, where c_k is what was identified and d_k a complex number, 0
 * where the cancellation is right. What is left shakes the tip through the arm on its gear,
 *
 *     x'' + a1 x' + a0 x = v'',    v = sum Re(d_k c_k e^{j k theta_m}),    tip's acceleration = L (b0 x + b1 x').
 *
 * The states x, x' of each axis and the d_k, which walk at random, are observed together by a Kalman filter from the tip's
 * acceleration. Acceleration and sines go through the same band-pass, so it costs no phase.
 */
#ifndef HIL_FOLLOWING_H
#define HIL_FOLLOWING_H

#include "real.h"

/* Sections of the band-pass, alike, one behind the other, and what a signal in it remembers, its last output included. */
enum { BAND_SECTIONS = 2, BAND_MEMORY = 5 };

/* The sampling time, then the settings; hil.control.following says what each means. */
struct following_config {
    real period_s;
    real model_error;
    real correlated_s;
    real walk_per_root_s;
    real most_error;
    real follow_s;
    real begin_sigmas;
    real end_sigmas;
    real begin_m;
    real end_m;
    real least_gain;
    real most_gain;
    real most_angle_rad;
    real low_ratio;
    real high_ratio;
    real slowest_rad_s;
    real least_noise_m_s2;
    real speed_lowpass_hz;
    real quick;
    real quick_s;
    real jolt_part;
    real wander;
    real wander_per_s;
    real likely;
    real begin_part;
    real end_s;
    real steady;
};

/* The arm of an axis as one resonance, sampled. */
struct following_arm {
    real a11; /* states x, x' one sample on */
    real a12;
    real a21;
    real a22;
    real b1; /* input of the mean of two samples of v'' */
    real b2;
    real stiff;   /* a0 */
    real damping; /* a1 */
    real spring;  /* b0 */
    real dashpot; /* b1 */
    real f_al_rad_s;
    real reduction_ratio;
    real delay_s; /* of the acceleration */
};

/* An order that is followed; amplitude 0 where there is none. */
struct following_order {
    real order;         /* k */
    real phase_rad;     /* phi_k */
    real amplitude_rad; /* A_k at the arm */
    real begin_part;    /* least |d| from which on w follows */
};

/* Memory of an axis. */
struct following_axis {
    real angle_rad;
    real speed_rad_s; /* low-passed, and once more */
    real slower_rad_s;
    real reference_rad; /* last set-point of the motion, its speed and acceleration */
    real reference_rad_s;
    real planned_rad_s2;
    real shaken; /* x and x' that this shakes */
    real shaking;
    real turning_rad_s; /* speed as late as neither low-pass */
};

/* Memory of all axes together. */
struct following_common {
    real started;  /* 1 once it has begun */
    real quiet;    /* least variance at rest */
    real loud;     /* variance */
    real count;    /* samples at rest */
    real resting;  /* variance there now */
    real jolted;   /* square of what the motion itself shakes */
};

/* State of an order. */
struct following_order_state {
    real open;       /* 1 while w follows */
    real given_up;   /* 1 where it was taken back for good */
    real beyond_s;   /* time that w has wanted to leave its bounds */
    real since_s;    /* time since it began to follow */
    real wandered;   /* length of the way that w has gone of late */
    real nearest;    /* largest |d| at which it nearly began, or would have */
    real small_s;    /* time that little has been left */
};

/* Factor between what is nearly enough to follow and what is enough: another run of the same motion differs by less. */
#define BEGIN_MARGIN 1.5

/* Arrays of an observer. n_states = 2 n_axes (1 + n_orders). */
struct following {
    const struct following_config *config;
    const struct following_arm *arms;      /* n_axes */
    const struct following_order *orders;  /* n_axes, n_orders */
    const real *band;                      /* b0, b1, b2, a1, a2 of a section */
    struct following_axis *axes;           /* n_axes */
    struct following_common *common;
    real *filters;    /* of the tip, of Re and Im of each order, of each axis' planned acceleration; BAND_MEMORY each */
    real *states;     /* x, x' of each axis, then Re and Im of each d; n_states */
    real *covariance; /* n_states, n_states */
    real *factors;    /* Re and Im of w; n_axes, n_orders, 2 */
    struct following_order_state *order_states; /* n_axes, n_orders */
    real *room;                           /* following_room(n_axes, n_orders) numbers */
    integer n_axes;
    integer n_orders;
};

/* Numbers of room that an observer needs. */
integer following_room(integer n_axes, integer n_orders);

/* One sample. samples has a row of motor angles, one of the motion's own set-points and one of the tip's levers in m. heard
 * is the tip's acceleration in m/s^2, and 1 where it was measured. */
void follow_step(const struct following *f, const real *samples, const real heard[2]);

#endif
