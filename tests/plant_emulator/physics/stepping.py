"""One axis of the plant in C, by itself."""

from plant_emulator.core import CORE


def plant_step(plant, state, command, braked, period_s, substeps):
    """One control period of a record of `PLANT` and one of `PLANT_STATE`, in place."""
    of = CORE.pointer(plant, "plant"), CORE.pointer(state, "plant_state")
    CORE.call.plant_step(*of, command, braked, period_s, substeps)
