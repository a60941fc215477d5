"""Tables of a comparison: treatments, compliance, and omitted runs."""

from markupsafe import Markup

from hil.experiments.treatment import TITLES
from hil.report.material import case_name
from hil.report.report_table import NONE, Cell, Columns, Mark, ReportTable, number, tabulate, with_error
from hil.results.comparison import AxisCompliance, ComparisonRow, TourResult, TreatmentTable

TRIALS = {"accepted": True, "refused": False, "accepted in part": None}
"""Whether a trial has found a treatment good, by its end."""


def cases(result: TreatmentTable) -> list[tuple[str, int | None]]:
    """Return experiments, each with axis or None, in their order."""
    return list(dict.fromkeys((row.experiment, row.axis) for robot in result.robots for row in robot.rows))


def treatment_words(row: ComparisonRow | AxisCompliance) -> str:
    """Treatment of a row in words; a host-closed one is marked."""
    name: str = row.treatment
    return TITLES.get(name, name) + (", host-closed" if row.loop == "host" else "")


def overview(result: TreatmentTable, key: str = "overview", caption: str | Markup = "") -> ReportTable | None:
    """The tip's peak of every treatment in every experiment."""
    if not any(row.tip_peak_mm is not None for robot in result.robots for row in robot.rows):
        return None
    columns, several = cases(result), len(result.robots) > 1
    rows: list[list[Cell]] = []
    for robot in result.robots:
        treatments = list(dict.fromkeys((row.treatment, row.loop) for row in robot.rows if row.left_out is None))
        for treatment in treatments:
            own = {(row.experiment, row.axis): row for row in robot.rows if (row.treatment, row.loop) == treatment}
            name = treatment_words(next(iter(own.values())))
            rows.append([*([robot.name] if several else []), name, *(_peak(own.get(case)) for case in columns)])
    head = ("robot", "treatment") if several else ("treatment",)
    header = (*head, *(f"{case_name(*case)} (mm)" for case in columns))
    limits = {robot.tip_mm for robot in result.robots}
    limit_text = f" Allowed: ±{limits.pop():g} mm." if len(limits) == 1 else ""
    text = caption or "Largest equivalent displacement of the tip in the window in which each run is judged."
    return ReportTable(key, "Tip peaks side by side", header, rows, range(len(head)), text + limit_text)


def claims(result: TreatmentTable, key: str = "tour-claims") -> ReportTable | None:
    """Tabulate a tour's claims beside the judged numbers."""
    if not isinstance(result, TourResult) or not result.tour.claims:
        return None
    rows: list[list[Cell]] = [
        [
            claim.claim,
            f"{'>' if claim.is_above else '≤'} {round(claim.asked, 4):g}",
            number(claim.found, "{:.4f}"),
            claim.unit,
            Mark(claim.holds),
        ]
        for claim in result.tour.claims
    ]
    header = ("Claim", "Asked", "Found", "Unit", "Holds")
    return ReportTable(key, "Claims", header, rows, {0, 1, 3, 4}, is_prose=True)


def notch_sentences(result: TreatmentTable) -> list[str]:
    """Sentences why a designed notch leaves more than the bench file's.

    Empty if it leaves at most as much in every experiment of a tour, or if there is no tour.
    """
    if not isinstance(result, TourResult) or not result.tour.notches:
        return []
    peaks = {
        (row.treatment, row.experiment, row.axis): row.tip_peak_mm
        for robot in result.robots
        for row in robot.rows
        if row.tip_peak_mm is not None
    }
    sentences, axes = [], set[int | None]()
    for case in cases(result):
        designed, given = peaks.get(("notch-designed", *case)), peaks.get(("notch", *case))
        if designed is not None and given is not None and designed > given:
            first, rest = case_name(*case)[0].upper(), case_name(*case)[1:]
            sentences.append(
                f"{first}{rest}: the designed notch leaves {designed:.3f} mm, the bench file's notch {given:.3f} mm."
            )
            axes.add(case[1])
    return [*sentences, *(str(each) for each in result.tour.notches if axes & {each.axis, None})]


