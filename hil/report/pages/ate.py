"""Page of an identified transmission error: one self-contained HTML file."""

from pathlib import Path

from hil.bench.model import values_in_words
from hil.recording import Recording
from hil.report.figures import ate as figures
from hil.report.figures.ate import AteMaterial
from hil.report.figures.order_map import MarkedResonance, order_maps
from hil.report.pages.page import Page, PageHead, PageVerdict, Section, bench_lines, filled_sections
from hil.report.style import Drawing
from hil.results.ate import AteResult


def page_of(directory: Path, result: AteResult) -> Page:
    """Return the page of a directory that `hil identify ate` has filled."""
    material = AteMaterial(directory, result)
    head = PageHead.of(result, f"Transmission error of axis {material.axis}")
    lines = bench_lines(result.bench, ("Known before", result.known_before.source))
    return Page(head, verdict(material), sections(material), provenance=lines)


def sections(material: AteMaterial) -> list[Section]:
    """All chapters for which there is data."""
    axis, part = material.axis, material.part
    errors = figures.errors(axis, part, is_sensorless=material.is_sensorless, is_paper=material.is_paper)
    passages = (figures.windows(material, direction) for direction in (1, -1))
    return filled_sections(
        ("result", "Transmission error", (errors, figures.waveform(axis, part, is_paper=material.is_paper))),
        ("evidence", "Signal and model", (_order_maps(material), figures.against_speed(material), *passages)),
        ("confidence", "Confidence", (figures.arm(material), figures.arm_twice(material), figures.agreement(material))),
        ("runs", "Runs", (figures.passes(material),)),
    )


def _order_maps(material: AteMaterial) -> Drawing | None:
    """Draw order maps of the fastest and the slowest pass."""
    made = [each for each in material.result.passes if each.stopped is None and (material.directory / each.recording).is_file()]
    if material.is_sensorless or not made:
        return None
    chosen = {each.recording: each for each in (made[0], min(made, key=lambda each: each.acceleration_rps_s))}
    runs = [
        (f"ramps of {each.acceleration_rps_s:.3g} rev/s²", Recording.load(material.directory / each.recording))
        for each in chosen.values()
    ]
    resonance = MarkedResonance(None if material.part is None else material.part.arm_hz, "f_a")
    title = f"Axis {material.axis}: which order shakes the tip"
    return order_maps(f"orders-{material.axis}", title, runs, material.axis, resonance)


def verdict(material: AteMaterial) -> PageVerdict:
    """Verdict at the top of the page."""
    result = material.result
    if result.stopped is not None:
        return PageVerdict("stopped", "A run was stopped", (result.stopped,))
    part = material.part
    if part is None:
        return PageVerdict("bad", "The transmission error was not identified", (result.not_identified or "",))
    details = (
        f"From {'motor torque and encoder alone' if material.is_sensorless else 'tip acceleration and motor angle'}.",
        *(result.notes or ()),
    )
    numbers = ", ".join(values_in_words(part))
    if result.is_within_goal:
        return PageVerdict("good", "The transmission error is identified", (numbers, *details))
    return PageVerdict("open", "The transmission error is less certain than requested", (numbers, *details))
