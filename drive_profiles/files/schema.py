"""JSON Schema of TOML files, for editors.

It states keys, types and ranges; descriptions come from the docstrings of the models.
"""

from __future__ import annotations

import inspect
import json
import re
from typing import Any

import pydantic

DRAFT = "https://json-schema.org/draft/2020-12/schema"
_ATTRIBUTE = re.compile(r"^ {4}(\w+): (.+?)(?=^ {4}\w+: |\Z)", re.MULTILINE | re.DOTALL)


def json_schema(model: Any, title: str) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file.

    The descriptions are those of the classes and of their attributes.

    Args:
        model: Class of the file, or a union of classes.
        title: Name of the kind.
    """
    document = pydantic.TypeAdapter(model).json_schema()
    for part in (document, *document.get("$defs", {}).values()):
        described, attributes = _parts(part.get("description", ""))
        if described:
            part["description"] = described
        for key, text in attributes.items():
            if key in part.get("properties", {}):
                part["properties"][key].setdefault("description", text)
    return {"$schema": DRAFT, **document, "title": title}


def schema_text(model: Any, title: str) -> str:
    """Return the JSON Schema as the text of a file."""
    return json.dumps(json_schema(model, title), indent=1, ensure_ascii=False, sort_keys=False) + "\n"


def _parts(docstring: str) -> tuple[str, dict[str, str]]:
    """Split a docstring into the class description and its attributes."""
    described, _, rest = inspect.cleandoc(docstring).partition("\nAttributes:\n")
    rest = re.split(r"^\S", rest, maxsplit=1, flags=re.MULTILINE)[0]
    return described.strip(), {name: " ".join(text.split()) for name, text in _ATTRIBUTE.findall(rest)}
