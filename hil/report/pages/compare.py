"""The page of a comparison, with its figures: one self-contained HTML file."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drive_profiles.errors import FileError
from hil.analysis import band_passed, motor_speed_rps
from hil.bench.bench import load_bench
from hil.experiments.motions import LINE_MOTION, POINT_TO_POINT
from hil.experiments.treatment import TITLES
from hil.recording import Recording
from hil.report import plotted_run as plotted
from hil.report import style
from hil.report.figures import shapers as figures_shapers
from hil.report.figures.arm_along_line import arm_along_line
from hil.report.figures.arm_swinging import arm_swinging
from hil.report.figures.directions import direction_table, directions_of
from hil.report.figures.order_map import MarkedResonance, order_maps
from hil.report.material import Material, case_name
from hil.report.origin import origin_of_table
from hil.report.pages.page import Card, CardStep, Item, Page, PageHead, PageVerdict, Section, filled_sections, versions_text
from hil.report.report_table import Mark
from hil.report.report_table import number as number_text
from hil.report.style import Drawing
from hil.report.tables import compare as tables_compare
from hil.report.tables.compare import cases, key_of, treatment_words
from hil.results.comparison import ComparisonRobot, ComparisonRow, TourResult, TreatmentTable

OVERLAID = 4
"""Largest number of lines in one diagram; beyond it each treatment has its own, with the untreated run behind it."""
MAPPED = 6
"""Largest number of order maps in one figure."""
BEHIND: style.Line = {"color": style.ORANGE, "linestyle": "-", "linewidth": 0.9, "alpha": 0.75}


@dataclass(frozen=True)
class ComparedMotion:
    """Figures of a motion of a robot with every treatment.

    Attributes:
        axis: Axis of a motion of one axis, else None.
        several: True if the comparison has more than one robot.
    """

    robot: ComparisonRobot
    material: Material
    experiment: str
    axis: int | None
    several: bool

    @property
    def key(self) -> str:
        """End of the keys of its figures and tables."""
        return f"{self.robot.directory}-{key_of(self.experiment, self.axis)}"

    @property
    def title(self) -> str:
        """Beginning of the titles of its figures and tables."""
        case = case_name(self.experiment, self.axis)
        return f"{self.robot.name}, {case}" if self.several else f"{case[0].upper()}{case[1:]}"

    @cached_property
    def runs(self) -> list[tuple[ComparisonRow, plotted.PlottedRun]]:
        """Rows of the motion with their recorded runs."""
        case = self.experiment, self.axis
        rows = [row for row in self.robot.rows if (row.experiment, row.axis) == case and row.recording is not None]
        found = ((row, self.material.find(*case, row.treatment, row.loop)) for row in rows)
        drawn = ((row, plotted.plotted_run(self.material, one, treatment_words(row), style.WITH)) for row, one in found)
        return [(row, run) for row, run in drawn if run is not None]

    def vibration(self) -> Drawing | None:
        """Draw the band-passed tip acceleration of all treatments, with the limit."""
        if len(self.runs) < 2:
            return None
        material, axis = self.material, self.axis
        f_al, band = material.f_al(axis), material.band_hz(axis)
        overlaid = len(self.runs) <= OVERLAID
        figure = self._overlay(f_al, band) if overlaid else self._multiples(f_al, band)
        limit = "Without a model the specification cannot be converted to an acceleration."
        if f_al is not None:
            limit = f"Dotted: the specification of ±{self.robot.tip_mm:g} mm as an acceleration at f_al = {f_al:.2f} Hz."
        elif material.bench.arm is not None:
            limit = "The peaks of the displacement, which is the acceleration integrated twice, are in the table."
        below = " Below: their envelopes, which separate lines that overlap above." if overlaid else ""
        behind = below if overlaid else " Orange, behind each: no treatment, with the loop closed in the same place."
        caption = (
            f"{plotted.direction_words(material, axis).capitalize()}, band-passed {band[0]:.3g} to {band[1]:.3g} Hz with zero "
            f"phase. {plotted.window_words(material, axis)} {limit}{behind}"
        )
        return style.drawing(figure, f"vibration-{self.key}", f"{self.title}: tip vibration", caption, is_zoomable=True)

    def _overlay(self, f_al: float | None, band_hz: tuple[float, float]) -> Figure:
        """Draw all runs in one diagram, and below it the amplitudes of their vibrations in m/s²."""
        figure, panels = style.panels(2, 1, 5.6, sharex=True, height_ratios=(3, 2))
        panel, below = panels[:, 0]
        for (row, run), look in zip(self.runs, style.OVERLAY_LINES, strict=False):
            plotted.draw_vibration(panel, replace(run, label=_label(row), look=look), band_hz, with_peak=False)
            vibration = band_passed(plotted.shown_acceleration(run), run.recording.period_s, band_hz)
            style.plot_thin(below, run.recording.time_s, np.abs(scipy.signal.hilbert(vibration)), **look)
        for each in (panel, below):
            self._shade(each, self.runs[0][1].recording)
        plotted.finish_vibration(self.material, panel, f_al)
        panel.set_xlabel("")
        if f_al is not None:
            below.axhline(plotted.limit_m_s2(self.material, f_al), **style.LIMIT)
            plotted.displacement_scale(below, f_al, "Displacement (mm)")
        below.set(ylim=(0.0, panel.get_ylim()[1]), xlabel="Time (s)", ylabel="Envelope (m/s²)")
        style.legend_above(figure, panel, columns=3)
        return figure

    def _multiples(self, f_al: float | None, band_hz: tuple[float, float]) -> Figure:
        """Draw each treated run in a diagram of its own, with the untreated run behind it."""
        plain = {row.loop: run for row, run in self.runs if row.treatment == "none"}
        shown = [(row, run) for row, run in self.runs if row.treatment != "none" or len(self.runs) == 1]
        count = -(-len(shown) // 2)
        figure, panels = style.panels(count, 2, 0.5 + 1.75 * count, sharex=self.axis is None, sharey=True)
        reach = 0.0
        for number, (row, run) in enumerate(shown):
            panel, behind = panels.flat[number], plain.get(row.loop)
            if behind is not None:
                plotted.draw_vibration(panel, replace(behind, label="untreated", look=BEHIND), band_hz, with_peak=False)
            plotted.draw_vibration(panel, replace(run, label="with the treatment", look=style.WITH), band_hz, with_peak=False)
            self._shade(panel, run.recording)
            reach = max(reach, plotted.finish_vibration(self.material, panel, f_al, with_name=False, with_scale=False))
            if f_al is not None and (number % 2 == 1 or number == len(shown) - 1):
                plotted.displacement_scale(panel, f_al)
            panel.set_title(_label(row))
            if number + 2 < len(shown):
                panel.set_xlabel("")
        for panel in panels.flat[len(shown) :]:
            panel.set_visible(False)
        if reach > 0.0:
            panels[0, 0].set_ylim(-1.08 * reach, 1.08 * reach)
        figure.supylabel("Tip acceleration, band-passed (m/s²)", fontsize=8.5)
        style.legend_above(figure, panels[0, 0], columns=3)
        return figure

    def _shade(self, panel: Axes, recording: Recording) -> None:
        """Shade the judged window, and limit the panel's time."""
        time, axis = recording.time_s, self.axis
        plotted.shade_judged(self.material, panel, axis, recording)
        if axis is None:
            panel.set_xlim(float(time[0]), float(time[-1]))
            return
        speed = np.abs(motor_speed_rps(recording, axis))
        rising = np.arange(len(speed)) < int(np.argmax(speed))
        fourth, second = self.material.window_rps(axis, 4), self.material.window_rps(axis, 2)
        if fourth is None or second is None:
            return
        shown = time[(speed >= 0.8 * fourth[0]) & (speed <= 1.15 * second[1]) & rising]
        if len(shown):
            panel.set_xlim(float(shown[0]), float(shown[-1]))

    def shapers(self) -> list[Item]:
        """Return the table of the shapers, the tip after a stop, and the residual over the frequency."""
        material, case = self.material, f"{self.title[0].upper()}{self.title[1:]}"
        runs = [run for run in material.result.runs if (run.experiment, run.axis) == (self.experiment, self.axis)]
        title = f"{case}: remaining vibration and cost of the shapers"
        made: list[Item] = [figures_shapers.shaper_table(runs, f"shapers-{self.key}", title)]
        if self.axis is not None and self.experiment == POINT_TO_POINT:
            title = f"{case}: the tip after the stop"
            made.append(figures_shapers.after_stop(material, self.axis, self.experiment, f"stop-{self.key}", title))
        title = f"{case}: remaining vibration at other frequencies"
        return [*made, figures_shapers.residuals(runs, f"residual-{self.key}", title)]

    def orders(self) -> list[Drawing]:
        """Draw order maps of a ramp with each treatment, several in one."""
        if self.axis is None:
            return []
        runs = [(run.label, run.recording) for _, run in self.runs]
        title = f"{f'{self.robot.name}, axis' if self.several else 'Axis'} {self.axis}: which order shakes the tip"
        resonance = MarkedResonance(self.material.f_al(self.axis))
        made = []
        for number, start in enumerate(range(0, len(runs), MAPPED)):
            key, name = f"orders-{self.key}{plotted.key_end(number)}", title + plotted.title_end(number)
            made.append(order_maps(key, name, runs[start : start + MAPPED], self.axis, resonance))
        return [drawing for drawing in made if drawing is not None]

    def directions(self) -> Drawing | None:
        """Draw the tip along x, y and z with the first treatments."""
        looked = [replace(run, look=look) for (_, run), look in zip(self.runs, style.OVERLAY_LINES, strict=False)]
        title = f"{self.title[0].upper()}{self.title[1:]}: the tip along x, y and z"
        return directions_of(self.material, looked, self.axis, f"directions-{self.key}", title)

    def arm(self) -> list[Drawing]:
        """Draw the arm along its line and at its resonances."""
        if self.experiment != LINE_MOTION:
            return []
        name = self.robot.directory
        made = arm_along_line(self.material, f"arm-line-{name}"), arm_swinging(self.material, f"arm-resonances-{name}")
        drawn = [each for each in made if each is not None]
        if not self.several:
            return drawn
        return [replace(each, title=f"{self.robot.name}: {each.title[0].lower()}{each.title[1:]}") for each in drawn]


