"""Commands on nodes: their faults, network management (CiA 301), and LSS (CiA 305)."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from drive_profiles.address import AddressError, parse_bit_rate
from drive_profiles.cli.application import Tool, command
from drive_profiles.cli.console import CLEAR_EPILOG, READ_EPILOG, ExitStatus, confirm, exit_on_error, fail, print_json, table
from drive_profiles.cli.options import BusOption, JsonOption, NodesOption, OptionalNodeOption, TimeoutOption
from drive_profiles.standard.cia301 import NmtCommand, NmtState

if TYPE_CHECKING:
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.device.device import Device
    from drive_profiles.device.faults import FaultReport
    from drive_profiles.device.lss import Lss, LssAddress

YesOption = Annotated[bool, typer.Option("--yes", help="Do not ask first.")]

# -- faults ------------------------------------------------------------------------------------------------------------


@command(epilog=CLEAR_EPILOG)
def faults(
    bus: BusOption,
    node: NodesOption = None,
    *,
    clear: Annotated[
        bool, typer.Option("--clear", help="Reset faults by the control word and clear 1003h, after a question.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before clearing.")] = False,
    timeout_s: TimeoutOption = 0.5,
    as_json: JsonOption = False,
) -> None:
    """Show the faults of drives, in words.

    They come from the state, 1001h, 603Fh and the history in 1003h.

    Examples:
        drive-profiles faults --bus socketcan:can0

        drive-profiles faults --bus socketcan:can0 --node 2 --clear
    """
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.device.faults import clear_faults, read_faults

    with exit_on_error(), SdoBus(bus, timeout_s) as opened:
        devices = devices_at(opened, node)
        reports = [read_faults(device) for device in devices]
        refused: list[str] = []
        if clear:
            loud = [device for device, report in zip(devices, reports, strict=True) if not report.is_quiet]
            if loud:
                _show(reports, as_json=False, err=True)
                confirm(f"reset faults and clear 1003h on {', '.join(f'node {each.node}' for each in loud)}?", yes=yes)
                refused = [words for device in loud for words in clear_faults(device)]
                reports = [read_faults(device) for device in devices]
        _show(reports, as_json=as_json)
    if refused:
        raise fail("\n".join(refused), ExitStatus.NODE)


def devices_at(bus: "SdoBus", nodes: list[int] | None) -> "list[Device]":
    """Return the devices at these nodes, or at all that answer.

    Raises:
        typer.Exit: A node does not answer, or none does.
    """
    from drive_profiles.device.target import any_device_at

    there = bus.answering(nodes or range(1, 128))
    silent = sorted(set(nodes or ()) - set(there))
    if silent or not there:
        alone = f"node {silent[0]} does not answer; check its supply and the node-ID" if silent else ""
        raise fail(alone or f"no node answers on {bus.address}", ExitStatus.NODE)
    return [any_device_at(bus, node) for node in there]


def _show(reports: "list[FaultReport]", *, as_json: bool, err: bool = False) -> None:
    """Print reports as a table or as JSON."""
    if as_json:
        print_json([
            {
                "node": report.node, "quiet": report.is_quiet, "state": None if report.state is None else report.state.value,
                "error_register": report.register, "error_code": report.code, "history": list(report.history),
                "words": [words for _, _, words in report.sentences],
            }
            for report in reports
        ])  # fmt: skip
        return
    rows = [
        (str(report.node), *row)
        for report in reports
        for row in ([("", "", "nothing is wrong")] if report.is_quiet else report.sentences)
    ]
    table("", ("node", "object", "value", "in words"), rows, err=err)


# -- NMT ---------------------------------------------------------------------------------------------------------------

BOOT_S = 5.0
"""Time that a node may take to come back from a reset."""
SEEN_S = 0.3
"""Time to wait for a heartbeat with the new state."""
NmtWord = Literal["start", "stop", "pre-operational", "reset-node", "reset-communication"]
_COMMANDS: dict[NmtWord, str] = {
    "start": "START",
    "stop": "STOP",
    "pre-operational": "ENTER_PRE_OPERATIONAL",
    "reset-node": "RESET_NODE",
    "reset-communication": "RESET_COMMUNICATION",
}


@command(epilog=READ_EPILOG)
def nmt(
    command: Annotated[
        NmtWord, typer.Argument(show_choices=False, help="start, stop, pre-operational, reset-node or reset-communication.")
    ],
    bus: BusOption,
    node: OptionalNodeOption = None,
    *,
    all_nodes: Annotated[bool, typer.Option("--all", help="All nodes at once.")] = False,
    yes: YesOption = False,
    timeout_s: TimeoutOption = 0.5,
) -> None:
    """Send an NMT command to a node, or to all.

    It first shows the states of the drives, and asks.

    Stop and resets end the process data of a drive. A drive under torque then reacts as its 6007h demands.

    Examples:
        drive-profiles nmt start --bus socketcan:can0 --node 2

        drive-profiles nmt reset-communication --bus socketcan:can0 --all
    """
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.standard.cia402 import State

    if (node is None) != all_nodes:
        raise fail("give one of --node and --all", ExitStatus.USAGE)
    with exit_on_error(), SdoBus(bus, timeout_s) as opened:
        there = opened.answering(range(1, 128) if node is None else [node])
        states = {device.node: device.state() for device in devices_at(opened, there)} if there else {}
        torque = {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE}
        moving = [number for number, state in states.items() if state in torque]
        rows = [(str(number), "no drive" if state is None else state.value) for number, state in states.items()]
        if node is not None and not there:
            rows.append((str(node), "not known: the node does not answer; it may be stopped"))
            states[node] = None
        table("", ("node", "state of the drive"), rows, err=True)
        named = f"node {node}" if node is not None else f"all nodes ({', '.join(map(str, states))}, and any silent node)"
        if moving:
            words = f"node {', node '.join(map(str, moving))}"
            typer.echo(f"UNDER TORQUE: {words}; without process data a drive stops as its 6007h demands, or not at all", err=True)
        confirm(f"{command}: send it to {named}?", yes=yes)
        before = {number: opened.boots(number) for number in states}
        opened.nmt(NmtCommand[_COMMANDS[command]], node or 0)
        if command in {"reset-node", "reset-communication"}:
            _wait_for_boot(opened, before)
        else:
            time.sleep(SEEN_S)
        for number in states:
            typer.echo(f"node {number}: {_seen(opened, number)}")
        if node is not None and command != "stop" and not opened.answering([node]):
            raise fail(f"node {node} does not answer", ExitStatus.NODE)


def _wait_for_boot(bus: "SdoBus", before: dict[int, int]) -> None:
    """Wait until every node has sent its boot-up message."""
    deadline = time.monotonic() + BOOT_S
    while missing := [node for node, boots in before.items() if bus.boots(node) <= boots]:
        bus.check()
        if time.monotonic() > deadline:
            words = f"node {', node '.join(map(str, missing))}: no boot-up message within {BOOT_S:g} s"
            raise fail(words, ExitStatus.NODE)
        time.sleep(0.02)


def _seen(bus: "SdoBus", node: int) -> str:
    """Return the state of a node by its last heartbeat, in words."""
    state = bus.nmt_state(node)
    if state is None:
        return "sent; the state is not known, because the node sends no heartbeat (1017h)"
    known = NmtState(state) if state in {each.value for each in NmtState} else None
    return f"state {state}" if known is None else known.name.lower().replace("_", "-")


# -- LSS ---------------------------------------------------------------------------------------------------------------

lss_app = Tool("lss", "Node-ID and bit rate of nodes, also of one without a node-ID (LSS, CiA 305).", is_group=True)


@dataclass(frozen=True, kw_only=True)
class OneNode:
    """Options that choose one node by LSS."""

    bus: BusOption
    identity: Annotated[
        str | None,
        typer.Option(
            "--identity", metavar="V,P,R,S", help="Vendor-ID, product code, revision and serial number of the node (1018h)."
        ),
    ] = None
    unconfigured: Annotated[bool, typer.Option("--unconfigured", help="The node without a node-ID, found by fast scan.")] = False
    only: Annotated[bool, typer.Option("--only", help="The only node on the bus.")] = False
    timeout_s: Annotated[float, typer.Option("--timeout-s", min=0.01, max=10.0, help="Longest time until an answer.")] = 0.2


@dataclass(frozen=True, kw_only=True)
class ChangedNode(OneNode):
    """Options that choose one node to change."""

    yes: YesOption = False


@dataclass(frozen=True, kw_only=True)
class RenamedNode(ChangedNode):
    """Options that choose one node to give a node-ID."""

    store: Annotated[bool, typer.Option("--store", help="Store the change, so that it survives a loss of power.")] = False


@lss_app.command(epilog=READ_EPILOG)
def show(one: OneNode) -> None:
    """Show identity and node-ID of one node, read by LSS.

    Example: drive-profiles lss show --unconfigured --bus socketcan:can0
    """
    _with_one(one, lambda lss, address: None)


@lss_app.command(epilog=READ_EPILOG)
def node_id(
    new: Annotated[int, typer.Argument(metavar="NODE-ID", min=1, max=127, help="The new node-ID.")],
    one: RenamedNode,
) -> None:
    """Give a node a node-ID.

    It takes effect with the node's next reset of communication (`drive-profiles nmt`).

    Example: drive-profiles lss node-id 5 --unconfigured --store --bus socketcan:can0
    """

    def change(lss: "Lss", address: "LssAddress") -> None:
        confirm(f"give {address} the node-ID {new}{' and store it' if one.store else ''}?", yes=one.yes)
        lss.configure_node_id(new)
        if one.store:
            lss.store()
        typer.echo(f"{address}: node-ID {new} takes effect with its next reset of communication")

    _with_one(one, change, taken=new)


@lss_app.command(epilog=READ_EPILOG)
def bit_rate(
    new: Annotated[str, typer.Argument(metavar="RATE", help="The new bit rate: 1M, 500k, 125k.")],
    one: ChangedNode,
) -> None:
    """Give a node a bit rate, and store it.

    It takes effect once the node has been switched off and on.

    Example: drive-profiles lss bit-rate 500k --identity 0x1,0x2,0x3,4 --bus socketcan:can0
    """
    try:
        rate = parse_bit_rate(new)
    except AddressError as error:
        raise fail(str(error), ExitStatus.USAGE) from None

    def change(lss: "Lss", address: "LssAddress") -> None:
        confirm(
            f"give {address} {rate} bit/s and store it? At another rate than its bus, the node cannot be reached.", yes=one.yes
        )
        lss.configure_bit_rate(rate)
        lss.store()
        typer.echo(f"{address}: {rate} bit/s take effect after the node is switched off and on")

    _with_one(one, change)


def _with_one(one: OneNode, change: "Callable[[Lss, LssAddress], None]", taken: int | None = None) -> None:
    """Choose one node, print its address, and act on it.

    `taken` is a node-ID that must be free.
    """
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.device.lss import Lss

    if (one.identity is not None) + one.unconfigured + one.only != 1:
        raise fail("give one of --identity, --unconfigured and --only", ExitStatus.USAGE)
    address = None if one.identity is None else _address(one.identity)
    with exit_on_error(), SdoBus(one.bus, max(one.timeout_s, 0.1)) as opened:
        there = opened.answering(range(1, 128))
        if one.only and len(there) > 1:
            raise fail(
                f"nodes {', '.join(map(str, there))} answer, but --only needs a single node; give --identity", ExitStatus.USAGE
            )
        lss = Lss(opened, one.timeout_s)
        with lss.chosen(address, unconfigured=one.unconfigured) as found:
            now = lss.node_id()
            typer.echo(f"{found}: {'no node-ID' if now is None else f'node-ID {now}'}")
            if taken is not None and taken in there and taken != now:
                raise fail(f"node-ID {taken} is taken on this bus; nothing has been changed", ExitStatus.FILE)
            change(lss, found)


def _address(text: str) -> "LssAddress":
    from drive_profiles.device.lss import LssAddress

    try:
        numbers = [int(part, 0) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or not all(0 <= number < 1 << 32 for number in numbers):
        raise fail(f"--identity {text}: expected four numbers, as 0x1,0x2,0x3,4", ExitStatus.USAGE)
    return LssAddress(*numbers)
