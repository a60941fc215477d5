"""Commands of ``drive-profiles`` that write to drives, each by the same transaction."""

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.completion import complete_nodes, complete_values
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
    ALL,
    JOURNALS,
    BusOptions,
    ClassesOption,
    DriveOptions,
    DryRunOption,
    JournalsOption,
    RollBackOption,
    StoreOption,
    UnverifiedOption,
    YesOption,
    class_names,
)
from drive_profiles.cli.transact import TransactionRequest, transact
from drive_profiles.errors import BusError, NoAnswerError, SdoAbortedError
from drive_profiles.standard.cia301 import DataType

if TYPE_CHECKING:
    from drive_profiles.device.device import Device
    from drive_profiles.device.memory import MemoryCommand
    from drive_profiles.parameter_set.parameters import ParameterSet
    from drive_profiles.standard.object_address import ObjectAddress


ForceCommissioningOption = Annotated[
    bool, typer.Option("--force-commissioning", help="Write commissioning values of another device, or of an unknown one.")
]
OtherDeviceOption = Annotated[
    bool, typer.Option("--other-device", help="Write a set that was pulled from another device; --yes does not cover that.")
]


@command("set", epilog=WRITE_EPILOG)
def set_(
    values: Annotated[
        list[str],
        typer.Argument(
            metavar="OBJECT=VALUE", help="An object and its value, in the parameter's unit.", autocompletion=complete_values
        ),
    ],
    drive: DriveOptions,
    *,
    kind: Annotated[
        str | None, typer.Option("--type", help="Data type, such as UNSIGNED16, of objects that no profile or EDS knows.")
    ] = None,
    dry_run: DryRunOption = False,
    yes: YesOption = False,
    store: StoreOption = False,
    rollback_on_error: RollBackOption = True,
    allow_unverified: UnverifiedOption = False,
    force_commissioning: Annotated[
        bool, typer.Option("--force-commissioning", help="Write commissioning values; else they are refused.")
    ] = False,
    journals: JournalsOption = JOURNALS,
) -> None:
    """Write single objects with the checks and rollback of `upload`.

    Give the address or the whole name of each object; a part of a name is not enough.

    Example: drive-profiles set notch_1.mode=1 notch_1.start_rps=4 --bus local:/tmp/robot.sock --node 2
    """
    from drive_profiles.upload.result import UploadOptions

    options = UploadOptions(
        store=store,
        rollback=rollback_on_error,
        allow_unverified=allow_unverified,
        force_commissioning=force_commissioning,
        journals=journals,
    )
    pairs = [_pair(text) for text in values]  # before the bus is opened
    with exit_on_error(writes=True):
        with drive.opened() as device:
            wanted = _as_set(pairs, device.catalogue, kind)
        if skipped_by_objflags := wanted.skipped_by_objflags(device.catalogue):
            named = ", ".join(skipped_by_objflags)
            raise fail(f"{named}: the EDS excludes it from downloads (ObjFlags); leave out --eds to write it", ExitStatus.FILE)
        transact(TransactionRequest(drive, options, yes, dry_run), [(drive.node, wanted)])


@command(epilog=WRITE_EPILOG)
def upload(
    sets: Annotated[
        list[Path], typer.Argument(metavar="SET", help="One parameter set (or DCF, concise DCF) for all nodes, or one each.")
    ],
    on: BusOptions,
    node: Annotated[
        list[int],
        typer.Option(
            "--node",
            min=1,
            max=127,
            help="Node-ID; repeat for several drives: the upload writes all of them or none.",
            autocompletion=complete_nodes,
        ),
    ],
    *,
    dry_run: DryRunOption = False,
    yes: YesOption = False,
    store: StoreOption = False,
    reset: Annotated[bool, typer.Option("--reset", help="After storing, reset the drives and check once more.")] = False,
    rollback_on_error: RollBackOption = True,
    classes: ClassesOption = ALL,
    allow_unverified: UnverifiedOption = False,
    force_commissioning: ForceCommissioningOption = False,
    other_device: OtherDeviceOption = False,
    journals: JournalsOption = JOURNALS,
) -> None:
    """Write parameter sets to drives, all or none.

    Each drive is checked, its values are saved in a snapshot, differing values are written and read back; with --store the
    drives also store them. After a failure all drives get their former values back.

    Examples:
        drive-profiles upload axis2.toml --bus local:/tmp/robot.sock --node 2 --dry-run

        drive-profiles upload axis2.toml axis3.toml --bus socketcan:can0 --node 2 --node 3 --store
    """
    from drive_profiles.parameter_set.formats import header_of
    from drive_profiles.upload.result import UploadOptions

    if len(set(node)) != len(node):
        raise fail(f"--node {' --node '.join(map(str, node))}: a drive is given twice; give each node once", ExitStatus.USAGE)
    if len(sets) not in {1, len(node)}:
        raise fail(
            f"{len(sets)} parameter sets for {len(node)} node{'s' * (len(node) > 1)}; give one for all, or one for each",
            ExitStatus.USAGE,
        )
    if reset and not store:
        raise fail("--reset without --store would only undo the upload; give --store as well", ExitStatus.USAGE)
    options = UploadOptions(
        class_names(classes),
        store,
        reset,
        rollback_on_error,
        allow_unverified,
        force_commissioning,
        other_device,
        journals=journals,
    )
    with exit_on_error(writes=True):
        for path in sets:
            header_of(path)  # a file that cannot be read is said before the bus is opened
        pairs = list(zip(node, sets * len(node) if len(sets) == 1 else sets, strict=True))
        transact(TransactionRequest(on, options, yes, dry_run), pairs)


