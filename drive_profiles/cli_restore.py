"""``drive-profiles store`` and ``restore``: what a drive keeps over a loss of power, and the ways back."""

# ruff: noqa: PLC0415 - canopen, pydantic and rich are imported inside the commands, so that --help and completion stay quick

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli_read import BusOption, EdsOption, NodeOption, ProfileOption, TimeoutOption
from drive_profiles.cli_transact import Request, transact
from drive_profiles.cli_write import JOURNALS, DryRun, Journals, Store, Yes
from drive_profiles.console import EXIT_FILE, EXIT_UNKNOWN, EXIT_USAGE, AsJson, Interrupts, confirm, fail, print_json, reported

if TYPE_CHECKING:
    from drive_profiles.device import Device
    from drive_profiles.memory import Command


def store(
    bus: BusOption,
    node: NodeOption,
    *,
    yes: Yes = False,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: AsJson = False,
) -> None:
    """Let a drive keep all that it holds now over a loss of power.

    Example: drive-profiles store --bus local:/tmp/robot.sock --node 2 --yes
    """
    from drive_profiles.memory import store_command
    from drive_profiles.outcome import Options

    with reported():
        request = Request(bus, Options(), profile, eds, timeout_s, yes, as_json=as_json)
        _give(request, node, store_command, _STORE)


def restore(
    bus: BusOption,
    node: Annotated[int | None, typer.Option("--node", min=1, max=127, help="Node-ID; a snapshot names its own.")] = None,
    *,
    snapshot: Annotated[
        Path | None, typer.Option("--snapshot", help="Write back what this journal's drive held before; of a folder the newest.")
    ] = None,
    defaults: Annotated[
        bool, typer.Option("--defaults", help="Let the drive put its factory's values back; they act after its next reset.")
    ] = False,
    dry_run: DryRun = False,
    yes: Yes = False,
    store: Store = False,
    force_commissioning: Annotated[
        bool, typer.Option("--force-commissioning", help="Write a snapshot to a device with another serial number.")
    ] = False,
    journals: Journals = JOURNALS,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: AsJson = False,
) -> None:
    """Go back: to the snapshot of an upload, or to the factory's values.

    Examples:
        drive-profiles restore --snapshot drive-journals --node 2 --bus local:/tmp/robot.sock

        drive-profiles restore --defaults --bus local:/tmp/robot.sock --node 2
    """
    from drive_profiles.outcome import Options

    if (snapshot is None) != defaults:
        raise fail("give one of --snapshot FILE and --defaults", EXIT_USAGE)
    # the drive has given the values of a snapshot itself: no fact of a profile, no limit of an EDS speaks against them
    options = Options(
        store=store, journals=journals, allow_unverified=True, limits=False, force_commissioning=force_commissioning
    )
    request = Request(bus, options, profile, eds, timeout_s, yes, dry_run, as_json)
    with reported():
        if snapshot is not None:
            _snapshot(request, snapshot, node)
        elif node is None:
            raise fail("--defaults needs --node", EXIT_USAGE)
        elif store:
            raise fail("--store would keep what --defaults lets the drive forget; reset it, then store", EXIT_USAGE)
        else:
            _defaults(request, node)


def _snapshot(request: Request, path: Path, node: int | None) -> None:
    from drive_profiles import journal
    from drive_profiles.snapshot import as_set
    from drive_profiles.target import catalogue_of

    path = _newest(path, node)
    statement = journal.read(path)
    kept = statement.snapshot
    if node is not None and node != kept.node:
        raise fail(f"{path} is of node {kept.node}, not of node {node}", EXIT_USAGE)
    typer.echo(f"{path}: {statement}", err=True)
    profile = request.profile or kept.profile or None
    wanted = as_set(kept, catalogue_of(profile, request.eds, kept.node))
    options = request.options
    if not kept.identity.get("serial_number"):  # 0 is what a device says that has none
        typer.echo(f"node {kept.node} had no serial number: see to it that it is the same device, not its twin", err=True)
        options = replace(options, force_commissioning=True)
    transact(replace(request, profile=profile, options=options), [(kept.node, wanted)])


def _newest(path: Path, node: int | None) -> Path:
    """The journal; of a folder the newest one in it, of that node where one is named."""
    if not path.is_dir():
        return path
    found = [each for each in path.glob("*.jsonl") if node is None or each.name.startswith(f"node{node}-")]
    if not found:
        raise fail(f"{path} holds no journal{'' if node is None else f' of node {node}'}", EXIT_FILE)
    return max(found, key=lambda each: each.name.partition("-")[2])


def _defaults(request: Request, node: int) -> None:
    from drive_profiles.memory import restore_command

    _give(request, node, restore_command, _DEFAULTS)


@dataclass(frozen=True)
class _Words:
    """What is said about a command: the question before it, the answer after it."""

    question: str
    done: str
    unsure: str
    key: str
    value: bool | str


_STORE = _Words(
    "let it store everything that it holds",
    "has stored what it holds",
    "whether it has stored is not known; once it answers, store again",
    "stored",
    True,
)
_DEFAULTS = _Words(
    "let it forget its values and go back to the factory's",
    "will hold its factory's values after its next reset",
    "what it will hold after its next reset is not known; once it answers, give the command again",
    "defaults",
    "after the next reset",
)


def _give(request: Request, node: int, choose: Callable[[Device], Command], words: _Words) -> None:
    """Give a drive one of the two commands, and say what came of it; Ctrl-C is remembered until it has answered.

    Raises:
        typer.Exit: It is not known what came of it.
        DriveProfileError: Nothing came of it.
    """
    from drive_profiles.bus import Bus
    from drive_profiles.errors import BusError, NoAnswerError, SdoAbortedError
    from drive_profiles.memory import has_done_nothing
    from drive_profiles.target import device_at

    with Interrupts() as interrupts, Bus(request.bus, request.timeout_s) as opened:
        device = device_at(opened, node, request.profile, request.eds)
        command = choose(device)
        device.check_quiet()
        if request.dry_run:
            typer.echo(f"would write 0x{command.signature:08X} to {command.address} of node {node}")
            return
        confirm(f"node {node}: {words.question} ({command.address}, up to {command.wait_s:g} s)?", yes=request.yes)
        device.check_quiet()  # a user may have thought for long
        interrupts.hold(f"interrupted: waiting for the answer of node {node}, up to {command.wait_s:g} s")
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
            raise fail(f"{failure}\nnode {node}: {words.unsure}", EXIT_UNKNOWN)
        if not request.as_json:
            typer.echo(f"node {node} {words.done}")
        if interrupts.event.is_set():
            typer.echo("the interrupt came too late: it had been told", err=True)
