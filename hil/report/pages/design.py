"""The page of a designed notch, its margins, and the tip on ramps: one self-contained HTML file; Figs. 11 and 12."""

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from hil.analysis import tip_displacement_mm
from hil.bench.design import notch_table
from hil.control.angles import ARCSEC
from hil.control.arrays import Real
from hil.design.frequency import acceleration_bound
from hil.design.notch_design import VERDICT_STEPS, NotchVerdict
from hil.design.ramp import follow
from hil.design.speed_margins import FINE_BAND
from hil.design.uncertainty import plants_words
from hil.experiments.judge import scale_at
from hil.experiments.notch_design import NotchDesignOutcome
from hil.report import style
from hil.report.figures import notch as notches
from hil.report.origin import origin_of_design
from hil.report.pages.page import Card, CardStep, Page, PageHead, PageVerdict, Section, filled_sections, render
from hil.report.report_table import NONE, Cell, Mark, ReportTable, number
from hil.report.style import Drawing


def write_design_report(outcome: NotchDesignOutcome, path: Path) -> Path:
    """Write the report of a design: one file, no network, no scripts.

    Raises:
        OSError: It cannot be written.
    """
    with style.styled():
        chapters = sections(outcome)
    head = PageHead(
        outcome.bench.name,
        heading=f"Variable notch of axis {outcome.request.axis}",
        subtitle="Designed from a plant; nothing was measured and nothing was sent",
        origin=origin_of_design(outcome),
        is_paper=outcome.bench.is_paper,
    )
    return render(path, Page(head, verdict(outcome), chapters, cards(outcome), provenance(outcome)))


def sections(outcome: NotchDesignOutcome) -> list[Section]:
    """All chapters."""
    return filled_sections(
        ("result", "Filter", (filters(outcome), peaks(outcome), requirements(outcome))),
        ("gain", "Gain", (families(outcome),)),
        ("stability", "Stability", (nyquist(outcome), margin_curves(outcome))),
        ("ramp", "On the ramp", (ramps(outcome),)),
        ("plants", "Plants", (plants(outcome),)),
        ("arm", "On the arm", (on_the_arm(outcome),)),
    )


def verdict(outcome: NotchDesignOutcome) -> PageVerdict:
    """NotchVerdict at the top of the page."""
    failure = outcome.failure
    if failure is not None:
        headline = "The given filters miss a requirement" if outcome.request.is_given else "No filter meets all requirements"
        if outcome.is_usable and not outcome.request.is_given:
            headline = "The best filters within all margins do not meet the limits of the tip"
        said = () if failure.what.casefold() == headline.casefold() else (failure.what,)  # once is enough
        return PageVerdict("bad", headline, (*said, *map(str, failure.missed)))
    best = outcome.best
    which = "The given filters meet" if outcome.request.is_given else "The designed filters meet"
    details = tuple(str(check) for check in best.checks)
    return PageVerdict("good", f"{which} all requirements, at every speed, for {plants_words(outcome.problem.members)}", details)


def cards(outcome: NotchDesignOutcome) -> list[Card]:
    """The tip before and after, by order."""
    made = []
    for row in outcome.best.peaks:
        before = (outcome.none if outcome.request.is_given or outcome.given is None else outcome.given).peak(row.order)
        change = f"{100.0 * (row.rising_mm / before.rising_mm - 1.0):+.0f} % peak".replace("-", "−")
        limit = outcome.problem.requirements.tip_mm
        mark = Mark(row.worst_mm <= limit, f"worst plant {row.worst_mm:.3f}, limit ±{limit:g} mm")
        title = f"Tip on the ramp, k = {row.order:g}, predicted"
        made.append(Card(title, f"{before.rising_mm:.3f}", "mm", (CardStep(f"{row.rising_mm:.3f}", change, mark),)))
    return made


