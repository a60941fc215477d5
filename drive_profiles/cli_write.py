"""The commands of ``drive-profiles`` that write to drives, each by the same transaction."""

# ruff: noqa: PLC0415 - canopen, pydantic and rich are imported inside the commands, so that --help and completion stay quick

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drive_profiles.cli_read import (
    ALL,
    BusOption,
    ClassesOption,
    EdsOption,
    NodeOption,
    ProfileOption,
    TimeoutOption,
    class_names,
    complete_objects,
)
from drive_profiles.console import (
    EXIT_UNKNOWN,
    EXIT_USAGE,
    AsJson,
    confirm,
    fail,
    print_json,
    progress,
    reported,
    table,
)

if TYPE_CHECKING:
    from drive_profiles.bus import Bus
    from drive_profiles.fleet import Control
    from drive_profiles.outcome import Options, Outcome
    from drive_profiles.parameters import ParameterSet
    from drive_profiles.upload import Upload

Yes = Annotated[bool, typer.Option("--yes", help="Do not ask before writing.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Show what would be written, and write nothing.")]
Journals = Annotated[Path, typer.Option("--journals", help="Folder for the snapshots and journals.")]
Unverified = Annotated[bool, typer.Option("--allow-unverified", help="Write also by facts that nobody has verified.")]
Store = Annotated[bool, typer.Option("--store", help="Let the drive keep the values over a loss of power.")]
RollBack = Annotated[
    bool, typer.Option("--rollback-on-error/--no-rollback-on-error", help="Put everything back when something fails.")
]
JOURNALS = Path("drive-journals")


def upload(
    sets: Annotated[
        list[Path], typer.Argument(metavar="SET...", help="One parameter set (or DCF, concise DCF) for all nodes, or one each.")
    ],
    bus: BusOption,
    node: Annotated[list[int], typer.Option("--node", min=1, max=127, help="Node-ID; again for several drives: all or none.")],
    *,
    dry_run: DryRun = False,
    yes: Yes = False,
    store: Store = False,
    reset: Annotated[bool, typer.Option("--reset", help="After storing, reset the drives and check once more.")] = False,
    rollback_on_error: RollBack = True,
    classes: ClassesOption = ALL,
    allow_unverified: Unverified = False,
    force_commissioning: Annotated[
        bool, typer.Option("--force-commissioning", help="Write one device's commissioning values to another.")
    ] = False,
    journals: Journals = JOURNALS,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: AsJson = False,
) -> None:
    """Write parameter sets to drives: check, snapshot, write what differs, read back, store; or put everything back.

    Examples:
        drive-profiles upload axis2.toml --bus local:/tmp/robot.sock --node 2 --dry-run

        drive-profiles upload axis2.toml axis3.toml --bus socketcan:can0 --node 2 --node 3 --store
    """
    from drive_profiles.formats import is_toml
    from drive_profiles.outcome import Options
    from drive_profiles.parameters import ParameterSet

    if len(set(node)) != len(node):
        raise fail(f"--node {' --node '.join(map(str, node))}: the same drive twice", EXIT_USAGE)
    if len(sets) not in {1, len(node)}:
        raise fail(f"{len(sets)} parameter sets for {len(node)} nodes: give one for all, or one for each", EXIT_USAGE)
    if reset and not store:
        raise fail("--reset without --store would only undo the upload", EXIT_USAGE)
    options = Options(
        class_names(classes), store, reset, rollback_on_error, allow_unverified, force_commissioning, journals=journals
    )
    with reported():
        loaded: list[ParameterSet | Path] = [ParameterSet.load(path) if is_toml(path) else path for path in sets]
        pairs = list(zip(node, loaded * len(node) if len(loaded) == 1 else loaded, strict=True))
        _transact(bus, pairs, options, profile, eds, timeout_s, yes=yes, dry_run=dry_run, as_json=as_json)


