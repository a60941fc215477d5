"""Figures of the axes by their models, and of the identification of the transmission error; Figs. 4 to 8."""

import numpy as np

from hil.analysis import motor_speed_rps
from hil.control.arrays import Real
from hil.design.ate.model import Arm, Sensing, Sweep, modelled
from hil.design.paper import TABLE_1
from hil.design.transmission_error import TransmissionError
from hil.experiments.motions import CONSTANT_ACCELERATION
from hil.recording import Recording
from hil.report import plotted_run as plotted
from hil.report import style
from hil.report.material import Material
from hil.report.style import Drawing


def plants(material: Material) -> Drawing | None:
    """P(s) of every axis with a model, gain and phase; Fig. 4."""
    axes = material.model_axes
    if not axes:
        return None
    figure, panels = style.panels(2, len(axes), 4.1, sharex=True, sharey="row", height_ratios=(3, 2))
    frequency = np.geomspace(1.0, 100.0, 1200)
    for column, number in enumerate(axes):
        plant = material.loop(number).plant
        response = plant.motor_angle_per_torque(frequency)
        gain, phase = panels[:, column]
        gain.semilogx(frequency, style.decibel(response), **style.MEASURED)
        phase.semilogx(frequency, np.degrees(np.unwrap(np.angle(response))), **style.MEASURED)
        low, high = plant.antiresonance_hz, plant.resonance_hz
        style.flag(gain, low, f"$f_a$ = {low:.2f} Hz", side="right")
        style.flag(gain, high, f"$f_r$ = {high:.2f} Hz")
        for panel in (low, high):
            phase.axvline(panel, **style.MARK)
        gain.set(title=f"Axis {number}: $P_{number}(s)$", xlim=(1.0, 100.0))
        phase.set_yticks([-180, -90, 0])
        phase.set(ylim=(-200, 20), xlabel="Frequency (Hz)")
    style.name_rows(panels, r"Gain $|\theta_m/\tau|$ (dB re 1 rad/N·m)", "Phase (°)")
    _plain_frequencies(panels[1])
    caption = (
        "Frequency response of each axis' two-inertia model from motor torque to motor angle, from the "
        f"{material.model_source}'s parameters. "
        "At the anti-resonance f_a the arm swings on its gear and holds the motor still; at the resonance f_r motor "
        "and arm swing "
        f"against each other.{' The paper has about 12 Hz and 22 Hz.' if material.bench.is_paper else ''}"
    )
    return style.drawing(figure, "plants", "Plant: motor angle per torque", caption, "computed", "Fig. 4")


def transmission_errors(material: Material) -> Drawing | None:
    """Draw identified θ_sync and that of the bench file; Fig. 5."""
    axes = material.model_axes
    if not axes:
        return None
    figure, panels = style.panels(2 * len(axes), 1, 0.7 + 2.7 * len(axes), sharex=True, height_ratios=(5, 3) * len(axes))
    turns = np.linspace(0.0, 2.0, 721)
    identified = 0
    for panel, rest, number in zip(panels[::2, 0], panels[1::2, 0], axes, strict=True):
        estimate, table = material.estimate(number), material.transmission_error(number)
        if estimate is not None:
            identified += 1
            panel.plot(turns, _arcsec(estimate.error, turns), label="identified from the tip acceleration", **style.BROAD)
        if table is not None:
            panel.plot(turns, _arcsec(table, turns), label=material.model_source, **style.MODEL)
        if estimate is not None and table is not None:
            spread = plotted.spread_arcsec(estimate.error, estimate.amplitude_error_arcsec, estimate.phase_error_deg, turns)
            rest.fill_between(turns, -spread, spread, color=style.SKY, alpha=0.5, linewidth=0.0, label="± 2 standard errors")
            off = _arcsec(estimate.error, turns) - _arcsec(table, turns)
            style.residual(rest, turns, off, "arcsec", f"identified − {material.model_source}")
        else:
            style.note(rest, "nothing to compare with")
        for turn in (1.0, 2.0):
            panel.axvline(turn, **style.MARK)
        panel.set_title(f"Axis {number}")
        rest.set_ylabel("Residual (arcsec)")
        panel.set(ylabel=r"$\theta_{sync}$ (arcsec)", xlim=(0.0, 2.0))
    panels[-1, 0].set_xlabel("Motor angle (rev)")
    style.legend_above(figure, *panels[:2, 0])
    how = (
        "The solid line is identified from the tip while the motor passed both resonances without a notch. "
        "It is a joint least-squares fit of all orders through the arm on its gear, driven by the measured motor angle. "
        if identified
        else "There is no run without a notch from which it could be identified. "
    )
    caption = (
        f"θ_sync over two revolutions of the motor, at the arm. {how}The dashed line is that of the {material.model_source}. "
        "Below each: their difference, enlarged, and the range that noise alone explains. Dotted lines: whole revolutions."
    )
    title = "Synchronous transmission error"
    return style.drawing(
        figure, "transmission-errors", title, caption, "measured and computed" if identified else "computed", "Fig. 5"
    )


