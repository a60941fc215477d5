"""Figures of the variable notch, its loop, and margins over speed.

They correspond to the paper's Figs. 10, 11 and 12.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from hil.analysis import motor_speed_rps
from hil.control.angles import ARCSEC
from hil.control.arrays import Real
from hil.control.notch import NOTCH_TRAPEZOID, Notch, notch_weight
from hil.design.frequency import Loop, Margins, acceleration_bound, margins
from hil.design.notch_problem import Requirements
from hil.experiments.motions import CONSTANT_ACCELERATION
from hil.report import style
from hil.report.material import Material, treatment_name
from hil.report.style import Drawing
from hil.report.tables.paper_runs import filters_end
from hil.results.acted import FilterSet
from hil.robot_tables import NotchTable

FAMILY = 11
"""Speeds in a bundle of curves."""
FEW = 5
"""Speeds in a family of curves that shall be told apart."""


@dataclass(frozen=True)
class NotchFigures:
    """Figures of filters that acted together.

    Attributes:
        nth: Which of the filters on the page these are, from 0.
    """

    material: Material
    filters: FilterSet
    nth: int = 0

    @cached_property
    def axes(self) -> tuple[int, ...]:
        """Axes with a model on which the filters acted."""
        return tuple(number for number in self.material.model_axes if number in self.filters.notches)

    @property
    def name(self) -> str:
        """End of a title, empty for the bench file's notch alone."""
        names = self.filters.treatments
        return "" if names == ("notch",) else f": {' and '.join(map(treatment_name, names))}"

    @property
    def speed_range_rps(self) -> tuple[float, float]:
        """Motor speeds around those at which the filters act."""
        notches = [notch for own in self.filters.notches.values() for notch in own]
        return 0.5 * min(notch.start_rps for notch in notches), 11.0 / 9.0 * max(notch.end_rps for notch in notches)

    @property
    def range_hz(self) -> tuple[float, float]:
        """Frequencies around those of the zeros."""
        notches = [notch for own in self.filters.notches.values() for notch in own]
        low = min(notch.order * notch.start_rps for notch in notches)
        return 0.625 * low, 25.0 / 18.0 * max(notch.order * notch.end_rps for notch in notches)

    @property
    def norm(self) -> Normalize:
        """Motor speeds of the first filter of each axis, for their colours."""
        return speed_norm([self.filters.notches[number][0] for number in self.axes])

    def schedules(self) -> Drawing | None:
        """Draw ζ_rd and filter frequencies, planned and reported, over speed; Fig. 10."""
        axes = sorted(self.filters.notches)
        figure, panels = style.panels(2, len(axes), 4.2, sharex=True, sharey="row", height_ratios=(2, 3))
        low, high = self.speed_range_rps
        speed = np.linspace(0.0, high, 1101)
        reported = 0
        for column, number in enumerate(axes):
            damping, frequency = panels[:, column]
            for index, table in enumerate(self.filters.notches[number]):
                _schedule(damping, frequency, table.notch(), speed, (low, high), with_names=index == 0)
            reported += self._reported(number, frequency)
            damping.set_title(f"Axis {number}")
            frequency.set(xlim=(low, high), xlabel="Motor speed $f_m$ (rev/s)")
        panels[0, 0].set(ylabel=r"Pole damping $\zeta_{rd}$ (–)", ylim=(0.0, 1.12 * panels[0, 0].get_ylim()[1]))
        panels[1, 0].set_ylabel("Frequency (Hz)")
        style.legend_above(figure, panels[1, 0], columns=5)
        dots = (
            " Dots: the zero frequency that the drive reported while it ran, over the measured motor speed."
            if reported
            else " No drive reported its filter's frequency in these runs."
        )
        key = f"schedules{filters_end(self.nth)}"
        caption = (
            "Above: the damping of the poles. The filter switches on between f_s and f_e, and off when the speed has left that "
            "range by the hysteresis (thin lines). Below: its zeros follow k f_m, its poles lie ω_d above." + dots
        )
        title = f"Variable parameters of the notch{self.name}"
        return style.drawing(figure, key, title, caption, "measured and computed" if reported else "computed", "Fig. 10")

    def _reported(self, number: int, panel: Axes) -> int:
        """Draw the filter frequency that the drive reported; 1 if any."""
        runs = (self.material.find(CONSTANT_ACCELERATION, number, name) for name in self.filters.treatments)
        run = next((run for run in runs if run is not None), None)
        recording = self.material.recording(run)
        if recording is None or f"axis{number}_notch_hz" not in recording.columns:
            return 0
        speed, zero = np.abs(motor_speed_rps(recording, number)), recording.axis(number, "notch_hz")
        rising = (zero > 0.0) & (np.arange(len(speed)) < int(np.argmax(speed)))
        if not rising.any():
            return 0
        speed, zero = style.thin(speed[rising], zero[rising], points=25)
        panel.plot(
            speed, zero, "o", color=style.BLACK, markerfacecolor=style.PAPER, markersize=3.8, label="zeros, reported by the drive"
        )
        return 1

    def families(self) -> Drawing | None:
        """Draw |F_n| and |G_al| from f_s to f_e; Fig. 11."""
        if not self.axes:
            return None
        figure, panels = style.panels(3, len(self.axes), 7.0, sharex="row", sharey="row", height_ratios=(2, 3, 3))
        low_hz, high_hz = self.range_hz
        frequency = np.linspace(low_hz, high_hz, 901)
        norm = self.norm
        for column, number in enumerate(self.axes):
            loop = self.material.loop(number, self.filters)
            notch = loop.notches[0]
            bound = self._bound(number, notch.order)
            gain, arm, line = panels[:, column]
            draw_family(gain, arm, loop, notch, norm, frequency)
            if bound is not None:
                arm.plot(frequency, bound(frequency), label="constraint (5)", **style.CONSTRAINT)
            _on_the_line(line, loop, notch, bound)
            gain.set_title(f"Axis {number}, k = {notch.order}")
            for panel in (gain, arm):
                panel.set(xlim=(low_hz, high_hz), xlabel="Frequency (Hz)")
            line.set_xlabel("Frequency on the line, k $f_m$ (Hz)")
        style.name_rows(panels, "Notch $|F_n|$ (dB)", r"$|G_{al}|$ (dB re 1/s²)", "$|G_{al}|$ on the line (dB re 1/s²)")
        style.legend_above(figure, panels[2, 0])
        colour_bar(figure, panels[:2], norm)
        key = f"families{filters_end(self.nth)}"
        caption = (
            f"Filters frozen at {FEW} motor speeds from f_s (faint) to f_e (strong). Middle: dots mark each curve at its own "
            "harmonic ω = 2π k f_m, the only frequency of the transmission error at that speed. Only there must constraint (5), "
            "|G_al| ≤ A_acc ω²/(L A_k), hold. Bottom: the same dots for all speeds as one curve, without and with the notch, at "
            "constant speed."
        )
        title = f"Gain of the notch and of G_al{self.name}"
        return style.drawing(figure, key, title, caption, "computed", "Fig. 11", is_zoomable=True)

    def _bound(self, number: int, order: int) -> Any:
        """Return constraint (5) in dB as a function of frequency."""
        amplitude = self.material.amplitude_arcsec(number, order) * ARCSEC
        if amplitude <= 0.0:
            return None
        lever, limit = self.material.bench.axis[number].tip_lever_m, 1e-3 * self.material.bench.specification.tip_mm
        return lambda frequency: style.decibel(acceleration_bound(frequency, amplitude, lever, limit))

    def nyquist(self) -> Drawing | None:
        """Draw the open loop, whole and near −1; Fig. 12."""
        if not self.axes:
            return None
        if len(self.axes) == 1:  # one above the other, two square panels would leave half of the page empty
            figure, beside = style.panels(1, 2, 4.4)
            panels = beside.T
        else:
            figure, panels = style.panels(2, len(self.axes), 7.4, sharex="row", sharey="row")
        norm = self.norm
        low_hz, high_hz = self.range_hz
        grid = np.geomspace(1.0, 0.49 / self.material.control_period_s, 700)
        peaks = []
        for column, number in enumerate(self.axes):
            loop = self.material.loop(number, self.filters)
            notch = loop.notches[0]
            whole, near = panels[:, column]
            drawn = {speed: margins(loop, speed, points=1000) for speed, _ in _speeds(notch, norm)}
            found = {**self.material.margins(number, self.filters), **drawn}
            worst_rps = max(found, key=lambda speed: found[speed].sensitivity_peak)
            worst = found[worst_rps].sensitivity_peak
            peaks.append(f"{worst:.2f} at {worst_rps:.2f} rev/s (axis {number})")
            for speed, colour in _speeds(notch, norm):
                response = _open_loop(loop, speed, grid, notch.order, (low_hz, high_hz))
                for panel in (whole, near):
                    panel.plot(response.real, response.imag, color=colour, linewidth=0.6)
            response = _open_loop(loop, worst_rps, grid, notch.order, (low_hz, high_hz))
            for panel in (whole, near):
                draw_worst(panel, response, "the worst speed")
            for panel in (whole, near):
                draw_critical_point(panel, (1.0 / worst, "1/$M_s$ around −1", CLOSEST))
            whole.set(xlim=(-5.0, 5.0), ylim=(-5.0, 4.0), title=f"Axis {number}")
            near.set(
                xlim=(-1.9, 0.3),
                ylim=(-1.2, 0.8),
                title=f"Axis {number}, near −1: worst at {worst_rps:.2f} rev/s",
                xticks=[-1.5, -1.0, -0.5, 0.0],
            )
        for panel in panels[:, 0]:
            panel.set_ylabel("Imaginary part (–)")
        style.legend_above(figure, panels[0, 0])
        colour_bar(figure, panels, norm)
        key = f"nyquist{filters_end(self.nth)}"
        caption = (
            f"Nyquist diagrams of L(jω) with the filter frozen at motor speeds from f_s (faint) to f_e (strong), sampled at "
            f"{1e6 * self.material.loop(self.axes[0], self.filters).period_s:.0f} µs; cross: −1. The dashed circle around it "
            "has the radius 1/M_s, the smallest distance at any speed, which the thick curve reaches at the dot: "
            f"M_s = {', '.join(peaks)}."
        )
        title = f"Open loop with the notch{self.name}"
        return style.drawing(figure, key, title, caption, "computed", "Fig. 12", is_zoomable=True)

    def margin_curves(self) -> Drawing | None:
        """M_s, gain margin and phase margin over the motor speed."""
        if not self.axes:
            return None
        figure, panels = style.panels(1, 3, 2.5, sharex=True)
        stable, counts = True, list[str]()
        for number, line in zip(self.axes, style.AXIS_LINES, strict=False):
            by_speed = self.material.margins(number, self.filters)
            stable = stable and all(margin.stable for margin in by_speed.values())
            speeds = list(by_speed)
            draw_margins(panels[0], by_speed, label=f"axis {number}", markevery=4, **line)
            counts.append(f"{len(speeds)} speeds from {speeds[0]:g} to {speeds[-1]:g} rev/s")
        asked = Requirements()
        draw_required_margins(panels[0], asked, max(11.0, self.speed_range_rps[1]), "required of a design")
        low, high = panels[0, 0].get_ylim()
        panels[0, 0].set_ylim(min(1.0, low), max(2.0, high))
        for panel in panels[0, 1:]:
            panel.set_ylim(0.0, 1.12 * panel.get_ylim()[1])
        style.legend_above(figure, panels[0, 0])
        verdict = (
            "inside the unit circle at every one of these speeds: the loop is stable throughout"
            if stable
            else "OUTSIDE the unit circle at one or more of these speeds: the loop is unstable there"
        )
        key = f"margins{filters_end(self.nth)}"
        caption = (
            f"Peak of the sensitivity |1/(1 + L)|, gain margin and phase margin with the filter frozen at "
            f"{counts[0]}. All closed-loop poles of the sampled loop lie {verdict}. Dotted: what `hil design notch` requires, "
            f"M_s ≤ {asked.max_sensitivity:g}, {asked.gain_margin_db:g} dB and {asked.phase_margin_deg:g}°; "
            "the paper requires only stability."
        )
        title = f"Stability margins at all motor speeds{self.name}"
        return style.drawing(figure, key, title, caption, "computed", "with Fig. 12", is_zoomable=True)


