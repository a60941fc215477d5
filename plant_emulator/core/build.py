"""Sources of the emulator's core: plant, control period and law."""

from hil.core.build import Core

PLANT = Core(
    "plant",
    "plant_emulator/core",
    "plant_emulator/core/core.h",
    (
        "plant_emulator/core",
        "plant_emulator/physics",
        "plant_emulator/motion",
        "plant_emulator/image",
        "hil/can",
        "hil/control",
        "hil/core",
    ),
)
