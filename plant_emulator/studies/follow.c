#include "follow.h"
#include "plant_emulator/physics/integration.h"

void follow(
    integer periods, real period_s, integer substeps, struct axis *axes, integer count, integer samples,
    const real *set_points, const real *noise, real *trace)
{
    for (integer row = 0; row < count; row++) { /* an axis feels nothing of the others: each goes through all periods alone */
        struct axis *axis = &axes[row];
        struct motion *m = &axis->motion;
        struct plant_state *mechanics = &axis->plant_state;
        struct constants k;
        struct grid_point near;
        find_constants(&axis->plant, &k);
        find_nearest(&k, mechanics, &near);
        for (integer i = 0; i < samples; i++) {
            for (integer period = 0; period < periods; period++) {
                axis->encoder.present_rad = noise[(row * samples + i) * periods + period];
                if (period == 0) {
                    real *at = trace + TRACE_COLUMNS * (i * count + row);
                    at[TRACE_COUNTS] = axis_counts(axis);
                    at[TRACE_ARM_ANGLE] = mechanics->arm_angle_rad;
                    at[TRACE_ARM_SPEED] = mechanics->arm_speed_rad_s;
                    at[TRACE_ARM_ACCELERATION] = mechanics->arm_acceleration_rad_s2;
                    at[TRACE_TORQUE] = m->torque_nm;
                    m->previous_counts = m->target_counts;
                    m->target_counts = set_points[i * count + row];
                    m->elapsed_periods = 0;
                }
                const real torque = command(axis, period_s);
                plant_period(&k, &near, mechanics, torque, 0, period_s, substeps);
                if (axis->change.is_changing > 0.0) {
                    age(axis, period_s);
                    find_constants(&axis->plant, &k);
                    find_nearest(&k, mechanics, &near);
                }
            }
            mechanics->arm_acceleration_rad_s2 = arm_acceleration(&k, mechanics, &near);
        }
    }
}
