"""The page of a passport: one self-contained HTML file."""

from collections.abc import Sequence
from pathlib import Path

from hil.passport.regression import FEWEST_BEFORE
from hil.passport.watch import FALSE_ALARMS, OrderOrigin, Trend
from hil.report import style
from hil.report.figures.passport import order_over_dates
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

    Args:
        path: The page.
        trends: Trends of all gears.
        origins: Origins of all orders.
        file: The passport.
        made_utc: Date of the page.
        left_out: Files that were not read.
        is_emulated: True if a run was made on an emulated robot.

    Raises:
        OSError: The page cannot be written.
    """
    gears = list(dict.fromkeys((trend.robot, trend.axis) for trend in trends))
    with style.styled():
        figures = _figures(trends)
    chapters = [Section("orders", "Orders", (table(trends),))]
    if origins:
        chapters.append(Section("origins", "Gear or motor", (origin_table(origins),)))
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
        return PageVerdict("bad", "✘", "A gear has changed", (*alarmed, *details))
    if not trends or open_:
        return PageVerdict("open", "▲", "No change is found, but some gears have too few runs", tuple(details))
    return PageVerdict("good", "✔", "No gear has changed", ())


def table(trends: Sequence[Trend]) -> ReportTable:
    """Tabulate every order of every gear, and whether it changed."""
    rows: list[list[Cell]] = []
    for trend in trends:
        last = " ± ".join(value_and_error(float(trend.values[-1]), float(trend.errors[-1])))
        scatter = number(trend.watch.scatter, "{:.2g}") if len(trend.values) > 1 else NONE
        state = Mark(not trend.is_alarmed if trend.is_watched else None, _state(trend))
        rows.append([
            f"{trend.robot}, axis {trend.axis}", trend.symbol, trend.unit, str(len(trend.values)), trend.dates[-1][:10],
            number(trend.watch.expected, "{:.4g}"), scatter, last, state, trend.explained_words or NONE,
        ])  # fmt: skip
    header = ("gear", "", "unit", "runs", "last", "expected", "scatter", "last run", "change", "explained by")
    caption = (
        f"Fewer than one in {1.0 / FALSE_ALARMS:.0f} runs of a gear give a false alarm, counting all its orders. An alarm is a "
        "jump out of the range that the earlier runs predict under the run's conditions, or a drift of their cumulative sums. "
        "An alarm stays from its first run on; --since starts anew. Scatter: that of the earlier runs, without the part "
        "that their conditions explain."
    )
    return ReportTable("orders", "Orders", "", header, rows, frozenset({0, 1, 2, 4, 8, 9}), caption)


def origin_table(origins: Sequence[OrderOrigin]) -> ReportTable:
    """Every order with its origin, and the reason."""
    rows: list[list[Cell]] = [[f"{each.robot}, axis {each.axis}", f"{each.order:g}", each.name, each.why] for each in origins]
    caption = "The runs do not show whether motor or gear is the cause."
    return ReportTable(
        "origins", "Origins of the orders", "", ("gear", "order", "from", "why"), rows, frozenset({0, 2, 3}), caption
    )


def _state(trend: Trend) -> str:
    if trend.watch.first is not None:
        return f"since {trend.dates[trend.watch.first][:10]}"
    return "none" if trend.is_watched else "too few runs"