def filters(outcome: NotchDesignOutcome) -> ReportTable | None:
    """The parameters, given and designed."""
    columns: list[tuple[str, dict[str, object]]] = []
    for name, verdict in (("given", outcome.given), ("designed", outcome.designed)):
        if verdict is not None:
            columns += [(f"{name}, k = {notch.order}", notch_table(notch).model_dump()) for notch in verdict.notches]
    if not columns:
        return None
    names = {
        "shape": "shape over the speed", "order": "k", "offset_hz": "ω_d/2π (Hz)", "zeta_rn": "ζ_rn", "zeta_rdth": "ζ_rdth",
        "start_rps": "f_s (rev/s)", "end_rps": "f_e (rev/s)", "ramp_rps": "slopes of a trapezoid (rev/s)",
        "hysteresis_rps": "hysteresis (rev/s)", "speed_lowpass_hz": "low-pass of f_m (Hz)",
    }  # fmt: skip
    rows: list[list[Cell]] = [
        [text, *(each if isinstance(each := values[key], str) else f"{each:g}" for _, values in columns)]
        for key, text in names.items()
    ]
    return ReportTable("filters", "Parameters of the notch", ("", *(name for name, _ in columns)), rows, paper="Table 3")


def _verdicts(outcome: NotchDesignOutcome) -> list[tuple[str, NotchVerdict]]:
    pairs = (("none", outcome.none), ("given", outcome.given), ("designed", outcome.designed))
    return [(name, one) for name, one in pairs if one is not None]


def peaks(outcome: NotchDesignOutcome) -> ReportTable:
    """The tip on the ramp: without, given, designed."""
    rows: list[list[Cell]] = []
    limit = outcome.problem.requirements.tip_mm
    for name, verdict in _verdicts(outcome):
        for row in verdict.peaks:
            before = NONE
            if outcome.given is not None and name == "designed":
                before = f"{100.0 * (row.rising_mm / outcome.given.peak(row.order).rising_mm - 1.0):+.1f} %".replace("-", "−")
            numbers = (number(value, "{:.4f}") for value in (row.rising_mm, row.falling_mm, row.worst_mm))
            others = ", ".join(f"{mm:.4f} at {rate:g}" for rate, mm in row.other_mm) or NONE
            rows.append([name, f"{row.order:g}", *numbers, row.worst_member, others, before, Mark(row.worst_mm <= limit)])
    header = (
        "filters", "k", "rising (mm)", "falling (mm)", "worst plant (mm)", "which", "other ramps (mm at rev/s²)", "against given",
        f"≤ {limit:g} mm",
    )  # fmt: skip
    caption = (
        "Predicted largest equivalent displacement of the tip at the judged speeds, on ramps up (rising) and down (falling) "
        "with the bench file's constant acceleration. `hil run constant-acceleration` measures the rising one. Other ramps: the "
        "nominal plant, the larger of up and down."
    )
    return ReportTable("peaks", "Predicted tip peak on the ramp", header, rows, {0, 5}, caption, paper="Figs. 13 and 14")


def requirements(outcome: NotchDesignOutcome) -> ReportTable:
    """Table of the requirements, with the worst value of each."""
    rows: list[list[Cell]] = []
    groups = {}
    for name, verdict in reversed(_verdicts(outcome)):
        groups[len(rows)] = f"{name} filter" if name != "none" else "no filter"
        for check in verdict.checks:
            asked = f"{'≤' if check.is_ceiling else '≥'} {check.limit:g}"
            speed = NONE if check.speed_rps is None else f"{check.speed_rps:.2f}"
            worst = number(check.value, "{:.4g}")
            cells: list[Cell] = [check.name.rstrip(","), worst, asked, check.unit, speed, check.member, Mark(check.holds)]
            rows.append(cells)
    header = ("what", "worst", "asked", "unit", "at (rev/s)", "plant", "holds")
    step = f"every {outcome.f_al_hz / VERDICT_STEPS:.2g} rev/s"
    caption = (
        f"The worst of all plants and of all motor speeds from rest to the speed limit, {step}. Peaks relative to those without "
        "a filter: on the bench file's ramp, and the largest of an order on any ramp."
    )
    return ReportTable("requirements", "Requirements", header, rows, {0, 3, 5, 6}, caption, groups=groups)


def on_the_arm(outcome: NotchDesignOutcome) -> ReportTable:
    """Margins on the arm by posture, of the best filters."""
    limits = outcome.problem.requirements
    rows: list[list[Cell]] = []
    count = 0 if outcome.problem.arm is None else len(outcome.problem.arm.cases)
    plain, filtered = outcome.best.postures[:count], outcome.best.postures[count:]
    worst = max(filtered, key=lambda row: row.sensitivity_peak, default=None)
    for row in (*plain, *(() if worst is None else (worst,))):
        values = (row.sensitivity_peak, row.speed_rps, row.phase_margin_deg, row.gain_margin_db)
        holds = row.sensitivity_peak <= limits.max_sensitivity and row.phase_margin_deg >= limits.phase_margin_deg
        rows.append([row.label, *(number(value, "{:.2f}") for value in values), Mark(holds)])
    caption = (
        "The arm is frozen in each posture, with this axis' filters at every motor speed. M_s is that of this axis' loop; "
        "brakes or their own loops hold the other motors. Last row: the worst while a filter of another axis acts. "
        + " ".join(f"{note[0].upper()}{note[1:]}." for note in outcome.notes)
    )
    header = ("posture", "M_s", "at (rev/s)", "phase margin (°)", "gain margin (dB)", "holds")
    return ReportTable("arm-margins", "Margins on the arm", header, rows, {0, 5}, caption)


