"""`hil`: experiments on an emulated or a real robot, and reports."""

from drive_profiles.cli.application import Tool, mount
from drive_profiles.cli.schema import mount_schema
from hil.cli import compare, demo, design, identify, learn, move, passport, plan, report, run
from hil.cli.console import EPILOG
from hil.cli.heard import explain, export, scope
from hil.cli.start import check, init

SCHEMAS = {
    "bench": "hil.bench.bench:Bench",
    "model": "hil.bench.model:Identified",
    "design": "hil.bench.design:Designs",
    "layout": "hil.recordings.layout:LayoutFile",
}
"""Classes of the TOML files that `hil` reads."""

app = Tool("hil", "Hardware-in-the-loop bench for robots with harmonic drives.", EPILOG)

mount(app, demo, init, check, run, move, report, plan, identify, design, learn, compare, passport, explain, export, scope)
mount_schema(app, SCHEMAS, "hil schema bench --out bench.schema.json")
