"""The page of a log that was explained, with a picture of each finding."""

from pathlib import Path

from hil.logs.explain import Explanation
from hil.logs.findings.finding import Finding, Severity
from hil.report import style
from hil.report.pages.page import Page, PageHead, PageVerdict, Section, render
from hil.report.report_table import NONE, Cell, Mark, ReportTable
from hil.report.style import Drawing

MOST_PICTURES = 40
_MARKS = {Severity.FAULT: Mark(False, "fault"), Severity.WARNING: Mark(None, "warning"), Severity.NOTE: Mark(None, "note")}


def write_explanation(path: Path, found: Explanation, made_utc: str) -> Path:
    """Write the page.

    Raises:
        OSError: The page cannot be written.
    """
    log = found.trace.log
    with style.styled():
        pictures = [finding_picture(each, number) for number, each in enumerate(found.findings[:MOST_PICTURES], start=1)]
    drawn = tuple(each for each in pictures if each is not None)
    sections = [Section("findings", "What was found", (_table(found.findings),))] if found.findings else []
    if drawn:
        sections.append(Section("pictures", "Data of the findings", drawn))
    if found.unknown:
        rows: list[list[Cell]] = [
            [NONE if each.node is None else str(each.node), each.kind, each.words] for each in found.unknown
        ]
        table = ReportTable("not-told", "Not told", ("node", "kind", "why"), rows, {1, 2}, is_prose=True)
        sections.append(Section("unknown", "Questions that this log cannot answer", (table,)))
    sections.append(Section("nodes", "Nodes and process data", (_nodes(found),)))
    head = PageHead(
        log.path.name, made_utc, heading="A log explained", is_bench=False,
        subtitle=f"{len(log)} frames in {log.duration_s:.3f} s, of {len(found.trace.nodes)} nodes",
    )  # fmt: skip
    return render(path, Page(head, verdict(found), sections, provenance=[("Log", str(log.path))]))


def verdict(found: Explanation) -> PageVerdict:
    """Verdict at the top of the page."""
    faults = [each for each in found.findings if each.severity is Severity.FAULT]
    if faults:
        return PageVerdict("bad", faults[0].words, tuple(each.words for each in faults[1:4]))
    if found.findings:
        return PageVerdict("open", "No fault, but warnings", tuple(each.words for each in found.findings[:3]))
    missing = tuple(each.words for each in found.unknown[:3])
    return PageVerdict("open" if missing else "good", "No fault found", missing)


def _table(findings: tuple[Finding, ...]) -> ReportTable:
    rows: list[list[Cell]] = []
    for number, each in enumerate(findings, start=1):
        stamps = ", ".join(f"{stamp:.3f}" for stamp in each.stamps_s) + (" …" if each.count > len(each.stamps_s) else "")
        node = NONE if each.node is None else str(each.node)
        rows.append([str(number), _MARKS[each.severity], node, each.kind, each.words, each.remedy, stamps])
    header = ("", "", "node", "kind", "seen", "to do", "at [s]")
    return ReportTable("found", "Findings", header, rows, {1, 3, 4, 5, 6}, "Worst first.", is_prose=True)


def _nodes(found: Explanation) -> ReportTable:
    rows: list[list[Cell]] = []
    for number, node in found.trace.nodes.items():
        for pdo in node.pdos:
            held = ", ".join(
                f"{entry.address[0]:04X}h" + (f":{entry.address[1]:02X}h" if entry.address[1] else "") for entry in pdo.entries
            )
            kind = NONE if pdo.transmission_type is None else str(pdo.transmission_type)
            rows.append(
                [str(number), pdo.name, f"{pdo.can_id:03X}h", kind, held or "not known", str(found.trace.log.count(pdo.can_id))]
            )
    header = ("node", "PDO", "identifier", "transmission type", "objects", "frames")
    return ReportTable("process-data", "Process data", header, rows, {1, 2, 4})


def finding_picture(finding: Finding, number: int) -> Drawing | None:
    """Draw the numbers behind a finding; None without any."""
    picture = finding.picture
    if picture is None or not len(picture.x):
        return None
    key = f"finding-{number}"
    figure, panels = style.panels(1, 1, 2.2)
    panel = panels[0, 0]
    mode = {"linewidth": 0.9} if picture.is_line else {"linestyle": "", "marker": ".", "markersize": 2.5}
    panel.plot(picture.x, picture.y, color=style.BLUE, **mode)
    for stamp in finding.stamps_s:
        panel.axvline(stamp, color=style.VERMILLION, linewidth=0.7, alpha=0.6)
    for name, value in picture.limits:
        panel.axhline(value, **style.MARK)
        panel.annotate(name, (1.0, value), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize="small")
    panel.set(xlabel=picture.x_label, ylabel=picture.y_label)
    said = f"{finding.words[:1].upper()}{finding.words[1:]}"
    words = f"{said}. Vertical lines: the first {len(finding.stamps_s)} of {finding.count} occurrences."
    return style.drawing(figure, key, f"{number}. {finding.kind}", words)
