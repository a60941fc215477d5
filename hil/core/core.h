/* All of the core that Python calls: the law, and what the bus, design, logs and the master have in C. */
#pragma once

#include "hil/can/frame_bits.h"
#include "hil/control/cancellation.h"
#include "hil/control/following.h"
#include "hil/control/servo.h"
#include "hil/design/gear.h"
#include "hil/design/margins.h"
#include "hil/design/ramp.h"
#include "hil/logs/candump.h"
#include "hil/master/run.h"

/* Digest of the sources that this library was built from, in hexadecimal. */
const char *core_sources(void);