def _pair(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip() or not value.strip():
        raise fail(f"{text!r}: expected OBJECT=VALUE, e.g. notch_1.mode=1 or 0x2110:1=1", ExitStatus.USAGE)
    return key.strip(), value.strip()


def _as_set(pairs: list[tuple[str, str]], catalogue: Any, type_name: str | None) -> "ParameterSet":
    from drive_profiles.parameter_set.parameters import CLASSES, Item, ParameterSet
    from drive_profiles.standard.object_address import address_text

    if type_name is not None and type_name not in DataType.__members__:
        raise fail(f"--type {type_name}: expected one of {', '.join(DataType.__members__)}", ExitStatus.USAGE)
    tables: dict[str, dict[str, Item]] = {name: {} for name in CLASSES}
    addresses: set[ObjectAddress] = set()
    for key, text in pairs:
        entry = catalogue.find(key, whole=True)  # what is written is named in full
        if entry.address in addresses:
            raise fail(f"{key}: two values for {entry}", ExitStatus.USAGE)
        addresses.add(entry.address)
        value = _number(text, key, entry.data_type or (DataType[type_name] if type_name else None))
        if entry.parameter is not None:
            tables[entry.parameter_class][entry.name] = Item(value=value, unit=entry.unit)
            continue
        name = entry.data_type.name if entry.data_type else type_name
        if name is None:
            raise fail(f"{key}: neither profile nor EDS knows its type; give --type", ExitStatus.USAGE)
        tables[entry.parameter_class][f"0x{address_text(entry.address)}"] = Item(value=value, type=name, name=entry.name)
    return ParameterSet.model_validate(tables)


def _number(text: str, key: str, data_type: Any) -> float | str:
    """Parse a user's value: decimal, 0x hexadecimal, or where allowed text."""
    if data_type is not None and not (data_type.is_integer or data_type.is_real or data_type.size):
        return text
    for convert in (lambda t: int(t, 0), float):
        with contextlib.suppress(ValueError, OverflowError):  # a whole number beyond the largest float has no finite value
            if math.isfinite(value := convert(text)):
                return value
    raise fail(f"{key}={text}: expected a finite number", ExitStatus.USAGE)


@command(epilog=STORE_EPILOG)
def store(drive: DriveOptions, *, yes: YesOption = False) -> None:
    """Let a drive store its values in its non-volatile memory.

    Example: drive-profiles store --bus local:/tmp/robot.sock --node 2 --yes
    """
    from drive_profiles.device.memory import store_command
    from drive_profiles.upload.result import UploadOptions

    with exit_on_error(writes=True):
        _give(TransactionRequest(drive, UploadOptions(), yes), drive.node, store_command, _STORE)


@command(epilog=WRITE_EPILOG)
def restore(
    on: BusOptions,
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
    request = TransactionRequest(on, options, yes, dry_run)
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

    path = _newest(path, node)
    statement = journal.read(path)
    before = statement.snapshot
    if node is not None and node != before.node:
        raise fail(f"{path} belongs to node {before.node}, not to node {node}", ExitStatus.USAGE)
    typer.echo(f"{path}: {statement}", err=True)
    profile = request.on.profile or before.profile or None
    code, revision = before.identity.get("product_code"), before.identity.get("revision")
    catalogue = catalogue_of(profile, request.on.eds, before.node, product_code=code, revision=revision)
    wanted = journal.as_set(before, catalogue)
    options = request.options
    if not before.identity.get("serial_number"):  # 0 is what a device says that has none
        typer.echo(f"node {before.node} had no serial number; check that it is the same device", err=True)
        options = replace(options, force_commissioning=True)
    transact(replace(request, on=replace(request.on, profile=profile), options=options), [(before.node, wanted)])


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


def _give(request: TransactionRequest, node: int, choose: "Callable[[Device], MemoryCommand]", words: _Words) -> None:
    """Give a drive one of the two commands, and print the result.

    Raises:
        typer.Exit: It is not known whether the drive has done it.
        DriveProfileError: The drive has not done it.
    """
    from drive_profiles.device.memory import has_done_nothing

    with Interrupts() as interrupts, DriveOptions(**{**vars(request.on), "node": node}).opened() as device:
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
        if request.on.as_json:
            print_json({"node": node, words.key: "unknown" if failure else words.value})
        if failure is not None:
            raise fail(f"{failure}\nnode {node}: {words.unsure}", ExitStatus.UNKNOWN)
        if not request.on.as_json:
            typer.echo(f"node {node} {words.done}")
