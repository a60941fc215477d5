"""One self-contained HTML file out of a directory of results."""

import datetime
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

from hil.master.bench import Bench
from hil.report import figures_identification, figures_model, figures_notch, figures_suppression, style, tables, tables_compare
from hil.report.material import CONSTANT_ACCELERATION, LINE_MOTION, Material, Run, finite
from hil.report.style import Drawing
from hil.report.tables import Mark, Table
from hil.report.timing import timing_table


@dataclass(frozen=True)
class Section:
    """A chapter of the page: figures and tables in the order in which they are read."""

    key: str
    title: str
    items: tuple[Drawing | Table, ...]


@dataclass(frozen=True)
class Verdict:
    """What came out, at the top of the page.

    Attributes:
        kind: `good`, `bad` or `open`: the colour.
        sign: The same as a sign.
        headline: The same in words.
        details: One sentence each.
    """

    kind: str
    sign: str
    headline: str
    details: tuple[str, ...]


@dataclass(frozen=True)
class Card:
    """A number that stands for a run pair: before and after.

    Attributes:
        title: What was moved.
        before: Without the notch.
        after: With it.
        unit: Of both.
        change: The change in words.
        mark: Whether it keeps the specification.
    """

    title: str
    before: str
    after: str
    unit: str
    change: str
    mark: Mark


def write_report(directory: Path, bench: Bench | None = None) -> Path:
    """Write `report.html` into a directory that holds `result.json` and the recordings it names.

    Args:
        directory: Where result.json is.
        bench: The bench of the runs; from result.json unless it is given.

    Returns:
        The path of the page: one file, no network, no scripts.

    Raises:
        OSError: result.json cannot be read or the page cannot be written.
        ValueError: result.json is not what a run writes.
    """
    material = Material(directory, bench)
    with style.styled():
        chapters = sections(material)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["typeset"] = typeset
    page = environment.get_template("report.html.j2").render(
        material=material,
        verdict=verdict(material),
        cards=cards(material),
        sections=chapters,
        provenance=provenance(material),
        stopped=stopped(material),
        is_drawing=lambda item: isinstance(item, Drawing),
        is_mark=lambda cell: isinstance(cell, Mark),
    )
    path = directory / "report.html"
    path.write_text(page, encoding="utf-8")
    return path


_SYMBOL = re.compile(r"(?<!\w)([A-Za-zα-ωΑ-Ω])_([A-Za-z0-9]+)(?!\w)")


def typeset(text: str) -> Markup:
    """Text for HTML, with f_al and the like set as symbols with an index."""
    if isinstance(text, Markup):
        return text
    return Markup(_SYMBOL.sub(r"\1<sub>\2</sub>", str(escape(text))))  # noqa: S704 - escaped before


def sections(material: Material) -> list[Section]:
    """All chapters for which there is data."""
    driven = sorted({run.axis for run in material.result.runs if run.axis is not None})
    chapters: list[tuple[str, str, list[Drawing | Table | None]]] = [
        ("paper", "Paper and bench", [tables.claims(material)]),
        (
            "model",
            "Axes and transmission error",
            [
                tables.resonances(material),
                figures_model.plants(material),
                figures_model.resonances(material),
                tables.transmission_errors(material),
                figures_model.transmission_errors(material),
                *(figures_identification.identification(material, axis) for axis in driven),
            ],
        ),
        (
            "notch",
            "Variable notch",
            [
                tables.notches(material),
                figures_notch.schedules(material),
                figures_notch.families(material),
                figures_notch.nyquist(material),
                figures_notch.margin_curves(material),
            ],
        ),
        (
            "verification",
            "Verification",
            [
                *(figures_suppression.suppression(material, axis) for axis in driven),
                figures_suppression.line_motion(material),
                *(figures_suppression.loop_places(material, axis) for axis in driven),
            ],
        ),
        ("own-robot", "Your own robot", [_own_robot(material)]),
        ("all-runs", "Runs", [tables.runs(material), tables.motions(material), timing_table(material)]),
    ]
    found = [Section(key, title, tuple(_present(items))) for key, title, items in chapters]
    return [section for section in found if section.items]


def _own_robot(material: Material) -> Table | None:
    """What the second part of the demo has left below this directory; not that of an earlier demo."""
    path = material.directory / "story" / "result.json"
    if not path.is_file():
        return None
    told = json.loads(path.read_text(encoding="utf-8"))
    started = material.result.bench.started_utc
    if told.get("kind") != "compare" or (started and _moment(told["started_utc"]) < _moment(started)):
        return None
    link = Markup(
        "The same robot as somebody meets it who knows nothing of it: identified, a notch designed and uploaded, and run side by "
        "side. <a href='story/report.html'>The whole story</a>."
    )
    failure = told.get("story", {}).get("failure")
    table = tables_compare.overview(told, "own-robot-table", link)
    if failure is None and table is not None:
        return table
    rows: list[list[tables.Cell]] = [[step["name"], step["what"], Mark(step["holds"], "")] for step in told["story"]["steps"]]
    return Table("own-robot-table", "It ended early", "", ("step", "what came", "done"), rows, frozenset({0, 1, 2}), link)


def _moment(text: str) -> datetime.datetime:
    found = datetime.datetime.fromisoformat(text)
    return found if found.tzinfo is not None else found.replace(tzinfo=datetime.UTC)


def _present(items: Iterable[Drawing | Table | None]) -> Iterable[Drawing | Table]:
    return (item for item in items if item is not None)


