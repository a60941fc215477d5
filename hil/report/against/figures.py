"""Figures with two results in one diagram."""

import numpy as np
from matplotlib.axes import Axes

from hil.control.order_keys import amplitude_key
from hil.recording import Recording
from hil.report import style
from hil.report.against.alike import RunPair
from hil.report.against.numbers import pair_name
from hil.report.figures.order_map import ramp_map
from hil.report.material import CONSTANT_ACCELERATION, Material
from hil.report.plotted_run import (
    PlottedRun,
    draw_vibration,
    finish_vibration,
    limit_words,
    plotted_run,
    shade_line,
    shade_speeds,
    shown_acceleration,
    smooth_spectrum,
)
from hil.report.style import Drawing, Real
from hil.results.ate import AteResult
from hil.results.plant import FrequencyResponseEntry, PlantResult

SPECTRUM_TO_HZ = 50.0
OLD, NEW = style.WITHOUT, style.WITH
SIDES = (("old", style.AXIS_LINES[1], -0.08), ("new", style.AXIS_LINES[0], 0.08))
"""Names, looks and shifts beside an order of the two results."""


def tip_figure(new: Material, old: Material, pair: RunPair, number: int) -> Drawing | None:
    """Draw the tip of two runs over time, and its spectrum.

    For a ramp, the lower panel shows orders instead of the spectrum. None without both recordings.
    """
    runs = [plotted_run(old, pair.old, "old", OLD), plotted_run(new, pair.new, "new", NEW)]
    drawn = [run for run in runs if run is not None]
    if len(drawn) < 2:
        return None
    axis, key = pair.new.axis, f"tip-{number}"
    figure, panels = style.panels(2, 1, 5.2, height_ratios=(3, 2))
    top, below = panels[:, 0]
    for run in drawn:
        draw_vibration(top, run, new.band_hz(axis))
    recording = drawn[-1].recording
    if axis is None:
        shade_line(new, top, recording)
    elif pair.new.experiment == CONSTANT_ACCELERATION:
        shade_speeds(new, axis, recording, top, with_names=False)
    top.set_xlim(float(recording.time_s[0]), float(recording.time_s[-1]))
    finish_vibration(new, top, new.f_al(axis))
    is_ramp = axis is not None and pair.new.experiment == CONSTANT_ACCELERATION
    below_words = _draw_orders(below, drawn, axis) if is_ramp and axis is not None else _draw_spectra(below, drawn)
    style.legend_above(figure, top)
    band = new.band_hz(axis)
    limit = "" if axis is None else f" {limit_words(new, axis)}"
    name = pair_name(pair)
    return Drawing(
        key,
        f"{name[0].upper()}{name[1:]}: the tip, old and new",
        "",
        "measured",
        f"Above: tip acceleration, band-passed {band[0]:.3g} to {band[1]:.3g} Hz with zero phase, each from the beginning of "
        f"its recording.{limit} Below: {below_words}",
        style.to_svg(figure, key, is_zoomable=True),
    )


def _draw_orders(panel: Axes, drawn: list[PlottedRun], axis: int) -> str:
    for run in drawn:
        found = order_amplitudes(run.recording, axis)
        if found is not None:
            panel.plot(*found, **run.look)
    panel.set(xlabel="Order k (per turn of the motor)", ylabel="Amplitude (m/s²)")
    panel.set_ylim(0.0, None)
    return "the largest amplitude of each order while the motor speeds up, in windows of two turns."


def order_amplitudes(recording: Recording, axis: int) -> tuple[Real, Real] | None:
    """Return orders and their largest amplitudes on a ramp, in m/s².

    Both of shape (n,); None if the motor turns too little.
    """
    found = ramp_map(recording, axis)
    if found is None:
        return None
    seen = ~np.all(np.isnan(found.amplitude), axis=0)
    return found.orders[seen], np.nanmax(found.amplitude[:, seen], axis=0)


def _draw_spectra(panel: Axes, drawn: list[PlottedRun]) -> str:
    for run in drawn:
        panel.plot(*smooth_spectrum(shown_acceleration(run), run.recording.period_s, SPECTRUM_TO_HZ), **run.look)
    panel.set(xlabel="Frequency (Hz)", ylabel="Amplitude (m/s²)", xlim=(0.0, SPECTRUM_TO_HZ))
    panel.set_ylim(0.0, None)
    return "Hann spectrum of the whole recording."


def error_figure(new: AteResult, old: AteResult) -> Drawing | None:
    """Draw the amplitudes of two transmission errors by order."""
    if new.ate is None or old.ate is None:
        return None
    figure, panels = style.panels(1, 1, 2.8)
    panel = panels[0, 0]
    for (name, look, shift), part in zip(SIDES, (old.ate, new.ate), strict=True):
        values = part.values.amplitudes_arcsec()
        errors = [part.standard_error.get(amplitude_key(order), 0.0) for order in values]
        abscissa = np.array([float(order) for order in values]) + shift
        points: style.Line = {**look, "linestyle": "", "elinewidth": 0.9, "capsize": 2.0}
        panel.errorbar(abscissa, list(values.values()), errors, label=name, **points)
    panel.set(xlabel="Order k", ylabel="Amplitude A_k (arcsec)")
    panel.set_ylim(0.0, None)
    style.legend_above(figure, panel)
    words = "Discs: new; squares: old; bars: standard errors."
    return Drawing(
        "errors-by-order", "Transmission error by order", "", "measured", words, style.to_svg(figure, "errors-by-order")
    )


def response_figure(new: PlantResult, old: PlantResult) -> Drawing | None:
    """Draw the motor angle per torque of two identifications."""
    if new.response is None or old.response is None:
        return None
    figure, panels = style.panels(2, 1, 4.6, sharex=True, height_ratios=(3, 2))
    gain, phase = panels[:, 0]
    for name, response, look in (("old", old.response, OLD), ("new", new.response, NEW)):
        frequency, value = _complex(response)
        gain.semilogx(frequency, style.decibel(value), label=name, **look)
        phase.semilogx(frequency, np.degrees(np.unwrap(np.angle(value))), **look)
    gain.set_ylabel(r"$|\theta_m/\tau|$ (dB re 1 rad/N·m)")
    phase.set(xlabel="Frequency (Hz)", ylabel="Phase (°)")
    style.legend_above(figure, gain)
    words = "Frequency response of each result at its excited frequencies."
    svg = style.to_svg(figure, "responses", is_zoomable=True)
    return Drawing("responses", "Motor angle per torque", "", "measured", words, svg)


def _complex(response: FrequencyResponseEntry) -> tuple[Real, style.Panels]:
    return np.asarray(response.frequency_hz), np.asarray(response.real) + 1j * np.asarray(response.imaginary)
