"""The page of a transmission error from recordings, with its figures: one self-contained HTML file."""

import math
from pathlib import Path

import numpy as np

from hil.bench.model import values_in_words
from hil.control.order_keys import amplitude_key
from hil.counting import counted
from hil.recording import load_columns
from hil.report import style
from hil.report.figures.order_map import LEVELS, draw_colour_scale, level_colours
from hil.report.order_names import BY_ORDER, symbol
from hil.report.pages.page import Page, PageHead, PageVerdict, Section, filled_sections, versions_text
from hil.report.report_table import Cell, ReportTable, number, value_and_error
from hil.report.style import Drawing
from hil.results.recorded_ate import SIGNAL_UNIT, Form, OrderEntry, RecordedAteResult, RecordedStretch

NAMED_PEAKS = 6
MOST_BINS = 16
LEAST_SPEED_RANGE = 0.15
"""Range of the speeds, by the highest, from which a map over the speed says anything."""
DRAWN_TURNS = 12.0
"""Revolutions of a stretch that are drawn: of more the waves could not be told apart."""
TURNS = {1: "forwards", -1: "backwards"}


_THROUGH = {False: "", True: ", in arcsec of the joint, through the arm to the sensor"}
_SIGNAL: dict[Form, str] = {
    "two encoders": "joint angle minus motor angle over N",
    "tip acceleration": "acceleration without that of the motor's own motion, up to three times the arm's resonance,",
    "motor torque": "torque without that of the motor's own motion, up to three times the arm's resonance,",
}


def page_of(directory: Path, result: RecordedAteResult) -> Page:
    """Return the page of a directory that `hil identify ate --recording` has filled."""
    head = PageHead(
        f"{result.robot}, from recordings",
        result.started_utc,
        heading=f"Transmission error of axis {result.axis}",
        subtitle=f"From {counted(len(result.files), 'recording')} by {result.form}",
        is_bench=False,
    )
    return Page(head, verdict(result), sections(directory, result), provenance=provenance(result))


def sections(directory: Path, result: RecordedAteResult) -> list[Section]:
    """All chapters for which there is data."""
    return filled_sections(
        ("result", "Transmission error", (spectrum(directory, result), orders(result))),
        ("evidence", "Signal and fit", (fit(directory, result), speed_map(directory, result))),
        ("change", "From part to part", (change(result), stretches(result))),
    )


def verdict(result: RecordedAteResult) -> PageVerdict:
    """Verdict at the top of the page."""
    scan, found = result.scan, []
    if scan is not None:
        above = ", ".join(f"{peak.order:.2f}" for peak in scan.peaks) or "none"
        found = [f"Blind scan: highest at order {scan.highest.order:.2f}; above the false-alarm level: {above}."]
    if result.ate is None or not result.is_identified:
        return PageVerdict("bad", "No order exceeds its noise", (result.not_identified or "", *found, *result.notes))
    details = (", ".join(values_in_words(result.ate)), *found, *result.notes)
    if any(each.is_seen for each in result.changes):
        return PageVerdict("open", "The transmission error is identified, and it changes", details)
    return PageVerdict("good", "The transmission error is identified", details)


def provenance(result: RecordedAteResult) -> list[tuple[str, str]]:
    """Recordings and versions."""
    lines = [("Robot", result.robot), ("Reduction ratio", f"{result.reduction_ratio:g}")]
    lines += [
        (
            "Recording",
            f"`{each.path}`: {each.rows} rows, {each.duration_s:.1f} s, every {1e3 * each.period_s:.2f} ms, steps of the stamps "
            f"within {1e3 * each.jitter_s:.2f} ms{'' if each.clock is None else f'; time: {each.clock}'}; "
            f"{'; '.join(f'`{words}`' for words in each.columns)}",
        )
        for each in result.files
    ]
    if result.plant is not None:
        lines.append(("Plant", result.plant))
    lines.append(("Versions", versions_text(result.versions)))
    return lines


