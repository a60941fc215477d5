#include "tip.h"

/* A link that turns: its vector (along, up), its rate and its change; the acceleration of its end against its beginning. */
static void turn_link(real along, real up, real rate, real change, real *x, real *z)
{
    *x = -change * up - rate * rate * along;
    *z = change * along - rate * rate * up;
}

static void chain_acceleration(const struct tip *tip, const real *moved, real *acceleration)
{
    const real *shoulder = moved + 3 * tip->chain_rows[0], *elbow = moved + 3 * tip->chain_rows[1];
    const real *wrist = moved + 3 * tip->chain_rows[2];
    real x, z, more_x, more_z;
    real alpha = 0.5 * PI - (tip->home_rad[0] + shoulder[0]), rate = -shoulder[1], change = -shoulder[2];
    turn_link(tip->upper_arm_m * COS(alpha), tip->upper_arm_m * SIN(alpha), rate, change, &x, &z);
    alpha += tip->home_rad[1] + elbow[0];
    rate += elbow[1];
    change += elbow[2];
    const real cosine = COS(alpha), sine = SIN(alpha), length = tip->forearm_m, width = tip->forearm_offset_m;
    turn_link(length * cosine - width * sine, length * sine + width * cosine, rate, change, &more_x, &more_z);
    x += more_x;
    z += more_z;
    alpha += tip->home_rad[2] + wrist[0];
    rate += wrist[1];
    change += wrist[2];
    turn_link(tip->tool_m * COS(alpha), tip->tool_m * SIN(alpha), rate, change, &more_x, &more_z);
    acceleration[0] = x + more_x;
    acceleration[1] = 0.0;
    acceleration[2] = z + more_z;
}

void tip_acceleration(const struct tip *tip, const real *moved, integer count, integer single, real *acceleration)
{
    acceleration[1] = 0.0;
    if (single >= 0) {
        const real lever = tip->levers_m[single], speed = moved[3 * single + 1];
        acceleration[0] = -lever * speed * speed;
        acceleration[2] = lever * moved[3 * single + 2];
    } else if (tip->has_chain) {
        chain_acceleration(tip, moved, acceleration);
    } else {
        real inwards = 0.0, tangential = 0.0;
        for (integer row = 0; row < count; row++) {
            const real lever = tip->levers_m[row], speed = moved[3 * row + 1];
            inwards += lever * speed * speed;
            tangential += lever * moved[3 * row + 2];
        }
        acceleration[0] = -inwards;
        acceleration[2] = tangential;
    }
}

void tip_trace(
    const struct tip *tip, const real *moved, integer instants, integer count, integer single, real *accelerations)
{
    for (integer i = 0; i < instants; i++) {
        tip_acceleration(tip, moved + 3 * i * count, count, single, accelerations + CHANNELS * i);
    }
}

void sample_tip(struct tip_sensor *sensor, const real *acceleration, real *shown)
{
    const real *draw = sensor->draws[sensor->next++], step = sensor->resolution_m_s2, reach = sensor->range_m_s2;
    for (integer channel = 0; channel < CHANNELS; channel++) {
        real value = acceleration[channel];
        if (sensor->is_mixed != 0) {
            const real *read = sensor->mixing[channel];
            value = read[0] * acceleration[0] + read[1] * acceleration[1] + read[2] * acceleration[2];
        }
        value += sensor->noise_m_s2 * draw[channel];
        if (step > 0.0) {
            value = step * round_down(value / step + 0.5);
        }
        shown[channel] = least(reach, most(-reach, value));
    }
}

void sample_tips(struct tip_sensor *sensor, integer samples, const real *accelerations, real *shown)
{
    for (integer i = 0; i < samples; i++) {
        sample_tip(sensor, accelerations + CHANNELS * i, shown + CHANNELS * i);
    }
}
