"""``drive-profiles``: which drive families are known, and what is known of each."""

# ruff: noqa: PLC0415 - pydantic and rich are imported inside the commands, so that --help and completion stay quick

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from drive_profiles.profile import Profile

BAD_FILE = 3
"""Exit code for a file with errors; 2 is usage, as everywhere."""

app = typer.Typer(
    help="Drive families as data: identity, what they can do, and which object holds which parameter.",
    epilog="Exit codes: 0 done, 2 usage, 3 a profile file has errors (each is listed with its line).",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
AsJson = Annotated[bool, typer.Option("--json", help="One JSON document instead of a table.")]


@app.command("list")
def list_profiles(*, as_json: AsJson = False) -> None:
    """List the profiles of the package.

    Example: drive-profiles list --json
    """
    from drive_profiles.profile import available

    profiles = [_load(name) for name in available()]
    if as_json:
        facts = [{"name": p.name, "title": p.title, "kind": p.kind, **p.identity.model_dump()} for p in profiles]
        typer.echo(json.dumps(facts, indent=2, ensure_ascii=False))
        return
    _table(
        "",
        ("name", "kind", "vendor", "product", "title"),
        [(p.name, p.kind, f"0x{p.identity.vendor_id:08X}", f"0x{p.identity.product_code:08X}", p.title) for p in profiles],
    )


@app.command()
def show(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="A name from `drive-profiles list`, or the path of a profile file.")
    ],
    *,
    as_json: AsJson = False,
) -> None:
    """Show one profile: identity, capabilities with their reasons, parameters with objects and units.

    Example: drive-profiles show emulated_drive
    """
    profile = _load(name)
    if as_json:
        typer.echo(profile.model_dump_json(indent=2, by_alias=True))
        return
    _table("", ("fact", "value"), _facts(profile))
    if profile.capabilities is not None:
        rows = [(name.replace("_", " "), entry.answer, entry.reason) for name, entry in profile.capabilities]
        _table("capabilities", ("what", "answer", "reason"), rows)
    _table(
        "parameters",
        ("name", "object", "type", "unit", "step on the wire", "access", "class"),
        [
            (name, entry.address, entry.data_type, entry.unit, entry.step, entry.access, entry.parameter_class)
            for name, entry in profile.parameters.items()
        ],
    )


def _facts(profile: Profile) -> list[tuple[str, ...]]:
    identity, sync = profile.identity, profile.sync
    facts: list[tuple[str, ...]] = [
        ("name", profile.name),
        ("title", profile.title),
        ("kind", profile.kind),
        ("device type (1000h)", f"0x{profile.device_type:08X}"),
        ("vendor (1018h:1)", f"0x{identity.vendor_id:08X}"),
        ("product (1018h:2)", f"0x{identity.product_code:08X}"),
        ("revision (1018h:3)", str(identity.revision)),
        ("SYNC period", f"{1e3 * sync.min_period_s:g} to {1e3 * sync.max_period_s:g} ms"),
    ]
    if profile.modes:
        facts.append(("modes (6502h)", ", ".join(profile.modes)))
    if profile.control_period_s is not None:
        facts.append(("control period", f"{1e6 * profile.control_period_s:g} us"))
    return facts


def _load(name: str) -> Profile:
    """The profile, or the exit with its errors: an unknown name is wrong usage, a bad file is a bad file."""
    from drive_profiles.errors import FileError, ProfileNotFoundError
    from drive_profiles.profile import Profile

    try:
        return Profile.load(name)
    except ProfileNotFoundError as error:
        raise typer.BadParameter(str(error), param_hint="NAME") from None
    except FileError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(BAD_FILE) from None


def _table(title: str, header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    """A rich table on a terminal; elsewhere plain columns, tab-separated, for cut and awk."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    if not console.is_terminal:
        if title:
            typer.echo(f"\n# {title}")
        for row in (header, *rows):
            typer.echo("\t".join(row))
        return
    table = Table(title=title or None, title_justify="left")
    for column in header:
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*(cell.replace("[", r"\[") for cell in row))
    console.print(table)


def main() -> None:
    """Entry point of the ``drive-profiles`` command."""
    app()


if __name__ == "__main__":
    main()
