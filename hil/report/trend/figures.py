"""Figure of a motion over dates: tip, f_al, margins, misses, lateness."""

import datetime
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

from hil.report import style
from hil.report.material import treatment_name
from hil.report.style import Drawing
from hil.report.trend.gather import TrendRun

BESIDE = np.timedelta64(1, "D")
"""Room before and after a single date."""
MOST_LINES = 4
"""Most treatments in one diagram; the table has all."""


def motion_figure(runs: Sequence[TrendRun], key: str, title: str) -> Drawing:
    """Draw a motion in one window over the dates of its runs.

    Each treatment has a line.
    """
    figure, panels = style.panels(3, 2, 6.4, sharex=True)
    treatments = list(dict.fromkeys(run.entry.treatment for run in runs))
    for name, look in zip(treatments, style.AXIS_LINES, strict=False):
        own = [run for run in runs if run.entry.treatment == name]
        for panel, (_, value) in zip(panels.flat, PANELS, strict=True):
            _draw(panel, own, value, treatment_name(name), look)
    for panel, (label, _) in zip(panels.flat, PANELS, strict=True):
        panel.set_ylabel(label)
        _scale(panel, from_zero=label not in AROUND)
    dates = [_date(run) for run in runs]
    if len(set(dates)) == 1:
        panels[0, 0].set_xlim(dates[0] - BESIDE, dates[0] + BESIDE)
    for panel in panels[-1]:
        locator: Any = AutoDateLocator(maxticks=6)  # type: ignore[no-untyped-call]
        panel.xaxis.set_major_locator(locator)
        panel.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
        panel.set_xlabel("Date (UTC)")
    style.legend_above(figure, *panels.flat)
    left = "" if len(treatments) <= MOST_LINES else f" Only {MOST_LINES} of {len(treatments)} treatments are drawn."
    return Drawing(
        key,
        title,
        "",
        "measured and computed",
        f"A point for each run; runs that were stopped or not judged have none.{left} Margins: from the model with the active "
        "filters, the worst over all speeds.",
        style.to_svg(figure, key),
    )


def _scale(panel: Axes, *, from_zero: bool) -> None:
    """Choose a scale that does not magnify small changes.

    It begins at 0, or has plain numbers at its ticks.
    """
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


def _misses(run: TrendRun) -> float | None:
    return 1e6 * run.entry.missed_cycles / run.entry.cycles if run.entry.cycles else None


def lateness_us(run: TrendRun) -> float | None:
    """Largest lateness of SYNC in µs; None in lock-step."""
    timing = run.entry.timing
    return None if timing is None or timing.lateness.max_s is None else 1e6 * timing.lateness.max_s


PANELS: tuple[tuple[str, Callable[[TrendRun], float | None]], ...] = (
    ("Tip peak (mm)", lambda run: run.entry.tip_peak_mm),
    ("Tip rms (mm)", lambda run: run.entry.tip_rms_mm),
    ("$f_{al}$ (Hz)", lambda run: run.entry.f_al_hz),
    ("Largest $M_s$ (–)", lambda run: None if run.margins is None else run.margins.sensitivity_peak),
    ("Missed (per million cycles)", _misses),
    ("Largest SYNC lateness (µs)", lateness_us),
)
"""Panels of the figure: name, and the number of a run."""
AROUND = (PANELS[2][0], PANELS[3][0])
"""Panels whose scale need not begin at 0."""
