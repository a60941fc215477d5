/* A gear that changes: its transmission error over time, wear, load, direction and temperature.
 *
 * The plant's amplitudes and phases are those of the instant. A gear that changes has them put anew after each control period,
 * from the values that it left the factory with and from what it has gone through since; over the period they are held.
 */
#pragma once

#include "axis.h"

/* Orders 1, 2 and 4 come before the others. */
enum { NAMED_LINES = 3, LINES = 7 };

/* Time constant with which the error follows load and direction: a reversal does not throw the arm. */
#define SMOOTHING_S 0.05

/* Motor speed at which the direction has become 0.7 of a whole one. */
#define TURNING_RAD_S 1.0

/* How the transmission error of an axis changes; a number for each order, 1, 2 and 4 first. */
struct change {
    real is_changing;
    real a_rad[LINES];
    real phi_rad[LINES];
    real step_rad[LINES];
    real step_s[LINES];
    real drift_rad_s[LINES];
    real growth_per_s[LINES];
    real growth_per_rad[LINES];
    real load_per_nm[LINES];
    real load_rad_nm[LINES];
    real direction_part[LINES];
    real direction_rad[LINES];
    real warmth_per_k[LINES];
    real warmth_rad_k[LINES];
    real reference_c;
    real ambient_c;
    real resistance_k_w;
    real thermal_constant_s;
};

/* What a gear has gone through: time with the brake open, way of the motor, smoothed load and direction, temperature. */
struct past {
    integer operating_periods;
    real operating_s;
    real turned_rad;
    real load_nm;
    real direction;
    real temperature_c;
};

/* What a gear goes through in a control period.
 *
 *     t_L' = (t_g - t_L)/T_s,    s' = (w/sqrt(w^2 + w_0^2) - s)/T_s
 *     H' = (H_a + R (t_f(w) + D_m w) w - H)/T_th
 *
 * each exact for a right-hand side that is held over the period. state is that at the end of the period; braked: the brake
 * holds the motor, then nothing wears. */
void go_through(
    const struct change *change, struct past *past, const struct plant *plant, const struct plant_state *state, int braked,
    real period_s);

/* Put the transmission error as it is now into the axis' constants.
 *
 *     A_k = A_k0 (1 + g t + w n + a_L t_L + a_s s + a_H (H - H_0)), not below 0
 *     phi_k = phi_k0 + step (from t_s on) + d t + b_L t_L + b_s s + b_H (H - H_0) */
void put_error(const struct change *change, const struct past *past, struct plant *plant);
