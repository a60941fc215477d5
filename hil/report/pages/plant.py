"""The page of a plant identification, with its figures and tables: one self-contained HTML file."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hil.control.arrays import Complex, Real
from hil.design.modes.problem import ArmMode, modal_angle, modal_tip
from hil.design.plant_problem import angle_response, tip_response
from hil.report import style
from hil.report.origin import origin_of
from hil.report.pages.page import Page, PageHead, PageVerdict, Section, bench_lines, filled_sections
from hil.report.report_table import Cell, Mark, ReportTable, value_and_error
from hil.report.style import Drawing
from hil.results.plant import PARAMETERS, FrequencyResponseEntry, PlantResult


def page_of(_: Path, result: PlantResult) -> Page:
    """Return the page of `hil identify plant`, also if it has identified nothing."""
    head = PageHead.of(result, f"Plant of axis {result.axis}")
    return Page(head, verdict(result), sections(result), provenance=provenance(result))


def sections(result: PlantResult) -> list[Section]:
    """All chapters for which there is data."""
    unknown: list[list[Cell]] = [[line] for line in result.cannot_tell or ()]
    cannot_tell = ReportTable("cannot-tell", "What these data cannot tell", ("",), unknown, is_prose=True)
    return filled_sections(
        ("plant", "Plant", (parameters(result), modes(result), frequency_response(result))),
        ("arm", "The arm at the tip", (tip(result),)),
        ("slow", "Friction and gravity", (friction(result),)),
        ("limits", "How far these data reach", (cannot_tell, checks(result))),
    )


def verdict(result: PlantResult) -> PageVerdict:
    """Verdict at the top of the page."""
    remarks, parameters = result.remarks, result.parameters
    if result.stopped is not None:
        return PageVerdict("stopped", "The run was stopped", (result.stopped, *remarks))
    if parameters is None:
        return PageVerdict("bad", "Not identified", (*(result.not_identified or ()), *remarks))
    f_a, stiffness = parameters["antiresonance_hz"], parameters["gear_stiffness_nm_rad"]
    headline = (
        f"f_a = {' ± '.join(value_and_error(f_a.value, f_a.standard_error))} Hz, "
        f"K_g = {' ± '.join(value_and_error(1e-3 * stiffness.value, 1e-3 * stiffness.standard_error))} kN·m/rad"
    )
    return PageVerdict("good", headline, remarks)


def provenance(result: PlantResult) -> list[tuple[str, str]]:
    """Bench, instant, versions and excitation of the measurement."""
    lines, plan = bench_lines(result.bench), result.plan
    if plan is not None:
        low, high = plan.travel_rev
        shape = result.request.shape
        lines += [
            (
                "Excitation",
                f"{shape} on the {plan.excitation}, peak {plan.amplitude_nm:.3g} N·m, crest {plan.crest_factor:.2f}",
            ),
            ("Motion", f"{plan.bias_rps:.3g} rev/s back and forth, {low:.1f} … {high:.1f} motor revolutions".replace("-", "−")),
        ]
    return lines


MOST_PERCENT = 100.0
"""Standard error in percent of a value above which the number says nothing."""
WHOLE_PERCENT = 10.0
"""Relative errors from which whole per cent are shown."""


def _percent(relative: float) -> str:
    """Return a standard error in per cent of its value."""
    if relative > MOST_PERCENT:
        return f"> {MOST_PERCENT:g} %"
    return f"{relative:.0f} %" if relative >= WHOLE_PERCENT else f"{relative:.2g} %"


def parameters(result: PlantResult) -> ReportTable | None:
    """Table of every number with its standard error."""
    values, plan = result.parameters, result.plan
    if values is None or plan is None:
        return None
    rows: list[list[Cell]] = []
    for each in PARAMETERS:
        if each.name not in values:
            continue
        value, error = values[each.name].value, values[each.name].standard_error
        relative = 100.0 * error / abs(value) if value else math.inf
        rows.append([each.title, *value_and_error(each.scale * value, each.scale * error), each.page_unit, _percent(relative)])
    header = ("Parameter", "Value", "Standard error", "Unit", "Relative")
    caption = (
        "Gear and arm refer to the arm side, motor and friction to the motor side. Standard errors come from the scatter "
        "between periods, times the misfit of whichever of torque, law and tip the model explains least. They include the "
        "dependence on the torsion, as the pilot run and this run show it. The checks below give the part that comes from "
        "noise alone; more periods lower it. “What these data cannot tell” lists the errors that are not "
        f"included. Misfit: {result.misfit:.2f} standard deviations; {plan.periods} periods."
    )
    return ReportTable("parameters", "Parameters", header, rows, {0, 3}, caption)


def modes(result: PlantResult) -> ReportTable:
    """Table of an arm's modes; None if it rings with one."""
    rows: list[list[Cell]] = []
    for mode in result.modes:
        values = (mode.antiresonance_hz, mode.resonance_hz, mode.damping, mode.inertia_kg_m2, mode.tip_part)
        rows.append(["–" if each is None else " ± ".join(value_and_error(each.value, each.standard_error)) for each in values])
    header = ("Dip, Hz", "Peak, Hz", "ζ", "Inertia, kg·m²", "Part of the tip's motion")
    caption = (
        "Modes of the arm with this motor held, the lowest first. Their inertias add up to the inertia about the joint, their "
        "parts of the tip's motion to 1. J_l, K_g, D_g, f_a, f_r and ζ above are those of the leading mode."
    )
    return ReportTable("modes", "Modes", header, rows, (), caption)


