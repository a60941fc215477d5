"""Figure of the tip's displacement along x, y and z."""

import numpy as np
from matplotlib.axes import Axes

from hil.analysis import Direction
from hil.report import style
from hil.report.material import Material
from hil.report.plotted_run import PlottedRun, number_or_nothing, shade_judged, shown_runs, window_words
from hil.report.style import Drawing
from hil.tip_vector import displacement_mm, tip_acceleration

SHOWN: tuple[Direction, ...] = ("x", "y", "z")


def directions(material: Material, experiment: str, axis: int | None) -> Drawing | None:
    """Draw the displacement of the tip along x, y and z.

    Without and with treatments; None if no run has a vector.
    """
    what = "Line motion" if axis is None else f"Axis {axis}"
    key = f"directions-{experiment if axis is None else axis}"
    groups = shown_runs(material, experiment, axis)
    return directions_of(material, groups[0] if groups else [], axis, key, f"{what}: the tip along x, y and z")


def directions_of(material: Material, drawn: list[PlottedRun], axis: int | None, key: str, title: str) -> Drawing | None:
    """Draw the tip along x, y and z in given runs.

    The runs are of one motion; None if none has a vector.
    """
    runs, scale = [run for run in drawn if run.entry.directions is not None], material.scale(axis)
    if not runs or scale is None:
        return None
    figure, panels = style.panels(3, 1, 6.0, sharex=True, sharey=True)
    limit = material.bench.specification.tip_mm
    for panel, name in zip(panels[:, 0], SHOWN, strict=True):
        for run in runs:
            _draw(panel, run, SHOWN.index(name), scale.band_hz)
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
    label = run.label + number_or_nothing(found[SHOWN[column]].tip_peak_mm, ": peak {:.4f} mm")
    style.plot_thin(panel, recording.time_s, np.asarray(moved), label=label, **run.look)


def _worst(runs: list[PlottedRun]) -> str:
    words = []
    for run in runs:
        worst = (run.entry.directions or {})["worst"]
        if worst.unit is not None and worst.tip_peak_mm is not None:
            x, y, z = worst.unit
            words.append(f"{run.label}: {worst.tip_peak_mm:.4f} mm along ({x:.2f}, {y:.2f}, {z:.2f})".replace("-", "−"))
    return f" Worst, {'; '.join(words)}." if words else ""