def plants(outcome: NotchDesignOutcome) -> ReportTable:
    """The set of plants."""
    rows: list[list[Cell]] = []
    orders = [order for order, size in sorted(outcome.problem.members[0].error.amplitude_arcsec.items()) if size > 0.0]
    for member in outcome.problem.members:
        plant = member.plant
        gear = 1e-3 * plant.gear_stiffness_nm_rad, plant.arm_inertia_kg_m2, plant.gear_damping_nm_s_rad
        numbers = (*gear, plant.antiresonance_hz, outcome.problem.loop(member).peak_hz())
        amplitudes = (f"{member.error.amplitude_arcsec[order]:.3g}" for order in orders)
        rows.append([member.label, *(number(value, "{:.4g}") for value in numbers), *amplitudes])
    sizes = (f"A_{order:g} (arcsec)" for order in orders)
    header = ("plant", "K_g (kN·m/rad)", "J_l (kg·m²)", "D_g (N·m·s/rad)", "f_a (Hz)", "f_al (Hz)", *sizes)
    caption = f"Plant from {outcome.source}. Every requirement is checked for each plant."
    return ReportTable("plant-set", "Plants for which the filter is designed", header, rows, caption=caption)


def provenance(outcome: NotchDesignOutcome) -> list[tuple[str, str]]:
    """Bench, plant, loop and search of the design."""
    request, problem = outcome.request, outcome.problem
    effort = request.effort
    lines = [
        ("Bench", outcome.bench.name),
        ("Plant from", outcome.source),
        ("Loop", f"every {1e6 * problem.period_s:g} µs, {problem.delay_samples} samples of delay"),
        ("Speed limit", f"{problem.speed_limit_rps:g} rev/s"),
    ]
    if not request.is_given:
        lines.append(
            ("Search", f"{', '.join(request.shapes)}; {effort.evaluations * len(request.shapes)} evaluations, seed {effort.seed}")
        )
    return lines


SHOWN_FREQUENCIES = (0.34, 2.2)
"""Band of the figures in units of f_al."""

GIVEN: style.Line = {"color": style.GREEN, "linestyle": (0, (5, 1.5, 1, 1.5)), "linewidth": 1.2}


def verdicts(outcome: NotchDesignOutcome) -> list[tuple[str, NotchVerdict, style.Line]]:
    """Return the verdicts to draw, with name and line style."""
    drawn: list[tuple[str, NotchVerdict, style.Line]] = [("no filter", outcome.none, style.WITHOUT)]
    if outcome.given is not None:
        drawn.append(("given filter", outcome.given, GIVEN))
    if outcome.designed is not None and outcome.designed.notches:
        drawn.append(("designed filter", outcome.designed, style.WITH))
    return drawn


