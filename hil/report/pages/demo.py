"""One self-contained HTML file out of a directory of results."""

import datetime
from collections.abc import Iterator
from pathlib import Path

from markupsafe import Markup

from hil.analysis import is_noise
from hil.control.treatments import treatment
from hil.experiments.motions import CONSTANT_ACCELERATION, LINE_MOTION, POINT_TO_POINT
from hil.experiments.plan import outside
from hil.experiments.treatment import TITLES
from hil.report.figures import arm_along_line, arm_swinging, directions, model, order_map, shapers, suppression
from hil.report.figures.notch import NotchFigures
from hil.report.material import Material, finite, run_name, treatment_name
from hil.report.pages.page import Card, CardStep, Item, Page, PageHead, PageVerdict, Section, bench_lines, filled_sections
from hil.report.plotted_run import key_end, shown_runs, title_end
from hil.report.report_table import NONE, Cell, Mark, ReportTable
from hil.report.report_table import number as number_text
from hil.report.style import Drawing
from hil.report.tables import compare as tables_compare
from hil.report.tables import paper_runs as tables
from hil.report.tables.trial import trial_table
from hil.results.acted import FilterSet
from hil.results.comparison import TourResult
from hil.results.files import ResultFileError, load_result
from hil.results.runs import ExperimentsResult, RunEntry, TreatmentComparison, leading

TOUR_FOLDER, ARM_FOLDER = "tour", "arm"
"""Folders of the demo's other parts, below its own."""


def page_of(directory: Path, _: ExperimentsResult) -> Page:
    """Return the page of a directory of runs, with `result.json` and the recordings that it names."""
    material = Material(directory)
    chapters = sections(material)  # they add to the notes
    head = PageHead.of(material.result, heading(material), tuple(material.notes))
    return Page(head, verdict(material), chapters, cards(material), provenance(material))


def heading(material: Material) -> str:
    """Title of the page: the treatments of the runs."""
    acted = {treatment(run.treatment) for run in material.result.runs}
    if material.bench.is_paper and any(each.filters for each in acted):
        return "Vibration suppression with a variable notch"
    names = [TITLES[name] for name in dict.fromkeys(run.treatment for run in material.result.runs) if name != "none"]
    return f"Vibration of the tip with {', '.join(names)}" if names else "Vibration of the tip"


def sections(material: Material) -> list[Section]:
    """Return all chapters with data: results first, then explanations."""
    driven = sorted({run.axis for run in material.result.runs if run.axis is not None and run.experiment != POINT_TO_POINT})
    return filled_sections(
        (
            "verification",
            _tip_title(material),
            [
                *suppression.line_motion(material),
                *(drawing for axis in driven for drawing in suppression.suppression(material, axis)),
                directions.directions(material, LINE_MOTION, None),
                arm_along_line.arm_along_line(material),
                arm_swinging.arm_swinging(material),
                *(directions.directions(material, CONSTANT_ACCELERATION, axis) for axis in driven),
                *(drawing for axis in driven for drawing in _order_maps(material, axis)),
                *(suppression.loop_sides(material, axis) for axis in driven),
            ],
        ),
        ("stops", "Stops", _stops(material)),
        ("paper", "Paper and bench", [tables.claims(material)]),
        ("own-robot", "Your own robot", [_own_robot(material)]),
        ("whole-arm", "A whole arm", _whole_arm(material)),
        (
            "model",
            "Axes and transmission error",
            [
                *(tables.resonances(material), model.plants(material), model.resonances(material)),
                *(tables.transmission_errors(material), model.transmission_errors(material)),
                *(model.identification(material, axis) for axis in driven),
            ],
        ),
        (
            "notch",
            "Variable notch",
            [item for number, filters in enumerate(material.filter_sets) for item in _filters(material, filters, number)],
        ),
        (
            "all-runs",
            "Runs",
            [
                *(tables.runs(material), directions.direction_table(material), _trials(material)),
                *(suppression.following(material), tables.motions(material), tables.timing_table(material)),
            ],
        ),
    )


def _tip_title(material: Material) -> str:
    """Title of the chapter with which a page begins."""
    treatments = {run.treatment for run in material.result.runs}
    acted = treatments - {"none"}
    if treatments == acted or not acted:
        return "The tip's vibration"
    return "Tip with and without the notch" if acted == {"notch"} else "Tip with and without treatment"


def _filters(material: Material, filters: FilterSet, number: int) -> list[Item]:
    """Table and figures of filters that acted together."""
    figures = NotchFigures(material, filters, number)
    table = tables.notches(material, filters, number)
    return [table, figures.schedules(), figures.families(), figures.nyquist(), figures.margin_curves()]


