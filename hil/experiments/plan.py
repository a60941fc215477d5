"""What is run and what comes of it: experiments, metrics, comparisons and the paper's claims, as `result.json` holds them."""

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from hil.analysis import Metrics, constant_acceleration_metrics, line_motion_metrics
from hil.design.frequency import ARCSEC, acceleration_bound, margins
from hil.experiments.motions import CONSTANT_ACCELERATION, LINE_MOTION, constant_acceleration, line_motion
from hil.experiments.treatment import ASKED, TITLES, TreatmentName
from hil.master.bench import Bench
from hil.master.run import Motion, RunResult
from hil.master.session import Loop
from hil.recording import Recording

F_AL_DEFAULT_HZ = 12.0
"""Peak of |G_al| where the bench file has no model: the paper's "around 12 Hz"."""


@dataclass(frozen=True)
class Experiment:
    """One run to be made.

    Attributes:
        name: `constant-acceleration` or `line-motion`.
        axis: The axis of a constant-acceleration run, else None.
        compensation: What acts against the transmission error.
        loop: Where the loop is closed.
    """

    name: str
    axis: int | None
    compensation: TreatmentName
    loop: Loop = "drive"

    @property
    def title(self) -> str:
        """For people."""
        where = f"axis {self.axis}" if self.axis is not None else "axes 2, 3, 5"
        with_ = {"none": "without", "notch": "with the notch"}.get(self.compensation, TITLES[self.compensation])
        return f"{self.name}, {where}, {self.loop}-closed, {with_}"

    @property
    def file_name(self) -> str:
        """Of its recording."""
        axis = f"-axis{self.axis}" if self.axis is not None else ""
        return f"{self.name}{axis}-{self.loop}-{self.compensation}.csv"

    def period_s(self, bench: Bench) -> float:
        """Its SYNC period."""
        return bench.bus.host_sync_period_s if self.loop == "host" else bench.bus.sync_period_s

    def motion(self, bench: Bench) -> Motion:
        """What it asks of the robot."""
        period = self.period_s(bench)
        if self.axis is not None:
            return constant_acceleration(bench, self.axis, period)
        return line_motion(bench, period)


def demo_experiments(bench: Bench) -> list[Experiment]:
    """The paper's experiments: both axes and the line, each without and with the notch; and axis 2 host-closed."""
    both: tuple[Literal["none"], Literal["notch"]] = ("none", "notch")
    axes = [number for number in (2, 3) if number in bench.axis]
    plan = [Experiment(CONSTANT_ACCELERATION, axis, way) for axis in axes for way in both]
    if bench.line_motion is not None:
        plan += [Experiment(LINE_MOTION, None, way) for way in both]
    if 2 in bench.axis:
        plan += [Experiment(CONSTANT_ACCELERATION, 2, way, "host") for way in both]
    return plan


def peak_hz(bench: Bench, axis: int, control_period_s: float = 250e-6) -> float:
    """f_al of an axis: the peak of |G_al| of its model with the P-PI in the drive."""
    loop = bench.axis[axis].loop(control_period_s, with_notch=False)
    return F_AL_DEFAULT_HZ if loop is None else loop.peak_hz()


def entries(bench: Bench, experiment: Experiment, result: RunResult, recording: str) -> list[dict[str, Any]]:
    """The entries of `runs` that one run gives: one per order's window, or one for the line motion."""
    common: dict[str, Any] = {
        "experiment": experiment.name,
        "axis": experiment.axis,
        "compensation": experiment.compensation,
        "loop": experiment.loop,
        "sync_period_s": experiment.period_s(bench),
        "control_period_s": result.control_period_s,
    }
    tail = {
        "cycles": result.cycles,
        "missed_cycles": result.missed_cycles,
        "wall_s": round(result.wall_s, 4),
        "motion_s": round(result.motion_s, 6),
        "recording": recording,
    }
    if result.bus_errors:
        tail["bus_errors"] = result.bus_errors
    if result.discarded:
        tail["discarded_positions"] = result.discarded
    if result.timing is not None:
        tail["timing"] = {"dropped_cycles": result.dropped_cycles, **asdict(result.timing)}
    if result.stopped is not None:
        empty = dict.fromkeys((*Metrics.__dataclass_fields__,))
        return [{**common, "order": None, **empty, "within_spec": False, **tail, "stopped": result.stopped.reason}]
    orders: tuple[int | None, ...] = (None,) if experiment.axis is None else (2, 4)
    return [{**common, "order": order, **_judged(bench, experiment, result, order), **tail} for order in orders]


MAX_SENSOR_MISSED = 0.005
"""Share of a motion's cycles that may lack the accelerometer; beyond it the run is not judged."""
AT_RANGE = 0.998
"""Share of its range from which a sensor counts as saturated: a step of its resolution below."""
MAX_LATE = 0.005
"""Share of a motion's cycles on the wall clock that may have been dropped, late, or without an answer; beyond it the same."""


