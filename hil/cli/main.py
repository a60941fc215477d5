"""hil: run the paper's experiments on an emulated robot or a real one, and report on them."""

from drive_profiles.cli.application import Tool
from hil.cli import compare, demo, design, identify, learn, plan, report, run
from hil.cli.console import EPILOG

app = Tool("hil", "Hardware-in-the-loop bench for robots with harmonic drives.", EPILOG)

for command in (demo, run, report, plan, identify, design, learn, compare):
    command.mount(app)


def main() -> None:
    """Entry point of the console script."""
    app.run()