def set_(
    values: Annotated[
        list[str],
        typer.Argument(metavar="OBJECT=VALUE...", help="Values in the parameters' units.", autocompletion=complete_objects),
    ],
    bus: BusOption,
    node: NodeOption,
    *,
    kind: Annotated[str | None, typer.Option("--type", help="Data type of objects that no profile or EDS knows.")] = None,
    dry_run: DryRun = False,
    yes: Yes = False,
    store: Store = False,
    rollback_on_error: RollBack = True,
    allow_unverified: Unverified = False,
    force_commissioning: Annotated[bool, typer.Option("--force-commissioning", help="Write commissioning values.")] = False,
    journals: Journals = JOURNALS,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: AsJson = False,
) -> None:
    """Write single objects, by the same transaction as `upload`.

    Example: drive-profiles set notch_1.mode=1 notch_1.start_rps=4 --bus local:/tmp/robot.sock --node 2
    """
    from drive_profiles.bus import Bus
    from drive_profiles.outcome import Options
    from drive_profiles.target import device_at

    options = Options(
        store=store,
        rollback=rollback_on_error,
        allow_unverified=allow_unverified,
        force_commissioning=force_commissioning,
        journals=journals,
    )
    with reported():
        with Bus(bus, timeout_s) as opened:
            device = device_at(opened, node, profile, eds)
        wanted = _as_set([_pair(text) for text in values], device.catalogue, kind)
        _transact(bus, [(node, wanted)], options, profile, eds, timeout_s, yes=yes, dry_run=dry_run, as_json=as_json)


