"""Figure of an arm along its line, and the tip's error, magnified."""

import math

import numpy as np
from matplotlib.axes import Axes

from hil.arm.kinematics import Kinematics
from hil.control.arrays import Real
from hil.report import arm_motion, style
from hil.report.arm_motion import MovedArm
from hil.report.material import Material
from hil.report.plotted_run import line_words
from hil.report.projection import ABOVE, ANGLE, SIDE
from hil.report.style import Drawing, Line

POSTURES = (0.3, 0.5, 1.0)
"""Postures that are drawn, evenly along the line from its start to its end, by the strength of their lines."""
LEAST_WAY_M = 0.02
"""Length of the path from which the error is drawn along it."""
MOST_LOOPS, PERIODS = 10, 1.5
"""Largest number of loops, and periods of the lowest frequency of the band that each has at least."""
LOOP_FRACTION = 0.96
"""Width of the largest loop over the distance of two."""
PATH: Line = {"color": style.GREEN, "linestyle": "-", "linewidth": 2.6, "solid_capstyle": "butt"}
VIEWS = {"side": SIDE, "above": ABOVE, "angle": ANGLE}
ACROSS = ("first", "second")
"""Panels of the two directions across the path."""
UPRIGHT = 0.9
"""Vertical part of a path's direction from which nothing across it is upwards: it is seen along x and y."""
VIEWS_IN, MARGIN_IN, LOOPS_IN = 3.3, 0.55, 7.9
"""Height of the views, what a panel with loops has around it, and its width."""


def arm_along_line(material: Material, key: str = "arm-line") -> Drawing | None:
    """Draw three views of an arm along its line, and its error."""
    arms, way = arm_motion.moved_arms(material), arm_motion.recorded_line(material)
    if way is None or material.bench.arm is None:
        return None
    has_loops = bool(arms) and _way_m(arms[0]) >= LEAST_WAY_M
    loops = _Loops(arms, material.bench.specification.tip_mm) if has_loops else None
    rows, heights = [list(VIEWS)], [VIEWS_IN]
    if loops is not None:
        rows += [[name] * len(VIEWS) for name in ACROSS]
        heights += [loops.height_in] * len(ACROSS)
    figure, panels = style.mosaic(rows, sum(heights) + 0.3, height_ratios=heights)
    _draw_views(panels, Kinematics.of(material.bench.arm), *way)
    if loops is not None:
        loops.draw(panels)
    style.legend_above(figure, *panels.values(), columns=5)
    title = "The arm along its line" + ("" if loops is None else f", its tip error drawn {loops.magnification:g} times as large")
    return style.drawing(figure, key, title, _caption(material, loops))


def _way_m(moved: MovedArm) -> float:
    inside = moved.tip_m[moved.judged]
    return float(np.linalg.norm(inside[-1] - inside[0]))


def _draw_views(panels: dict[str, Axes], kinematics: Kinematics, angles_rad: Real, tip_m: Real) -> None:
    """Draw the arm in three views, at some postures, with tip path."""
    rows = np.linspace(0, len(angles_rad) - 1, len(POSTURES)).astype(int)
    skeletons = kinematics.skeleton(angles_rad[rows])
    for name, view in VIEWS.items():
        panel = panels[name]
        arm_motion.draw_ground(panel, view)
        for skeleton, strength in zip(skeletons, POSTURES, strict=True):
            arm_motion.draw_skeleton(panel, view, skeleton, strength=strength)
        panel.plot(*view.flat(tip_m), zorder=5, label="path of the tip", **PATH)
        panel.set_title(view.title)
        arm_motion.draw_directions(panel, view)
    way = np.abs(tip_m[-1] - tip_m[0])
    beside: Line = (
        {"xytext": (7, 0), "ha": "left", "va": "center"} if way[2] > way[0] else {"xytext": (0, -5), "ha": "center", "va": "top"}
    )
    for words, point in (("start", tip_m[0]), ("end", tip_m[-1])):
        panels["side"].annotate(words, SIDE.flat(point), textcoords="offset points", fontsize=7.5, **beside)
    points = np.concatenate([skeletons.reshape(-1, 3), tip_m])
    arm_motion.fit_limits([(panels[name], view) for name, view in VIEWS.items()], points)


