"""Figure of a passport: an order's amplitude and phase over dates."""

import datetime
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

from hil.passport.watch import Trend
from hil.report import style
from hil.report.style import Drawing

ALONE = np.timedelta64(7, "D")
"""Room before and after a single date."""
WIDE = 4.0
"""Limits so many times wider than the values or the narrowest of them are cut off."""


def order_over_dates(amplitude: Trend, phase: Trend | None, key: str, title: str) -> Drawing:
    """An order over its dates.

    Args:
        amplitude: Trend of A_k.
        phase: Trend of φ_k; None if no run shows it.
        key: Anchor of the figure.
        title: Title of the figure.
    """
    shown = [each for each in (amplitude, phase) if each is not None]
    figure, panels = style.panels(1, len(shown), 2.4)
    for panel, trend in zip(panels[0], shown, strict=True):
        _draw(panel, trend)
    return Drawing(
        key, title, "", "measured",
        "Discs: runs with their standard errors. Shaded: the range in which each run was expected; a run outside of it is an "
        "alarm. The range depends on the conditions of the run, and is wide while there are few runs. Squares: runs from the "
        "first alarm on.",
        style.to_svg(figure, key),
    )  # fmt: skip


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
    if len(set(dates.tolist())) == 1:
        panel.set_xlim(dates[0] - ALONE, dates[0] + ALONE)
    locator: Any = AutoDateLocator(maxticks=6)  # type: ignore[no-untyped-call]
    panel.xaxis.set_major_locator(locator)
    panel.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    name = "Phase φ" if trend.is_phase else "Amplitude A"
    panel.set(xlabel="Date", ylabel=f"{name}, order {trend.order:g} ({trend.unit})")


def _draw_limits(panel: Axes, trend: Trend, dates: Any) -> None:
    """Draw the limits of a jump at each watched run, as steps.

    The figure does not show limits that are far from the values.
    """
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
