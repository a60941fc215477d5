"""Experiments and their entries in `result.json`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hil.analysis import Metrics, judged_orders, shown_band
from hil.bench.bench import Bench
from hil.control.angles import ARCSEC
from hil.control.treatments import LoopName, TreatmentName
from hil.design.frequency import CONTROL_PERIOD_S, acceleration_bound, margins
from hil.design.paper import TABLE_1
from hil.experiments.bus_demand import BusDemand
from hil.experiments.judge import FoundScale, RunJudge, shown_rps, unreached
from hil.experiments.motions import (
    CONSTANT_ACCELERATION,
    LINE_MOTION,
    POINT_TO_POINT,
    constant_acceleration,
    line_motion,
    point_to_point,
)
from hil.experiments.treatment import FILTERING, REMEDIES, TITLES
from hil.experiments.window import JudgedWindow, judged_stop, judged_windows
from hil.master.motion import Motion, RunResult
from hil.recording import Recording
from hil.results.following import FollowingEntry
from hil.results.runs import (
    CancellationTrial,
    FilterTrial,
    PaperClaim,
    RingingMode,
    RunEntry,
    RunTiming,
    TreatmentComparison,
    leading,
)


@dataclass(frozen=True)
class Experiment:
    """One experiment to run.

    Attributes:
        name: `constant-acceleration`, `line-motion` or `point-to-point`.
        axis: The axis that moves alone; None for the line motion.
    """

    name: str
    axis: int | None
    treatment: TreatmentName
    loop: LoopName = "drive"

    @property
    def is_stop(self) -> bool:
        """True if the ringing after the stop is judged."""
        return self.name == POINT_TO_POINT

    @property
    def title(self) -> str:
        """Experiment in words."""
        where = "" if self.axis is None else f"axis {self.axis}, "
        with_ = "with the notch" if self.treatment == "notch" else TITLES[self.treatment]
        return f"{self.name}, {where}{self.loop}-closed, {with_}"

    @property
    def file_name(self) -> str:
        """File name of the recording."""
        axis = f"-axis{self.axis}" if self.axis is not None else ""
        return f"{self.name}{axis}-{self.loop}-{self.treatment}.csv"

    def period_s(self, bench: Bench) -> float:
        """SYNC period of the loop, s."""
        return bench.bus.host_sync_period_s if self.loop == "host" else bench.bus.sync_period_s

    def motion(self, bench: Bench) -> Motion:
        """Motion of the robot from the bench file, without a shaper."""
        period = self.period_s(bench)
        if self.axis is not None and self.is_stop:
            return point_to_point(bench, self.axis, period)
        if self.axis is not None:
            return constant_acceleration(bench, self.axis, period)
        return line_motion(bench, period)

    def bus_demand(self, motion: Motion) -> BusDemand:
        """Demand of the motion on the bus."""
        return BusDemand(
            self.title,
            motion.axes,
            motion.period_s,
            self.loop,
            with_notch=self.treatment in FILTERING,
            with_torque_offset=motion.torque_offset_nm is not None,
        )


def demo_experiments(bench: Bench) -> list[Experiment]:
    """List the experiments of the demo.

    These are axes 2 and 3 and the line, each without treatment, with the paper's notch and with cancellation; and axis 2
    host-closed, without and with the notch, as in the paper.
    """
    both: tuple[Literal["none"], Literal["notch"]] = ("none", "notch")
    axes = [number for number in (2, 3) if number in bench.axis]
    all_three: tuple[TreatmentName, ...] = (*both, "cancellation")
    plan = [Experiment(CONSTANT_ACCELERATION, axis, treatment) for axis in axes for treatment in all_three]
    if bench.line_motion is not None:
        plan += [Experiment(LINE_MOTION, None, treatment) for treatment in all_three]
    if 2 in bench.axis:
        plan += [Experiment(CONSTANT_ACCELERATION, 2, treatment, "host") for treatment in both]
    return plan


@dataclass(frozen=True)
class TrialVerdict:
    """Result of a treatment's trial, for the entries of its run.

    Attributes:
        trial: Runs of a cancellation's trial; None without one.
        refusal: Reason why the run was made without the treatment, and is not judged; or None.
        filters: Trial of designed filters; None without one.
        following: Trial of a cancellation that follows, and what it made of each order; None without one.
        plain: Recording of the trial's first run, on which nothing acts against the vibration; None without one.
    """

    trial: CancellationTrial | None = None
    refusal: str | None = None
    filters: FilterTrial | None = None
    following: FollowingEntry | None = None
    plain: Recording | None = None


NO_TRIAL = TrialVerdict()


def entries(
    bench: Bench,
    experiment: Experiment,
    result: RunResult,
    recording: str,
    trial: TrialVerdict = NO_TRIAL,
    repeated: int = 1,
    judge: RunJudge | None = None,
) -> list[RunEntry]:
    """Make the entries of one run.

    Args:
        result: Result of the run; of several runs their mean.
        recording: Path of the recording, from the result's directory.
        trial: End of the trial before the run.
        repeated: Number of runs in the mean.
        judge: Judge of all runs on the bench; None for one that knows only this run.
    """
    judge = RunJudge(bench) if judge is None else judge
    if experiment.is_stop:
        return [_stop_entry(judge, experiment, result, recording, repeated, trial)]
    is_ramp = experiment.axis is not None and result.stopped is None
    if is_ramp and experiment.treatment == "none":
        judge.look(result.recording, experiment.axis or 0)
    elif is_ramp and trial.plain is not None and judge.found(experiment.axis).scale is None:
        judge.look(trial.plain, experiment.axis or 0)  # a tip that is quiet no longer shows where it rang
    found = judge.found(experiment.axis)
    orders: tuple[int | None, ...] = (None,)
    if is_ramp:
        orders = judged_orders(found.scale, shown_rps(bench))
    missed: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
    if is_ramp and found.scale is not None:
        missed = unreached(bench, experiment.axis or 0, found.scale)
    windows = zip(orders, judged_windows(bench, experiment.axis, result, orders, found), strict=True)
    return [
        _entry(bench, experiment, result, found, order, window).model_copy(
            update={
                "recording": recording,
                "invalid": trial.refusal or window.invalid,
                "within_spec": None if trial.refusal is not None else window.is_within,
                "trial": trial.trial,
                "filter_trial": trial.filters,
                "following": trial.following,
                "repeated": repeated if repeated > 1 else None,
                "unjudged_orders": missed[0] or None,
                "unreached_orders": missed[1] or None,
            }
        )
        for order, window in windows
    ]


def _stop_entry(
    judge: RunJudge, experiment: Experiment, result: RunResult, recording: str, repeated: int, trial: TrialVerdict
) -> RunEntry:
    """Make the entry of a point-to-point move."""
    axis = experiment.axis or 0
    found = judge.found(axis)
    stop = judged_stop(judge.bench, axis, result, found, judge.rates(axis))
    ringing = stop.ringing
    waves = () if ringing is None else zip(ringing.modes, ringing.amplitude_mm, ringing.error_mm, strict=True)
    modes = [
        RingingMode(frequency_hz=mode.frequency_hz, damping=mode.damping, amplitude_mm=size, error_mm=error)
        for mode, size, error in waves
    ]
    return _entry(judge.bench, experiment, result, found, None, stop.window).model_copy(
        update={
            "recording": recording,
            "invalid": trial.refusal or stop.window.invalid,
            "within_spec": None if trial.refusal is not None else stop.window.is_within,
            "trial": trial.trial,
            "repeated": repeated if repeated > 1 else None,
            "ringing": tuple(modes) or None,
        }
    )


def _entry(
    bench: Bench, experiment: Experiment, result: RunResult, found: FoundScale, order: int | None, window: JudgedWindow
) -> RunEntry:
    scale = found.scale
    return RunEntry(
        experiment=experiment.name,
        axis=experiment.axis,
        treatment=experiment.treatment,
        loop=experiment.loop,
        sync_period_s=experiment.period_s(bench),
        control_period_s=result.control_period_s,
        order=order,
        **(dict.fromkeys(Metrics.__dataclass_fields__) if window.metrics is None else vars(window.metrics)),
        within_spec=None,
        cycles=result.cycles,
        missed_cycles=result.missed_cycles,
        wall_s=round(result.wall_s, 4),
        motion_s=round(result.motion_s, 6),
        recording="",
        bus_errors=result.bus_errors or None,
        discarded_positions=result.discarded or None,
        timing=timing_of(result),
        stopped=None if result.stopped is None else result.stopped.reason,
        f_al_hz=None if scale is None or found.source is None else scale.f_al_hz,
        f_al_source=found.source,
        f_al_error_hz=found.error_hz,
        f_al_words=None if scale is None else found.words,
        remark=found.remark,
        window_rps=None if scale is None or order is None else scale.windows_rps[order],
        band_hz=None if scale is None else shown_band(experiment.period_s(bench), scale.band_hz),
    )


def timing_of(result: RunResult) -> RunTiming | None:
    """Timing of a run's cycles for the result file; None in lock-step."""
    return None if result.timing is None else RunTiming(dropped_cycles=result.dropped_cycles, **vars(result.timing))


