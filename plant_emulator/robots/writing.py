"""Text of a robot file or a bench file."""

from collections.abc import Mapping
from typing import Any

from drive_profiles.files.toml import Table, toml_value


def file_text(table: Table) -> str:
    """Return a robot or a bench as the text of its file.

    Default values are left out. Reading the text gives the same robot or bench.
    """
    return "\n".join([*_lines("", table.model_dump(exclude_none=True, exclude_defaults=True)), ""])


def _lines(name: str, values: Mapping[Any, Any]) -> list[str]:
    """Return the lines of a table: plain values, then tables.

    Small tables inside an axis stay on a line.
    """
    inner = {key: value for key, value in values.items() if isinstance(value, dict) and name.count(".") < 1}
    plain = [f"{key} = {toml_value(value)}" for key, value in values.items() if key not in inner]
    lines = [f"[{name}]", *plain] if name and plain else plain
    for key, value in inner.items():
        found = _lines(f"{name}.{key}" if name else str(key), value)
        lines += ["", *found] if lines and found and found[0] else found
    return lines