def checks(result: PlantResult) -> ReportTable:
    """Table of the checks, with the value and the limit of each."""
    rows: list[list[Cell]] = []
    for check in result.checks:
        needed = f"{check.needed:.3g} {check.unit}".strip()
        rows.append([check.name, f"{check.value:.3g} {check.unit}".strip(), needed, Mark(check.holds)])
    return ReportTable("checks", "Checks", ("Check", "Found", "Limit", "Holds"), rows, {0, 3})


def frequency_response(result: PlantResult) -> Drawing | None:
    """Draw the motor angle per torque, with fit and confidence."""
    measured, plant, parameters = result.response, result.plant, result.parameters
    if measured is None or plant is None or parameters is None:
        return None
    modes = [ArmMode.of(each) for each in result.modes]
    fine = np.geomspace(measured.frequency_hz[0], measured.frequency_hz[-1], 800)
    model = modal_angle(plant, modes, fine) if modes else angle_response(plant, fine)
    figure, panels = _response(result, measured, fine, model)
    panels[0, 0].set_ylabel(r"$|\theta_m/\tau|$ (dB re 1 rad/N·m)")
    for name, symbol, side in (("antiresonance_hz", "f_a", "right"), ("resonance_hz", "f_r", "left")):
        parameter = parameters[name]
        text = f"${symbol}$ = {' ± '.join(value_and_error(parameter.value, parameter.standard_error))} Hz"
        style.flag(panels[0, 0], parameter.value, text, side=side)
    style.legend_above(figure, panels[0, 0])
    caption = (
        "Frequency response on the excited lines, with the excitation as instrument, averaged over the periods; bars and band: "
        "where the true value lies with a probability of 95 %. Dashed: the fitted model. Coherence: the "
        "fraction of the motor's motion in one period that follows the torque."
    )
    return style.drawing(figure, "frequency-response", "Motor angle per torque", caption, style.BOTH, "Fig. 4", is_zoomable=True)


def tip(result: PlantResult) -> Drawing | None:
    """Tip acceleration per motor angle."""
    measured, plant, parameters = result.tip_response, result.plant, result.parameters
    if measured is None or plant is None or parameters is None:
        return None
    fine = np.geomspace(measured.frequency_hz[0], measured.frequency_hz[-1], 800)
    lever = result.bench.file.axis[result.axis].tip_lever_m * parameters["lever_ratio"].value
    modes, delay_s = [ArmMode.of(each) for each in result.modes], parameters["accelerometer_delay_s"].value
    model = modal_tip(plant, modes, fine, lever, delay_s) if modes else tip_response(plant, fine, lever, delay_s)
    figure, panels = _response(result, measured, fine, model)
    panels[0, 0].set_ylabel(r"$|a_{tip}/\theta_m|$ (dB re 1 m/s² per rad)")
    style.legend_above(figure, panels[0, 0])
    ratio = parameters["lever_ratio"]
    seen = " ± ".join(value_and_error(ratio.value, ratio.standard_error))
    caption = (
        "Response of the arm on its gear to the motor's motion: it peaks at f_a, whatever the torque and the lever. Its height "
        f"is a check: the lever that follows from it is {seen} times the bench file's."
    )
    return style.drawing(figure, "tip-response", "Tip acceleration per motor angle", caption, style.BOTH, is_zoomable=True)


