"""Commands of ``drive-profiles`` that compare parameter sets."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.address import BUS_VARIABLE
from drive_profiles.cli.application import command
from drive_profiles.cli.console import COMPARE_EPILOG, ExitStatus, exit_on_error, fail, print_json, table
from drive_profiles.cli.options import (
    DriveOptions,
    EdsOption,
    JsonOption,
    OptionalNodeOption,
    ProfileOption,
    TimeoutOption,
    take_bus,
)
from drive_profiles.cli.read import decoded
from drive_profiles.errors import DriveProfileError, NoAnswerError, NodeError, ProfileNotFoundError, RefusedError
from drive_profiles.standard import shown
from drive_profiles.standard.cia301 import encode

if TYPE_CHECKING:
    from drive_profiles.parameter_set.parameters import Difference
    from drive_profiles.standard.units import Scaling


@command(epilog=COMPARE_EPILOG)
def diff(
    context: typer.Context,
    left: Annotated[
        Path | None, typer.Argument(metavar="SET", help="A parameter set, DCF or concise DCF; left out with --default.")
    ] = None,
    right: Annotated[
        Path | None, typer.Argument(metavar="OTHER", help="The set to compare with; default: the drive at --node.")
    ] = None,
    *,
    default: Annotated[
        bool, typer.Option("--default", help="Show objects of the drive at --node that differ from the defaults of its EDS.")
    ] = False,
    bus: Annotated[
        str | None, typer.Option("--bus", help="Bus address, e.g. socketcan:can0 (default: $HIL_BUS).", envvar=BUS_VARIABLE)
    ] = None,
    node: OptionalNodeOption = None,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: JsonOption = False,
) -> None:
    """Compare a parameter set with another, or with a drive.

    Ends with status 7 if they differ.

    Examples:
        drive-profiles diff old.toml new.toml

        drive-profiles diff axis2.toml --bus local:/tmp/robot.sock --node 2

        drive-profiles diff --default --eds drive.eds --bus local:/tmp/robot.sock --node 2
    """
    from drive_profiles.parameter_set.formats import header_of

    if default != (left is None):
        raise fail("give either a parameter set or --default", ExitStatus.USAGE)
    with exit_on_error():
        if left is not None and right is not None:
            differences = _between_files(left, right, profile, eds, node)
        else:
            if left is not None:
                header_of(left)  # a file that cannot be read is said before the bus is opened
            if bus is None or node is None or (default and eds is None):
                needed = "--default needs --bus, --node and --eds, which states the defaults"
                raise fail(needed if default else "give a second parameter set, or --bus and --node", ExitStatus.USAGE)
            take_bus(context, bus)
            drive = DriveOptions(bus=bus, node=node, profile=profile, eds=eds, timeout_s=timeout_s)
            differences = _against_drive(left, drive) if left is not None else _against_defaults(drive, eds or Path())
    _show(differences, str(left or eds), str(right or f"node {node}"), as_json=as_json)


def _between_files(left: Path, right: Path, profile: str | None, eds: Path | None, node: int | None) -> "list[Difference]":
    """Return the differences between two sets in files, of any format."""
    from drive_profiles.cli.sets import catalogue_for
    from drive_profiles.family.catalogue import Catalogue, CatalogueEntry
    from drive_profiles.parameter_set import formats

    catalogues = []
    for path in (left, right):
        try:
            catalogues.append(catalogue_for(path, profile, eds, node))
        except ProfileNotFoundError:
            if profile is not None:
                raise
            catalogues.append(Catalogue())  # a set of a profile that is not here; it can be compared as it stands
    known = max(catalogues, key=lambda each: (each.profile is not None, len(each)))
    first, second = (formats.read(path, known, node, flagged=True) for path in (left, right))

    def scaling_of(entry: CatalogueEntry) -> "Scaling | None":
        return first.header.scaling_of(entry) or second.header.scaling_of(entry)

    return first.differences(second, known, scaling_of)


def _against_drive(path: Path, drive: DriveOptions) -> "list[Difference]":
    """Return the differences between a set and a drive, beyond limits too."""
    from drive_profiles.cli.sets import set_for_drive
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.parameter_set.parameters import Difference
    from drive_profiles.upload.checks import foreign_device

    with SdoBus(drive.bus, drive.timeout_s) as opened:
        device, wanted = set_for_drive(opened, drive.node, path, drive.profile, drive.eds)
        foreign = foreign_device(device, wanted.header, device.identify())
        if foreign:
            raise NodeError(drive.node, f"{path} is for another device: {'; '.join(foreign)}", "check node-ID and file")
        writes = device.resolve(wanted, limits=False)
        scaling = device.scaling([write.entry for write in writes])
        differences = []
        for write in writes:
            held = device.read(write.address)
            if held != write.data:
                name = write.entry.name or str(write.entry)
                value = decoded(write.entry, held, lambda _: scaling)
                differences.append(Difference(name, write.value, value, write.entry.unit))
    return differences


def _against_defaults(drive: DriveOptions, eds_file: Path) -> "list[Difference]":
    """Return the differences between an EDS's defaults and a drive."""
    from drive_profiles import eds as front_end
    from drive_profiles.eds.export import entries
    from drive_profiles.parameter_set.commands import is_command
    from drive_profiles.parameter_set.parameters import Difference

    delivered = {
        (variable.index, variable.subindex): variable.default
        for _, variable in entries(front_end.load(eds_file, node_id=drive.node).dictionary)
        if variable.default is not None
    }
    if not delivered:
        raise RefusedError(f"{eds_file} states no default")
    with drive.opened() as device:
        known = [e for e in device.catalogue if e.address in delivered and e.is_readable and e.is_writable and not e.flags]
        differences = []
        for entry in (each for each in known if not is_command(each.address, device.catalogue.profile)):
            try:
                if entry.data_type is None:
                    continue
                held, data = device.read(entry.address), encode(entry.data_type, delivered[entry.address])
                if held == data:
                    continue
                scaling = device.scaling([entry]) if entry.needs_scaling else None
                left, right = (entry.decoded(each, scaling) for each in (data, held))
            except NoAnswerError:
                raise
            except (DriveProfileError, ValueError, TypeError) as error:
                typer.echo(f"not compared: {entry}: {error}", err=True)
                continue
            differences.append(Difference(entry.name or str(entry), left, right, entry.unit))
    return differences


