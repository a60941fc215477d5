"""The page of a passport, each order over dates: one self-contained HTML file."""

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from hil.passport.regression import FEWEST_BEFORE
from hil.passport.watch import FALSE_ALARMS, OrderOrigin, Trend
from hil.report import style
from hil.report.origin import MEASURED, Origin
from hil.report.pages.page import Page, PageHead, PageVerdict, Section, render
from hil.report.report_table import NONE, Cell, Mark, ReportTable, number, value_and_error
from hil.report.style import Drawing

MOST_FIGURES = 60
"""Figures on one page; the table has all orders."""
EMULATED = "Emulated: this passport has runs on an emulated robot."


def write_passport(
    path: Path, trends: Sequence[Trend], origins: Sequence[OrderOrigin], file: Path, made_utc: str, left_out: Sequence[str] = (),
    *, is_emulated: bool = False,
) -> Path:  # fmt: skip
    """Write the page of a passport.

    Raises:
        OSError: The page cannot be written.
    """
    gears = list(dict.fromkeys((trend.robot, trend.axis) for trend in trends))
    with style.styled():
        figures = _figures(trends)
    chapters = [Section("orders", "Orders", (table(trends),))]
    if origins:
        rows: list[list[Cell]] = [[f"{each.robot}, axis {each.axis}", f"{each.order:g}", each.name, each.why] for each in origins]
        header, caption = ("gear", "order", "from", "why"), "The runs do not show whether motor or gear is the cause."
        told = ReportTable("origins", "Origins of the orders", header, rows, {0, 2, 3}, caption)
        chapters.append(Section("origins", "Gear or motor", (told,)))
    for robot, axis in gears:
        own = tuple(figure for gear, figure in figures if gear == (robot, axis))
        if own:
            chapters.append(Section(f"gear-{robot}-{axis}".replace(" ", "-"), f"{robot}, axis {axis}", own))
    robots = ", ".join(dict.fromkeys(robot for robot, _ in gears)) or "no gear"
    head = PageHead(
        robots,
        made_utc,
        tuple(left_out),
        heading="Passport of gears",
        subtitle="Transmission errors over the months",
        origin=Origin("emulated", EMULATED, is_emulated=True) if is_emulated else MEASURED,
    )
    return render(path, Page(head, verdict(trends), chapters, provenance=[("Passport", str(file))]))


def _figures(trends: Sequence[Trend]) -> list[tuple[tuple[str, int], Drawing]]:
    made = []
    phases = {(each.robot, each.axis, each.order): each for each in trends if each.is_phase}
    for trend in [each for each in trends if not each.is_phase][:MOST_FIGURES]:
        phase = phases.get((trend.robot, trend.axis, trend.order))
        key = f"order-{trend.robot}-{trend.axis}-{trend.order:g}".replace(" ", "-").replace(".", "-")
        title = f"{trend.robot}, axis {trend.axis}: order {trend.order:g}"
        made.append(((trend.robot, trend.axis), order_over_dates(trend, phase, key, title)))
    return made


def verdict(trends: Sequence[Trend]) -> PageVerdict:
    """Verdict at the top of the page."""
    alarmed = [trend.words for trend in trends if trend.is_alarmed]
    open_ = {(trend.robot, trend.axis) for trend in trends} - {(trend.robot, trend.axis) for trend in trends if trend.is_watched}
    details = [
        f"{robot}, axis {axis}: {FEWEST_BEFORE + 1} runs are needed before a change can show" for robot, axis in sorted(open_)
    ]
    if alarmed:
        return PageVerdict("bad", "A gear has changed", (*alarmed, *details))
    if not trends or open_:
        return PageVerdict("open", "No change is found, but some gears have too few runs", tuple(details))
    return PageVerdict("good", "No gear has changed", ())


