"""``drive-profiles store`` and ``restore``: store values, or restore earlier ones."""

# ruff: noqa: PLC0415 - canopen, pydantic and rich are imported inside the commands, so that --help and completion stay quick

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.completion import complete_nodes
from drive_profiles.cli.console import (
    STORE_EPILOG,
    WRITE_EPILOG,
    ExitStatus,
    Interrupts,
    confirm,
    exit_on_error,
    fail,
    print_json,
)
from drive_profiles.cli.options import (
    JOURNALS,
    BusOption,
    DryRunOption,
    EdsOption,
    JournalsOption,
    JsonOption,
    NodeOption,
    ProfileOption,
    StoreOption,
    TimeoutOption,
    YesOption,
)
from drive_profiles.cli.transact import TransactionRequest, transact

if TYPE_CHECKING:
    from drive_profiles.device.device import Device
    from drive_profiles.device.memory import MemoryCommand


@command(epilog=STORE_EPILOG)
def store(
    bus: BusOption,
    node: NodeOption,
    *,
    yes: YesOption = False,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: JsonOption = False,
) -> None:
    """Let a drive store its values in its non-volatile memory.

    Example: drive-profiles store --bus local:/tmp/robot.sock --node 2 --yes
    """
    from drive_profiles.device.memory import store_command
    from drive_profiles.upload.result import UploadOptions

    with exit_on_error(writes=True):
        request = TransactionRequest(bus, UploadOptions(), profile, eds, timeout_s, yes, as_json=as_json)
        _give(request, node, store_command, _STORE)


@command(epilog=WRITE_EPILOG)
def restore(
    bus: BusOption,
    node: Annotated[
        int | None,
        typer.Option(
            "--node", min=1, max=127, help="Node-ID; with --snapshot, default: the snapshot's.", autocompletion=complete_nodes
        ),
    ] = None,
    *,
    snapshot: Annotated[
        Path | None, typer.Option("--snapshot", help="Journal with the values to restore; for a folder, its newest journal.")
    ] = None,
    defaults: Annotated[
        bool, typer.Option("--defaults", help="Restore the drive's factory settings; they take effect after its next reset.")
    ] = False,
    dry_run: DryRunOption = False,
    yes: YesOption = False,
    store: StoreOption = False,
    force_commissioning: Annotated[
        bool, typer.Option("--force-commissioning", help="Write a snapshot to a device with another serial number.")
    ] = False,
    journals: JournalsOption = JOURNALS,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: JsonOption = False,
) -> None:
    """Restore the snapshot of an upload, or the factory settings.

    Examples:
        drive-profiles restore --snapshot drive-journals --node 2 --bus local:/tmp/robot.sock

        drive-profiles restore --defaults --bus local:/tmp/robot.sock --node 2
    """
    from drive_profiles.device.memory import restore_command
    from drive_profiles.upload.result import UploadOptions

    if (snapshot is None) != defaults:
        raise fail("give either --snapshot FILE or --defaults", ExitStatus.USAGE)
    # the drive has given the values of a snapshot itself: no fact of a profile, no limit of an EDS speaks against them
    options = UploadOptions(
        store=store, journals=journals, allow_unverified=True, limits=False, force_commissioning=force_commissioning
    )
    request = TransactionRequest(bus, options, profile, eds, timeout_s, yes, dry_run, as_json)
    with exit_on_error(writes=True):
        if snapshot is not None:
            _snapshot(request, snapshot, node)
        elif node is None:
            raise fail("--defaults needs --node", ExitStatus.USAGE)
        elif store:
            raise fail("--store with --defaults would store the old values; reset the drive first, then store", ExitStatus.USAGE)
        else:
            _give(request, node, restore_command, _DEFAULTS)


