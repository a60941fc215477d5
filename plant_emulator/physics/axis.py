"""Motor and arm joined by a harmonic drive gearing; equations in `axis.h`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core import CORE

MORE_LINES: int = CORE.call.MORE_LINES
"""Orders beside 1, 2 and 4 for which an axis has room, orders of the joint, and orders of cogging."""

PLANT, PLANT_STATE = CORE.dtype("plant"), CORE.dtype("plant_state")

Record = NDArray[Any] | np.void
"""A record of an array, or an array of one."""


def synchronous_error(plant: Record, motor_angle: float) -> tuple[float, float]:
    """Return θ_sync in rad on the arm side, and dθ_sync/dθ_m.

    θ_sync = Σ A_k cos(k θ_m + φ_k), k = 1, 2, 4, others, and m/N. Eq. (2).
    """
    slope = np.empty(1)
    error = CORE.call.synchronous_error(CORE.pointer(plant, "plant"), motor_angle, CORE.pointer(slope))
    return error, float(slope[0])


def hang_at_rest(plant: Record, state: Record) -> None:
    """Put a braked axis at rest under gravity, in place.

    The gear carries the load, so θ_l hangs below θ_m/N + θ_sync.
    """
    CORE.call.hang_at_rest(CORE.pointer(plant, "plant"), CORE.pointer(state, "plant_state"))


SMOOTHING_S, TURNING_RAD_S = CORE.constants["SMOOTHING_S"], CORE.constants["TURNING_RAD_S"]
LINES: int = CORE.call.LINES
"""Orders that a `CHANGE` record has numbers for: 1, 2 and 4, then the others."""
CHANGE, PAST = CORE.dtype("change"), CORE.dtype("past")


def put_error(change: Record, past: Record, plant: Record) -> None:
    """Update the axis' constants to the present transmission error."""
    CORE.call.put_error(CORE.pointer(change, "change"), CORE.pointer(past, "past"), CORE.pointer(plant, "plant"))
