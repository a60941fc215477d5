"""The page of many trials: one self-contained HTML file in the style of all pages.

It says that its robots are emulated.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

from hil.report.origin import Origin
from hil.report.pages.page import PageHead, PageVerdict, Section, render
from hil.report.report_table import ReportTable
from hil.report.style import Drawing

EMULATED = Origin("emulated", "Emulated robots: nothing on this page was measured on a real one.", is_emulated=True)


def sections(chapters: Iterable[tuple[str, str, Sequence[Drawing | ReportTable | None]]]) -> list[Section]:
    """Return the chapters that have something to show.

    Args:
        chapters: Anchor, title and items of each; None stands for an item without data.
    """
    filled = (Section(key, title, tuple(item for item in items if item is not None)) for key, title, items in chapters)
    return [section for section in filled if section.items]


def write_page(
    path: Path, words: tuple[str, str, str], verdict: PageVerdict, chapters: list[Section], provenance: Sequence[tuple[str, str]]
) -> Path:
    """Write the page of some trials.

    Args:
        path: The page.
        words: Heading, what was tried, and a sentence on how.
        verdict: Verdict at the top.
        chapters: Figures and tables in reading order.
        provenance: Names and texts on the trials' origin.

    Raises:
        OSError: The page cannot be written.
    """
    heading, subject, subtitle = words
    head = PageHead(subject, heading=heading, subtitle=subtitle, origin=EMULATED, is_bench=False)
    return render(path, head, verdict, chapters, provenance=[*provenance])


def as_markdown(chapters: Iterable[Section]) -> str:
    """Return the tables of a page as Markdown."""
    tables = [item for chapter in chapters for item in chapter.items if isinstance(item, ReportTable)]
    return "\n\n".join(f"**{each.title}**\n\n{each.markdown()}" for each in tables)
