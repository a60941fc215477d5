"""Commands of ``drive-profiles`` that read a bus and write nothing to it."""

import datetime
import math
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drive_profiles.address import parse_address
from drive_profiles.cli.application import command
from drive_profiles.cli.completion import complete_objects
from drive_profiles.cli.console import READ_EPILOG, ExitStatus, exit_on_error, fail, listed, print_json, progress, table
from drive_profiles.cli.options import (
    ALL,
    BusOption,
    ClassesOption,
    DriveOptions,
    ForceOption,
    JsonOption,
    NodesOption,
    TimeoutOption,
    class_names,
)
from drive_profiles.errors import BusError, DriveProfileError, SdoAbortedError
from drive_profiles.standard import shown

if TYPE_CHECKING:
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.device.device import Device, DeviceIdentity
    from drive_profiles.family.catalogue import CatalogueEntry
    from drive_profiles.standard.units import Scaling

INDEX = "backup.json"


@command(epilog=READ_EPILOG)
def scan(
    bus: BusOption,
    *,
    nodes: Annotated[str, typer.Option("--nodes", help="Node-IDs to ask: 1-127, or 1,2,5.")] = "1-127",
    timeout_s: TimeoutOption = 0.5,
    as_json: JsonOption = False,
) -> None:
    """Read the identity of every node.

    Only 1000h, 1008h, 100Ah and 1018h are read.

    Example: drive-profiles scan --bus local:/tmp/robot.sock
    """
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.device.device import identity_at
    from drive_profiles.device.target import matching

    wanted = listed("--nodes", nodes, "node-ID")
    with exit_on_error(), SdoBus(bus, timeout_s) as opened:
        there = opened.answering(wanted)
        rows = []
        with progress("asking", len(there)) as step:
            for node in there:
                identity = identity_at(opened.port(node))
                rows.append((identity, matching(identity)))
                step(1)
    if as_json:
        print_json([{**asdict(identity), "profiles": names} for identity, names in rows])
    else:
        header = ("node", "vendor", "product", "revision", "serial", "name", "profile")
        table("", header, [_row(identity, names) for identity, names in rows])
    if not rows:
        raise fail(
            f"no node of {nodes} answers on {bus} within {timeout_s:g} s: check the bit rate and the supply", ExitStatus.NODE
        )


def _row(identity: "DeviceIdentity", names: list[str]) -> tuple[str, ...]:
    return (
        str(identity.node),
        _hex(identity.vendor_id),
        _hex(identity.product_code),
        _hex(identity.revision),
        "-" if identity.serial_number is None else str(identity.serial_number),
        identity.name or "-",
        " or ".join(names) or "-",
    )


def _hex(value: int | None) -> str:
    return "-" if value is None else f"0x{value:08X}"


@command(epilog=READ_EPILOG)
def info(drive: DriveOptions) -> None:
    """Show a node's identity, state, error register and matching profile.

    Example: drive-profiles info --bus socketcan:can0 --node 2
    """
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.device.target import any_device_at, matching

    with exit_on_error(), SdoBus(drive.bus, drive.timeout_s) as opened:
        device = any_device_at(opened, drive.node, drive.profile, drive.eds)
        identity = device.identify()
        state = device.state()
        try:
            register: int | None = device.read((0x1001, 0))[0]
        except (SdoAbortedError, IndexError):
            register = None
        names = matching(identity)
    facts: dict[str, Any] = {
        **asdict(identity),
        "state": None if state is None else state.value,
        "error_register": register,
        "profiles": names,
        "known_objects": len(device.catalogue),
    }
    if drive.as_json:
        print_json(facts)
        return
    rows = [
        (key.replace("_", " "), "-" if value in (None, "", []) else f"0x{value:0{digits}X}" if digits else str(value))
        for key, value in (facts | {"profiles": ", ".join(names)}).items()
        for digits in (_HEXADECIMAL.get(key),)
    ]
    table("", ("fact", "value"), rows)


_HEXADECIMAL = {"device_type": 8, "vendor_id": 8, "product_code": 8, "revision": 8, "error_register": 2}
"""Digits of what is hexadecimal."""


