"""``drive-profiles``: drive families as data, and parameters of drives."""

from __future__ import annotations

from drive_profiles.cli import compare, convert, eds, profiles, read, realise, restore, schema, write
from drive_profiles.cli.application import Tool
from drive_profiles.cli.console import EPILOG
from drive_profiles.cli.live import backup, faults, lss, nmt, watch

app = Tool(
    "drive-profiles",
    "Drive families as data, and the parameters of real drives: identity, capabilities and values.",
    EPILOG,
)

for group in (profiles, read, watch, faults, nmt, lss, backup, write, compare, restore, convert, eds, realise, schema):
    group.mount(app)