def _schedule(damping: Axes, frequency: Axes, notch: Notch, speed: Real, shown: tuple[float, float], *, with_names: bool) -> None:
    inside = speed[(speed >= notch.start_rps) & (speed <= notch.end_rps)]
    weight = np.array([notch_weight(notch.mode, f, notch.start_rps, notch.end_rps, notch.ramp_rps) for f in inside])
    zeta = notch.zeta_rn + weight * (notch.zeta_rdth - notch.zeta_rn)
    damping.plot(inside, zeta, color=style.BLUE, linewidth=1.6)
    damping.axhline(notch.zeta_rn, **style.MARK)
    at = shown[1] - 0.011 * (shown[1] - shown[0]), notch.zeta_rn
    style.name_at(damping, rf"$\zeta_{{rn}}$ = {notch.zeta_rn:g}", at, (0, 3), ha="right")
    for edge, outside, text, side in (
        (notch.start_rps, notch.start_rps - notch.hysteresis_rps, f"$f_s$ = {notch.start_rps:g} rev/s", "right"),
        (notch.end_rps, notch.end_rps + notch.hysteresis_rps, f"$f_e$ = {notch.end_rps:g} rev/s", "left"),
    ):
        if notch.mode != NOTCH_TRAPEZOID:
            damping.plot([edge, edge], [0.0, notch.zeta_rdth], color=style.BLUE, linewidth=1.6)
            damping.plot([outside, outside, edge], [0.0, notch.zeta_rdth, notch.zeta_rdth], color=style.BLUE, linewidth=0.7)
        pad = -3 if side == "right" else 3
        style.name_at(damping, text, (outside, notch.zeta_rdth), (pad, -2), ha=side, va="top")
    names = ("zeros, k $f_m$", r"poles, k $f_m + \omega_d/2\pi$") if with_names else (None, None)
    frequency.plot(inside, notch.order * inside, color=style.BLUE, label=names[0])
    frequency.plot(inside, notch.order * inside + weight * notch.offset_hz, label=names[1], **style.MODEL)


