"""`hil passport`: identified errors of each gear over months."""

import datetime
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import fail, numbered
from hil.cli.console import ExitStatus, epilog_without_motion, exit_on_error, say, say_left_out, say_page, show
from hil.cli.options import JsonOption
from hil.errors import NotPossibleError

if TYPE_CHECKING:
    from hil.passport.watch import Trend

PASSPORT_EPILOG = epilog_without_motion({
    ExitStatus.DONE: "no gear has changed",
    ExitStatus.FILE: "bad file, or no passport",
    ExitStatus.NOT_MET: "a gear has changed",
})  # fmt: skip
PASSPORT_FILE, PAGE = "passport.sqlite", "passport.html"


@command(epilog=PASSPORT_EPILOG)
def passport(
    directory: Annotated[
        list[Path],
        typer.Argument(metavar="DIR", help="Folders of identifications: result.json and model files below them."),
    ],
    file: Annotated[
        Path | None, typer.Option("--file", help=f"Passport file; default: {PASSPORT_FILE} in the first folder.", dir_okay=False)
    ] = None,
    since: Annotated[
        str | None, typer.Option("--since", metavar="DATE", help="Watch runs from this date on, such as that of a new gear.")
    ] = None,
    pole_pairs: Annotated[
        list[str] | None, typer.Option("--pole-pairs", metavar="AXIS=P", help="Pole pairs of an axis' motor: 2=5; repeatable.")
    ] = None,
    slots: Annotated[
        list[str] | None, typer.Option("--slots", metavar="AXIS=Z", help="Slots of an axis' motor: 2=12; repeatable.")
    ] = None,
    note: Annotated[str, typer.Option(help="Conditions of new runs whose own notes have none: 22 °C, 3 kg, forwards.")] = "",
    as_json: JsonOption = False,
) -> None:
    """Keep the identified errors of each gear, and report changes.

    Example: hil passport bench-out --file passport.sqlite --pole-pairs 2=5 --slots 2=12
    """
    with exit_on_error(moves=False):
        from hil.passport.gather import gather
        from hil.passport.origin import Motor
        from hil.passport.store import add, read
        from hil.passport.watch import origins, trends
        from hil.report.pages.passport import table as table_of_orders
        from hil.report.pages.passport import write_passport
        from hil.results.base import RESULT_FILE

        for folder in directory:
            if not folder.is_dir():
                say(f"{folder}: there is no such folder")
                raise typer.Exit(ExitStatus.FILE)
        where, begin = file or directory[0] / PASSPORT_FILE, _date(since)
        poles, teeth = _counts(pole_pairs or [], "--pole-pairs"), _counts(slots or [], "--slots")
        motors = {axis: Motor(poles.get(axis), teeth.get(axis)) for axis in poles.keys() | teeth.keys()}
        gathered = gather(directory, note)
        if not gathered.runs and not (where.exists() and read(where)):
            say_left_out(gathered.left_out, "files")
            raise NotPossibleError(
                f"no identified transmission error below {', '.join(map(str, directory))}, and none in {where}; expected "
                f"{RESULT_FILE} or a model file of hil identify ate or hil learn; run one of these, or name its folder"
            )
        new = add(where, gathered.runs)
        runs = read(where)
        found = trends(runs, motors, begin)
        told = origins(runs, motors, begin)
        say_left_out(gathered.left_out, "files")
        say(f"{where}: {new} new runs, {len(runs)} in all")
        made = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        is_emulated = any(run.emulated for run in runs)
        page = write_passport(where.with_name(PAGE), found, told, where, made, gathered.left_out, is_emulated=is_emulated)
        if as_json:
            typer.echo(json.dumps([_entry(trend) for trend in found], indent=2, ensure_ascii=False))
        else:
            show(table_of_orders(found))
        say_page(page)
        shown = {(trend.robot, trend.axis, trend.order) for trend in found}
        for each in told:  # no model file has these orders, since they are the motor's
            if (each.robot, each.axis, each.order) not in shown:
                say(f"{each.robot}, axis {each.axis}: order {each.order:g} comes from the motor, not the gear: {each.why}")
        alarmed = [trend for trend in found if trend.is_alarmed]
        for trend in alarmed:
            say(trend.words)
        if alarmed:
            raise typer.Exit(ExitStatus.NOT_MET)


def _date(text: str | None) -> str:
    """A date of the command line in UTC; empty for none.

    Raises:
        typer.BadParameter: It is not a date.
    """
    if text is None:
        return ""
    try:
        date = datetime.datetime.fromisoformat(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not a date; expected e.g. 2026-03-01", param_hint="--since") from None
    date = date.replace(tzinfo=datetime.UTC) if date.tzinfo is None else date.astimezone(datetime.UTC)
    return date.isoformat(timespec="seconds")


def _counts(texts: list[str], option: str) -> dict[int, int]:
    """Numbers by axis.

    Raises:
        typer.Exit: One is none.
    """
    found = numbered(option, texts, "AXIS=NUMBER")
    if wrong := next((text for text in found.values() if not (text.isdecimal() and 1 <= int(text) <= 1000)), None):
        raise fail(f"{option}: {wrong!r} is not a number from 1 to 1000", ExitStatus.USAGE)
    return {axis: int(text) for axis, text in found.items()}


def _entry(trend: "Trend") -> dict[str, object]:
    first = trend.watch.first
    return {
        "robot": trend.robot, "axis": trend.axis, "order": trend.order, "quantity": "phi_deg" if trend.is_phase else "a_arcsec",
        "dates": list(trend.dates), "values": trend.values.tolist(), "standard_errors": trend.errors.tolist(),
        "alarmed_since": None if first is None else trend.dates[first], "explained": trend.watch.explained,
        "origin": trend.origin,
    }  # fmt: skip
