"""A directory as `hil demo` leaves it, made without CAN by plant_emulator.studies.simulate."""

import math
from pathlib import Path

import numpy as np
import pytest

from hil.analysis import constant_acceleration_metrics, line_motion_metrics, motor_speed_rps
from hil.bench.bench import load_bench
from hil.experiments.judge import axis_scale
from hil.experiments.plan import comparisons
from hil.recording import Recording
from hil.report import later_text, style
from hil.report.writer import write_report_of
from hil.results.acted import ActedFilter
from hil.results.base import MeasuredBench
from hil.results.runs import ExperimentsResult, PaperClaim, RunEntry
from hil.robot_tables import Control, NotchShape
from plant_emulator.robots import robot as world
from plant_emulator.studies.simulate import simulate

ROBOT, BENCH = world.load_robot("reference"), load_bench("reference")


def recorded(axis: int | None, *, with_notch: bool, sync_period_s: float = 0.002) -> Recording:
    controls = {number: Control(**table.control.model_dump()) for number, table in BENCH.axis.items()}
    keep = {"hysteresis_rps", "speed_lowpass_hz", "ramp_rps"}
    notches = {
        number: tuple(NotchShape(**notch.model_dump(exclude=keep)) for notch in table.notch)
        for number, table in BENCH.axis.items()
        if with_notch
    }
    found = simulate(ROBOT, axis, controls=controls, notches=notches, sync_period_s=sync_period_s)
    random = np.random.default_rng(1)
    columns = {"time_s": found.time_s}
    for column, number in enumerate(found.axes):
        step = 2.0 * math.pi / ROBOT.axis[number].encoder_counts_per_rev
        columns[f"axis{number}_reference_rad"] = found.reference_counts[:, column] * step
        columns[f"axis{number}_position_rad"] = found.position_counts[:, column] * step
        columns[f"axis{number}_torque_nm"] = found.torque_nm[:, column]
    for place, name in enumerate(("x", "y", "z")):
        noisy = found.tip_acceleration_m_s2[:, place] + random.normal(0.0, 0.02, len(found.time_s))
        columns[f"tip_{name}_m_s2"] = np.round(noisy / 0.00981) * 0.00981
    columns["missing"] = np.zeros(len(found.time_s))
    if with_notch and axis is not None:
        speed = np.abs(motor_speed_rps(Recording(columns), axis))
        columns[f"axis{axis}_notch_hz"] = np.where((speed >= 4.0) & (speed <= 9.0), 2.0 * speed, 0.0)
    return Recording(columns)


def entries(directory: Path, axis: int | None, treatment: str, loop: str, period_s: float) -> list[RunEntry]:
    recording = recorded(axis, with_notch=treatment == "notch", sync_period_s=period_s)
    experiment = "line-motion" if axis is None else "constant-acceleration"
    name = f"runs/{experiment}-{axis or 'all'}-{treatment}-{loop}.csv"
    recording.save(directory / name)
    moved = BENCH.chain_axes if axis is None else (axis,)
    acted = tuple(
        ActedFilter(axis=number, held_by="host" if loop == "host" else "drive", notch=notch)
        for number in moved
        for notch in BENCH.axis[number].notch
    )
    found = []
    for order in (None,) if axis is None else (2, 4):
        scale = axis_scale(BENCH, axis or 2)
        if axis is None:
            metrics = line_motion_metrics(recording, BENCH.line_motion.dwell_s, BENCH.line_motion.duration_s, scale)
        else:
            metrics = constant_acceleration_metrics(recording, axis, order, scale)
        entry = RunEntry(
            experiment=experiment,
            axis=axis,
            treatment=treatment,
            loop=loop,
            sync_period_s=period_s,
            control_period_s=250e-6,
            order=order,
            **vars(metrics),
            within_spec=metrics.tip_peak_mm <= 0.05,
            cycles=len(recording.time_s),
            missed_cycles=0,
            wall_s=0.9,
            motion_s=float(recording.time_s[-1]),
            recording=name,
            filters=() if treatment == "none" else acted,
        )
        found.append(entry)
    return found


def make(directory: Path) -> Path:
    runs: list[RunEntry] = []
    for axis in (2, 3, None):
        for treatment in ("none", "notch"):
            runs += entries(directory, axis, treatment, "drive", 0.002)
    for treatment in ("none", "notch"):
        runs += entries(directory, 2, treatment, "host", 250e-6)
    compared = comparisons(runs)
    area = next(each.spectrum_area_reduction_pct for each in compared if each.experiment == "line-motion")
    peaks = {run.axis: run.tip_peak_mm for run in runs if run.treatment == "notch" and run.order == 2 and run.loop == "drive"}
    paper = [
        PaperClaim(claim="f_al of axis 2", source="Table 1", paper=11.84, bench=11.8402, unit="Hz", holds=True),
        PaperClaim(claim="f_al of axis 3", source="Table 1", paper=11.45, bench=11.4503, unit="Hz", holds=True),
        *(
            PaperClaim(
                claim=f"Tip of axis {axis} within ±0.05 mm with the notch",
                source=f"section 5.1, Fig. {figure}",
                paper="≤ 0.05",
                bench=peaks[axis],
                unit="mm",
                holds=peaks[axis] <= 0.05,
            )
            for axis, figure in ((2, 13), (3, 14))
        ),
        PaperClaim(
            claim="Spectrum area of the line motion falls",
            source="section 5.2, Fig. 15",
            paper=26.0,
            bench=area,
            unit="%",
            holds=area >= 26.0,
        ),
    ]
    bench = MeasuredBench(
        name="reference",
        bus="local:/tmp/robot.sock",
        clock="lock-step",
        started_utc="2025-01-01T12:00:00Z",
        versions={"hil-bench": "0.1.0", "python": "3.11", "numpy": np.__version__},
        file=BENCH,
    )
    ExperimentsResult(bench=bench, runs=runs, comparisons=compared, paper=paper, emulated=True).write(directory / "result.json")
    return directory


@pytest.fixture(scope="session")
def full_report(full_directory):
    """The page of all runs, and its matplotlib figures with their SVG by key, drawn."""
    drawn, original = {}, style.to_svg

    def spy(figure, key, **options):
        svg = original(figure, key, **options)
        drawn[key] = (figure, str(svg))
        return svg

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "to_svg", spy)
        patch.setattr(later_text, "_processors", lambda: 1)  # drawn here, not in a copy: the figures know their places
        page = write_report_of(full_directory).read_text(encoding="utf-8")
    return page, drawn


@pytest.fixture(scope="session")
def full_directory(tmp_path_factory) -> Path:
    """All runs; tests must not change it."""
    return make(tmp_path_factory.mktemp("report"))
