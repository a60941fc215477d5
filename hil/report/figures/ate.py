"""Figures and tables of an identified transmission error.

They correspond to the paper's Figs. 5, 7, 8 and Table 2.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy
from markupsafe import Markup

from hil.bench.model import IdentifiedError
from hil.control.angles import ARCSEC
from hil.control.arrays import Real
from hil.control.order_keys import amplitude_key, phase_key
from hil.design.ate.model import Arm, Sensing, Sweep, modelled
from hil.design.paper import TABLE_2
from hil.design.transmission_error import TransmissionError
from hil.recording import Recording
from hil.report import style
from hil.report.order_names import order_words, symbol, symbol_of
from hil.report.origin import origin_of
from hil.report.plotted_run import FEWEST, draw_passage, passage_panels, spread_arcsec
from hil.report.report_table import Cell, Mark, ReportTable, number, value_and_error
from hil.report.style import Drawing
from hil.results.ate import AteResult, AteRun

AROUND = (0.75, 1.3)
"""Motor speeds of a window, by that at which its order meets the resonance."""
SPEED_HZ = 20.0
ROOM_FOR_NAMES = 0.2
"""Height that is added above the curves for the names of the resonant speeds, as a fraction of theirs."""
TURNS = {1: "forwards", -1: "backwards"}


@dataclass(frozen=True)
class DrawnPass:
    """One pass as it is drawn; all of shape (n,).

    Attributes:
        speed_rps: Motor speed f_m, with its sign.
        measured: Signal in the fit's band.
        model: Prediction of the model in that band.
        direction: +1 and −1 in the rows of the ramps, else 0.
    """

    time_s: Real
    speed_rps: Real
    measured: Real
    model: Real
    direction: Real


class AteMaterial:
    """Material of the page: the result, and its passes in the fit's band."""

    def __init__(self, directory: Path, result: AteResult) -> None:
        self.directory, self.result = directory, result
        self.axis, self.is_sensorless = result.axis, result.sensorless

    @property
    def part(self) -> IdentifiedError | None:
        """Transmission error that was identified, or None."""
        return self.result.ate

    @property
    def word(self) -> str:
        """Word for data of the robot: `measured`, or `emulated`."""
        return origin_of(self.result).word

    @property
    def is_paper(self) -> bool:
        """True for the paper's robot."""
        return self.result.bench.file.is_paper

    @property
    def unit(self) -> str:
        """Unit of the signal."""
        return "N·m" if self.is_sensorless else "m/s²"

    @property
    def signal_name(self) -> str:
        """Signal in words."""
        return "Motor torque" if self.is_sensorless else "Tip acceleration"

    @cached_property
    def passes(self) -> list[DrawnPass]:
        """Passes as they are drawn; empty without an identified error."""
        part, fit = self.part, self.result.fit
        if part is None or fit is None or part.arm_hz is None or part.damping is None:
            return []
        hz, damping = fit.arm_hz or part.arm_hz, fit.arm_damping or part.damping
        arm = Arm(hz, damping, fit.delay_s, fit.gear_fraction, others=self.result.known_before.others)
        ratio = self.result.bench.file.axis[self.axis].reduction_ratio
        return [self._drawn(each, arm, self.result.sensing, ratio, error_of(part), fit.band_hz) for each in self.result.passes]

    @property
    def furthest(self) -> int:
        """Index of the pass to draw."""
        ends = [each.end_rps or 0.0 for each in self.result.passes]
        return ends.index(max(ends))

    def _drawn(
        self,
        entry: AteRun,
        arm: Arm,
        sensing: Sensing,
        ratio: float,
        error: TransmissionError,
        band_hz: tuple[float, float],
    ) -> DrawnPass:
        recording = Recording.load(self.directory / entry.recording)
        time, period = recording.time_s, recording.period_s
        angle = recording.axis(self.axis, "position_rad")
        measured = recording.axis(self.axis, "torque_nm") if self.is_sensorless else recording.felt_m_s2
        direction = np.zeros(len(time), dtype=np.int8)
        for from_s, sign in ((entry.forward_from_s, 1), (entry.backward_from_s, -1)):
            since = time - from_s
            direction[(since >= 0.0) & (since <= entry.ramp_s)] = sign
        model = modelled(Sweep(angle, measured, period, direction), ratio, sensing, arm, error)
        band = scipy.signal.butter(2, band_hz, "bandpass", fs=1.0 / period, output="sos")
        slow = scipy.signal.butter(2, min(SPEED_HZ, 0.2 / period), fs=1.0 / period, output="sos")
        speed = scipy.signal.sosfiltfilt(slow, np.gradient(angle, period)) / (2.0 * math.pi)
        seen, drawn = (scipy.signal.sosfiltfilt(band, values) for values in (measured, model))
        return DrawnPass(time, speed, seen, drawn, direction.astype(np.float64))


