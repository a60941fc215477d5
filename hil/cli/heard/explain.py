"""`hil explain`: faults of a bus, from a log."""

import datetime
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import progress
from hil.cli.console import ExitStatus, epilog_without_motion, exit_on_error, say_page
from hil.cli.options import DescriptionsOption, JsonOption, bit_rate_from

if TYPE_CHECKING:
    from drive_profiles.eds.description import Description
    from hil.logs.explain import Explanation

EXPLAIN_EPILOG = epilog_without_motion({
    ExitStatus.DONE: "no fault found",
    ExitStatus.FILE: "no log, or a bad device description",
    ExitStatus.NOT_MET: "something is wrong",
})  # fmt: skip


@command(epilog=EXPLAIN_EPILOG)
def explain(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Log of a bus: candump (-l, or -ta), BLF, ASC, TRC, MF4.")],
    description: DescriptionsOption = None,
    bitrate: Annotated[str | None, typer.Option(metavar="RATE", help="Bit rate, which a log does not contain: 1M, 500k.")] = None,
    interface: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Interface to read if the log has several: can1; default: that of the first frame."),
    ] = None,
    page: Annotated[
        Path | None, typer.Option("--page", help="Write a page with a picture of each finding.", dir_okay=False)
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find the faults in a log of a bus, worst first.

    Each finding has time stamps and a remedy.

    Example: hil explain candump.log --description drive.eds:2 --bitrate 1M --page log.html
    """
    with exit_on_error(moves=False):
        from hil.logs.explain import explain as explained
        from hil.logs.opening import open_log

        rate = bit_rate_from(bitrate)
        known = dict(description_from(text) for text in description or [])
        size = log.stat().st_size if log.is_file() else 0
        with progress(f"reading {log.name}", size) as advance:
            before = 0

            def read(done: int) -> None:
                nonlocal before
                advance(done - before)
                before = done

            frames = open_log(log, read, interface)
        found = explained(frames, known, rate)
        if as_json:
            typer.echo(json.dumps(_entry(found), indent=2, ensure_ascii=False))
        else:
            _tell(found)
        if page is not None:
            from hil.report.pages.log import write_explanation

            made = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
            page.parent.mkdir(parents=True, exist_ok=True)
            say_page(write_explanation(page, found, made))
        if found.findings:
            raise typer.Exit(ExitStatus.NOT_MET)


def description_from(text: str) -> tuple[int, "Description"]:
    """A device description and its node-ID.

    Raises:
        typer.BadParameter: There is no node-ID.
        DriveProfileError: The file cannot be read.
    """
    from drive_profiles.eds.description import load

    name, _, number = text.rpartition(":")
    if not name or not number.isdigit():
        name, number = text, ""
    loaded = load(name, node_id=int(number) if number else None)
    if loaded.node_id is None:
        raise typer.BadParameter(f"{text!r} has no node-ID; expected e.g. {name}:2", param_hint="--description")
    return loaded.node_id, loaded


def _tell(found: "Explanation") -> None:
    log = found.trace.log
    typer.echo(f"{len(log)} frames in {log.duration_s:.3f} s, nodes {', '.join(map(str, found.trace.nodes)) or 'none'}")
    for number, each in enumerate(found.findings, start=1):
        where = ", ".join(f"{stamp:.6g}" for stamp in each.stamps_s)
        typer.echo(f"\n{number}. {each.severity.name.lower()}: {each.kind}\n   {each.words}")
        if where:
            typer.echo(
                f"   at {where} s" + (f" and {each.count - len(each.stamps_s)} more" if each.count > len(each.stamps_s) else "")
            )
        typer.echo(f"   → {each.remedy}")
    if not found.findings:
        typer.echo("no fault found")
    if found.unknown:
        typer.echo("\nQuestions that this log cannot answer:")
    for unknown in found.unknown:
        typer.echo(f"- {unknown.kind}{'' if unknown.node is None else f', node {unknown.node}'}: {unknown.words}")


def _entry(found: "Explanation") -> dict[str, Any]:
    log = found.trace.log
    return {
        "log": str(log.path),
        "frames": len(log),
        "duration_s": log.duration_s,
        "nodes": list(found.trace.nodes),
        "findings": [
            {
                "kind": each.kind, "severity": each.severity.name.lower(), "node": each.node, "words": each.words,
                "remedy": each.remedy, "count": each.count, "stamps_s": list(each.stamps_s),
            }
            for each in found.findings
        ],
        "cannot_tell": [{"kind": each.kind, "node": each.node, "words": each.words} for each in found.unknown],
    }  # fmt: skip
