"""Figures of the treatments at work; Figs. 13, 14 and 15; of a cancellation that follows, amplitudes and phases."""

import itertools

import numpy as np
from matplotlib.axes import Axes

from hil.analysis import BRAKING_S, amplitude_spectrum, motor_speed_rps
from hil.experiments.motions import CONSTANT_ACCELERATION, LINE_MOTION
from hil.recording import Recording
from hil.report import plotted_run as plotted
from hil.report import style
from hil.report.material import Material, finite, run_name, treatment_name
from hil.report.style import Drawing


def suppression(material: Material, axis: int) -> list[Drawing]:
    """Draw tip vibration and spectrum of a ramp; Figs. 13 and 14."""
    groups = plotted.shown_runs(material, CONSTANT_ACCELERATION, axis)
    return [_ramp(material, axis, runs, f"suppression-{axis}{plotted.key_end(number)}") for number, runs in enumerate(groups)]


def _ramp(material: Material, axis: int, runs: list[plotted.PlottedRun], key: str) -> Drawing:
    figure, panels = style.panels(2, 1, 5.0, height_ratios=(3, 2))
    top, bottom = panels[:, 0]
    f_al = material.f_al(axis)
    for run in runs:
        plotted.draw_vibration(top, run, material.band_hz(axis))
        inside = plotted.judged_samples(material, run.recording, axis)
        if len(inside) >= plotted.FEWEST:
            tip = run.recording.felt_m_s2[inside]
            label = run.label + plotted.number_or_nothing(run.entry.spectrum_peak_m_s2, ": peak {:.3f} m/s²")
            bottom.plot(*plotted.smooth_spectrum(tip, run.recording.period_s, 30.0), label=label, **run.look)
    recording = runs[-1].recording
    plotted.shade_speeds(material, axis, recording, top)
    top.set_xlim(float(recording.time_s[0]), _end_of_ramp(recording, axis))
    plotted.finish_vibration(material, top, f_al)
    bottom.set(xlabel="Frequency (Hz)", ylabel="Amplitude (m/s²)", xlim=(0.0, 30.0), ylim=(0.0, None))
    _inner_legend(bottom)
    style.legend_above(figure, top)
    paper, band = {2: "Fig. 13", 3: "Fig. 14"}.get(axis, "as Figs. 13 and 14"), material.band_hz(axis)
    scale = "" if f_al is None else "; the scale on the right is the same as a displacement, divided by (2π f_al)²"
    caption = (
        f"{plotted.direction_words(material, axis).capitalize()} of the constant-acceleration runs, band-passed {band[0]:.3g} to "
        f"{band[1]:.3g} Hz with zero phase, "
        f"as the run is judged{scale}. {plotted.window_words(material, axis)} {plotted.limit_words(material, axis)} "
        "Below: Hann spectrum of the shaded part, interpolated between its bins (the numbers are those of the "
        f"bins).{_changes(material, runs)}"
    )
    title = f"Axis {axis}: tip vibration{plotted.what_acted(runs)}"
    return style.drawing(figure, key, title, caption, "measured", paper, is_zoomable=True)


def line_motion(material: Material) -> list[Drawing]:
    """Draw tip vibration and spectrum on the line; Fig. 15."""
    groups = plotted.shown_runs(material, LINE_MOTION, None)
    return [_line(material, runs, f"line-motion{plotted.key_end(number)}") for number, runs in enumerate(groups)]