def _judged(bench: Bench, experiment: Experiment, result: RunResult, order: int | None) -> dict[str, Any]:
    """The metrics and the verdict of one window; where it cannot be judged, why, and never a pass."""
    try:
        if result.timing is not None and result.dropped_cycles + result.missed_cycles > MAX_LATE * result.cycles:
            raise ValueError(
                f"of {result.cycles} cycles {result.dropped_cycles} were not sent in time and {result.missed_cycles} "
                f"lack an answer, more than {100.0 * MAX_LATE:g} %; docs/realtime.md"
            )
        if result.sensor_missed > MAX_SENSOR_MISSED * result.cycles:
            raise ValueError(f"the accelerometer was missing in {result.sensor_missed} of {result.cycles} cycles")
        check_range(bench, result.recording)
        metrics = _metrics(bench, experiment, result, order)
    except ValueError as error:
        return {**dict.fromkeys(Metrics.__dataclass_fields__), "within_spec": False, "invalid": str(error)}
    return {**vars(metrics), "within_spec": bool(metrics.tip_peak_mm <= bench.specification.tip_mm)}


def check_range(bench: Bench, recording: Recording) -> None:
    """Refuse a recording in which the accelerometer was at the end of its range.

    Raises:
        ValueError: It was, in so many samples.
    """
    limit = bench.accelerometer.range_m_s2
    if limit is None:
        return
    for name in ("tip_x_m_s2", "tip_y_m_s2", "tip_z_m_s2"):
        values = np.abs(recording.columns[name])
        count = int(np.count_nonzero(values >= AT_RANGE * limit))
        if count:
            raise ValueError(
                f"the accelerometer was at the end of its range of {limit:g} m/s² in {count} samples of {name}: "
                "move more slowly, or take one with a wider range"
            )


def _metrics(bench: Bench, experiment: Experiment, result: RunResult, order: int | None) -> Metrics:
    if experiment.axis is not None and order is not None:
        return constant_acceleration_metrics(result.recording, experiment.axis, order, peak_hz(bench, experiment.axis))
    line = bench.line_motion
    assert line is not None  # noqa: S101 - the motion was made from it
    return line_motion_metrics(result.recording, line.dwell_s, line.duration_s, peak_hz(bench, 2))