def error_of(part: IdentifiedError) -> TransmissionError:
    """θ_sync as a function of the motor angle."""
    return TransmissionError(part.values.amplitudes_arcsec(), part.values.phases_deg())


def shown_orders(part: IdentifiedError) -> list[float]:
    """Orders of the result, from that with the lowest resonant speed."""
    return sorted(part.values.amplitudes_arcsec(), reverse=True)


def waveform(axis: int, part: IdentifiedError | None, *, is_paper: bool = False) -> Drawing | None:
    """Draw θ_sync over two motor revolutions with its confidence; Fig. 5."""
    if part is None:
        return None
    error, key = error_of(part), f"waveform-axis{axis}"
    paper = TABLE_2.get(axis) if is_paper else None
    rows = 1 if paper is None else 2
    figure, panels = style.panels(rows, 1, 1.6 + 1.1 * rows, sharex=True, height_ratios=(5, 3)[:rows])
    panel, turns = panels[0, 0], np.linspace(0.0, 2.0, 721)
    angle = 2.0 * math.pi * turns
    middle = error.angle_rad(angle) / ARCSEC
    own = [{k: part.standard_error.get(key(k), 0.0) for k in error.amplitude_arcsec} for key in (amplitude_key, phase_key)]
    spread = spread_arcsec(error, own[0], own[1], turns)
    panel.fill_between(turns, middle - spread, middle + spread, color=style.SKY, alpha=0.6, label="± 2 standard errors")
    panel.plot(turns, middle, label="identified", **style.MEASURED)
    if paper is not None:
        panel.plot(turns, paper.angle_rad(angle) / ARCSEC, label="paper, Table 2", **style.MODEL)
        rest = panels[1, 0]
        rest.fill_between(turns, -spread, spread, color=style.SKY, alpha=0.6)
        style.residual(rest, turns, middle - paper.angle_rad(angle) / ARCSEC, "arcsec", "identified − paper")
        rest.set_ylabel("Residual (arcsec)")
    for turn in (1.0, 2.0):
        panel.axvline(turn, **style.MARK)
    panel.set_xlim(0.0, 2.0)
    panels[-1, 0].set_xlabel("Motor angle (rev)")
    panel.set_ylabel(r"$\theta_{sync}$ (arcsec)")
    style.legend_above(figure, panel)
    caption = (
        f"θ_sync at the arm over two motor revolutions: {order_words(error.amplitude_arcsec)} as identified, with two standard "
        "errors. Dotted lines: whole revolutions."
    )
    return style.drawing(figure, key, f"Synchronous transmission error of axis {axis}", caption, style.BOTH, "Fig. 5")


