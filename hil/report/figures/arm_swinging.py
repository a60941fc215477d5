"""Figure of an arm at its resonances: tip ellipses, and modes.

The ellipses are measured; the modes are computed if masses and stiffness are known.
"""

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from hil.arm.kinematics import Kinematics
from hil.arm.regressor import PER_LINK, regressor
from hil.arm.swinging import ModeShape, mode_shapes
from hil.bench.bench import AxisTable, Bench
from hil.bench.model import IdentifiedArm
from hil.control.arrays import Real
from hil.report import style
from hil.report.arm_motion import MovedArm, draw_directions, draw_ground, draw_skeleton, fit_limits, moved_arms, round_down
from hil.report.material import Material
from hil.report.plotted_run import line_words
from hil.report.projection import ANGLE, View, fullest
from hil.report.report_table import vector_text
from hil.report.style import Drawing, Line
from hil.tip_swing import MOST_SWINGS, Swing, resonances_hz, spectrum_mm, swing

ELLIPSE_M = 0.2
"""Half-axis of the largest ellipse as it is drawn, at most."""
DEFLECTION_M = 0.09
"""Motion of the tip in a mode as it is drawn."""
SPECTRUM_IN, PANEL_IN = 1.9, 3.1
DEFLECTED: Line = {"color": style.VERMILLION, "linestyle": "-", "linewidth": 1.5}
OTHER_WAY: Line = {"color": style.VERMILLION, "linestyle": (0, (3, 1.4)), "linewidth": 1.0}
FEWEST_COLUMNS = 2
SHOWN_HZ = 1.2
"""Frequencies that are drawn beyond the band, over its upper end."""


def arm_swinging(material: Material, key: str = "arm-resonances") -> Drawing | None:
    """Draw the tip's swing at each resonance of an arm's line."""
    arms, arm = moved_arms(material), material.bench.arm
    band_hz = arms[0].run.entry.band_hz if arms else None
    if not arms or arm is None or band_hz is None:
        return None
    first = arms[0]
    found = resonances_hz(first.moved_mm, first.run.recording.period_s, first.judged, band_hz)
    if not found:
        return None
    swings = [[swing(moved.moved_mm, moved.run.recording.period_s, moved.judged, hz) for hz in found] for moved in arms]
    posture = first.angles_rad[swings[0][0].row]
    modes = known_modes(material.bench, material.result.arm, posture, first.run.recording.axes)
    shapes = [] if modes is None else modes.shapes
    columns = max(FEWEST_COLUMNS, len(found), len(shapes))
    rows = [["spectrum"] * columns, [f"swing-{number}" for number in range(columns)]]
    rows += [[f"mode-{number}" for number in range(columns)]] if shapes else []
    heights = [SPECTRUM_IN, *[PANEL_IN] * (len(rows) - 1)]
    figure, panels = style.mosaic(rows, sum(heights), height_ratios=heights)
    _draw_spectrum(panels["spectrum"], arms, found, band_hz)
    longest = max(float(np.linalg.norm(each.half_axes_mm[0])) for own in swings for each in own)
    magnification = round_down(1e3 * ELLIPSE_M / max(longest, 1e-9))
    stage = _Stage(Kinematics.of(arm), arms, magnification)
    for number in range(columns):
        stage.draw_swing(panels[f"swing-{number}"], [each[number] for each in swings] if number < len(found) else [])
        if shapes:
            stage.draw_mode(panels[f"mode-{number}"], posture, shapes[number : number + 1])
    stage.fit()
    style.legend_above(figure, *panels.values())
    text = _caption(material, arms, swings, magnification) + _mode_words(modes)
    origin = "measured and computed" if shapes else "measured"
    return style.drawing(figure, key, "How the tip swings at its resonances", text, origin)


@dataclass(frozen=True)
class KnownModes:
    """Modes of an arm in a posture.

    Attributes:
        shapes: The modes, the lowest first.
        rigid: Axes whose gears count as rigid.
    """

    shapes: list[ModeShape]
    source: str
    rigid: tuple[int, ...]


def known_modes(bench: Bench, known: IdentifiedArm | None, angles_rad: Real, moving: tuple[int, ...]) -> KnownModes | None:
    """Return the modes of the bench's arm in a posture, if known.

    They come from the bodies of the links, or without those from identified masses. `angles_rad` has the shape (joints,); the
    stiffness of each `moving` axis must be known.
    """
    arm = bench.arm
    if arm is None:
        return None
    stiffness = {number: value for number, table in bench.axis.items() if (value := _stiffness_nm_rad(table)) is not None}
    if any(body.mass_kg > 0.0 for body in arm.bodies()) and stiffness and set(moving) <= set(stiffness):
        shapes, source = mode_shapes(arm, angles_rad, stiffness), "the masses in the bench file and the gears' stiffness"
    elif known is not None and set(moving) <= set(known.axes) <= set(arm.axes) and len(known.masses) == PER_LINK * len(arm.axes):
        others = [row for row, axis in enumerate(arm.axes) if axis not in known.axes]
        joints = np.array(angles_rad)
        joints[others] = np.radians(known.joints_deg)[others]
        matrix = np.asarray(regressor(Kinematics.of(arm), joints) @ np.array(known.masses))
        stiffness = dict(zip(known.axes, known.stiffness_nm_rad, strict=True))
        shapes, source = (
            mode_shapes(arm, joints, stiffness, matrix),
            f"the masses and stiffness identified in {known.postures} postures",
        )
    else:
        return None
    return KnownModes(shapes[:MOST_SWINGS], source, tuple(axis for axis in sorted(arm.axes) if axis not in stiffness))


