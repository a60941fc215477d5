"""The report's tables: the paper's numbers beside the bench's."""

import math
import re
from operator import attrgetter

from markupsafe import Markup

from hil.design.frequency import Margins
from hil.design.paper import TABLE_1, TABLE_2, TABLE_3
from hil.master.lateness import duration_text
from hil.report.material import Material, run_name, treatment_name, worst_of
from hil.report.report_table import NONE, Cell, Columns, Mark, ReportTable, number, tabulate
from hil.results.acted import FilterSet
from hil.results.runs import RunEntry

_in_table_3 = attrgetter("offset_hz", "zeta_rn", "zeta_rdth", "order", "start_rps", "end_rps")


def claims(material: Material) -> ReportTable:
    """The paper's claims beside the bench's numbers, grouped by axis."""
    by_group: dict[str, list[list[Cell]]] = {}
    for claim in material.result.paper:
        axis = _AXIS.search(claim.claim)
        group = f"Axis {axis[1]}" if axis is not None else "Line motion" if "line motion" in claim.claim else "Robot"
        words = claim.claim.removeprefix(f"{group.lower()}: ").removeprefix(f"{group.lower()}, ")
        numbers = number(claim.paper, "{:.4g}"), number(claim.bench, "{:.4g}")
        by_group.setdefault(group, []).append([words, claim.source, *numbers, claim.unit, Mark(claim.holds)])
    rows: list[list[Cell]] = []
    groups = {}
    for group, own in by_group.items():
        groups[len(rows)] = group
        rows += own
    header = ("Claim", "Where in the paper", "Paper", "Bench", "Unit", "Holds")
    title = "The paper's claims beside the bench's numbers"
    return ReportTable("claims", title, header, rows, {0, 1, 4, 5}, is_prose=True, groups=groups)


_AXIS = re.compile(r"\baxis (\d+)")


def resonances(material: Material) -> ReportTable:
    """Table of the resonances, beside the paper's Table 1."""
    rows: list[list[Cell]] = []
    is_paper = material.bench.is_paper
    for axis, f_al in material.f_al_hz.items():
        own, estimate = (f_al, f_al / 2.0, f_al / 4.0), material.estimate(axis)
        pairs = zip(TABLE_1.get(axis, (None, None, None)), own, strict=True)
        numbers = [x for pair in pairs for x in pair] if is_paper else own
        identified = NONE if estimate is None else number(estimate.arm.resonance_hz, "{:.2f}")
        rows.append([f"axis {axis}", *(number(x, "{:.2f}") for x in numbers), identified])
    symbols = (("f", "al", "Hz"), ("f", "m2", "rev/s"), ("f", "m4", "rev/s"))
    sources = (", paper", ", bench") if is_paper else ("",)
    header = (
        "",
        *(_sub(symbol, index, unit + source) for symbol, index, unit in symbols for source in sources),
        "arm on its gear (Hz, identified)",
    )
    caption = (
        f"Peak of |G_al| of the {material.model_source}'s model with its loop, and the motor speeds at which the 2nd "
        "and the 4th harmonic meet it. Last column: the anti-resonance refined from the ramp without a notch."
    )
    title = "Resonance and the motor speeds that excite it"
    return ReportTable("table-1", title, header, rows, caption=caption, paper="Table 1")


def transmission_errors(material: Material) -> ReportTable:
    """Table of the transmission errors, beside the paper's Table 2."""
    rows: list[list[Cell]] = []
    is_paper = material.bench.is_paper
    for axis in material.model_axes:
        stated, estimate, paper = material.transmission_error(axis), material.estimate(axis), TABLE_2.get(axis)
        if stated is None:
            continue
        known = stated.amplitude_arcsec.keys() | (set() if estimate is None else estimate.error.amplitude_arcsec.keys())
        for order in sorted(known):
            for column in range(2):
                name, unit = ("A", "arcsec") if column == 0 else ("φ", "°")
                printed = None if paper is None else (paper.amplitude_arcsec, paper.phase_deg)[column].get(order)
                identified = NONE
                if estimate is not None and order in estimate.error.amplitude_arcsec:
                    value = (estimate.error.amplitude_arcsec, estimate.error.phase_deg)[column][order]
                    error = (estimate.amplitude_error_arcsec, estimate.phase_error_deg)[column][order]
                    identified = f"{value:.2f} ± {error:.2f}" if column == 0 else f"{value:.1f} ± {error:.1f}"
                rows.append(
                    [
                        f"axis {axis}",
                        Markup("{}<sub>{:g}</sub>").format(name, order),
                        unit,
                        *([number(printed, "{:g}")] if is_paper else []),
                        number((stated.amplitude_arcsec, stated.phase_deg)[column].get(order), "{:g}"),
                        identified,
                    ]
                )
    paper_column = ("Paper",) if is_paper else ()
    header = ("", "Parameter", "Unit", *paper_column, material.model_source.capitalize(), "Identified ± standard error")
    caption = (
        "Identified from the tip acceleration of the ramp without a notch. The standard error covers noise only. A relative "
        "error of the tip lever appears unchanged in the amplitudes. An error of the motor angle's zero appears k times in φ_k."
    )
    title = "Parameters of the synchronous transmission error"
    return ReportTable("table-2", title, header, rows, {0, 1, 2}, caption, paper="Table 2")