def against_speed(material: AteMaterial) -> Drawing | None:
    """The signal against the motor speed, both directions, measured and modelled."""
    if not material.passes:
        return None
    drawn, part, rest_name = material.passes[material.furthest], material.part, f"{material.word} − model"
    figure, panels = style.panels(4, 1, 5.9, sharex=True, height_ratios=(5, 3, 5, 3))
    for panel, rest, sign in zip(panels[::2, 0], panels[1::2, 0], (1, -1), strict=True):
        panel.sharey(panels[0, 0])
        rest.sharey(panels[1, 0])
        rows = drawn.direction == sign
        style.plot_thin(panel, np.abs(drawn.speed_rps[rows]), drawn.measured[rows], label=material.word, **style.BROAD)
        style.plot_thin(panel, np.abs(drawn.speed_rps[rows]), drawn.model[rows], label="model", **style.MODEL)
        if part is not None and part.arm_hz is not None:
            reached = float(np.max(np.abs(drawn.speed_rps)))
            for order in shown_orders(part):
                if (speed := part.arm_hz / order) <= reached:
                    style.flag(panel, speed, f"$f_a$/{order:g} = {speed:.2f} rev/s", side="right")
        panel.set_title(f"motor turning {TURNS[sign]}")
        if rows.any():
            style.residual(
                rest, np.abs(drawn.speed_rps[rows]), drawn.measured[rows] - drawn.model[rows], material.unit, rest_name
            )
        rest.set_ylabel(f"Residual ({material.unit})")
        panel.set_ylabel(f"{material.signal_name} ({material.unit})")
    low, high = panels[0, 0].get_ylim()
    panels[0, 0].set_ylim(low, high + ROOM_FOR_NAMES * (high - low))
    panels[-1, 0].set_xlabel("Motor speed (rev/s)")
    style.legend_above(figure, panels[0, 0])
    caption = (
        f"The {material.signal_name.lower()} of pass {material.furthest + 1} in the band of the fit, and the identified model's "
        "response to the measured motor angle, over motor speed. Below each: the residual, enlarged. Order k excites the arm's "
        "resonance at f_a/k."
    )
    title = f"{material.signal_name} against motor speed"
    return style.drawing(
        figure, "against-speed", title, caption, style.BOTH, "Fig. 7" if material.axis == 2 else "Fig. 8", is_zoomable=True
    )


def windows(material: AteMaterial, direction: int) -> Drawing | None:
    """Draw speed, signal and spectrum around f_m2 and f_m4; Figs. 7, 8."""
    part = material.part
    if not material.passes or part is None or part.arm_hz is None:
        return None
    drawn = material.passes[material.furthest]
    orders = [k for k in shown_orders(part) if np.max(np.abs(drawn.speed_rps)) >= part.arm_hz / k] or shown_orders(part)[-1:]
    figure, panels = passage_panels(len(orders), material.signal_name, material.unit)
    speed = np.abs(drawn.speed_rps)
    for column, order in enumerate(orders):
        centre = part.arm_hz / order
        rows = (drawn.direction == direction) & (speed >= AROUND[0] * centre) & (speed <= AROUND[1] * centre)
        panels[0, column].set_title(f"k = {order:g}: {AROUND[0] * centre:.1f} to {AROUND[1] * centre:.1f} rev/s")
        if np.count_nonzero(rows) < FEWEST:
            style.note(panels[0, column], "the run did not reach these speeds")
            continue
        passage = drawn.time_s, speed, drawn.measured, drawn.model
        draw_passage(panels[:, column], passage, rows, rows, material.unit, material.word)
    panels[3, 0].set_ylim(0.0, None)  # once all are drawn: the row has one scale
    style.legend_above(figure, panels[1, 0])
    key = f"windows-{TURNS[direction]}"
    caption = (
        f"Constant acceleration of one motor in pass {material.furthest + 1}. Top: its speed. Middle: the signal in the band of "
        "the fit. Dashed: response of the identified transmission error and arm to the measured motor angle; below it the "
        "residual, enlarged. Bottom: amplitude spectrum (Hann window, interpolated between its bins)."
    )
    title = f"Axis {material.axis} through its resonant speeds, {TURNS[direction]}"
    paper = {2: "Fig. 7", 3: "Fig. 8"}.get(material.axis, "as Figs. 7 and 8")
    return style.drawing(figure, key, title, caption, style.BOTH, paper, is_zoomable=True)


