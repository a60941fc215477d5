"""drive-profiles lss: node-ID and bit rate of nodes (CiA 305)."""

# ruff: noqa: PLC0415 - canopen is imported inside the commands, so that --help and completion stay quick

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.application import Tool
from drive_profiles.cli.console import READ_EPILOG, ExitStatus, confirm, exit_on_error, fail
from drive_profiles.cli.options import BusOption

if TYPE_CHECKING:
    from drive_profiles.device.lss import Lss, LssAddress

lss_app = Tool("lss", "Node-ID and bit rate of nodes, also of one without a node-ID (LSS, CiA 305).", is_group=True)

IdentityOption = Annotated[
    str | None,
    typer.Option(
        "--identity", metavar="V,P,R,S", help="Vendor-ID, product code, revision and serial number of the node (1018h)."
    ),
]
UnconfiguredOption = Annotated[bool, typer.Option("--unconfigured", help="The node without a node-ID, found by fast scan.")]
OnlyOption = Annotated[bool, typer.Option("--only", help="The only node on the bus.")]
StoreOption = Annotated[bool, typer.Option("--store", help="Store the change, so that it survives a loss of power.")]
YesOption = Annotated[bool, typer.Option("--yes", help="Do not ask first.")]
LssTimeoutOption = Annotated[float, typer.Option("--timeout-s", min=0.01, max=10.0, help="Longest time until an answer.")]


@lss_app.command(epilog=READ_EPILOG)
def show(
    bus: BusOption,
    *,
    identity: IdentityOption = None,
    unconfigured: UnconfiguredOption = False,
    only: OnlyOption = False,
    timeout_s: LssTimeoutOption = 0.2,
) -> None:
    """Show identity and node-ID of one node, read by LSS.

    Example: drive-profiles lss show --unconfigured --bus socketcan:can0
    """
    _with_one(bus, identity, unconfigured, only, timeout_s, lambda lss, address: None)


@lss_app.command(epilog=READ_EPILOG)
def node_id(
    new: Annotated[int, typer.Argument(metavar="NODE-ID", min=1, max=127, help="The new node-ID.")],
    bus: BusOption,
    *,
    identity: IdentityOption = None,
    unconfigured: UnconfiguredOption = False,
    only: OnlyOption = False,
    store: StoreOption = False,
    yes: YesOption = False,
    timeout_s: LssTimeoutOption = 0.2,
) -> None:
    """Give a node a node-ID.

    It takes effect with the node's next reset of communication (`drive-profiles nmt`).

    Example: drive-profiles lss node-id 5 --unconfigured --store --bus socketcan:can0
    """

    def change(lss: Lss, address: LssAddress) -> None:
        confirm(f"give {address} the node-ID {new}{' and store it' if store else ''}?", yes=yes)
        lss.configure_node_id(new)
        if store:
            lss.store()
        typer.echo(f"{address}: node-ID {new} takes effect with its next reset of communication")

    _with_one(bus, identity, unconfigured, only, timeout_s, change, taken=new)


@lss_app.command(epilog=READ_EPILOG)
def bit_rate(
    new: Annotated[str, typer.Argument(metavar="RATE", help="The new bit rate: 1M, 500k, 125k.")],
    bus: BusOption,
    *,
    identity: IdentityOption = None,
    unconfigured: UnconfiguredOption = False,
    only: OnlyOption = False,
    yes: YesOption = False,
    timeout_s: LssTimeoutOption = 0.2,
) -> None:
    """Give a node a bit rate, and store it.

    It takes effect once the node has been switched off and on.

    Example: drive-profiles lss bit-rate 500k --identity 0x1,0x2,0x3,4 --bus socketcan:can0
    """
    from drive_profiles.address import AddressError, parse_bit_rate

    try:
        rate = parse_bit_rate(new)
    except AddressError as error:
        raise fail(str(error), ExitStatus.USAGE) from None

    def change(lss: Lss, address: LssAddress) -> None:
        confirm(f"give {address} {rate} bit/s and store it? At another rate than its bus, the node cannot be reached.", yes=yes)
        lss.configure_bit_rate(rate)
        lss.store()
        typer.echo(f"{address}: {rate} bit/s take effect after the node is switched off and on")

    _with_one(bus, identity, unconfigured, only, timeout_s, change)


def _with_one(
    bus: str,
    identity: str | None,
    unconfigured: bool,
    only: bool,
    timeout_s: float,
    change: Callable[[Lss, LssAddress], None],
    taken: int | None = None,
) -> None:
    """Choose one node, print its address, and act on it.

    Args:
        bus: The bus.
        identity: Text of `--identity`.
        unconfigured: Choose by fast scan.
        only: Choose the only node of the bus.
        timeout_s: Time to an answer.
        change: What is done with the chosen node.
        taken: Node-ID that must be free.
    """
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.device.lss import Lss

    if (identity is not None) + unconfigured + only != 1:
        raise fail("give one of --identity, --unconfigured and --only", ExitStatus.USAGE)
    address = None if identity is None else _address(identity)
    with exit_on_error(), SdoBus(bus, max(timeout_s, 0.1)) as opened:
        there = opened.answering(range(1, 128))
        if only and len(there) > 1:
            raise fail(
                f"nodes {', '.join(map(str, there))} answer, but --only needs a single node; give --identity", ExitStatus.USAGE
            )
        lss = Lss(opened, timeout_s)
        with lss.chosen(address, unconfigured=unconfigured) as found:
            now = lss.node_id()
            typer.echo(f"{found}: {'no node-ID' if now is None else f'node-ID {now}'}")
            if taken is not None and taken in there and taken != now:
                raise fail(f"node-ID {taken} is taken on this bus; nothing has been changed", ExitStatus.FILE)
            change(lss, found)


def _address(text: str) -> LssAddress:
    from drive_profiles.device.lss import LssAddress

    try:
        numbers = [int(part, 0) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or not all(0 <= number < 1 << 32 for number in numbers):
        raise fail(f"--identity {text}: expected four numbers, as 0x1,0x2,0x3,4", ExitStatus.USAGE)
    return LssAddress(*numbers)
