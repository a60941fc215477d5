"""The page of a rehearsal."""

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from drive_profiles.standard.shown import spans
from hil.counting import counted
from hil.report import style
from hil.report.pages.page import PageVerdict, Section, filled_sections
from plant_emulator.rehearsal.many import figures, tables
from plant_emulator.rehearsal.many.claims import RehearsalClaim
from plant_emulator.rehearsal.many.reading import KIND_NAMES, by_kind, is_quiet
from plant_emulator.trials import page
from plant_emulator.trials.rows import Row, text


def write_page(path: Path, rows: Sequence[Row], found: Sequence[RehearsalClaim], chapters: list[Section]) -> Path:
    """Write the page of these rows' robots or arms, at least one.

    Raises:
        OSError: The page cannot be written.
        ValueError: There are no rows.
    """
    if not rows:
        raise ValueError("no robot has a result: there is nothing to show; run the rehearsal first")
    words = (
        "The documented path, rehearsed",
        f"{counted(len(rows), 'robot')} drawn by seed",
        "Each robot went through the documented path without manual edits, from a bench file without its parameters",
    )
    return page.write_page(path, words, verdict(rows, found), chapters, provenance(rows))


def sections(rows: Sequence[Row], found: Sequence[RehearsalClaim]) -> list[Section]:
    """Return all chapters with data."""
    with style.styled():
        return filled_sections(
            ("result", "Result", [tables.claims(found), figures.tips(rows), tables.tips(rows), figures.before_and_after(rows)]),
            ("path", "Steps", [figures.steps(rows), tables.steps(rows), tables.causes(rows), figures.facts(rows)]),
            ("honesty", "Estimates", [figures.errors(rows), tables.estimates(rows)]),
            ("safety", "Never worse", [tables.worse(rows), tables.probes(rows)]),
            ("time", "Cost", [figures.cost(rows), tables.cost(rows)]),
            ("which", "Robots", [tables.robots(rows)]),
        )


def verdict(rows: Sequence[Row], found: Sequence[RehearsalClaim]) -> PageVerdict:
    """Return the verdict at the top of the page."""
    failed = [each for each in found if each.holds is False]
    open_ = [each for each in found if each.holds is None]
    quiet = "; ".join(
        f"{KIND_NAMES[kind]}: {sum(map(is_quiet, own))} of {len(own)} robots end within the goal" for kind, own in by_kind(rows)
    )
    details = [*([quiet] if quiet else []), *(f"{each.name}: {each.measured}; required: {each.asked}" for each in failed)]
    if open_:
        details.append(f"Not judged, with too few robots: {'; '.join(each.name for each in open_)}")
    judged = len(found) - len(open_)
    if failed:
        headline = f"{len(failed)} of {judged} claims {'do' if len(failed) > 1 else 'does'} not hold"
        return PageVerdict("bad", headline, tuple(details))
    return PageVerdict("good", f"All {judged} claims that could be judged hold", tuple(details))


def provenance(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Return seeds, kinds, the path's connection, and versions."""
    versions = Counter(text(row, "version") for row in rows if text(row, "version"))
    ways = {True: "over the bus", False: "in one process, without frames"}
    over = [ways[value] for value in (False, True) if any(row.get("over_bus") is value for row in rows)]
    groups = [(KIND_NAMES[kind], own) for kind, own in by_kind(rows)] or [("Arms", [*rows])]
    return [
        *((name, f"seeds {_spans([row['seed'] for row in own])}") for name, own in groups),
        *([("Path", " and ".join(over))] if over else []),
        ("Version", " and ".join(f"{name} ({count} robots)" for name, count in versions.items()) or "not known"),
    ]


def _spans(seeds: Sequence[object]) -> str:
    """Return seeds in as few words as possible."""
    numbers = sorted(seed for seed in seeds if isinstance(seed, int))
    steps = {after - before for before, after in pairwise(numbers)}
    if len(numbers) > 2 and steps == {2}:
        return f"{numbers[0]}, {numbers[1]} … {numbers[-1]}"
    return spans(numbers)