def _stiffness_nm_rad(table: AxisTable) -> float | None:
    """Return the stiffness of a gear at the joint, None if unknown."""
    if table.gear_stiffness_nm_rad is not None or table.model is None:
        return table.gear_stiffness_nm_rad
    return table.model.gear_stiffness_nm_rad


def _draw_spectrum(panel: Axes, arms: list[MovedArm], found: list[float], band_hz: tuple[float, float]) -> None:
    for moved in arms:
        frequency, amplitude = spectrum_mm(moved.moved_mm, moved.run.recording.period_s, moved.judged)
        shown = frequency <= SHOWN_HZ * band_hz[1]
        panel.plot(frequency[shown], amplitude[shown], label=moved.run.label, **moved.run.look)
    for hz in found:
        style.flag(panel, hz, f"{hz:.1f} Hz")
    panel.set(xlabel="Frequency (Hz)", ylabel="Tip (mm)", xlim=(0.0, SHOWN_HZ * band_hz[1]))
    panel.set_ylim(0.0, 1.15 * panel.get_ylim()[1])


class _Stage:
    """Panels with the arm in its most telling views of one scale."""

    def __init__(self, kinematics: Kinematics, arms: list[MovedArm], magnification: float) -> None:
        self._kinematics, self._arms, self._magnification = kinematics, arms, magnification
        self._panels: list[tuple[Axes, View]] = []
        self._points_m: list[Real] = []

    def draw_swing(self, panel: Axes, swings: list[Swing]) -> None:
        """Draw the arm and the ellipse of its tip at a resonance."""
        if not swings:
            panel.set_axis_off()
            return
        view = fullest(np.stack(swings[0].half_axes_mm))
        skeleton = self._draw_arm(panel, view, self._arms[0].angles_rad[swings[0].row])
        for moved, each in zip(self._arms, swings, strict=True):
            ellipse = view.flat(skeleton[-1] + 1e-3 * self._magnification * each.ellipse_mm())
            panel.plot(*ellipse, zorder=7, **{**moved.run.look, "linewidth": 1.6})
        lengths = " → ".join(f"{float(np.linalg.norm(each.half_axes_mm[0])):.4f}" for each in swings)
        panel.set_title(f"{swings[0].frequency_hz:.1f} Hz: {lengths} mm")

    def draw_mode(self, panel: Axes, angles_rad: Real, modes: list[ModeShape]) -> None:
        """Draw the arm deflected by a mode to either side, if any."""
        if not modes:
            panel.set_axis_off()
            return
        self._draw_arm(panel, ANGLE, angles_rad, strength=0.4)
        for sign, look in ((1.0, DEFLECTED), (-1.0, OTHER_WAY)):
            deflected = self._kinematics.skeleton(angles_rad + sign * DEFLECTION_M * modes[0].joints_rad)
            draw_skeleton(panel, ANGLE, deflected, look=look)
        panel.set_title(f"Mode at {modes[0].frequency_hz:.1f} Hz, computed")

    def _draw_arm(self, panel: Axes, view: View, angles_rad: Real, strength: float = 1.0) -> Real:
        skeleton = self._kinematics.skeleton(angles_rad)
        draw_ground(panel, view)
        draw_skeleton(panel, view, skeleton, strength=strength)
        draw_directions(panel, view)
        self._panels.append((panel, view))
        self._points_m += [skeleton, skeleton[-1] + ELLIPSE_M * np.concatenate([np.eye(3), -np.eye(3)])]
        return skeleton

    def fit(self) -> None:
        """Give all panels one scale."""
        fit_limits(self._panels, np.concatenate(self._points_m))


def _caption(material: Material, arms: list[MovedArm], swings: list[list[Swing]], magnification: float) -> str:
    words = "; ".join(_swing_words(each) for each in swings[0])
    return (
        f"Above: amplitude spectrum (Hann) of the tip's displacement, all directions together, {line_words(material)}. Below: "
        f"the arm where the tip swung most at each peak, and the ellipse of the tip there, {magnification:g} times as large. It "
        f"follows from the recorded amplitudes and phases along x, y and z, and shows how the tip swings, not how the arm "
        f"bends. {arms[0].run.label.capitalize()}: {words}."
    )


def _swing_words(each: Swing) -> str:
    long, short = each.half_axes_mm
    length, width = float(np.linalg.norm(long)), float(np.linalg.norm(short))
    unit = long / max(length, 1e-300) * math.copysign(1.0, float(long[np.argmax(np.abs(long))]))
    direction = vector_text((np.round(unit, 2) + 0.0).tolist())  # a zero without a sign
    return f"{each.frequency_hz:.1f} Hz, {length:.4f} mm along {direction} and {width:.4f} mm across"


def _mode_words(modes: KnownModes | None) -> str:
    if modes is None:
        return " The arm's modes are not drawn: they need the masses of its links and the stiffness of its gears."
    axes = ", ".join(map(str, modes.rigid))
    held = f" Gears of axes {axes}, whose stiffness is not known, count as rigid." if modes.rigid else ""
    frequencies = ", ".join(f"{mode.frequency_hz:.1f}" for mode in modes.shapes)
    return (
        f" In the last row the arm's modes, all motors held, in the first of these postures: {frequencies} Hz, computed from "
        f"{modes.source}. Each is drawn with the tip {1e3 * DEFLECTION_M:.0f} mm to either side.{held}"
    )
