"""Transaction of the commands of ``drive-profiles`` that write: ask, write, report."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from drive_profiles.cli.console import ExitStatus, Interrupts, confirm, print_json, progress, table
from drive_profiles.cli.options import BusOptions
from drive_profiles.errors import OutOfRangeError, RefusedError, SdoAbortedError
from drive_profiles.standard import shown
from drive_profiles.standard.cia301 import DataType

if TYPE_CHECKING:
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.device.device import Device
    from drive_profiles.parameter_set.parameters import ParameterSet, Write
    from drive_profiles.upload.result import UploadOptions, UploadResult
    from drive_profiles.upload.upload import Upload

TOO_LATE = "the interrupt came too late: the upload finishes"
"""Line on an interrupt after which nothing is restored any more; it holds before the outcome and after it."""
MAX_ROWS = 20
"""Most changes that are shown before they are written."""


@dataclass(frozen=True)
class TransactionRequest:
    """Request of a command that writes, beside the values."""

    on: BusOptions
    options: "UploadOptions"
    yes: bool = False
    dry_run: bool = False


def transact(request: TransactionRequest, pairs: "Sequence[tuple[int, ParameterSet | Path]]") -> None:
    """Prepare uploads, show changes, ask, run, and report.

    From the first write to the end of the process Ctrl-C does not end the program: it rolls the uploads back, or comes too
    late.

    Raises:
        typer.Exit: Not every drive holds its set.
    """
    from drive_profiles.device.bus import SdoBus
    from drive_profiles.parameter_set.parameters import CLASSES
    from drive_profiles.upload import fleet

    with Interrupts() as interrupts, SdoBus(request.on.bus, request.on.timeout_s) as opened:
        uploads = [_upload(opened, node, wanted, request) for node, wanted in pairs]
        classes = request.options.classes
        if empty := [
            item.device.node for item in uploads if all(name not in classes for name, _, _ in item.parameter_set.items())
        ]:
            chosen = "" if classes == CLASSES else f" of {', '.join(classes)} (--classes)"
            raise RefusedError(f"the parameter set for node {', node '.join(map(str, empty))} holds no values{chosen}")
        fleet.prepare(uploads)
        for item in uploads:
            for warning in item.warnings:
                typer.echo(f"node {item.device.node}: {warning}", err=True)
        _show_changes(uploads, request)
        if request.dry_run:
            return
        count = sum(len(item.changes) for item in uploads)
        if count or request.options.store:
            storing = " and store" if request.options.store else ""
            nodes = ", ".join(f"node {node}" for node, _ in pairs)
            confirm(f"write {count} objects{storing} on {nodes}?", yes=request.yes)
        total = sum(len(item.changes) + len(item.writes) for item in uploads)
        back = "restoring every written value" if request.options.rollback else "nothing more will be written"
        interrupts.hold(f"interrupted: {back}; wait for the outcome", TOO_LATE)
        with progress("writing", total) as step:
            outcomes = fleet.run(uploads, fleet.UploadControl(interrupts.window, lambda node, made: step(made)))
        report(outcomes, request)
        status = exit_status(outcomes)
    if status:
        raise typer.Exit(status)


def exit_status(outcomes: "Sequence[UploadResult]") -> int:
    """Return the commands' exit status; an unknown state precedes any failure."""
    if any(outcome.kind == "unknown" for outcome in outcomes):
        return ExitStatus.UNKNOWN
    return max((outcome.exit_code for outcome in outcomes), default=0)


def _upload(bus: "SdoBus", node: int, wanted: "ParameterSet | Path", request: TransactionRequest) -> "Upload":
    """Prepare the upload of a set or file to a node."""
    from drive_profiles.cli.sets import set_for_drive
    from drive_profiles.device.target import device_at
    from drive_profiles.upload.upload import Upload

    if isinstance(wanted, Path):
        device, wanted = set_for_drive(bus, node, wanted, request.on.profile, request.on.eds)
    else:
        device = device_at(bus, node, request.on.profile or wanted.header.profile or None, request.on.eds)
    return Upload(device, wanted, request.options, bus.address)


def _show_changes(uploads: "Sequence[Upload]", request: TransactionRequest) -> None:
    """Print the changes as a table, with `--json` on standard error.

    Before a question or a result the table is short, so that the following text does not push it out of sight.
    """
    rows: list[tuple[str, ...]] = []
    documents: list[dict[str, Any]] = []
    for item in uploads:
        node = item.device.node
        for write, held in item.changes:
            now, new, unit, data_type = _in_unit(item.device, write, held)
            rows.append((str(node), str(write.entry), *shown.pair(now, new, write.address, data_type), unit))
            documents.append({"node": node, "object": str(write.entry), "now": now, "new": new, "unit": unit})
    if request.dry_run and request.on.as_json:
        print_json(documents)
    elif rows:
        listed = len(rows) if request.dry_run or len(rows) <= MAX_ROWS + 1 else MAX_ROWS
        table("", ("node", "object", "now", "new", "unit"), rows[:listed], err=request.on.as_json)
        if listed < len(rows):
            typer.echo(f"… and {len(rows) - listed} more; --dry-run shows all", err=request.on.as_json)
    else:
        typer.echo("nothing differs", err=request.on.as_json)


def _in_unit(device: "Device", write: "Write", held: bytes) -> "tuple[float | str, float | str, str, DataType | None]":
    """Return value now, new value, unit and type of a write."""
    known = device.catalogue.get(write.address)
    for entry in (known, write.entry) if known is not None and known.data_type is write.entry.data_type else (write.entry,):
        try:
            scaling = device.scaling([entry])
            new = entry.decoded(write.data, scaling)
            now = entry.decoded(held, scaling) if held else ""
        except (RefusedError, OutOfRangeError, SdoAbortedError, ValueError):  # the scaling cannot be read: raw then
            continue
        return now, new, device.catalogue.unit_of(entry), entry.data_type
    return held.hex(" "), write.data.hex(" "), "bytes", None


def report(outcomes: "Sequence[UploadResult]", request: TransactionRequest) -> None:
    """Print each result, and the next command if one is uncertain."""
    if request.on.as_json:
        print_json(
            [{**asdict(outcome), "journal": None if outcome.journal is None else str(outcome.journal)} for outcome in outcomes]
        )
    for outcome in outcomes:
        if not request.on.as_json or outcome.kind != "done":
            typer.echo(str(outcome), err=outcome.kind != "done")
        if outcome.journal is not None and not request.on.as_json:
            typer.echo(f"node {outcome.node}: its previous values are in {outcome.journal.absolute()}", err=True)
        if hint := _hint(outcome, request):
            typer.echo(f"node {outcome.node}: once it answers: {hint}", err=True)


def _hint(outcome: "UploadResult", request: TransactionRequest) -> str:
    if outcome.kind != "unknown":
        return ""
    where = f"--bus {request.on.bus} --node {outcome.node}"
    if outcome.others == "old":
        return "" if outcome.journal is None else f"drive-profiles restore --snapshot {outcome.journal} {where}"
    check = f"check that it holds the set (drive-profiles verify SET {where})"
    if outcome.stored == "unknown":
        return f"{check}, then drive-profiles store {where}"
    return f"{check}; if it does not, upload the set again"
