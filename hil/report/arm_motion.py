"""Motion of an arm along its line, as figures show it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from hil.arm.kinematics import Kinematics
from hil.bench.tip import joint_angles
from hil.control.arrays import Real, Rows
from hil.experiments.motions import LINE_MOTION
from hil.report import style
from hil.report.material import Material, treatment_name
from hil.report.plotted_run import PlottedRun, judged_line_s, plotted_run
from hil.report.projection import View
from hil.tip_swing import LEAST_SWING_ROWS
from hil.tip_vector import displacement_mm, tip_acceleration

STEPS = (1.0, 2.0, 5.0)
"""Magnifications are one of these, times a power of ten."""
ARM: style.Line = {"color": style.EDGE, "linestyle": "-", "linewidth": 2.0}
BEFORE: style.Line = {"color": style.ORANGE, "linestyle": "-", "linewidth": 0.9}
AFTER: style.Line = {"color": style.BLUE, "linestyle": "-", "linewidth": 1.6}
"""Lines of small loops, in which dashes could not be told; what acts is dark, strong and inside."""
NOTHING = "no treatment"
GROUND_M = 0.1 * np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0]])
"""Corners of the plane on which the base stands."""
TRIAD_M = 0.2
"""Length of the base frame's directions where they are drawn."""
BESIDE_M = np.array([[0.13, -0.05, 0.0], [-0.05, 0.13, 0.0], [0.0, 0.0, 0.24]])
"""Where their names stand, from the corner in which they begin."""


@dataclass(frozen=True)
class MovedArm:
    """One run of an arm's line.

    Attributes:
        angles_rad: Joint angles from the recorded motors; shape (n, joints).
        tip_m: Tip by the kinematics; shape (n, 3).
        moved_mm: Displacement of the tip by its vibration, in the band; shape (n, 3).
        judged: Rows in which it is judged; shape (n,).
    """

    run: PlottedRun
    angles_rad: Real
    tip_m: Real
    moved_mm: Real
    judged: Rows

    @property
    def peak_mm(self) -> float:
        """Largest displacement in the judged rows, in any direction."""
        return float(np.max(np.linalg.norm(self.moved_mm[self.judged], axis=1)))


def recorded_line(material: Material) -> tuple[Real, Real] | None:
    """Return joint angles and tip along the first complete line, or None."""
    arm = material.bench.arm
    if arm is None:
        return None
    lines = [run for run in material.result.runs if run.experiment == LINE_MOTION and run.stopped is None]
    recording = next((found for run in lines if (found := material.recording(run)) is not None), None)
    if recording is None:
        return None
    angles = joint_angles(material.bench, recording)
    return angles, np.asarray(Kinematics.of(arm).pose(angles)[0])


def moved_arms(material: Material) -> list[MovedArm]:
    """Return the arm's line without treatment and with the best treatment.

    Both drive-closed; the best treatment leaves the least tip peak. One alone if the other is missing, and an empty list
    without both.
    """
    entries = [
        run
        for run in material.result.runs
        if run.experiment == LINE_MOTION and run.loop == "drive" and run.directions is not None and run.tip_peak_mm is not None
    ]
    plain = [run for run in entries if run.treatment == "none"]
    acting = sorted((run for run in entries if run.treatment != "none"), key=lambda run: run.tip_peak_mm or 0.0)
    drawn = [
        plotted_run(material, run, NOTHING if run.treatment == "none" else treatment_name(run.treatment), look)
        for run, look in [*((run, BEFORE) for run in plain[:1]), *((run, AFTER) for run in acting[:1])]
    ]
    return [moved for run in drawn if run is not None and (moved := _moved(material, run)) is not None]


def _moved(material: Material, run: PlottedRun) -> MovedArm | None:
    """Compute a run's motion by the kinematics of the bench's arm."""
    bench, scale, recording = material.bench, material.scale(None), run.recording
    if bench.arm is None or bench.line_motion is None or scale is None or run.entry.stopped is not None:
        return None
    angles = joint_angles(bench, recording)
    begin, end = judged_line_s(material)
    time = recording.time_s - recording.time_s[0] - bench.line_motion.dwell_s
    judged = (time >= begin) & (time <= end)
    if np.count_nonzero(judged) < LEAST_SWING_ROWS:
        return None
    tip, _ = Kinematics.of(bench.arm).pose(angles)
    moved = displacement_mm(tip_acceleration(recording), recording.period_s, scale.band_hz)
    return MovedArm(run, angles, np.asarray(tip), moved, judged)


def round_down(value: float) -> float:
    """Round down to 1, 2 or 5 times a power of ten.

    >>> round_down(140.0), round_down(0.07), round_down(5.0)
    (100.0, 0.05, 5.0)
    """
    power = 10.0 ** np.floor(np.log10(value) + 1e-9)
    return float(max(step * power for step in STEPS if step * power <= value * (1.0 + 1e-9)))


def draw_skeleton(panel: Axes, view: View, skeleton_m: Real, *, strength: float = 1.0, look: style.Line = ARM) -> None:
    """Draw an arm as a line, with rings at joints and tip.

    The tip is a filled disc. The line is that of `Kinematics.skeleton`; shape (2 joints + 2, 3).
    """
    right, up = view.flat(skeleton_m)
    colour = (look["color"], strength)
    panel.plot(right, up, solid_capstyle="round", zorder=3, **{**look, "color": colour})
    rings: style.Line = {"marker": "o", "markersize": 4.4, "markerfacecolor": style.PAPER, "markeredgecolor": colour}
    panel.plot(right[1:-1:2], up[1:-1:2], zorder=4, linestyle="", **rings)
    panel.plot(right[-1:], up[-1:], zorder=6, marker="o", markersize=4.0, linestyle="", color=colour)


def fit_limits(panels: Sequence[tuple[Axes, View]], points_m: Real, margin_m: float = 0.05) -> None:
    """Give panels one scale, equal in both directions, for all points.

    Points have the shape (n, 3).
    """
    points_m = np.concatenate([points_m, GROUND_M])
    flat = [view.flat(points_m) for _, view in panels]
    half = 0.5 * max(float(np.ptp(values)) for pair in flat for values in pair) + margin_m
    for (panel, _), (right, up) in zip(panels, flat, strict=True):
        panel.set_aspect("equal")
        for values, set_limits in ((right, panel.set_xlim), (up, panel.set_ylim)):
            middle = 0.5 * (float(np.min(values)) + float(np.max(values)))
            set_limits(middle - half, middle + half)


def draw_ground(panel: Axes, view: View) -> None:
    """Draw the plane under the base."""
    panel.fill(*view.flat(GROUND_M), facecolor=style.SHADE, edgecolor=style.GREY, linewidth=1.0, zorder=1)


def draw_directions(panel: Axes, view: View) -> None:
    """Name the panel's axes, or draw the directions of the base frame."""
    if view.names is not None:
        right, up = view.names
        panel.set(xlabel=f"{right} (m)", ylabel=f"{up} (m)")
        return
    panel.set_axis_off()
    corner = GROUND_M.min(axis=0)
    for axis, name, beside in zip(np.eye(3), "xyz", BESIDE_M, strict=True):
        panel.plot(*view.flat(corner + np.stack([np.zeros(3), TRIAD_M * axis])), color=style.GREY, linewidth=1.0, zorder=2)
        panel.annotate(name, view.flat(corner + beside), ha="center", va="center", fontsize=8.0, color=style.GREY)
