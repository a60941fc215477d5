"""Figures and tables of an identified plant: frequency responses with their confidence, friction and gravity."""

import math
from typing import Any

import numpy as np

from hil.design.frequency import Complex, Real
from hil.design.plant_identification import angle_response, tip_response
from hil.report import style
from hil.report.origin import origin_of
from hil.report.style import Drawing
from hil.report.tables.paper_runs import Cell, Mark, ReportTable
from hil.results.plant import FrequencyResponseEntry, PlantResult

PARAMETERS = (
    ("motor_inertia_kg_m2", "J_m, motor", "kg·m²"),
    ("arm_inertia_kg_m2", "J_l, arm", "kg·m²"),
    ("gear_stiffness_nm_rad", "K_g, gear", "N·m/rad"),
    ("gear_damping_nm_s_rad", "D_g, gear", "N·m·s/rad"),
    ("motor_damping_nm_s_rad", "D_m, motor", "N·m·s/rad"),
    ("arm_damping_nm_s_rad", "D_l, arm", "N·m·s/rad"),
    ("viscous_damping_nm_s_rad", "D_m + D_l/N²", "N·m·s/rad"),
    ("antiresonance_hz", "f_a, anti-resonance", "Hz"),
    ("resonance_hz", "f_r, resonance", "Hz"),
    ("damping", "ζ of the arm on its gear", ""),
    ("friction_coulomb_nm", "Coulomb friction, from slow turns", "N·m"),
    ("friction_viscous_nm_s_rad", "Slope of the friction, from slow turns", "N·m·s/rad"),
    ("gravity_moment_nm", "m g l, gravity at the arm", "N·m"),
    ("gravity_phase_deg", "q_0 in m g l cos(θ_l + q_0)", "°"),
    ("lever_ratio", "Tip lever seen, over the bench file's", ""),
    ("torque_age_s", "Age of the reported torque", "s"),
    ("accelerometer_delay_s", "Delay of the accelerometer", "s"),
)


def parameters(result: PlantResult) -> ReportTable | None:
    """Table of every number with its standard error."""
    values, plan = result.parameters, result.plan
    if values is None or plan is None:
        return None
    rows: list[list[Cell]] = []
    for name, title, unit in PARAMETERS:
        if name not in values:
            continue
        value, error = values[name].value, values[name].standard_error
        percent = f"{100.0 * error / abs(value):.2g} %" if value else "–"
        rows.append([title, f"{value:.5g}".replace("-", "−"), f"{error:.2g}".replace("-", "−"), unit, percent])
    return ReportTable(
        "parameters", "Parameters", "", ("Parameter", "Value", "Standard error", "Unit", "Relative"), rows,
        frozenset({0, 3}),
        "Gear and arm on the arm side, motor and friction on the motor side. Standard errors come from the scatter between "
        "periods, enlarged by the misfit of the model where that is above 1; what they do not contain is said under “What these "
        f"data cannot tell”. Misfit: {result.misfit:.2f} standard deviations; {plan.periods} periods.",
    )  # fmt: skip


def checks(result: PlantResult) -> ReportTable | None:
    """Table of the checks, with the value and the limit of each."""
    rows: list[list[Cell]] = []
    for check in result.checks:
        needed = f"{check.needed:.3g} {check.unit}".strip()
        rows.append([check.name, f"{check.value:.3g} {check.unit}".strip(), needed, Mark(check.holds)])
    if not rows:
        return None
    return ReportTable("checks", "Checks", "", ("Check", "Found", "Limit", "Holds"), rows, frozenset({0, 3}))


def frequency_response(result: PlantResult) -> Drawing | None:
    """Figure of the motor angle per torque: gain, phase, coherence, fit and confidence."""
    measured, plant, parameters = result.response, result.plant, result.parameters
    if measured is None or plant is None or parameters is None:
        return None
    frequency, value = _complex(measured)
    figure, panels = style.panels(3, 1, 6.2, sharex=True, height_ratios=(4, 3, 1.6))
    fine = np.geomspace(frequency[0], frequency[-1], 800)
    model = angle_response(plant, fine)
    _gain_and_phase(panels, frequency, value, np.asarray(measured.radius), fine, model, origin_of(result).word)
    panels[0, 0].set_ylabel(r"$|\theta_m/\tau|$ (dB re 1 rad/N·m)")
    for name, symbol, side in (("antiresonance_hz", "f_a", "right"), ("resonance_hz", "f_r", "left")):
        parameter = parameters[name]
        text = f"${symbol}$ = {parameter.value:.3f} ± {parameter.standard_error:.1g} Hz"
        style.flag(panels[0, 0], parameter.value, text, side=side)
    _coherence(panels[2, 0], frequency, measured)
    style.legend_above(figure, panels[0, 0])
    return Drawing(
        "frequency-response", "Motor angle per torque", "Fig. 4", "measured and computed",
        "Frequency response on the excited lines, with the excitation as instrument, averaged over the periods; bars and band: "
        "where the true value lies with a probability of 95 %. Broken: the two-inertia model that was fitted. Coherence: the "
        "fraction of the motor's motion in one period that follows the torque.",
        style.to_svg(figure, "frequency-response"),
    )  # fmt: skip


