"""plant-emulator: the emulated robot as a process, and its experiments without a bus."""

import os

import typer

from plant_emulator.cli import eds, robustness, serve, simulate

app = typer.Typer(
    name="plant-emulator",
    help="An emulated robot: harmonic-drive axes behind CANopen drives, and an accelerometer at the tip.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

for command in (serve, simulate, eds, robustness):
    command.mount(app)


def main() -> None:
    """Entry point of the console script."""
    try:
        app()
    except BrokenPipeError:
        os._exit(141)  # the reader of the output has gone; there is nothing to tell it
