"""Figures of the identification of the transmission error; Figs. 7 and 8."""

import numpy as np

from hil.analysis import motor_speed_rps
from hil.design.ate.model import Arm, Sensing, Sweep, modelled
from hil.recording import Recording
from hil.report import style
from hil.report.material import CONSTANT_ACCELERATION, Material
from hil.report.plotted_run import FEWEST, judged_samples, limit_m_s2, limit_words, smooth_spectrum
from hil.report.style import Drawing, Real


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
    figure, panels = style.panels(4, len(orders), 5.9, height_ratios=(3, 5, 3, 4), sharey="row")
    for column, order in enumerate(orders):
        _window(material, axis, recording, model, order, panels[:, column])
    panels[3, 0].set_ylim(0.0, None)  # once all are drawn: the row has one scale
    panels[0, 0].set_ylabel("Speed (rev/s)")
    panels[1, 0].set_ylabel("Tip acceleration (m/s²)")
    panels[2, 0].set_ylabel("Residual (m/s²)")
    panels[3, 0].set_ylabel("Amplitude (m/s²)")
    style.legend_above(figure, panels[1, 0])
    paper = {2: "Fig. 7", 3: "Fig. 8"}.get(axis, "as Figs. 7 and 8")
    computed = (
        " Dashed: response of the arm on its gear, computed from the measured motor angle and the "
        f"{material.model_source}'s θ_sync. "
        "Below it: the residual, enlarged; it includes the sensor's noise."
        if model is not None
        else " The axis has no model to compare with."
    )
    limit = limit_words(material, axis, ", around the mean")
    return Drawing(
        f"identification-{axis}",
        f"Axis {axis} through its resonant speeds, untreated",
        paper,
        "measured" if model is None else "measured and computed",
        "Constant acceleration of one motor. Top: its speed; shaded: the speeds in which the run is judged. Middle: "
        "vertical "
        f"acceleration of the tip, as the sensor gave it.{computed} {limit} Bottom: amplitude spectrum of the shaded "
        "part (Hann window, interpolated between its bins, mean removed).",
        style.to_svg(figure, f"identification-{axis}"),
    )


def _modelled(material: Material, axis: int, recording: Recording) -> Real | None:
    error, plant = material.transmission_error(axis), material.bench.axis[axis].plant()
    if error is None or plant is None:
        return None
    angle, sensing = recording.axis(axis, "position_rad"), Sensing(material.bench.axis[axis].tip_lever_m)
    ramp = Sweep(angle, recording.felt_m_s2, recording.period_s, np.ones(len(angle), dtype=np.int8))
    return modelled(ramp, plant.reduction_ratio, sensing, Arm.of(plant), error)


def _window(material: Material, axis: int, recording: Recording, model: Real | None, order: int, panels: style.Panels) -> None:
    top, middle, rest, bottom = panels
    window = material.window_rps(axis, order)
    top.set_title(f"k = {order}" + ("" if window is None else f": {window[0]:.3g} to {window[1]:.3g} rev/s"))
    inside = judged_samples(material, recording, axis, order)
    style.stack_over_time(top, middle, rest)
    bottom.set_xlabel("Frequency (Hz)")
    bottom.set_xlim(0.0, 30.0)
    if len(inside) < FEWEST:
        for panel in panels:
            style.note(panel, "no model: not judged" if window is None else "the run did not reach these speeds")
        return
    time, tip = recording.time_s, recording.felt_m_s2
    margin = round(0.3 / recording.period_s)
    rows = slice(max(0, inside[0] - margin), inside[-1] + margin)
    begin, end = float(time[inside[0]]), float(time[inside[-1]])
    for panel in (top, middle, rest):
        panel.axvspan(begin, end, color=style.SHADE, zorder=0)
        panel.set_xlim(float(time[rows][0]), float(time[rows][-1]))
    top.plot(*style.thin(time[rows], np.abs(motor_speed_rps(recording, axis)[rows])), **style.BROAD)
    middle.plot(*style.thin(time[rows], tip[rows]), label=material.word, **style.BROAD)
    if model is not None:
        middle.plot(*style.thin(time[rows], model[rows]), label="model", **style.MODEL)
        style.residual(rest, time[rows], tip[rows] - model[rows], "m/s²", f"{material.word} − model")
    else:
        style.note(rest, "no model to compare with")
    f_al = material.f_al(axis)
    if f_al is not None:
        centre, limit = float(np.mean(tip[inside])), limit_m_s2(material, f_al)
        for sign, name in ((1.0, f"±{material.bench.specification.tip_mm:g} mm equivalent"), (-1.0, None)):
            middle.axhline(centre + sign * limit, label=name, **style.LIMIT)
    for values, look in ((tip, style.BROAD), (model, style.MODEL)):
        if values is not None:
            bottom.plot(*smooth_spectrum(values[inside], recording.period_s, 30.0), **look)
