#include "articulated.h"

/* Frame, position and screw of a link from those of the one before. */
static void locate(const struct link *before, struct link *link, real angle)
{
    const real c = COS(angle), s = SIN(angle);
    for (int r = 0; r < 3; r++) {
        const real b0 = before->frame[r][0], b1 = before->frame[r][1], b2 = before->frame[r][2];
        const real x = b0 * link->turn[0][0] + b1 * link->turn[1][0] + b2 * link->turn[2][0];
        const real y = b0 * link->turn[0][1] + b1 * link->turn[1][1] + b2 * link->turn[2][1];
        link->frame[r][0] = c * x + s * y;
        link->frame[r][1] = c * y - s * x;
        link->frame[r][2] = b0 * link->turn[0][2] + b1 * link->turn[1][2] + b2 * link->turn[2][2];
        link->position[r] = before->position[r] + (b0 * link->origin[0] + b1 * link->origin[1] + b2 * link->origin[2]);
    }
    const real ax = link->frame[0][2], ay = link->frame[1][2], az = link->frame[2][2];
    const real px = link->position[0], py = link->position[1], pz = link->position[2];
    link->screw[0] = ax;
    link->screw[1] = ay;
    link->screw[2] = az;
    link->screw[3] = py * az - pz * ay;
    link->screw[4] = pz * ax - px * az;
    link->screw[5] = px * ay - py * ax;
}

/* Velocity of a link, and the acceleration v_before x (screw q') that it has without any of its joint's. */
static void move(const struct link *before, struct link *link, real speed)
{
    const real wx = before->velocity[0], wy = before->velocity[1], wz = before->velocity[2];
    const real vx = before->velocity[3], vy = before->velocity[4], vz = before->velocity[5];
    const real ax = link->screw[0] * speed, ay = link->screw[1] * speed, az = link->screw[2] * speed;
    const real bx = link->screw[3] * speed, by = link->screw[4] * speed, bz = link->screw[5] * speed;
    link->velocity[0] = wx + ax;
    link->velocity[1] = wy + ay;
    link->velocity[2] = wz + az;
    link->velocity[3] = vx + bx;
    link->velocity[4] = vy + by;
    link->velocity[5] = vz + bz;
    link->drift[0] = wy * az - wz * ay;
    link->drift[1] = wz * ax - wx * az;
    link->drift[2] = wx * ay - wy * ax;
    link->drift[3] = (wy * bz - wz * by) + (vy * az - vz * ay);
    link->drift[4] = (wz * bx - wx * bz) + (vz * ax - vx * az);
    link->drift[5] = (wx * by - wy * bx) + (vx * ay - vy * ax);
}

/* Inertia of a link alone, and its bias force v x* (body v). */
static void weigh(struct link *link)
{
    const real m = link->mass_kg;
    const real c0 = link->centre[0], c1 = link->centre[1], c2 = link->centre[2];
    const real x = link->position[0] + (link->frame[0][0] * c0 + link->frame[0][1] * c1 + link->frame[0][2] * c2);
    const real y = link->position[1] + (link->frame[1][0] * c0 + link->frame[1][1] * c1 + link->frame[1][2] * c2);
    const real z = link->position[2] + (link->frame[2][0] * c0 + link->frame[2][1] * c1 + link->frame[2][2] * c2);
    real(*body)[6] = link->body;
    for (int r = 0; r < 3; r++) {
        const real f0 = link->frame[r][0], f1 = link->frame[r][1], f2 = link->frame[r][2];
        const real t0 = f0 * link->inertia[0][0] + f1 * link->inertia[1][0] + f2 * link->inertia[2][0];
        const real t1 = f0 * link->inertia[0][1] + f1 * link->inertia[1][1] + f2 * link->inertia[2][1];
        const real t2 = f0 * link->inertia[0][2] + f1 * link->inertia[1][2] + f2 * link->inertia[2][2];
        for (int k = 0; k < 3; k++) {
            body[r][k] = t0 * link->frame[k][0] + t1 * link->frame[k][1] + t2 * link->frame[k][2];
            body[3 + r][3 + k] = 0.0;
            body[r][3 + k] = 0.0;
        }
    }
    const real mx = m * x, my = m * y, mz = m * z;
    body[0][0] += my * y + mz * z;
    body[1][1] += mx * x + mz * z;
    body[2][2] += mx * x + my * y;
    body[0][1] -= mx * y;
    body[0][2] -= mx * z;
    body[1][2] -= my * z;
    body[1][0] = body[0][1];
    body[2][0] = body[0][2];
    body[2][1] = body[1][2];
    body[0][4] = -mz;
    body[0][5] = my;
    body[1][3] = mz;
    body[1][5] = -mx;
    body[2][3] = -my;
    body[2][4] = mx;
    for (int r = 0; r < 3; r++) {
        body[3 + r][3 + r] = m;
        for (int k = 0; k < 3; k++) {
            body[3 + r][k] = body[k][3 + r];
        }
    }
    const real wx = link->velocity[0], wy = link->velocity[1], wz = link->velocity[2];
    const real vx = link->velocity[3], vy = link->velocity[4], vz = link->velocity[5];
    const real fx = m * vx + (wy * mz - wz * my), fy = m * vy + (wz * mx - wx * mz), fz = m * vz + (wx * my - wy * mx);
    const real nx = body[0][0] * wx + body[0][1] * wy + body[0][2] * wz + (my * vz - mz * vy);
    const real ny = body[1][0] * wx + body[1][1] * wy + body[1][2] * wz + (mz * vx - mx * vz);
    const real nz = body[2][0] * wx + body[2][1] * wy + body[2][2] * wz + (mx * vy - my * vx);
    link->force[0] = (wy * nz - wz * ny) + (vy * fz - vz * fy);
    link->force[1] = (wz * nx - wx * nz) + (vz * fx - vx * fz);
    link->force[2] = (wx * ny - wy * nx) + (vx * fy - vy * fx);
    link->force[3] = wy * fz - wz * fy;
    link->force[4] = wz * fx - wx * fz;
    link->force[5] = wx * fy - wy * fx;
}

