#include "follow.h"
#include "plant_emulator/physics/integration.h"

void follow(
    integer periods, real period_s, integer substeps, struct axis *axes, integer count, integer samples,
    const real *set_points, const real *encoder, const real *noise, real *trace)
{
    for (integer row = 0; row < count; row++) { /* an axis feels nothing of the others: each goes through all periods alone */
        struct axis *axis = &axes[row];
        struct motion *m = &axis->motion;
        struct plant_state *mechanics = &axis->plant_state;
        struct constants k;
        struct grid_point near;
        const real e1 = encoder[4 * row], phi1 = encoder[4 * row + 1], e2 = encoder[4 * row + 2], phi2 = encoder[4 * row + 3];
        const real at_home = e1 * COS(phi1) + e2 * COS(phi2); /* the drive counts from what it saw there */
        find_constants(&axis->plant, &k);
        find_nearest(&k, mechanics, &near);
        for (integer i = 0; i < samples; i++) {
            for (integer period = 0; period < periods; period++) {
                const real angle = mechanics->motor_angle_rad;
                real shown = angle + noise[(row * samples + i) * periods + period];
                if (e1 != 0.0 || e2 != 0.0) {
                    shown += e1 * COS(angle + phi1) + e2 * COS(2.0 * angle + phi2) - at_home;
                }
                if (period == 0) {
                    real *at = trace + TRACE_COLUMNS * (i * count + row);
                    at[TRACE_COUNTS] = measured_counts(shown, m->counts_per_rad);
                    at[TRACE_ARM_ANGLE] = mechanics->arm_angle_rad;
                    at[TRACE_ARM_SPEED] = mechanics->arm_speed_rad_s;
                    at[TRACE_ARM_ACCELERATION] = mechanics->arm_acceleration_rad_s2;
                    at[TRACE_TORQUE] = m->torque_nm;
                    m->previous_counts = m->target_counts;
                    m->target_counts = set_points[i * count + row];
                    m->elapsed_periods = 0;
                }
                const real torque = command(axis, shown, period_s);
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
