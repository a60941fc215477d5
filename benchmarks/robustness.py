"""Monte Carlo over plants: how long a thousand closed-loop runs of one axis take."""

from benchmarks.measure import Row, agreed, progress, seconds, table, turns
from drive_profiles.processors import usable_processors
from plant_emulator.robots.robot import load_robot
from plant_emulator.robots.tuning import load_tuning
from plant_emulator.studies.robustness import Study, judge_all
from plant_emulator.trials.executors import LocalProcesses
from plant_emulator.trials.rows import Row as PlantRow

RUNS = 1000


def studies() -> dict[str, Study]:
    """Axis 2 of the reference robot through the resonant speeds, without and with Table 3's filter."""
    robot, tuning = load_robot("reference"), load_tuning("reference")
    controls = {number: axis.control for number, axis in tuning.axis.items() if axis.control is not None}
    notches = {number: tuple(table.notch() for table in axis.notch) for number, axis in tuning.axis.items()}
    return {"without notch": Study(robot, 2, controls, {}), "with Table 3's notch": Study(robot, 2, controls, notches)}


def robustness(runs: int = RUNS) -> list[str]:
    """Seconds for a thousand plants, in one process and in one per core; processes' start and judgement included.

    Raises:
        DisagreementError: The number of processes has changed what came out.
    """
    runs = turns(runs, least=4)
    cores = usable_processors()
    rows: list[Row] = []
    for name, study in studies().items():
        first: list[PlantRow] = []
        simulated = float(study.times[-1]) * runs
        for jobs in dict.fromkeys((1, cores)):
            progress(f"robustness: {runs} plants {name}, {jobs} processes")
            judged: list[list[PlantRow]] = []

            def run(jobs: int = jobs, study: Study = study, judged: list[list[PlantRow]] = judged) -> None:
                judged[:] = judge_all([study], runs, LocalProcesses(jobs))

            took = seconds(run)
            first = first or judged[0]
            others = [index for index, (one, two) in enumerate(zip(first, judged[0], strict=True)) if one != two]
            agreed(f"{name}, {jobs} processes, plants that are judged otherwise", len(others), 0.0)
            rows.append((f"{runs} plants, axis 2, {name}", jobs, took, runs / took, simulated / took))
    return table(("Monte Carlo", "processes", "s", "plants per s", "simulated s per s"), rows)
