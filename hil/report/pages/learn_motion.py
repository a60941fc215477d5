"""The page of learning on a motion: one self-contained HTML file."""

from pathlib import Path

from hil.counting import axes_in_words
from hil.report.figures import ate as figures_ate
from hil.report.pages.page import Card, CardStep, Item, Page, PageHead, PageVerdict, Section, bench_lines, filled_sections
from hil.report.report_table import Columns, Mark, ReportTable, number, tabulate
from hil.results.learning import MotionLearningResult, ProbedPart, ProbingRun

RUN_WORDS = {"base": "none", "probe": "probing", "applied": "as learnt so far"}


def page_of(_: Path, result: MotionLearningResult) -> Page:
    """Return the page of `hil learn --motion`, also if it has learnt nothing."""
    head = PageHead.of(result, f"Learning on the {result.motion.replace('-', ' ')}")
    return Page(head, verdict(result), sections(result), cards(result), provenance(result))


def sections(result: MotionLearningResult) -> list[Section]:
    """All chapters for which there is data."""
    drawn: list[Item] = [parts(result)]
    drawn += [figures_ate.errors(each.axis, each.ate, is_paper=result.bench.file.is_paper) for each in result.learnt]
    return filled_sections(("result", "Transmission error", drawn), ("runs", "Runs", [runs(result)]))


PARTS: Columns[ProbedPart] = (
    ("", lambda part: f"axis {part.axis}"),
    ("Order", lambda part: f"{part.order:g}"),
    ("A (arcsec)", lambda part: number(part.a_arcsec, "{:.2f}")),
    ("± (arcsec)", lambda part: number(part.a_error_arcsec, "{:.2f}")),
    ("φ (°)", lambda part: number(part.phi_deg, "{:.1f}")),
    ("± (°)", lambda part: number(part.phi_error_deg, "{:.1f}")),
    ("Seen (%)", lambda part: number(100.0 * part.seen_fraction, "{:.0f}")),
    ("Result", lambda part: part.outcome),
)


def parts(result: MotionLearningResult) -> ReportTable:
    """Table of the estimates of each order of each axis."""
    caption = (
        "Standard errors include the noise by which equal runs differ, and the motion's own vibration, which is the same in "
        "every run. Seen: how much of the order these runs show. An order that is not reached, not seen or not significant "
        "stays at 0."
    )
    return tabulate("parts", "Each order of each axis", PARTS, result.parts, caption, (0, 7))


RUNS: Columns[ProbingRun] = (
    ("Run", lambda run: str(run.number)),
    (
        "Cancellation",
        lambda run: (
            RUN_WORDS[run.what] + ("" if run.pace == 1.0 else f", {run.pace:g} × the time") + (", kept" if run.is_kept else "")
        ),
    ),
    ("Tip's peak (mm)", lambda run: number(run.tip_peak_mm, "{:.4f}")),
    ("Root mean square (mm)", lambda run: number(run.tip_rms_mm, "{:.4f}")),
    ("Cycles", lambda run: str(run.cycles)),
    ("Missed", lambda run: str(run.missed_cycles)),
    ("Recording", lambda run: run.recording if run.stopped is None else "stopped"),
)


def runs(result: MotionLearningResult) -> ReportTable:
    """Tabulate every run: cancelled error, and the tip."""
    probe = "some arcsec" if result.probe_arcsec is None else f"{result.probe_arcsec:.1f} arcsec"
    caption = (
        f"A probing run cancels {probe} of every order of every axis at one of four phases, which change from run to run. Tip: "
        "length of its displacement vector in the band, in the judged part of the motion."
    )
    return tabulate("probing", "Runs of the motion", RUNS, result.runs, caption, (1, 6))


def verdict(result: MotionLearningResult) -> PageVerdict:
    """Verdict at the top of the page."""
    left = [f"{each.words}." for each in result.parts if each.outcome != "learnt"]
    left += [
        f"Axis {each.axis}: its gear reacts on its motor, with {each.ate.motor_friction_nm:.3f} N·m of friction in addition."
        for each in result.learnt
        if each.ate.gear_reaction > 0.0
    ]
    if result.stopped is not None:
        return PageVerdict("stopped", "A run was stopped", (result.stopped,))
    if result.not_learnt is not None:
        return PageVerdict("bad", "Nothing is learnt", (result.not_learnt,))
    names = axes_in_words([each.axis for each in result.learnt])
    return PageVerdict("good", f"The cancellation of {names} is learnt", (f"In the model file {result.model}.", *left))


def cards(result: MotionLearningResult) -> list[Card]:
    """The tip's peak without cancellation, and with the learnt one."""
    kept = next((run for run in result.runs if run.is_kept), None)
    if kept is None or kept.tip_peak_mm is None or result.base_peak_mm is None:
        return []
    before, after = result.base_peak_mm, kept.tip_peak_mm
    change = f"{100.0 * (after / before - 1.0):+.0f} % peak".replace("-", "−")
    mark = Mark(after < before, f"after {len(result.runs)} runs")
    title = f"{result.motion.replace('-', ' ')}, worst direction"
    return [Card(title, f"{before:.4f}", "mm", (CardStep(f"{after:.4f}", change, mark),))]


def provenance(result: MotionLearningResult) -> list[tuple[str, str]]:
    """Bench, instant and versions of the runs."""
    noise = [] if result.noise_mm is None else [("Equal runs differ by", f"{result.noise_mm:.4f} mm (root mean square)")]
    return bench_lines(result.bench, ("Model file", result.model), *noise)