def comparisons(runs: Sequence[RunEntry]) -> list[TreatmentComparison]:
    """Compare each treatment with none, in every pair of runs."""
    pairs = []
    leads = leading(runs)
    for run in leads:
        if run.treatment != "none" or run.tip_peak_mm is None:
            continue
        for other in leads:
            if other.treatment == "none" or other.tip_peak_mm is None or _conditions(other) != _conditions(run):
                continue
            same = same_window(runs, other, run)
            comparison = TreatmentComparison(
                experiment=run.experiment,
                axis=run.axis,
                loop=run.loop,
                treatment=other.treatment,
                tip_peak_reduction_pct=_reduction_pct(run.tip_peak_mm, other.tip_peak_mm),
                spectrum_area_reduction_pct=_reduction_pct(run.spectrum_area, same.spectrum_area),
            )
            pairs.append(comparison)
    return pairs


def same_window(runs: Sequence[RunEntry], run: RunEntry, untreated: RunEntry) -> RunEntry:
    """Return the entry of a run in the leading window of the untreated one, if it has that."""
    return next((each for each in runs if each.recording == run.recording and each.order == untreated.order), run)


def _conditions(run: RunEntry) -> tuple[str, int | None, str]:
    """Conditions in which runs that are compared with each other agree."""
    return run.experiment, run.axis, run.loop


