"""What the emulator's core is made of: the plant and the control period, on top of the law's own sources."""

from hil.core.build import Core

PLANT = Core(
    "plant",
    "plant_emulator/core",
    "plant_emulator/core/core.h",
    ("plant_emulator/core", "plant_emulator/physics", "plant_emulator/motion", "plant_emulator/studies", "hil/control"),
)
