"""The figure of `plant-emulator robustness`.

It shows the distribution of the tip peak, and the most influential unknowns.
"""

import io
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from hil.report import style
from plant_emulator.studies.summary import Summary

SHOWN = 12
"""Largest number of bars of influence."""


def figure_svg(summaries: Sequence[Summary]) -> str:
    """Return one row per study, as SVG.

    A row has the distribution with its limit, and the strongest influences.
    """
    with style.styled(), mpl.rc_context({"svg.fonttype": "path", "svg.hashsalt": "robustness"}):  # the same picture everywhere
        figure, panels = style.panels(len(summaries), 2, 3.4 * len(summaries))
        for row, summary in enumerate(summaries):
            _distribution(panels[row, 0], summary)
            _influences(panels[row, 1], summary)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def title(summary: Summary) -> str:
    """Return the study in words."""
    study = summary.study
    moved = "line motion" if study.axis is None else f"axis {study.axis}, constant acceleration"
    return f"{moved}, {'with' if any(study.filters.values()) else 'without'} notch, {len(summary.judged)} plants"


def _distribution(panel: Axes, summary: Summary) -> None:
    study, values = summary.study, summary.results
    limit = study.area_reduction_percent if summary.is_by_area else study.tip_mm
    unit = "%" if summary.is_by_area else "mm"
    finite = values[np.isfinite(values)]
    if finite.size:
        # one edge at the limit, so that no bar stands on both sides
        width = max(float(np.ptp(finite)) / 30.0, 1e-3 * limit)
        first, last = np.floor((finite.min() - limit) / width), np.ceil((finite.max() - limit) / width)
        edges = (limit + width * np.arange(first, last + 1.5)).tolist()
        is_within = finite >= limit if summary.is_by_area else finite <= limit
        panel.hist(finite[is_within], edges, color=style.BLUE, edgecolor="white", linewidth=0.4, label="within the specification")
        panel.hist(finite[~is_within], edges, color=style.ORANGE, edgecolor="white", linewidth=0.4, hatch="////", label="outside")
    panel.axvline(limit, **style.LIMIT, label=f"limit, {limit:g} {unit}")
    nominal = study.result(summary.nominal)
    if np.isfinite(nominal):
        panel.plot([nominal], [0.0], marker="^", color=style.BLACK, linestyle="none", clip_on=False, zorder=5, label="robot file")
    panel.set_xlabel(f"{'reduction of the spectrum’s area' if summary.is_by_area else 'tip peak'} in {unit}")
    panel.set_ylabel("plants")
    panel.set_title(title(summary))
    low, high = panel.get_ylim()
    panel.set_ylim(low, 1.35 * high)
    panel.yaxis.set_major_locator(MaxNLocator(integer=True))
    panel.legend(loc="upper center", ncols=2, frameon=True, facecolor="white", edgecolor="none", framealpha=1.0)


def _influences(panel: Axes, summary: Summary) -> None:
    shown = summary.influences[:SHOWN][::-1]
    if not shown:
        panel.text(0.5, 0.5, "too few runs for influences", transform=panel.transAxes, ha="center", va="center")
        panel.set_axis_off()
        return
    rows = np.arange(len(shown))
    values = np.array([each.correlation for each in shown])
    reach = np.abs(np.array([[each.correlation - each.low, each.high - each.correlation] for each in shown]).T)
    colours = [style.BLUE if each.is_clear else style.GREY for each in shown]
    panel.barh(
        rows, values, xerr=reach, color=colours, ecolor=style.BLACK, error_kw={"linewidth": 0.8, "capsize": 2.0}, height=0.7
    )
    panel.axvline(0.0, color=style.BLACK, linewidth=0.7)
    panel.set_yticks(rows, [each.label for each in shown])
    panel.set_xlim(-1.0, 1.0)
    panel.set_xticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    panel.set_xlabel("rank correlation, 95 % interval")
    panel.set_title("influence (grey: may be chance)")
