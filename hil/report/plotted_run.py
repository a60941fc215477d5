"""Runs in figures: vibration over time, specification, and spectrum."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from hil.analysis import band_passed, line_window_s, motor_speed_rps, speed_window
from hil.control.arrays import Real
from hil.design.transmission_error import TransmissionError
from hil.recording import Recording
from hil.report import style
from hil.report.material import Material, finite, treatment_name
from hil.results.runs import RunEntry
from hil.tip_vector import steady_window_s, tip_acceleration

Rows = slice | NDArray[np.bool_] | NDArray[np.int_]

SHADED_ORDER = 2
"""Order whose window is shaded in figures, and whose numbers stand in their legends."""
FEWEST = 16
"""Least number of samples in a window that was reached, as in the analysis."""


@dataclass(frozen=True)
class PlottedRun:
    """A run in a figure: entry, recording, label and line style."""

    entry: RunEntry
    recording: Recording
    label: str
    look: style.Line


def plotted_run(material: Material, run: RunEntry | None, label: str, look: style.Line) -> PlottedRun | None:
    """Return a run to draw, marked if stopped; None without recording."""
    recording = material.recording(run)
    if run is None or recording is None:
        return None
    return PlottedRun(run, recording, label + (" (stopped early)" if run.stopped else ""), look)


def shown_runs(material: Material, experiment: str, axis: int | None) -> list[list[PlottedRun]]:
    """Return the runs of an experiment in groups of one diagram each.

    The untreated run comes first in a group, then as many treated runs as there are line styles. Host-closed runs have groups of
    their own if one of their treatments was not run in the drives.
    """
    groups: list[list[PlottedRun]] = []
    seen: set[str] = set()
    for loop in ("drive", "host"):
        entries = [run for run in material.result.runs if (run.experiment, run.axis, run.loop) == (experiment, axis, loop)]
        shown: dict[str, RunEntry] = {}
        for run in entries:
            if run.treatment not in shown or run.order == SHADED_ORDER:
                shown[run.treatment] = run
        plain = plotted_run(material, shown.pop("none", None), _label("none", shown), style.WITHOUT)
        treated = [run for run in shown.values() if material.recording(run) is not None]
        if seen >= {run.treatment for run in treated} and groups:
            continue
        seen |= {run.treatment for run in treated}
        size, behind = len(style.OVERLAY_LINES) - 1, [] if plain is None else [plain]
        for start in range(0, max(1, len(treated)), size):
            looks = zip(treated[start : start + size], style.OVERLAY_LINES[1:], strict=False)
            drawn = [plotted_run(material, run, _label(run.treatment, shown), look) for run, look in looks]
            group = [*behind, *(run for run in drawn if run is not None)]
            groups += [group] if group else []
    return groups


def _label(name: str, others: Mapping[str, RunEntry]) -> str:
    """Label of a run with a treatment beside others."""
    if set(others) <= {"none", "notch"} and "notch" in {name, *others}:
        return {"none": "without notch", "notch": "with notch"}[name]
    return treatment_name(name)


def key_end(number: int) -> str:
    """Return the end of the key of a figure's n-th part."""
    return f"-part{number + 1}" if number else ""


def title_end(number: int) -> str:
    """Return the end of the title of a figure's n-th part."""
    return f", part {number + 1}" if number else ""


def what_acted(runs: list[PlottedRun]) -> str:
    """Return treatments for a title: `with and without the notch`."""
    names = [run.entry.treatment for run in runs if run.entry.treatment != "none"]
    if not names:
        return ""
    article = {"notch": "the notch"}
    words = " and ".join(article.get(name, treatment_name(name)) for name in names)
    return f" with {'and without ' if len(names) < len(runs) else ''}{words}"


def draw_vibration(panel: Axes, run: PlottedRun, band_hz: tuple[float, float], *, with_peak: bool = True) -> None:
    """Draw the band-passed vertical acceleration over time."""
    vibration = band_passed(shown_acceleration(run), run.recording.period_s, band_hz)
    label = run.label + (number_or_nothing(run.entry.tip_peak_mm, ": peak {:.3f} mm") if with_peak else "")
    style.plot_thin(panel, run.recording.time_s, vibration, label=label, **run.look)


def shown_acceleration(run: PlottedRun) -> Real:
    """Return the tip's acceleration by which a run is judged; shape (n,).

    For an arm's line it is the component along the worst direction.
    """
    found = run.entry.directions
    unit = None if found is None or run.entry.axis is not None else found["worst"].unit
    return run.recording.felt_m_s2 if unit is None else np.asarray(tip_acceleration(run.recording) @ np.array(unit))


