"""Figures and table of input shapers: tip after a stop, residual over frequency, fit and cost."""

import math
from collections.abc import Sequence

import numpy as np

from hil.control.arrays import Real
from hil.control.shapers import EI_TOLERANCE, Shaper, SwingingMode
from hil.experiments.treatment import TITLES
from hil.experiments.window import stop_row
from hil.recording import Recording
from hil.report import style
from hil.report.material import Material, case_name
from hil.report.report_table import NONE, Cell, ReportTable, number
from hil.report.style import Drawing
from hil.results.runs import RunEntry, ShaperEntry

SHOWN_S = 0.5
"""Time after a stop that is drawn."""
BEFORE_S = 0.08
"""Time before it."""
RATIOS = np.linspace(0.5, 1.6, 441)
"""Frequencies, relative to the assumed one."""
LINES: tuple[style.Line, ...] = (
    {"color": style.BLUE, "linestyle": "-", "linewidth": 1.3},
    {"color": style.VERMILLION, "linestyle": (0, (5, 1.5)), "linewidth": 1.3},
    {"color": style.GREEN, "linestyle": (0, (5, 1.5, 1, 1.5)), "linewidth": 1.3},
    {"color": style.PURPLE, "linestyle": (0, (1, 1)), "linewidth": 1.5},
    {"color": style.BLACK, "linestyle": (0, (8, 1.5)), "linewidth": 1.2},
)
"""Lines of the shapers, in the order of the table of treatments."""