def errors(
    axis: int, part: IdentifiedError | None, *, is_sensorless: bool = False, is_paper: bool = False
) -> ReportTable | None:  # fmt: skip
    """Tabulate a transmission error, for the paper's robot beside Table 2."""
    if part is None:
        return None
    rows: list[list[Cell]] = []
    paper = TABLE_2.get(axis) if is_paper else None
    in_table_2 = None if paper is None else {"A": paper.amplitude_arcsec, "φ": paper.phase_deg}
    for each in part.numbers():
        form = "{:.3f}" if each.letter == "A" else "{:.2f}"
        printed = [] if in_table_2 is None else [number(in_table_2[each.letter].get(each.order), "{:g}")]
        shown = [number(each.value, form), number(each.error, form)]
        rows.append([symbol(each.letter, each.order), each.unit, *printed, *shown])
    header = ("Parameter", "Unit", *([] if paper is None else ["Paper"]), "Identified", "Standard error")
    caption = (
        "The standard error covers noise only. "
        + (
            "Without an accelerometer a relative error of J_l appears unchanged in the amplitudes, "
            if is_sensorless
            else "A relative error of the tip lever appears unchanged in the amplitudes, "
        )
        + "an error of the motor angle's zero in the phases."
    )
    title = f"Parameters of the synchronous transmission error of axis {axis}"
    return ReportTable(f"table-2-axis{axis}", title, header, rows, {0, 1}, caption, paper="Table 2")


def arm(material: AteMaterial) -> ReportTable | None:
    """Table of the arm and of the alignment in time."""
    part, fit = material.part, material.result.fit
    if part is None or fit is None:
        return None
    errors = part.standard_error
    torsion = "" if part.torsion_arcsec is None else f", at a torsion of {part.torsion_arcsec:.3g} arcsec"
    delays_s = fit.delay_s if material.is_sensorless else part.accelerometer_delay_s, fit.delay_error_s
    motion = (number(fit.motion_scale, "{:.3f}"), number(fit.motion_scale_error, "{:.3f}"))
    late = "torque" if material.is_sensorless else material.result.bench.file.accelerometer.title
    carried = sorted((fit.carried or {}).items(), key=lambda each: -each[1])
    orders: list[list[Cell]] = [[f"of it order {order}", "%", number(100.0 * each, "{:.0f}"), ""] for order, each in carried]
    rows: list[list[Cell]] = [
        [f"f_a, arm on its gear{torsion}", "Hz", number(part.arm_hz, "{:.3f}"), number(errors.get("arm_hz"), "{:.3f}")],
        ["its damping ζ", "", number(part.damping, "{:.4f}"), number(errors.get("damping"), "{:.4f}")],
        [f"delay of the {late} behind the motor angle", "ms", *(number(1e3 * each, "{:.3f}") for each in delays_s)],
        ["gain of the motor's own motion (1: lever and ratio are right)", "", *motion],
        ["share of the vibration that θ_sync explains", "%", number(100.0 * fit.explained_by_error, "{:.2f}"), ""],
        *orders,
        ["residual in the band", material.unit, number(fit.residual, "{:.4f}"), ""],
    ]
    caption = (
        f"The gear is assumed to cause {100.0 * fit.gear_fraction:.0f} % of the damping. A change of this fraction by 0.1 "
        "changes only the delay, by 0.2 ζ/ω, about 0.1 ms."
    )
    return ReportTable("arm", "Arm and time alignment", ("", "Unit", "Found", "Standard error"), rows, {0, 1}, caption)