def direction_words(material: Material, axis: int | None) -> str:
    """Direction of `shown_acceleration`, in words."""
    if material.bench.arm is None:
        return "vertical tip acceleration"
    return "tip acceleration along the axis' lever" if axis is not None else "tip acceleration along each run's worst direction"


def finish_vibration(
    material: Material, panel: Axes, f_al: float | None, *, with_name: bool = True, with_scale: bool = True
) -> float:
    """Draw labels, the limit, and the displacement scale on the right.

    `f_al` is in Hz, None without a model.

    Returns:
        The largest value between the panel's times, m/s².
    """
    panel.set_xlabel("Time (s)")
    if with_name:
        panel.set_ylabel("Tip acceleration, band-passed (m/s²)")
    reach = max(map(_within, [panel] * len(panel.get_lines()), panel.get_lines()), default=0.0)
    if f_al is not None:
        limit = limit_m_s2(material, f_al)
        reach = max(reach, limit)
        for sign, name in ((1.0, f"specification ±{material.bench.specification.tip_mm:g} mm"), (-1.0, None)):
            panel.axhline(sign * limit, label=name, **style.LIMIT)
        if with_scale:
            displacement_scale(panel, f_al, "Equivalent displacement (mm)")
    if reach > 0.0:
        panel.set_ylim(-1.08 * reach, 1.08 * reach)
    return reach


def displacement_scale(panel: Axes, f_al: float, name: str = "mm") -> None:
    """Draw the scale of displacement on the right."""
    scale = 1e3 / (2.0 * math.pi * f_al) ** 2
    right = panel.secondary_yaxis("right", functions=(lambda a: np.asarray(a) * scale, lambda d: np.asarray(d) / scale))
    right.set_ylabel(name)


def _within(panel: Axes, line: Line2D) -> float:
    """Return the largest |y| of a line between the panel's x limits."""
    x, y = (np.asarray(values, dtype=np.float64) for values in line.get_data())
    low, high = panel.get_xlim()
    shown = (x >= low) & (x <= high)
    return float(np.max(np.abs(y[shown]))) if len(x) > 2 and shown.any() else 0.0


def shade_speeds(material: Material, axis: int, recording: Recording, panel: Axes, *, with_names: bool = True) -> None:
    """Shade the judged window, and mark the notch's switching speeds."""
    time = recording.time_s
    inside = judged_samples(material, recording, axis)
    if len(inside):
        panel.axvspan(float(time[inside[0]]), float(time[inside[-1]]), color=style.SHADE, zorder=0)
    acting = material.acting(axis)
    if acting is None or not with_names:
        return
    notches = acting.notches[axis]
    speed = np.abs(motor_speed_rps(recording, axis))
    for value, name in ((notches[0].start_rps, "$f_s$"), (notches[0].end_rps, "$f_e$")):
        reached = np.flatnonzero(speed >= value)
        if len(reached):
            style.flag(panel, float(time[reached[0]]), f"{name} = {value:g} rev/s", side="right")


def judged_samples(material: Material, recording: Recording, axis: int, order: int = SHADED_ORDER) -> NDArray[np.int_]:
    """Return the samples in which an order is judged; shape (n,)."""
    window = material.window_rps(axis, order)
    return np.flatnonzero(speed_window(recording, axis, window)) if window is not None else np.zeros(0, dtype=np.int_)


def shade_judged(material: Material, panel: Axes, axis: int | None, recording: Recording) -> None:
    """Shade what is judged: a window of speeds, or times of the line motion (None)."""
    if axis is None:
        shade_line(material, panel, recording)
    else:
        shade_speeds(material, axis, recording, panel, with_names=False)


def window_words(material: Material, axis: int | None) -> str:
    """Sentence on the shaded speeds, or on the times of the line motion (None)."""
    if axis is None:
        return f"Shaded: {line_words(material)}, in which it is judged."
    window = material.window_rps(axis, SHADED_ORDER)
    if window is None:
        return "Nothing is shaded: the run is not judged."
    return f"Shaded: {window[0]:.3g} to {window[1]:.3g} rev/s, where the second harmonic crosses the resonance."


def judged_line_s(material: Material) -> tuple[float, float]:
    """Return the line's judged part, in s after the motion's start."""
    motion = material.bench.line_motion
    if motion is None:
        return 0.0, 0.0
    return line_window_s(motion.duration_s) if material.bench.arm is None else steady_window_s(motion.duration_s, motion.ramp_s)


def line_words(material: Material) -> str:
    """Times of the line motion that are judged, in words."""
    begin, end = judged_line_s(material)
    return f"{begin:.3g} to {end:.3g} s after the start"


