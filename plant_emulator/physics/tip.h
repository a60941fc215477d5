/* Acceleration at the tip, and what its accelerometer shows of it. */
#pragma once

#include "plant_emulator/physics/sensing.h"

/* Samples of noise that are drawn at once: a generator's call costs more than its numbers. */
enum { NOISE_SAMPLES = 256 };

/* Links of the planar chain of shoulder, elbow and wrist. */
enum { CHAIN_LINKS = 3 };

/* What the axes move. An axis that alone is free moves the sensor on its lever, as in the single-axis experiments; else the chain
 * of the geometry moves it, or, without one, all levers together. */
struct tip {
    const real *levers_m; /* of each axis */
    integer has_chain;
    integer chain_rows[CHAIN_LINKS]; /* of shoulder, elbow and wrist */
    real home_rad[CHAIN_LINKS];      /* their joint angles where the motors are at home */
    real upper_arm_m;
    real forearm_m;
    real forearm_offset_m; /* across the forearm */
    real tool_m;
    real *moved; /* room for angle, speed and acceleration of each arm */
};

/* Errors, noise, resolution and range of the accelerometer. */
struct tip_sensor {
    integer is_mixed;                 /* the sensitivities are not those of an ideal sensor */
    real mixing[CHANNELS][CHANNELS];  /* what each channel reads of X, Y and Z */
    real noise_m_s2;      /* standard deviation of each sample */
    real resolution_m_s2; /* step of the output; 0 for none */
    real range_m_s2;      /* at which it saturates */
    integer next;         /* the draw of the next sample; NOISE_SAMPLES once all are used */
    real draws[NOISE_SAMPLES][CHANNELS];
};

/* Acceleration (X, Y, Z) of the tip in m/s^2, without gravity.
 *
 * moved holds angle, speed and acceleration of the arm of each of count axes; single is the row that alone is free, or -1.
 *
 *     on a lever:  (-L w^2, 0, L w')        of a chain:  sum over links of alpha'' y x r - alpha'^2 r
 *
 * with the links' angles alpha above the horizontal and their vectors r. */
void tip_acceleration(const struct tip *tip, const real *moved, integer count, integer single, real *acceleration);

/* tip_acceleration at some instants: moved is one after the other, and so are the accelerations. */
void tip_trace(
    const struct tip *tip, const real *moved, integer instants, integer count, integer single, real *accelerations);

/* What the sensor shows of an acceleration: with its errors and noise, in its steps and within its range. next must not be NOISE_SAMPLES. */
void sample_tip(struct tip_sensor *sensor, const real *acceleration, real *shown);

/* sample_tip for some samples, for which there is noise; both are rows of CHANNELS. */
void sample_tips(struct tip_sensor *sensor, integer samples, const real *accelerations, real *shown);
