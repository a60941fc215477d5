/* The variable notch filter, which follows the motor speed, and a filter with fixed coefficients.
 *
 *     F_n(s) = (s^2 + 2 zeta_rn w_rn s + w_rn^2) / (s^2 + 2 zeta_rd w_rd s + w_rd^2) * w_rd^2 / w_rn^2,    F_n(0) = 1
 *     w_rn = 2 pi k f_m,    w_rd = w_rn + w_d
 *
 * Source: the paper, eq. (6), (7) and Table 3; bilinear transform from its section 5.1.
 */
#ifndef HIL_NOTCH_H
#define HIL_NOTCH_H

#include "real.h"

/* zeta_rd over the motor speed: no filter; zeta_rdth inside [f_s, f_e]; a trapezoid that rises and falls over ramp_rps.
 * NOTCH_FIXED is a second-order section with given coefficients at every speed, as drives without the variable notch have it. */
enum { NOTCH_OFF, NOTCH_SWITCHED, NOTCH_TRAPEZOID, NOTCH_FIXED };

/* Filters per axis, in series: one per harmonic order of the transmission error. */
enum { NOTCHES = 2 };

/* Parameters of one filter. */
struct notch_config {
    integer mode;
    real order;            /* k */
    real start_rps;        /* f_s */
    real end_rps;          /* f_e */
    real offset_hz;        /* w_d / 2 pi */
    real zeta_rn;          /* damping of the zeros */
    real zeta_rdth;        /* damping of the poles inside [f_s, f_e] */
    real hysteresis_rps;   /* distance by which the speed must leave [f_s, f_e] before the filter is taken out */
    real speed_lowpass_hz; /* corner of the low-pass that gives f_m from the measured speed */
    real ramp_rps;         /* width of either slope of the trapezoid */
    real b0;               /* coefficients of a fixed filter */
    real b1;
    real b2;
    real a1;
    real a2;
};

/* Memory of one filter. */
struct notch_state {
    real s1; /* delays of the transposed direct form II */
    real s2;
    real speed_rps;    /* f_m, the low-passed speed */
    real mean_nm;      /* the low-passed torque */
    integer active;    /* 1 while the filter acts */
    real frequency_hz; /* zero frequency at present */
    real zeta_rd;      /* pole damping at present */
};

/* Corner of the low-pass that gives the torque on which a filter starts.
 *
 * A coarse encoder makes the torque command noisy. Started on one noisy sample the filter takes that sample's error for a step:
 * 0.013 mm at the tip with 13 bits and no transmission error at all, 0.003 mm from the low-passed torque. Corners from 10 to
 * 50 Hz do equally well; below 5 Hz the lag of the mean shows, 0.005 mm and more. */
#define START_LOWPASS_HZ 20.0

/* Coefficients b0, b1, b2, a1, a2 of the notch, by the bilinear transform without prewarping:
 *
 *     s = 2/T (1 - 1/z)/(1 + 1/z),    y_n = b0 u_n + b1 u_n-1 + b2 u_n-2 - a1 y_n-1 - a2 y_n-2
 *
 * zero_hz and pole_hz are w_rn / 2 pi and w_rd / 2 pi. */
void notch_coefficients(real zero_hz, real pole_hz, real zeta_rn, real zeta_rd, real period_s, real coefficients[5]);

/* Weight of the filter at a speed, 0 to 1: always 1 where it switches, the height of the trapezoid where it has slopes. */
real notch_weight(integer mode, real speed_rps, real start_rps, real end_rps, real ramp_rps);

/* Fraction of the new sample in a first-order low-pass x += blend (u - x); 1 where the corner is beyond reach. */
real lowpass_blend(real corner_hz, real period_s);

/* One sample of the filter: follow the speed, switch with hysteresis, filter the torque command u in N m. A fixed one is
 * always on.
 *
 * f_m = |w_m| / 2 pi behind a first-order low-pass; w_rn = 2 pi k f_m; w_rd = w_rn + w w_d and
 * zeta_rd = zeta_rn + w (zeta_rdth - zeta_rn) with the weight w of notch_weight. At w = 0 poles and zeros are equal: no filter,
 * hence no step at the trapezoid's feet.
 *
 * The filter runs in transposed direct form II and starts DC-consistent, s2 = (b2 - a2) u', s1 = (b1 - a1) u' + s2: as if the
 * low-passed torque u' had stood there for ever. Its high-frequency gain is (w_rd/w_rn)^2 > 1, so any other start would kick the
 * arm. speed_rad_s is the measured motor speed, behind the velocity low-pass. Returns the filtered torque command in N m. */
real notch_step(const struct notch_config *config, struct notch_state *state, real period_s, real speed_rad_s, real u);

#endif