def after_stop(material: Material, axis: int, experiment: str, key: str, title: str) -> Drawing | None:
    """Draw the tip after a stop, with and without each treatment."""
    runs = [run for run in material.result.runs if (run.experiment, run.axis) == (experiment, axis)]
    found = [(run, recording) for run in runs if (recording := material.recording(run)) is not None and run.stopped is None]
    plain = next((pair for pair in found if pair[0].treatment == "none"), None)
    treated = [pair for pair in found if pair[0].treatment != "none"]
    if plain is None or not treated:
        return None
    count = -(-len(treated) // 2)
    figure, panels = style.panels(count, 2, 0.6 + 1.6 * count, sharex=True, sharey=True)
    for panel, (run, recording) in zip(panels.flat, treated, strict=False):
        panel.plot(*_after(plain[1], axis), label="untreated", **style.WITHOUT)
        panel.plot(*_after(recording, axis), label="with the shaper", **style.WITH)
        panel.axvline(0.0, **style.MARK)
        peak_mm, words = run.tip_peak_mm, "not judged"
        if peak_mm is not None:
            words = f"{peak_mm:.4f} mm, {change_db(plain[0].tip_peak_mm, peak_mm)}"
        panel.set_title(f"{TITLES[run.treatment]}: {words}")
    for panel in panels.flat[len(treated) :]:
        panel.set_visible(False)
    for panel in panels[-1]:
        panel.set_xlabel("Time after the set-points stop (s)")
    figure.supylabel("Tip acceleration (m/s²)", fontsize=8.5)
    style.legend_above(figure, panels[0, 0], columns=2)
    caption = (
        "Tip acceleration as recorded, less its mean at rest. Dotted line: the set-points stop. The smooth decay after it "
        "is the motor settling; the oscillation is the arm. In millimetres: the oscillation at that instant, separated "
        "from the rest by the closed loop's poles."
    )
    return style.drawing(figure, key, title, caption, material.word)


def _after(recording: Recording, axis: int) -> tuple[Real, ...]:
    """Time and acceleration around a stop; shapes (m,)."""
    row, period = stop_row(recording, axis), recording.period_s
    first, last = max(0, row - round(BEFORE_S / period)), min(len(recording.time_s), row + round(SHOWN_S / period))
    tip = recording.felt_m_s2 - np.mean(recording.felt_m_s2[-(len(recording.time_s) - row) // 4 :])
    time: Real = period * np.arange(first - row, last - row, dtype=np.float64)
    return style.thin(time, tip[first:last])


def residuals(runs: Sequence[RunEntry], key: str, title: str) -> Drawing | None:
    """Draw each shaper's residual over the true frequency, by its formula."""
    found: dict[str, ShaperEntry] = {TITLES[run.treatment]: run.shaper for run in runs if run.shaper is not None}
    if not found:
        return None
    figure, panels = style.panels(1, 1, 3.2)
    panel = panels[0, 0]
    for (name, made), look in zip(found.items(), LINES, strict=False):
        mode = made.modes[0]
        left = Shaper(made.amplitudes, made.times_s).remaining(RATIOS * mode.frequency_hz, mode.damping)
        panel.plot(RATIOS, 100.0 * left, label=name, **look)
    panel.axhline(100.0 * EI_TOLERANCE, **style.LIMIT)
    panel.axvspan(0.9, 1.1, color=style.SHADE, zorder=0)
    panel.set(xlabel="True frequency over the assumed one", ylabel="Remaining vibration (%)", ylim=(0.0, 60.0))
    panel.set_xlim(float(RATIOS[0]), float(RATIOS[-1]))
    style.legend_above(figure, panel, columns=5)
    modes = {mode_words(made.modes[0]) for made in found.values()}
    caption = (
        f"V of the mode of {'; '.join(sorted(modes))}, in % of what the motion would leave without a shaper. Shaded: ±10 %. "
        f"Dotted: {100.0 * EI_TOLERANCE:g} %. A shaper for two modes has the impulses of both, and leaves even less between "
        "them."
    )
    return style.drawing(figure, key, title, caption, "computed")


def shaper_table(
    runs: Sequence[RunEntry], key: str = "shapers", title: str = "Remaining vibration and cost of shapers"
) -> ReportTable:
    """Tabulate runs with a shaper beside runs without, of one motion."""
    plain = {(run.experiment, run.axis, run.loop): run.tip_peak_mm for run in runs if run.treatment == "none"}
    rows: list[list[Cell]] = []
    for run in runs:
        made = run.shaper
        if made is None:
            continue
        error = NONE if made.path_error_mm is None else f"{made.path_error_mm:.3f}"
        parts = (made.remaining_low_fraction, made.remaining_fraction, made.remaining_high_fraction)
        rows.append([
            TITLES[run.treatment], case_name(run.experiment, run.axis), "; ".join(map(mode_words, made.modes)),
            f"{1e3 * made.duration_s:.0f}", f"{1e3 * made.delay_s:.0f}", *(f"{100.0 * part:.1f}" for part in parts), error,
            number(run.tip_peak_mm, "{:.4f}"), change_db(plain.get((run.experiment, run.axis, run.loop)), run.tip_peak_mm),
        ])  # fmt: skip
    header = (
        "shaper", "motion", "fitted to", "longer by (ms)", "late by (ms)", "left at −10 % (%)", "as fitted (%)", "at +10 % (%)",
        "path error (mm)", "tip (mm)", "against nothing",
    )  # fmt: skip
    caption = (
        "Fitted to the modes that ring while the loop holds the motor: frequency and damping ratio of the closed loop's poles. "
        "Left: remaining vibration by the formula, also at frequencies 10 % lower and higher than assumed. A shaped motion of "
        "one axis keeps its path but is late; the tip of a shaped line leaves the straight line by the path error."
    )
    left = [mode_words(mode) for run in runs if run.shaper is not None for mode in run.shaper.left]
    if left:
        caption += f" Not shaped, because a shaper takes at most two modes: {'; '.join(dict.fromkeys(left))}."
    return ReportTable(key, title, header, rows, {0, 1, 2}, caption)


def mode_words(mode: SwingingMode) -> str:
    """A mode in words: `11.63 Hz, ζ 0.129`."""
    return f"{mode.frequency_hz:.2f} Hz, ζ {mode.damping:.3f}"


def change_db(before: float | None, after: float | None) -> str:
    """A change in dB with its sign."""
    if not before or not after:
        return NONE
    return f"{20.0 * math.log10(after / before):+.1f} dB".replace("-", "−")