def _pair(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip() or not value.strip():
        raise fail(f"{text!r}: expected OBJECT=VALUE, e.g. notch_1.mode=1 or 0x2110:1=1", EXIT_USAGE)
    return key.strip(), value.strip()


def _as_set(pairs: list[tuple[str, str]], catalogue: Any, kind: str | None) -> ParameterSet:
    """Single values as a parameter set, so that they take the same way."""
    from drive_profiles.cia301 import DataType
    from drive_profiles.parameter import address_of
    from drive_profiles.parameters import CLASSES, Item, ParameterSet

    if kind is not None and kind not in DataType.__members__:
        raise fail(f"--type {kind}: expected one of {', '.join(DataType.__members__)}", EXIT_USAGE)
    tables: dict[str, dict[str, Item]] = {name: {} for name in CLASSES}
    for key, text in pairs:
        entry = catalogue.find(key)
        value = _number(text, key, entry.data_type or (DataType[kind] if kind else None))
        if entry.parameter is not None:
            tables[entry.parameter_class][entry.name] = Item(value=value, unit=entry.unit)
            continue
        name = entry.data_type.name if entry.data_type else kind
        if name is None:
            raise fail(f"{key}: neither profile nor EDS knows its type; give --type", EXIT_USAGE)
        tables[entry.parameter_class][f"0x{address_of(entry.place)}"] = Item(value=value, type=name, name=entry.name)
    return ParameterSet.model_validate(tables)


def _number(text: str, key: str, kind: Any) -> float | str:
    """A value as a user writes it: decimal, 0x hexadecimal, or text where the object holds text or bytes."""
    if kind is not None and not (kind.is_integer or kind.is_real or kind.size):
        return text
    for convert in (lambda t: int(t, 0), float):
        with contextlib.suppress(ValueError):
            return convert(text)
    raise fail(f"{key}={text}: {text!r} is no number", EXIT_USAGE)


def _transact(
    bus: str,
    pairs: Sequence[tuple[int, ParameterSet | Path]],
    options: Options,
    profile: str | None,
    eds: Path | None,
    timeout_s: float,
    *,
    yes: bool,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Prepare all, show what would change, ask, run all, and say how each ended."""
    from drive_profiles import fleet
    from drive_profiles.bus import Bus

    with Bus(bus, timeout_s) as opened:
        uploads = [_upload(opened, node, wanted, options, profile, eds) for node, wanted in pairs]
        fleet.prepare(uploads)
        for item in uploads:
            for warning in item.warnings:
                typer.echo(f"node {item.device.node}: {warning}", err=True)
        if dry_run or not as_json:
            _show_changes(uploads, as_json=as_json and dry_run)
        if dry_run:
            return
        count = sum(len(item.changes) for item in uploads)
        if count or options.store:
            kept = " and store" if options.store else ""
            confirm(f"write {count} objects{kept} on {', '.join(f'node {node}' for node, _ in pairs)}?", yes=yes)
        total = sum(len(item.changes) + len(item.writes) for item in uploads)
        with progress("writing", total) as step, _interruptible(fleet.Control(progress=lambda node, made: step(made))) as control:
            outcomes = fleet.run(uploads, control)
    _report(outcomes, as_json=as_json)


def _upload(bus: Bus, node: int, wanted: ParameterSet | Path, options: Options, profile: str | None, eds: Path | None) -> Upload:
    """The transaction of one node; a DCF is its own EDS."""
    from drive_profiles import formats
    from drive_profiles.target import device_at
    from drive_profiles.upload import Upload

    if isinstance(wanted, Path):
        own = wanted if eds is None and wanted.suffix.lower() in formats.DEVICE_FILES else eds
        device = device_at(bus, node, profile, own)
        wanted = formats.read(wanted, device.catalogue, node)
        for line in wanted.header.not_read:
            typer.echo(f"node {node}: not taken: {line}", err=True)
    else:
        device = device_at(bus, node, profile or wanted.header.profile or None, eds)
    return Upload(device, wanted, options, bus.address)


@contextlib.contextmanager
def _interruptible(control: Control) -> Iterator[Control]:
    """Ctrl-C and SIGTERM stop an upload between two objects, and everything is put back."""
    before = {number: signal.signal(number, lambda *_: control.cancel.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield control
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _show_changes(uploads: Sequence[Upload], *, as_json: bool) -> None:
    rows: list[tuple[str, ...]] = []
    documents: list[dict[str, Any]] = []
    for item in uploads:
        node = item.device.node
        scaling = item.device.scaling([write.entry for write in item.writes])
        for write, held in item.changes:
            now = write.entry.decoded(held, scaling) if held else ""
            rows.append((str(node), str(write.entry), str(now), str(write.value), write.entry.unit))
            documents.append({
                "node": node, "object": str(write.entry), "now": now, "new": write.value, "unit": write.entry.unit,
            })  # fmt: skip
    if as_json:
        print_json(documents)
    elif rows:
        table("", ("node", "object", "now", "new", "unit"), rows)
    else:
        typer.echo("nothing differs")


def _report(outcomes: Sequence[Outcome], *, as_json: bool) -> None:
    if as_json:
        print_json(
            [{**asdict(outcome), "journal": None if outcome.journal is None else str(outcome.journal)} for outcome in outcomes]
        )
    for outcome in outcomes:
        if not as_json or outcome.kind != "done":
            typer.echo(str(outcome), err=outcome.kind != "done")
        if outcome.kind == "unknown" and outcome.journal is not None:
            typer.echo(f"node {outcome.node}: once it answers: drive-profiles restore --snapshot {outcome.journal}", err=True)
    codes = [EXIT_UNKNOWN if outcome.kind == "unknown" else outcome.exit_code for outcome in outcomes]
    if any(codes):
        raise typer.Exit(max(codes))


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
    """Let a drive keep what it holds now over a loss of power.

    Example: drive-profiles store --bus local:/tmp/robot.sock --node 2 --yes
    """
    from drive_profiles.bus import Bus
    from drive_profiles.parameter import place_of
    from drive_profiles.target import device_at
    from drive_profiles.upload import store_command

    with reported(), Bus(bus, timeout_s) as opened:
        device = device_at(opened, node, profile, eds)
        address, signature, wait_s = store_command(device)
        device.check_quiet()
        confirm(f"let node {node} store everything that it holds ({address}, up to {wait_s:g} s)?", yes=yes)
        device.write(place_of(address), signature.to_bytes(4, "little"), "the store signature", wait_s)
    if as_json:
        print_json({"node": node, "stored": True})
    else:
        typer.echo(f"node {node} has stored what it holds")


def restore(
    bus: BusOption,
    node: Annotated[int | None, typer.Option("--node", min=1, max=127, help="Node-ID; a snapshot names its own.")] = None,
    *,
    snapshot: Annotated[Path | None, typer.Option("--snapshot", help="Write back what this journal's drive held before.")] = None,
    defaults: Annotated[
        bool, typer.Option("--defaults", help="Let the drive put its factory's values back; they act after its next reset.")
    ] = False,
    dry_run: DryRun = False,
    yes: Yes = False,
    store: Store = False,
    journals: Journals = JOURNALS,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: AsJson = False,
) -> None:
    """Go back: to the snapshot of an upload, or to the factory's values.

    Examples:
        drive-profiles restore --snapshot drive-journals/node2-….jsonl --bus local:/tmp/robot.sock

        drive-profiles restore --defaults --bus local:/tmp/robot.sock --node 2
    """
    if (snapshot is None) != defaults:
        raise fail("give one of --snapshot FILE and --defaults", EXIT_USAGE)
    with reported():
        if snapshot is not None:
            _restore_snapshot(
                snapshot,
                node,
                bus,
                profile,
                eds,
                timeout_s,
                store=store,
                journals=journals,
                yes=yes,
                dry_run=dry_run,
                as_json=as_json,
            )
            return
        if node is None:
            raise fail("--defaults needs --node", EXIT_USAGE)
        _restore_defaults(bus, node, profile, eds, timeout_s, yes=yes, dry_run=dry_run, as_json=as_json)


def _restore_snapshot(
    path: Path,
    node: int | None,
    bus: str,
    profile: str | None,
    eds: Path | None,
    timeout_s: float,
    *,
    store: bool,
    journals: Path,
    yes: bool,
    dry_run: bool,
    as_json: bool,
) -> None:
    from drive_profiles import journal
    from drive_profiles.outcome import Options
    from drive_profiles.snapshot import as_set
    from drive_profiles.target import catalogue_of

    statement = journal.read(path)
    kept = statement.snapshot
    if node is not None and node != kept.node:
        raise fail(f"{path} is of node {kept.node}, not of node {node}", EXIT_USAGE)
    typer.echo(f"{path}: {statement}", err=True)
    profile = profile or kept.profile or None
    wanted = as_set(kept, catalogue_of(profile, eds, kept.node))
    # the drive has given these values itself; without a serial number it cannot be told from its twin
    options = Options(
        store=store,
        journals=journals,
        allow_unverified=True,
        limits=False,
        force_commissioning=kept.identity.get("serial_number") is None,
    )
    _transact(bus, [(kept.node, wanted)], options, profile, eds, timeout_s, yes=yes, dry_run=dry_run, as_json=as_json)


def _restore_defaults(
    bus: str, node: int, profile: str | None, eds: Path | None, timeout_s: float, *, yes: bool, dry_run: bool, as_json: bool
) -> None:
    from drive_profiles.bus import Bus
    from drive_profiles.errors import RefusedError
    from drive_profiles.parameter import place_of
    from drive_profiles.target import device_at

    with Bus(bus, timeout_s) as opened:
        device = device_at(opened, node, profile, eds)
        facts = device.profile.store if device.profile else None
        if facts is not None and facts.restore is None:
            raise RefusedError(f"a {device.profile.name if device.profile else 'drive'} has no such command: {facts.note}")
        address, signature = (facts.restore or "", facts.restore_signature) if facts else ("1011:1", 0x6461_6F6C)
        device.check_quiet()
        if dry_run:
            typer.echo(f"would write 0x{signature:08X} to {address} of node {node}")
            return
        confirm(f"let node {node} forget its values and go back to the factory's ({address})?", yes=yes)
        wait_s = facts.wait_s if facts else 5.0
        device.write(place_of(address), signature.to_bytes(4, "little"), "the restore signature", wait_s)
    if as_json:
        print_json({"node": node, "defaults": "after the next reset"})
    else:
        typer.echo(f"node {node} will hold its factory's values after its next reset")
