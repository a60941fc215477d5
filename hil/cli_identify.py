"""hil identify: what a robot is, measured on it: the plant and the transmission error of an axis."""

import importlib

import typer

identify_app = typer.Typer(
    name="identify",
    help="Identify the plant and the transmission error of an axis, over the bus, and write them to a model file.",
    no_args_is_help=True,
)

COMMANDS = ("hil.cli_identify_plant", "hil.cli_identify_ate")


def mount(app: typer.Typer) -> None:
    """Make it a group of commands of `hil`."""
    for name in COMMANDS:
        importlib.import_module(name).mount(identify_app)
    app.add_typer(identify_app)
