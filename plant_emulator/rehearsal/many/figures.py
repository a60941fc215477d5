"""Figures of a rehearsal."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, NullFormatter, PercentFormatter

from hil.control.arrays import Real
from hil.report import style
from hil.report.style import Drawing
from plant_emulator.rehearsal.many.claims import CPU_S, RMS_Z
from plant_emulator.rehearsal.many.reading import (
    FACT_NAMES,
    KIND_NAMES,
    QUANTITY_NAMES,
    STEP_NAMES,
    TREATMENT_NAMES,
    by_kind,
    is_done,
    is_quiet,
    robots_of,
    worst_tip_mm,
)
from plant_emulator.rehearsal.many.summary import FAR_Z, deviations, quantities
from plant_emulator.rehearsal.record import ENDED, QUIET_MM, STEPS, TREATMENTS
from plant_emulator.trials.rows import Row, number, numbers, text
from plant_emulator.trials.statistics import run_fraction

COMPUTED = "computed"

TIP_LINES: dict[str, style.Line] = {
    "none": style.WITHOUT,
    "notch": {"color": style.GREY, "linestyle": (0, (5, 1.5, 1, 1.5)), "linewidth": 1.2},
    "notch_designed": {"color": style.PURPLE, "linestyle": (0, (1, 1)), "linewidth": 1.4},
    "cancellation": {"color": style.GREEN, "linestyle": (0, (5, 1.5)), "linewidth": 1.3},
    "cancellation_learnt": style.WITH,
    "floor": {"color": style.BLACK, "linestyle": (0, (1, 1.6)), "linewidth": 1.0},
}

ENDED_COLOURS = {
    "done": style.GREEN,
    "noted": style.SKY,
    "refused": style.ORANGE,
    "stopped": style.VERMILLION,
    "crashed": style.PURPLE,
    "skipped": style.GRID,
}
ENDED_HATCHES = {"refused": "////", "stopped": "xxxx", "crashed": "...."}
FEWEST_INSIDE = 0.06
"""Part of a bar from which its number fits inside."""

FACTS_SHOWN = ("antiresonance_hz", "a1_arcsec", "a2_arcsec", "encoder_bits", "sync_period_s", "noise_m_s2", "hysteresis_nm",
               "softness", "current_lag_s")  # fmt: skip
BINS = 5
MOST_POINTS = 2000
"""Robots in the figure of tips before and after."""


def tips(rows: Sequence[Row]) -> Drawing | None:
    """Return the figure of true tips over the goal, by treatment."""
    kinds = by_kind(rows)
    if not numbers(rows, "goal_mm"):
        return None
    figure, panels = style.panels(1, len(kinds), 3.4, sharey=True)
    for panel, (kind, own) in zip(panels[0], kinds, strict=True):
        for treatment in (*TREATMENTS, "floor"):
            ratios = _ratios(own, treatment)
            if ratios:
                reached = np.arange(len(ratios) + 1) / len(own)
                rising = np.sort([min(ratios), *ratios])  # from 0 %
                panel.step(rising, reached, where="post", label=TREATMENT_NAMES[treatment], **TIP_LINES[treatment])
        panel.axvline(1.0, **style.LIMIT)
        panel.set_xscale("log")
        panel.set(xlabel="True tip / goal", ylim=(0.0, 1.02))
        panel.set_title(robots_of(kind, len(own)))
        panel.yaxis.set_major_formatter(PercentFormatter(1.0))
    panels[0, 0].set_ylabel("Fraction of all robots below")
    style.legend_above(figure, *panels[0], columns=6)
    caption = (
        "True tip displacement of the worst order, on a quiet sensor, relative to the goal: 0.010 mm or 1.3 times the floor, "
        "whichever is more. A curve ends at the fraction of robots whose treatment was accepted. Floor: the same robots "
        "without a transmission error."
    )
    return style.drawing(figure, "tips", "True tip under each treatment", caption, COMPUTED)


def _ratios(rows: Sequence[Row], treatment: str) -> list[float]:
    found = []
    for row in rows:
        tip, goal = worst_tip_mm(row, treatment), number(row, "goal_mm")
        is_there = treatment in {"none", "notch", "floor"} or is_done(row, treatment)
        if tip is not None and goal and is_there:
            found.append(max(tip / goal, 1e-4))
    return found


def before_and_after(rows: Sequence[Row]) -> Drawing | None:
    """Return the figure of each final tip over that before treatment."""
    found = [
        (before, after, is_quiet(row), text(row, "end_treatment") != "none")
        for row in rows[:MOST_POINTS]
        if (before := worst_tip_mm(row, "none")) is not None and (after := number(row, "end_tip_mm")) is not None
    ]
    if not found:
        return None
    figure, [[panel]] = style.panels(1, 1, 4.2)
    looks: tuple[tuple[str, Callable[[bool, bool], bool], style.Line], ...] = (
        ("within the goal", lambda quiet, treated: quiet, {"color": style.BLUE, "marker": "o"}),
        ("treated, not within", lambda quiet, treated: treated and not quiet, {"color": style.VERMILLION, "marker": "s"}),
        ("refused", lambda quiet, treated: not treated and not quiet, {"color": style.ORANGE, "marker": "^"}),
    )
    floor = 1e-4
    for name, belongs, look in looks:
        points = [(max(before, floor), max(after, floor)) for before, after, quiet, treated in found if belongs(quiet, treated)]
        if points:
            panel.plot(*zip(*points, strict=True), linestyle="none", label=f"{name}: {len(points)}", **look)
    low, high = floor, 2.0 * max(max(before, after) for before, after, *_ in found)
    panel.plot([low, high], [low, high], **style.MARK)
    panel.axhline(QUIET_MM, **style.LIMIT)
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set(xlabel="True tip without a treatment (mm)", ylabel="At the path's end (mm)", xlim=(low, high), ylim=(low, high))
    style.legend_above(figure, panel, columns=3)
    caption = (
        "Each point is the worst order of a robot. Horizontal dotted line: 0.010 mm; the floor can raise the goal of a robot. "
        "Diagonal dotted line: no change; robots above it are worse than before."
    )
    return style.drawing(figure, "before-after", "Before and after", caption, COMPUTED)


def steps(rows: Sequence[Row]) -> Drawing | None:
    """Return the figure of the steps' ends, as bars of counts."""
    kinds = by_kind(rows)
    if not kinds:
        return None
    figure, panels = style.panels(1, len(kinds), 3.4, sharey=True)
    at = np.arange(len(STEPS), dtype=float)
    for panel, (kind, own) in zip(panels[0], kinds, strict=True):
        left = np.zeros(len(STEPS))
        for ended in ENDED:
            counts = np.array([sum(text(row, f"{step}_ended") == ended for row in own) for step in STEPS], dtype=float)
            if not counts.any():
                continue
            hatch = ENDED_HATCHES.get(ended)
            panel.barh(at, counts, left=left, color=ENDED_COLOURS[ended], edgecolor=style.PAPER, hatch=hatch, linewidth=0.4,
                       height=0.72, label=ended)  # fmt: skip
            _inside(panel, at, left, counts, len(own))
            left += counts
        panel.set_yticks(at, [STEP_NAMES[step] for step in STEPS])
        panel.set(xlabel="Robots", xlim=(0, len(own)))
        panel.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        panel.set_title(robots_of(kind, len(own)))
        panel.grid(visible=False, axis="y")
    panels[0, 0].invert_yaxis()
    style.legend_above(figure, *panels[0], columns=6)
    caption = "In the order of the path. Noted: done, but less than requested. Skipped: a step that it needs failed."
    return style.drawing(figure, "steps-figure", "How the steps end", caption, COMPUTED)


