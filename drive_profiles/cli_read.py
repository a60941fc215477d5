"""The commands of ``drive-profiles`` that read a bus and write nothing to it."""

# ruff: noqa: PLC0415 - canopen, pydantic and rich are imported inside the commands, so that --help and completion stay quick

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drive_profiles.console import EXIT_NODE, EXIT_USAGE, AsJson, fail, print_json, progress, reported, table

if TYPE_CHECKING:
    from drive_profiles.device import Found

BusOption = Annotated[
    str,
    typer.Option(
        "--bus",
        help="INTERFACE:CHANNEL[@BITRATE]: local:/tmp/robot.sock, socketcan:can0, slcan:/dev/ttyACM0@1M.",
        envvar="HIL_BUS",
    ),
]
NodeOption = Annotated[int, typer.Option("--node", min=1, max=127, help="Node-ID.")]
ProfileOption = Annotated[str | None, typer.Option("--profile", help="A name or a file; else the one that matches the identity.")]
EdsOption = Annotated[Path | None, typer.Option("--eds", help="The device's own EDS: more objects, and their limits.")]
TimeoutOption = Annotated[float, typer.Option("--timeout-s", min=0.01, max=60.0, help="How long an answer may take.")]
ClassesOption = Annotated[str, typer.Option("--classes", help="Comma-separated: tuning, limits, communication, commissioning.")]
ALL = "tuning,limits,communication,commissioning"


def complete_objects(ctx: typer.Context, incomplete: str) -> Iterable[str]:
    """Names of parameters for the shell: of the profile that is given, else of all."""
    from drive_profiles.errors import DriveProfileError
    from drive_profiles.profile import Profile, available

    chosen = ctx.params.get("profile")
    try:
        names = {name for each in ([chosen] if chosen else available()) for name in Profile.load(each).parameters}
    except DriveProfileError:
        return []
    return sorted(name for name in names if incomplete in name)


def class_names(text: str) -> tuple[str, ...]:
    """The classes of an option."""
    from drive_profiles.parameters import CLASSES

    names = tuple(name.strip() for name in text.split(",") if name.strip())
    unknown = [name for name in names if name not in CLASSES]
    if unknown or not names:
        raise fail(f"--classes {text}: expected some of {', '.join(CLASSES)}", EXIT_USAGE)
    return names


def scan(
    bus: BusOption,
    *,
    nodes: Annotated[str, typer.Option("--nodes", help="Node-IDs to ask: 1-127, or 1,2,5.")] = "1-127",
    timeout_s: TimeoutOption = 0.5,
    as_json: AsJson = False,
) -> None:
    """Ask every node who it is: only reads of 1000h, 1008h, 100Ah and 1018h.

    Example: drive-profiles scan --bus local:/tmp/robot.sock
    """
    from drive_profiles.bus import Bus
    from drive_profiles.device import found_at
    from drive_profiles.target import matching

    wanted = _nodes(nodes)
    with reported(), Bus(bus, timeout_s) as opened:
        there = opened.answering(wanted)
        rows = []
        with progress("asking", len(there)) as step:
            for node in there:
                found = found_at(opened.port(node))
                rows.append((found, matching(found)))
                step(1)
    if as_json:
        print_json([{**asdict(found), "profiles": names} for found, names in rows])
    else:
        header = ("node", "vendor", "product", "revision", "serial", "name", "profile")
        table("", header, [_row(found, names) for found, names in rows])
    if not rows:
        raise fail(
            f"no node of {nodes} answers on {bus} within {timeout_s:g} s: is the bit rate right, is everything powered?",
            EXIT_NODE,
        )


def _nodes(text: str) -> list[int]:
    found: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("-")
        if re.fullmatch(r"\s*\d{1,3}\s*(-\s*\d{1,3}\s*)?", part) is None:
            raise fail(f"--nodes {text}: expected node-IDs as 1-127, or 1,2,5", EXIT_USAGE)
        if last and int(last) < int(first):
            raise fail(f"--nodes {text}: {first}-{last} runs backwards", EXIT_USAGE)
        found |= set(range(int(first), int(last or first) + 1))
    if not found or not found <= set(range(1, 128)):
        raise fail(f"--nodes {text}: node-IDs are 1 to 127", EXIT_USAGE)
    return sorted(found)


def _row(found: Found, names: list[str]) -> tuple[str, ...]:
    return (
        str(found.node),
        _hex(found.vendor_id),
        _hex(found.product_code),
        _hex(found.revision),
        "-" if found.serial_number is None else str(found.serial_number),
        found.name or "-",
        " or ".join(names) or "-",
    )


