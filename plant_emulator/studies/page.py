"""The page of a robustness study."""

from collections.abc import Sequence
from pathlib import Path

from drive_profiles.version import version_text
from hil.report import style
from hil.report.pages.page import PageVerdict, Section
from hil.report.report_table import ReportTable
from plant_emulator.studies.figure import distribution_and_influences
from plant_emulator.studies.summary import Summary
from plant_emulator.trials import page
from plant_emulator.trials.statistics import fraction_text


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
        return PageVerdict("good", "✔", f"All {runs} plants meet the specification", details)
    is_bad = any(each.faults or each.nominal["meets"] is not True for each in summaries)
    kind, sign = ("bad", "✘") if is_bad else ("open", "▲")
    return PageVerdict(kind, sign, f"{count} of {runs} plants meet the specification", details)