def families(outcome: NotchDesignOutcome) -> Drawing | None:
    """Draw |F_n| and |G_al| from f_s to f_e; Figs. 9 and 11."""
    best = outcome.best
    own = [notch for notch in best.notches if notch.order in outcome.request.orders]
    if not own:
        return None
    figure, panels = style.panels(3, len(own), 7.6, sharey="row", height_ratios=(2, 3, 3))
    norm = notches.speed_norm(own)
    shown = _shown_hz(outcome)
    frequency = np.linspace(*shown, 1601)
    loop = outcome.loop(best.notches)
    for column, notch in enumerate(own):
        gain, arm, line = panels[:, column]
        bound = _bound(outcome, notch.order, frequency)
        notches.draw_family(gain, arm, loop, notch, norm, frequency)
        arm.plot(frequency, bound, **style.CONSTRAINT)
        bare = outcome.loop().acceleration_per_transmission_error(frequency)
        arm.plot(frequency, style.decibel(bare), **style.WITHOUT)
        _on_the_line(outcome, line, notch.order)
        gain.set_title(f"k = {notch.order}")
        for panel in (gain, arm):
            panel.set(xlim=shown, xlabel="Frequency (Hz)")
        line.set_xlabel("Frequency on the line, k $f_m$ (Hz)")
    style.name_rows(panels, "$|F_n|$ (dB)", r"$|G_{al}|$ (dB re 1/s²)", "on the line (dB)")
    style.legend_above(figure, panels[2, 0])
    notches.colour_bar(figure, panels[:2], norm, shrink=0.6)
    caption = (
        f"Filters frozen at {notches.FEW} motor speeds from f_s (faint) to f_e (strong), for the nominal plant. Middle: dots "
        "mark each curve at its own harmonic ω = 2π k f_m, where constraint (5), |G_al| ≤ A_acc ω²/(L A_k), has to hold; dashed: "
        "without a filter. Bottom: these dots for all speeds as one curve."
    )
    title = "Gain of the filter and of G_al"
    return style.drawing(figure, "families", title, caption, "computed", "Figs. 9 and 11", is_zoomable=True)


def _on_the_line(outcome: NotchDesignOutcome, panel: Axes, order: int) -> None:
    low_hz, high_hz = _shown_hz(outcome)
    speeds = np.linspace(0.25 * low_hz / order, min(outcome.problem.speed_limit_rps, high_hz / order), 361)
    line = order * speeds
    for name, verdict, look in verdicts(outcome):
        panel.plot(line, notches.on_the_line_db(outcome.loop(verdict.notches), order, speeds), label=name, **look)
    panel.plot(line, _bound(outcome, order, line), label="constraint (5)", **style.CONSTRAINT)
    panel.set_xlim(low_hz, high_hz)
    panel.set_ylim(bottom=style.decibel(np.array([(2.0 * math.pi * low_hz) ** 2]))[0] - 3.0)


def _shown_hz(outcome: NotchDesignOutcome) -> tuple[float, float]:
    """Band of the figures: the resonance and the filters' frequencies around it."""
    return SHOWN_FREQUENCIES[0] * outcome.f_al_hz, SHOWN_FREQUENCIES[1] * outcome.f_al_hz


def _bound(outcome: NotchDesignOutcome, order: int, frequency: Real) -> Real:
    problem = outcome.problem
    amplitude = problem.members[0].error.amplitude_arcsec[order] * ARCSEC
    limit = 1e-3 * problem.requirements.tip_mm
    return style.decibel(acceleration_bound(frequency, amplitude, problem.lever_m, limit))


def nyquist(outcome: NotchDesignOutcome) -> Drawing | None:
    """Draw the open loop, whole and near the allowed M_s; Fig. 12."""
    best = outcome.best
    if not best.notches:
        return None
    figure, panels = style.panels(1, 2, 4.4)
    norm = notches.speed_norm(best.notches)
    loop = outcome.loop(best.notches)
    fine = np.linspace(FINE_BAND[0] * outcome.f_al_hz, FINE_BAND[1] * outcome.f_al_hz, 1400)
    grid = np.unique(np.concatenate([np.geomspace(1.0, 0.49 / loop.period_s, 700), fine]))
    low, high = min(n.start_rps for n in best.notches), max(n.end_rps for n in best.notches)
    for speed in np.linspace(low, high, 2 * notches.FAMILY):
        response = loop.open_loop(grid, float(speed))
        for panel in panels[0]:
            panel.plot(response.real, response.imag, color=style.SPEED_COLOURS(norm(speed)), linewidth=0.6)
    allowed = outcome.problem.requirements.max_sensitivity
    worst_rps = max(best.margins, key=lambda speed: best.margins[speed].sensitivity_peak)
    worst = best.margins[worst_rps].sensitivity_peak
    response = loop.open_loop(grid, float(worst_rps))
    for panel in panels[0]:
        notches.draw_worst(panel, response, f"worst speed, {worst_rps:.2f} rev/s")
    for panel in panels[0]:
        notches.draw_critical_point(
            panel,
            (1.0 / allowed, f"$M_s$ = {allowed:g}, allowed", style.CONSTRAINT),
            (1.0 / worst, f"$M_s$ = {worst:.2f}, nominal plant", style.MODEL),
        )
    panels[0, 0].set(xlim=(-5.0, 5.0), ylim=(-5.0, 4.0), ylabel="Imaginary part (–)")
    panels[0, 1].set(xlim=(-1.9, 0.3), ylim=(-1.2, 0.8), title="near −1")
    style.legend_above(figure, panels[0, 0])
    notches.colour_bar(figure, panels, norm, shrink=0.6)
    caption = (
        "Nyquist diagrams of L(jω) for the nominal plant. The filters are frozen at motor speeds from f_s (faint) to f_e "
        f"(strong); the loop is sampled every {1e6 * loop.period_s:.0f} µs with {loop.delay_samples} samples of delay. "
        "Cross: −1. No curve may enter the dashed circle of the allowed M_s."
    )
    return style.drawing(figure, "nyquist", "Open loop with the filter", caption, "computed", "Fig. 12", is_zoomable=True)