def comparisons(runs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Each treatment against none, of every pair that was run (single axis: the k = 2 window)."""
    found = []
    for run in runs:
        if run["compensation"] != "none" or run["order"] == 4 or run["tip_peak_mm"] is None:
            continue
        key = {name: run[name] for name in ("experiment", "axis", "loop", "order")}
        found += [
            {
                "experiment": run["experiment"],
                "axis": run["axis"],
                "loop": run["loop"],
                "compensation": other["compensation"],
                "tip_peak_reduction_pct": _reduction(run, other, "tip_peak_mm"),
                "spectrum_area_reduction_pct": _reduction(run, other, "spectrum_area"),
            }
            for other in runs
            if other["compensation"] != "none" and other["tip_peak_mm"] is not None and key.items() <= other.items()
        ]
    return found


def _reduction(before: dict[str, Any], after: dict[str, Any], name: str) -> float:
    return round(100.0 * (1.0 - after[name] / before[name]), 3) if before[name] else 0.0


# -- the paper's claims ------------------------------------------------------------------------------------------------

TABLE_1 = {2: (11.84, 5.92, 2.96), 3: (11.45, 5.72, 2.86)}
"""f_al in Hz, f_m2 and f_m4 in rps, by axis."""

TOLERANCE = 0.005
"""Relative difference up to which a figure of Table 1 counts as met: they are given with three to four digits."""


def _claim(claim: str, source: str, paper: object, bench: object, unit: str, holds: bool) -> dict[str, Any]:
    return {"claim": claim, "source": source, "paper": paper, "bench": bench, "unit": unit, "holds": holds}


def claims(bench: Bench, runs: list[dict[str, Any]], compared: list[dict[str, Any]], *, is_paper: bool) -> list[dict[str, Any]]:
    """The paper's claims beside the bench's numbers; those that the runs made do not touch are left out.

    Of another robot than the paper's only one thing is asked: that with what acts against its error it keeps the specification.
    """
    if not is_paper:
        return [claim for claim in _measured_claims(bench, runs) if _WITHIN in claim["claim"]]
    return [*_design_claims(bench), *_measured_claims(bench, runs), *_line_claims(bench, compared)]


def _design_claims(bench: Bench) -> list[dict[str, Any]]:
    """Section 3.1, Table 1, section 4.2: computed from the bench file's model, as the paper computed them."""
    found = []
    for axis, (f_al, f_m2, f_m4) in TABLE_1.items():
        table = bench.axis.get(axis)
        loop = None if table is None else table.loop(250e-6)
        if loop is None or table is None:
            continue
        plant, peak = loop.plant, loop.peak_hz()
        anti, resonance = plant.antiresonance_hz, plant.resonance_hz
        name = f"axis {axis}"
        found += [
            _claim(f"{name}: resonance around 22 Hz", "section 3.1", 22, round(resonance, 2), "Hz", abs(resonance - 22) <= 1),
            _claim(f"{name}: anti-resonance around 12 Hz", "section 3.1", 12, round(anti, 2), "Hz", abs(anti - 12) <= 1),
            _claim(f"{name}: gain peak of G_al", "Table 1", f_al, round(peak, 3), "Hz", _close(peak, f_al)),
            _claim(f"{name}: excitation speed, k = 2", "Table 1", f_m2, round(peak / 2, 3), "rps", _close(peak / 2, f_m2)),
            _claim(f"{name}: excitation speed, k = 4", "Table 1", f_m4, round(peak / 4, 3), "rps", _close(peak / 4, f_m4)),
        ]
        if not table.notch:
            continue
        low, high = table.notch[0].start_rps, table.notch[0].end_rps
        speeds = np.linspace(low, high, 51)
        worst = max(_gain_over_bound(bench, axis, float(speed)) for speed in speeds)
        found.append(
            _claim(f"{name}: |G_al| on the line over constraint (5), with the notch", "Fig. 11", "≤ 1", round(worst, 3), "",
                   worst <= 1.0)
        )  # fmt: skip
        judged = [margins(loop, float(speed)) for speed in (0.0, *speeds)]
        phase = min(margin.phase_margin_deg for margin in judged)
        stable = all(margin.stable for margin in judged)
        peak_s = max(margin.sensitivity_peak for margin in judged)
        found.append(
            _claim(f"{name}: stable at every motor speed (smallest phase margin; M_s {peak_s:.2f})", "Fig. 12", "stable",
                   round(phase, 1), "deg", stable)
        )  # fmt: skip
    return found


def _gain_over_bound(bench: Bench, axis: int, speed_rps: float) -> float:
    table = bench.axis[axis]
    loop = table.loop(250e-6)
    assert loop is not None and table.model is not None  # noqa: S101, PT018 - the caller has looked
    line = np.array([2.0 * speed_rps])
    gain = np.abs(loop.acceleration_per_transmission_error(line, speed_rps))
    limit_m = 1e-3 * bench.specification.tip_mm
    return float(gain[0] / acceleration_bound(line, table.model.ate.a2_arcsec * ARCSEC, table.tip_lever_m, limit_m)[0])


_WITHIN = "tip within"


def _measured_claims(bench: Bench, runs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Sections 3.2 and 5.1: measured over CAN."""
    found = []
    limit = bench.specification.tip_mm
    singles = [run for run in runs if run["axis"] is not None and run["tip_peak_mm"] is not None]
    for run in singles:
        if run["order"] != 2:
            continue
        name = f"axis {run['axis']}, {run['loop']}-closed"
        peak = round(run["tip_peak_mm"], 4)
        if run["compensation"] in ASKED:
            what = "the notch" if run["compensation"] == "notch" else TITLES[run["compensation"]]
            claim = f"{name}: {_WITHIN} ±{limit:g} mm with {what}"
            found.append(_claim(claim, "section 5.1", f"≤ {limit:g}", peak, "mm", peak <= limit))
            continue
        if run["compensation"] != "none":
            continue
        claim = f"{name}: tip beyond ±{limit:g} mm without it"
        found.append(_claim(claim, "section 5.1", f"> {limit:g}", peak, "mm", peak > limit))
        fourth = [other for other in singles if other["order"] == 4 and other["recording"] == run["recording"]]
        if fourth and fourth[0]["tip_peak_mm"]:
            ratio = run["tip_peak_mm"] / fourth[0]["tip_peak_mm"]
            claim = f"{name}: the 2nd order shakes the tip more than the 4th"
            found.append(_claim(claim, "section 3.2", "> 1", round(ratio, 2), "times", ratio > 1.0))
    return found


def _line_claims(bench: Bench, compared: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Section 5.2: measured over CAN."""
    wanted = bench.specification.line_area_reduction_pct
    return [
        _claim("line motion: area of the acceleration spectrum falls", "section 5.2", 26, round(area, 1), "%", area >= wanted)
        for area in (
            pair["spectrum_area_reduction_pct"]
            for pair in compared
            if pair["experiment"] == LINE_MOTION and pair["compensation"] == "notch"
        )
        if math.isfinite(area)
    ]


def _close(found: float, paper: float) -> bool:
    return abs(found - paper) <= TOLERANCE * paper