def page_of(directory: Path, result: TreatmentTable) -> Page:
    """Return the page of a directory that `hil compare` has filled."""
    own = {robot.directory: directory / robot.directory for robot in result.robots}
    materials = {name: Material(path) if (path / "result.json").is_file() else None for name, path in own.items()}
    chapters = sections(result, materials)  # they add to the notes
    names = ", ".join(robot.name for robot in result.robots)
    head = PageHead(
        names or _bench_name(directory, result),
        result.started_utc,
        tuple(note for material in materials.values() if material is not None for note in material.notes),
        heading=result.tour.heading if isinstance(result, TourResult) else "Treatments side by side",
        aftermath=tuple(f"{robot.name}: {sentence}" for robot in result.robots for sentence in robot.aftermath),
        origin=origin_of_table(result),
    )
    return Page(head, verdict(result), chapters, cards(result), provenance(result))


def _bench_name(directory: Path, result: TreatmentTable) -> str:
    """Return the name of the bench of a tour without robots."""
    try:
        return load_bench(directory / result.tour.bench_file).name if isinstance(result, TourResult) else "none"
    except FileError:
        return "none"


def sections(result: TreatmentTable, materials: dict[str, Material | None]) -> list[Section]:
    """All chapters for which there is data."""
    several = len(result.robots) > 1
    first: list[Item] = [tables_compare.overview(result), tables_compare.claims(result)]
    first += [peaks(result, robot) for robot in result.robots]
    chapters: list[tuple[str, str, list[Item]]] = [("side-by-side", "Side by side", first)]
    for experiment, axis in cases(result):
        items: list[Item] = [tables_compare.experiment(result, experiment, axis)]
        for robot in result.robots:
            material = materials[robot.directory]
            if material is None:
                continue
            motion = ComparedMotion(robot, material, experiment, axis, several)
            items += motion.shapers()
            if experiment != POINT_TO_POINT:
                items += [motion.vibration(), motion.directions(), *motion.arm(), *motion.orders()]
        title = case_name(experiment, axis).capitalize()
        chapters.append((f"experiment-{tables_compare.key_of(experiment, axis)}", title, items))
    vectors = [direction_table(each, f"directions-{name}") for name, each in materials.items() if each is not None]
    chapters.append(("directions", "The tip as a vector", [*vectors]))
    chapters.append(("way", "Steps of the tour", [tables_compare.tour(result)]))
    chapters.append(("robot", "True values of the robot", [tables_compare.revealed(result)]))
    chapters.append(("cost", "What it costs", [tables_compare.compliances(result)]))
    chapters.append(("missing", "Left out", [tables_compare.left_out(result)]))
    return filled_sections(*chapters)


