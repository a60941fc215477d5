"""Tables of a rehearsal."""

from collections import Counter
from collections.abc import Sequence

from hil.report.report_table import NONE, Cell, Mark, ReportTable
from hil.report.report_table import number as number_text
from plant_emulator.rehearsal.many.causes import CAUSES, main_refusal, refusals
from plant_emulator.rehearsal.many.claims import RehearsalClaim
from plant_emulator.rehearsal.many.reading import (
    KIND_NAMES,
    QUANTITY_NAMES,
    STEP_NAMES,
    TREATMENT_NAMES,
    accepted,
    by_kind,
    is_done,
    is_quiet,
    robots_of,
    tips_mm,
    worst_tip_mm,
)
from plant_emulator.rehearsal.many.rows import WALKED
from plant_emulator.rehearsal.many.summary import FAR_Z, quantities
from plant_emulator.rehearsal.record import ENDED, PROBES, STEPS, TREATMENTS
from plant_emulator.trials.rows import Row, number, numbers, text
from plant_emulator.trials.statistics import SHOWN_PERCENT, percentiles

MOST_LISTED = 40
"""Robots that are listed one by one; the table of all is beside the page."""
SHORT_WORDS = 220
SPREAD_HEADER = ("", "Robots", *(f"{percent} %" for percent in SHOWN_PERCENT), "Worst")


def claims(found: Sequence[RehearsalClaim]) -> ReportTable:
    """Return the goals beside the reached numbers."""
    rows: list[list[Cell]] = [[each.words, each.asked, each.measured, Mark(each.holds)] for each in found]
    header = ("Claim", "Asked", "Measured", "Holds")
    return ReportTable("claims", "Requirements", header, rows, {0, 1, 2, 3}, is_prose=True)


def tips(rows: Sequence[Row]) -> ReportTable:
    """Return percentiles of the worst order's true tip in mm, by treatment."""
    cells: list[list[Cell]] = []
    groups = {}
    for kind, own in by_kind(rows):
        groups[len(cells)] = robots_of(kind, len(own))
        for treatment in (*TREATMENTS, "floor", "end"):
            if treatment == "end":
                values = numbers(own, "end_tip_mm")
            else:
                done = own if treatment in {"none", "notch", "floor"} else [row for row in own if is_done(row, treatment)]
                values = [tip for row in done if (tip := worst_tip_mm(row, treatment)) is not None]
            if values:
                name = "at the path's end" if treatment == "end" else TREATMENT_NAMES[treatment]
                cells.append(_spread(name, values, "{:.2g}"))
    caption = "Peak of the tip's displacement in the worst order's window, in mm, on a quiet sensor; accepted treatments only."
    return ReportTable("tip-table", "True tip (mm)", SPREAD_HEADER, cells, caption=caption, groups=groups)


def _spread(name: str, values: Sequence[float], form: str) -> list[Cell]:
    """Return the row of some values under `SPREAD_HEADER`."""
    return [name, str(len(values)), *(number_text(value, form) for value in (*percentiles(values).values(), max(values)))]


def steps(rows: Sequence[Row]) -> ReportTable:
    """Return the ends of each step, in counts."""
    cells: list[list[Cell]] = []
    groups = {}
    for kind, own in by_kind(rows):
        groups[len(cells)] = robots_of(kind, len(own))
        for step in STEPS:
            counts = Counter(text(row, f"{step}_ended") for row in own)
            cells.append([STEP_NAMES[step], *(str(counts[ended]) if counts[ended] else NONE for ended in ENDED)])
    header = ("Step", *(ended.capitalize() for ended in ENDED))
    return ReportTable("steps-table", "How each step ended", header, cells, groups=groups)


def causes(rows: Sequence[Row]) -> ReportTable:
    """Return the refusals that ended paths, by cause."""
    found = refusals(rows)
    unrefused = sum(not is_quiet(row) and main_refusal(row) is None for row in rows)
    cells: list[list[Cell]] = []
    for cause, count in Counter(each.cause for each in found).most_common():
        own = [each for each in found if each.cause == cause]
        true, example = sum(each.is_true for each in own), own[0]
        by_step = ", ".join(f"{STEP_NAMES[step]} {n}" for step, n in Counter(each.step for each in own).most_common())
        cells.append([cause, str(count), str(true), by_step, f"seed {example.seed}: {_short(example.words)}"])
    if unrefused:
        cells.append(["not refused, and not within the goal", str(unrefused), "0", NONE, NONE])
    header = ("Cause", "Robots", "True", "Where", "Example")
    conditions = "; ".join(f"{cause.name}: {cause.condition}" for cause in CAUSES)
    caption = (
        "Refusals that ended the paths of robots outside the goal. True counts the robots that meet the condition of the cause "
        f"({conditions}), and those whose tip reaches the goal, or loses at least half of the excess, without the cause."
    )
    return ReportTable("causes", "Refusals by cause", header, cells, {0, 3, 4}, caption, is_prose=True)


