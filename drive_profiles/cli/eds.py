"""``drive-profiles eds``: show, check and clean a device description."""

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drive_profiles.cli.application import Tool
from drive_profiles.cli.console import ExitStatus, epilog, exit_on_error, print_json, table
from drive_profiles.cli.options import JsonOption
from drive_profiles.errors import FileError, Problem
from drive_profiles.standard import shown
from drive_profiles.standard.cia301 import DataType

if TYPE_CHECKING:
    from drive_profiles.eds import Description

EDS_EPILOG = epilog(
    (ExitStatus.DONE, ExitStatus.USAGE, ExitStatus.FILE),
    {ExitStatus.DONE: "done, perhaps with warnings", ExitStatus.FILE: "a file, or a part of it, was refused"},
)

app = Tool("eds", "Device descriptions of any maker (EDS, DCF, XDD): check, show, convert.", EDS_EPILOG, is_group=True)
NodeId = Annotated[int | None, typer.Option("--node-id", min=1, max=127, help="Node-ID for $NODEID; overrides that of the file.")]
File = Annotated[Path, typer.Argument(metavar="FILE", help="An EDS, DCF, XDD or XDC file.")]
_REAL_DIGITS = 7
"""Digits of a file's real numbers: all that a REAL32 has."""
_ADDRESS = re.compile(r"(?:0x)?([0-9a-f]{4})h?(?:(?:sub|:|\.)(?:0x)?([0-9a-f]{1,2})h?)?", re.IGNORECASE)


@app.command(epilog=EDS_EPILOG)
def check(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="EDS, DCF, XDD or XDC files.")],
    *,
    strict: Annotated[bool, typer.Option("--strict", help="Refuse a file with any fault.")] = False,
    node_id: NodeId = None,
    as_json: JsonOption = False,
) -> None:
    """Report every fault of the files with its line and repair.

    If a file contradicts itself or the standard, both sides are reported and kept.

    Example: drive-profiles eds check --strict drive.eds
    """
    reports = [_checked(path, node_id, strict=strict) for path in files]
    if as_json:
        print_json([report for report, _ in reports])
    else:
        for _, text in reports:
            typer.echo(text)
    if any(report["refused"] or not report["accepted"] for report, _ in reports):
        raise typer.Exit(ExitStatus.FILE)


@app.command(epilog=EDS_EPILOG)
def show(
    file: File,
    wanted: Annotated[
        str | None, typer.Argument(metavar="OBJECT", help="0x2147:1, 2147sub1, 2147, or a part of a name. All if not given.")
    ] = None,
    *,
    node_id: NodeId = None,
    as_json: JsonOption = False,
) -> None:
    """Show identity and objects: type, access, default, limits, mappable, value.

    Example: drive-profiles eds show drive.eds 60C2sub2
    """
    from drive_profiles.eds.export import entries, entry_data, summary

    description = _load(file, node_id)
    rows = [entry_data(item, variable) for item, variable in entries(description.dictionary)]
    facts = summary(description)
    if wanted is not None:
        rows = [row for row in rows if _is_wanted(row, wanted)]
        if not rows:
            raise typer.BadParameter(
                f"{file} has no object {wanted!r}; expected an address or a part of a name", param_hint="OBJECT"
            )
    if as_json:
        print_json({**facts, "objects": rows})
    else:
        if wanted is None:
            table("", ("fact", "value"), [(name.replace("_", " "), _shown(name, value)) for name, value in facts.items()])
        table(
            "objects" if wanted is None else "",
            ("object", "name", "type", "access", "default", "limits", "mappable", "value"),
            [_row(row) for row in rows],
        )
    if count := len(description.problems):  # on standard error: standard output stays clean
        typer.echo(f"{_count(count, 'problem')} in this file: drive-profiles eds check {description.path}", err=True)


