"""Page of two results side by side: their settings, then their figures.

Settings are the bench file with gains, filters and model, the request, and the versions.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from hil.control.order_keys import amplitude_key
from hil.errors import NotPossibleError
from hil.experiments.motions import CONSTANT_ACCELERATION
from hil.report import plotted_run as plotted
from hil.report import style
from hil.report.against.alike import PairedRuns, RunPair, check_robot, paired_runs
from hil.report.against.numbers import (
    NumberPair,
    error_numbers,
    model_numbers,
    numbers_table,
    pair_name,
    plant_numbers,
    run_numbers,
)
from hil.report.figures.order_map import ramp_map
from hil.report.material import Material, run_name
from hil.report.origin import origin_of
from hil.report.pages.page import Card, CardStep, Page, PageHead, PageVerdict, Section, moment_text, render
from hil.report.report_table import NONE, Cell, Mark, ReportTable, number
from hil.report.style import Drawing
from hil.results.ate import AteResult
from hil.results.base import RESULT_FILE, MeasuredResult
from hil.results.files import load_any
from hil.results.plant import PlantResult
from hil.results.runs import ExperimentsResult

AGAINST_FILE = "against.html"


MOST_DIFFERING = 200
"""Most settings that are shown."""
GROUPS = ("Control", "Model", "Bench file", "Request", "Bus and versions")


class Setting(NamedTuple):
    """A setting that differs: its group, its key, both values as text."""

    group: str
    key: str
    old: str
    new: str


@dataclass(frozen=True)
class _Content:
    """Numbers, figures and cards of two results, with notes."""

    numbers: list[NumberPair]
    drawings: list[Drawing]
    cards: list[Card]
    notes: tuple[str, ...] = ()


def write_against(directory: Path, old_directory: Path, *, is_interactive: bool = False) -> Path:
    """Write `against.html` into the new result's directory; return its path.

    Raises:
        NotPossibleError: The two are unlike: another kind, robot, axis or motion. Or Bokeh is needed, and is not installed.
        OSError: A result or a recording cannot be read, or the page cannot be written.
        ValueError: A result.json is not a readable result.
    """
    new, old = _measured(directory), _measured(old_directory)
    check_robot(new, old)
    settings = differing(new, old)
    with style.styled():
        content = _content(new, old, directory, old_directory)
    sections = [Section("old-and-new", "Old and new", (numbers_table(content.numbers),))]
    if content.drawings:
        sections.append(Section("figures", "In one diagram", tuple(content.drawings)))
    sections.append(Section("settings-chapter", "Settings", (settings_table(settings),)))
    head = PageHead(
        new.bench.name,
        new.bench.started_utc,
        content.notes + _origin_notes(new, old),
        heading="Two results side by side",
        subtitle="New beside old",
        aftermath=(*new.aftermath, *(f"Old result: {text}" for text in old.aftermath)),
        origin=origin_of(new),
    )
    provenance = [
        (name, f"{folder}, {moment_text(each.bench.started_utc)}")
        for name, folder, each in (("New", directory, new), ("Old", old_directory, old))
    ]
    page = Page(head, verdict(content.numbers, settings), sections, content.cards, provenance)
    return render(directory / AGAINST_FILE, page, is_interactive=is_interactive)


def _measured(directory: Path) -> MeasuredResult:
    result = load_any(directory / RESULT_FILE)
    if isinstance(result, ExperimentsResult | AteResult | PlantResult):
        return result
    command = result.kind.replace("-", " ")
    raise NotPossibleError(
        f"{directory}: this is a result of hil {command}; expected one of hil run, identify ate or identify plant"
    )


def _content(new: MeasuredResult, old: MeasuredResult, directory: Path, old_directory: Path) -> _Content:
    """What results of one kind have in common."""
    if isinstance(new, AteResult) and isinstance(old, AteResult):
        drawings = [each for each in (error_figure(new, old),) if each is not None]
        return _Content(list(error_numbers(new, old)), drawings, [], _not_identified(new.ate, old.ate))
    if isinstance(new, PlantResult) and isinstance(old, PlantResult):
        drawings = [each for each in (response_figure(new, old),) if each is not None]
        return _Content(list(plant_numbers(new, old)), drawings, [], _not_identified(new.parameters, old.parameters))
    return _of_runs(Material(directory), Material(old_directory))


def _of_runs(new: Material, old: Material) -> _Content:
    paired = paired_runs(new.result, old.result)
    drawings, seen = [], set()
    for pair in paired.pairs:
        if pair.new.recording not in seen:
            seen.add(pair.new.recording)
            drawings.append(tip_figure(new, old, pair, len(seen)))
    numbers = [*run_numbers(paired.pairs), *model_numbers(new, old)]
    notes = (*new.notes, *(f"Old: {note}" for note in old.notes), *_left(paired), *_early(paired.pairs))
    cards = [_card(pair, new.bench.specification.tip_mm) for pair in paired.pairs]
    return _Content(numbers, [each for each in drawings if each is not None], cards, notes)


def _card(pair: RunPair, tip_mm: float) -> Card:
    before, after = pair.old.tip_peak_mm, pair.new.tip_peak_mm
    change = f"{100.0 * (after / before - 1.0):+.0f} % peak".replace("-", "−") if before and after is not None else ""
    name = pair_name(pair)
    numbers = number(before, "{:.3f}"), number(after, "{:.3f}")
    step = CardStep(numbers[1], change, Mark(pair.new.within_spec, f"limit ±{tip_mm:g} mm"))
    return Card(f"{name[0].upper()}{name[1:]}", numbers[0], "mm", (step,))


def _left(paired: PairedRuns) -> list[str]:
    """Windows without a counterpart."""
    return [
        f"Only in the {which} result: {run_name(run)}."
        for which, runs in (("new", paired.only_new), ("old", paired.only_old))
        for run in runs
    ]


def _early(pairs: Sequence[RunPair]) -> list[str]:
    """Runs that ended early or could not be judged."""
    told = [
        f"{which}, {run_name(run)}: {run.stopped or run.invalid}"
        for pair in pairs
        for which, run in (("New", pair.new), ("Old", pair.old))
        if run.stopped or run.invalid
    ]
    return list(dict.fromkeys(told))


def _not_identified(new: object, old: object) -> tuple[str, ...]:
    return tuple(f"The {name} result contains no identification." for name, part in (("new", new), ("old", old)) if part is None)


def _origin_notes(new: MeasuredResult, old: MeasuredResult) -> tuple[str, ...]:
    unknown = [name for name, each in (("new", new), ("old", old)) if each.emulated is None]
    if not unknown or len({new.emulated, old.emulated}) == 1:
        return ()
    return (f"The {unknown[0]} result does not record whether its robot was emulated.",)


def verdict(numbers: Sequence[NumberPair], settings: Sequence[Setting]) -> PageVerdict:
    """Sum up the differences, with those that exceed their standard errors."""
    certain = [each for each in numbers if each.is_beyond]
    details = [
        f"{each.group}: {each.name} {number(each.old, '{:.4g}')} → {number(each.new, '{:.4g}')} {each.unit}".rstrip()
        for each in certain
    ]
    with_error = [each for each in numbers if each.error is not None]
    count = "No setting differs" if not settings else f"Settings that differ: {len(settings)}"
    told = f"{len(certain)} of {len(with_error)} numbers that have a standard error differ by more than chance"
    headline = f"{count}; {told if with_error else 'no number has a standard error in both'}"
    return PageVerdict("open", headline, tuple(details))


SPECTRUM_TO_HZ = 50.0
OLD, NEW = style.WITHOUT, style.WITH
SIDES = (("old", style.AXIS_LINES[1], -0.08), ("new", style.AXIS_LINES[0], 0.08))
"""Names, looks and shifts beside an order of the two results."""


def tip_figure(new: Material, old: Material, pair: RunPair, number: int) -> Drawing | None:
    """Draw the tip of two runs over time, and its spectrum.

    For a ramp, the lower panel shows orders instead of the spectrum. None without both recordings.
    """
    runs = [plotted.plotted_run(old, pair.old, "old", OLD), plotted.plotted_run(new, pair.new, "new", NEW)]
    drawn = [run for run in runs if run is not None]
    if len(drawn) < 2:
        return None
    axis, key = pair.new.axis, f"tip-{number}"
    figure, panels = style.panels(2, 1, 5.2, height_ratios=(3, 2))
    top, below = panels[:, 0]
    for run in drawn:
        plotted.draw_vibration(top, run, new.band_hz(axis))
    recording = drawn[-1].recording
    if axis is None:
        plotted.shade_line(new, top, recording)
    elif pair.new.experiment == CONSTANT_ACCELERATION:
        plotted.shade_speeds(new, axis, recording, top, with_names=False)
    top.set_xlim(float(recording.time_s[0]), float(recording.time_s[-1]))
    plotted.finish_vibration(new, top, new.f_al(axis))
    is_ramp = axis is not None and pair.new.experiment == CONSTANT_ACCELERATION
    below_words = _draw_orders(below, drawn, axis) if is_ramp and axis is not None else _draw_spectra(below, drawn)
    style.legend_above(figure, top)
    band = new.band_hz(axis)
    limit = "" if axis is None else f" {plotted.limit_words(new, axis)}"
    name = pair_name(pair)
    caption = (
        f"Above: tip acceleration, band-passed {band[0]:.3g} to {band[1]:.3g} Hz with zero phase, each from the beginning of "
        f"its recording.{limit} Below: {below_words}"
    )
    return style.drawing(figure, key, f"{name[0].upper()}{name[1:]}: the tip, old and new", caption, is_zoomable=True)


def _draw_orders(panel: Axes, drawn: list[plotted.PlottedRun], axis: int) -> str:
    """Draw the largest amplitude of each order on a ramp, in m/s²."""
    for run in drawn:
        found = ramp_map(run.recording, axis)
        if found is not None:
            seen = ~np.all(np.isnan(found.amplitude), axis=0)
            panel.plot(found.orders[seen], np.nanmax(found.amplitude[:, seen], axis=0), **run.look)
    panel.set(xlabel="Order k (per turn of the motor)", ylabel="Amplitude (m/s²)", ylim=(0.0, None))
    return "the largest amplitude of each order while the motor speeds up, in windows of two turns."


def _draw_spectra(panel: Axes, drawn: list[plotted.PlottedRun]) -> str:
    for run in drawn:
        panel.plot(*plotted.smooth_spectrum(plotted.shown_acceleration(run), run.recording.period_s, SPECTRUM_TO_HZ), **run.look)
    panel.set(xlabel="Frequency (Hz)", ylabel="Amplitude (m/s²)", xlim=(0.0, SPECTRUM_TO_HZ), ylim=(0.0, None))
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
    panel.set(xlabel="Order k", ylabel="Amplitude A_k (arcsec)", ylim=(0.0, None))
    style.legend_above(figure, panel)
    words = "Discs: new; squares: old; bars: standard errors."
    return style.drawing(figure, "errors-by-order", "Transmission error by order", words)


def response_figure(new: PlantResult, old: PlantResult) -> Drawing | None:
    """Draw the motor angle per torque of two identifications."""
    if new.response is None or old.response is None:
        return None
    figure, panels = style.panels(2, 1, 4.6, sharex=True, height_ratios=(3, 2))
    gain, phase = panels[:, 0]
    for name, response, look in (("old", old.response, OLD), ("new", new.response, NEW)):
        frequency, value = np.asarray(response.frequency_hz), np.asarray(response.real) + 1j * np.asarray(response.imaginary)
        gain.semilogx(frequency, style.decibel(value), label=name, **look)
        phase.semilogx(frequency, np.degrees(np.unwrap(np.angle(value))), **look)
    gain.set_ylabel(r"$|\theta_m/\tau|$ (dB re 1 rad/N·m)")
    phase.set(xlabel="Frequency (Hz)", ylabel="Phase (°)")
    style.legend_above(figure, gain)
    words = "Frequency response of each result at its excited frequencies."
    return style.drawing(figure, "responses", "Motor angle per torque", words, is_zoomable=True)


def differing(new: MeasuredResult, old: MeasuredResult) -> list[Setting]:
    """Return the differing settings by groups; a missing one is a dash."""
    own, other = dict(_settings(new)), dict(_settings(old))
    found = [
        Setting(_group(key), key, _text(other.get(key)), _text(own.get(key)))
        for key in dict.fromkeys((*own, *other))
        if own.get(key) != other.get(key)
    ]
    return sorted(found, key=lambda each: GROUPS.index(each.group))


def settings_table(found: list[Setting]) -> ReportTable:
    """Table of the settings that differ."""
    rows: list[list[Cell]] = []
    groups: dict[int, str] = {}
    for setting in found[:MOST_DIFFERING]:
        if setting.group not in groups.values():
            groups[len(rows)] = setting.group
        rows.append([f"`{setting.key}`", setting.old, setting.new])
    more = len(found) - MOST_DIFFERING
    caption = f"{more} more are not shown." if more > 0 else "" if found else "No setting differs."
    header = ("Setting", "old", "new")
    return ReportTable("settings", "Settings that differ", header, rows, {0, 1, 2}, caption, is_prose=True, groups=groups)


def _settings(result: MeasuredResult) -> Iterator[tuple[str, Any]]:
    bench = result.bench
    yield from _flat(bench.file.model_dump(mode="json"), "")
    if isinstance(result, PlantResult):
        yield from _flat(result.request.model_dump(mode="json"), "request.")
    if isinstance(result, AteResult):
        yield from _flat(result.known_before.model_dump(mode="json"), "request.known_before.")
        yield "request.sensorless", result.sensorless
    yield "run.bus", bench.bus
    yield "run.clock", bench.clock
    yield from _flat(dict(bench.versions), "run.versions.")


def _flat(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield the single values with their dotted keys; lists count from 1."""
    if isinstance(value, dict):
        parts = [(str(key), each) for key, each in value.items()]
    elif isinstance(value, list | tuple) and any(isinstance(each, dict | list | tuple) for each in value):
        parts = [(str(place), each) for place, each in enumerate(value, 1)]
    else:
        yield path.removesuffix("."), value
        return
    for key, each in parts:
        yield from _flat(each, f"{path}{key}.")


def _group(key: str) -> str:
    parts = key.split(".")
    if parts[0] in {"request", "run"}:
        return "Request" if parts[0] == "request" else "Bus and versions"
    if parts[0] == "axis" and len(parts) > 2:
        return {"control": "Control", "notch": "Control", "model": "Model"}.get(parts[2], "Bench file")
    return "Bench file"


def _text(value: Any) -> str:
    if value is None:
        return NONE
    if isinstance(value, float):
        return f"{value:.10g}".replace("-", "−")
    return ", ".join(map(_text, value)) if isinstance(value, list | tuple) else str(value)
