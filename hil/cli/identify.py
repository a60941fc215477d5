"""`hil identify`: plant and transmission error of an axis, an arm's masses."""

import importlib

import typer

from drive_profiles.cli.application import Tool

identify_app = Tool(
    "identify",
    "Identify plant and transmission error of an axis, or the masses of an arm, into a model file.",
    is_group=True,
)

COMMANDS = ("hil.cli.identify_plant", "hil.cli.identify_ate", "hil.cli.identify_arm")


def mount(app: typer.Typer) -> None:
    """Add the group of commands to `hil`."""
    for name in COMMANDS:
        importlib.import_module(name).mount(identify_app)
    app.add_typer(identify_app)