def draw_family(gain: Axes, arm: Axes, loop: Loop, notch: Notch, norm: Normalize, frequency_hz: Real) -> None:
    """Draw |F_n| and |G_al| at a few speeds of a filter.

    A dot above all curves marks each |G_al| at the harmonic of its speed, ω/2π = k f_m. The speeds are from f_s to f_e of
    `notch`; frequencies have the shape (n,).
    """
    edge: style.Line = {"markeredgecolor": style.PAPER, "markeredgewidth": 0.8}
    for speed, colour in _speeds(notch, norm, FEW):
        response = style.decibel(loop.acceleration_per_transmission_error(frequency_hz, speed))
        gain.plot(frequency_hz, style.decibel(loop.notch_response(frequency_hz, speed)), color=colour, linewidth=0.8)
        arm.plot(frequency_hz, response, color=colour, linewidth=0.8)
        here = notch.order * speed
        arm.plot([here], [np.interp(here, frequency_hz, response)], "o", color=colour, markersize=6.0, zorder=5, **edge)


def on_the_line_db(loop: Loop, order: int, speeds_rps: Real) -> Real:
    """Return |G_al| on the line ω = 2π k f_m in dB, each at its own speed; shape (n,)."""
    pairs = zip(order * speeds_rps, speeds_rps, strict=True)
    return style.decibel(np.array([loop.acceleration_per_transmission_error(np.array([f]), float(v))[0] for f, v in pairs]))