def spectrum(directory: Path, result: RecordedAteResult) -> Drawing | None:
    """Figure of the blind scan with its floor and false-alarm level."""
    entry = result.scan
    if entry is None:
        return None
    curve, key = load_columns(directory / "scan.csv"), f"order-spectrum-axis{result.axis}"
    figure, panels = style.panels(1, 1, 3.0)
    panel = panels[0, 0]
    panel.plot(curve["order"], curve["amplitude"], label="amplitude", **style.MEASURED)
    panel.plot(curve["order"], curve["floor"], label="floor", **{**style.MARK, "linewidth": 1.2})
    panel.plot(curve["order"], curve["level"], label=f"false alarm in {100 * entry.false_alarm:g} % of scans", **style.LIMIT)
    top = 1.18 * float(np.max(curve["amplitude"]))
    for peak in entry.peaks[:NAMED_PEAKS]:
        at = peak.order, peak.amplitude
        style.name_at(panel, f"{peak.order:.2f}", at, (0, 3), ha="center", va="bottom", bbox=style.NAME_GROUND)
    panel.set(xlim=(float(curve["order"][0]), float(curve["order"][-1])), ylim=(0.0, top))
    panel.set_xticks(range(1, 11))
    panel.set(xlabel="Order k (per motor revolution)", ylabel=f"Amplitude ({entry.unit})")
    style.legend_above(figure, panel)
    caption = (
        "Amplitude of each order in a scan of all orders, each fitted by itself, together with the slow part"
        f"{_THROUGH[_is_sensed(result)]}. Dotted: the floor, which is the median of the neighbours, and the level that noise "
        "alone reaches anywhere in the scan with the given probability. The side lobes of an order come from the small number "
        "of revolutions."
    )
    return style.drawing(figure, key, f"Order spectrum of axis {result.axis}", caption)


def speed_map(directory: Path, result: RecordedAteResult) -> Drawing | None:
    """Draw the amplitude over speed and order."""
    table = load_columns(directory / "map.csv")
    speeds = np.unique(table["speed_rps"])
    if len(speeds) < 3 or float(speeds[-1] - speeds[0]) < LEAST_SPEED_RANGE * float(speeds[-1]):
        return None
    orders = np.unique(table["order"])
    edges = np.linspace(float(speeds[0]), float(speeds[-1]), min(MOST_BINS, len(speeds)) + 1)
    place = np.clip(np.searchsorted(edges, table["speed_rps"], side="right") - 1, 0, len(edges) - 2)
    row = np.searchsorted(orders, table["order"])
    total, count = np.zeros((len(edges) - 1, len(orders))), np.zeros((len(edges) - 1, len(orders)))
    np.add.at(total, (place, row), table["amplitude"] ** 2)
    np.add.at(count, (place, row), 1.0)
    there = count[:, 0] > 0
    centres = (0.5 * (edges[1:] + edges[:-1]))[there]
    if len(centres) < 2:
        return None
    amplitude = np.sqrt(total[there] / count[there])
    key = f"order-map-axis{result.axis}"
    levels = np.linspace(0.0, float(np.max(amplitude)), LEVELS + 1)
    figure, panels = style.panels(1, 1, 3.4)
    panel = panels[0, 0]
    panel.contourf(centres, orders, amplitude.T, levels=levels, colors=level_colours())
    panel.plot(centres, np.full(len(centres), float(orders[0])), "|", color=style.BLACK, markersize=7, clip_on=False)
    panel.set(xlim=(float(centres[0]), float(centres[-1])), ylim=(float(orders[0]), float(orders[-1])))
    panel.set_yticks(range(1, 11))
    panel.set(xlabel="Motor speed (rev/s)", ylabel="Order k (per motor revolution)")
    draw_colour_scale(figure, panels, levels, f"Amplitude ({SIGNAL_UNIT[result.form]})", aspect=30)
    caption = (
        "Amplitude over motor speed and order, in windows of 2.5 revolutions. Ticks at the bottom: speeds with data; between "
        "them the colours are interpolated. An order of the gear stays at its height at every speed"
        f"{', strongest where it passes the resonance of the arm' if _is_sensed(result) else ''}; a line of a fixed frequency "
        "falls as the speed rises."
    )
    return style.drawing(figure, key, f"Orders of axis {result.axis} over the speed", caption)


