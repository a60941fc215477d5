"""``drive-profiles``: drive families as data, and parameters of drives."""

from drive_profiles.cli import compare, convert, eds, nodes, profiles, read, realise, watch, write
from drive_profiles.cli.application import Tool, mount
from drive_profiles.cli.console import EPILOG
from drive_profiles.cli.schema import mount_schema

SCHEMAS = {
    "profile": "drive_profiles.family.profile:Profile",
    "parameters": "drive_profiles.parameter_set.parameters:ParameterSet",
}
"""Classes of the TOML files that `drive-profiles` reads."""

app = Tool(
    "drive-profiles", "Drive families as data, and the parameters of real drives: identity, capabilities and values.", EPILOG
)

mount(app, profiles, read, watch, nodes, write, compare, convert, eds, realise)
mount_schema(app, SCHEMAS, "drive-profiles schema profile --out profile.schema.json")
