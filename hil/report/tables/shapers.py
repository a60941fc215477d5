"""Table of input shapers: fit, residual vibration, and cost.

The residual is that of the formula, and that on the robot.
"""

import math
from collections.abc import Sequence

from hil.control.shapers import SwingingMode
from hil.experiments.treatment import TITLES
from hil.report.report_table import NONE, Cell, ReportTable, number
from hil.results.runs import RunEntry


def shapers(
    runs: Sequence[RunEntry], key: str = "shapers", title: str = "Remaining vibration and cost of shapers"
) -> ReportTable:
    """Tabulate runs with a shaper beside runs without.

    Of the same motion; None without shapers.
    """
    plain = {(run.experiment, run.axis, run.loop): run.tip_peak_mm for run in runs if run.treatment == "none"}
    rows: list[list[Cell]] = []
    for run in runs:
        made = run.shaper
        if made is None:
            continue
        where = run.experiment.replace("-", " ") if run.axis is None else f"axis {run.axis}, {run.experiment.replace('-', ' ')}"
        error = NONE if made.path_error_mm is None else f"{made.path_error_mm:.3f}"
        parts = (made.remaining_low_fraction, made.remaining_fraction, made.remaining_high_fraction)
        rows.append([
            TITLES[run.treatment], where, "; ".join(map(mode_words, made.modes)), f"{1e3 * made.duration_s:.0f}",
            f"{1e3 * made.delay_s:.0f}", *(f"{100.0 * part:.1f}" for part in parts), error, number(run.tip_peak_mm, "{:.4f}"),
            change_db(plain.get((run.experiment, run.axis, run.loop)), run.tip_peak_mm),
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
