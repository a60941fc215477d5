"""One self-contained HTML file: head, verdict, cards, chapters; the template is report.html.j2."""

import datetime
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import jinja2
from markupsafe import Markup, escape

from drive_profiles.files.safefile import naming
from hil.design.paper import CITATION
from hil.report import palette
from hil.report.interactive.parts import InteractiveParts, interactive_parts
from hil.report.origin import MEASURED, Origin, origin_of
from hil.report.report_table import Mark, ReportTable
from hil.report.style import Drawing
from hil.results.base import MeasuredBench, MeasuredResult


@dataclass(frozen=True)
class PageHead:
    """The head of a page.

    Attributes:
        bench: Name of the bench, or of several, of the page.
        started_utc: Instant at which the runs began; None if nothing was run.
        notes: Sentences on missing parts of the page.
        aftermath: One sentence per setting that was not restored on the drives.
        is_bench: True if `bench` is a bench; False if it is a subject in words.
    """

    bench: str
    started_utc: str | None = None
    notes: tuple[str, ...] = ()
    heading: str = "Vibration suppression with a variable notch"
    subtitle: str = "Run of a robot with harmonic drive gearings over CANopen"
    aftermath: tuple[str, ...] = ()
    origin: Origin = MEASURED
    is_paper: bool = False
    is_bench: bool = True

    @classmethod
    def of(cls, result: MeasuredResult, heading: str, notes: tuple[str, ...] = ()) -> "PageHead":
        """Return the head of the page of one measurement on one bench."""
        bench, origin = result.bench, origin_of(result)
        is_paper, aftermath = bench.file.is_paper, result.aftermath
        return cls(bench.name, bench.started_utc, notes, heading, aftermath=aftermath, origin=origin, is_paper=is_paper)

    def tag(self, drawing: Drawing) -> str:
        """Return the origin of a figure in words: `measured` or `emulated`."""
        return drawing.origin.replace("measured", self.origin.word)


@dataclass(frozen=True)
class Section:
    """A chapter of the page: figures and tables in reading order."""

    key: str
    title: str
    items: tuple[Drawing | ReportTable, ...]


Item = Drawing | ReportTable | None
"""A figure or table, or None without data for it."""


def filled_sections(*chapters: tuple[str, str, Iterable[Item]]) -> list[Section]:
    """Return the chapters that have something to show."""
    filled = (Section(key, title, tuple(filter(None, items))) for key, title, items in chapters)
    return [section for section in filled if section.items]


@dataclass(frozen=True)
class PageVerdict:
    """Verdict at the top of a page.

    Attributes:
        kind: Which chooses colour and sign; `stopped` has the colour of `bad`.
    """

    kind: Literal["good", "bad", "stopped", "open"]
    headline: str
    details: tuple[str, ...]

    @property
    def look(self) -> tuple[str, str]:
        """Colour and sign."""
        return {"good": ("good", "✔"), "bad": ("bad", "✘"), "stopped": ("bad", "■"), "open": ("open", "▲")}[self.kind]


@dataclass(frozen=True)
class CardStep:
    """One treatment's number on a card.

    Attributes:
        name: Treatment in words; empty if the card has one step only.
    """

    after: str
    change: str
    mark: Mark
    name: str = ""


@dataclass(frozen=True)
class Card:
    """A motion's number without treatment, and with each treatment."""

    title: str
    before: str
    unit: str
    steps: tuple[CardStep, ...]


@dataclass(frozen=True)
class Page:
    """Content of a page.

    Attributes:
        provenance: Names and texts on place, time and versions of the runs.
    """

    head: PageHead
    verdict: PageVerdict
    sections: Sequence[Section]
    cards: Sequence[Card] = ()
    provenance: Sequence[tuple[str, str]] = ()


_SYMBOL = re.compile(r"(?<!\w)([A-Za-zα-ωΑ-Ω])_([A-Za-z0-9]+)(?!\w)")


_QUANTITY = re.compile(r"(?<=\d) (?=(?:%|mm|Hz|rev/s|m/s²|ms|s|rad|k?N·m|arcsec|dB|°)(?![\w·]))")
"""The gap between a number and its unit, at which no line ends."""
_CODE = re.compile(r"`([^`]+)`")


def typeset(text: str) -> Markup:
    """Format text as HTML.

    Symbols such as f_al have an index; text between backticks is code; a number stays with its unit.
    """
    if isinstance(text, Markup):
        return text
    parts = _CODE.split(str(escape(text)))
    parts[::2] = [_QUANTITY.sub("&nbsp;", _SYMBOL.sub(r"\1<sub>\2</sub>", plain)) for plain in parts[::2]]
    parts[1::2] = [f"<code>{code}</code>" for code in parts[1::2]]
    return Markup("".join(parts))  # noqa: S704 - escaped before


def moment_text(instant: str) -> str:
    """Write an instant of ISO 8601 in words, to the minute, UTC.

    Any other text is returned unchanged.

    >>> moment_text("2025-01-01T12:00:07Z")
    '1 January 2025, 12:00 UTC'
    """
    try:
        moment = datetime.datetime.fromisoformat(instant)
    except ValueError:
        return instant
    moment = moment.astimezone(datetime.UTC) if moment.tzinfo is not None else moment
    return f"{moment.day} {_MONTHS[moment.month - 1]} {moment:%Y, %H:%M} UTC"


_MONTHS = (
    "January", "February", "March", "April", "May", "June", "July", "August", "September", "October", "November", "December",
)  # fmt: skip


def bench_lines(bench: MeasuredBench, *more: tuple[str, str]) -> list[tuple[str, str]]:
    """Return names and texts of a measurement's bench, without empty ones."""
    lines = [("Bench", bench.name), ("Bus", bench.bus), ("Clock", bench.clock), *more]
    return [(name, text) for name, text in (*lines, ("Versions", versions_text(bench.versions))) if text]


def versions_text(versions: Mapping[str, str]) -> str:
    """Return versions by package as a line."""
    return ", ".join(f"{name} {version}" for name, version in versions.items())


def render(path: Path, page: Page, *, is_interactive: bool = False) -> Path:
    """Write a page: one file, no network, no scripts unless interactive.

    Returns:
        `path`.

    Raises:
        NotPossibleError: It shall be interactive, and Bokeh is not installed.
        OSError: The page cannot be written.
    """
    template = _environment().get_template("report.html.j2")
    text = template.render(
        vars(page),
        interactive=_interactive(page.sections) if is_interactive else None,
        citation=CITATION,
        palette=Markup(palette.css(":root")),  # noqa: S704 - of constants
        is_drawing=lambda item: isinstance(item, Drawing),
        is_tall=_is_tall,
        is_mark=lambda cell: isinstance(cell, Mark),
    )
    with naming(path):
        path.write_text(text, encoding="utf-8")
    return path


def _interactive(sections: Iterable[Section]) -> InteractiveParts | None:
    drawings = [item for section in sections for item in section.items if isinstance(item, Drawing)]
    figures = {each.key: each.zoom for each in drawings if each.zoom is not None}
    return interactive_parts(figures) if figures else None


_TALL = 0.7
"""Height over width from which a figure takes most of a printed page."""


def _is_tall(drawing: Drawing) -> bool:
    box = re.search(r'viewBox="\S+ \S+ (\S+) ([^"\s]+)"', drawing.svg)
    return box is not None and float(box[2]) > _TALL * float(box[1])


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["typeset"] = typeset
    environment.filters["moment"] = moment_text
    return environment