def _line(material: Material, runs: list[plotted.PlottedRun], key: str) -> Drawing:
    figure, panels = style.panels(2, 1, 5.0, height_ratios=(3, 2))
    top, bottom = panels[:, 0]
    motion, band = material.bench.line_motion, material.band_hz(None)
    for run in runs:
        time = run.recording.time_s
        begin = time[0] + (0.0 if motion is None else motion.dwell_s)
        end = time[-1] if motion is None else begin + motion.duration_s
        plotted.draw_vibration(top, run, band)
        moving = (time >= begin) & (time <= end)
        frequency, amplitude = amplitude_spectrum(plotted.shown_acceleration(run)[moving], run.recording.period_s, "boxcar")
        shown = frequency <= 50.0
        label = run.label + plotted.number_or_nothing(run.entry.spectrum_area, ": area {:.3f} m/s²·Hz")
        bottom.plot(frequency[shown], amplitude[shown], label=label, **run.look)
    time = runs[-1].recording.time_s
    plotted.shade_line(material, top, runs[-1].recording)
    top.set_xlim(float(time[0]), float(time[-1]))
    plotted.finish_vibration(material, top, material.f_al(None))
    bottom.set(xlabel="Frequency (Hz)", ylabel="Amplitude (m/s²)", xlim=(0.0, 50.0), ylim=(0.0, None))
    _inner_legend(bottom)
    style.legend_above(figure, top)
    area = "its area from 0 to" if material.bench.arm is None else "the area of all directions together from 0.2 f_al to"
    caption = (
        f"Straight line of the tip with axes {', '.join(map(str, material.bench.chain_axes))}. Above: "
        f"{plotted.direction_words(material, None)}, band-passed {band[0]:.3g} to {band[1]:.3g} Hz with zero phase; shaded: "
        f"{plotted.line_words(material)}, in which it is judged. Below: amplitude spectrum of the unfiltered acceleration over "
        f"the whole motion (rectangular window); {area} 50 Hz is compared."
        f"{' The paper has −26 %.' if material.bench.is_paper else ''}{_changes(material, runs)}"
    )
    title = f"Line motion: tip vibration{plotted.what_acted(runs)}"
    return style.drawing(figure, key, title, caption, "measured", "Fig. 15", is_zoomable=True)


def loop_sides(material: Material, axis: int) -> Drawing | None:
    """Draw the tip for the loop in the drive and host-closed."""
    looks = (("drive", "closed in the drive", style.BROAD), ("host", "closed on the host, over the bus", style.OTHER_LOOP))
    pairs: dict[str, list[plotted.PlottedRun]] = {}
    for treatment in ("none", "notch"):
        drawn = [
            plotted.plotted_run(material, material.find(CONSTANT_ACCELERATION, axis, treatment, loop), label, look)
            for loop, label, look in looks
        ]
        runs = [run for run in drawn if run is not None]
        if any(run.entry.loop == "host" for run in runs):
            pairs[treatment] = runs
    if not pairs:
        return None
    figure, panels = style.panels(2, len(pairs), 4.6, height_ratios=(3, 2), sharey="row")
    reach = 0.0
    for column, (treatment, runs) in enumerate(pairs.items()):
        top, bottom = panels[:, column]
        for run in runs:
            plotted.draw_vibration(top, run, material.band_hz(axis), with_peak=False)
            inside = plotted.judged_samples(material, run.recording, axis)
            if len(inside) >= plotted.FEWEST:
                tip = run.recording.felt_m_s2[inside]
                bottom.plot(*plotted.smooth_spectrum(tip, run.recording.period_s, 30.0), **run.look)
        recording = runs[-1].recording
        plotted.shade_speeds(material, axis, recording, top, with_names=False)
        last = column == len(pairs) - 1
        inside = plotted.judged_samples(material, recording, axis)
        if len(inside) >= plotted.FEWEST:
            top.set_xlim(float(recording.time_s[inside[0]]) - 0.25, float(recording.time_s[inside[-1]]) + 0.25)
        reach = max(reach, plotted.finish_vibration(material, top, material.f_al(axis), with_name=column == 0, with_scale=last))
        tips = [plotted.number_or_nothing(run.entry.tip_peak_mm, run.entry.loop + " {:.3f} mm") for run in runs]
        title = "Without notch" if treatment == "none" else "With notch"
        top.set_title(": ".join(filter(None, (title, ", ".join(filter(None, tips))))))
        bottom.set(xlabel="Frequency (Hz)", xlim=(0.0, 30.0))
    if reach > 0.0:
        panels[0, 0].set_ylim(-1.08 * reach, 1.08 * reach)
    panels[1, 0].set(ylabel="Amplitude (m/s²)", ylim=(0.0, None))
    style.legend_above(figure, panels[0, 0])
    caption = (
        "The same law in two places: inside the drive, with set-points over the bus, and on the host, with torque "
        "over the bus in every "
        f"period of the loop. {_periods(pairs)} Band-passed tip acceleration around the k = 2 window (shaded) and "
        f"its Hann spectrum there."
    )
    title = f"Axis {axis}: the loop in the drive and on the host"
    return style.drawing(figure, f"loop-places-{axis}", title, caption, is_zoomable=True)


