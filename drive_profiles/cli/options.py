"""Options and arguments that several commands of ``drive-profiles`` take."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.address import BUS_VARIABLE, AddressError, choose_bus
from drive_profiles.cli.completion import complete_list, complete_nodes, complete_profiles
from drive_profiles.cli.console import ExitStatus, fail

if TYPE_CHECKING:
    from drive_profiles.device.device import Device


def take_bus(context: typer.Context, value: str | None) -> str | None:
    """Print the chosen bus and its origin on standard error."""
    if value is None or context.resilient_parsing:  # the shell asks for completions
        return value
    source = context.get_parameter_source("bus")
    is_option = source is not None and source.name == "COMMANDLINE"  # the name: typer has a click of its own
    try:
        choice = choose_bus(value if is_option else None)
    except AddressError as error:
        raise fail(str(error), ExitStatus.USAGE) from None
    if choice is None:
        return value
    typer.echo(str(choice), err=True)
    return choice.address


JsonOption = Annotated[bool, typer.Option("--json", help="One JSON document instead of text.")]
ProfileName = Annotated[
    str,
    typer.Argument(
        metavar="NAME",
        help="A name from `drive-profiles list`, or a profile's file; append /PRODUCT for one product.",
        autocompletion=complete_profiles,
    ),
]
BusOption = Annotated[
    str,
    typer.Option(
        "--bus",
        help="INTERFACE:CHANNEL[@BITRATE]: local:/tmp/robot.sock, socketcan:can0, slcan:/dev/ttyACM0@1M.",
        envvar=BUS_VARIABLE,
        callback=take_bus,
    ),
]
NodeOption = Annotated[int, typer.Option("--node", min=1, max=127, help="Node-ID.", autocompletion=complete_nodes)]
OptionalNodeOption = Annotated[int | None, typer.Option("--node", min=1, max=127, help="Node-ID.", autocompletion=complete_nodes)]
NodesOption = Annotated[
    list[int] | None,
    typer.Option(
        "--node", min=1, max=127, help="Node-ID; repeat for several nodes. Default: all.", autocompletion=complete_nodes
    ),
]
ProfileOption = Annotated[
    str | None,
    typer.Option(
        "--profile",
        help="Profile name or file, also with /PRODUCT. Default: the one that matches the identity.",
        autocompletion=complete_profiles,
    ),
]
EdsOption = Annotated[Path | None, typer.Option("--eds", help="The device's own EDS, for further objects and limits.")]
TimeoutOption = Annotated[float, typer.Option("--timeout-s", min=0.01, max=60.0, help="Longest time until an answer.")]
ALL = "tuning,limits,communication,commissioning"
ClassesOption = Annotated[
    str,
    typer.Option(
        "--classes",
        help="Comma-separated: tuning, limits, communication, commissioning.",
        autocompletion=complete_list(lambda: ALL.split(",")),
    ),
]
YesOption = Annotated[bool, typer.Option("--yes", help="Do not ask before writing.")]
DryRunOption = Annotated[bool, typer.Option("--dry-run", help="Show what would be written, and write nothing.")]
JournalsOption = Annotated[Path, typer.Option("--journals", help="Folder for journals; created if missing.")]
UnverifiedOption = Annotated[bool, typer.Option("--allow-unverified", help="Allow writes based on unverified profile data.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace the file if it exists.")]
StoreOption = Annotated[bool, typer.Option("--store", help="Save the values to the drive's non-volatile memory.")]
RollBackOption = Annotated[
    bool, typer.Option("--rollback-on-error/--no-rollback-on-error", help="Restore the former values when something fails.")
]
JOURNALS = Path("drive-journals")


@dataclass(frozen=True, kw_only=True)
class BusOptions:
    """Options of a command on drives of one bus."""

    bus: BusOption
    profile: ProfileOption = None
    eds: EdsOption = None
    timeout_s: TimeoutOption = 0.5
    as_json: JsonOption = False


@dataclass(frozen=True, kw_only=True)
class DriveOptions(BusOptions):
    """Options of a command on one drive."""

    node: NodeOption

    @contextlib.contextmanager
    def opened(self) -> "Iterator[Device]":
        """Open the bus and the drive at the node, as `device_at` does."""
        from drive_profiles.device.bus import SdoBus
        from drive_profiles.device.target import device_at

        with SdoBus(self.bus, self.timeout_s) as bus:
            yield device_at(bus, self.node, self.profile, self.eds)


def class_names(text: str) -> tuple[str, ...]:
    """Return the parameter classes of an option's text."""
    from drive_profiles.parameter_set.parameters import CLASSES

    names = tuple(name.strip() for name in text.split(",") if name.strip())
    unknown = [name for name in names if name not in CLASSES]
    if unknown or not names:
        raise fail(f"--classes {text}: unknown class; expected some of {', '.join(CLASSES)}", ExitStatus.USAGE)
    return names
