"""`hil`: experiments on an emulated or a real robot, and reports."""

from drive_profiles.cli.application import Tool
from hil.cli import compare, demo, design, identify, learn, move, passport, plan, report, run
from hil.cli.console import EPILOG
from hil.cli.heard import explain, export, scope
from hil.cli.start import check, init, schema

app = Tool("hil", "Hardware-in-the-loop bench for robots with harmonic drives.", EPILOG)

for command in (
    demo,
    init,
    check,
    run,
    move,
    report,
    plan,
    identify,
    design,
    learn,
    compare,
    passport,
    explain,
    export,
    scope,
    schema,
):
    command.mount(app)
