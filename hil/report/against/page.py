"""Page of two results side by side."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hil.errors import NotPossibleError
from hil.report import style
from hil.report.against import figures
from hil.report.against.alike import PairedRuns, RunPair, check_robot, paired_runs
from hil.report.against.numbers import (
    NumberPair,
    error_numbers,
    model_numbers,
    numbers_table,
    pair_name,
    plant_numbers,
    run_numbers,
)
from hil.report.against.settings import Setting, differing, settings_table
from hil.report.material import Material, run_name
from hil.report.origin import origin_of
from hil.report.pages.page import Card, CardStep, Page, PageHead, PageVerdict, Section, moment_text, render
from hil.report.report_table import Mark, number
from hil.report.style import Drawing
from hil.results.ate import AteResult
from hil.results.base import RESULT_FILE, MeasuredResult
from hil.results.files import load_any
from hil.results.plant import PlantResult
from hil.results.runs import ExperimentsResult

AGAINST_FILE = "against.html"


@dataclass(frozen=True)
class _Content:
    """Numbers, figures and cards of two results, with notes."""

    numbers: list[NumberPair]
    drawings: list[Drawing]
    cards: list[Card]
    notes: tuple[str, ...] = ()


def write_against(directory: Path, old_directory: Path, *, is_interactive: bool = False) -> Path:
    """Write `against.html` into the new result's directory; return its path.

    Args:
        directory: Directory of the new result.
        old_directory: Directory of the old one.
        is_interactive: True if its figures can be zoomed.

    Raises:
        NotPossibleError: The two are unlike: another kind, robot, axis or motion. Or Bokeh is needed, and is not installed.
        OSError: A result or a recording cannot be read, or the page cannot be written.
        ValueError: A result.json is not a readable result.
    """
    new, old = _measured(directory), _measured(old_directory)
    check_robot(new, old)
    settings = differing(new, old)
    with style.styled():
        content = _content(new, old, directory, old_directory)
    sections = [Section("old-and-new", "Old and new", (numbers_table(content.numbers),))]
    if content.drawings:
        sections.append(Section("figures", "In one diagram", tuple(content.drawings)))
    sections.append(Section("settings-chapter", "Settings", (settings_table(settings),)))
    head = PageHead(
        new.bench.name,
        new.bench.started_utc,
        content.notes + _origin_notes(new, old),
        heading="Two results side by side",
        subtitle="New beside old",
        aftermath=(*new.aftermath, *(f"Old result: {text}" for text in old.aftermath)),
        origin=origin_of(new),
    )
    provenance = [
        (name, f"{folder}, {moment_text(each.bench.started_utc)}")
        for name, folder, each in (("New", directory, new), ("Old", old_directory, old))
    ]
    page = Page(head, verdict(content.numbers, settings), sections, content.cards, provenance)
    return render(directory / AGAINST_FILE, page, is_interactive=is_interactive)


def _measured(directory: Path) -> MeasuredResult:
    result = load_any(directory / RESULT_FILE)
    if isinstance(result, ExperimentsResult | AteResult | PlantResult):
        return result
    command = result.kind.replace("-", " ")
    raise NotPossibleError(
        f"{directory}: this is a result of hil {command}; expected one of hil run, identify ate or identify plant"
    )


def _content(new: MeasuredResult, old: MeasuredResult, directory: Path, old_directory: Path) -> _Content:
    """What results of one kind have in common."""
    if isinstance(new, AteResult) and isinstance(old, AteResult):
        drawings = [each for each in (figures.error_figure(new, old),) if each is not None]
        return _Content(list(error_numbers(new, old)), drawings, [], _not_identified(new.ate, old.ate))
    if isinstance(new, PlantResult) and isinstance(old, PlantResult):
        drawings = [each for each in (figures.response_figure(new, old),) if each is not None]
        return _Content(list(plant_numbers(new, old)), drawings, [], _not_identified(new.parameters, old.parameters))
    return _of_runs(Material(directory), Material(old_directory))


def _of_runs(new: Material, old: Material) -> _Content:
    paired = paired_runs(new.result, old.result)
    drawings, seen = [], set()
    for pair in paired.pairs:
        if pair.new.recording not in seen:
            seen.add(pair.new.recording)
            drawings.append(figures.tip_figure(new, old, pair, len(seen)))
    numbers = [*run_numbers(paired.pairs), *model_numbers(new, old)]
    notes = (*new.notes, *(f"Old: {note}" for note in old.notes), *_left(paired), *_early(paired.pairs))
    cards = [_card(pair, new.bench.specification.tip_mm) for pair in paired.pairs]
    return _Content(numbers, [each for each in drawings if each is not None], cards, notes)


def _card(pair: RunPair, tip_mm: float) -> Card:
    before, after = pair.old.tip_peak_mm, pair.new.tip_peak_mm
    change = f"{100.0 * (after / before - 1.0):+.0f} % peak".replace("-", "−") if before and after is not None else ""
    name = pair_name(pair)
    numbers = number(before, "{:.3f}"), number(after, "{:.3f}")
    step = CardStep(numbers[1], change, Mark(pair.new.within_spec, f"limit ±{tip_mm:g} mm"))
    return Card(f"{name[0].upper()}{name[1:]}", numbers[0], "mm", (step,))


def _left(paired: PairedRuns) -> list[str]:
    """Windows without a counterpart."""
    return [
        f"Only in the {which} result: {run_name(run)}."
        for which, runs in (("new", paired.only_new), ("old", paired.only_old))
        for run in runs
    ]


def _early(pairs: Sequence[RunPair]) -> list[str]:
    """Runs that ended early or could not be judged."""
    told = [
        f"{which}, {run_name(run)}: {run.stopped or run.invalid}"
        for pair in pairs
        for which, run in (("New", pair.new), ("Old", pair.old))
        if run.stopped or run.invalid
    ]
    return list(dict.fromkeys(told))


def _not_identified(new: object, old: object) -> tuple[str, ...]:
    return tuple(f"The {name} result contains no identification." for name, part in (("new", new), ("old", old)) if part is None)


def _origin_notes(new: MeasuredResult, old: MeasuredResult) -> tuple[str, ...]:
    unknown = [name for name, each in (("new", new), ("old", old)) if each.emulated is None]
    if not unknown or len({new.emulated, old.emulated}) == 1:
        return ()
    return (f"The {unknown[0]} result does not record whether its robot was emulated.",)


def verdict(numbers: Sequence[NumberPair], settings: Sequence[Setting]) -> PageVerdict:
    """Sum up the differences, with those that exceed their standard errors."""
    certain = [each for each in numbers if each.is_beyond]
    details = [
        f"{each.group}: {each.name} {number(each.old, '{:.4g}')} → {number(each.new, '{:.4g}')} {each.unit}".rstrip()
        for each in certain
    ]
    with_error = [each for each in numbers if each.error is not None]
    count = "No setting differs" if not settings else f"Settings that differ: {len(settings)}"
    told = f"{len(certain)} of {len(with_error)} numbers that have a standard error differ by more than chance"
    headline = f"{count}; {told if with_error else 'no number has a standard error in both'}"
    return PageVerdict("open", "▲", headline, tuple(details))
