"""Commands of ``drive-profiles`` that compare parameter sets, with each other or with what a drive holds."""

# ruff: noqa: PLC0415 - canopen and pydantic are imported inside the commands, so that --help and completion stay quick

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.console import COMPARE_EPILOG, ExitStatus, exit_on_error, fail, print_json, table
from drive_profiles.cli.options import (
    BusOption,
    EdsOption,
    JsonOption,
    NodeOption,
    OptionalBusOption,
    OptionalNodeOption,
    ProfileOption,
    TimeoutOption,
    take_bus,
)
from drive_profiles.standard import shown

if TYPE_CHECKING:
    from drive_profiles.parameter_set.parameters import Difference, ParameterSet


def mount(app: typer.Typer) -> None:
    """Add these commands to an application."""
    app.command("diff", epilog=COMPARE_EPILOG)(diff)
    app.command("verify", epilog=COMPARE_EPILOG)(verify)


def diff(
    context: typer.Context,
    left: Annotated[Path, typer.Argument(metavar="SET", help="A parameter set.")],
    right: Annotated[Path | None, typer.Argument(metavar="OTHER", help="Another; left out: the drive at --node.")] = None,
    *,
    bus: OptionalBusOption = None,
    node: OptionalNodeOption = None,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: JsonOption = False,
) -> None:
    """Compare a parameter set with another, or with what a drive holds; ends with 7 where they differ.

    Examples:
        drive-profiles diff old.toml new.toml

        drive-profiles diff axis2.toml --bus local:/tmp/robot.sock --node 2
    """
    from drive_profiles.parameter_set.parameters import ParameterSet

    with exit_on_error():
        first = ParameterSet.load(left)
        if right is not None:
            differences = first.differences(ParameterSet.load(right))
            header = ("parameter", str(left), str(right), "unit")
        elif bus is None or node is None:
            raise fail("give a second parameter set, or --bus and --node", ExitStatus.USAGE)
        else:
            take_bus(context, bus)
            differences = _against_drive(first, bus, node, profile, eds, timeout_s)
            header = ("parameter", str(left), f"node {node}", "unit")
    _show(differences, header, as_json=as_json)


def _against_drive(
    wanted: ParameterSet, bus: str, node: int, profile: str | None, eds: Path | None, timeout_s: float
) -> list[Difference]:
    """Differences between a parameter set and the objects of a drive."""
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.device.target import device_at
    from drive_profiles.parameter_set.parameters import Difference

    with SdoBus(bus, timeout_s) as opened:
        device = device_at(opened, node, profile or wanted.header.profile or None, eds)
        writes = device.resolve(wanted)
        scaling = device.scaling([write.entry for write in writes])
        differences = []
        for write in writes:
            held = device.read(write.address)
            if held != write.data:
                name = write.entry.name or str(write.entry)
                differences.append(Difference(name, write.value, write.entry.decoded(held, scaling), write.entry.unit))
    return differences


def _show(differences: list[Difference], header: tuple[str, ...], *, as_json: bool) -> None:
    if as_json:
        print_json([difference._asdict() for difference in differences])
    elif differences:
        table("", header, [(each.key, *_values(each), shown.unit(each.unit)) for each in differences])
    else:
        typer.echo("no difference")
    if differences:
        raise typer.Exit(ExitStatus.DIFFERS)


def _values(difference: Difference) -> tuple[str, str]:
    """Both values, as long as it takes to tell them apart; a dash for a set without the object."""
    from drive_profiles.family.catalogue import address_from

    left, right = difference.left, difference.right
    address = address_from(difference.key) or (0, 0)
    if left is None or right is None:
        given = right if left is None else left
        value = "-" if given is None else shown.value(given, address)
        return ("-", value) if left is None else (value, "-")
    return shown.pair(left, right, address)


def verify(
    parameter_set: Annotated[Path, typer.Argument(metavar="SET", help="A parameter set.")],
    bus: BusOption,
    node: NodeOption,
    *,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: JsonOption = False,
) -> None:
    """Check that a drive holds a parameter set, byte for byte; ends with 7 where it does not.

    Example: drive-profiles verify axis2.toml --bus local:/tmp/robot.sock --node 2
    """
    from drive_profiles.parameter_set.parameters import ParameterSet

    with exit_on_error():
        wanted = ParameterSet.load(parameter_set)
        differences = _against_drive(wanted, bus, node, profile, eds, timeout_s)
    _show(differences, ("parameter", str(parameter_set), f"node {node}", "unit"), as_json=as_json)
