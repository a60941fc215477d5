"""The page of a comparison: one self-contained HTML file."""

from pathlib import Path

from drive_profiles.errors import FileError
from hil.bench.bench import load_bench
from hil.experiments.treatment import TITLES
from hil.report.figures import shapers as figures_shapers
from hil.report.figures.compare import ComparedMotion, peaks
from hil.report.material import POINT_TO_POINT, Material
from hil.report.origin import origin_of_table
from hil.report.pages.page import Card, CardStep, Item, Page, PageHead, PageVerdict, Section, filled_sections, versions_text
from hil.report.report_table import Mark
from hil.report.tables import compare as tables_compare
from hil.report.tables.compare import case_name, cases
from hil.report.tables.directions import directions as direction_table
from hil.report.tables.shapers import shapers as shaper_table
from hil.results.comparison import ComparisonRow, TourResult, TreatmentTable


def page_of(directory: Path, result: TreatmentTable) -> Page:
    """Return the page of a directory that `hil compare` has filled."""
    materials = {robot.directory: _material(directory / robot.directory) for robot in result.robots}
    chapters = sections(result, materials)  # they add to the notes
    names = ", ".join(robot.name for robot in result.robots)
    head = PageHead(
        names or _bench_name(directory, result),
        result.started_utc,
        tuple(_notes(materials)),
        heading=result.tour.heading if isinstance(result, TourResult) else "Treatments side by side",
        aftermath=tuple(f"{robot.name}: {sentence}" for robot in result.robots for sentence in robot.aftermath),
        origin=origin_of_table(result),
    )
    return Page(head, verdict(result), chapters, cards(result), provenance(result))


def _bench_name(directory: Path, result: TreatmentTable) -> str:
    """Return the name of the bench of a tour without robots.

    The tour ended before a run; `none` without a bench file.
    """
    try:
        return load_bench(directory / result.tour.bench_file).name if isinstance(result, TourResult) else "none"
    except FileError:
        return "none"


def _material(directory: Path) -> Material | None:
    """Material of one robot, or None if nothing was run."""
    return Material(directory) if (directory / "result.json").is_file() else None


def _notes(materials: dict[str, Material | None]) -> list[str]:
    return [note for material in materials.values() if material is not None for note in material.notes]


def sections(result: TreatmentTable, materials: dict[str, Material | None]) -> list[Section]:
    """All chapters for which there is data."""
    several = len(result.robots) > 1
    chapters: list[tuple[str, str, list[Item]]] = [
        (
            "side-by-side",
            "Side by side",
            [
                tables_compare.overview(result),
                tables_compare.claims(result),
                *(peaks(result, robot) for robot in result.robots),
            ],
        ),
    ]
    for experiment, axis in cases(result):
        items: list[Item] = [tables_compare.experiment(result, experiment, axis)]
        for robot in result.robots:
            material = materials[robot.directory]
            if material is None:
                continue
            motion = ComparedMotion(robot, material, experiment, axis, several)
            items += _shaped(motion)
            if experiment != POINT_TO_POINT:
                items += [motion.vibration(), motion.directions(), *motion.arm(), *motion.orders()]
        title = case_name(experiment, axis).capitalize()
        chapters.append((f"experiment-{tables_compare.key_of(experiment, axis)}", title, items))
    vectors = [direction_table(each, f"directions-{name}") for name, each in materials.items() if each is not None]
    chapters.append(("directions", "The tip as a vector", [*vectors]))
    chapters.append(("way", "Steps of the tour", [tables_compare.tour(result)]))
    chapters.append(("robot", "True values of the robot", [tables_compare.revealed(result)]))
    chapters.append(("cost", "What it costs", [tables_compare.compliances(result)]))
    chapters.append(("missing", "Left out", [tables_compare.left_out(result)]))
    return filled_sections(*chapters)


def _shaped(motion: ComparedMotion) -> list[Item]:
    """Return tables and figures of the shapers for one motion.

    Their table, the tip after a stop, and the residual over the frequency.
    """
    material, experiment, axis = motion.material, motion.experiment, motion.axis
    key, case = motion.key, f"{motion.title[0].upper()}{motion.title[1:]}"
    runs = [run for run in material.result.runs if (run.experiment, run.axis) == (experiment, axis)]
    made: list[Item] = [shaper_table(runs, f"shapers-{key}", f"{case}: remaining vibration and cost of the shapers")]
    if axis is not None and experiment == POINT_TO_POINT:
        made.append(figures_shapers.after_stop(material, axis, experiment, f"stop-{key}", f"{case}: the tip after the stop"))
    made.append(figures_shapers.residuals(runs, f"residual-{key}", f"{case}: remaining vibration at other frequencies"))
    return made