def _peak(row: ComparisonRow | None) -> Cell:
    if row is None or row.left_out is not None:
        return Mark(None, "left out")
    if row.tip_peak_mm is None:
        return Mark(None, "refused by its trial" if row.trial == "refused" else "not judged")
    return Mark(row.within_spec, f"{row.tip_peak_mm:.3f}")


def experiment(result: TreatmentTable, name: str, axis: int | None) -> ReportTable:
    """Table of one experiment, with a row per robot and treatment."""
    robot: Columns[tuple[str, ComparisonRow]] = (("robot", lambda row: row[0]),) if len(result.robots) > 1 else ()
    columns: Columns[tuple[str, ComparisonRow]] = (
        *robot,
        ("treatment", lambda row: TITLES.get(row[1].treatment, row[1].treatment)),
        ("closed in", lambda row: row[1].loop),
        ("tip peak (mm)", lambda row: number(row[1].tip_peak_mm, "{:.4f}")),
        ("on the whole ramp (mm)", lambda row: number(row[1].ramp_peak_mm, "{:.4f}")),
        ("change", lambda row: number(row[1].tip_peak_change_pct, "{:+.0f} %")),
        ("spectrum area (m/s²·Hz)", lambda row: number(row[1].spectrum_area, "{:.3f}")),
        ("change", lambda row: number(row[1].spectrum_area_change_pct, "{:+.0f} %")),
        ("specification", lambda row: _within(row[1])),
        ("trial", lambda row: NONE if row[1].trial is None else Mark(TRIALS[row[1].trial], row[1].trial)),
        ("compliance at 1 Hz", lambda row: NONE if row[1].compliance is None else f"× {row[1].compliance.slow:.2f}"),
        ("largest", lambda row: NONE if row[1].compliance is None else f"× {row[1].compliance.peak:.2f}"),
    )
    rows = [
        (each.name, row)
        for each in result.robots
        for row in sorted(each.rows, key=lambda row: row.left_out is not None)  # as they were run, omitted ones at the end
        if (row.experiment, row.axis) == (name, axis)
    ]
    host = (
        " The fixed notch runs only on the host, which closes the loop over the bus with a sample of delay. It is compared with "
        "no treatment there."
    )
    caption = (
        "Tip peak: in the judged window. Whole ramp: except the jerks at its ends. Area: in the judged window of the untreated "
        "run. Changes are relative to no treatment, with the loop closed in the same place. Trial: a cancellation's own "
        "check at the tip before it is used. Compliance: how many times further the motor yields to a disturbing torque than "
        "without the treatment. Its columns hold for 1 Hz, and for the frequency from 0.1 to 30 Hz at which it yields most. It "
        "is that of the worst moved axis at the worst speed, and comes from the model."
        + (host if any(row.loop == "host" for _, row in rows) else "")
    )
    left, title = len(robot), f"{case_name(name, axis).capitalize()}: every treatment"
    return tabulate(f"table-{key_of(name, axis)}", title, columns, rows, caption, (*range(left + 2), left + 7, left + 8))


def _within(row: ComparisonRow) -> Mark:
    if row.left_out is not None or row.not_judged is not None:
        return Mark(None, "not judged" if row.left_out is None else "left out")
    return Mark(row.within_spec, "within" if row.within_spec else "outside")