def fit(directory: Path, result: RecordedAteResult) -> Drawing | None:
    """Draw the longest stretch: signal, slow part, error and residual."""
    if not result.stretches:
        return None
    columns = load_columns(directory / "fit.csv")
    longest = max(np.unique(columns["stretch"]), key=lambda each: float(np.ptp(columns["turns"][columns["stretch"] == each])))
    rows = columns["stretch"] == longest
    turns = np.abs(columns["turns"][rows] - columns["turns"][rows][0])
    middle = 0.5 * float(turns[-1])
    shown = np.abs(turns - middle) <= 0.5 * DRAWN_TURNS
    whole, slow = columns["signal"][rows], columns["slow"][rows]
    error, rest = columns["error"][rows], columns["residual"][rows]
    key = f"recorded-fit-axis{result.axis}"
    figure, panels = style.panels(3, 1, 5.6, height_ratios=(4, 4, 2))
    level = float(np.mean(whole))
    panels[0, 0].plot(turns, whole - level, label="recorded", **style.MEASURED)
    panels[0, 0].plot(turns, slow - level, label="slow part", **style.MODEL)
    panels[1, 0].plot(turns[shown], (whole - slow)[shown], label="recorded − slow part", **style.BROAD)
    panels[1, 0].plot(turns[shown], error[shown], label="transmission error", **{**style.MODEL, "linestyle": "-"})
    style.residual(panels[2, 0], turns[shown], rest[shown], SIGNAL_UNIT[result.form], "recorded − fit")
    for panel in panels[:, 0]:
        panel.set_ylabel(SIGNAL_UNIT[result.form])
        panel.margins(x=0.0)
    panels[2, 0].set_xlabel("Motor revolutions from the beginning of the stretch")
    style.legend_above(figure, panels[0, 0], panels[1, 0])
    stretch = result.stretches[int(longest)]
    caption = (
        f"{stretch.turns:.1f} revolutions of the motor {TURNS[stretch.direction]}, about {stretch.speed_rps:.1f} rev/s. Above: "
        f"the {_SIGNAL[result.form]} with its slow part, a polynomial of degree {stretch.degree}, chosen by "
        "cross-validation. Below: the signal less its slow part, the fitted orders, and the residual."
    )
    return style.drawing(figure, key, f"The longest stretch of axis {result.axis}", caption, style.BOTH)


def change(result: RecordedAteResult) -> Drawing | None:
    """Draw A_k and φ_k from part to part with two standard errors."""
    parts, part = result.parts, result.ate
    if len(parts) < 2 or part is None:
        return None
    orders = _shown_orders(result)
    key = f"change-axis{result.axis}"
    figure, panels = style.panels(2, 1, 4.2, sharex=True)
    for place, order in enumerate(orders):
        look = {**style.AXIS_LINES[place % len(style.AXIS_LINES)], "linewidth": 0.9, "capsize": 2.0, "label": f"order {order:g}"}
        values = [_of(each, order) for each in parts]
        where = np.arange(len(parts)) + 0.08 * (place - 0.5 * (len(orders) - 1))
        panels[0, 0].errorbar(where, [each.a_arcsec for each in values], [2 * each.a_error_arcsec for each in values], **look)
        mean = part.values.phases_deg().get(order, 0.0)
        turned = [(each.phi_deg - mean + 180.0) % 360.0 - 180.0 for each in values]
        panels[1, 0].errorbar(where, turned, [min(180.0, 2 * each.phi_error_deg) for each in values], **look)
    panels[0, 0].set_ylim(bottom=0.0)
    panels[0, 0].set_ylabel("A_k (arcsec)".replace("A_k", "$A_k$"))
    panels[1, 0].set_ylabel("$φ_k$ from its mean (°)")
    panels[1, 0].axhline(0.0, **style.MARK)
    names = [f"{_file_name(result, each)}\n{each.from_s:.1f} … {each.to_s:.1f} s" for each in parts]
    panels[1, 0].set_xticks(
        range(len(parts)), names, fontsize=6.5 if len(parts) < 8 else 5.5, rotation=0 if len(parts) < 7 else 40
    )
    style.legend_above(figure, panels[0, 0])
    caption = (
        "Amplitudes and phases of the orders that exceed their noise, in parts of the stretches, with two standard errors. A "
        "feed-forward with one phase leaves 2 sin(Δ/2) of an order whose phase differs by Δ: half of it at 30°."
    )
    return style.drawing(figure, key, f"Transmission error of axis {result.axis}, part by part", caption)