def stopped(material: Material) -> list[tuple[str, str]]:
    """Runs that ended early, each once, with the reason."""
    return list({_ramp_name(run): run.stopped for run in material.result.runs if run.stopped}.items())


def _ramp_name(run: Run) -> str:
    return run.model_copy(update={"order": None}).name


def verdict(material: Material) -> Verdict:
    """What came out: of the paper's claims where they were judged, else of the runs against the specification."""
    claims = material.result.paper
    failed = [claim for claim in claims if claim.holds is False]
    held = [claim for claim in claims if claim.holds is True]
    early = stopped(material)
    details = [f"Stopped early: {name}: {reason}" for name, reason in early]
    details += [
        f"Does not hold: {claim.claim} (paper {_with_unit(claim.paper, claim.unit)}, bench {_with_unit(claim.bench, claim.unit)})"
        for claim in failed
    ]
    details += [f"Not judged: {run.name}: {run.invalid}" for run in material.result.runs if run.invalid]
    details += _missed(material)
    if early:
        many = "A run was" if len(early) == 1 else f"{len(early)} runs were"
        return Verdict("bad", "■", f"{many} stopped early", tuple(details))
    if failed:
        return Verdict("bad", "✘", f"{len(failed)} of the paper's {len(claims)} claims do not hold on this bench", tuple(details))
    if held:
        left = len(claims) - len(held)
        rest = "" if not left else f"; {left} could not be judged from these runs"
        headline = f"The bench reproduces the paper: {len(held)} of {len(claims)} claims hold{rest}"
        return Verdict("open" if left else "good", "▲" if left else "✔", headline, tuple(details))
    return _by_specification(material, details)


def _by_specification(material: Material, details: list[str]) -> Verdict:
    limit = f"±{material.bench.specification.tip_mm:g} mm"
    judged = [run for run in material.result.runs if run.within_spec is not None and not run.invalid and run.order in (None, 2)]
    details = [f"{run.name}: tip peak {tables.number(run.tip_peak_mm, '{:.3f}')} mm" for run in judged] + details
    if not judged:
        return Verdict("open", "▲", "Nothing was judged against the specification", tuple(details))
    outside = [run for run in judged if not run.within_spec]
    if not outside:
        return Verdict("good", "✔", f"All judged runs keep the tip within {limit}", tuple(details))
    if all(run.compensation == "none" for run in outside):
        return Verdict("open", "▲", f"Without the notch the tip leaves {limit}", tuple(details))
    return Verdict("bad", "✘", f"The tip leaves {limit}", tuple(details))


def _missed(material: Material) -> list[str]:
    """A sentence on missed cycles, counting each recording once."""
    by_recording = {run.recording or _ramp_name(run): run for run in material.result.runs if run.missed_cycles is not None}
    missed = sum(run.missed_cycles or 0 for run in by_recording.values())
    cycles = sum(run.cycles or 0 for run in by_recording.values())
    if not by_recording:
        return []
    return [f"Missed cycles: {missed} of {cycles} in {len(by_recording)} motions."]


def _with_unit(value: Any, unit: str | None) -> str:
    return f"{tables.number(value, '{:.4g}')} {unit or ''}".strip()


def cards(material: Material) -> list[Card]:
    """Before and after, for every pair of runs."""
    found = []
    for comparison in material.result.comparisons:
        order = 2 if comparison.experiment == CONSTANT_ACCELERATION else None
        without = material.find(comparison.experiment, comparison.axis, "none", comparison.loop, order)
        with_notch = material.find(comparison.experiment, comparison.axis, comparison.compensation, comparison.loop, order)
        if without is None or with_notch is None:
            continue
        title = "Line motion" if comparison.experiment == LINE_MOTION else f"Axis {comparison.axis}, constant acceleration"
        if comparison.compensation != "notch":
            title += f", {with_notch.compensation_name}"
        area = comparison.spectrum_area_reduction_pct
        # the line motion is judged by its spectrum, as the paper does; the ramps by the tip's peak
        if order is None and area is not None and finite(area):
            wanted = material.bench.specification.line_area_reduction_pct
            before, after = (tables.number(run.spectrum_area, "{:.2f}") for run in (without, with_notch))
            mark = Mark(area >= wanted, f"asked: −{wanted:g} %")
            found.append(Card(f"{title}, {comparison.loop}-closed", before, after, "m/s²·Hz", f"{_percent(area)} area", mark))
            continue
        before, after = (tables.number(run.tip_peak_mm, "{:.3f}") for run in (without, with_notch))
        change = "" if not finite(comparison.tip_peak_reduction_pct) else f"{_percent(comparison.tip_peak_reduction_pct)} peak"
        text = f"asked: ±{material.bench.specification.tip_mm:g} mm"
        mark = Mark(with_notch.within_spec, text)
        found.append(Card(f"{title}, {comparison.loop}-closed", before, after, "mm", change, mark))
    return found


def _percent(reduction: float | None) -> str:
    return f"{-(reduction or 0.0):+.0f} %".replace("-", "−")


def provenance(material: Material) -> list[tuple[str, str]]:
    """Where, when and with what the runs were made."""
    record = material.result.bench
    versions = ", ".join(f"{name} {version}" for name, version in record.versions.items())
    lines = [
        ("Bench", record.name or material.bench.name),
        ("Bus", _plain(record.bus)),
        ("Clock", _plain(record.clock)),
        ("Seed", _plain(record.seed)),
        ("Started (UTC)", record.started_utc or ""),
        ("Versions", versions),
    ]
    return [(name, text) for name, text in lines if text]


def _plain(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_plain(item)}" for key, item in value.items() if item is not None)
    return "" if value is None else str(value)
