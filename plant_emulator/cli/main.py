"""plant-emulator: the emulated robot, and experiments without a bus."""

from drive_profiles.cli.application import Tool
from plant_emulator.cli import eds, fleet, following, rehearse, robustness, schema, serve, simulate
from plant_emulator.cli.console import EPILOG

app = Tool(
    "plant-emulator",
    "An emulated robot: harmonic-drive axes behind CANopen drives, and an accelerometer at the tip.",
    EPILOG,
)

for command in (serve, simulate, eds, robustness, fleet, rehearse, following, schema):
    command.mount(app)