def _response(result: PlantResult, measured: FrequencyResponseEntry, fine: Real, model: Complex) -> tuple[Figure, style.Panels]:
    """Draw gain, phase and coherence of a measured response beside the fitted model."""
    figure, panels = style.panels(3, 1, 6.2, sharex=True, height_ratios=(4, 3, 1.6))
    frequency, radius = np.asarray(measured.frequency_hz), np.asarray(measured.radius)
    value = np.asarray(measured.real) + 1j * np.asarray(measured.imaginary)
    gain, phase = panels[0, 0], panels[1, 0]
    size = np.abs(value)
    low, high = style.decibel(np.maximum(size - radius, 1e-3 * size)), style.decibel(size + radius)
    gain.fill_between(frequency, low, high, color=style.SKY, alpha=0.45, linewidth=0, label="95 %")
    gain.semilogx(frequency, style.decibel(value), label=origin_of(result).word, marker=".", **style.MEASURED)
    gain.semilogx(fine, style.decibel(model), label="fitted model", **style.MODEL)
    angle = np.degrees(np.unwrap(np.angle(value)))
    fitted = np.degrees(np.unwrap(np.angle(model)))
    angle += 360.0 * round(float(np.median(np.interp(frequency, fine, fitted) - angle)) / 360.0)
    width = np.degrees(np.arcsin(np.minimum(1.0, radius / size)))
    phase.fill_between(frequency, angle - width, angle + width, color=style.SKY, alpha=0.45, linewidth=0)
    phase.semilogx(frequency, angle, marker=".", **style.MEASURED)
    phase.semilogx(fine, fitted, **style.MODEL)
    phase.set_ylabel("Phase (°)")
    _coherence(panels[2, 0], frequency, measured)
    return figure, panels


def _coherence(panel: Any, frequency: Real, measured: FrequencyResponseEntry) -> None:
    panel.semilogx(frequency, measured.coherence, **style.MEASURED)
    panel.set(ylim=(0.0, 1.05), ylabel="Coherence", xlabel="Frequency (Hz)")
    ticks = [tick for tick in (2, 3, 5, 10, 20, 30, 50, 100, 200) if frequency[0] <= tick <= frequency[-1]]
    panel.set_xticks(ticks, [str(tick) for tick in ticks])
    panel.minorticks_off()


def friction(result: PlantResult) -> Drawing | None:
    """Draw the friction measurement: torque over arm angle, friction over speed."""
    curve, parameters = result.friction, result.parameters
    if curve is None or parameters is None:
        return None
    speed = np.asarray(curve.speed_rad_s) / (2.0 * math.pi)
    arm, torque = np.degrees(curve.arm_angle_rad), np.asarray(curve.torque_nm)
    model, gravity = np.asarray(curve.model_nm), np.asarray(curve.gravity_nm)
    figure, panels = style.panels(1, 2, 3.4, width_ratios=(3, 2))
    over_angle, over_speed = panels[0]
    fastest_rps = float(np.max(np.abs(speed)))
    for direction, look, name in ((1, style.AXIS_LINES[0], "forwards"), (-1, style.AXIS_LINES[1], "backwards")):
        turning = speed * direction > 0.0
        is_fastest = np.abs(speed) > 0.9 * fastest_rps
        for rows, fill, pace in ((turning & is_fastest, "full", "fastest"), (turning & ~is_fastest, "none", "slower")):
            if rows.any():
                points: style.Line = {**look, "linestyle": "none", "fillstyle": fill, "label": f"{name}, {pace}"}
                over_angle.plot(arm[rows], torque[rows], **points)
                over_speed.plot(speed[rows], (torque - gravity)[rows], **points)
        line = np.flatnonzero(turning & is_fastest)
        line = line[np.argsort(arm[line])]
        over_angle.plot(arm[line], model[line], label="fit at the fastest speed", **style.RESIDUAL)
    order = np.argsort(arm)
    over_angle.plot(arm[order], gravity[order], label="gravity, fitted", **style.CONSTRAINT)
    over_angle.set(xlabel="Arm angle (°)", ylabel="Motor torque (N·m)")
    level, slope = parameters["friction_coulomb_nm"].value, parameters["friction_viscous_nm_s_rad"].value
    for direction in (1, -1):
        reach = np.linspace(0.0, fastest_rps, 2)
        over_speed.plot(
            direction * reach, direction * (level + slope * 2.0 * math.pi * reach), label="friction, fitted", **style.MODEL
        )
    over_speed.set(xlabel="Motor speed (rev/s)", ylabel="Friction (N·m)")
    style.legend_above(figure, over_angle, over_speed)
    paces = sorted({round(float(each), 2) for each in np.abs(speed)})
    slower = (
        f" Open points are the slower turns ({', '.join(f'{pace:g}' for pace in paces[:-1])} rev/s against {paces[-1]:g} "
        "rev/s): they cover less of the angle and need less torque, so they lie beside the others."
        if len(paces) > 1
        else ""
    )
    caption = (
        "Left: motor torque of slow turns in both directions, one point per motor turn; gravity is what both have in "
        f"common.{slower} Right: the torque less gravity, over speed."
    )
    return style.drawing(figure, "friction", "Friction and gravity", caption, style.BOTH)