def estimates(rows: Sequence[Row]) -> ReportTable:
    """Return quantities' deviations, beside what their standard errors let expect."""
    cells: list[list[Cell]] = []
    for each in quantities(rows):
        off = NONE if each.median_off is None else number_text(each.median_off, "{:.2g}°")
        if each.median_off is not None and not each.name.endswith("_deg"):
            off = number_text(100.0 * each.median_off, "{:.2g} %")
        far = f"{100.0 * each.far / each.count:.2g} %"
        worst = f"{number_text(each.worst_z, '{:+.1f}')} (seed {each.worst_seed})"
        cells.append([QUANTITY_NAMES[each.name], str(each.count), off, number_text(each.rms_z, "{:.2f}"), far, worst])
    header = ("Quantity", "Robots", "Median deviation", "rms of z", f"|z| > {FAR_Z:g}", "Largest z")
    caption = "z: estimate minus truth, in the tools' standard errors."
    return ReportTable("estimates", "Truth and estimate", header, cells, caption=caption)


def worse(rows: Sequence[Row]) -> ReportTable:
    """Return the robots that an accepted treatment made worse."""
    found = [row for row in rows if text(row, "worse")]
    cells: list[list[Cell]] = []
    for row in found[:MOST_LISTED]:
        before = tips_mm(row, "none")
        pairs = [
            f"{TREATMENT_NAMES[name]} k = {order}: {number_text(before.get(order), '{:.3g}')} → {number_text(tip, '{:.3g}')} mm"
            for name in accepted(row)
            for order, tip in tips_mm(row, name).items()
            if f"{name} k{order}" in text(row, "worse").split(", ")
        ]
        cells.append([_seed(row), KIND_NAMES[text(row, "kind")], "; ".join(pairs)])
    header = ("Seed", "Robot", "True tip before → after")
    return ReportTable("worse", f"Made worse: {len(found)}", header, cells, {0, 1, 2}, is_prose=True)


def probes(rows: Sequence[Row]) -> ReportTable:
    """Return how many wrong corrections were tried and accepted, and their effect."""
    cells: list[list[Cell]] = []
    for name in PROBES:
        tried = [row for row in rows if row.get(f"probe_{name}_accepted") is not None]
        if not tried:
            continue
        let_in = [row for row in tried if row.get(f"probe_{name}_accepted") is True]
        worst = max(numbers(let_in, f"probe_{name}_worst_ratio"), default=None)
        seeds = ", ".join(_seed(row) for row in let_in[:8]) + (" …" if len(let_in) > 8 else "")
        cells.append([_probe(name), str(len(tried)), str(len(let_in)), number_text(worst, "× {:.2f}"), seeds or NONE])
    header = ("Correction", "Tried", "Accepted", "Tip, at worst", "Seeds")
    caption = "Each was given to the trial in place of the right one. Tip: of the worst order, relative to no treatment."
    return ReportTable("probes", "Wrong corrections", header, cells, {0, 4}, caption)


def cost(rows: Sequence[Row]) -> ReportTable:
    """Return the processor time by step."""
    cells: list[list[Cell]] = []
    columns = {f"{step}_cpu_s": STEP_NAMES[step] for step in STEPS} | {"cpu_s": "whole path", "survey_cpu_s": "the truth"}
    for column, name in columns.items():
        values = [value for value in numbers(rows, column) if value > 0.0]
        if values:
            cells.append(_spread(name, values, "{:.1f}"))
    caption = "In seconds. The truth: measuring the true tip and trying wrong corrections, which the path does not include."
    return ReportTable("cost", "Processor time (s)", SPREAD_HEADER, cells, caption=caption)


def robots(rows: Sequence[Row]) -> ReportTable:
    """Return the robots that miss the goal, internal errors first."""
    found = sorted((row for row in rows if not is_quiet(row)), key=lambda row: (row.get("walk") == WALKED, row["seed"]))
    cells: list[list[Cell]] = []
    for row in found[:MOST_LISTED]:
        refusal = main_refusal(row)
        words = text(row, "walk_words") or ("not refused" if refusal is None else f"{STEP_NAMES[refusal.step]}: {refusal.words}")
        tip = f"{number_text(number(row, 'end_tip_mm'), '{:.2g}')} / {number_text(number(row, 'goal_mm'), '{:.2g}')}"
        cells.append([_seed(row), KIND_NAMES.get(text(row, "kind"), NONE), tip, _short(words)])
    header = ("Seed", "Robot", "Tip / goal (mm)", "Last message")
    caption = f"{len(found)} robots; robots.csv has all. `plant-emulator rehearse --seeds SEED --keep --out FOLDER` repeats one."
    return ReportTable("robots", "Robots not within the goal", header, cells, {0, 1, 2, 3}, caption, is_prose=True)


def _seed(row: Row) -> str:
    return str(row["seed"])


def _short(words: str) -> str:
    return words if len(words) <= SHORT_WORDS else f"{words[: SHORT_WORDS - 2]} …"


def _probe(name: str) -> str:
    """Return the name of a wrong correction in words.

    >>> _probe("phi2_off_60"), _probe("a4_times_3"), _probe("another_robot")
    ('φ₂ off by 60°', 'A₄ × 3', 'another robot')
    """
    index = {"1": "₁", "2": "₂", "4": "₄"}
    if name.startswith("phi"):
        order, _, angle = name.removeprefix("phi").partition("_off_")
        return f"φ{index.get(order, order)} off by {angle}°"
    order, found, factor = name.removeprefix("a").partition("_times_")
    return f"A{index.get(order, order)} × {factor}" if found else name.replace("_", " ")
