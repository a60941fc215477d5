"""drive-profiles nmt: network management (CiA 301) for one or all nodes."""

# ruff: noqa: PLC0415 - canopen and pydantic are imported inside the commands, so that --help and completion stay quick

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.completion import complete_nodes
from drive_profiles.cli.console import READ_EPILOG, ExitStatus, confirm, exit_on_error, fail, table
from drive_profiles.cli.live.faults import devices_at
from drive_profiles.cli.options import BusOption

if TYPE_CHECKING:
    from drive_profiles.device.bus import SdoBus

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
    node: Annotated[int | None, typer.Option("--node", min=1, max=127, help="Node-ID.", autocompletion=complete_nodes)] = None,
    *,
    all_nodes: Annotated[bool, typer.Option("--all", help="All nodes at once.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask first.")] = False,
    timeout_s: Annotated[float, typer.Option("--timeout-s", min=0.01, max=60.0, help="Longest time until an answer.")] = 0.5,
) -> None:
    """Send an NMT command to a node, or to all.

    It first shows the states of the drives, and asks.

    Stop and resets end the process data of a drive. A drive under torque then reacts as its 6007h demands.

    Examples:
        drive-profiles nmt start --bus socketcan:can0 --node 2

        drive-profiles nmt reset-communication --bus socketcan:can0 --all
    """
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.standard.cia301 import NmtCommand
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


def _wait_for_boot(bus: SdoBus, before: dict[int, int]) -> None:
    """Wait until every node has sent its boot-up message.

    Raises:
        typer.Exit: One has not.
    """
    deadline = time.monotonic() + BOOT_S
    while missing := [node for node, boots in before.items() if bus.boots(node) <= boots]:
        bus.check()
        if time.monotonic() > deadline:
            words = f"node {', node '.join(map(str, missing))}: no boot-up message within {BOOT_S:g} s"
            raise fail(words, ExitStatus.NODE)
        time.sleep(0.02)


def _seen(bus: SdoBus, node: int) -> str:
    """Return the state of a node by its last heartbeat, in words."""
    from drive_profiles.standard.cia301 import NmtState

    state = bus.nmt_state(node)
    if state is None:
        return "sent; the state is not known, because the node sends no heartbeat (1017h)"
    known = NmtState(state) if state in {each.value for each in NmtState} else None
    return f"state {state}" if known is None else known.name.lower().replace("_", "-")