def margin_curves(outcome: NotchDesignOutcome) -> Drawing:
    """Draw M_s, gain and phase margin over motor speed, with requirements."""
    figure, panels = style.panels(1, 3, 2.6, sharex=True)
    requirements = outcome.problem.requirements
    for name, verdict, look in verdicts(outcome):
        notches.draw_margins(panels[0], verdict.margins, label=name, **look)
    notches.draw_required_margins(panels[0], requirements, outcome.problem.speed_limit_rps, "asked")
    limits = (requirements.max_sensitivity, requirements.gain_margin_db, requirements.phase_margin_deg)
    for column, (panel, limit) in enumerate(zip(panels[0], limits, strict=True)):
        bottom, top = panel.get_ylim()
        panel.set_ylim(1.0 if column == 0 else 0.0, max(top, 1.1 * limit) if column else max(top, limit + 0.1, bottom + 0.2))
    style.legend_above(figure, panels[0, 0])
    caption = (
        "Nominal plant, filters frozen at each speed from rest to the speed limit; a switched filter also counts as active "
        "within its hysteresis. Dotted: the requirements. Their table lists the worst of all plants."
    )
    return style.drawing(figure, "margins", "Margins at every motor speed", caption, "computed", "with Fig. 12", is_zoomable=True)


def ramps(outcome: NotchDesignOutcome) -> Drawing:
    """Draw the simulated tip on the ramp over the motor speed."""
    figure, panels = style.panels(1, 2, 3.0, sharey=True)
    problem, limit = outcome.problem, outcome.problem.requirements.tip_mm
    scale = scale_at(outcome.bench, outcome.request.axis, outcome.f_al_hz)
    low = 0.8 * min(problem.window_rps(order)[0] for order in outcome.orders)
    for name, verdict, look in verdicts(outcome):
        loop, load_nm = outcome.loop(verdict.notches), (problem.friction_nm + problem.gravity_nm, 0.0)
        motion = follow(loop, problem.members[0].error, problem.ramps[0].reference_rad, load_nm=load_nm)
        tip = tip_displacement_mm(problem.lever_m * motion.arm_acceleration_rad_s2, motion.period_s, scale)
        top = int(np.argmax(motion.motor_speed_rps))
        for panel, rows in zip(panels[0], (slice(0, top), slice(top, None)), strict=True):
            inside = motion.motor_speed_rps[rows] >= low
            panel.plot(motion.motor_speed_rps[rows][inside], tip[rows][inside], label=name, **{**look, "linewidth": 0.9})
    for panel, title in zip(panels[0], ("speed rising", "speed falling"), strict=True):
        for sign in (-1.0, 1.0):
            panel.axhline(sign * limit, **style.LIMIT)
        for order in outcome.orders:
            panel.axvspan(*problem.window_rps(order), color=style.SHADE, zorder=0)
        panel.set(title=title, xlabel="Motor speed $f_m$ (rev/s)")
    panels[0, 1].invert_xaxis()
    panels[0, 0].set_ylabel("Tip displacement (mm)")
    style.legend_above(figure, panels[0, 0])
    caption = (
        "Simulated ramps up and down with the bench file's constant acceleration, the nominal plant and the law at its sampling "
        f"time: equivalent displacement, {scale.band_hz[0]:.3g} to {scale.band_hz[1]:.3g} Hz. Shaded: the judged speeds; dotted: "
        "the specification. The filter does better at constant speed: on a ramp it has no time to settle."
    )
    return style.drawing(figure, "ramps", "Tip on the ramp, predicted", caption, "computed", "Figs. 13 and 14", is_zoomable=True)
