"""Figures and tables of the tip as a vector on an arm: along x, y, z and the worst direction."""

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from hil.analysis import DIRECTIONS, Direction, DirectionMetrics
from hil.experiments.treatment import TITLES
from hil.report import style
from hil.report.material import Material, run_name
from hil.report.plotted_run import PlottedRun, number_or_nothing, shade_judged, shown_runs, window_words
from hil.report.report_table import Cell, Columns, Mark, ReportTable, number, tabulate, vector_text
from hil.report.style import Drawing
from hil.results.runs import RunEntry
from hil.tip_vector import displacement_mm, tip_acceleration

ALONG: tuple[Direction, ...] = ("x", "y", "z")


def directions(material: Material, experiment: str, axis: int | None) -> Drawing | None:
    """Draw the tip along x, y and z in an experiment."""
    what = "Line motion" if axis is None else f"Axis {axis}"
    key = f"directions-{experiment if axis is None else axis}"
    groups = shown_runs(material, experiment, axis)
    return directions_of(material, groups[0] if groups else [], axis, key, f"{what}: the tip along x, y and z")


def directions_of(material: Material, drawn: list[PlottedRun], axis: int | None, key: str, title: str) -> Drawing | None:
    """Draw the tip along x, y, z in runs of one motion."""
    runs, scale = [run for run in drawn if run.entry.directions is not None], material.scale(axis)
    if not runs or scale is None:
        return None
    figure, panels = style.panels(3, 1, 6.0, sharex=True, sharey=True)
    limit = material.bench.specification.tip_mm
    for panel, name in zip(panels[:, 0], ALONG, strict=True):
        for run in runs:
            _draw(panel, run, ALONG.index(name), scale.band_hz)
        for sign in (1.0, -1.0):
            panel.axhline(sign * limit, **style.LIMIT)
        shade_judged(material, panel, axis, runs[-1].recording)
        panel.set_ylabel(f"Tip along {name} (mm)")
        panel.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=min(len(runs), 3), borderaxespad=0.1
        )  # above: curves fill the panel
    panels[-1, 0].set_xlabel("Time (s)")
    caption = (
        f"Displacement of the tip in the base frame: its acceleration from {scale.band_hz[0]:.3g} to {scale.band_hz[1]:.3g} Hz, "
        f"integrated twice. Dotted: the specification of ±{limit:g} mm, which holds for every direction. "
        f"{window_words(material, axis)}{_worst(runs)}"
    )
    return style.drawing(figure, key, title, caption, is_zoomable=True)


def _draw(panel: Axes, run: PlottedRun, column: int, band_hz: tuple[float, float]) -> None:
    recording, found = run.recording, run.entry.directions or {}
    moved = displacement_mm(tip_acceleration(recording)[:, [column]], recording.period_s, band_hz)[:, 0]
    label = run.label + number_or_nothing(found[ALONG[column]].tip_peak_mm, ": peak {:.4f} mm")
    style.plot_thin(panel, recording.time_s, np.asarray(moved), label=label, **run.look)


def _worst(runs: list[PlottedRun]) -> str:
    words = []
    for run in runs:
        worst = (run.entry.directions or {})["worst"]
        if worst.unit is not None and worst.tip_peak_mm is not None:
            words.append(f"{run.label}: {worst.tip_peak_mm:.4f} mm along {vector_text(worst.unit)}")
    return f" Worst, {'; '.join(words)}." if words else ""


def peaks_mm(entries: Sequence[RunEntry], treatment: str) -> dict[Direction, float]:
    """Return the tip's peaks in a treatment's first judged run, by direction."""
    for run in entries:
        if run.treatment == treatment and run.invalid is None and run.directions is not None:
            return {name: each.tip_peak_mm for name, each in run.directions.items() if each.tip_peak_mm is not None}
    return {}


def side_by_side(material: Material, key: str, caption: str | Markup) -> ReportTable:
    """Tabulate the tip's peaks by direction, with a column per treatment."""
    runs, limit_mm = material.result.runs, material.bench.specification.tip_mm
    names = [name for name in dict.fromkeys(run.treatment for run in runs) if peaks_mm(runs, name)]
    peaks = {name: peaks_mm(runs, name) for name in names}
    rows: list[list[Cell]] = []
    for direction in DIRECTIONS:
        own = [peaks[name].get(direction) for name in names]
        cells = [Mark(None) if peak is None else Mark(peak <= limit_mm, f"{peak:.4f}") for peak in own]
        rows.append(["worst" if direction == "worst" else f"along {direction}", *cells])
    header = ("Tip peak (mm)", *(TITLES.get(name, name) for name in names))
    title = "The tip along x, y and z, side by side"
    return ReportTable(key, title, header, rows, range(len(header)), caption)


def direction_table(material: Material, key: str = "directions") -> ReportTable:
    """Tabulate peaks, root mean squares and areas of every window."""
    columns: Columns[tuple[RunEntry, Direction, DirectionMetrics]] = (
        ("Run", lambda row: run_name(row[0]) if row[1] == "x" else ""),
        ("Direction", lambda row: row[1] + (f" {vector_text(row[2].unit)}" if row[1] == "worst" and row[2].unit else "")),
        ("Tip peak (mm)", lambda row: number(row[2].tip_peak_mm, "{:.4f}")),
        ("Tip rms (mm)", lambda row: number(row[2].tip_rms_mm, "{:.4f}")),
        ("Spectrum peak (m/s²)", lambda row: number(row[2].spectrum_peak_m_s2, "{:.4f}")),
        ("at (Hz)", lambda row: number(row[2].spectrum_peak_hz, "{:.2f}")),
        ("Spectrum area (m/s²·Hz)", lambda row: number(row[2].spectrum_area, "{:.3f}")),
    )
    rows = [
        (run, name, run.directions[name]) for run in material.result.runs if run.directions is not None for name in DIRECTIONS
    ]
    caption = (
        "Displacement of the tip in the base frame: the acceleration in the band of the vibration, integrated twice. The worst "
        "direction is that of the largest displacement, and determines the verdict. Its area and root mean square are those of "
        "all directions together. Areas: from 0.2 f_al to 50 Hz."
    )
    return tabulate(key, "The tip along x, y and z", columns, rows, caption, (0, 1))