def orders(result: RecordedAteResult) -> ReportTable | None:
    """Table of A_k and φ_k with their standard errors."""
    part = result.ate
    if part is None:
        return None
    rows: list[list[Cell]] = []
    changes = {each.order: each for each in result.changes}
    for each in part.numbers():
        seen = changes.get(each.order)
        words = "" if seen is None or each.letter == "A" else "changes" if seen.is_seen else "noise explains it"
        shown = value_and_error(each.value, each.error or 0.0)
        rows.append([symbol(each.letter, each.order), each.unit, *shown, words])
    header = ("Parameter", "Unit", "Identified", "Standard error", "From part to part")
    caption = (
        "The standard error is that of the mean of all stretches; it includes the choice of the slow part and the "
        "correlation of neighbouring samples. Phases count from the zero of the recorded motor encoder."
    )
    title = f"Transmission error of axis {result.axis}"
    return ReportTable("orders", title, header, rows, {0, 1, 4}, caption)


def stretches(result: RecordedAteResult) -> ReportTable:
    """Table of the stretches."""
    rows: list[list[Cell]] = []
    shown = _shown_orders(result)
    for each in result.stretches:
        cells: list[Cell] = [
            _file_name(result, each), TURNS[each.direction], number(each.turns, "{:.1f}"), number(each.speed_rps, "{:.2f}"),
            f"{each.from_s:.1f} … {each.to_s:.1f}", number(each.degree, "{:d}"),
        ]  # fmt: skip
        for order in shown:
            value = _of(each, order)
            cells += [" ± ".join(value_and_error(value.a_arcsec, value.a_error_arcsec))]
            cells += [" ± ".join(value_and_error(value.phi_deg, value.phi_error_deg))]
        rows.append(cells)
    names = [f"{letter}_{order:g} ({unit})" for order in shown for letter, unit in BY_ORDER]
    header = ("Recording", "Way", "Turns", "Speed (rev/s)", "From, to (s)", "Degree", *names)
    caption = "A stretch is a motion one way without a stop. Degree: that of the slow part."
    return ReportTable("stretches", "Stretches", header, rows, {0, 1}, caption)


def _is_sensed(result: RecordedAteResult) -> bool:
    """Return True for a sensor behind the arm."""
    return result.form != "two encoders"


def _shown_orders(result: RecordedAteResult) -> list[float]:
    """Return the four largest orders, above their noise if any is."""
    part = result.ate
    if part is None:
        return []
    amplitudes = part.values.amplitudes_arcsec()
    strong = [
        order for order, size in amplitudes.items() if size >= 3.0 * part.standard_error.get(amplitude_key(order), math.inf)
    ]
    largest = sorted(strong or amplitudes, key=lambda order: -amplitudes[order])[:4]
    return sorted(largest)


def _of(stretch: RecordedStretch, order: float) -> OrderEntry:
    return next(each for each in stretch.values if each.order == order)


def _file_name(result: RecordedAteResult, stretch: RecordedStretch) -> str:
    return Path(result.files[stretch.file].path).name.split(".")[0]
