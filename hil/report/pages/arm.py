"""The page of an arm's masses: one self-contained HTML file."""

from pathlib import Path

from hil.report.figures import arm as figures_arm
from hil.report.origin import origin_of_arm
from hil.report.pages.page import Page, PageHead, PageVerdict, Section
from hil.report.report_table import Cell, ReportTable, number, value_and_error
from hil.results.arm import ArmResult


def page_of(_: Path, result: ArmResult) -> Page:
    """Return the page of `hil identify arm`."""
    drawings = [each for each in (figures_arm.line_dips(result), figures_arm.fitted_dips(result)) if each is not None]
    chapters = [Section("line", "Resonances", tuple(drawings)), Section("dips", "Dips", (dips(result), gears(result)))]
    head = PageHead(
        result.bench,
        result.started_utc,
        heading="Masses of the arm",
        subtitle="From the plants of its axes in several postures",
        origin=origin_of_arm(result),
    )
    return Page(head, verdict(result), chapters, provenance=[("Bench", result.bench)])


def verdict(result: ArmResult) -> PageVerdict:
    """Verdict at the top of the page."""
    known = result.arm
    found = f"from {known.postures} postures, misfit {known.misfit:.2f} standard errors"
    headline = f"Dips are predicted within {100.0 * known.dip_error:.1f} %, {found}"
    return PageVerdict("good", "✔", headline, result.notes)


def dips(result: ArmResult) -> ReportTable:
    """Tabulate measured dips beside the fit and the bench file's bodies."""
    rows: list[list[Cell]] = []
    for row in result.measured:
        posture = ", ".join(f"{angle:.0f}" for angle in row.joints_deg).replace("-", "−")
        measured = " ± ".join(value_and_error(row.measured_hz, row.standard_error_hz))
        off = 100.0 * (row.measured_hz / row.fitted_hz - 1.0)
        by_bodies = None if row.bodies_hz is None else 100.0 * (row.measured_hz / row.bodies_hz - 1.0)
        numbers = (number(row.fitted_hz, "{:.2f}"), number(off, "{:+.2f}"), number(by_bodies, "{:+.2f}"))
        rows.append([f"axis {row.axis}", posture, measured, *numbers])
    header = ("axis", "joints (°)", "measured (Hz)", "fitted (Hz)", "measured − fitted (%)", "measured − bodies (%)")
    caption = "Last column: against the bench file's bodies on the fitted gears; empty if its links have no bodies."
    return ReportTable("dips", "Measured and fitted dips", "", header, rows, frozenset({0, 1}), caption)


def gears(result: ArmResult) -> ReportTable:
    """Stiffness of each gear."""
    known = result.arm
    rows: list[list[Cell]] = [
        [f"axis {axis}", " ± ".join(value_and_error(1e-3 * stiffness, 1e-3 * error))]
        for axis, stiffness, error in zip(known.axes, known.stiffness_nm_rad, known.standard_error_nm_rad, strict=True)
    ]
    return ReportTable("gears", "Gears", "", ("axis", "K_g (kN·m/rad)"), rows)