def tip(result: PlantResult) -> Drawing | None:
    """Tip acceleration per motor angle."""
    measured, plant, parameters = result.tip_response, result.plant, result.parameters
    if measured is None or plant is None or parameters is None:
        return None
    frequency, value = _complex(measured)
    figure, panels = style.panels(3, 1, 6.2, sharex=True, height_ratios=(4, 3, 1.6))
    fine = np.geomspace(frequency[0], frequency[-1], 800)
    lever = result.bench.file.axis[result.axis].tip_lever_m * parameters["lever_ratio"].value
    model = tip_response(plant, fine, lever, parameters["accelerometer_delay_s"].value)
    _gain_and_phase(panels, frequency, value, np.asarray(measured.radius), fine, model, origin_of(result).word)
    panels[0, 0].set_ylabel(r"$|a_{tip}/\theta_m|$ (dB re 1 m/s² per rad)")
    _coherence(panels[2, 0], frequency, measured)
    style.legend_above(figure, panels[0, 0])
    ratio = parameters["lever_ratio"]
    return Drawing(
        "tip-response", "Tip acceleration per motor angle", "", "measured and computed",
        "The arm on its gear, driven by the motor's motion: it peaks at f_a, and needs neither the torque nor the lever to tell "
        f"it. Its height is a check: the lever seen is {ratio.value:.3f} ± {ratio.standard_error:.1g} times the bench "
        "file's.",
        style.to_svg(figure, "tip-response"),
    )  # fmt: skip


def _complex(measured: FrequencyResponseEntry) -> tuple[Real, Complex]:
    value = np.asarray(measured.real) + 1j * np.asarray(measured.imaginary)
    return np.asarray(measured.frequency_hz), np.asarray(value, dtype=np.complex128)


def _gain_and_phase(
    panels: style.Panels, frequency: Real, value: Complex, radius: Real, fine: Real, model: Complex, word: str
) -> None:  # fmt: skip
    gain, phase = panels[0, 0], panels[1, 0]
    size = np.abs(value)
    low, high = style.decibel(np.maximum(size - radius, 1e-3 * size)), style.decibel(size + radius)
    gain.fill_between(frequency, low, high, color=style.SKY, alpha=0.45, linewidth=0, label="95 %")
    gain.semilogx(frequency, style.decibel(value), label=word, marker=".", **style.MEASURED)
    gain.semilogx(fine, style.decibel(model), label="fitted model", **style.MODEL)
    angle = np.degrees(np.unwrap(np.angle(value)))
    fitted = np.degrees(np.unwrap(np.angle(model)))
    angle += 360.0 * round(float(np.median(np.interp(frequency, fine, fitted) - angle)) / 360.0)
    width = np.degrees(np.arcsin(np.minimum(1.0, radius / size)))
    phase.fill_between(frequency, angle - width, angle + width, color=style.SKY, alpha=0.45, linewidth=0)
    phase.semilogx(frequency, angle, marker=".", **style.MEASURED)
    phase.semilogx(fine, fitted, **style.MODEL)
    phase.set_ylabel("Phase (°)")


def _coherence(panel: Any, frequency: Real, measured: FrequencyResponseEntry) -> None:
    panel.semilogx(frequency, measured.coherence, **style.MEASURED)
    panel.set_ylim(0.0, 1.05)
    panel.set_ylabel("Coherence")
    panel.set_xlabel("Frequency (Hz)")
    ticks = [tick for tick in (2, 3, 5, 10, 20, 30, 50, 100, 200) if frequency[0] <= tick <= frequency[-1]]
    panel.set_xticks(ticks, [str(tick) for tick in ticks])
    panel.minorticks_off()


def friction(result: PlantResult) -> Drawing | None:
    """Figure of the slow turns: torque over the arm angle, and friction over the speed."""
    curve, parameters = result.friction, result.parameters
    if curve is None or parameters is None:
        return None
    speed = np.asarray(curve.speed_rad_s) / (2.0 * math.pi)
    arm, torque = np.degrees(curve.arm_angle_rad), np.asarray(curve.torque_nm)
    model, gravity = np.asarray(curve.model_nm), np.asarray(curve.gravity_nm)
    figure, panels = style.panels(1, 2, 3.2, width_ratios=(3, 2))
    over_angle, over_speed = panels[0]
    for direction, look, name in ((1, style.AXIS_LINES[0], "forwards"), (-1, style.AXIS_LINES[1], "backwards")):
        rows = np.flatnonzero(speed * direction > 0.0)
        over_angle.plot(arm[rows], torque[rows], label=f"{name}, each a motor turn", **{**look, "linestyle": "none"})
        order = rows[np.argsort(arm[rows])]
        fastest = order[np.abs(speed[order]) > 0.9 * np.max(np.abs(speed))]
        over_angle.plot(arm[fastest], model[fastest], color=style.BLACK, linewidth=0.9)
    order = np.argsort(arm)
    over_angle.plot(arm[order], gravity[order], label="gravity, fitted", **style.MODEL)
    over_angle.set_xlabel("Arm angle (°)")
    over_angle.set_ylabel("Motor torque (N·m)")
    over_speed.plot(speed, torque - gravity, **{**style.AXIS_LINES[0], "linestyle": "none"})
    for direction in (1, -1):
        line = np.linspace(0.0, float(np.max(np.abs(speed))), 2)
        level = parameters["friction_coulomb_nm"].value
        slope = parameters["friction_viscous_nm_s_rad"].value
        over_speed.plot(direction * line, direction * (level + slope * 2.0 * math.pi * line), **style.MODEL)
    over_speed.set_xlabel("Motor speed (rev/s)")
    over_speed.set_ylabel("Friction (N·m)")
    style.legend_above(figure, over_angle)
    return Drawing(
        "friction", "Friction and gravity", "", "measured and computed",
        "Left: motor torque of slow turns in both directions, averaged over whole motor turns; gravity is what both have in "
        "common. Right: what is left of it, over the speed. Broken: the fit.",
        style.to_svg(figure, "friction"),
    )  # fmt: skip
