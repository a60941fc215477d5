"""hil identify: the plant and the transmission error of an axis, measured on the robot."""

import importlib

import typer

identify_app = typer.Typer(
    name="identify",
    help="Identify the plant and the transmission error of an axis, over the bus, and write them to a model file.",
    no_args_is_help=True,
)

COMMANDS = ("hil.cli.identify_plant", "hil.cli.identify_ate")


def mount(app: typer.Typer) -> None:
    """Add the group of commands to `hil`."""
    for name in COMMANDS:
        importlib.import_module(name).mount(identify_app)
    app.add_typer(identify_app)