def arm_twice(material: AteMaterial) -> ReportTable | None:
    """Tabulate the arm as known before, beside the arm from the ramps."""
    part, known = material.part, material.result.known_before
    if part is None or known.start is None or part.arm_hz is None or part.damping is None:
        return None
    start, errors = known.start, part.standard_error
    pairs = (
        ("f_a, arm on its gear", "Hz", start.resonance_hz, known.resonance_error_hz, part.arm_hz, errors.get("arm_hz")),
        ("its damping ζ", "", start.damping, known.damping_error, part.damping, errors.get("damping")),
    )
    rows: list[list[Cell]] = []
    for name, unit, before, before_error, now, now_error in pairs:
        texts = (" ± ".join(value_and_error(value, error or 0.0)) for value, error in ((before, before_error), (now, now_error)))
        sigma = None if before_error is None or now_error is None else abs(now - before) / math.hypot(before_error, now_error)
        words = "not known" if sigma is None else "explains it" if sigma <= FAR_SIGMA else "does not explain it"
        mark = Mark(True if words == "explains it" else None, words)
        rows.append([name, unit, *texts, number(100.0 * (now / before - 1.0), "{:+.2f}"), number(sigma, "{:.1f}"), mark])
    differences = ("Difference (%)", "Difference (standard errors of noise)", "Noise alone")
    header = ("", "Unit", f"Before ({known.source})", "Now (ramps)", *differences)
    caption = (
        "Both standard errors cover noise only. A difference of more than three is not noise but an error of a model: one run "
        "excites the arm by motor torque, the other by the transmission error, at another amplitude. The difference in percent "
        "then shows better how well f_a is known."
    )
    title = "The arm: both identifications compared"
    return ReportTable("arm-twice", title, header, rows, {0, 1, 6}, caption)


FAR_SIGMA = 3.0
"""Standard errors from which two estimates differ by more than noise."""


def agreement(material: AteMaterial) -> ReportTable | None:
    """Table of both directions against each other."""
    fit = material.result.fit
    if fit is None:
        return None
    rows: list[list[Cell]] = []
    for each in fit.agreement:
        numbers = (number(each.forward, "{:.3f}"), number(each.backward, "{:.3f}"), number(each.sigma, "{:.1f}"))
        rows.append([symbol_of(each.name), *numbers, Mark(each.sigma <= 4.0)])
    header = ("", "Forwards", "Backwards", "Difference (standard errors of noise)", "Agree")
    caption = "Amplitudes and phases from the ramps of each direction alone, with the arm and delay of the joint fit." + (
        ""
        if fit.miss is None
        else f" The standard errors contain the {100.0 * fit.miss:.2g} % of the vibration that the model misses."
    )
    return ReportTable("agreement", "Both directions compared", header, rows, {0, 4}, caption)


def passes(material: AteMaterial) -> ReportTable:
    """Table of every pass, and the standard errors after it."""
    history = material.result.history or ()
    part = material.part
    names = [] if part is None else [(each.name, symbol(each.letter, each.order), each.unit) for each in part.numbers()]
    rows: list[list[Cell]] = []
    for index, each in enumerate(material.result.passes):
        after = history[index] if index < len(history) else None
        rows.append(
            [
                str(index + 1),
                number(each.acceleration_rps_s, "{:.2f}"),
                number(each.end_rps, "{:.2f}"),
                f"{each.low_rev:.1f} … {each.high_rev:.1f}".replace("-", "−"),
                number(each.sensor_missed + each.missed_cycles, "{:d}"),
                *(number(None if after is None else after.standard_error.get(name), "{:.3f}") for name, _, _ in names),
                each.recording if each.stopped is None else "stopped",
            ]
        )
    columns = (Markup("{} ± ({})").format(sign, unit) for _, sign, unit in names)
    header = ("Pass", "Acceleration (rev/s²)", "Top speed (rev/s)", "Travel (rev)", "Missed", *columns, "Recording")
    caption = "Each pass goes forwards and back; the standard errors are those of all passes so far."
    return ReportTable("passes", "Passes", header, rows, {0, len(header) - 1}, caption)
