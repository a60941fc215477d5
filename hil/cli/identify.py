"""`hil identify`: plant and transmission error of an axis, an arm's masses."""

from drive_profiles.cli.application import Tool, mount
from hil.cli import identify_arm, identify_ate, identify_plant

identify_app = Tool(
    "identify",
    "Identify plant and transmission error of an axis, or the masses of an arm, into a model file.",
    is_group=True,
)

mount(identify_app, identify_plant, identify_ate, identify_arm)
