"""The page of an arm's masses, with its predicted and measured dips: one self-contained HTML file."""

import itertools
from pathlib import Path

import numpy as np

from hil.report import style
from hil.report.origin import origin_of_arm
from hil.report.pages.page import Page, PageHead, PageVerdict, Section
from hil.report.report_table import Cell, ReportTable, number, value_and_error
from hil.report.style import Drawing
from hil.results.arm import ArmResult


def page_of(_: Path, result: ArmResult) -> Page:
    """Return the page of `hil identify arm`."""
    drawings = [each for each in (line_dips(result), fitted_dips(result)) if each is not None]
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
    return PageVerdict("good", headline, result.notes)


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
    return ReportTable("dips", "Measured and fitted dips", header, rows, {0, 1}, caption)


def gears(result: ArmResult) -> ReportTable:
    """Stiffness of each gear."""
    known = result.arm
    rows: list[list[Cell]] = [
        [f"axis {axis}", " ± ".join(value_and_error(1e-3 * stiffness, 1e-3 * error))]
        for axis, stiffness, error in zip(known.axes, known.stiffness_nm_rad, known.standard_error_nm_rad, strict=True)
    ]
    return ReportTable("gears", "Gears", ("axis", "K_g (kN·m/rad)"), rows)


BAND_SIGMAS = 2.0
"""Standard errors of the shaded band."""


def line_dips(result: ArmResult) -> Drawing | None:
    """Draw predicted dips along the line, beside those of the bodies."""
    if not result.line:
        return None
    figure, ((panel,),) = style.panels(1, 1, 3.6)
    way = 100.0 * np.array([row.way_fraction for row in result.line])
    dips = np.array([row.dips_hz for row in result.line])
    errors = BAND_SIGMAS * np.array([row.standard_error_hz for row in result.line])
    for column in range(dips.shape[1]):
        panel.fill_between(way, dips[:, column] - errors[:, column], dips[:, column] + errors[:, column], color=style.SHADE)
        panel.plot(way, dips[:, column], label="predicted", **style.BROAD)
    if result.line[0].bodies_hz:
        for column in np.array([row.bodies_hz for row in result.line]).T:
            panel.plot(way, column, label="from the bench file's bodies", **style.MODEL)
    for axis, look in zip(result.arm.axes, itertools.cycle(style.AXIS_LINES)):
        near = [row for row in result.measured if row.axis == axis and row.way_fraction is not None]
        points = ([100.0 * (row.way_fraction or 0.0) for row in near], [row.measured_hz for row in near])
        panel.plot(*points, label=f"measured by axis {axis}", clip_on=False, **(look | {"linestyle": "none"}))
    panel.set_yscale("log")
    panel.set_ylim(0.7 * float(np.min(dips)), 1.4 * float(np.max(dips)))
    ticks = [hz for hz in (2, 3, 5, 7, 10, 15, 20, 30, 50, 70, 100) if 0.7 * np.min(dips) < hz < 1.4 * np.max(dips)]
    panel.set_yticks(ticks, [str(hz) for hz in ticks])
    panel.minorticks_off()
    panel.set(xlabel="Position along the line (%)", ylabel="Frequency (Hz)")
    style.legend_above(figure, panel)
    caption = (
        "Resonances of the arm with all motors held: dips in every motor's response. Shaded: two standard errors. Points: "
        "measured in postures near the line."
    )
    return style.drawing(figure, "line-dips", "Resonances of the arm along its line", caption, "computed")


def fitted_dips(result: ArmResult) -> Drawing:
    """Measured dips against those of the fit, in per cent."""
    figure, ((panel,),) = style.panels(1, 1, 2.6)
    for axis, look in zip(result.arm.axes, itertools.cycle(style.AXIS_LINES)):
        rows = [row for row in result.measured if row.axis == axis]
        hz = [row.measured_hz for row in rows]
        off = [100.0 * (row.measured_hz / row.fitted_hz - 1.0) for row in rows]
        errors = [100.0 * row.standard_error_hz / row.measured_hz for row in rows]
        panel.errorbar(hz, off, yerr=errors, label=f"axis {axis}", **(look | {"linestyle": "none"}))
    panel.axhline(0.0, **style.MARK)
    panel.set(xlabel="Measured dip (Hz)", ylabel="Measured − fitted (%)")
    style.legend_above(figure, panel)
    caption = (
        "Every dip that an axis has measured in a posture, with its standard error. The fit counts an error of at least 0.3 %, "
        "because an excited joint turns by several degrees."
    )
    return style.drawing(figure, "fitted-dips", "Residuals of the dips", caption, style.BOTH)