def verdict(result: TreatmentTable) -> PageVerdict:
    """Verdict: the treatment that keeps the specification everywhere."""
    judged = [(robot.directory, row) for robot in result.robots for row in robot.rows if row.within_spec is not None]
    everywhere = {(robot, row.experiment, row.axis) for robot, row in judged}
    limits = {robot.tip_mm for robot in result.robots}
    limit = f"±{next(iter(limits)):g} mm" if len(limits) == 1 else "its specification"
    by_treatment: dict[str, list[tuple[str, ComparisonRow]]] = {}
    for robot, row in judged:
        by_treatment.setdefault(row.treatment, []).append((robot, row))
    details = [f"Stopped early: {robot.name}: {robot.ended}" for robot in result.robots if robot.ended is not None]
    failure = result.tour.failure if isinstance(result, TourResult) else None
    if failure:
        details.append(f"The tour ended early: {failure}")
    details += [_sentence(name, rows, len(everywhere)) for name, rows in by_treatment.items()]
    details += [*tables_compare.notch_sentences(result), *_refused(result)]
    if failure or any(robot.ended is not None for robot in result.robots):
        return PageVerdict("stopped", "The comparison is not complete", tuple(details))
    keeping = {
        name: max(row.tip_peak_mm for _, row in rows if row.tip_peak_mm is not None)
        for name, rows in by_treatment.items()
        if name != "none"
        and all(row.within_spec for _, row in rows)
        and {(robot, row.experiment, row.axis) for robot, row in rows} == everywhere
    }
    where = "the experiment" if len(everywhere) == 1 else f"all {len(everywhere)} experiments"
    if keeping:
        best = min(keeping, key=lambda name: keeping[name])
        return PageVerdict("good", f"{_title(best)} keeps the tip within {limit} in {where}", tuple(details))
    if not any(name != "none" for name in by_treatment):
        return PageVerdict("bad", "Nothing could be compared", tuple(details))
    return PageVerdict("open", f"No single treatment keeps the tip within {limit} in {where}", tuple(details))