def table(trends: Sequence[Trend]) -> ReportTable:
    """Tabulate every order of every gear, and whether it changed."""
    rows: list[list[Cell]] = []
    for trend in trends:
        last = " ± ".join(value_and_error(float(trend.values[-1]), float(trend.errors[-1])))
        scatter = number(trend.watch.scatter, "{:.2g}") if len(trend.values) > 1 else NONE
        since = "none" if trend.is_watched else "too few runs"
        if trend.watch.first is not None:
            since = f"since {trend.dates[trend.watch.first][:10]}"
        state = Mark(not trend.is_alarmed if trend.is_watched else None, since)
        rows.append([
            f"{trend.robot}, axis {trend.axis}", trend.symbol, trend.unit, str(len(trend.values)), trend.dates[-1][:10],
            number(trend.watch.expected, "{:.4g}"), scatter, last, state, trend.explained_words or NONE,
            trend.origin or NONE,
        ])  # fmt: skip
    header = ("gear", "", "unit", "runs", "last", "expected", "scatter", "last run", "change", "explained by", "from")
    caption = (
        f"Fewer than one in {1.0 / FALSE_ALARMS:.0f} runs of a gear give a false alarm, counting all its orders. An alarm is a "
        "jump out of the range that the earlier runs predict under the run's conditions, or a drift of their cumulative sums. "
        "An alarm stays from its first run on; --since starts anew. Scatter: that of the earlier runs, without the part "
        "that their conditions explain."
    )
    return ReportTable("orders", "Orders", header, rows, {0, 1, 2, 4, 8, 9, 10}, caption)


ALONE = np.timedelta64(7, "D")
"""Room before and after a single date."""
WIDE = 4.0
"""Limits so many times wider than the values or the narrowest of them are cut off."""


def order_over_dates(amplitude: Trend, phase: Trend | None, key: str, title: str) -> Drawing:
    """An order over its dates."""
    shown = [each for each in (amplitude, phase) if each is not None]
    figure, panels = style.panels(1, len(shown), 2.4)
    for panel, trend in zip(panels[0], shown, strict=True):
        _draw(panel, trend)
    caption = (
        "Discs: runs with their standard errors. Shaded: the range in which each run was expected; a run outside of it is an "
        "alarm. The range depends on the conditions of the run, and is wide while there are few runs. Squares: runs from the "
        "first alarm on."
    )
    return style.drawing(figure, key, title, caption)


def _draw(panel: Axes, trend: Trend) -> None:
    dates = np.array([datetime.datetime.fromisoformat(text).replace(tzinfo=None) for text in trend.dates], dtype="datetime64[s]")
    first = len(dates) if trend.watch.first is None else trend.watch.first
    for rows, marker, colour in ((slice(0, first), "o", style.BLUE), (slice(first, None), "s", style.VERMILLION)):
        if len(dates[rows]):
            panel.errorbar(
                dates[rows], trend.values[rows], trend.errors[rows], linestyle="", elinewidth=0.9, markersize=4.0, marker=marker,
                color=colour,
            )  # fmt: skip
    _draw_limits(panel, trend, dates)
    style.date_axis(panel, dates, ALONE, "Date")
    name = "Phase φ" if trend.is_phase else "Amplitude A"
    panel.set_ylabel(f"{name}, order {trend.order:g} ({trend.unit})")


def _draw_limits(panel: Axes, trend: Trend, dates: Any) -> None:
    """Draw the near limits of a jump at each watched run."""
    low, high = trend.watch.low, trend.watch.high
    values, errors = trend.values, trend.errors
    bottom, top = float(np.min(values - errors)), float(np.max(values + errors))
    known = np.isfinite(low)
    near = high - low < WIDE * max(top - bottom, float(np.min((high - low)[known], initial=np.inf)))
    shown = known & near
    if np.any(known):
        panel.fill_between(dates[known], low[known], high[known], color=style.SHADE, zorder=0, linewidth=0.0)
        panel.plot(dates[known], low[known], **style.MARK)
        panel.plot(dates[known], high[known], **style.MARK)
    bottom, top = float(np.min(low[shown], initial=bottom)), float(np.max(high[shown], initial=top))
    room = 0.08 * (top - bottom) or 0.05 * max(1.0, abs(top))
    panel.set_ylim(bottom - room, top + room)
