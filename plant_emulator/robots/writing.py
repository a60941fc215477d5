"""Text of a robot file from a robot."""

from collections.abc import Mapping
from typing import Any

from drive_profiles.files.toml import toml_value
from plant_emulator.robots.robot import Robot


def robot_text(robot: Robot) -> str:
    """A robot as its file says it; what is as by default is left out. Reading it gives the same robot."""
    return "\n".join([*_lines("", robot.model_dump(exclude_none=True, exclude_defaults=True)), ""])


def _lines(name: str, values: Mapping[Any, Any]) -> list[str]:
    """A table with its plain values first, then its tables; small tables inside an axis stay on a line."""
    inner = {key: value for key, value in values.items() if isinstance(value, dict) and name.count(".") < 1}
    plain = [f"{key} = {toml_value(value)}" for key, value in values.items() if key not in inner]
    lines = [f"[{name}]", *plain] if name and plain else plain
    for key, value in inner.items():
        found = _lines(f"{name}.{key}" if name else str(key), value)
        lines += ["", *found] if lines and found and found[0] else found
    return lines
