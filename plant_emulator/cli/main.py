"""plant-emulator: the emulated robot, and experiments without a bus."""

from drive_profiles.cli.application import Tool, mount
from drive_profiles.cli.schema import mount_schema
from plant_emulator.cli import eds, fleet, following, rehearse, robustness, serve, simulate
from plant_emulator.cli.console import EPILOG

SCHEMAS = {
    "robot": "plant_emulator.robots.robot:AnyRobot",
    "tuning": "plant_emulator.robots.tuning:Tuning",
    "spread": "plant_emulator.studies.spread:PlantSpread",
    "faults": "plant_emulator.bus.faults:FaultsFile",
}
"""Classes of the TOML files that `plant-emulator` reads."""

app = Tool(
    "plant-emulator",
    "An emulated robot: harmonic-drive axes behind CANopen drives, and an accelerometer at the tip.",
    EPILOG,
)

mount(app, serve, simulate, eds, robustness, fleet, rehearse, following)
mount_schema(app, SCHEMAS, "plant-emulator schema robot --out robot.schema.json")