@command(epilog=READ_EPILOG)
def pull(
    drive: DriveOptions,
    *,
    out: Annotated[Path | None, typer.Option("--out", help="File to write; default, or -: standard output.")] = None,
    force: ForceOption = False,
    classes: ClassesOption = ALL,
) -> None:
    """Read all values that could be written back, as a set.

    Objects that could not be read are listed on standard error and in the set's header.

    Example: drive-profiles pull --bus local:/tmp/robot.sock --node 2 --out axis2.toml
    """
    from drive_profiles.device.target import doubt_of_profile

    wanted = class_names(classes)
    if out == Path("-"):
        out = None
    with exit_on_error(), drive.opened() as device:
        if drive.profile is not None and (doubt := doubt_of_profile(device.identify(), drive.profile)):
            typer.echo(doubt, err=True)
        with progress("reading", len(device.catalogue)) as step:
            pulled = device.pull(wanted, lambda done, total: step(1))
        header = pulled.header.model_copy(update={"bitrate_bit_s": parse_address(drive.bus).bitrate})
        pulled = pulled.model_copy(update={"header": header})
        if out is not None:
            pulled.save(out, force=force)
        text = "" if out is not None or drive.as_json else pulled.dumps()
    for line in pulled.header.not_read:
        typer.echo(f"not read: {line}", err=True)
    count = sum(1 for _ in pulled.items())
    if not count:
        typer.echo(f"node {drive.node}: no known object gave a value that can be written back", err=True)
    if drive.as_json:
        print_json(pulled.model_dump())
    elif out is None:
        typer.echo(text, nl=False)
    else:
        typer.echo(f"{count} values of node {drive.node} in {out}")


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
    from drive_profiles.files.safefile import file_instead, write_json

    wanted = class_names(classes)
    problem = file_instead(out) or (f"{out} already exists and is not empty" if out.exists() and any(out.iterdir()) else "")
    if problem:
        raise fail(f"{problem}; nothing was written", ExitStatus.FILE)
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


def _kept(bus: "SdoBus", node: int, out: Path, classes: tuple[str, ...]) -> dict[str, Any]:
    """Back up one node; gives its entry of the index."""
    from drive_profiles.device.device import identity_at
    from drive_profiles.device.target import device_at

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


@command(epilog=READ_EPILOG)
def get(
    objects: Annotated[
        list[str],
        typer.Argument(
            metavar="OBJECT", help="Address such as 0x2147:1, a name, or a part of a name.", autocompletion=complete_objects
        ),
    ],
    drive: DriveOptions,
) -> None:
    """Read objects by address or name.

    The command shows every object that it could read; the exit status is that of the first failure.

    Example: drive-profiles get position_gain_per_s 0x6041 --bus local:/tmp/robot.sock --node 2
    """
    from drive_profiles.standard.object_address import address_text

    with exit_on_error(), drive.opened() as device:
        entries = [device.catalogue.find(text) for text in objects]
        values, failures = _got(device, entries)
    if drive.as_json:
        documents: list[dict[str, Any]] = [
            {"object": f"0x{address_text(e.address)}", "name": e.name, "value": in_json(v), "unit": e.unit, "bytes": d.hex()}
            for e, d, v in values
        ]
        documents += [{"object": f"0x{address_text(e.address)}", "name": e.name, "error": str(error)} for e, error in failures]
        print_json(documents)
    elif values:
        rows = [
            (address_text(e.address), e.name or "-", _value(e, d, v), device.catalogue.unit_of(e), d.hex(" "))
            for e, d, v in values
        ]
        table("", ("object", "name", "value", "unit", "bytes"), rows)
    for _, error in failures:
        typer.echo(str(error), err=True)
    if failures:
        raise typer.Exit(failures[0][1].exit_code)


def _got(
    device: "Device", entries: "list[CatalogueEntry]"
) -> "tuple[list[tuple[CatalogueEntry, bytes, float | str]], list[tuple[CatalogueEntry, DriveProfileError]]]":
    """Read objects; return those read, with bytes and value, and the failures."""
    values: list[tuple[CatalogueEntry, bytes, float | str]] = []
    failures: list[tuple[CatalogueEntry, DriveProfileError]] = []
    for entry in entries:
        try:
            data = device.read(entry.address)
            value = decoded(entry, data, device.scaling)
        except BusError as error:
            failures.append((entry, error))
            break  # nothing more will come
        except DriveProfileError as error:
            failures.append((entry, error))
            continue
        values.append((entry, data, value))
    return values, failures


def decoded(entry: "CatalogueEntry", data: bytes, scaling_of: "Callable[[list[CatalogueEntry]], Scaling | None]") -> float | str:
    """Return an object's value; bytes that are no value become text."""
    try:
        return entry.decoded(data, scaling_of([entry]))
    except ValueError as error:
        return f"{data.hex(' ')} ({error})"


def in_json(value: float | str) -> float | str:
    """Return a value as JSON takes it, which has no infinities."""
    return value if isinstance(value, str) or math.isfinite(value) else str(value)


def _value(entry: "CatalogueEntry", data: bytes, value: float | str) -> str:
    """Format a value for people."""
    if entry.data_type is None and shown.is_hexadecimal(entry.address) and len(data) in {1, 2, 4, 8}:
        return f"0x{int.from_bytes(data, 'little'):0{2 * len(data)}X}"
    return shown.value(value, entry.address, entry.data_type)
