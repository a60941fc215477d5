"""Monte Carlo over plants: how long a thousand closed-loop runs of one axis take."""

import os
from functools import partial

from benchmarks.measure import Row, progress, seconds, table
from plant_emulator.robot import load_robot
from plant_emulator.robustness import Study
from plant_emulator.robustness_workers import run_all
from plant_emulator.tuning import load_tuning

RUNS = 1000


def studies() -> dict[str, Study]:
    """Axis 2 of the reference robot through the resonant speeds, without and with Table 3's filter."""
    robot, tuning = load_robot("reference"), load_tuning("reference")
    controls = {number: axis.control for number, axis in tuning.axis.items() if axis.control is not None}
    notches = {number: tuple(table.notch() for table in axis.notch) for number, axis in tuning.axis.items()}
    return {"without notch": Study(robot, 2, controls, {}), "with Table 3's notch": Study(robot, 2, controls, notches)}


def robustness(runs: int = RUNS) -> list[str]:
    """Seconds for a thousand plants, in this process and in one per core; processes' start and judgement included."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    rows: list[Row] = []
    for name, study in studies().items():
        study.judge(-1)  # compile
        simulated = float(study.times[-1]) * runs
        for jobs in dict.fromkeys((1, cores)):
            progress(f"robustness: {runs} plants {name}, {jobs} processes")
            took = seconds(partial(run_all, [study], runs, jobs))
            rows.append((f"{runs} plants, axis 2, {name}", jobs, took, runs / took, simulated / took))
    return table(("Monte Carlo", "processes", "s", "plants per s", "simulated s per s"), rows)