def _inside(panel: Axes, at: Real, left: Real, counts: Real, whole: int) -> None:
    """Write each count into its bar if it fits."""
    box = {"facecolor": style.PAPER, "edgecolor": "none", "pad": 0.8}
    for y, begin, count in zip(at, left, counts, strict=True):
        if count >= FEWEST_INSIDE * whole:
            panel.text(begin + 0.5 * count, y, f"{count:.0f}", ha="center", va="center", fontsize=7.0, bbox=box)


def facts(rows: Sequence[Row]) -> Drawing | None:
    """Return the figure of the fraction within the goal over facts."""
    shown = [name for name in FACTS_SHOWN if len(set(numbers(rows, f"robot_{name}"))) > 1]
    if not shown:
        return None
    columns = 3
    lines = -(-len(shown) // columns)
    figure, panels = style.panels(lines, columns, 0.5 + 1.9 * lines, sharey=True)
    for panel, name in zip(panels.flat, shown, strict=False):
        title, factor = FACT_NAMES[name]
        pairs = np.array([(factor * value, is_quiet(row)) for row in rows if (value := number(row, f"robot_{name}")) is not None])
        _fractions(panel, pairs)
        panel.set_xlabel(title)
        panel.yaxis.set_major_formatter(PercentFormatter(1.0))
    for panel in panels.flat[len(shown) :]:
        panel.set_visible(False)
    for panel in panels[:, 0]:
        panel.set(ylabel="Within the goal", ylim=(0.0, 1.05))
    caption = (
        "Fraction of the robots whose path ends within the goal, with its 95 % interval. The robots form up to five groups of "
        "equal size, each drawn at its median. A falling curve shows what is still difficult."
    )
    return style.drawing(figure, "facts", "Robots within the goal by property", caption, COMPUTED)


def _fractions(panel: Axes, pairs: Any) -> None:
    """Draw fractions of the true in groups along a fact."""
    values, holds = pairs[:, 0], pairs[:, 1]
    distinct = np.unique(values)
    if len(distinct) <= BINS:
        groups = [values == value for value in distinct]
    else:
        edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)))
        last = edges[-1]
        groups = [(values >= low) & ((values < high) | ((high == last) & (values == last))) for low, high in pairwise(edges)]
    filled = [group for group in groups if group.any()]
    x = np.array([np.median(values[group]) for group in filled])
    found = [run_fraction(int(holds[group].sum()), int(group.sum())) for group in filled]
    reach = np.array([(each.share - each.low, each.high - each.share) for each in found]).T
    panel.errorbar(
        x,
        [each.share for each in found],
        yerr=np.clip(reach, 0.0, None),
        marker="o",
        color=style.BLUE,
        ecolor=style.GREY,
        elinewidth=0.9,
        capsize=2.0,
    )


