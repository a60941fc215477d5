"""hil identify: the plant and the transmission error of an axis, measured on the robot."""

import importlib

import typer

from drive_profiles.cli.application import Tool

identify_app = Tool(
    "identify",
    "Identify the plant and the transmission error of an axis, over the bus, and write them to a model file.",
    is_group=True,
)

COMMANDS = ("hil.cli.identify_plant", "hil.cli.identify_ate")


def mount(app: typer.Typer) -> None:
    """Add the group of commands to `hil`."""
    for name in COMMANDS:
        importlib.import_module(name).mount(identify_app)
    app.add_typer(identify_app)