def _reduction_pct(before: float | None, after: float | None) -> float:
    return round(100.0 * (1.0 - after / before), 3) if before and after is not None else 0.0


# -- the paper's claims ------------------------------------------------------------------------------------------------

PAPER_LINE_AREA_PCT = 26.0
"""Bound: reduction of the area of the line motion's spectrum; section 5.2 of the paper."""

TOLERANCE = 0.005
"""Bound: relative difference up to which a figure of Table 1 counts as met: they have three to four digits."""


Number = int | float | str


def _claim(claim: str, source: str, paper: Number, bench: Number, unit: str, holds: bool) -> PaperClaim:
    return PaperClaim(claim=claim, source=source, paper=paper, bench=bench, unit=unit, holds=holds)


def claims(bench: Bench, runs: Sequence[RunEntry], pairs: Sequence[TreatmentComparison]) -> list[PaperClaim]:
    """Check the paper's claims that the runs concern.

    Args:
        bench: The bench file of the paper's robot.
        pairs: Comparisons of the runs.
    """
    return [*_design_claims(bench), *_measured_claims(bench, runs), *_line_claims(pairs)]


def outside(runs: Sequence[RunEntry]) -> list[RunEntry]:
    """Runs with a remedy that do not keep the specification."""
    return [run for run in leading(runs) if run.treatment in REMEDIES and run.within_spec is False]