@app.command(epilog=EDS_EPILOG)
def convert(
    file: File,
    out: Annotated[Path, typer.Option("--out", metavar="OUT", help="The file to write: .eds, .dcf or .json.", dir_okay=False)],
    *,
    node_id: NodeId = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite OUT.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Report as one JSON document.")] = False,
) -> None:
    """Write a clean EDS or DCF, or JSON, from a description.

    The result holds what the reader understood of the file.

    Example: drive-profiles eds convert drive.xdd --out drive.eds
    """
    from drive_profiles.eds.export import as_data, as_text, lost
    from drive_profiles.files.safefile import write_atomically

    suffix = out.suffix.lower().removeprefix(".")
    if suffix not in {"eds", "dcf", "json"}:
        raise typer.BadParameter(f"{out} has an unknown suffix; expected .eds, .dcf or .json", param_hint="--out")
    description = _load(file, node_id)
    notes = lost(description, suffix)
    if suffix == "json":
        data = (json.dumps(as_data(description), indent=2, ensure_ascii=False) + "\n").encode()
    else:
        data = as_text(description, "dcf" if suffix == "dcf" else "eds").encode()
        notes += _read_again(data, out, node_id)
    if not out.parent.is_dir():
        raise typer.BadParameter(f"folder {out.parent} does not exist; create it first", param_hint="--out")
    if out.exists() and not force:
        raise typer.BadParameter(f"{out} already exists; give --force to overwrite it", param_hint="--out")
    with exit_on_error():
        write_atomically(out, data, force=force)
    if as_json:
        print_json({"path": str(out), "bytes": len(data), "notes": [note._asdict() for note in notes]})
        return
    if notes:
        typer.echo(str(FileError(out, notes)), err=True)
    typer.echo(f"{out}: written, {len(data)} bytes")


def _checked(path: Path, node_id: int | None, *, strict: bool) -> tuple[dict[str, Any], str]:
    """Return the findings in one file, as data and as text."""
    from drive_profiles.eds import load
    from drive_profiles.eds.export import findings_data, summary

    try:
        description = load(path, node_id=node_id, strict=strict)
    except FileError as error:
        report = {
            "path": str(path),
            "accepted": False,
            "warnings": [],
            "contradictions": [],
            "refused": [each._asdict() for each in error.problems],
        }
        return report, f"{error}\n{path}: refused, {_count(len(error.problems), 'problem')}"
    facts = summary(description)
    report = {**facts, "accepted": True, **findings_data(description)}
    problems = description.problems
    text = (
        f"{path}: {facts['kind']}, {_count(facts['object_count'], 'object')}, "
        f"{_count(facts['entry_count'], 'entry', 'entries')}; "
        f"{_count(len(description.warnings), 'warning')}, {_count(len(description.contradictions), 'contradiction')}, "
        f"{len(description.refused)} left out"
    )
    return report, f"{FileError(path, problems)}\n{text}" if problems else text


def _count(number: int, one: str, many: str = "") -> str:
    return f"{number} {one if number == 1 else many or one + 's'}"


def _load(path: Path, node_id: int | None) -> "Description":
    """Load a description, or exit with the reasons for its refusal."""
    from drive_profiles.eds import load

    with exit_on_error():
        return load(path, node_id=node_id)


def _read_again(data: bytes, out: Path, node_id: int | None) -> "tuple[Problem, ...]":
    """Return the problems of a file just made: faults of the device."""
    from drive_profiles.eds import loads

    try:
        return loads(data, out, node_id=node_id).warnings
    except FileError as error:
        typer.echo(f"{error}\nnot written: the result cannot be read again", err=True)
        raise typer.Exit(ExitStatus.FILE) from None


def _is_wanted(row: dict[str, Any], wanted: str) -> bool:
    match = _ADDRESS.fullmatch(wanted.strip())
    if match is not None:
        index, subindex = int(match.group(1), 16), match.group(2)
        if row["index"] == index and (subindex is None or row["subindex"] == int(subindex, 16)):
            return True
    return wanted.lower() in f"{row['object']}\n{row['name']}".lower()


def _shown(name: str, value: object) -> str:
    if value is None or value == "":
        return "-"
    return f"0x{value:08X}" if name in {"vendor_id", "product_code", "revision"} else str(value)


def _row(row: dict[str, Any]) -> tuple[str, ...]:
    default, low, high, value = (_value(row, row[key]) for key in ("default", "low", "high", "value"))
    name = row["name"] if row["name"] == row["object"] else f"{row['object']} / {row['name']}"
    return (
        f"{row['index']:04X}:{row['subindex']:02X}",
        name,
        row["type"],
        row["access"],
        f"{default} with node-ID" if row["relative"] else default,
        f"{low}..{high}" if low or high else "",
        "yes" if row["mappable"] else "no",
        value,
    )


def _value(row: dict[str, Any], held: float | str | None) -> str:
    """Format the number of an object; text stays as it is."""
    if held is None:
        return ""
    data_type = DataType.__members__.get(row["type"])
    text = shown.value(held, (row["index"], row["subindex"]), data_type, digits=_REAL_DIGITS)
    return text if text.isprintable() else repr(text)  # of a file: control characters are escaped