class _Loops:
    """Loops of the tip's error about its path, magnified."""

    def __init__(self, arms: list[MovedArm], limit_mm: float) -> None:
        self.arms, self.limit_mm = arms, limit_mm
        first = arms[0]
        begin, end = first.tip_m[first.judged][[0, -1]]
        self.along = (end - begin) / np.linalg.norm(end - begin)
        is_upright = abs(float(self.along[2])) >= UPRIGHT
        axis = np.eye(3)[0 if is_upright else 2]
        across = axis - (axis @ self.along) * self.along
        across /= np.linalg.norm(across)
        self.names = ("Forwards (mm)", "Sideways (mm)") if is_upright else ("Upwards (mm)", "Sideways (mm)")
        self.across = (across, np.cross(across, self.along))
        low_hz = (first.run.entry.band_hz or (1.0, 1.0))[0]
        lasts_s = float(np.count_nonzero(first.judged)) * first.run.recording.period_s
        self.count = min(MOST_LOOPS, max(1, int(lasts_s * low_hz / PERIODS)))
        way_mm = 1e3 * _way_m(first)
        self.reach_mm = max(limit_mm, *(moved.peak_mm for moved in arms))
        self.magnification = arm_motion.round_down(LOOP_FRACTION * way_mm / self.count / (2.0 * self.reach_mm))
        self.length_mm = way_mm * (1.0 + 1.0 / self.count)

    @property
    def height_in(self) -> float:
        """Height of a panel in which both directions have one scale."""
        return LOOPS_IN * 2.2 * self.reach_mm * self.magnification / self.length_mm + MARGIN_IN

    def draw(self, panels: dict[str, Axes]) -> None:
        """Draw the loops in both directions, each in the specification's ring."""
        turn = np.linspace(0.0, 2.0 * math.pi, 73)
        for name, words, across in zip(ACROSS, self.names, self.across, strict=True):
            panel, rings = panels[name], list[tuple[Real, Real]]()
            for moved in self.arms:
                centre_mm, along_mm, across_mm = self._errors(moved, across)
                for stretch in np.array_split(np.arange(len(along_mm)), self.count):
                    middle = float(np.mean(centre_mm[stretch]))
                    label = f"{moved.run.label}: {moved.peak_mm:.4f} mm" if stretch[0] == 0 else None
                    panel.plot(middle + self.magnification * along_mm[stretch], across_mm[stretch], label=label, **moved.run.look)
                    rings.append((middle + self.magnification * self.limit_mm * np.cos(turn), self.limit_mm * np.sin(turn)))
            for number, ring in enumerate(rings[: self.count]):
                panel.plot(*ring, label=None if number else f"specification ±{self.limit_mm:g} mm", **style.LIMIT)
            panel.axhline(0.0, zorder=1, color=style.GREEN, linewidth=1.0)
            panel.set_aspect(self.magnification)
            panel.set_ylim(-1.08 * self.reach_mm, 1.08 * self.reach_mm)
            panel.set(xlabel="Along the line (mm)" if name == ACROSS[-1] else "", ylabel=words)

    def _errors(self, moved: MovedArm, across: Real) -> tuple[Real, Real, Real]:
        """Return position along the path, and error along and across it."""
        inside = moved.moved_mm[moved.judged]
        begin = moved.tip_m[0]
        return 1e3 * ((moved.tip_m[moved.judged] - begin) @ self.along), inside @ self.along, inside @ across


def _caption(material: Material, loops: _Loops | None) -> str:
    text = (
        "Above: base, joints (rings) and tip (disc) at the start (faint), in the middle and at the end of the motion, from "
        "the recorded motor angles and the bench file's kinematics. Axes that do not move are drawn at home."
    )
    if loops is None:
        return text
    band = loops.arms[0].run.entry.band_hz
    within = "" if band is None else f" from {band[0]:.3g} to {band[1]:.3g} Hz"
    return (
        f"{text} Below: the tip's vibration{within}, its acceleration integrated twice, {line_words(material)}, in "
        f"{loops.count} stretches of time. Each is drawn around its own point of the path and {loops.magnification:g} times as "
        "large as the path's scale. Outside the dotted circle the tip exceeds the specification in the plane of the drawing."
    )