def _show(differences: "list[Difference]", left: str, right: str, *, as_json: bool) -> None:
    if as_json:
        print_json([difference._asdict() for difference in differences])
    elif differences:
        table("", ("parameter", left, right, "unit"), [(each.key, *_values(each), shown.unit(each.unit)) for each in differences])
    else:
        typer.echo("no difference")
    if differences:
        raise typer.Exit(ExitStatus.DIFFERS)


def _values(difference: "Difference") -> tuple[str, str]:
    """Format both values so that they differ visibly."""
    from drive_profiles.family.catalogue import address_from

    left, right = difference.left, difference.right
    address = address_from(difference.key) or (0, 0)
    if left is None or right is None:
        given = right if left is None else left
        value = "-" if given is None else shown.value(given, address)
        return ("-", value) if left is None else (value, "-")
    return shown.pair(left, right, address)


@command(epilog=COMPARE_EPILOG)
def verify(
    parameter_set: Annotated[Path, typer.Argument(metavar="SET", help="A parameter set, DCF or concise DCF.")],
    drive: DriveOptions,
) -> None:
    """Check that a drive holds a parameter set, byte for byte.

    Ends with status 7 if it does not.

    Example: drive-profiles verify axis2.toml --bus local:/tmp/robot.sock --node 2
    """
    with exit_on_error():
        differences = _against_drive(parameter_set, drive)
    _show(differences, str(parameter_set), f"node {drive.node}", as_json=drive.as_json)
