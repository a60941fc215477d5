/* Limits, windows and inputs of an axis: what is broken, what is reached, and where the encoder stood at each edge. */
#pragma once

#include "record.h"

/* Check the axis against its limits; what is broken is latched in trip. */
void watch_limits(struct motion *motion, real speed, real counts);

/* Note which of target, speed and rest have been reached for as long as 6068h, 606Eh and 6070h ask. */
void watch_windows(struct motion *motion, real speed, real angle);

/* Look at all inputs once: their state, their edges, and the counts latched at these.
 *
 * A switch's edge lies where the switch does, as a capture unit in hardware has it; an input that is forced changes where the
 * motor stands. Of several equal edges the first is kept until its bit of edges is cleared. The first look makes no edges. */
void watch_inputs(struct motion *motion, real counts);
