/* Accelerations of an arm of rigid links under the torques of its joints: the articulated-body algorithm.
 *
 * All vectors are spatial ones in the frame of the base, at its origin: the angular part first, then the linear one. So no
 * matrix is carried from link to link, and inertias add up as they are. Each link's frame is turned so that its joint is the z
 * axis. In the arrays of joints, every row has a number for each link, from the base on.
 *
 * Source: R. Featherstone, Rigid Body Dynamics Algorithms, Springer 2008, chapters 2 and 7.
 */
#pragma once

#include "hil/control/real.h"

/* A link: constants, then where it is and what acts on it as the last evaluation left it. Row 0 of an array is the base, which
 * falls upwards: so gravity acts on every link. */
struct link {
    integer row;   /* of the link's axis among the axes of a robot */
    real home_rad; /* the joint's angle where the axis' arm angle is 0 */
    real turn[3][3]; /* rotation and origin of the joint in the link before it, at an angle of 0 */
    real origin[3];
    real mass_kg;
    real centre[3]; /* centre of mass, and inertia about it, in the link's frame */
    real inertia[3][3];
    real frame[3][3];
    real position[3];
    real screw[6]; /* velocity of the link per rad/s of its joint */
    real velocity[6];
    real drift[6];   /* the acceleration that velocities make */
    real body[6][6]; /* inertia and bias force of the link with all that it carries */
    real force[6];
    real carried[6]; /* U = body screw */
    real about;      /* D = screw U */
    real rest;       /* u, the torque that is left to accelerate the joint */
    real acceleration[6];
};

/* Rows of the array of joints: angles in rad, speeds, torques in N m, accelerations. */
enum { JOINT_ANGLE, JOINT_SPEED, JOINT_TORQUE, JOINT_ACCELERATION, JOINT_ROWS };

/* Accelerations of an arm's joints under their torques: JOINT_ACCELERATION is written. links has count + 1 rows. */
void accelerations(struct link *links, integer count, real *joints);

/* Torques that hold an arm at rest against gravity: JOINT_TORQUE is written, JOINT_ANGLE alone is read. */
void holding_torques(struct link *links, integer count, real *joints);
