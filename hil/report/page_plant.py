"""The page of a plant identification: one self-contained HTML file."""

import json
from pathlib import Path
from types import SimpleNamespace

import jinja2

from hil.report import figures_plant, style
from hil.report.figures_plant import Document
from hil.report.page import Card, Section, Verdict, typeset
from hil.report.style import Drawing
from hil.report.tables import Mark, Table


def write_plant_report(directory: Path) -> Path:
    """Write `report.html` into a directory that `hil identify plant` has filled, whether it has identified or not.

    Raises:
        OSError: result.json cannot be read, or the page cannot be written.
        ValueError: result.json is not that of a plant identification.
    """
    document: Document = json.loads((directory / "result.json").read_text(encoding="utf-8"))
    if document.get("kind") != "identify plant":
        raise ValueError(f"{directory / 'result.json'} is not that of a plant identification")
    with style.styled():
        chapters = sections(document)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["typeset"] = typeset
    record = document["bench"]
    notes = [f"not put back as it was found: {what}" for what in document.get("not_restored", [])]
    page = environment.get_template("report.html.j2").render(
        heading=f"Plant of axis {document['axis']}",
        material=SimpleNamespace(
            bench=SimpleNamespace(name=record["name"]),
            result=SimpleNamespace(bench=SimpleNamespace(started_utc=record["started_utc"])),
            notes=notes,
        ),
        verdict=verdict(document),
        cards=cards(document),
        sections=chapters,
        provenance=provenance(document),
        is_drawing=lambda item: isinstance(item, Drawing),
        is_mark=lambda cell: isinstance(cell, Mark),
    )
    path = directory / "report.html"
    path.write_text(page, encoding="utf-8")
    return path


def sections(document: Document) -> list[Section]:
    """All chapters for which there is data."""
    chapters: list[tuple[str, str, tuple[Drawing | Table | None, ...]]] = [
        ("plant", "Plant", (figures_plant.parameters(document), figures_plant.frequency_response(document))),
        ("arm", "The arm at the tip", (figures_plant.tip(document),)),
        ("slow", "Friction and gravity", (figures_plant.friction(document),)),
        ("limits", "What these data can tell", (_cannot_tell(document), figures_plant.checks(document))),
    ]
    found = [Section(key, title, tuple(item for item in items if item is not None)) for key, title, items in chapters]
    return [section for section in found if section.items]


def _cannot_tell(document: Document) -> Table | None:
    lines = document.get("cannot_tell", [])
    if not lines:
        return None
    return Table("claims", "What these data cannot tell", "", ("",), [[line] for line in lines])


def verdict(document: Document) -> Verdict:
    """What came out."""
    remarks = tuple(document.get("remarks", ()))
    if "stopped" in document:
        return Verdict("bad", "■", "The run was stopped", (document["stopped"], *remarks))
    if "parameters" not in document:
        return Verdict("bad", "✘", "Not identified", (*document.get("not_identified", ()), *remarks))
    found = document["parameters"]
    f_a, stiffness = found["antiresonance_hz"], found["gear_stiffness_nm_rad"]
    headline = (
        f"f_a = {f_a['value']:.3f} ± {f_a['standard_error']:.1g} Hz, "
        f"K_g = {stiffness['value']:.4g} ± {stiffness['standard_error']:.1g} N·m/rad"
    )
    return Verdict("good", "✔", headline, remarks)


def cards(document: Document) -> list[Card]:
    """None: there is no before and after."""
    del document
    return []


def provenance(document: Document) -> list[tuple[str, str]]:
    """Where, when and how it was measured."""
    record, plan = document["bench"], document.get("plan")
    lines = [("Bench", record["name"]), ("Bus", record["bus"]), ("Started (UTC)", record["started_utc"])]
    if plan is not None:
        low, high = plan["travel_rev"]
        shape = document["request"]["shape"]
        lines += [
            (
                "Excitation",
                f"{shape} on the {plan['excitation']}, peak {plan['amplitude_nm']:.3g} N·m, crest {plan['crest_factor']:.2f}",
            ),
            ("Motion", f"{plan['bias_rps']:.3g} rev/s to and fro, {low:.1f} … {high:.1f} motor revolutions"),
        ]
    return lines
