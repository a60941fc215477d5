"""Figures of what the robot did: the paper's Figs. 7, 8, 13, 14 and 15, and the two places of the loop side by side."""

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from scipy import fft, signal

from hil.analysis import LINE_WINDOW_S, TIP_BAND_HZ, WINDOWS_RPS, amplitude_spectrum, motor_speed_rps, speed_window
from hil.design.transmission_error import arm_response
from hil.recording import Recording
from hil.report import style
from hil.report.material import CONSTANT_ACCELERATION, LINE_MOTION, Material, Run, finite
from hil.report.style import Drawing, Real

FEWEST = 16
"""Samples in a window below which it counts as not reached; as in the analysis."""


@dataclass(frozen=True)
class Trace:
    """A run that is drawn: what it is called, how it looks, what it recorded."""

    run: Run
    recording: Recording
    label: str
    look: style.Line


def identification(material: Material, axis: int) -> Drawing | None:
    """Speed, tip acceleration and its spectrum in both windows, measured and modelled; Figs. 7 and 8."""
    run = material.find(CONSTANT_ACCELERATION, axis, "none", "drive") or material.find(CONSTANT_ACCELERATION, axis, "none", "host")
    recording = material.recording(run)
    if run is None or recording is None:
        return None
    model = _modelled(material, axis, recording)
    figure, panels = style.panels(3, 2, 5.9, height_ratios=(2, 3, 3), sharey="row")
    for column, order in enumerate((2, 4)):
        _window(material, axis, recording, model, order, panels[:, column])
    panels[0, 0].set_ylabel("Motor speed (rev/s)")
    panels[1, 0].set_ylabel("Tip acceleration (m/s²)")
    panels[2, 0].set_ylabel("Amplitude (m/s²)")
    style.legend_above(figure, panels[1, 0])
    paper = {2: "Fig. 7", 3: "Fig. 8"}.get(axis, "as Figs. 7 and 8")
    computed = (
        " Broken: what the arm on its gear does, computed from the motor angle as measured and the bench file's θ_sync."
        if model is not None
        else " The axis has no model to compare with."
    )
    limit = _limit_words(material, axis)
    return Drawing(
        f"identification-{axis}", f"Axis {axis} through its resonant speeds, without notch", paper,
        "measured" if model is None else "measured and computed",
        "Constant acceleration of one motor. Top: its speed; shaded: the speeds in which the run is judged. Middle: vertical "
        f"acceleration of the tip, as the sensor gave it.{computed} {limit}, around the mean. Bottom: amplitude spectrum of the shaded "
        "part (Hann window, interpolated between its bins, mean removed).",
        style.to_svg(figure, f"identification-{axis}"),
    )  # fmt: skip


def _modelled(material: Material, axis: int, recording: Recording) -> Real | None:
    error = material.transmission_error(axis)
    if error is None:
        return None
    lever = material.bench.axis[axis].tip_lever_m
    return arm_response(material.loop(axis).plant, recording.axis(axis, "position_rad"), recording.period_s, lever, error)


def _window(
    material: Material, axis: int, recording: Recording, model: Real | None, order: int, panels: style.Panels
) -> None:
    top, middle, bottom = panels
    low, high = WINDOWS_RPS[order]
    top.set_title(f"k = {order}: {low:g} to {high:g} rev/s")
    inside = np.flatnonzero(speed_window(recording, axis, order))
    for panel in (top, middle):
        panel.set_xlabel("Time (s)")
    bottom.set_xlabel("Frequency (Hz)")
    bottom.set_xlim(0.0, 30.0)
    if len(inside) < FEWEST:
        note(panels, "the run did not reach these speeds")
        return
    time, tip = recording.time_s, recording.columns["tip_z_m_s2"]
    margin = round(0.3 / recording.period_s)
    rows = slice(max(0, inside[0] - margin), inside[-1] + margin)
    begin, end = float(time[inside[0]]), float(time[inside[-1]])
    for panel in (top, middle):
        panel.axvspan(begin, end, color=style.SHADE, zorder=0)
        panel.set_xlim(float(time[rows][0]), float(time[rows][-1]))
    top.plot(*style.thin(time[rows], np.abs(motor_speed_rps(recording, axis)[rows])), **style.MEASURED)
    middle.plot(*style.thin(time[rows], tip[rows]), label="measured", **style.MEASURED)
    if model is not None:
        middle.plot(*style.thin(time[rows], model[rows]), label="model", **style.MODEL)
    if axis in material.f_al_hz:
        centre, limit = float(np.mean(tip[inside])), _limit(material, material.f_al_hz[axis])
        for sign, name in ((1.0, f"±{material.bench.specification.tip_mm:g} mm equivalent"), (-1.0, None)):
            middle.axhline(centre + sign * limit, label=name, **style.LIMIT)
    for values, look in ((tip, style.MEASURED), (model, style.MODEL)):
        if values is not None:
            bottom.plot(*_smooth_spectrum(values[inside], recording.period_s, 30.0), **look)
    bottom.set_ylim(0.0, None)