def _stops(material: Material) -> list[Item]:
    """Return table and figures of shapers and stops."""
    runs = material.result.runs
    stopped = sorted({run.axis for run in runs if run.axis is not None and run.experiment == POINT_TO_POINT})
    return [
        shapers.shaper_table(runs),
        *(shapers.after_stop(material, axis, POINT_TO_POINT, f"stop-{axis}", f"Axis {axis}: after the stop") for axis in stopped),
        shapers.residuals(runs, "residual", "Remaining vibration at other frequencies"),
    ]


def _trials(material: Material) -> ReportTable:
    """Trials of the cancellations before the runs."""
    tried = {run.recording: run for run in material.result.runs if run.trial is not None}
    parts = [
        (run_name(run, with_window=False), part) for run in tried.values() for part in (run.trial.parts if run.trial else ())
    ]
    return trial_table("trials", "Trials of the cancellations", parts)


def _order_maps(material: Material, axis: int) -> Iterator[Drawing | None]:
    """Yield order maps of an axis without and with treatments."""
    for number, group in enumerate(shown_runs(material, CONSTANT_ACCELERATION, axis)):
        runs = [(run.label, run.recording) for run in group]
        key, title = f"orders-{axis}{key_end(number)}", f"Axis {axis}: which order shakes the tip{title_end(number)}"
        yield order_map.order_maps(key, title, runs, axis, order_map.MarkedResonance(material.f_al(axis)))


def _part(material: Material, folder: str) -> TourResult | None:
    """Return a part of this demo from a folder below, or None."""
    try:
        result = load_result(material.directory / folder, TourResult, "a tour")
    except (OSError, ResultFileError):
        return None
    return None if _moment(result.started_utc) < _moment(material.result.bench.started_utc) else result


def _whole_arm(material: Material) -> list[Item]:
    """Numbers, claims and picture of the demo's last part; none without it."""
    result = _part(material, ARM_FOLDER)
    if result is None:
        return []
    caption = Markup(
        "Six axes with coupled links. Of the arm only the positions of its joints and the inertias of its motors are known. The "
        "transmission errors were learnt on the line itself. <a href='{}/report.html'>The whole tour</a>."
    ).format(ARM_FOLDER)
    if not result.robots or result.tour.failure is not None:
        return [_ended_early(result, "whole-arm-table", caption)]
    try:
        runs = Material(material.directory / ARM_FOLDER / result.robots[0].directory)
    except (OSError, ResultFileError):
        return []
    return [
        directions.side_by_side(runs, "whole-arm-table", caption),
        tables_compare.claims(result, "whole-arm-claims"),
        arm_along_line.arm_along_line(runs, "whole-arm-line"),
    ]


def _ended_early(result: TourResult, key: str, caption: str | Markup) -> ReportTable:
    rows: list[list[Cell]] = [[step.name, step.what, Mark(step.holds, "")] for step in result.tour.steps]
    return ReportTable(key, "It ended early", ("step", "result", "done"), rows, {0, 1, 2}, caption, is_prose=True)


def _own_robot(material: Material) -> ReportTable | None:
    """Table of the demo's second part; None without it."""
    result = _part(material, TOUR_FOLDER)
    if result is None:
        return None
    which = "The same robot" if result.tour.seed is None else f"A robot drawn by seed {result.tour.seed}, not the paper's,"
    link = Markup(
        "{} with unknown parameters: it was identified, a notch was designed and uploaded, and all treatments were run. <a "
        "href='tour/report.html'>The whole tour</a>."
    ).format(which)
    table = tables_compare.overview(result, "own-robot-table", link)
    return table if result.tour.failure is None and table else _ended_early(result, "own-robot-table", link)


def _moment(text: str) -> datetime.datetime:
    instant = datetime.datetime.fromisoformat(text)
    return instant if instant.tzinfo is not None else instant.replace(tzinfo=datetime.UTC)


def stopped(material: Material) -> list[tuple[str, str]]:
    """Runs that ended early, each once, with the reason."""
    return list({run_name(run, with_window=False): run.stopped for run in material.result.runs if run.stopped}.items())