def resonances(material: Material) -> Drawing | None:
    """|G_al| of every axis with a model, f_al marked; Fig. 6."""
    axes = material.model_axes
    if not axes:
        return None
    figure, panels = style.panels(1, len(axes), 2.6, sharey=True)
    frequency = np.unique(np.concatenate([np.geomspace(1.0, 100.0, 500), np.linspace(8.0, 16.0, 400)]))
    for panel, number in zip(panels[0], axes, strict=True):
        loop = material.loop(number)
        gain = style.decibel(loop.acceleration_per_transmission_error(frequency))
        panel.semilogx(frequency, gain, **style.MEASURED)
        peak = material.f_al_hz[number]
        is_printed = material.bench.is_paper and number in TABLE_1
        beside = f"\n(paper: {TABLE_1[number][0]:.2f} Hz)" if is_printed else ""
        style.flag(panel, peak, rf"$f_{{al}}$ = {peak:.2f} Hz" + beside, height=0.3)
        panel.plot([peak], [np.interp(peak, frequency, gain)], "o", color=style.BLUE)
        panel.set(xlim=(1.0, 100.0), title=f"Axis {number}", xlabel="Frequency (Hz)")
    panels[0, 0].set_ylabel(r"$|G_{al}|$ (dB re 1/s²)")
    _plain_frequencies(panels[0])
    caption = (
        f"|G_al| = |a_l/θ_sync| of the closed loop without a notch, sampled at {1e6 * material.control_period_s:.0f} "
        f"µs. Where the "
        "motor turns so fast that the k-th harmonic meets the peak, f_m = f_al/k, the arm rings (Table 1)."
    )
    return style.drawing(figure, "resonances", "Arm acceleration per transmission error", caption, "computed", "Fig. 6")


def _arcsec(error: TransmissionError, turns: Real) -> Real:
    return np.asarray(np.degrees(error.angle_rad(2.0 * np.pi * turns)) * 3600.0)


def _plain_frequencies(panels: style.Panels) -> None:
    """1, 2, 5, 10 … instead of powers of ten."""
    ticks = (1, 2, 5, 10, 20, 50, 100)
    for panel in panels:
        panel.set_xticks(ticks, labels=[str(tick) for tick in ticks])
        panel.minorticks_off()


def identification(material: Material, axis: int) -> Drawing | None:
    """Draw speed, tip acceleration and spectrum in both windows; Figs. 7, 8."""
    run = material.find(CONSTANT_ACCELERATION, axis, "none", "drive") or material.find(
        CONSTANT_ACCELERATION, axis, "none", "host"
    )
    recording = material.recording(run)
    if run is None or recording is None or material.scale(axis) is None:
        return None
    model = _modelled(material, axis, recording)
    orders = material.judged_orders(axis)
    figure, panels = plotted.passage_panels(len(orders), "Tip acceleration", "m/s²")
    for column, order in enumerate(orders):
        _window(material, axis, recording, model, order, panels[:, column])
    panels[3, 0].set_ylim(0.0, None)  # once all are drawn: the row has one scale
    style.legend_above(figure, panels[1, 0])
    paper = {2: "Fig. 7", 3: "Fig. 8"}.get(axis, "as Figs. 7 and 8")
    computed = (
        " Dashed: response of the arm on its gear, computed from the measured motor angle and the "
        f"{material.model_source}'s θ_sync. "
        "Below it: the residual, enlarged; it includes the sensor's noise."
        if model is not None
        else " The axis has no model to compare with."
    )
    limit = plotted.limit_words(material, axis, ", around the mean")
    caption = (
        "Constant acceleration of one motor. Top: its speed; shaded: the speeds in which the run is judged. Middle: "
        "vertical "
        f"acceleration of the tip, as the sensor gave it.{computed} {limit} Bottom: amplitude spectrum of the shaded "
        "part (Hann window, interpolated between its bins, mean removed)."
    )
    title = f"Axis {axis} through its resonant speeds, untreated"
    return style.drawing(
        figure, f"identification-{axis}", title, caption, "measured" if model is None else "measured and computed", paper
    )


def _modelled(material: Material, axis: int, recording: Recording) -> Real | None:
    error, plant = material.transmission_error(axis), material.bench.axis[axis].plant()
    if error is None or plant is None:
        return None
    angle, sensing = recording.axis(axis, "position_rad"), Sensing(material.bench.axis[axis].tip_lever_m)
    ramp = Sweep(angle, recording.felt_m_s2, recording.period_s, np.ones(len(angle), dtype=np.int8))
    return modelled(ramp, plant.reduction_ratio, sensing, Arm.of(plant), error)


def _window(material: Material, axis: int, recording: Recording, model: Real | None, order: int, panels: style.Panels) -> None:
    top, middle, rest, _ = panels
    window = material.window_rps(axis, order)
    top.set_title(f"k = {order}" + ("" if window is None else f": {window[0]:.3g} to {window[1]:.3g} rev/s"))
    inside = plotted.judged_samples(material, recording, axis, order)
    if len(inside) < plotted.FEWEST:
        for panel in panels:
            style.note(panel, "no model: not judged" if window is None else "the run did not reach these speeds")
        plotted.name_passage(panels)
        return
    time, tip = recording.time_s, recording.felt_m_s2
    margin = round(0.3 / recording.period_s)
    rows = slice(max(0, inside[0] - margin), inside[-1] + margin)
    begin, end = float(time[inside[0]]), float(time[inside[-1]])
    for panel in (top, middle, rest):
        panel.axvspan(begin, end, color=style.SHADE, zorder=0)
        panel.set_xlim(float(time[rows][0]), float(time[rows][-1]))
    passage = time, np.abs(motor_speed_rps(recording, axis)), tip, model
    plotted.draw_passage(panels, passage, rows, inside, "m/s²", material.word)
    if model is None:
        style.note(rest, "no model to compare with")
    f_al = material.f_al(axis)
    if f_al is not None:
        centre, limit = float(np.mean(tip[inside])), plotted.limit_m_s2(material, f_al)
        for sign, name in ((1.0, f"±{material.bench.specification.tip_mm:g} mm equivalent"), (-1.0, None)):
            middle.axhline(centre + sign * limit, label=name, **style.LIMIT)
