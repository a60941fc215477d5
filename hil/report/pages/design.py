"""The page of a designed notch: one self-contained HTML file."""

from pathlib import Path

from hil.bench.design import notch_table
from hil.design.notch_design import VERDICT_STEPS, NotchVerdict
from hil.design.uncertainty import plants_words
from hil.experiments.notch_design import NotchDesignOutcome
from hil.report import style
from hil.report.figures import design as figures_design
from hil.report.origin import origin_of_design
from hil.report.pages.page import Card, CardStep, Page, PageHead, PageVerdict, Section, filled_sections, render
from hil.report.report_table import NONE, Cell, Mark, ReportTable, number


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
        ("gain", "Gain", (figures_design.families(outcome),)),
        ("stability", "Stability", (figures_design.nyquist(outcome), figures_design.margin_curves(outcome))),
        ("ramp", "On the ramp", (figures_design.ramps(outcome),)),
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
        return PageVerdict("bad", "✘", headline, (*said, *map(str, failure.missed)))
    best = outcome.best
    which = "The given filters meet" if outcome.request.is_given else "The designed filters meet"
    details = tuple(str(check) for check in best.checks)
    return PageVerdict(
        "good", "✔", f"{which} all requirements, at every speed, for {plants_words(outcome.problem.members)}", details
    )


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
    rows: list[list[Cell]] = [[text, *(_cell(values[key]) for _, values in columns)] for key, text in names.items()]
    return ReportTable("filters", "Parameters of the notch", "Table 3", ("", *(name for name, _ in columns)), rows)


def _cell(value: object) -> str:
    return value if isinstance(value, str) else f"{value:g}"


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
    return ReportTable("peaks", "Predicted tip peak on the ramp", "Figs. 13 and 14", header, rows, frozenset({0, 5}), caption)


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
    return ReportTable("requirements", "Requirements", "", header, rows, frozenset({0, 3, 5, 6}), caption, groups=groups)


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
    return ReportTable("arm-margins", "Margins on the arm", "", header, rows, frozenset({0, 5}), caption)


def plants(outcome: NotchDesignOutcome) -> ReportTable:
    """The set of plants."""
    rows: list[list[Cell]] = []
    orders = [order for order, size in sorted(outcome.problem.members[0].error.amplitude_arcsec.items()) if size > 0.0]
    for member in outcome.problem.members:
        plant = member.plant
        peak = outcome.problem.loop(member).peak_hz()
        numbers = (
            1e-3 * plant.gear_stiffness_nm_rad,
            plant.arm_inertia_kg_m2,
            plant.gear_damping_nm_s_rad,
            plant.antiresonance_hz,
            peak,
        )
        amplitudes = (f"{member.error.amplitude_arcsec[order]:.3g}" for order in orders)
        rows.append([member.label, *(number(value, "{:.4g}") for value in numbers), *amplitudes])
    header = (
        "plant",
        "K_g (kN·m/rad)",
        "J_l (kg·m²)",
        "D_g (N·m·s/rad)",
        "f_a (Hz)",
        "f_al (Hz)",
        *(f"A_{order:g} (arcsec)" for order in orders),
    )
    caption = f"Plant from {outcome.source}. Every requirement is checked for each plant."
    return ReportTable("plant-set", "Plants for which the filter is designed", "", header, rows, caption=caption)


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