MARGINS = (("sensitivity_peak", "$M_s$ (–)"), ("gain_margin_db", "Gain margin (dB)"), ("phase_margin_deg", "Phase margin (°)"))
"""Margins by their fields, and the names of their panels."""


def draw_margins(panels: style.Panels, by_speed: Mapping[float, Margins], **look: Any) -> None:
    """Draw M_s, gain and phase margin over the motor speed, each in its panel."""
    for panel, (field, name) in zip(panels, MARGINS, strict=True):
        values = [getattr(each, field) for each in by_speed.values()]
        panel.plot(list(by_speed), [value if math.isfinite(value) else math.nan for value in values], **look)
        panel.set(xlabel="Motor speed $f_m$ (rev/s)", ylabel=name)


def draw_required_margins(panels: style.Panels, asked: Requirements, up_to_rps: float, name: str) -> None:
    """Draw the limits of M_s, gain and phase margin, up to a motor speed."""
    for panel, limit in zip(panels, (asked.max_sensitivity, asked.gain_margin_db, asked.phase_margin_deg), strict=True):
        panel.axhline(limit, label=name, **style.LIMIT)
        panel.set_xlim(0.0, up_to_rps)


def _on_the_line(panel: Axes, loop: Loop, notch: Notch, bound: Any) -> None:
    speed = np.linspace(max(0.5, notch.start_rps - 1.2), notch.end_rps + 1.2, 261)
    here = notch.order * speed
    bare = loop.acceleration_per_transmission_error(here)
    panel.plot(here, style.decibel(bare), label="without notch", **style.WITHOUT)
    panel.plot(here, on_the_line_db(loop, notch.order, speed), label="with notch", **style.WITH)
    if bound is not None:
        panel.plot(here, bound(here), label="constraint (5)", **style.CONSTRAINT)
    panel.set_xlim(here[0], here[-1])
    style.flag(panel, notch.order * notch.start_rps, "k $f_s$", side="right")
    style.flag(panel, notch.order * notch.end_rps, "k $f_e$", height=0.12)


