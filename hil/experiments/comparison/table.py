"""Table of a comparison."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace

from hil.bench.bench import Bench
from hil.design.compliance import Compliance, compliance, judged_speeds
from hil.experiments.comparison.plan import ComparisonPlan, ComparisonRequest
from hil.experiments.plan import Experiment, same_window
from hil.experiments.treatment import TreatmentSetup
from hil.results.comparison import AxisCompliance, ComparisonRobot, ComparisonRow, ComplianceFactors
from hil.results.runs import ExperimentsResult, RunEntry, TreatmentComparison, leading

Key = tuple[str, int | None, str, str]
"""Experiment, axis, treatment, and the side that closes the loop."""
Runs = Mapping[Key, RunEntry]
"""Runs by key; of a ramp the window that speaks for it."""


def gathered(plan: ComparisonPlan, directory: str, result: ExperimentsResult | None, ended: str) -> ComparisonRobot:
    """Gather one robot's rows.

    Args:
        result: Result of its runs; None without one.
        ended: Reason why they ended early; empty if they did not.
    """
    bench = plan.robot.bench
    entries = [] if result is None else result.runs
    runs = {_key(run): run for run in leading(entries)}
    changes = {_key(change): change for change in ([] if result is None else result.comparisons)}
    rows = []
    for experiment, setup in plan.setups.items():
        key = _key_of(experiment)
        row = _row(experiment, _factors(bench, experiment, setup, runs.get(key)))
        run, untreated = runs.get(key), runs.get((experiment.name, experiment.axis, "none", experiment.loop))
        area = None if run is None else same_window(entries, run, untreated or run).spectrum_area
        rows.append(_measured(row, run, area, changes.get(key), ended))
    rows += [_row(left.experiment, left_out=left.reason) for left in plan.left_out]
    return ComparisonRobot(
        name=bench.name,
        source=plan.robot.source,
        directory=directory,
        bus=bench.bus.address,
        tip_mm=bench.specification.tip_mm,
        rows=tuple(rows),
        compliance=tuple(entry for number in sorted(bench.axis) for entry in _compliances(plan, number, runs)),
        not_restored=(() if result is None else result.not_restored) or (),
        versions=None if result is None else result.bench.versions,
        ended=ended or None,
        emulated=None if result is None else result.emulated,
        emulated_parts=None if result is None else result.emulated_parts,
        all_disabled=None if result is None else result.all_disabled,
        line_axes=tuple(bench.chain_axes) or None,
    )


def _key(of: RunEntry | TreatmentComparison) -> Key:
    return of.experiment, of.axis, of.treatment, of.loop


def _key_of(experiment: Experiment) -> Key:
    return experiment.name, experiment.axis, experiment.treatment, experiment.loop


def _row(experiment: Experiment, compliance: ComplianceFactors | None = None, left_out: str | None = None) -> ComparisonRow:
    return ComparisonRow(
        experiment=experiment.name,
        axis=experiment.axis,
        treatment=experiment.treatment,
        loop=experiment.loop,
        tip_peak_mm=None,
        tip_peak_change_pct=None,
        spectrum_area=None,
        spectrum_area_change_pct=None,
        within_spec=None,
        trial=None,
        compliance=compliance,
        left_out=left_out,
    )


def _measured(
    row: ComparisonRow, run: RunEntry | None, area: float | None, change: TreatmentComparison | None, ended: str
) -> ComparisonRow:
    if run is None:
        return row.model_copy(update={"not_judged": ended or "not run"})
    values: dict[str, object] = {"recording": run.recording, "shaper": run.shaper}
    if run.trial is not None:
        whole = "accepted in part" if run.trial.refused else "accepted"
        values["trial"] = whole if run.trial.is_good else "refused"
    if run.filter_trial is not None:
        values["trial"] = "accepted" if run.filter_trial.is_good else "refused"
    if run.invalid is not None or run.stopped is not None:
        return row.model_copy(update=values | {"not_judged": run.invalid or run.stopped})
    values |= {"tip_peak_mm": run.tip_peak_mm, "spectrum_area": area, "within_spec": run.within_spec}
    values["ramp_peak_mm"] = run.ramp_peak_mm
    if change is not None:
        values["tip_peak_change_pct"] = round(-change.tip_peak_reduction_pct, 3)
        values["spectrum_area_change_pct"] = round(-change.spectrum_area_reduction_pct, 3)
    return row.model_copy(update=values)


# -- compliance of treatments --------------------------------------------------------------------------------------------------


def _moved(bench: Bench, experiment: Experiment) -> tuple[int, ...]:
    return bench.chain_axes if experiment.axis is None else (experiment.axis,)


def _factors(bench: Bench, experiment: Experiment, setup: TreatmentSetup, run: RunEntry | None) -> ComplianceFactors | None:
    """Compliance factors of a treatment, for the worst moved axis."""
    if run is None:
        return None
    moved = _moved(bench, experiment)
    pairs = [(_compliance(bench, number, None, run), _compliance(setup.bench, number, setup, run)) for number in moved]
    ratios = [(after.slow / before.slow, after.peak / before.peak) for before, after in pairs if before and after]
    if not ratios:
        return None
    slow, peak = (round(max(each), 3) for each in zip(*ratios, strict=True))
    return ComplianceFactors(slow=slow, peak=peak)


def _compliance(bench: Bench, number: int, setup: TreatmentSetup | None, run: RunEntry) -> Compliance | None:
    with_notch = setup is not None and setup.filters == "notch"
    loop = bench.axis[number].loop(run.control_period_s, int(run.loop == "host"), with_notch=with_notch)
    if loop is None:
        return None
    if setup is not None and number in setup.fixed:
        loop = replace(loop, fixed=(setup.fixed[number],))
    return compliance(loop, judged_speeds(loop))


def _compliances(plan: ComparisonPlan, number: int, runs: Runs) -> Iterable[AxisCompliance]:
    entries: dict[tuple[str, str], AxisCompliance] = {}
    for experiment, setup in plan.setups.items():
        run = runs.get(_key_of(experiment))
        key = (experiment.treatment, experiment.loop)
        if (
            run is None
            or number not in _moved(setup.bench, experiment)
            or setup.is_cancelled
            or setup.is_inside
            or key in entries
        ):
            continue
        one = _compliance(setup.bench, number, setup, run)
        if one is not None:
            entries[key] = AxisCompliance(axis=number, treatment=key[0], loop=key[1], **asdict(one))
    return entries.values()


# -- the table as text -----------------------------------------------------------------------------------------------------


def unmet(robots: Sequence[ComparisonRobot], request: ComparisonRequest) -> list[str]:
    """Sentences on named treatments that were not compared or judged."""
    reasons = []
    for robot in robots:
        for row in robot.rows:
            reason = row.not_judged or (row.left_out if row.treatment in request.named else None)
            if reason:
                reasons.append(f"{robot.name}, {_where(row)}, {row.treatment}: {reason}")
    return reasons


def _where(row: ComparisonRow) -> str:
    return "line motion" if row.axis is None else f"axis {row.axis}"
