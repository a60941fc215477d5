"""The page of adaptive cancellation: one self-contained HTML file."""

from pathlib import Path

from markupsafe import Markup

from hil.counting import axes_in_words
from hil.recording import Recording
from hil.report.figures import ate as figures_ate
from hil.report.figures.order_map import MarkedResonance, order_maps
from hil.report.order_names import BY_ORDER, symbol
from hil.report.pages.page import Card, CardStep, Item, Page, PageHead, PageVerdict, Section, bench_lines, filled_sections
from hil.report.report_table import Cell, Columns, Mark, ReportTable, number, tabulate
from hil.report.tables.trial import trial_table
from hil.results.learning import LearningPass, LearningResult, LearningRun


def page_of(directory: Path, result: LearningResult) -> Page:
    """Return the page of a directory that `hil learn` has filled, also if it has learnt nothing."""
    head = PageHead.of(result, "Adaptive cancellation")
    lines = bench_lines(result.bench, ("Model file", result.model))
    return Page(head, verdict(result), sections(result, directory), cards(result), lines)


def sections(result: LearningResult, directory: Path | None = None) -> list[Section]:
    """Return all chapters with data; figures of recordings need their directory."""
    learnt: list[Item] = []
    is_paper = result.bench.file.is_paper
    for each in result.learnt:
        learnt += [figures_ate.errors(each.axis, each.ate, is_paper=is_paper)]
        learnt += [figures_ate.waveform(each.axis, each.ate, is_paper=is_paper)]
    maps = [] if directory is None else _order_maps(result, directory)
    items = [*maps, estimates(result), passes(result), _verdicts(result)]
    return filled_sections(("result", "Transmission error", learnt), ("passes", "Passes", items))


def _order_maps(result: LearningResult, directory: Path) -> list[Item]:
    """Return order maps of the first and last pass of each axis."""
    made: list[Item] = []
    for axis in result.learnt:
        runs = [run for run in result.runs if run.axis == axis.axis and run.stopped is None]
        shown = [
            (name, Recording.load(directory / run.recording))
            for name, run in (("before", runs[0]), ("after", runs[-1]))
            if (directory / run.recording).is_file()
        ]
        title = f"Axis {axis.axis}: which order shakes the tip"
        made.append(order_maps(f"orders-{axis.axis}", title, shown, axis.axis, MarkedResonance(axis.ate.arm_hz, "f_a")))
    return made


def estimates(result: LearningResult) -> ReportTable:
    """Table of the estimates after each pass."""
    rows: list[list[Cell]] = []
    orders = sorted({order for axis in result.learnt for each in axis.passes for order in each.values.amplitudes_arcsec()})
    for axis in result.learnt:
        for index, each in enumerate(axis.passes, start=1):
            amplitudes, phases = each.values.amplitudes_arcsec(), each.values.phases_deg()
            values = [number(column.get(order), "{:.3f}") for order in orders for column in (amplitudes, phases)]
            rows.append([f"axis {axis.axis}", str(index), *values, number(1e3 * each.set_point_delay_s, "{:.2f}")])
    symbols = [Markup("{} ({})").format(symbol(letter, order), unit) for order in orders for letter, unit in BY_ORDER]
    header = ("", "After pass", *symbols, "Set-point delay (ms)")
    caption = (
        "Estimate of the correction that silences the tip, after each pass. The first estimate comes from the model file or a "
        "fit; passes with the whole correction refine it by the vibration that remains. Set-point delay: lag of the motor "
        "beyond its SYNC period and its interpolation."
    )
    return ReportTable("estimates", "Estimates from pass to pass", header, rows, caption=caption)


def _verdicts(result: LearningResult) -> ReportTable:
    """Table of the verdicts on each order after each pass."""
    parts = [
        (f"axis {axis.axis}, pass {index}", part)
        for axis in result.learnt
        for index, each in enumerate(axis.passes, start=1)
        for part in each.parts
    ]
    return trial_table("verdicts", "Each order, against the first pass", parts)


def passes(result: LearningResult) -> ReportTable:
    """Table of every pass: the fraction of the cancellation, and the vibration."""
    after = {(axis.axis, index): each for axis in result.learnt for index, each in enumerate(axis.passes, start=1)}
    columns: Columns[tuple[LearningRun, LearningPass | None]] = (
        ("", lambda row: f"axis {row[0].axis}"),
        ("Pass", lambda row: str(row[0].number)),
        ("Cancellation (%)", lambda row: number(None if row[1] is None else 100.0 * row[1].gain, "{:.0f}")),
        ("Vibration (m/s²)", lambda row: number(None if row[1] is None else row[1].vibration_m_s2, "{:.4f}")),
        ("Acceleration (rev/s²)", lambda row: number(row[0].acceleration_rps_s, "{:.2f}")),
        ("Top speed (rev/s)", lambda row: number(row[0].end_rps, "{:.2f}")),
        ("Cycles", lambda row: str(row[0].cycles)),
        ("Missed", lambda row: str(row[0].missed_cycles)),
        ("Recording", lambda row: row[0].recording if row[0].stopped is None else "stopped"),
    )
    caption = (
        "Pass 1 has no cancellation, pass 2 half of the cancellation, later passes all of it. Vibration: root mean "
        "square of the tip's vertical acceleration, around f_al, at the speeds that excite the arm."
    )
    rows = [(run, after.get((run.axis, run.number))) for run in result.runs]
    return tabulate("passes", "Passes", columns, rows, caption, (0, 8))


def verdict(result: LearningResult) -> PageVerdict:
    """Verdict at the top of the page."""
    names = axes_in_words([each.axis for each in result.learnt]) if result.learnt else ""
    learnt = [f"In the model file {result.model}: {names}."] if result.learnt else []
    learnt += [f"Axis {each.axis}: {words}." for each in result.learnt for words in each.kept]
    learnt += [f"Left out: {words}." for each in result.learnt for words in each.left_out]
    learnt += [f"Axis {each.axis}: {words}." for each in result.learnt for words in each.notes]
    if result.stopped is not None:
        return PageVerdict("stopped", "A pass was stopped", (result.stopped, *learnt))
    if result.not_learnt is not None:
        return PageVerdict("bad", "Not everything was learnt", (result.not_learnt, *learnt))
    return PageVerdict("good", f"The cancellation of {names} is learnt", tuple(learnt))


def cards(result: LearningResult) -> list[Card]:
    """The vibration of the first and of the last pass, by axis."""
    made = []
    for each in result.learnt:
        before, after = each.passes[0].vibration_m_s2, each.passes[-1].vibration_m_s2
        change = f"{-100.0 * each.reduction_fraction:+.0f} % vibration".replace("-", "−")
        mark = Mark(after < before, f"after {len(each.passes)} passes")
        made.append(Card(f"Axis {each.axis}, ramps", f"{before:.3f}", "m/s²", (CardStep(f"{after:.3f}", change, mark),)))
    return made