def notches(material: Material, filters: FilterSet, nth: int = 0) -> ReportTable:
    """Tabulate filters and their worst margins beside the paper's Table 3."""
    rows: list[list[Cell]] = []
    is_paper = material.bench.is_paper and "notch" in filters.treatments
    for axis, tables in sorted(filters.notches.items()):
        paper = TABLE_3.get(axis) if is_paper else None
        worst = worst_of(material.margins(axis, filters).values()) if axis in material.model_axes else None
        for notch in tables:
            printed = (None,) * 6 if paper is None or notch.order != paper.order else _in_table_3(paper)
            cells = [_both(*pair) for pair in zip(printed, _in_table_3(notch), strict=True)]
            rows.append([f"axis {axis}", *cells, *_margin_cells(worst)])
    header = (
        "",
        Markup("ω<sub>d</sub>/2π (Hz)"),
        Markup("ζ<sub>rn</sub>"),
        Markup("ζ<sub>rdth</sub>"),
        "k",
        _sub("f", "s", "rev/s"),
        _sub("f", "e", "rev/s"),
        Markup("largest M<sub>s</sub>"),
        "least gain margin (dB)",
        "least phase margin (°)",
        "stable",
    )
    speeds = [list(material.margins(axis, filters)) for axis in filters.notches if axis in material.model_axes]
    margins = " Without a model of the axis there are no margins."
    if speeds:
        margins = f" Margins: by the {material.model_source}'s model, the worst of {len(speeds[0])} motor speeds "
        margins += f"from {speeds[0][0]:g} to {speeds[0][-1]:g} rev/s."
    caption = f"{_held(material, filters)}{' Brackets: the value of the paper, if it differs.' if is_paper else ''}" + margins
    whose = "" if filters.treatments == ("notch",) else f" of {' and '.join(map(treatment_name, filters.treatments))}"
    title = f"Variable notch filter{whose}, with its margins"
    return ReportTable(f"table-3{filters_end(nth)}", title, header, rows, caption=caption, paper="Table 3" if is_paper else "")


def filters_end(nth: int) -> str:
    """Return the end of the keys of the n-th filters."""
    return f"-filters{nth + 1}" if nth else ""


def _held(material: Material, filters: FilterSet) -> str:
    """Sentence on the source of the parameters."""
    is_host = filters.loop == "host"
    return "The parameters of the loop that the host closed." if is_host else "The parameters read back from the drive."


def _margin_cells(worst: Margins | None) -> list[Cell]:
    if worst is None:
        return [NONE, NONE, NONE, NONE]
    return [
        number(worst.sensitivity_peak, "{:.2f}"),
        number(worst.gain_margin_db, "{:.1f}"),
        number(worst.phase_margin_deg, "{:.0f}"),
        Mark(worst.stable),
    ]


def _both(paper: float | None, bench: float) -> str:
    """The bench's value, and the paper's in brackets if it differs."""
    if paper is None or math.isclose(paper, bench, rel_tol=1e-6):
        return f"{bench:g}"
    return f"{bench:g} ({paper:g})"


def runs(material: Material) -> ReportTable:
    """Every window of every run with its numbers."""
    columns: Columns[RunEntry] = (
        ("Run", _name),
        ("Window", _window_words),
        ("Specification", _within),
        ("Tip peak (mm)", lambda run: number(run.tip_peak_mm, "{:.4f}")),
        ("noise (mm)", lambda run: number(run.noise_mm, "{:.4f}")),
        (
            "order alone (mm)",
            lambda run: NONE if run.order_mm is None else f"{run.order_mm:.4f} ± {run.order_error_mm or 0.0:.4f}",
        ),
        ("on the whole ramp (mm)", lambda run: number(run.ramp_peak_mm, "{:.4f}")),
        ("Tip rms (mm)", lambda run: number(run.tip_rms_mm, "{:.4f}")),
        ("Spectrum peak (m/s²)", lambda run: number(run.spectrum_peak_m_s2, "{:.4f}")),
        ("at (Hz)", lambda run: number(run.spectrum_peak_hz, "{:.2f}")),
        ("Spectrum area (m/s²·Hz)", lambda run: number(run.spectrum_area, "{:.3f}")),
    )
    caption = (
        "Tip: equivalent displacement in the judged window. A ramp has one window for each order k that crosses the resonance, "
        "around f_al/k. Noise: the peak that noise alone would show. Order alone: its largest amplitude, tracked along the "
        "motor angle, with its standard error. Whole ramp: the peak except the jerks at its ends. Without f_al nothing is "
        "judged, and there are no millimetres."
    )
    return tabulate("runs", "Results of all runs", columns, material.result.runs, caption, range(3))


