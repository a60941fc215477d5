"""drive-profiles faults: faults that drives report, in words."""

# ruff: noqa: PLC0415 - canopen and pydantic are imported inside the commands, so that --help and completion stay quick

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.completion import complete_nodes
from drive_profiles.cli.console import CLEAR_EPILOG, ExitStatus, confirm, exit_on_error, fail, print_json, table
from drive_profiles.cli.options import BusOption, JsonOption, TimeoutOption

if TYPE_CHECKING:
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.device.device import Device
    from drive_profiles.device.faults import FaultReport

NodesOption = Annotated[
    list[int] | None,
    typer.Option(
        "--node", min=1, max=127, help="Node-ID; repeat for several nodes. Default: all.", autocompletion=complete_nodes
    ),
]


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


def devices_at(bus: SdoBus, nodes: list[int] | None) -> list[Device]:
    """Return the devices at these nodes, or at all that answer.

    The objects of the standard are enough; no profile is needed.

    Raises:
        typer.Exit: A node does not answer, or none does.
    """
    from drive_profiles.device.device import Device
    from drive_profiles.device.target import catalogue_of, device_at
    from drive_profiles.errors import NodeError

    there = bus.answering(nodes or range(1, 128))
    silent = sorted(set(nodes or ()) - set(there))
    if silent or not there:
        raise fail(f"node {silent[0]} does not answer" if silent else f"no node answers on {bus.address}", ExitStatus.NODE)
    devices = []
    for node in there:
        try:
            devices.append(device_at(bus, node))
        except NodeError:  # no profile is of it, or several are
            devices.append(Device(bus.port(node), catalogue_of(None, None), bus.nmt))
    return devices


def _show(reports: list[FaultReport], *, as_json: bool, err: bool = False) -> None:
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
