"""The page of a robustness study, and its figure."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from drive_profiles.version import version_text
from hil.report import style
from hil.report.pages.page import PageVerdict, Section
from hil.report.report_table import ReportTable
from hil.report.style import Drawing
from plant_emulator.studies.summary import Influence, Summary
from plant_emulator.studies.tables import shown
from plant_emulator.trials import page
from plant_emulator.trials.statistics import fraction_text


def distribution_and_influences(summary: Summary) -> Drawing:
    """Return the plants' results with their limit, beside the influences."""
    influences = shown(summary.influences)
    figure, [[distribution, bars]] = style.panels(1, 2, max(3.4, 0.8 + 0.22 * len(influences)))
    _distribution(distribution, summary)
    _influences(bars, influences[::-1])
    style.legend_above(figure, distribution)
    caption = (
        "Left: the number by which a plant is judged; the triangle is the robot of the file. Right: rank correlation of that "
        "number with each unknown, with the 95 % interval; for an angle it has no sign. Grey: the correlation may be chance."
    )
    key = f"figure-{summary.study.name}"
    return style.drawing(figure, key, "Plants and influences", caption, "computed")


def _distribution(panel: Axes, summary: Summary) -> None:
    study, values = summary.study, summary.results
    limit = study.area_reduction_percent if study.is_by_area else study.tip_mm
    unit = "%" if study.is_by_area else "mm"
    finite = values[np.isfinite(values)]
    if finite.size:
        # one edge at the limit, so that no bar stands on both sides
        width = max(float(np.ptp(finite)) / 30.0, 1e-3 * limit)
        first, last = np.floor((finite.min() - limit) / width), np.ceil((finite.max() - limit) / width)
        edges = (limit + width * np.arange(first, last + 1.5)).tolist()
        is_within = finite >= limit if study.is_by_area else finite <= limit
        look: style.Line = {"edgecolor": style.PAPER, "linewidth": 0.4}
        panel.hist(finite[is_within], edges, color=style.BLUE, label="within the specification", **look)
        panel.hist(finite[~is_within], edges, color=style.ORANGE, hatch="////", label="outside", **look)
    panel.axvline(limit, **style.LIMIT, label=f"limit, {limit:g} {unit}")
    nominal = study.result(summary.nominal)
    if np.isfinite(nominal):
        panel.plot([nominal], [0.0], marker="^", color=style.BLACK, linestyle="none", clip_on=False, zorder=5, label="robot file")
    panel.set_xlabel(f"{'reduction of the spectrum’s area' if study.is_by_area else 'tip peak'} in {unit}")
    panel.set_ylabel("plants")
    panel.xaxis.set_major_locator(MaxNLocator(nbins=6))
    panel.yaxis.set_major_locator(MaxNLocator(integer=True))


def _influences(panel: Axes, found: tuple[Influence, ...]) -> None:
    if not found:
        style.note(panel, "too few runs for influences")
        panel.set_axis_off()
        return
    rows = np.arange(len(found))
    values = np.array([each.correlation for each in found])
    reach = np.abs(np.array([[each.correlation - each.low, each.high - each.correlation] for each in found]).T)
    colours = [style.BLUE if each.is_clear else style.GREY for each in found]
    panel.barh(rows, values, color=colours, height=0.7)
    panel.errorbar(values, rows, xerr=reach, linestyle="none", color=style.BLACK, elinewidth=0.8, capsize=2.0)
    panel.axvline(0.0, color=style.BLACK, linewidth=0.7)
    panel.set_yticks(rows, [each.label for each in found])
    panel.set_xlim(-1.0, 1.0)
    panel.set_xticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    panel.set_xlabel("rank correlation, 95 % interval")


def write_page(path: Path, studies: Sequence[tuple[Summary, Sequence[ReportTable]]]) -> Path:
    """Write the page of some studies of one robot, at least one.

    Raises:
        OSError: The page cannot be written.
    """
    with style.styled():
        chapters = [
            Section(each.study.name, each.title[0].upper() + each.title[1:], (distribution_and_influences(each), *tables))
            for each, tables in studies
        ]
    summaries = [summary for summary, _ in studies]
    study = summaries[0].study
    words = ("Robustness", f"robot “{study.robot.name}”", "Simulated plants that differ from the robot file in their unknowns")
    provenance = [
        ("Seed", str(study.seed)),
        *((each.study.words, f"{len(each.judged)} plants") for each in summaries),
        ("Version", version_text()),
    ]
    return page.write_page(path, words, verdict(summaries), chapters, provenance)


def verdict(summaries: Sequence[Summary]) -> PageVerdict:
    """Return the verdict at the top of the page: do all plants meet the specification?"""
    count, runs = sum(each.meeting.count for each in summaries), sum(len(each.judged) for each in summaries)
    details = tuple(
        f"{each.title}: {fraction_text(each.meeting.count, len(each.judged))} meet the specification; "
        f"{fraction_text(each.stable.count, len(each.judged))} are stable"
        for each in summaries
    )
    if count == runs:
        return PageVerdict("good", f"All {runs} plants meet the specification", details)
    is_bad = any(each.faults or each.nominal["meets"] is not True for each in summaries)
    return PageVerdict("bad" if is_bad else "open", f"{count} of {runs} plants meet the specification", details)
