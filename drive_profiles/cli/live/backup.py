"""drive-profiles backup: the parameter sets of all nodes at once."""

# ruff: noqa: PLC0415 - canopen and pydantic are imported inside the commands, so that --help and completion stay quick

from __future__ import annotations

import datetime
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import READ_EPILOG, ExitStatus, exit_on_error, fail, print_json, progress, table
from drive_profiles.cli.live.faults import NodesOption
from drive_profiles.cli.options import ALL, BusOption, ClassesOption, JsonOption, TimeoutOption, class_names

if TYPE_CHECKING:
    from drive_profiles.device.bus import SdoBus

INDEX = "backup.json"


@command(epilog=READ_EPILOG)
def backup(
    bus: BusOption,
    out: Annotated[Path, typer.Option("--out", help="Folder for the files; new, or empty.")],
    node: NodesOption = None,
    *,
    classes: ClassesOption = ALL,
    timeout_s: TimeoutOption = 0.5,
    as_json: JsonOption = False,
) -> None:
    """Read the parameter sets of all nodes into a folder.

    Each node has a file, as `pull` writes it; an index lists them all.

    To restore them, `upload` these files. A node without a known profile is in the index but has no file.

    Example: drive-profiles backup --bus socketcan:can0 --out as-found
    """
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.files.safefile import write_json

    wanted = class_names(classes)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise fail(f"{out} already exists and is not empty; nothing was written", ExitStatus.FILE)
    with exit_on_error(), SdoBus(bus, timeout_s) as opened:
        there = opened.answering(node or range(1, 128))
        if silent := sorted(set(node or ()) - set(there)):
            raise fail(f"node {silent[0]} does not answer; nothing was written", ExitStatus.NODE)
        if not there:
            raise fail(f"no node answers on {bus}; nothing was written", ExitStatus.NODE)
        with progress("reading", len(there)) as step:
            entries = []
            for number in there:
                entries.append(_kept(opened, number, out, wanted))
                step(1)
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        index = {"bus": opened.address, "date": now, "nodes": entries}
        write_json(out / INDEX, index)
    if as_json:
        print_json(index)
    else:
        rows = [(str(each["node"]), each["file"] or "-", str(each["values"]), each["remark"]) for each in entries]
        table("", ("node", "file", "values", "remark"), rows)
    if failed := [each["node"] for each in entries if each["file"] is None]:
        typer.echo(f"node {', node '.join(map(str, failed))}: not backed up; for the reason see {out / INDEX}", err=True)
        raise typer.Exit(ExitStatus.NODE)


def _kept(bus: SdoBus, node: int, out: Path, classes: tuple[str, ...]) -> dict[str, Any]:
    """Back up one node; gives its entry of the index."""
    from drive_profiles.device.device import identity_at
    from drive_profiles.device.target import device_at
    from drive_profiles.errors import BusError, DriveProfileError

    entry: dict[str, Any] = {
        "node": node,
        "file": None,
        "values": 0,
        "hash": None,
        "not_read": [],
        "identity": None,
        "remark": "",
    }
    try:
        entry["identity"] = asdict(identity_at(bus.port(node)))
        pulled = device_at(bus, node).pull(classes)
        name = f"node{node}.toml"
        pulled.save(out / name)
    except BusError:
        raise
    except DriveProfileError as error:
        return entry | {"remark": str(error)}
    unread = list(pulled.header.not_read)
    count = sum(1 for _ in pulled.items())
    remark = f"{len(unread)} objects not read" if unread else ""
    return entry | {"file": name, "values": count, "hash": pulled.digest(), "not_read": unread, "remark": remark}
