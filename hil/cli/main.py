"""hil: run the paper's experiments on an emulated robot or a real one, and report on them."""

import os

import typer

from hil.cli import compare, demo, design, identify, learn, plan, report, run
from hil.cli.console import EPILOG

app = typer.Typer(
    name="hil",
    help="Hardware-in-the-loop bench for robots with harmonic drives.",
    epilog=EPILOG,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

for command in (demo, run, report, plan, identify, design, learn, compare):
    command.mount(app)


def main() -> None:
    """Entry point of the console script."""
    try:
        app()
    except BrokenPipeError:
        os._exit(141)  # the reader of the output has gone; there is nothing to tell it