def verdict(material: Material) -> PageVerdict:
    """Return the verdict on the paper's claims, or on the specification."""
    claims = material.result.paper
    failed = [claim for claim in claims if claim.holds is False]
    held = [claim for claim in claims if claim.holds is True]
    early = stopped(material)
    details = [f"Stopped early: {name}: {reason}" for name, reason in early]
    details += [
        f"Does not hold: {claim.claim} (paper {_with_unit(claim.paper, claim.unit)}, bench {_with_unit(claim.bench, claim.unit)})"
        for claim in failed
    ]
    details += [f"Not judged: {run_name(run)}: {run.invalid}" for run in material.result.runs if run.invalid]
    details += [
        f"Not cancelled: {part.words}"
        for trial in {run.recording: run.trial for run in material.result.runs if run.trial is not None}.values()
        for part in trial.left_out
    ]
    details += _missed(material)
    if early:
        many = "A run was" if len(early) == 1 else f"{len(early)} runs were"
        return PageVerdict("stopped", f"{many} stopped early", tuple(details))
    if failed:
        return PageVerdict("bad", f"{len(failed)} of the paper's {len(claims)} claims do not hold on this bench", tuple(details))
    if held:
        left = len(claims) - len(held)
        rest = "" if not left else f"; {left} could not be judged from these runs"
        beyond = _beyond(material)
        headline = f"The bench reproduces the paper: {len(held)} of {len(claims)} claims hold{rest}{beyond}"
        in_a_row = _line_in_a_row(material)
        if in_a_row:
            headline, details = in_a_row, [f"{headline}.", *details]
        is_open = bool(left or beyond)
        return PageVerdict("open" if is_open else "good", headline, tuple(details))
    return _by_specification(material, details)


def _line_in_a_row(material: Material) -> str:
    """Return the line's tip peaks for several treatments in the drives."""
    runs = [run for run in material.result.runs if (run.experiment, run.loop) == (LINE_MOTION, "drive")]
    treated = [run for run in runs if run.treatment != "none"]
    if len(treated) < 2 or len(treated) == len(runs) or any(run.tip_peak_mm is None for run in runs):
        return ""
    limit_mm = material.bench.specification.tip_mm
    words = {"none": "untreated", "notch": "with the paper's notch"}
    parts = [
        f"{millimetres(run.tip_peak_mm, limit_mm)} {words.get(run.treatment, f'with {treatment_name(run.treatment)}')}"
        for run in runs
    ]
    return f"Line motion: tip {', '.join(parts)}; limit ±{limit_mm:g} mm"


def _beyond(material: Material) -> str:
    """Return treated runs outside the specification, except those of claims."""
    limit_mm = material.bench.specification.tip_mm
    texts = [
        f"{run_name(run, with_window=False)}: tip {millimetres(run.tip_peak_mm, limit_mm)}"
        for run in outside(material.result.runs)
    ]
    return f". Outside ±{limit_mm:g} mm: {'; '.join(texts)}" if texts else ""


def millimetres(peak_mm: float | None, limit_mm: float) -> str:
    """Return a peak in mm to three decimals, or more.

    As many as keep it on its side of the limit.

    >>> millimetres(0.0474, 0.05), millimetres(0.0502, 0.05)
    ('0.047 mm', '0.0502 mm')
    """
    if peak_mm is None:
        return NONE
    digits = 3
    while digits < 6 and (round(peak_mm, digits) <= limit_mm) != (peak_mm <= limit_mm):
        digits += 1
    return f"{peak_mm:.{digits}f} mm"


def _by_specification(material: Material, details: list[str]) -> PageVerdict:
    """Return the verdict on the largest tip peak against the specification."""
    limit_mm = material.bench.specification.tip_mm
    runs = leading(material.result.runs)
    judged = [run for run in runs if run.within_spec is not None and run.invalid is None]
    details = [
        f"{run_name(run)}: tip peak {millimetres(run.tip_peak_mm, limit_mm)}{_ramp_words(run)}" for run in judged
    ] + details
    open_orders = [text for run in runs for text in run.unjudged_orders or ()]
    details += dict.fromkeys(open_orders)
    details += dict.fromkeys(
        text for run in runs for text in (*(run.unreached_orders or ()), *((run.remark,) if run.remark else ()))
    )
    if not judged:
        return PageVerdict("open", "Not judged", tuple(details))
    acted = [run for run in judged if run.treatment != "none"] or judged
    worst = max(acted, key=lambda run: run.tip_peak_mm or 0.0)
    which = "" if len(acted) == 1 else f" at most ({run_name(worst, with_window=False)})"
    headline = f"Tip {millimetres(worst.tip_peak_mm, limit_mm)}{which}, allowed ≤ {limit_mm:g} mm"
    left = [run for run in acted if not run.within_spec]
    if len(judged) < len(runs):
        return PageVerdict("open", f"{headline}; {len(runs) - len(judged)} of {len(runs)} not judged", tuple(details))
    if not left and open_orders:
        return PageVerdict("open", f"{headline}; not every order was judged", tuple(details))
    if not left:
        return PageVerdict("good", headline, tuple(details))
    if all(run.treatment == "none" for run in left):
        return PageVerdict("open", f"{headline}, with no treatment", tuple(details))
    return PageVerdict("bad", headline, tuple(details))