def note(panels: style.Panels, text: str) -> None:
    """The same sentence in every panel."""
    for panel in panels:
        style.note(panel, text)


def suppression(material: Material, axis: int) -> Drawing | None:
    """Tip vibration and its spectrum with and without the notch, drive-closed; Figs. 13 and 14."""
    traces = _pair(material, CONSTANT_ACCELERATION, axis)
    if not traces:
        return None
    figure, panels = style.panels(2, 1, 5.0, height_ratios=(3, 2))
    top, bottom = panels[:, 0]
    f_al = material.f_al_hz.get(axis)
    for trace in traces:
        _vibration(top, trace)
        inside = np.flatnonzero(speed_window(trace.recording, axis, 2))
        if len(inside) >= FEWEST:
            tip = trace.recording.columns["tip_z_m_s2"][inside]
            label = trace.label + _number(trace.run.spectrum_peak_m_s2, ": peak {:.3f} m/s²")
            bottom.plot(*_smooth_spectrum(tip, trace.recording.period_s, 30.0), label=label, **trace.look)
    recording = traces[-1].recording
    _shade_speeds(material, axis, recording, top)
    _finish_vibration(material, top, f_al)
    top.set_xlim(float(recording.time_s[0]), _end_of_ramp(recording, axis))
    bottom.set(xlabel="Frequency (Hz)", ylabel="Amplitude (m/s²)", xlim=(0.0, 30.0))
    bottom.set_ylim(0.0, None)
    _inner_legend(bottom)
    style.legend_above(figure, top)
    paper = {2: "Fig. 13", 3: "Fig. 14"}.get(axis, "as Figs. 13 and 14")
    return Drawing(
        f"suppression-{axis}", f"Axis {axis}: tip vibration with and without the notch", paper, "measured",
        f"Vertical tip acceleration of the constant-acceleration runs, band-passed {TIP_BAND_HZ[0]:g} to {TIP_BAND_HZ[1]:g} Hz without phase, "
        "which is what the run is judged by; the scale on the right is the same as a displacement, divided by (2π f_al)². Shaded: "
        f"{WINDOWS_RPS[2][0]:g} to {WINDOWS_RPS[2][1]:g} rev/s, where the second harmonic crosses the resonance. {_limit_words(material, axis)}. "
        f"Below: Hann spectrum of the shaded part.{_change(material, CONSTANT_ACCELERATION, axis)}",
        style.to_svg(figure, f"suppression-{axis}"),
    )  # fmt: skip


def line_motion(material: Material) -> Drawing | None:
    """Tip vibration on the line and its spectrum up to 50 Hz, with and without the notch; Fig. 15."""
    traces = _pair(material, LINE_MOTION, None)
    if not traces:
        return None
    figure, panels = style.panels(2, 1, 5.0, height_ratios=(3, 2))
    top, bottom = panels[:, 0]
    motion = material.bench.line_motion
    for trace in traces:
        time = trace.recording.time_s
        begin = time[0] + (0.0 if motion is None else motion.dwell_s)
        end = time[-1] if motion is None else begin + motion.duration_s
        _vibration(top, trace)
        moving = (time >= begin) & (time <= end)
        frequency, amplitude = amplitude_spectrum(trace.recording.columns["tip_z_m_s2"][moving], trace.recording.period_s, "boxcar")
        shown = frequency <= 50.0
        label = trace.label + _number(trace.run.spectrum_area, ": area {:.3f} m/s²·Hz")
        bottom.plot(frequency[shown], amplitude[shown], label=label, **trace.look)
    time = traces[-1].recording.time_s
    begin = float(time[0]) + (0.0 if motion is None else motion.dwell_s)
    top.axvspan(begin + LINE_WINDOW_S[0], begin + LINE_WINDOW_S[1], color=style.SHADE, zorder=0)
    top.set_xlim(float(time[0]), float(time[-1]))
    _finish_vibration(material, top, material.line_f_al_hz)
    bottom.set(xlabel="Frequency (Hz)", ylabel="Amplitude (m/s²)", xlim=(0.0, 50.0))
    bottom.set_ylim(0.0, None)
    _inner_legend(bottom)
    style.legend_above(figure, top)
    return Drawing(
        "line-motion", "Line motion: tip vibration with and without the notch", "Fig. 15", "measured",
        f"Straight line of the tip with axes 2, 3 and 5. Above: vertical acceleration, band-passed {TIP_BAND_HZ[0]:g} to {TIP_BAND_HZ[1]:g} Hz "
        f"without phase; shaded: {LINE_WINDOW_S[0]:g} to {LINE_WINDOW_S[1]:g} s after the start, in which it is judged. Below: amplitude "
        "spectrum of the unfiltered acceleration over the whole motion (rectangular window); its area from 0 to 50 Hz is compared. "
        f"The paper has −26 %.{_change(material, LINE_MOTION, None)}",
        style.to_svg(figure, "line-motion"),
    )  # fmt: skip


