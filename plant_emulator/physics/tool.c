#include "tool.h"

void tool_motion(const struct link *links, integer number, const real *tool, real *moved)
{
    const struct link *last = &links[number];
    const real *w = last->velocity, *a = last->acceleration, *up = links[0].acceleration + 3; /* -g: links fall upwards */
    for (int r = 0; r < 3; r++) {
        moved[r] = last->position[r];
        for (int k = 0; k < 3; k++) {
            moved[r] += last->frame[r][k] * tool[k];
        }
    }
    const real x = moved[0], y = moved[1], z = moved[2];
    const real vx = w[3] + (w[1] * z - w[2] * y), vy = w[4] + (w[2] * x - w[0] * z), vz = w[5] + (w[0] * y - w[1] * x);
    moved[3] = vx;
    moved[4] = vy;
    moved[5] = vz;
    const real fx = a[3] + (a[1] * z - a[2] * y) + (w[1] * vz - w[2] * vy);
    const real fy = a[4] + (a[2] * x - a[0] * z) + (w[2] * vx - w[0] * vz);
    const real fz = a[5] + (a[0] * y - a[1] * x) + (w[0] * vy - w[1] * vx);
    moved[6] = fx - up[0];
    moved[7] = fy - up[1];
    moved[8] = fz - up[2];
    for (int k = 0; k < 3; k++) {
        const real along = last->frame[0][k] * fx + last->frame[1][k] * fy + last->frame[2][k] * fz;
        for (int r = 0; r < 3; r++) {
            moved[9 + r] = tool[3 * (1 + k) + r] * along + (k > 0 ? moved[9 + r] : 0.0);
        }
    }
}

void feel(const struct link *links, integer count, const real *sensor, const real *tip, real *room, real *felt)
{
    const real at = sensor[12];
    if (!(at >= 1.0 && at <= (real)count)) {
        for (int r = 0; r < 3; r++) {
            felt[r] = tip[r];
        }
        return;
    }
    const integer number = (integer)at;
    tool_motion(links, number, sensor, room);
    const struct link *link = &links[number];
    const real *up = links[0].acceleration + 3;
    for (int r = 0; r < 3; r++) {
        felt[r] = 0.0;
    }
    for (int k = 0; k < 3; k++) {
        real along = 0.0;
        for (int r = 0; r < 3; r++) {
            along += link->frame[r][k] * (room[6 + r] + sensor[13] * up[r]);
        }
        for (int r = 0; r < 3; r++) {
            felt[r] += sensor[3 * (1 + k) + r] * along;
        }
    }
}
