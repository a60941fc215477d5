"""Commands of ``drive-profiles`` that write to drives, each by the same transaction."""

# ruff: noqa: PLC0415 - canopen, pydantic and rich are imported inside the commands, so that --help and completion stay quick

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.completion import complete_nodes, complete_values
from drive_profiles.cli.console import WRITE_EPILOG, ExitStatus, exit_on_error, fail
from drive_profiles.cli.options import (
    ALL,
    JOURNALS,
    BusOption,
    ClassesOption,
    DryRunOption,
    EdsOption,
    JournalsOption,
    JsonOption,
    NodeOption,
    ProfileOption,
    RollBackOption,
    StoreOption,
    TimeoutOption,
    UnverifiedOption,
    YesOption,
    class_names,
)
from drive_profiles.cli.transact import TransactionRequest, transact

if TYPE_CHECKING:
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
    bus: BusOption,
    node: NodeOption,
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
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: JsonOption = False,
) -> None:
    """Write single objects with the checks and rollback of `upload`.

    Give the address or the whole name of each object; a part of a name is not enough.

    Example: drive-profiles set notch_1.mode=1 notch_1.start_rps=4 --bus local:/tmp/robot.sock --node 2
    """
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.device.target import device_at
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
        with SdoBus(bus, timeout_s) as opened:
            device = device_at(opened, node, profile, eds)
        wanted = _as_set(pairs, device.catalogue, kind)
        if skipped_by_objflags := wanted.skipped_by_objflags(device.catalogue):
            named = ", ".join(skipped_by_objflags)
            raise fail(f"{named}: the EDS excludes it from downloads (ObjFlags); leave out --eds to write it", ExitStatus.FILE)
        transact(TransactionRequest(bus, options, profile, eds, timeout_s, yes, dry_run, as_json), [(node, wanted)])


@command(epilog=WRITE_EPILOG)
def upload(
    sets: Annotated[
        list[Path], typer.Argument(metavar="SET", help="One parameter set (or DCF, concise DCF) for all nodes, or one each.")
    ],
    bus: BusOption,
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
    profile: ProfileOption = None,
    eds: EdsOption = None,
    timeout_s: TimeoutOption = 0.5,
    as_json: JsonOption = False,
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
        raise fail(f"{len(sets)} parameter sets for {len(node)} nodes; give one for all, or one for each", ExitStatus.USAGE)
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
        transact(TransactionRequest(bus, options, profile, eds, timeout_s, yes, dry_run, as_json), pairs)


def _pair(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip() or not value.strip():
        raise fail(f"{text!r}: expected OBJECT=VALUE, e.g. notch_1.mode=1 or 0x2110:1=1", ExitStatus.USAGE)
    return key.strip(), value.strip()


def _as_set(pairs: list[tuple[str, str]], catalogue: Any, type_name: str | None) -> ParameterSet:
    """Make a parameter set of single values."""
    from drive_profiles.parameter_set.parameters import CLASSES, Item, ParameterSet
    from drive_profiles.standard.cia301 import DataType
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
    """Parse a user's value: decimal, 0x hexadecimal, or text.

    Text is accepted if the object holds text or bytes.
    """
    if data_type is not None and not (data_type.is_integer or data_type.is_real or data_type.size):
        return text
    for convert in (lambda t: int(t, 0), float):
        with contextlib.suppress(ValueError, OverflowError):  # a whole number beyond the largest float has no finite value
            if math.isfinite(value := convert(text)):
                return value
    raise fail(f"{key}={text}: expected a finite number", ExitStatus.USAGE)
