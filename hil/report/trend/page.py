"""Page of all runs below a folder, in that folder."""

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from markupsafe import Markup

from hil.report import style
from hil.report.material import run_name, treatment_name
from hil.report.origin import MEASURED, Origin
from hil.report.pages.page import Page, PageHead, PageVerdict, Section, render
from hil.report.report_table import NONE, Cell, Mark, ReportTable, number, with_error
from hil.report.style import Drawing
from hil.report.trend.figures import lateness_us, motion_figure
from hil.report.trend.gather import GatheredRuns, TrendRun

TREND_FILE = "trend.html"
MOST_LISTED = 2000
"""Most windows in the tables; the newest are shown."""
MOST_MOTIONS = 40
"""Most figures."""
SHOWN_REASONS = 50
"""Most results that are named with the reason why they were not read."""


def write_trend(folder: Path, gathered: GatheredRuns) -> Path:
    """Write `trend.html` into a folder, and return its path.

    Raises:
        OSError: The page cannot be written.
    """
    robots = sorted({run.robot for run in gathered.runs})
    shown = gathered.runs[-MOST_LISTED:]
    sections = []
    with style.styled():
        drawings = _drawings(gathered.runs)
    for place, robot in enumerate(robots, 1):
        own = tuple(drawing for name, drawing in drawings if name == robot)
        rows = [run for run in shown if run.robot == robot]
        items: tuple[Drawing | ReportTable, ...] = (*own, _table(rows, f"runs-{place}"))
        sections.append(Section(f"robot-{place}", robot, items))
    emulated = any(run.robot.endswith(", emulated") for run in gathered.runs)
    band = "Emulated: this folder has runs on an emulated robot; the title of each chapter says so."
    head = PageHead(
        str(folder),
        None,
        tuple(_notes(gathered, len(gathered.runs) - len(shown), len(drawings))),
        heading="Runs by date",
        subtitle="All runs below a folder",
        origin=Origin("emulated", band, is_emulated=True) if emulated else MEASURED,
        is_bench=False,
    )
    return render(folder / TREND_FILE, Page(head, verdict(gathered), sections))


def _drawings(runs: Sequence[TrendRun]) -> list[tuple[str, Drawing]]:
    """Figures of all motions, by robot."""
    ordered = sorted(runs, key=_motion)  # stable: by date within each
    made = []
    for place, (_, each) in enumerate(groupby(ordered, key=_motion)):
        if place == MOST_MOTIONS:
            break
        own = list(each)
        entry = own[0].entry
        title = run_name(entry).replace(f", {treatment_name(entry.treatment)}", "", 1)
        made.append((own[0].robot, motion_figure(own, f"motion-{place + 1}", f"{title[0].upper()}{title[1:]}")))
    return made


def _motion(run: TrendRun) -> tuple[str, str, int, str, int]:
    entry = run.entry
    return run.robot, entry.experiment, entry.axis or 0, entry.loop, entry.order or 0


def _table(runs: Sequence[TrendRun], key: str) -> ReportTable:
    """Table of the windows, the newest first."""
    rows: list[list[Cell]] = []
    for run in reversed(runs):
        entry = run.entry
        order, f_al = with_error(entry.order_mm, entry.order_error_mm), with_error(entry.f_al_hz, entry.f_al_error_hz)
        state: Cell = Mark(entry.within_spec)
        if entry.stopped or entry.invalid:
            state = Mark(False if entry.stopped else None, "stopped" if entry.stopped else "not judged")
        link = Markup("<a href='{}/report.html'>{}</a>").format(run.folder, run.folder) if run.folder != "." else "."
        rows.append([
            run.date_utc[:16].replace("T", " "), link, run.case, number(entry.tip_peak_mm, "{:.4f}"),
            number(entry.tip_rms_mm, "{:.4f}"), order, f_al, *_margin_cells(run), f"{entry.missed_cycles} of {entry.cycles}",
            number(lateness_us(run), "{:.0f}"), state,
        ])  # fmt: skip
    header = (
        "date (UTC)", "folder", "run", "tip peak (mm)", "rms (mm)", "the order (mm)", "f_al (Hz)", "M_s", "gain margin (dB)",
        "phase margin (°)", "missed", "largest SYNC lateness (µs)", "within",
    )  # fmt: skip
    caption = "The newest first. Margins: from the model with the active filters, the worst over all speeds."
    return ReportTable(key, "Runs", "", header, rows, frozenset({0, 1, 2, 12}), caption)


def _margin_cells(run: TrendRun) -> tuple[str, str, str]:
    found = run.margins
    if found is None:
        return NONE, NONE, NONE
    return (
        number(found.sensitivity_peak, "{:.2f}"),
        number(found.gain_margin_db, "{:.1f}"),
        number(found.phase_margin_deg, "{:.1f}"),
    )


def _notes(gathered: GatheredRuns, rows_left: int, figures: int) -> list[str]:
    notes = []
    if gathered.left_out:
        count = len(gathered.left_out)
        notes.append(f"{count} results were not read:" if count > 1 else "A result was not read:")
        notes += [f"`{text}`" for text in gathered.left_out[:SHOWN_REASONS]]
        if count > SHOWN_REASONS:
            notes.append(f"and {count - SHOWN_REASONS} more.")
    if gathered.others:
        words = ", ".join(f"{count} of hil {command}" for command, count in gathered.others.items())
        notes.append(f"Results of other commands are not shown here: {words}. hil passport follows transmission errors.")
    if gathered.copies:
        several = f"{gathered.copies} results are copies of others, and are"
        copies = "A result is a copy of another, and is" if gathered.copies == 1 else several
        notes.append(f"{copies} not counted again.")
    if rows_left:
        notes.append(f"The {rows_left} oldest windows are in the figures, not in the tables.")
    if figures == MOST_MOTIONS:
        notes.append(f"Only {MOST_MOTIONS} motions are drawn.")
    return notes


def verdict(gathered: GatheredRuns) -> PageVerdict:
    """Count runs and their dates, and those stopped or outside their specification."""
    runs = gathered.runs
    first, last = runs[0].date_utc[:10], runs[-1].date_utc[:10]
    when = first if first == last else f"{first} to {last}"
    stopped = {(run.folder, run.entry.recording) for run in runs if run.entry.stopped}
    outside = {(run.folder, run.entry.recording) for run in runs if run.entry.within_spec is False and not run.entry.stopped}
    several = "results" if gathered.results > 1 else "result"
    details = []
    if stopped:
        details.append(f"Runs that were stopped: {len(stopped)}.")
    if outside:
        details.append(f"Runs outside the specification: {len(outside)}.")
    if gathered.left_out:
        details.append(f"Results that were not read: {len(gathered.left_out)}.")
    return PageVerdict("open", "▲", f"{gathered.results} {several} with runs, {when}", tuple(details))
