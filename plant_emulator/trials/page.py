"""The page of many trials, an HTML file: its robots are emulated."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from hil.report.origin import Origin
from hil.report.pages.page import Page, PageHead, PageVerdict, Section, render
from hil.report.report_table import ReportTable

EMULATED = Origin("emulated", "Emulated robots: nothing on this page was measured on a real one.", is_emulated=True)


def write_page(
    path: Path, words: tuple[str, str, str], verdict: PageVerdict, chapters: list[Section], provenance: Sequence[tuple[str, str]]
) -> Path:
    """Write the page of some trials.

    Args:
        words: Heading, what was tried, and a sentence on how.
        chapters: Figures and tables in reading order.
        provenance: Names and texts on the trials' origin.

    Raises:
        OSError: The page cannot be written.
    """
    heading, subject, subtitle = words
    head = PageHead(subject, heading=heading, subtitle=subtitle, origin=EMULATED, is_bench=False)
    return render(path, Page(head, verdict, chapters, provenance=provenance))


def as_markdown(chapters: Iterable[Section]) -> str:
    """Return the tables of a page as Markdown."""
    tables = [item for chapter in chapters for item in chapter.items if isinstance(item, ReportTable)]
    return "\n\n".join(f"**{each.title}**\n\n{each.markdown()}" for each in tables)