def loop_places(material: Material, axis: int) -> Drawing | None:
    """The loop closed in the drive and on the host, without and with the notch."""
    pairs = {}
    for compensation in ("none", "notch"):
        traces = [
            _trace(material, material.find(CONSTANT_ACCELERATION, axis, compensation, "drive"), "closed in the drive", style.WITHOUT),
            _trace(material, material.find(CONSTANT_ACCELERATION, axis, compensation, "host"), "closed on the host, over the bus", style.WITH),
        ]
        pairs[compensation] = [trace for trace in traces if trace is not None]
    pairs = {name: traces for name, traces in pairs.items() if any(trace.run.loop == "host" for trace in traces)}
    if not pairs:
        return None
    figure, panels = style.panels(2, len(pairs), 4.6, height_ratios=(3, 2), sharey="row")
    for column, (compensation, traces) in enumerate(pairs.items()):
        top, bottom = panels[:, column]
        for trace in traces:
            _vibration(top, trace)
            inside = np.flatnonzero(speed_window(trace.recording, axis, 2))
            if len(inside) >= FEWEST:
                tip = trace.recording.columns["tip_z_m_s2"][inside]
                bottom.plot(*_smooth_spectrum(tip, trace.recording.period_s, 30.0), **trace.look)
        recording = traces[-1].recording
        _shade_speeds(material, axis, recording, top, with_names=False)
        last = column == len(pairs) - 1
        _finish_vibration(material, top, material.f_al_hz.get(axis), with_name=column == 0, with_scale=last)
        inside = np.flatnonzero(speed_window(recording, axis, 2))
        if len(inside) >= FEWEST:
            top.set_xlim(float(recording.time_s[inside[0]]) - 0.25, float(recording.time_s[inside[-1]]) + 0.25)
        top.set_title("Without notch" if compensation == "none" else "With notch")
        bottom.set(xlabel="Frequency (Hz)", xlim=(0.0, 30.0))
    panels[1, 0].set_ylabel("Amplitude (m/s²)")
    panels[1, 0].set_ylim(0.0, None)
    style.legend_above(figure, panels[0, 0])
    return Drawing(
        f"loop-places-{axis}", f"Axis {axis}: the loop in the drive and on the host", "", "measured",
        "The same law in two places: inside the drive, with set-points over the bus, and on the host, with torque over the bus in every "
        f"period of the loop. {_periods(pairs)} Band-passed tip acceleration around the k = 2 window (shaded) and its Hann spectrum there.",
        style.to_svg(figure, f"loop-places-{axis}"),
    )  # fmt: skip


def _periods(pairs: dict[str, list[Trace]]) -> str:
    runs = {trace.run.loop: trace.run for traces in pairs.values() for trace in traces}
    said = [f"{loop}-closed: {1e3 * run.sync_period_s:g} ms" for loop, run in runs.items() if run.sync_period_s]
    return f"SYNC period {', '.join(said)}." if said else ""


def _pair(material: Material, experiment: str, axis: int | None) -> list[Trace]:
    """The runs without and with the notch, as far as they are there; drive-closed before host-closed."""
    for loop in ("drive", "host"):
        traces = [
            _trace(material, material.find(experiment, axis, "none", loop), "without notch", style.WITHOUT),
            _trace(material, material.find(experiment, axis, "notch", loop), "with notch", style.WITH),
        ]
        found = [trace for trace in traces if trace is not None]
        if found:
            return found
    return []


def _trace(material: Material, run: Run | None, label: str, look: style.Line) -> Trace | None:
    recording = material.recording(run)
    if run is None or recording is None:
        return None
    return Trace(run, recording, label + (" (stopped early)" if run.stopped else ""), look)