def errors(rows: Sequence[Row]) -> Drawing | None:
    """Return the figure of the deviations' spread and rms in standard errors."""
    found = quantities(rows)
    if not found:
        return None
    at = np.arange(len(found))
    figure, [[spread, rms]] = style.panels(1, 2, 0.9 + 0.26 * len(found), sharey=True, width_ratios=(2.2, 1.0))
    edge = 2.0 * FAR_Z
    for y, each in zip(at, found, strict=True):
        z = np.array([value for _, value in deviations(rows, each.name)])
        low, first, middle, third, high = np.clip(np.percentile(z, [5, 25, 50, 75, 95]), -edge, edge)
        spread.plot([low, high], [y, y], color=style.SKY, linewidth=1.4)
        spread.plot([first, third], [y, y], color=style.BLUE, linewidth=4.0, solid_capstyle="butt")
        spread.plot([middle], [y], color=style.BLACK, marker="|", markersize=8.0)
        is_inside = RMS_Z[0] <= each.rms_z <= RMS_Z[1]
        look = {"color": style.BLUE, "marker": "o"} if is_inside else {"color": style.VERMILLION, "marker": "s"}
        rms.plot([min(each.rms_z, 20.0)], [y], linestyle="none", **look)
    for x in (-1.0, 1.0):
        spread.axvline(x, **style.MARK)
    spread.axvline(0.0, color=style.EDGE, linewidth=0.7)
    spread.set_yticks(at, [QUANTITY_NAMES[each.name] for each in found])
    spread.invert_yaxis()
    spread.set(xlabel="(Estimate − truth) / standard error", xlim=(-edge, edge))
    for limit in RMS_Z:
        rms.axvline(limit, **style.LIMIT)
    rms.set_xscale("log")
    rms.set(xlabel="Root mean square", xlim=(0.2, 22.0))
    rms.set_xticks([0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0], ["0.2", "0.5", "1", "2", "5", "10", "20"])
    rms.xaxis.set_minor_formatter(NullFormatter())
    caption = (
        f"Left: 5 to 95 % of the robots (thin), the middle half (thick), the median; cut off at ±{edge:g}. Right: the "
        f"required range is {RMS_Z[0]:g} to {RMS_Z[1]:g}, between the dotted lines. Squares lie outside; those at 20 may be "
        "larger."
    )
    return style.drawing(figure, "errors", "Calibration of the standard errors", caption, COMPUTED)


def cost(rows: Sequence[Row]) -> Drawing | None:
    """Return the figure of the processor time of one robot's path."""
    spent = numbers(rows, "cpu_s")
    if not spent:
        return None
    figure, [[panel]] = style.panels(1, 1, 2.6)
    edges = np.linspace(0.0, 1.05 * max(*spent, CPU_S), 41)
    looks = {"linear": {"color": style.BLUE}, "real": {"color": style.ORANGE, "hatch": "////"}, "any": {"color": style.GREEN}}
    kinds = [kind for kind, _ in by_kind(rows)]
    panel.hist(
        [numbers(own, "cpu_s") for _, own in by_kind(rows)],
        edges.tolist(),
        stacked=True,
        edgecolor=style.PAPER,
        linewidth=0.4,
        color=[looks[kind]["color"] for kind in kinds],
        hatch=[looks[kind].get("hatch", "") for kind in kinds],
        label=[KIND_NAMES[kind] for kind in kinds],
    )
    style.flag(panel, CPU_S, f"{CPU_S:g} s")
    panel.set(xlabel="Processor time of one robot's path (s)", ylabel="Robots")
    panel.yaxis.set_major_locator(MaxNLocator(integer=True))
    style.legend_above(figure, panel)
    caption = "Time of the whole path of a drawn robot. Measuring its true tip and trying wrong corrections is not included."
    return style.drawing(figure, "cost-figure", "Processor time", caption, COMPUTED)
