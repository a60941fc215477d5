"""The page of a comparison: one self-contained HTML file."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jinja2

from hil.experiments.treatment import TITLES
from hil.report import figures_compare, style, tables_compare
from hil.report.material import Material
from hil.report.page import Card, Section, Verdict, typeset
from hil.report.style import Drawing
from hil.report.tables import Mark, Table
from hil.report.tables_compare import Document, place_name, places


def write_compare_report(directory: Path) -> Path:
    """Write `report.html` into a directory that `hil compare` has filled.

    Raises:
        OSError: result.json cannot be read, or the page cannot be written.
        ValueError: result.json is not that of a comparison.
    """
    result: Document = json.loads((directory / "result.json").read_text(encoding="utf-8"))
    if result.get("kind") != "compare":
        raise ValueError(f"{directory / 'result.json'} is not that of a comparison")
    materials = {robot["directory"]: _material(directory / robot["directory"]) for robot in result["robots"]}
    with style.styled():
        chapters = sections(result, materials)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["typeset"] = typeset
    names = ", ".join(robot["name"] for robot in result["robots"])
    page = environment.get_template("report.html.j2").render(
        heading="Your own robot" if "story" in result else "Treatments side by side",
        material=SimpleNamespace(
            bench=SimpleNamespace(name=names or "none"),
            result=SimpleNamespace(bench=SimpleNamespace(started_utc=result["started_utc"])),
            notes=_notes(result, materials),
        ),
        verdict=verdict(result),
        cards=cards(result),
        sections=chapters,
        provenance=provenance(result),
        is_drawing=lambda item: isinstance(item, Drawing),
        is_mark=lambda cell: isinstance(cell, Mark),
    )
    path = directory / "report.html"
    path.write_text(page, encoding="utf-8")
    return path


def _material(directory: Path) -> Material | None:
    """What one robot left, or None where nothing was run."""
    return Material(directory) if (directory / "result.json").is_file() else None


def _notes(result: Document, materials: dict[str, Material | None]) -> list[str]:
    said = [note for material in materials.values() if material is not None for note in material.notes]
    return said + [
        f"{robot['name']}: not put back as it was found: {what}" for robot in result["robots"] for what in robot["not_restored"]
    ]


def sections(result: Document, materials: dict[str, Material | None]) -> list[Section]:
    """All chapters for which there is data."""
    several = len(result["robots"]) > 1
    chapters: list[tuple[str, str, list[Drawing | Table | None]]] = [
        ("way", "How it came to that", [tables_compare.story(result)]),
        (
            "side-by-side",
            "Side by side",
            [tables_compare.overview(result), *(figures_compare.peaks(result, robot) for robot in result["robots"])],
        ),
    ]
    for experiment, axis in places(result):
        items: list[Drawing | Table | None] = [tables_compare.experiment(result, experiment, axis)]
        for robot in result["robots"]:
            material = materials[robot["directory"]]
            if material is not None:
                items.append(figures_compare.vibration(robot, material, experiment, axis, several=several))
        title = place_name(experiment, axis).capitalize()
        chapters.append((f"experiment-{tables_compare.key_of(experiment, axis)}", title, items))
    chapters.append(("cost", "What it costs", [tables_compare.compliances(result)]))
    chapters.append(("missing", "Left out", [tables_compare.left_out(result)]))
    found = [Section(key, title, tuple(item for item in items if item is not None)) for key, title, items in chapters]
    return [section for section in found if section.items]


def _judged(result: Document) -> list[tuple[str, dict[str, Any]]]:
    """Every row that was judged, with its robot."""
    return [
        (robot["directory"], row) for robot in result["robots"] for row in robot["rows"] if row["within_spec"] is not None
    ]  # fmt: skip


def verdict(result: Document) -> Verdict:
    """Which treatment keeps the specification everywhere."""
    judged = _judged(result)
    everywhere = {(robot, row["experiment"], row["axis"]) for robot, row in judged}
    limits = {robot["tip_mm"] for robot in result["robots"]}
    limit = f"±{next(iter(limits)):g} mm" if len(limits) == 1 else "its specification"
    by_way: dict[str, list[tuple[str, dict[str, Any]]]] = {}
    for robot, row in judged:
        by_way.setdefault(row["compensation"], []).append((robot, row))
    details = [f"Stopped early: {robot['name']}: {robot['ended']}" for robot in result["robots"] if "ended" in robot]
    failure = result.get("story", {}).get("failure")
    if failure:
        details.append(f"The story ended early: {failure}")
    details += [_sentence(name, rows, len(everywhere)) for name, rows in by_way.items()]
    details += _refused(result)
    if failure or any("ended" in robot for robot in result["robots"]):
        return Verdict("bad", "■", "The comparison is not complete", tuple(details))
    keeping = {
        name: max(row["tip_peak_mm"] for _, row in rows)
        for name, rows in by_way.items()
        if name != "none" and all(row["within_spec"] for _, row in rows) and _covered(rows) == everywhere
    }
    where = "the experiment" if len(everywhere) == 1 else f"all {len(everywhere)} experiments"
    if keeping:
        best = min(keeping, key=lambda name: keeping[name])
        return Verdict("good", "✔", f"{_title(best)} keeps the tip within {limit} in {where}", tuple(details))
    if not any(name != "none" for name in by_way):
        return Verdict("bad", "✘", "Nothing could be compared", tuple(details))
    return Verdict("open", "▲", f"No single treatment keeps the tip within {limit} in {where}", tuple(details))


def _covered(rows: list[tuple[str, dict[str, Any]]]) -> set[tuple[str, str, int | None]]:
    return {(robot, row["experiment"], row["axis"]) for robot, row in rows}


def _title(name: str) -> str:
    words = TITLES.get(name, name)
    return words[0].upper() + words[1:]


def _sentence(name: str, rows: list[tuple[str, dict[str, Any]]], count: int) -> str:
    """A treatment in a sentence."""
    within = sum(bool(row["within_spec"]) for _, row in rows if row["loop"] == "drive" or name != "none")
    rows = [(robot, row) for robot, row in rows if row["loop"] == "drive" or name != "none"]
    told = f"{_title(name)}: within the specification in {within} of {count}"
    changes = [row["tip_peak_change_pct"] for _, row in rows if row["tip_peak_change_pct"] is not None]
    if changes:
        low, high = min(changes), max(changes)
        told += f", tip peak {low:+.0f} %" if round(low) == round(high) else f", tip peak {low:+.0f} … {high:+.0f} %"
    factors = [row["compliance"]["slow"] for _, row in rows if row["compliance"] is not None]
    if factors and max(factors) > 1.05:
        told += f"; the motor gives way {max(factors):.1f} times as far at 1 Hz"
    return told.replace("-", "−") + "."


def _refused(result: Document) -> list[str]:
    return [
        f"Refused by its trial: {robot['name']}, {place_name(row['experiment'], row['axis'])}, {TITLES[row['compensation']]}."
        for robot in result["robots"]
        for row in robot["rows"]
        if row["trial"] == "refused"
    ]


def cards(result: Document) -> list[Card]:
    """For every experiment the treatment with the smallest peak."""
    found = []
    for robot in result["robots"]:
        for experiment, axis in places(result):
            own = [row for row in robot["rows"] if (row["experiment"], row["axis"]) == (experiment, axis)]
            own = [row for row in own if row["tip_peak_mm"] is not None]
            acting = [row for row in own if row["compensation"] != "none"]
            if not acting:
                continue
            best = min(acting, key=lambda row: row["tip_peak_mm"])
            before = next((row for row in own if row["compensation"] == "none" and row["loop"] == best["loop"]), None)
            if before is None:
                continue
            head = f"{robot['name']}, " if len(result["robots"]) > 1 else ""
            found.append(
                Card(
                    f"{head}{place_name(experiment, axis)}: {tables_compare.way_name(best)}",
                    f"{before['tip_peak_mm']:.3f}",
                    f"{best['tip_peak_mm']:.3f}",
                    "mm",
                    f"{tables_compare.change(best['tip_peak_change_pct'])} peak",
                    Mark(best["within_spec"], f"asked: ±{robot['tip_mm']:g} mm"),
                )
            )
    return found


def provenance(result: Document) -> list[tuple[str, str]]:
    """Where, when and with what the runs were made."""
    lines = []
    for robot in result["robots"]:
        source = f", {robot['source']}" if robot["source"] else ""
        lines.append(("Robot", f"{robot['name']} on {robot['bus']}{source}"))
    lines.append(("Started (UTC)", result["started_utc"]))
    versions: dict[str, str] = next((robot["versions"] for robot in result["robots"] if "versions" in robot), {})
    lines.append(("Versions", ", ".join(f"{name} {version}" for name, version in versions.items())))
    return [(name, text) for name, text in lines if text]
