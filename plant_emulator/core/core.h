/* All of the emulator's core that Python calls. */
#pragma once

#include "hil/can/frame_bits.h"
#include "plant_emulator/image/image.h"
#include "plant_emulator/motion/period.h"
#include "plant_emulator/motion/supervision.h"
#include "plant_emulator/motion/transitions.h"
#include "plant_emulator/physics/integration.h"
#include "plant_emulator/physics/tool.h"

/* Digest of the sources that this library was built from, in hexadecimal. */
const char *core_sources(void);