def _vibration(panel: Axes, trace: Trace) -> None:
    """The band-passed vertical acceleration over time."""
    period = trace.recording.period_s
    band = signal.butter(2, TIP_BAND_HZ, "bandpass", fs=1.0 / period, output="sos")
    vibration = signal.sosfiltfilt(band, trace.recording.columns["tip_z_m_s2"])
    label = trace.label + _number(trace.run.tip_peak_mm, ": peak {:.3f} mm")
    panel.plot(*style.thin(trace.recording.time_s, vibration), label=label, **trace.look)


def _finish_vibration(material: Material, panel: Axes, f_al: float | None, *, with_name: bool = True, with_scale: bool = True) -> None:
    """Labels, the limit, and the displacement scale on the right."""
    panel.set_xlabel("Time (s)")
    if with_name:
        panel.set_ylabel("Tip acceleration, band-passed (m/s²)")
    reach = max((float(np.max(np.abs(np.asarray(line.get_ydata(), dtype=np.float64)))) for line in panel.get_lines()), default=0.0)
    if f_al is not None:
        limit = _limit(material, f_al)
        reach = max(reach, limit)
        for sign, name in ((1.0, f"specification ±{material.bench.specification.tip_mm:g} mm"), (-1.0, None)):
            panel.axhline(sign * limit, label=name, **style.LIMIT)
        if with_scale:
            scale = 1e3 / (2.0 * math.pi * f_al) ** 2
            right = panel.secondary_yaxis("right", functions=(lambda a: a * scale, lambda d: d / scale))
            right.set_ylabel("Equivalent displacement (mm)")
    if reach > 0.0:
        panel.set_ylim(-1.08 * reach, 1.08 * reach)


def _shade_speeds(material: Material, axis: int, recording: Recording, panel: Axes, *, with_names: bool = True) -> None:
    """The judged window, and where the notch goes in and out."""
    time = recording.time_s
    inside = np.flatnonzero(speed_window(recording, axis, 2))
    if len(inside):
        panel.axvspan(float(time[inside[0]]), float(time[inside[-1]]), color=style.SHADE, zorder=0)
    notches = material.bench.axis[axis].notch if axis in material.bench.axis else ()
    if not notches or not with_names:
        return
    speed = np.abs(motor_speed_rps(recording, axis))
    for value, name in ((notches[0].start_rps, "$f_s$"), (notches[0].end_rps, "$f_e$")):
        reached = np.flatnonzero(speed >= value)
        if len(reached):
            style.flag(panel, float(time[reached[0]]), f"{name} = {value:g} rev/s", side="right" if name == "$f_s$" else "left")


def _end_of_ramp(recording: Recording, axis: int) -> float:
    speed = np.abs(motor_speed_rps(recording, axis))
    return float(recording.time_s[max(FEWEST, int(np.argmax(speed)))])


def _limit(material: Material, f_al: float) -> float:
    """The specification as an acceleration in m/s²: A_acc (2π f_al)²."""
    return 1e-3 * material.bench.specification.tip_mm * (2.0 * math.pi * f_al) ** 2


def _limit_words(material: Material, axis: int) -> str:
    if axis not in material.f_al_hz:
        return "No model, hence no equivalent of the limit"
    limit = _limit(material, material.f_al_hz[axis])
    return f"Dotted: the specification of ±{material.bench.specification.tip_mm:g} mm as an acceleration, ±{limit:.3f} m/s²"


def _smooth_spectrum(values: Real, period_s: float, up_to_hz: float) -> tuple[Real, Real]:
    """The Hann amplitude spectrum without the mean, interpolated between its bins by zeros behind the samples."""
    weights = signal.get_window("hann", len(values))
    length = fft.next_fast_len(8 * len(values), real=True)
    amplitude = 2.0 * np.abs(fft.rfft((values - np.mean(values)) * weights, length)) / float(np.sum(weights))
    frequency = fft.rfftfreq(length, period_s)
    shown = frequency <= up_to_hz
    return frequency[shown], amplitude[shown]


def _inner_legend(panel: Axes) -> None:
    if panel.get_legend_handles_labels()[0]:
        panel.legend(loc="upper right")


def _number(value: float | None, form: str) -> str:
    return form.format(value) if finite(value) else ""


def _change(material: Material, experiment: str, axis: int | None) -> str:
    """The comparison in a sentence, where there is one."""
    found = material.comparison(experiment, axis)
    if found is None:
        return ""
    said = []
    if finite(found.tip_peak_reduction_pct):
        said.append(f"tip peak {-found.tip_peak_reduction_pct:+.0f} %")  # type: ignore[operator]
    if finite(found.spectrum_area_reduction_pct):
        said.append(f"spectrum area {-found.spectrum_area_reduction_pct:+.0f} %")  # type: ignore[operator]
    return f" With the notch: {', '.join(said)}.".replace("-", "−") if said else ""
