"""Result files made by hand, with the types that write them."""

import datetime
from pathlib import Path
from typing import Any

from hil.bench.bench import load_bench
from hil.results.base import RESULT_FILE, MeasuredBench, Result
from hil.results.comparison import (
    AxisCompliance,
    ComparisonRequestEntry,
    ComparisonResult,
    ComparisonRobot,
    ComparisonRow,
    ComplianceFactors,
    TourPart,
    TourResult,
    TourStep,
)
from hil.results.runs import RunEntry

BENCH = load_bench("reference")
STARTED = datetime.datetime(2025, 1, 1, 12, tzinfo=datetime.UTC)
RAMP = ("constant-acceleration", 2)


def measured_bench() -> MeasuredBench:
    return MeasuredBench.of(BENCH, STARTED, is_lock_step=True)


def run_entry(treatment: str = "none", **changes: Any) -> RunEntry:
    """A run of axis 2 in the window of k = 2; within the specification of 0.05 mm where its peak is."""
    peak = changes.get("tip_peak_mm", 0.075)
    values = {
        "experiment": RAMP[0], "axis": RAMP[1], "treatment": treatment, "loop": "drive", "sync_period_s": 0.002,
        "control_period_s": 250e-6, "order": 2, "tip_peak_mm": peak, "tip_rms_mm": 0.03, "spectrum_peak_m_s2": 0.28,
        "spectrum_peak_hz": 11.9, "spectrum_area": 1.28, "within_spec": peak is not None and peak <= 0.05, "cycles": 1851,
        "missed_cycles": 0, "wall_s": 0.44, "motion_s": 3.7, "recording": f"runs/{treatment}.csv",
    }  # fmt: skip
    return RunEntry(**(values | changes))


def row(experiment: str, axis: int | None, treatment: str, peak: float | None, **changes: Any) -> ComparisonRow:
    """A row of a comparison; one without a peak has no number at all."""
    is_compared = peak is not None and treatment != "none"
    values = {
        "experiment": experiment, "axis": axis, "treatment": treatment, "loop": "drive", "tip_peak_mm": peak,
        "tip_peak_change_pct": 100.0 * (peak / 0.075 - 1.0) if is_compared and peak is not None else None,
        "spectrum_area": None if peak is None else 10.0 * peak, "spectrum_area_change_pct": -30.0 if is_compared else None,
        "within_spec": None if peak is None else peak <= 0.05, "trial": None,
        "compliance": None if peak is None else ComplianceFactors(slow=1.0, peak=1.0),
        "recording": None if peak is None else "there",
    }  # fmt: skip
    return ComparisonRow(**(values | changes))


def robot(rows: list[ComparisonRow], name: str = "reference", **changes: Any) -> ComparisonRobot:
    costs = tuple(
        AxisCompliance(axis=2, treatment=way, loop="drive", slow=slow, peak=slow, peak_hz=4.0)
        for way, slow in (("none", 0.1), ("low-gains", 0.37))
    )
    values = {
        "name": name, "source": "bench.toml", "directory": name, "bus": "local:x", "tip_mm": 0.05, "rows": tuple(rows),
        "compliance": costs, "not_restored": (), "versions": {"python": "3.11"},
    }  # fmt: skip
    return ComparisonRobot(**(values | changes))


REQUEST = ComparisonRequestEntry(experiments=("constant-acceleration", "line-motion"), axes=(), treatments=("none",), named=())


def comparison(*robots: ComparisonRobot) -> ComparisonResult:
    return ComparisonResult(started_utc=STARTED.isoformat(), request=REQUEST, robots=list(robots))


def tour(*robots: ComparisonRobot, failure: str | None = None, **changes: Any) -> TourResult:
    """A tour of one step, which has failed where the tour has."""
    what = "f_a" if failure is None else failure
    step = TourStep(name="identify plant, axis 2", what=what, holds=failure is None, seconds=9.0, link="x/report.html")
    part = TourPart(bench_file="bench.toml", steps=(step,), failure=failure)
    values = {"started_utc": STARTED.isoformat(), "request": REQUEST, "robots": list(robots), "tour": part}
    return TourResult(**(values | changes))


def written(directory: Path, result: Result) -> Path:
    """The directory, with the result in it."""
    result.write(directory / RESULT_FILE)
    return directory
