"""The page of an identification of the transmission error: one self-contained HTML file."""

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jinja2

from hil.report import figures_ate, style
from hil.report.figures_ate import AteMaterial
from hil.report.page import Section, Verdict, typeset
from hil.report.style import Drawing
from hil.report.tables import Mark, Table


@dataclass(frozen=True)
class _Chapter:
    key: str
    title: str
    items: tuple[Drawing | Table | None, ...]


def write_ate_report(directory: Path) -> Path:
    """Write `report.html` into a directory that `hil identify ate` has filled.

    Raises:
        OSError: result.json or a recording cannot be read, or the page cannot be written.
        ValueError: result.json is not that of an identification of the transmission error.
    """
    material = AteMaterial(directory)
    with style.styled():
        chapters = sections(material)
    record = material.result["bench"]
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["typeset"] = typeset
    page = environment.get_template("report.html.j2").render(
        heading=f"Transmission error of axis {material.axis}",
        material=SimpleNamespace(
            bench=SimpleNamespace(name=record["name"]),
            result=SimpleNamespace(bench=SimpleNamespace(started_utc=record["started_utc"])),
            notes=[f"not put back as it was found: {what}" for what in material.result.get("not_restored", [])],
        ),
        verdict=verdict(material),
        cards=[],
        sections=chapters,
        provenance=provenance(material),
        is_drawing=lambda item: isinstance(item, Drawing),
        is_mark=lambda cell: isinstance(cell, Mark),
    )
    path = directory / "report.html"
    path.write_text(page, encoding="utf-8")
    return path


def sections(material: AteMaterial) -> list[Section]:
    """All chapters for which there is data."""
    chapters = [
        _Chapter("result", "Transmission error", (figures_ate.errors(material), figures_ate.waveform(material))),
        _Chapter(
            "evidence",
            "Measured against modelled",
            (figures_ate.against_speed(material), figures_ate.windows(material, 1), figures_ate.windows(material, -1)),
        ),
        _Chapter("confidence", "Confidence", (figures_ate.arm(material), figures_ate.agreement(material))),
        _Chapter("runs", "Runs", (figures_ate.passes(material),)),
    ]
    found = [Section(each.key, each.title, tuple(item for item in each.items if item is not None)) for each in chapters]
    return [section for section in found if section.items]


def verdict(material: AteMaterial) -> Verdict:
    """What came out."""
    result: dict[str, Any] = material.result
    notes = tuple(result.get("notes", ()))
    if "stopped" in result:
        return Verdict("bad", "■", "A run was stopped", (result["stopped"],))
    part = material.part
    if part is None:
        return Verdict("bad", "✘", "The transmission error was not identified", (str(result.get("not_identified", "")),))
    details = (
        f"By {'motor torque and encoder alone' if material.is_sensorless else 'tip acceleration and motor angle'}.",
        *notes,
    )
    values, known = part.values.model_dump(), part.standard_error
    numbers = ", ".join(
        f"{symbol} = {values[name]:.2f} ± {known.get(name, 0.0):.2f}{unit}"
        for symbol, name, unit in (
            ("A_2", "a2_arcsec", " arcsec"), ("φ_2", "phi2_deg", "°"), ("A_4", "a4_arcsec", " arcsec"), ("φ_4", "phi4_deg", "°"),
        )
    )  # fmt: skip
    if result["is_within_goal"]:
        return Verdict("good", "✔", "The transmission error is identified", (numbers, *details))
    return Verdict("open", "▲", "The transmission error is known less well than asked", (numbers, *details))


def provenance(material: AteMaterial) -> list[tuple[str, str]]:
    """Where, when and with what the runs were made."""
    record = material.result["bench"]
    versions = ", ".join(f"{name} {version}" for name, version in record["versions"].items())
    lines = [
        ("Bench", record["name"]),
        ("Bus", str(record["bus"])),
        ("Clock", record["clock"]),
        ("Started (UTC)", record["started_utc"]),
        ("Known before", material.result["known_before"]["source"]),
        ("Versions", versions),
    ]
    return [(name, text) for name, text in lines if text]
