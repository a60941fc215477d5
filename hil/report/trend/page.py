"""Page of all runs below a folder, in that folder."""

import datetime
import math
from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from hil.report import style
from hil.report.material import run_name, treatment_name
from hil.report.origin import MEASURED, Origin
from hil.report.pages.page import Page, PageHead, PageVerdict, Section, render
from hil.report.report_table import NONE, Cell, Mark, ReportTable, number, with_error
from hil.report.style import Drawing
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
        "date (UTC)", "folder", "run", "tip peak (mm)", "rms (mm)", "order alone (mm)", "f_al (Hz)", "M_s", "gain margin (dB)",
        "phase margin (°)", "missed", "largest SYNC lateness (µs)", "within",
    )  # fmt: skip
    caption = "The newest first. Margins: from the model with the active filters, the worst over all speeds."
    return ReportTable(key, "Runs", header, rows, {0, 1, 2, 12}, caption)


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
    return PageVerdict("open", f"{gathered.results} {several} with runs, {when}", tuple(details))


BESIDE = np.timedelta64(1, "D")
"""Room before and after a single date."""
MOST_LINES = 4
"""Most treatments in one diagram; the table has all."""


def motion_figure(runs: Sequence[TrendRun], key: str, title: str) -> Drawing:
    """Draw a motion over its runs' dates, a line per treatment."""
    figure, panels = style.panels(3, 2, 6.4, sharex=True)
    treatments = list(dict.fromkeys(run.entry.treatment for run in runs))
    for name, look in zip(treatments, style.AXIS_LINES, strict=False):
        own = [run for run in runs if run.entry.treatment == name]
        for panel, (_, value) in zip(panels.flat, PANELS, strict=True):
            _draw(panel, own, value, treatment_name(name), look)
    for panel, (label, _) in zip(panels.flat, PANELS, strict=True):
        panel.set_ylabel(label)
        _scale(panel, from_zero=label not in AROUND)
    dates = np.array([_date(run) for run in runs])
    for panel in panels[-1]:
        style.date_axis(panel, dates, BESIDE, "Date (UTC)")
    style.legend_above(figure, *panels.flat)
    left = "" if len(treatments) <= MOST_LINES else f" Only {MOST_LINES} of {len(treatments)} treatments are drawn."
    caption = (
        f"A point for each run; runs that were stopped or not judged have none.{left} Margins: from the model with the active "
        "filters, the worst over all speeds."
    )
    return style.drawing(figure, key, title, caption, style.BOTH)


def _scale(panel: Axes, *, from_zero: bool) -> None:
    """Choose a scale from 0, or with plain numbers."""
    if not panel.get_lines():
        style.note(panel, "not known")
        panel.set_yticks([])
        return
    panel.ticklabel_format(axis="y", useOffset=False)
    if from_zero:
        most = max(float(np.max(np.asarray(line.get_ydata(), dtype=np.float64))) for line in panel.get_lines())
        panel.set_ylim(0.0, 1.08 * most or 1.0)


def _draw(panel: Axes, runs: Sequence[TrendRun], value: Callable[[TrendRun], float | None], name: str, look: style.Line) -> None:
    """Draw a number over the dates, of the runs that have it."""
    points = [(_date(run), found) for run in runs if (found := value(run)) is not None and math.isfinite(found)]
    if points:
        dates, values = zip(*points, strict=True)
        panel.plot(np.array(dates), np.array(values), label=name, **look)


def _date(run: TrendRun) -> np.datetime64:
    return np.datetime64(datetime.datetime.fromisoformat(run.date_utc).replace(tzinfo=None), "s")


def lateness_us(run: TrendRun) -> float | None:
    """Largest lateness of SYNC in µs; None in lock-step."""
    timing = run.entry.timing
    return None if timing is None or timing.lateness.max_s is None else 1e6 * timing.lateness.max_s


PANELS: tuple[tuple[str, Callable[[TrendRun], float | None]], ...] = (
    ("Tip peak (mm)", lambda run: run.entry.tip_peak_mm),
    ("Tip rms (mm)", lambda run: run.entry.tip_rms_mm),
    ("$f_{al}$ (Hz)", lambda run: run.entry.f_al_hz),
    ("Largest $M_s$ (–)", lambda run: None if run.margins is None else run.margins.sensitivity_peak),
    ("Missed (per million cycles)", lambda run: 1e6 * run.entry.missed_cycles / run.entry.cycles if run.entry.cycles else None),
    ("Largest SYNC lateness (µs)", lateness_us),
)
"""Panels of the figure: name, and the number of a run."""
AROUND = (PANELS[2][0], PANELS[3][0])
"""Panels whose scale need not begin at 0."""
