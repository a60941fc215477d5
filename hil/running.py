"""One experiment from Python, as with `hil run`."""

import math
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import get_args

from drive_profiles.address import LOCAL, choose_bus, parse_address
from hil.analysis import band_passed
from hil.bench.bench import load_bench
from hil.control.treatments import LoopName, TreatmentName
from hil.errors import NotPossibleError
from hil.experiments.motions import CONSTANT_ACCELERATION, LINE_MOTION, POINT_TO_POINT
from hil.experiments.plan import Experiment
from hil.experiments.runner import run_experiments
from hil.experiments.treatment import TREATMENTS, known_from
from hil.recording import Recording
from hil.results.base import result_directory
from hil.results.runs import ExperimentsResult, RunEntry, leading
from hil.tip_vector import displacement_mm, tip_acceleration

DISPLACEMENT = "tip_displacement_mm"
"""Column of the tip's displacement, by which a run is judged."""
LOOPS: tuple[LoopName, ...] = get_args(LoopName)
EXPERIMENTS = (CONSTANT_ACCELERATION, LINE_MOTION, POINT_TO_POINT)


@dataclass(frozen=True)
class ExperimentRun:
    """A run with its result and recording.

    Attributes:
        result: Content of `result.json`.
        recording: Its columns by name, one row per cycle; with `tip_displacement_mm` where f_al is known.
        folder: Directory with `result.json`, the recording as CSV, and the log of the bus.
    """

    result: ExperimentsResult
    recording: Recording
    folder: Path

    @property
    def entry(self) -> RunEntry:
        """The leading window of the run: tip peak and verdict."""
        return leading(self.result.runs)[0]


def run(
    bench_file: str | Path,
    experiment: str,
    *,
    axis: int | None = None,
    treatment: TreatmentName = "none",
    loop: LoopName = "drive",
    bus: str | None = None,
    model: str | Path | None = None,
    design: str | Path | None = None,
    learnt: str | Path | None = None,
    repeat: int = 1,
    out: str | Path | None = None,
    force: bool = False,
    yes: bool = False,
) -> ExperimentRun:
    """Run one experiment on a bench file's robot, as `hil run`.

    Args:
        bench_file: Path of the bench file, or a name of the package: `reference`.
        experiment: `constant-acceleration`, `line-motion` or `point-to-point`.
        axis: The axis that moves alone; None for a line motion.
        treatment: Treatment of the vibration.
        loop: Side that closes the loop, the drive or the host.
        bus: Address of the bus; None: that of HIL_BUS, else that of the bench file.
        model: Model file of `hil identify`.
        design: Design file of `hil design`.
        learnt: Model file of `hil learn`.
        repeat: Number of runs, of which the mean is judged.
        out: Directory of the files; None for a new one in `bench-out`.
        force: True to replace the files of an older result in `out`.
        yes: True to move a robot on another bus than a local one, where robots are emulated.

    Raises:
        ValueError: There is no such experiment, treatment, loop or bus address, or the axis does not go with it.
        DriveProfileError: A file cannot be used.
        ChannelError: There is no bus.
        NotPossibleError: Something is missing for it, or a robot would move that may be real, and `yes` is not given.
        HilError: A limit or a node does not allow it; or the run was stopped: the folder then has all of it.
    """
    if experiment not in EXPERIMENTS:
        raise ValueError(f"experiment {experiment!r}: expected {', '.join(EXPERIMENTS)}")
    if treatment not in TREATMENTS:
        raise ValueError(f"treatment {treatment!r}: expected {', '.join(TREATMENTS)}")
    if loop not in LOOPS:
        raise ValueError(f"loop {loop!r}: expected {', '.join(LOOPS)}")
    if not isinstance(repeat, Integral) or repeat < 1:
        raise ValueError(f"repeat {repeat!r}: expected a whole number of at least 1")
    if (experiment == LINE_MOTION) != (axis is None):
        raise ValueError("a line-motion takes no axis" if axis is not None else f"{experiment} needs an axis")
    bench = load_bench(bench_file)
    choice = choose_bus(bus, (f"bench file {bench_file}", bench.bus.address), option_name="bus")
    bench = bench if choice is None else bench.on(choice.address)
    known = known_from(bench_file, bench, model=_path(model), design=_path(design), learnt=_path(learnt))
    if not yes and parse_address(bench.bus.address).interface != LOCAL:
        raise NotPossibleError(f"this moves the robot on {bench.bus.address}: clear its way, then pass yes=True")
    wanted = Experiment(experiment, axis, treatment, loop)
    folder = result_directory(out, Path(wanted.file_name).stem, force=force, remedy="force=True replaces its files")
    done = run_experiments(bench, [wanted], folder, knowledge=known, repeat=repeat)
    if done.failure is not None:
        raise done.failure
    entry = leading(done.result.runs)[0]
    return ExperimentRun(done.result, with_displacement(Recording.load(folder / entry.recording), entry), folder)


def with_displacement(recording: Recording, entry: RunEntry) -> Recording:
    """A recording with the column `tip_displacement_mm`, by which its run was judged.

    Of an axis alone it is the acceleration in the band, over (2π f_al)²; on a bench with an arm the acceleration along the
    worst direction, integrated twice. Without a band or an f_al of its window the recording stays as it is.
    """
    worst = None if entry.directions is None else entry.directions["worst"].unit
    if entry.band_hz is None or (worst is None and entry.f_al_hz is None):
        return recording
    if worst is not None:
        moved = displacement_mm(tip_acceleration(recording), recording.period_s, entry.band_hz) @ worst
    else:
        vibration = band_passed(recording.felt_m_s2, recording.period_s, entry.band_hz)
        moved = 1e3 * vibration / (2.0 * math.pi * (entry.f_al_hz or math.inf)) ** 2
    return Recording({**recording.columns, DISPLACEMENT: moved})


def _path(given: str | Path | None) -> Path | None:
    return None if given is None else Path(given)