def _snapshot(request: TransactionRequest, path: Path, node: int | None) -> None:
    from drive_profiles.device.target import catalogue_of
    from drive_profiles.upload import journal
    from drive_profiles.upload.journal import as_set

    path = _newest(path, node)
    statement = journal.read(path)
    before = statement.snapshot
    if node is not None and node != before.node:
        raise fail(f"{path} belongs to node {before.node}, not to node {node}", ExitStatus.USAGE)
    typer.echo(f"{path}: {statement}", err=True)
    profile = request.profile or before.profile or None
    code, revision = before.identity.get("product_code"), before.identity.get("revision")
    catalogue = catalogue_of(profile, request.eds, before.node, product_code=code, revision=revision)
    wanted = as_set(before, catalogue)
    options = request.options
    if not before.identity.get("serial_number"):  # 0 is what a device says that has none
        typer.echo(f"node {before.node} had no serial number; check that it is the same device", err=True)
        options = replace(options, force_commissioning=True)
    transact(replace(request, profile=profile, options=options), [(before.node, wanted)])


def _newest(path: Path, node: int | None) -> Path:
    """Return the path of the journal; in a folder the newest."""
    if not path.is_dir():
        return path
    journals = [each for each in path.glob("*.jsonl") if node is None or each.name.startswith(f"node{node}-")]
    if not journals:
        raise fail(f"{path} holds no journal{'' if node is None else f' of node {node}'}", ExitStatus.FILE)
    return max(journals, key=lambda each: each.name.partition("-")[2])


@dataclass(frozen=True)
class _Words:
    """Sentences on a command: the question before it, the answer after it."""

    question: str
    done: str
    unsure: str
    key: str
    value: bool | str


_STORE = _Words(
    "store all its values",
    "has stored its values",
    "it is unknown whether the drive has stored its values; once the drive answers, store again",
    "stored",
    True,
)
_DEFAULTS = _Words(
    "drop its values and restore the factory settings",
    "will hold its factory settings after its next reset",
    "the values after the next reset are unknown; once the drive answers, repeat the command",
    "defaults",
    "after the next reset",
)


def _give(request: TransactionRequest, node: int, choose: Callable[[Device], MemoryCommand], words: _Words) -> None:
    """Give a drive one of the two commands, and print the result.

    Ctrl-C is held until the drive has answered.

    Args:
        request: Bus and options of the command.
        node: Node-ID of the drive.
        choose: Maker of the memory command for a device.
        words: Sentences on the command.

    Raises:
        typer.Exit: It is not known whether the drive has done it.
        DriveProfileError: The drive has not done it.
    """
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.device.memory import has_done_nothing
    from drive_profiles.device.target import device_at
    from drive_profiles.errors import BusError, NoAnswerError, SdoAbortedError

    with Interrupts() as interrupts, SdoBus(request.bus, request.timeout_s) as opened:
        device = device_at(opened, node, request.profile, request.eds)
        command = choose(device)
        command.check(device)
        device.check_quiet()
        if request.dry_run:
            typer.echo(f"would write 0x{command.signature:08X} to {command.written_address} of node {node}")
            return
        confirm(f"node {node}: {words.question} ({command.written_address}, up to {command.wait_s:g} s)?", yes=request.yes)
        device.check_quiet()  # a user may have thought for long
        told = f"the interrupt came too late: node {node} has the command; it may take {command.wait_s:g} s to answer"
        interrupts.hold("interrupted: nothing has been written", told)
        if not interrupts.window.close():
            raise typer.Exit(ExitStatus.INTERRUPTED)
        failure: Exception | None = None
        try:
            command.give(device)
        except SdoAbortedError as error:
            if has_done_nothing(error):
                raise
            failure = error
        except (NoAnswerError, BusError) as error:
            failure = error
        if request.as_json:
            print_json({"node": node, words.key: "unknown" if failure else words.value})
        if failure is not None:
            raise fail(f"{failure}\nnode {node}: {words.unsure}", ExitStatus.UNKNOWN)
        if not request.as_json:
            typer.echo(f"node {node} {words.done}")
