"""The page of a transmission error from recordings: one self-contained HTML file."""

from pathlib import Path

from hil.bench.model import values_in_words
from hil.counting import counted
from hil.report.figures import recorded_ate as figures
from hil.report.figures.recorded_ate import RecordedMaterial
from hil.report.pages.page import Page, PageHead, PageVerdict, Section, filled_sections, versions_text
from hil.results.recorded_ate import RecordedAteResult


def page_of(directory: Path, result: RecordedAteResult) -> Page:
    """Return the page of a directory that `hil identify ate --recording` has filled."""
    material = RecordedMaterial(directory)
    head = PageHead(
        f"{result.robot}, from recordings",
        result.started_utc,
        heading=f"Transmission error of axis {result.axis}",
        subtitle=f"From {counted(len(result.files), 'recording')} by {result.form}",
        is_bench=False,
    )
    return Page(head, verdict(material), sections(material), provenance=provenance(material))


def sections(material: RecordedMaterial) -> list[Section]:
    """All chapters for which there is data."""
    return filled_sections(
        ("result", "Transmission error", (figures.spectrum(material), figures.orders(material))),
        ("evidence", "Signal and fit", (figures.fit(material), figures.speed_map(material))),
        ("change", "From part to part", (figures.change(material), figures.stretches(material))),
    )


def verdict(material: RecordedMaterial) -> PageVerdict:
    """Verdict at the top of the page."""
    result = material.result
    if result.ate is None or not result.is_identified:
        return PageVerdict("bad", "✘", "No order exceeds its noise", (result.not_identified or "", *result.notes))
    numbers = ", ".join(values_in_words(result.ate))
    if any(each.is_seen for each in result.changes):
        return PageVerdict("open", "▲", "The transmission error is identified, and it changes", (numbers, *result.notes))
    return PageVerdict("good", "✔", "The transmission error is identified", (numbers, *result.notes))


def provenance(material: RecordedMaterial) -> list[tuple[str, str]]:
    """Recordings and versions."""
    result = material.result
    lines = [("Robot", result.robot), ("Reduction ratio", f"{result.reduction_ratio:g}")]
    lines += [
        (
            "Recording",
            f"`{each.path}`: {each.rows} rows, {each.duration_s:.1f} s, every {1e3 * each.period_s:.2f} ms, steps of the stamps "
            f"within {1e3 * each.jitter_s:.2f} ms{'' if each.clock is None else f'; time: {each.clock}'}; "
            f"{'; '.join(f'`{words}`' for words in each.columns)}",
        )
        for each in result.files
    ]
    if result.plant is not None:
        lines.append(("Plant", result.plant))
    lines.append(("Versions", versions_text(result.versions)))
    return lines