def left_out(result: TreatmentTable) -> ReportTable:
    """Tabulate runs that were not made or not judged, by reason."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for robot in result.robots:
        for row in robot.rows:
            reason = row.left_out or row.not_judged
            if reason:
                where = "line motion" if row.axis is None else f"axis {row.axis}"
                reasons.setdefault((robot.name, reason), []).append(f"{treatment_words(row)} ({where})")
    rows: list[list[Cell]] = [[name, "; ".join(names), reason] for (name, reason), names in reasons.items()]
    return ReportTable("left-out", "Runs left out or not judged", ("robot", "what", "why"), rows, {0, 1, 2}, is_prose=True)


def compliances(result: TreatmentTable) -> ReportTable:
    """Table of the motor's compliance by axis and treatment."""
    rows: list[list[Cell]] = []
    several = len(result.robots) > 1
    for robot in result.robots:
        plain = {(each.axis, each.loop): each for each in robot.compliance if each.treatment == "none"}
        for each in robot.compliance:
            own = plain.get((each.axis, each.loop))
            pairs = () if own is None else ((each.slow, own.slow), (each.peak, own.peak))
            factors = [f"× {with_it / without:.2f}" for with_it, without in pairs] or [NONE, NONE]
            rows.append([
                *([robot.name] if several else []), f"axis {each.axis}", treatment_words(each),
                number(each.slow, "{:.4f}"), factors[0], number(each.peak, "{:.4f}"), factors[1],
                number(each.peak_hz, "{:.1f}"),
            ])  # fmt: skip
    head = ("robot",) if several else ()
    header = (*head, "axis", "treatment", "at 1 Hz (rad/(N·m))", "", "largest (rad/(N·m))", "", "at (Hz)")
    caption = (
        "|θ_m/τ_d| = |P/(1 + P C)|: how far a disturbing torque turns the motor with the loop closed, from the model. Filters "
        "that follow the speed: at the worst speed at which they act. Cancellation does not change the loop."
    )
    title = "What lower gains and filters cost: compliance of the motor"
    return ReportTable("compliance", title, header, rows, range(len(head) + 2), caption)


def tour(result: TreatmentTable) -> ReportTable | None:
    """Tabulate the steps of a tour; None without one."""
    if not isinstance(result, TourResult) or not result.tour.steps:
        return None
    part = result.tour
    rows: list[list[Cell]] = []
    for step in part.steps:
        linked: Cell = NONE
        if step.link:
            linked = Markup('<a href="{}">{}</a>').format(step.link, "report" if step.link.endswith(".html") else "file")
        rows.append([step.name, step.what, Mark(step.holds, ""), number(step.seconds, "{:.1f}"), linked])
    caption = Markup(
        "The bench file contained neither plant nor transmission error: <a href='{}'>{}</a>. Each step is a command of its own "
        "that can be repeated on a real robot."
    ).format(part.bench_file, part.bench_file)
    header = ("step", "result", "done", "time (s)", "")
    return ReportTable("tour", "From a bench file to a quiet arm", header, rows, {0, 1, 2, 4}, caption, is_prose=True)


def revealed(result: TreatmentTable) -> ReportTable | None:
    """Tabulate an emulated robot's true numbers beside the identified ones."""
    if not isinstance(result, TourResult) or not result.tour.facts:
        return None
    part = result.tour
    rows: list[list[Cell]] = []
    for fact in part.facts or ():
        shown, error = with_error(fact.estimate, fact.standard_error), NONE
        if fact.estimate is not None and fact.standard_error:
            error = f"{(fact.estimate - fact.truth) / fact.standard_error:+.1f}".replace("-", "−")
        rows.append([
            f"axis {fact.axis}", fact.name, fact.symbol or NONE, fact.unit, number(fact.truth, "{:.4g}"), shown, error,
        ])  # fmt: skip
    caption = Markup(
        "The robot of seed {seed}, read only after the last step: <a href='{file}'>{file}</a>. Off: difference between estimate "
        "and truth, in standard errors. A gear with hysteresis or a soft wind-up has no single stiffness: "
        "f<sub>a</sub> and K<sub>g</sub> then hold for the motion that identified them, the true values for a large torsion. "
        "Rows without an estimate: no command identifies them."
    ).format(seed=part.seed, file=part.robot_file)
    header = ("", "quantity", "", "unit", "truth", "found", "off")
    return ReportTable("revealed", "Truth and estimate", header, rows, {0, 1, 2, 3}, caption)


def key_of(experiment: str, axis: int | None) -> str:
    """Anchor of a case."""
    return experiment if axis is None else f"{experiment}-axis{axis}"
