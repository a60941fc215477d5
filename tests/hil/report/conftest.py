"""A directory as `hil demo` leaves it, made without CAN by plant_emulator.simulate."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from hil.analysis import constant_acceleration_metrics, line_motion_metrics, motor_speed_rps
from hil.master.bench import load_bench
from hil.recording import Recording
from plant_emulator import robot as world
from plant_emulator.simulate import simulate

ROBOT, BENCH = world.load_robot("reference"), load_bench("reference")


def recorded(axis: int | None, *, with_notch: bool, sync_period_s: float = 0.002) -> Recording:
    controls = {number: world.Control(**table.control.model_dump()) for number, table in BENCH.axis.items()}
    keep = {"hysteresis_rps", "speed_lowpass_hz", "ramp_rps"}
    notches = {
        number: tuple(world.NotchTable(**notch.model_dump(exclude=keep)) for notch in table.notch)
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


def entries(directory: Path, axis: int | None, compensation: str, loop: str, period_s: float) -> list[dict]:
    recording = recorded(axis, with_notch=compensation == "notch", sync_period_s=period_s)
    experiment = "line-motion" if axis is None else "constant-acceleration"
    name = f"runs/{experiment}-{axis or 'all'}-{compensation}-{loop}.csv"
    recording.save(directory / name)
    found = []
    for order in (None,) if axis is None else (2, 4):
        f_al = BENCH.axis[axis or 2].loop(250e-6, with_notch=False).peak_hz()
        if axis is None:
            metrics = line_motion_metrics(recording, BENCH.line_motion.dwell_s, BENCH.line_motion.duration_s, f_al)
        else:
            metrics = constant_acceleration_metrics(recording, axis, order, f_al)
        found.append(
            {
                "experiment": experiment,
                "axis": axis,
                "compensation": compensation,
                "loop": loop,
                "sync_period_s": period_s,
                "control_period_s": 250e-6,
                "order": order,
                **vars(metrics),
                "within_spec": metrics.tip_peak_mm <= 0.05,
                "cycles": len(recording.time_s),
                "missed_cycles": 0,
                "wall_s": 0.9,
                "motion_s": float(recording.time_s[-1]),
                "recording": name,
            }
        )
    return found


def reduction(runs: list[dict], experiment: str, axis: int | None, loop: str) -> dict:
    order = None if axis is None else 2
    pair = {
        r["compensation"]: r
        for r in runs
        if (r["experiment"], r["axis"], r["loop"], r["order"]) == (experiment, axis, loop, order)
    }
    share = {key: 100.0 * (1.0 - pair["notch"][key] / pair["none"][key]) for key in ("tip_peak_mm", "spectrum_area")}
    return {
        "experiment": experiment,
        "axis": axis,
        "loop": loop,
        "tip_peak_reduction_pct": share["tip_peak_mm"],
        "spectrum_area_reduction_pct": share["spectrum_area"],
    }


def make(directory: Path) -> Path:
    runs = []
    for axis in (2, 3, None):
        for compensation in ("none", "notch"):
            runs += entries(directory, axis, compensation, "drive", 0.002)
    for compensation in ("none", "notch"):
        runs += entries(directory, 2, compensation, "host", 250e-6)
    comparisons = [
        reduction(runs, "constant-acceleration", 2, "drive"),
        reduction(runs, "constant-acceleration", 3, "drive"),
        reduction(runs, "line-motion", None, "drive"),
        reduction(runs, "constant-acceleration", 2, "host"),
    ]
    peaks = {
        r["axis"]: r["tip_peak_mm"] for r in runs if r["compensation"] == "notch" and r["order"] == 2 and r["loop"] == "drive"
    }
    paper = [
        {"claim": "f_al of axis 2", "source": "Table 1", "paper": 11.84, "bench": 11.8402, "unit": "Hz", "holds": True},
        {"claim": "f_al of axis 3", "source": "Table 1", "paper": 11.45, "bench": 11.4503, "unit": "Hz", "holds": True},
        {
            "claim": "Tip of axis 2 within ±0.05 mm with the notch",
            "source": "section 5.1, Fig. 13",
            "paper": "≤ 0.05",
            "bench": peaks[2],
            "unit": "mm",
            "holds": peaks[2] <= 0.05,
        },
        {
            "claim": "Tip of axis 3 within ±0.05 mm with the notch",
            "source": "section 5.1, Fig. 14",
            "paper": "≤ 0.05",
            "bench": peaks[3],
            "unit": "mm",
            "holds": peaks[3] <= 0.05,
        },
        {
            "claim": "Spectrum area of the line motion falls",
            "source": "section 5.2, Fig. 15",
            "paper": 26.0,
            "bench": comparisons[2]["spectrum_area_reduction_pct"],
            "unit": "%",
            "holds": comparisons[2]["spectrum_area_reduction_pct"] >= 26.0,
        },
    ]
    result = {
        "schema": 1,
        "bench": {
            "name": "reference",
            "file": BENCH.model_dump(mode="json"),
            "bus": "local:/tmp/robot.sock",
            "clock": "lock-step",
            "seed": 1,
            "versions": {"hil-bench": "0.1.0", "python": "3.11", "numpy": np.__version__},
            "started_utc": "2025-01-01T12:00:00Z",
        },
        "runs": runs,
        "comparisons": comparisons,
        "paper": paper,
    }
    (directory / "result.json").write_text(json.dumps(result), encoding="utf-8")
    return directory


@pytest.fixture(scope="session")
def full_directory(tmp_path_factory) -> Path:
    """All runs; tests must not change it."""
    return make(tmp_path_factory.mktemp("report"))