def _title(name: str) -> str:
    words = TITLES.get(name, name)
    return words[0].upper() + words[1:]


def _sentence(name: str, rows: list[tuple[str, ComparisonRow]], count: int) -> str:
    """A treatment in a sentence."""
    within = sum(bool(row.within_spec) for _, row in rows if row.loop == "drive" or name != "none")
    rows = [(robot, row) for robot, row in rows if row.loop == "drive" or name != "none"]
    if count > 1:
        where = f"within the specification in {within} of {count}"
    elif any(row.within_spec is not None for _, row in rows):
        where = f"{'within' if within else 'outside'} the specification"
    else:
        where = "not judged"
    text = f"{_title(name)}: {where}"
    changes = [row.tip_peak_change_pct for _, row in rows if row.tip_peak_change_pct is not None]
    if changes:
        low, high = min(changes), max(changes)
        text += f", tip peak {low:+.0f} %" if round(low) == round(high) else f", tip peak {low:+.0f} … {high:+.0f} %"
    factors = [row.compliance.slow for _, row in rows if row.compliance is not None]
    if factors and max(factors) > 1.05:
        text += f"; the motor yields {max(factors):.1f} times as far at 1 Hz"
    return text.replace("-", "−") + "."


def _refused(result: TreatmentTable) -> list[str]:
    return [
        f"Refused by its trial: {robot.name}, {case_name(row.experiment, row.axis)}, {TITLES[row.treatment]}."
        for robot in result.robots
        for row in robot.rows
        if row.trial == "refused"
    ]


def cards(result: TreatmentTable) -> list[Card]:
    """Card of every experiment: the treatment with the smallest peak."""
    made = []
    for robot in result.robots:
        for experiment, axis in cases(result):
            own = [row for row in robot.rows if (row.experiment, row.axis) == (experiment, axis)]
            peaks = [(row.tip_peak_mm, row) for row in own if row.tip_peak_mm is not None]
            acting = [(peak, row) for peak, row in peaks if row.treatment != "none"]
            if not acting:
                continue
            after_mm, best = min(acting, key=lambda pair: pair[0])
            before_mm = next((peak for peak, row in peaks if row.treatment == "none" and row.loop == best.loop), None)
            if before_mm is None:
                continue
            head = f"{robot.name}, " if len(result.robots) > 1 else ""
            change = number_text(best.tip_peak_change_pct, "{:+.0f} % peak")
            step = CardStep(f"{after_mm:.3f}", change, Mark(best.within_spec, f"limit ±{robot.tip_mm:g} mm"))
            title = f"{head}{case_name(experiment, axis)}: {tables_compare.treatment_words(best)}"
            made.append(Card(title, f"{before_mm:.3f}", "mm", (step,)))
    return made