WORST: style.Line = {"color": style.VERMILLION, "linestyle": "-", "linewidth": 1.8}
"""Line of the speed at which the loop comes closest to −1."""
CLOSEST: style.Line = {"color": style.VERMILLION, "linewidth": 1.1, "linestyle": (0, (4, 1.6))}
"""Line of the circle around −1 that the loop touches."""


def draw_worst(panel: Axes, response: Any, name: str) -> None:
    """Draw the open loop of the worst speed, with a dot.

    The worst speed is that of the shortest distance to −1, which the dot marks. The response has the shape (n,).
    """
    closest = response[int(np.argmin(np.abs(1.0 + response)))]
    panel.plot(response.real, response.imag, label=name, **WORST)
    panel.plot([closest.real], [closest.imag], "o", color=style.VERMILLION, markersize=4.5, zorder=5)


def draw_critical_point(panel: Axes, *circles: tuple[float, str, style.Line]) -> None:
    """Draw the unit circle and −1, with circles around it, in a Nyquist diagram."""
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    panel.plot(np.cos(angle), np.sin(angle), label="unit circle", **style.MARK)
    for radius, name, look in circles:
        panel.plot(-1.0 + radius * np.cos(angle), radius * np.sin(angle), label=name, **look)
    panel.plot([-1.0], [0.0], "+", color=style.BLACK, markersize=8, markeredgewidth=1.4)
    panel.set_aspect("equal")
    panel.set_xlabel("Real part (–)")


def _open_loop(loop: Loop, speed_rps: float, grid: Real, order: int, range_hz: tuple[float, float]) -> Any:
    """Return L(jω) at a frozen speed, on a grid that suits it."""
    here = order * speed_rps
    around = np.linspace(0.85 * here, 1.15 * here, 201)
    return loop.open_loop(
        np.unique(np.concatenate([grid, around, np.linspace(1.6 * range_hz[0], 1.2 * range_hz[1], 700)])), speed_rps
    )


def speed_norm(notches: Sequence[Notch | NotchTable]) -> Normalize:
    """Speeds from the least f_s to the greatest f_e, for their colours."""
    return Normalize(min(notch.start_rps for notch in notches), max(notch.end_rps for notch in notches))


def _speeds(notch: Notch, norm: Normalize, count: int = FAMILY) -> Iterator[tuple[float, Any]]:
    """Speeds from f_s to f_e, with their colours."""
    for speed in np.linspace(notch.start_rps, notch.end_rps, count):
        yield float(speed), style.SPEED_COLOURS(norm(speed))


def colour_bar(figure: Figure, panels: style.Panels, norm: Normalize, shrink: float = 0.5) -> None:
    """Draw the colours of the speeds beside some panels."""
    bar = figure.colorbar(ScalarMappable(norm, style.SPEED_COLOURS), ax=list(panels.flat), shrink=shrink, aspect=30, pad=0.02)
    bar.set_label("Motor speed $f_m$ (rev/s)")