def verdict(result: TreatmentTable) -> PageVerdict:
    """Verdict: the treatment that keeps the specification everywhere."""
    judged = [(robot.directory, row) for robot in result.robots for row in robot.rows if row.within_spec is not None]
    everywhere = {(robot, row.experiment, row.axis) for robot, row in judged}
    limits = {robot.tip_mm for robot in result.robots}
    limit = f"±{next(iter(limits)):g} mm" if len(limits) == 1 else "its specification"
    by_treatment: dict[str, list[tuple[str, ComparisonRow]]] = {}
    for robot, row in judged:
        by_treatment.setdefault(row.treatment, []).append((robot, row))
    details = [f"Stopped early: {robot.name}: {robot.ended}" for robot in result.robots if robot.ended is not None]
    failure = result.tour.failure if isinstance(result, TourResult) else None
    if failure:
        details.append(f"The tour ended early: {failure}")
    details += [_sentence(name, rows, len(everywhere)) for name, rows in by_treatment.items()]
    details += [*tables_compare.notch_sentences(result), *_refused(result)]
    if failure or any(robot.ended is not None for robot in result.robots):
        return PageVerdict("bad", "■", "The comparison is not complete", tuple(details))
    keeping = {
        name: max(row.tip_peak_mm for _, row in rows if row.tip_peak_mm is not None)
        for name, rows in by_treatment.items()
        if name != "none" and all(row.within_spec for _, row in rows) and _covered(rows) == everywhere
    }
    where = "the experiment" if len(everywhere) == 1 else f"all {len(everywhere)} experiments"
    if keeping:
        best = min(keeping, key=lambda name: keeping[name])
        return PageVerdict("good", "✔", f"{_title(best)} keeps the tip within {limit} in {where}", tuple(details))
    if not any(name != "none" for name in by_treatment):
        return PageVerdict("bad", "✘", "Nothing could be compared", tuple(details))
    return PageVerdict("open", "▲", f"No single treatment keeps the tip within {limit} in {where}", tuple(details))


def _covered(rows: list[tuple[str, ComparisonRow]]) -> set[tuple[str, str, int | None]]:
    return {(robot, row.experiment, row.axis) for robot, row in rows}


def _title(name: str) -> str:
    words = TITLES.get(name, name)
    return words[0].upper() + words[1:]


def _sentence(name: str, rows: list[tuple[str, ComparisonRow]], count: int) -> str:
    """A treatment in a sentence."""
    within = sum(bool(row.within_spec) for _, row in rows if row.loop == "drive" or name != "none")
    rows = [(robot, row) for robot, row in rows if row.loop == "drive" or name != "none"]
    if count > 1:
        where = f"within the specification in {within} of {count}"
    elif any(row.within_spec is not None for _, row in rows):
        where = f"{'within' if within else 'outside'} the specification"
    else:
        where = "not judged"
    text = f"{_title(name)}: {where}"
    changes = [row.tip_peak_change_pct for _, row in rows if row.tip_peak_change_pct is not None]
    if changes:
        low, high = min(changes), max(changes)
        text += f", tip peak {low:+.0f} %" if round(low) == round(high) else f", tip peak {low:+.0f} … {high:+.0f} %"
    factors = [row.compliance.slow for _, row in rows if row.compliance is not None]
    if factors and max(factors) > 1.05:
        text += f"; the motor yields {max(factors):.1f} times as far at 1 Hz"
    return text.replace("-", "−") + "."


def _refused(result: TreatmentTable) -> list[str]:
    return [
        f"Refused by its trial: {robot.name}, {case_name(row.experiment, row.axis)}, {TITLES[row.treatment]}."
        for robot in result.robots
        for row in robot.rows
        if row.trial == "refused"
    ]


def cards(result: TreatmentTable) -> list[Card]:
    """Card of every experiment: the treatment with the smallest peak."""
    made = []
    for robot in result.robots:
        for experiment, axis in cases(result):
            own = [row for row in robot.rows if (row.experiment, row.axis) == (experiment, axis)]
            peaks = [(row.tip_peak_mm, row) for row in own if row.tip_peak_mm is not None]
            acting = [(peak, row) for peak, row in peaks if row.treatment != "none"]
            if not acting:
                continue
            after_mm, best = min(acting, key=lambda pair: pair[0])
            before_mm = next((peak for peak, row in peaks if row.treatment == "none" and row.loop == best.loop), None)
            if before_mm is None:
                continue
            head = f"{robot.name}, " if len(result.robots) > 1 else ""
            change = f"{tables_compare.change(best.tip_peak_change_pct)} peak"
            step = CardStep(f"{after_mm:.3f}", change, Mark(best.within_spec, f"limit ±{robot.tip_mm:g} mm"))
            title = f"{head}{case_name(experiment, axis)}: {tables_compare.treatment_words(best)}"
            made.append(Card(title, f"{before_mm:.3f}", "mm", (step,)))
    return made


def provenance(result: TreatmentTable) -> list[tuple[str, str]]:
    """Robots, instant and versions of the runs."""
    lines = []
    for robot in result.robots:
        source = f", {robot.source}" if robot.source else ""
        lines.append(("Robot", f"{robot.name} on {robot.bus}{source}"))
    versions: dict[str, str] = next((robot.versions for robot in result.robots if robot.versions is not None), {})
    lines.append(("Versions", versions_text(versions)))
    return [(name, text) for name, text in lines if text]
