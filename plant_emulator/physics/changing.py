"""A gear that changes with time, load, direction and temperature; see `changing.h`."""

from plant_emulator.core import CORE
from plant_emulator.physics.axis import Record

SMOOTHING_S, TURNING_RAD_S = CORE.constants["SMOOTHING_S"], CORE.constants["TURNING_RAD_S"]
LINES: int = CORE.call.LINES
"""Orders that a `CHANGE` record has numbers for: 1, 2 and 4, then the others."""
CHANGE, PAST = CORE.dtype("change"), CORE.dtype("past")


def put_error(change: Record, past: Record, plant: Record) -> None:
    """Update the axis' constants to the present transmission error."""
    CORE.call.put_error(CORE.pointer(change, "change"), CORE.pointer(past, "past"), CORE.pointer(plant, "plant"))