def provenance(result: TreatmentTable) -> list[tuple[str, str]]:
    """Robots, instant and versions of the runs."""
    lines = []
    for robot in result.robots:
        source = f", {robot.source}" if robot.source else ""
        lines.append(("Robot", f"{robot.name} on {robot.bus}{source}"))
    versions: dict[str, str] = next((robot.versions for robot in result.robots if robot.versions is not None), {})
    lines.append(("Versions", versions_text(versions)))
    return [(name, text) for name, text in lines if text]


def _label(row: ComparisonRow) -> str:
    """Treatment of a run, with its peak and its change."""
    if row.tip_peak_mm is None:
        return f"{treatment_words(row)}: " + ("refused by its trial" if row.trial == "refused" else "not judged")
    change_text = "" if row.tip_peak_change_pct is None else f" ({number_text(row.tip_peak_change_pct, '{:+.0f} %')})"
    return f"{treatment_words(row)}: {row.tip_peak_mm:.3f} mm{change_text}"


def peaks(result: TreatmentTable, robot: ComparisonRobot) -> Drawing | None:
    """Draw the tip's peaks beside the specification, the experiments side by side."""
    columns = [case for case in cases(result) if any(_is_judged(row, case) for row in robot.rows)]
    names = list(dict.fromkeys(treatment_words(row) for row in robot.rows if row.tip_peak_mm is not None))
    if not columns or len(names) < 2:
        return None
    key = f"peaks-{robot.directory}"
    figure, panels = style.panels(1, len(columns), 0.9 + 0.3 * len(names), sharey=True, sharex=True)
    reach = 1.12 * max([robot.tip_mm, *(row.tip_peak_mm for row in robot.rows if row.tip_peak_mm is not None)])
    height = {name: len(names) - 1 - number for number, name in enumerate(names)}
    for column, case in enumerate(columns):
        panel = panels[0, column]
        own = [(row, row.tip_peak_mm) for row in robot.rows if _is_judged(row, case) and row.tip_peak_mm is not None]
        plain = {row.loop: peak for row, peak in own if row.treatment == "none"}
        panel.axvspan(0.0, robot.tip_mm, color=style.SHADE, zorder=0)
        panel.axvline(robot.tip_mm, **style.LIMIT)
        for row, peak in own:
            y, within = height[treatment_words(row)], row.within_spec
            panel.plot([plain.get(row.loop, peak), peak], [y, y], color=style.GREY, linewidth=0.9, zorder=1)
            look = {"marker": "o", "color": style.BLUE} if within else {"marker": "s", "color": style.VERMILLION}
            panel.plot([peak], [y], linestyle="", markersize=5.5, zorder=3, **look)
            side, shift = _side(peak, robot.tip_mm, reach * LABEL_FRACTION * len(columns))
            panel.annotate(f"{peak:.3f}", (peak, y), xytext=(shift, 5.5), textcoords="offset points", ha=side, fontsize=7.0)
        panel.set(title=case_name(*case).capitalize(), xlabel="Tip peak (mm)", ylim=(-0.6, len(names) - 0.2))
    panels[0, 0].set_xlim(0.0, reach)
    panels[0, 0].locator_params(axis="x", nbins=5)
    panels[0, 0].set_yticks([height[name] for name in names], names)
    several = len(result.robots) > 1
    caption = (
        f"Dotted line and shade: the specification of ±{robot.tip_mm:g} mm. Blue discs are within it, red squares outside; "
        "the thin line leads to the peak with no treatment and the loop closed in the same place."
    )
    title = f"{robot.name}: tip peaks against the specification" if several else "Tip peaks against the specification"
    return style.drawing(figure, key, title, caption)


LABEL_FRACTION = 0.022
"""Half a label's width as a fraction of a figure's: beside the limit it stands on its own side."""


def _side(peak: float, limit: float, half: float) -> tuple[str, float]:
    """Return alignment and shift by which a label covers no line."""
    if peak < half:
        return "left", 0.0
    if abs(peak - limit) >= half:
        return "center", 0.0
    return ("right", 2.0) if peak <= limit else ("left", -2.0)


def _is_judged(row: ComparisonRow, case: tuple[str, int | None]) -> bool:
    return (row.experiment, row.axis) == case and row.tip_peak_mm is not None