def _design_claims(bench: Bench) -> list[PaperClaim]:
    """Check the claims of section 3.1, Table 1 and section 4.2."""
    rows = []
    for axis, (f_al, f_m2, f_m4) in TABLE_1.items():
        table = bench.axis.get(axis)
        loop = None if table is None else table.loop(CONTROL_PERIOD_S)
        if loop is None or table is None:
            continue
        plant, peak = loop.plant, loop.peak_hz()
        anti, resonance = plant.antiresonance_hz, plant.resonance_hz
        name = f"axis {axis}"
        rows += [
            _claim(f"{name}: resonance around 22 Hz", "section 3.1", 22, round(resonance, 2), "Hz", abs(resonance - 22) <= 1),
            _claim(f"{name}: anti-resonance around 12 Hz", "section 3.1", 12, round(anti, 2), "Hz", abs(anti - 12) <= 1),
            _claim(f"{name}: gain peak of G_al", "Table 1", f_al, round(peak, 3), "Hz", _close(peak, f_al)),
            _claim(f"{name}: excitation speed, k = 2", "Table 1", f_m2, round(peak / 2, 3), "rev/s", _close(peak / 2, f_m2)),
            _claim(f"{name}: excitation speed, k = 4", "Table 1", f_m4, round(peak / 4, 3), "rev/s", _close(peak / 4, f_m4)),
        ]
        if not table.notch:
            continue
        low, high = table.notch[0].start_rps, table.notch[0].end_rps
        speeds = np.linspace(low, high, 51)
        worst = max(_gain_over_bound(bench, axis, float(speed)) for speed in speeds)
        rows.append(
            _claim(f"{name}: |G_al| on the line over constraint (5), with the notch", "Fig. 11", "≤ 1", round(worst, 3), "",
                   worst <= 1.0)
        )  # fmt: skip
        at_speeds = [margins(loop, float(speed)) for speed in (0.0, *speeds)]
        phase = min(margin.phase_margin_deg for margin in at_speeds)
        stable = all(margin.stable for margin in at_speeds)
        peak_s = max(margin.sensitivity_peak for margin in at_speeds)
        rows.append(
            _claim(f"{name}: stable at every motor speed (smallest phase margin; M_s {peak_s:.2f})", "Fig. 12", "stable",
                   round(phase, 1), "°", stable)
        )  # fmt: skip
    return rows


def _gain_over_bound(bench: Bench, axis: int, speed_rps: float) -> float:
    table = bench.axis[axis]
    loop = table.loop(CONTROL_PERIOD_S)
    assert loop is not None and table.model is not None  # noqa: S101, PT018 - the caller has looked
    line = np.array([2.0 * speed_rps])
    gain = np.abs(loop.acceleration_per_transmission_error(line, speed_rps))
    limit_m = 1e-3 * bench.specification.tip_mm
    return float(gain[0] / acceleration_bound(line, table.model.ate.a2_arcsec * ARCSEC, table.tip_lever_m, limit_m)[0])


def _measured_claims(bench: Bench, runs: Sequence[RunEntry]) -> list[PaperClaim]:
    """Sections 3.2 and 5.1: measured over CAN."""
    rows = []
    limit = bench.specification.tip_mm
    singles = [(run, run.tip_peak_mm) for run in runs if run.axis is not None and run.tip_peak_mm is not None]
    for run, tip_peak_mm in singles:
        if run.order != 2:
            continue
        name = f"axis {run.axis}, {run.loop}-closed"
        peak = round(tip_peak_mm, 4)
        if run.treatment == "notch":
            claim = f"{name}: tip within ±{limit:g} mm with the notch"
            rows.append(_claim(claim, "section 5.1", f"≤ {limit:g}", peak, "mm", peak <= limit))
            continue
        if run.treatment != "none":
            continue
        claim = f"{name}: tip outside ±{limit:g} mm without it"
        rows.append(_claim(claim, "section 5.1", f"> {limit:g}", peak, "mm", peak > limit))
        fourth = [other_mm for other, other_mm in singles if other.order == 4 and other.recording == run.recording]
        if fourth and fourth[0]:
            ratio = tip_peak_mm / fourth[0]
            claim = f"{name}: the 2nd order shakes the tip more than the 4th"
            rows.append(_claim(claim, "section 3.2", "> 1", round(ratio, 2), "times", ratio > 1.0))
    return rows


def _line_claims(pairs: Sequence[TreatmentComparison]) -> list[PaperClaim]:
    """Section 5.2: measured over CAN."""
    return [
        _claim("line motion: area of the acceleration spectrum falls", "section 5.2", PAPER_LINE_AREA_PCT, round(area, 1), "%",
               area >= PAPER_LINE_AREA_PCT)
        for area in (
            pair.spectrum_area_reduction_pct for pair in pairs if pair.experiment == LINE_MOTION and pair.treatment == "notch"
        )
        if math.isfinite(area)
    ]  # fmt: skip


def _close(value: float, paper: float) -> bool:
    return abs(value - paper) <= TOLERANCE * paper
