"""The command ``schema`` of all three tools: JSON Schemas for editors."""

import inspect
import json
import pkgutil
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from drive_profiles.cli.completion import complete_list
from drive_profiles.cli.console import FILE_EPILOG, ExitStatus, exit_on_error, fail

DRAFT = "https://json-schema.org/draft/2020-12/schema"
_ATTRIBUTE = re.compile(r"^ {4}(\w+): (.+?)(?=^ {4}\w+: |\Z)", re.MULTILINE | re.DOTALL)


def mount_schema(app: typer.Typer, kinds: Mapping[str, str], example: str) -> None:
    """Add ``schema`` to a tool.

    `kinds` has the classes of the files that the tool reads as `module:name`, so that --help loads none.
    """
    named = ", ".join(kinds)

    def schema(
        kind: Annotated[str, typer.Argument(help=f"One of {named}.", autocompletion=complete_list(lambda: list(kinds)))],
        out: Annotated[Path | None, typer.Option("--out", help="File to write; default: standard output.")] = None,
        *,
        force: Annotated[bool, typer.Option("--force", help="Replace the file if it exists.")] = False,
    ) -> None:
        from drive_profiles.files.safefile import write_atomically

        if kind not in kinds:
            raise fail(f"no schema of {kind!r}; expected one of {named}", ExitStatus.USAGE)
        with exit_on_error():
            document = json_schema(pkgutil.resolve_name(kinds[kind]), f"{app.info.name} {kind} file")
            text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
            if out is not None:
                write_atomically(out, text.encode(), force=force)
        if out is None:
            typer.echo(text, nl=False)

    schema.__doc__ = f"""Write the JSON Schema of a kind of TOML file.

    With it an editor completes and checks such a file.

    Example: {example}
    """
    app.command("schema", epilog=FILE_EPILOG)(schema)


def json_schema(model: Any, title: str) -> dict[str, Any]:
    """Return a file's JSON Schema, described by the docstrings of its classes."""
    import pydantic

    document = pydantic.TypeAdapter(model).json_schema()
    for part in (document, *document.get("$defs", {}).values()):
        described, attributes = _parts(part.get("description", ""))
        if described:
            part["description"] = described
        for key, text in attributes.items():
            if key in part.get("properties", {}):
                part["properties"][key].setdefault("description", text)
    return {"$schema": DRAFT, **document, "title": title}


def _parts(docstring: str) -> tuple[str, dict[str, str]]:
    """Split a docstring into the class description and its attributes."""
    described, _, rest = inspect.cleandoc(docstring).partition("\nAttributes:\n")
    rest = re.split(r"^\S", rest, maxsplit=1, flags=re.MULTILINE)[0]
    return described.strip(), {name: " ".join(text.split()) for name, text in _ATTRIBUTE.findall(rest)}
