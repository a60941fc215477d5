/* A group of axes over some control periods: one, or up to four in lock-step, see lanes.h. */
#pragma once

#include "period.h"
#include "plant_emulator/physics/rates.h"

enum { POSE_NUMBERS = sizeof(struct pose) / sizeof(real), STATE_NUMBERS = sizeof(struct axis_state) / sizeof(real) };

/* Advance count axes, no more than LANES, by some control periods. */
INLINED LANED void advance_group(integer periods, real period_s, integer substeps, const struct advancing *axes, int count)
{
    struct group group = {0};
    struct lane_pose pose;
    struct lane_state x, slope;
    lanes torque = EVERY(lanes, 0.0);
    marks braked = EVERY(marks, 0);
    for (int lane = 0; lane < LANES; lane++) { /* lanes that are left over repeat the first axis */
        const struct advancing *one = &axes[lane < count ? lane : 0];
        struct axis *axis = one->axis;
        struct prepared *mine = one->prepared;
        prepare(&axis->plant, &axis->plant_state, mine);
        const struct axis_state here = state_of(&axis->plant_state);
        join(&group, lane, &mine->constants, &mine->near);
        gather(&pose.theta_m, &mine->pose.theta_m, POSE_NUMBERS, lane);
        gather(&x.theta_m, &here.theta_m, STATE_NUMBERS, lane);
    }
    for (integer period = 0; period < periods; period++) {
        for (int lane = 0; lane < count; lane++) {
            LANE(torque, lane) = command(axes[lane].axis, period_s);
            LANE(braked, lane) = axes[lane].axis->motion.mode == BRAKED ? -1 : 0;
        }
        run_period(&group, &pose, &x, torque, braked, period_s, substeps);
        for (int lane = 0; lane < count; lane++) {
            struct axis *axis = axes[lane].axis;
            struct prepared *mine = axes[lane].prepared;
            struct axis_state here;
            scatter(&here.theta_m, &x.theta_m, STATE_NUMBERS, lane);
            put_back(&axis->plant_state, &here);
            draw_noise(&axis->encoder);
            if (axis->change.is_changing > 0.0) {
                age(axis, period_s);
                scatter(&mine->pose.theta_m, &pose.theta_m, POSE_NUMBERS, lane);
                prepare(&axis->plant, &axis->plant_state, mine);
                join(&group, lane, &mine->constants, &mine->near);
                gather(&pose.theta_m, &mine->pose.theta_m, POSE_NUMBERS, lane);
            }
        }
        rates(&group, &pose, EVERY(lanes, 0.0), EVERY(marks, -1), &x, &slope);
        for (int lane = 0; lane < count; lane++) {
            struct plant_state *mechanics = &axes[lane].axis->plant_state;
            real *shown = axes[lane].trace;
            mechanics->arm_acceleration_rad_s2 = LANE(slope.w_l, lane);
            if (shown != 0) {
                shown += axes[lane].stride * period;
                shown[0] = mechanics->arm_angle_rad;
                shown[1] = mechanics->arm_speed_rad_s;
                shown[2] = mechanics->arm_acceleration_rad_s2;
            }
        }
    }
    for (int lane = 0; lane < count; lane++) {
        struct motion *m = &axes[lane].axis->motion;
        scatter(&axes[lane].prepared->pose.theta_m, &pose.theta_m, POSE_NUMBERS, lane);
        m->wake = m->trip != 0 || m->event != 0;
    }
}