def _hex(value: int | None) -> str:
    return "-" if value is None else f"0x{value:08X}"


def info(
    bus: BusOption,
    node: NodeOption,
    *,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: AsJson = False,
) -> None:
    """Show who a node is, its state, its errors and what is known of it.

    Example: drive-profiles info --bus socketcan:can0 --node 2
    """
    from drive_profiles.bus import Bus
    from drive_profiles.errors import NodeError, SdoAbortedError
    from drive_profiles.target import catalogue_of, device_at, matching

    with reported(), Bus(bus, timeout_s) as opened:
        try:
            device = device_at(opened, node, profile, eds)
        except NodeError:
            from drive_profiles.device import Device

            device = Device(opened.port(node), catalogue_of(None, None))
        found = device.identify()
        state = device.state()
        try:
            register: int | None = device.read((0x1001, 0))[0]
        except (SdoAbortedError, IndexError):
            register = None
        names = matching(found)
    facts: dict[str, Any] = {
        **asdict(found),
        "state": None if state is None else state.value,
        "error_register": register,
        "profiles": names,
        "known_objects": len(device.catalogue),
    }
    if as_json:
        print_json(facts)
        return
    hexadecimal = {"device_type", "vendor_id", "product_code", "revision", "error_register"}
    shown = [
        (key.replace("_", " "), "-" if value in (None, "", []) else f"0x{value:X}" if key in hexadecimal else _plain(value))
        for key, value in facts.items()
    ]
    table("", ("fact", "value"), shown)


def _plain(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def pull(
    bus: BusOption,
    node: NodeOption,
    *,
    out: Annotated[Path | None, typer.Option("--out", help="File to write; left out, or -: standard output.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file if it is there.")] = False,
    classes: ClassesOption = ALL,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: AsJson = False,
) -> None:
    """Read everything that could be written back: the parameter set that the drive is.

    What could not be read is said on standard error and in the set's header.

    Example: drive-profiles pull --bus local:/tmp/robot.sock --node 2 --out axis2.toml
    """
    from drive_profiles.bus import Bus
    from drive_profiles.target import device_at

    wanted = class_names(classes)
    if out == Path("-"):
        out = None
    with reported(), Bus(bus, timeout_s) as opened:
        device = device_at(opened, node, profile, eds)
        with progress("reading", len(device.catalogue)) as step:
            pulled = device.pull(wanted, lambda done, total: step(1))
        if out is not None:
            pulled.save(out, force=force)
    for line in pulled.header.not_read:
        typer.echo(f"not read: {line}", err=True)
    count = sum(1 for _ in pulled.items())
    if not count:
        typer.echo(f"node {node}: none of its known objects could be read and written back", err=True)
    if as_json:
        print_json(pulled.model_dump())
    elif out is None:
        typer.echo(pulled.dumps(), nl=False)
    else:
        typer.echo(f"{count} values of node {node} in {out}")


def get(
    objects: Annotated[
        list[str], typer.Argument(metavar="OBJECT...", help="0x2147:1, or a name.", autocompletion=complete_objects)
    ],
    bus: BusOption,
    node: NodeOption,
    *,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: AsJson = False,
) -> None:
    """Read objects.

    Example: drive-profiles get position_gain_per_s 0x6041 --bus local:/tmp/robot.sock --node 2
    """
    from drive_profiles.bus import Bus
    from drive_profiles.parameter import address_of
    from drive_profiles.target import device_at

    with reported(), Bus(bus, timeout_s) as opened:
        device = device_at(opened, node, profile, eds)
        entries = [device.catalogue.find(text) for text in objects]
        scaling = device.scaling(entries)
        found = []
        for entry in entries:
            data = device.read(entry.place)
            try:
                value: float | str = entry.decoded(data, scaling)
            except ValueError as error:
                value = f"{data.hex(' ')} ({error})"
            found.append((entry, data, value))
    if as_json:
        print_json(
            [
                {
                    "object": f"0x{address_of(e.place)}",
                    "name": e.name,
                    "value": str(v) if isinstance(v, float) and not math.isfinite(v) else v,
                    "unit": e.unit,
                    "bytes": d.hex(),
                }
                for e, d, v in found
            ]
        )
        return
    rows = [(address_of(e.place), e.name or "-", str(v), e.unit, d.hex(" ")) for e, d, v in found]
    table("", ("object", "name", "value", "unit", "bytes"), rows)