def _ramp_words(run: RunEntry) -> str:
    """Return order, noise, ramp peak and f_al of a run in words."""
    order = "" if run.order_mm is None else f", order {run.order} {run.order_mm:.4f} ± {run.order_error_mm or 0.0:.4f} mm"
    noise = ", not above the sensor's noise" if is_noise(run.tip_peak_mm, run.noise_mm) else ""
    whole = "" if run.ramp_peak_mm is None else f", {run.ramp_peak_mm:.3f} mm on the whole ramp"
    f_al = "" if run.f_al_hz is None else f"; f_al = {run.f_al_hz:.2f} Hz"
    return order + noise + whole + (f_al if run.f_al_words is None else f"; {run.f_al_words}")


def _missed(material: Material) -> list[str]:
    """A sentence on missed cycles, counting each recording once."""
    by_recording = {run.recording: run for run in material.result.runs}
    missed = sum(run.missed_cycles for run in by_recording.values())
    cycles = sum(run.cycles for run in by_recording.values())
    if not by_recording:
        return []
    return [f"Missed cycles: {missed} of {cycles} in {len(by_recording)} motion{'s' * (len(by_recording) > 1)}."]


def _with_unit(value: float | str | None, unit: str) -> str:
    return f"{number_text(value, '{:.4g}')} {unit}".strip()


def cards(material: Material) -> list[Card]:
    """Return a card of every motion, then of the line's spectrum."""
    groups: dict[tuple[str, int | None, str], list[TreatmentComparison]] = {}
    for each in material.result.comparisons:
        groups.setdefault((each.experiment, each.axis, each.loop), []).append(each)
    limit_mm, wanted = material.bench.specification.tip_mm, material.bench.specification.line_area_reduction_pct
    leads = {(run.experiment, run.axis, run.loop, run.treatment): run for run in reversed(leading(material.result.runs))}
    made, areas = [], []
    for (experiment, axis, loop), comparisons in groups.items():
        without = leads.get((experiment, axis, loop, "none"))
        treated = [(each, leads.get((experiment, axis, loop, each.treatment))) for each in comparisons]
        pairs = [(each, run) for each, run in treated if run is not None]
        if without is None or not pairs:
            continue
        where = "Line motion" if experiment == LINE_MOTION else f"Axis {axis}, {experiment.replace('-', ' ')}"
        title = f"{where}, {loop}-closed"
        is_named = len(pairs) > 1 or pairs[0][1].treatment != "notch"
        named = [(each, run, treatment_name(run.treatment) if is_named else "") for each, run in pairs]
        steps = tuple(
            CardStep(
                number_text(run.tip_peak_mm, "{:.3f}"),
                number_text(-each.tip_peak_reduction_pct, "{:+.0f} % peak") if finite(each.tip_peak_reduction_pct) else "",
                Mark(run.within_spec, f"limit ±{limit_mm:g} mm"),
                name,
            )
            for each, run, name in named
        )
        made.append(Card(title, number_text(without.tip_peak_mm, "{:.3f}"), "mm", steps))
        # the paper judges the line by its spectrum: shown where the bench asks for less of it
        if axis is None and wanted is not None and all(finite(each.spectrum_area_reduction_pct) for each, _ in pairs):
            steps = tuple(
                CardStep(
                    number_text(run.spectrum_area, "{:.2f}"),
                    number_text(-each.spectrum_area_reduction_pct, "{:+.0f} % area"),
                    Mark(each.spectrum_area_reduction_pct >= wanted, f"at least −{wanted:g} %"),
                    name,
                )
                for each, run, name in named
            )
            areas.append(Card(title, number_text(without.spectrum_area, "{:.2f}"), "m/s²·Hz", steps))
    return made + areas


def provenance(material: Material) -> list[tuple[str, str]]:
    """Bench, instant and versions of the runs."""
    files = material.result.files
    sources = [(f"{file.role.capitalize()} file", f"{file.path} (SHA-256 {file.sha256})") for file in files]
    return [*bench_lines(material.result.bench), *sources]
