"""The commands of ``drive-profiles`` that write to drives, each by the same transaction."""

# ruff: noqa: PLC0415 - canopen, pydantic and rich are imported inside the commands, so that --help and completion stay quick

from __future__ import annotations

import contextlib
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
from drive_profiles.cli_transact import Request, transact
from drive_profiles.console import EXIT_USAGE, AsJson, fail, reported

if TYPE_CHECKING:
    from drive_profiles.parameter import Place
    from drive_profiles.parameters import ParameterSet

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
        transact(Request(bus, options, profile, eds, timeout_s, yes, dry_run, as_json), pairs)


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
    """Write single objects, each named in full, by the same transaction as `upload`.

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
        transact(Request(bus, options, profile, eds, timeout_s, yes, dry_run, as_json), [(node, wanted)])


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
    places: set[Place] = set()
    for key, text in pairs:
        entry = catalogue.find(key, whole=True)  # what is written is named in full
        if entry.place in places:
            raise fail(f"{key}: two values for {entry}", EXIT_USAGE)
        places.add(entry.place)
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