def _within(run: RunEntry) -> Mark:
    if run.stopped or run.invalid:
        return Mark(None, "stopped early" if run.stopped else "not judged")
    return Mark(run.within_spec, {True: "within", False: "outside", None: ""}[run.within_spec])


def _window_words(run: RunEntry) -> str:
    if run.order is None:
        return NONE
    return f"k = {run.order}" + ("" if run.window_rps is None else f", {run.window_rps[0]:.3g} … {run.window_rps[1]:.3g} rev/s")


def _name(run: RunEntry) -> str:
    what = f"axis {run.axis}, ramp" if run.axis is not None else run.experiment.replace("-", " ")
    return f"{what}, {treatment_name(run.treatment)}, {run.loop}-closed" + (" (stopped early)" if run.stopped else "")


def motions(material: Material) -> ReportTable:
    """Every motion once: load of the bus, and duration."""
    columns: Columns[RunEntry] = (
        ("Motion", _name),
        ("SYNC (ms)", lambda run: number(1e3 * run.sync_period_s, "{:g}")),
        ("Loop (µs)", lambda run: number(1e6 * run.control_period_s, "{:g}")),
        ("Cycles", lambda run: number(run.cycles, "{:d}")),
        ("Missed", lambda run: number(run.missed_cycles, "{:d}")),
        ("Motion (s)", lambda run: number(run.motion_s, "{:.2f}")),
        ("Wall (s)", lambda run: number(run.wall_s, "{:.2f}")),
        ("Motion / wall (–)", lambda run: number(run.motion_s / run.wall_s, "{:.1f}") if run.wall_s > 0.0 else NONE),
        ("Recording", lambda run: run.recording),
    )
    caption = (
        "A cycle is a SYNC period; it is missed if an answer was late or lost. Motion: time of the robot. Wall: time of the "
        "wall clock, which is less if an emulated robot runs faster than real time."
    )
    once = {run.recording: run for run in material.result.runs}.values()
    return tabulate("motions", "Cycles and times", columns, once, caption, (0, 8))


def _sub(symbol: str, index: str, unit: str) -> Markup:
    return Markup("{}<sub>{}</sub> ({})").format(symbol, index, unit)


def timing_table(material: Material) -> ReportTable:
    """Tabulate the punctuality of SYNC and answers, by motion."""
    by_recording = {run.recording: (run, run.timing) for run in material.result.runs if run.timing is not None}
    rows: list[list[Cell]] = []
    for run, timing in by_recording.values():
        load = timing.bus_load
        counts = [str(count) for count in (timing.cycles, timing.dropped, timing.late, timing.missed)]
        name = run_name(run, with_window=False)
        for spread, what in ((timing.lateness, "SYNC after its deadline"), (timing.arrivals, "answers after SYNC")):
            durations = (spread.p50_s, spread.p99_s, spread.p999_s, spread.max_s)
            cells = [duration_text(duration_s).replace("-", NONE) for duration_s in durations]
            first = spread is timing.lateness
            tail = [*counts, NONE if load is None else f"{100.0 * load:.1f}"] if first else [""] * 5
            rows.append([name if first else "", what, *cells, *tail])
    refused = sorted(
        {
            f"{measure.name} ({measure.detail})"
            for _, timing in by_recording.values()
            for measure in timing.measures
            if not measure.is_granted
        }
    )
    header = ("Motion", "What", "p50", "p99", "p99.9", "max", "Cycles", "Dropped", "Late", "Missed", "Bus load (%)")
    sentence = f" Not granted: {'; '.join(refused)}." if refused else " The operating system granted every request for real time."
    caption = (
        "Percentiles are at most 2.4 % too large and never too small; the largest is exact. A cycle that is too late is "
        "dropped: its set-points are not sent. Late: SYNC was sent after the limit. Missed: an answer did not come." + sentence
    )
    return ReportTable("timing", "Timing of the cycle", header, rows, {0, 1}, caption)
