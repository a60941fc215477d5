"""The command ``schema`` of all three tools: JSON Schemas for editors."""

# ruff: noqa: PLC0415 - pydantic is imported inside the command, so that --help and completion stay quick

import pkgutil
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from drive_profiles.cli.completion import complete_list
from drive_profiles.cli.console import FILE_EPILOG, ExitStatus, exit_on_error, fail


def mount_schema(app: typer.Typer, kinds: Mapping[str, str], example: str) -> None:
    """Add ``schema`` to a tool.

    Args:
        app: The tool.
        kinds: Classes of the files that the tool reads, as `module:name`, so that --help loads none.
        example: Command that shows how it is used.
    """
    named = ", ".join(kinds)

    def schema(
        kind: Annotated[str, typer.Argument(help=f"One of {named}.", autocompletion=complete_list(lambda: list(kinds)))],
        out: Annotated[Path | None, typer.Option("--out", help="File to write; default: standard output.")] = None,
        *,
        force: Annotated[bool, typer.Option("--force", help="Replace the file if it exists.")] = False,
    ) -> None:
        from drive_profiles.files.safefile import write_atomically
        from drive_profiles.files.schema import schema_text

        if kind not in kinds:
            raise fail(f"no schema of {kind!r}; expected one of {named}", ExitStatus.USAGE)
        with exit_on_error():
            text = schema_text(pkgutil.resolve_name(kinds[kind]), f"{app.info.name} {kind} file")
            if out is not None:
                write_atomically(out, text.encode(), force=force)
        if out is None:
            typer.echo(text, nl=False)

    schema.__doc__ = f"""Write the JSON Schema of a kind of TOML file.

    With it an editor completes and checks such a file.

    Example: {example}
    """
    app.command("schema", epilog=FILE_EPILOG)(schema)