def shade_line(material: Material, panel: Axes, recording: Recording) -> None:
    """Shade the judged times of the line motion."""
    motion = material.bench.line_motion
    if motion is not None and material.scale(None) is not None:
        start = float(recording.time_s[0]) + motion.dwell_s
        begin, end = judged_line_s(material)
        panel.axvspan(start + begin, start + end, color=style.SHADE, zorder=0)


def limit_m_s2(material: Material, f_al: float) -> float:
    """Specification as an acceleration in m/s²: A_acc (2π f_al)²."""
    return 1e-3 * material.bench.specification.tip_mm * (2.0 * math.pi * f_al) ** 2


def limit_words(material: Material, axis: int, where: str = "") -> str:
    """Return a sentence on the dotted lines of the specification."""
    f_al = material.f_al(axis)
    if f_al is None:
        return "Without f_al the specification cannot be converted to an acceleration."
    limit = limit_m_s2(material, f_al)
    return (
        f"Dotted: the specification of ±{material.bench.specification.tip_mm:g} mm as an acceleration, ±{limit:.3f} m/s²{where}."
    )


def smooth_spectrum(values: Real, period_s: float, up_to_hz: float) -> tuple[Real, Real]:
    """Return frequencies and Hann amplitude spectrum of values without their mean.

    The values have the shape (n,) and are zero-padded; the results have the shape (m,).
    """
    weights = scipy.signal.get_window("hann", len(values))
    length = scipy.fft.next_fast_len(8 * len(values), real=True)
    amplitude = 2.0 * np.abs(scipy.fft.rfft((values - np.mean(values)) * weights, length)) / float(np.sum(weights))
    frequency = scipy.fft.rfftfreq(length, period_s)
    shown = frequency <= up_to_hz
    return frequency[shown], amplitude[shown]


def passage_panels(count: int, signal: str, unit: str) -> tuple[Figure, style.Panels]:
    """Make a figure of passages through resonant speeds: speed, signal, residual and spectrum of each in a column."""
    figure, panels = style.panels(4, count, 5.9, height_ratios=(3, 5, 3, 4), sharey="row")
    style.name_rows(panels, "Speed (rev/s)", f"{signal} ({unit})", f"Residual ({unit})", f"Amplitude ({unit})")
    return figure, panels


def draw_passage(
    panels: style.Panels, passage: tuple[Real, Real, Real, Real | None], shown: Rows, judged: Rows, unit: str, word: str
) -> None:
    """Draw a passage through a resonant speed in its column.

    `passage` has time, |f_m|, signal and its model, each of shape (n,); `shown` and `judged` choose their rows, for the spectrum
    the latter. `word` names the signal, in `unit`.
    """
    time, speed, signal, model = passage
    top, middle, rest, bottom = panels
    style.plot_thin(top, time[shown], speed[shown], **style.BROAD)
    style.plot_thin(middle, time[shown], signal[shown], label=word, **style.BROAD)
    if model is not None:
        style.plot_thin(middle, time[shown], model[shown], label="model", **style.MODEL)
        style.residual(rest, time[shown], signal[shown] - model[shown], unit, f"{word} − model")
    for values, look in ((signal, style.BROAD), (model, style.MODEL)):
        if values is not None:
            bottom.plot(*smooth_spectrum(values[judged], float(time[1] - time[0]), 30.0), **look)
    name_passage(panels)


def name_passage(panels: style.Panels) -> None:
    """Name the abscissae of a passage's column."""
    style.stack_over_time(*panels[:3])
    panels[3].set(xlabel="Frequency (Hz)", xlim=(0.0, 30.0))


def spread_arcsec(
    error: TransmissionError, amplitude_error_arcsec: Mapping[float, float], phase_error_deg: Mapping[float, float], turns: Real
) -> Real:
    """Return two standard errors of θ_sync in arcsec from those of A_k and φ_k; shape (n,) of the motor's turns."""
    variance = np.zeros_like(turns)
    for order, amplitude in error.amplitude_arcsec.items():
        phase = 2.0 * math.pi * order * turns + math.radians(error.phase_deg[order])
        variance += (amplitude_error_arcsec.get(order, 0.0) * np.cos(phase)) ** 2
        variance += (amplitude * math.radians(phase_error_deg.get(order, 0.0)) * np.sin(phase)) ** 2
    return np.asarray(2.0 * np.sqrt(variance))


def number_or_nothing(value: float | None, form: str) -> str:
    """Number in its format, or an empty text."""
    return form.format(value) if finite(value) else ""
