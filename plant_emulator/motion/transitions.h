/* Transitions of an axis under torque to another mode, or to a stop, without a jump of the torque. */
#pragma once

#include "record.h"

/* Turn to a ramp to rest from the present speed, without a jump of the torque.
 *
 * The position loop runs v/K_pp behind its reference, so the ramp starts that far ahead of the motor. So that the torque does not
 * jump, the integrator absorbs the torque offset, or in torque modes the whole torque. In torque modes the filters restart too:
 * they have been tracking a torque that was not applied.
 *
 * An infinite deceleration brakes with all the torque that the limits allow, and then holds the motor where it is; what the
 * integrator has learnt of the load it keeps until then, but for a torque mode's. */
void begin_stop(struct axis *axis, real deceleration_rad_s2);

/* Turn from one mode to another while the motor is under torque, from its present motion and without a jump of the torque.
 *
 * Profiles go on from the present demand, cyclic modes from what is measured. The targets become what the motor does now: where
 * it stands (POSITION), or can stop (PROFILE), its speed, its torque; the owner then gives new ones. The integrator takes what
 * the new law would have the torque jump by, and gives it up with its own time constant. mode is neither BRAKED nor STOPPING,
 * which begin_stop enters. */
void begin_mode(struct axis *axis, integer mode);

/* All the torque against the motion until it has ended, or turned round; the loop then holds the motor where it is.
 *
 * stop_periods counts the periods without progress: limits may leave too little torque for a stop. previous_integral_nm is the
 * integrator before this period. Returns the torque in N m. */
real brake_hard(struct axis *axis, real previous_integral_nm);
