"""Figures of an arm's identified masses: predicted and measured dips."""

import itertools

import numpy as np

from hil.report import style
from hil.report.style import Drawing
from hil.results.arm import ArmResult

BAND_SIGMAS = 2.0
"""Standard errors of the shaded band."""


def line_dips(result: ArmResult) -> Drawing | None:
    """Draw the predicted dips along the line with their standard errors.

    With the dips from the bench file's bodies, if it has any.
    """
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
    panel.set_xlabel("Position along the line (%)")
    panel.set_ylabel("Frequency (Hz)")
    style.legend_above(figure, panel)
    return Drawing(
        "line-dips",
        "Resonances of the arm along its line",
        "",
        "computed",
        "Resonances of the arm with all motors held: dips in every motor's response. Shaded: two standard errors. Points: "
        "measured in postures near the line.",
        style.to_svg(figure, "line-dips"),
    )


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
    panel.set_xlabel("Measured dip (Hz)")
    panel.set_ylabel("Measured − fitted (%)")
    style.legend_above(figure, panel)
    return Drawing(
        "fitted-dips",
        "Residuals of the dips",
        "",
        "measured and computed",
        "Every dip that an axis has measured in a posture, with its standard error. The fit counts an error of at least 0.3 %, "
        "because an excited joint turns by several degrees.",
        style.to_svg(figure, "fitted-dips"),
    )