/* Add to the link before what it feels of this one: what its joint, free to turn, does not take up. */
static void hand_on(struct link *before, struct link *link, real torque, int is_on_base)
{
    real about = 0.0, rest = torque;
    for (int r = 0; r < 6; r++) {
        real u = 0.0;
        for (int k = 0; k < 6; k++) {
            u += link->body[r][k] * link->screw[k];
        }
        link->carried[r] = u;
        about += link->screw[r] * u;
        rest -= link->screw[r] * link->force[r];
    }
    link->about = about;
    link->rest = rest;
    if (is_on_base) {
        return;
    }
    const real per_about = 1.0 / about;
    const real ahead = rest * per_about;
    for (int r = 0; r < 6; r++) {
        const real scaled = link->carried[r] * per_about;
        real felt = link->force[r] + link->carried[r] * ahead;
        for (int k = 0; k < 6; k++) {
            const real element = link->body[r][k] - scaled * link->carried[k];
            before->body[r][k] += element;
            felt += element * link->drift[k];
        }
        before->force[r] += felt;
    }
}

/* Acceleration of a link; returns that of its joint. */
static real accelerate(const struct link *before, struct link *link)
{
    real rest = link->rest;
    for (int r = 0; r < 6; r++) {
        link->acceleration[r] = before->acceleration[r] + link->drift[r];
        rest -= link->carried[r] * link->acceleration[r];
    }
    const real turning = rest / link->about;
    for (int r = 0; r < 6; r++) {
        link->acceleration[r] += link->screw[r] * turning;
    }
    return turning;
}

void accelerations(struct link *links, integer count, real *joints)
{
    for (integer i = 0; i < count; i++) {
        locate(&links[i], &links[i + 1], joints[JOINT_ANGLE * count + i]);
        move(&links[i], &links[i + 1], joints[JOINT_SPEED * count + i]);
        weigh(&links[i + 1]);
    }
    for (integer i = count - 1; i >= 0; i--) {
        hand_on(&links[i], &links[i + 1], joints[JOINT_TORQUE * count + i], i == 0);
    }
    for (integer i = 0; i < count; i++) {
        joints[JOINT_ACCELERATION * count + i] = accelerate(&links[i], &links[i + 1]);
    }
}

void holding_torques(struct link *links, integer count, real *joints)
{
    for (integer i = 0; i < count; i++) {
        locate(&links[i], &links[i + 1], joints[JOINT_ANGLE * count + i]);
    }
    const real *up = links[0].acceleration + 3;
    const real gx = up[0], gy = up[1], gz = up[2];
    real fx = 0.0, fy = 0.0, fz = 0.0, nx = 0.0, ny = 0.0, nz = 0.0;
    for (integer i = count; i > 0; i--) {
        const struct link *link = &links[i];
        const real m = link->mass_kg, c0 = link->centre[0], c1 = link->centre[1], c2 = link->centre[2];
        const real x = link->position[0] + (link->frame[0][0] * c0 + link->frame[0][1] * c1 + link->frame[0][2] * c2);
        const real y = link->position[1] + (link->frame[1][0] * c0 + link->frame[1][1] * c1 + link->frame[1][2] * c2);
        const real z = link->position[2] + (link->frame[2][0] * c0 + link->frame[2][1] * c1 + link->frame[2][2] * c2);
        fx += m * gx;
        fy += m * gy;
        fz += m * gz;
        nx += m * (y * gz - z * gy);
        ny += m * (z * gx - x * gz);
        nz += m * (x * gy - y * gx);
        const real turning = link->screw[0] * nx + link->screw[1] * ny + link->screw[2] * nz;
        joints[JOINT_TORQUE * count + i - 1] = turning + (link->screw[3] * fx + link->screw[4] * fy + link->screw[5] * fz);
    }
}