def _periods(pairs: dict[str, list[plotted.PlottedRun]]) -> str:
    runs = {run.entry.loop: run.entry for runs in pairs.values() for run in runs}
    parts = [f"{loop}-closed: {1e3 * run.sync_period_s:g} ms" for loop, run in runs.items() if run.sync_period_s]
    return f"SYNC period {', '.join(parts)}." if parts else ""


def _end_of_ramp(recording: Recording, axis: int) -> float:
    speed = np.abs(motor_speed_rps(recording, axis))
    # the filter without phase shows the braking's jerk a little before it happens
    before = round(BRAKING_S / recording.period_s)
    return float(recording.time_s[max(plotted.FEWEST, int(np.argmax(speed)) - before)])


def _inner_legend(panel: Axes) -> None:
    if panel.get_legend_handles_labels()[0]:
        panel.legend(loc="upper right")


def _changes(material: Material, runs: list[plotted.PlottedRun]) -> str:
    """Return a sentence on each comparison of the drawn runs."""
    found = {(each.experiment, each.axis, each.loop, each.treatment): each for each in material.result.comparisons}
    words = ""
    for run in (each.entry for each in runs if each.entry.treatment != "none"):
        comparison = found.get((run.experiment, run.axis, run.loop, run.treatment))
        pairs = () if comparison is None else (
            ("tip peak", comparison.tip_peak_reduction_pct), ("spectrum area", comparison.spectrum_area_reduction_pct),
        )  # fmt: skip
        parts = [f"{what} {-percent:+.0f} %" for what, percent in pairs if finite(percent)]
        name = "the notch" if run.treatment == "notch" else treatment_name(run.treatment)
        words += f" With {name}: {', '.join(parts)}.".replace("-", "−") if parts else ""
    return words


def following(material: Material) -> Drawing | None:
    """Draw amplitude factor and phase shift of each order over the motion."""
    runs = {run.recording: run for run in material.result.runs if run.following is not None and run.following.orders}
    if not runs:
        return None
    run = next(iter(runs.values()))
    orders = () if run.following is None else run.following.orders
    figure, panels = style.panels(2, 1, 3.2, sharex=True)
    top, bottom = panels[:, 0]
    for each, look in zip(orders, itertools.cycle(style.AXIS_LINES)):
        name = f"axis {each.axis}, order {each.order:g}"
        top.plot(each.time_s, [size / each.amplitude_start_arcsec for size in each.amplitude_arcsec], label=name, **look)
        bottom.plot(each.time_s, [phase - each.phase_deg[0] for phase in each.phase_deg], label=name, **look)
    top.set_ylabel("Factor of A")
    bottom.set(xlabel="Time (s)", ylabel="Change of φ (°)")
    style.legend_above(figure, top)
    caption = (
        "Amplitude and phase of each cancelled order, relative to the identified ones. They are held at rest, while the "
        "motion's own jerks shake the tip, and while an order does not exceed the sensor's noise. "
        + " ".join(f"{each.words}." for each in orders)
    )
    title = f"{run_name(run, with_window=False)}: amplitude and phase as the cancellation followed them"
    return style.drawing(figure, "following", title, caption)
