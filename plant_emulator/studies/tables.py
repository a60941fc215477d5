"""Tables of a robustness study, for its page and the terminal."""

from collections.abc import Iterable

from hil.report.report_table import Cell, ReportTable, number
from plant_emulator.studies.robustness import Study
from plant_emulator.studies.spread import Unknown
from plant_emulator.studies.summary import PERCENTILES, Influence, Summary
from plant_emulator.trials.rows import Row
from plant_emulator.trials.statistics import CONFIDENCE, fraction_text

RESULT_WORDS = {
    "tip_peak_mm": "tip peak in mm",
    "area_reduction_percent": "area reduced by %",
    "following_error_rev": "following error in rev",
    "residual_mm": "left at the end in mm",
    "growth_per_s": "slowest pole in 1/s",
}
FORM = "{:.4g}"
SHOWN = 12
"""Unknowns of a page and a terminal, at least where there are as many; the files have all."""


def shown(influences: tuple[Influence, ...]) -> tuple[Influence, ...]:
    """Return the strongest influences, and all that are beyond chance."""
    return influences[: max(SHOWN, sum(each.is_clear for each in influences))]


def tables(summary: Summary, repeat: str) -> list[ReportTable]:
    """Return the criteria, the judged number, the influences, and the worst plant."""
    study, worst = summary.study, summary.worst
    strongest = {each.name for each in shown(summary.influences)}
    again = plant(
        study,
        worst,
        (unknown for unknown in study.unknowns if unknown.name in strongest),
        "Worst: plant",
        f"`{repeat}` repeats it.",
    )
    return [_criteria(summary), _judged(summary), *([_influences(summary)] if summary.influences else []), again]


def _criteria(summary: Summary) -> ReportTable:
    study, runs = summary.study, len(summary.judged)
    limit = f"area −{study.area_reduction_percent:g} % or more" if study.is_by_area else f"tip peak ≤ {study.tip_mm:g} mm"
    rows: list[list[Cell]] = [
        [f"meets the specification, {limit}", fraction_text(summary.meeting.count, runs)],
        ["stable", fraction_text(summary.stable.count, runs)],
    ]
    rows += [[f"not stable: {fault}", str(count)] for fault, count in summary.faults.items()]
    header = ("", f"plants ({100.0 * CONFIDENCE:g} % interval)")
    return ReportTable(f"criteria-{study.name}", "Criteria", header, rows, {0, 1})


def _judged(summary: Summary) -> ReportTable:
    study = summary.study
    values = (study.result(summary.nominal), *summary.percentiles.values(), study.result(summary.worst))
    words = "reduction of the area in %" if study.is_by_area else "tip peak in mm"
    header = ("", "robot file", *(f"{percent} %" for percent in PERCENTILES), "worst")
    cells: list[list[Cell]] = [[words, *(number(value, FORM) for value in values)]]
    return ReportTable(f"judged-{study.name}", "Percentiles of the plants", header, cells)


def _influences(summary: Summary) -> ReportTable:
    cells: list[list[Cell]] = [
        [
            each.label, number(each.correlation, "{:+.2f}"), f"{number(each.low, '{:+.2f}')} … {number(each.high, '{:+.2f}')}",
            number(each.coefficient, "{:+.2f}"), "yes" if each.is_clear else "no",
        ]
        for each in shown(summary.influences)
    ]  # fmt: skip
    part = None if summary.explained is None else 100.0 * summary.explained
    caption = "" if part is None else f"A linear regression over all unknowns explains {part:.0f} % of the variance."
    header = ("unknown", "rank correlation", f"{100.0 * CONFIDENCE:g} % interval", "coefficient", "beyond chance")
    title = "Unknowns that matter most"
    return ReportTable(f"influences-{summary.study.name}", title, header, cells, {0, 4}, caption)


def plant(study: Study, row: Row, unknowns: Iterable[Unknown], before: str = "Plant", caption: str = "") -> ReportTable:
    """Return the results of one plant, and what was drawn for it."""
    found = {words: value for name, words in RESULT_WORDS.items() if isinstance(value := row[name], float)}
    cells: list[list[Cell]] = [[words, number(value, FORM)] for words, value in found.items()]
    cells.append(["stable", f"no: {str(row['faults']).replace(' ', ', ')}" if row["faults"] else "yes"])
    cells.append(["meets the specification", "yes" if row["meets"] else "no"])
    drawn = len(cells)
    cells += [[unknown.name, number(row[unknown.name], FORM)] for unknown in unknowns]
    title = f"{before} {row['index']} of seed {study.seed}, {study.words}"
    groups = {drawn: "drawn"} if len(cells) > drawn else {}
    return ReportTable(f"plant-{study.name}", title, ("", "value"), cells, caption=caption, groups=groups)
