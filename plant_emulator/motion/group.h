/* A group of axes over some control periods: one, or up to four in lock-step, see lanes.h. */
#ifndef PLANT_GROUP_H
#define PLANT_GROUP_H

#include "period.h"
#include "plant_emulator/physics/rates.h"

enum { POSE_NUMBERS = sizeof(struct pose) / sizeof(real), STATE_NUMBERS = sizeof(struct axis_state) / sizeof(real) };

/* Advance count axes, no more than LANES; the arms' states go to trace, one row after stride numbers. */
INLINED LANED void advance_group(
    integer periods, real period_s, integer substeps, struct axis *axes, struct prepared *prepared, integer count, real *trace,
    integer stride)
{
    struct group group = {0};
    struct lane_pose pose;
    struct lane_state x, slope;
    lanes torque = EVERY(lanes, 0.0);
    marks braked = EVERY(marks, 0);
    for (int lane = 0; lane < LANES; lane++) { /* lanes that are left over repeat the first axis */
        struct prepared *mine = &prepared[lane < count ? lane : 0];
        struct axis *axis = &axes[lane < count ? lane : 0];
        prepare(&axis->plant, &axis->plant_state, mine);
        const struct axis_state here = state_of(&axis->plant_state);
        join(&group, lane, &mine->constants, &mine->near);
        gather(&pose.theta_m, &mine->pose.theta_m, POSE_NUMBERS, lane);
        gather(&x.theta_m, &here.theta_m, STATE_NUMBERS, lane);
    }
    for (integer period = 0; period < periods; period++) {
        for (int lane = 0; lane < count; lane++) {
            LANE(torque, lane) = command(&axes[lane], period_s);
            LANE(braked, lane) = axes[lane].motion.mode == BRAKED ? -1 : 0;
        }
        run_period(&group, &pose, &x, torque, braked, period_s, substeps);
        const int is_shown = trace != 0 || period == periods - 1;
        if (is_shown) {
            rates(&group, &pose, EVERY(lanes, 0.0), EVERY(marks, -1), &x, &slope);
        }
        for (int lane = 0; lane < count; lane++) {
            struct axis *axis = &axes[lane];
            struct prepared *mine = &prepared[lane];
            struct plant_state *mechanics = &axis->plant_state;
            struct axis_state here;
            scatter(&here.theta_m, &x.theta_m, STATE_NUMBERS, lane);
            put_back(mechanics, &here);
            draw_noise(&axis->encoder);
            if (axis->change.is_changing > 0.0) {
                age(axis, period_s);
                scatter(&mine->pose.theta_m, &pose.theta_m, POSE_NUMBERS, lane);
                prepare(&axis->plant, mechanics, mine);
                join(&group, lane, &mine->constants, &mine->near);
                gather(&pose.theta_m, &mine->pose.theta_m, POSE_NUMBERS, lane);
            }
            if (is_shown) {
                mechanics->arm_acceleration_rad_s2 = LANE(slope.w_l, lane);
            }
            if (trace != 0) {
                real *shown = trace + stride * period + 3 * lane;
                shown[0] = mechanics->arm_angle_rad;
                shown[1] = mechanics->arm_speed_rad_s;
                shown[2] = mechanics->arm_acceleration_rad_s2;
            }
        }
    }
    for (int lane = 0; lane < count; lane++) {
        struct motion *m = &axes[lane].motion;
        scatter(&prepared[lane].pose.theta_m, &pose.theta_m, POSE_NUMBERS, lane);
        m->wake = m->trip != 0 || m->event != 0;
    }
}

#endif
