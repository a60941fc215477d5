"""The documented path on one robot, docs/tuning.md as a function."""

import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.bench.bench import Bench
from hil.control.treatments import TreatmentName
from hil.emulator import EmulatorProcess
from hil.errors import HilError, InterruptedRunError, SafetyStopError
from hil.experiments.cancellation.effect import Part
from hil.experiments.treatment import Knowledge
from hil.recording import Recording
from hil.reporter import SILENT, Reporter
from plant_emulator.rehearsal.estimates import facts_of, quantities_of
from plant_emulator.rehearsal.gear import ALL_AROUND_RAD
from plant_emulator.rehearsal.over_bus import StepsOverBus
from plant_emulator.rehearsal.probes import probe
from plant_emulator.rehearsal.record import TREATMENTS, PathRecord, StepRecord
from plant_emulator.rehearsal.steps import Note, PathFiles, StepsInProcess
from plant_emulator.rehearsal.survey import Survey
from plant_emulator.rehearsal.without import PathEnd, tip_without
from plant_emulator.robots.blank_bench import file_text
from plant_emulator.robots.robot import Robot

RUNS: dict[str, tuple[TreatmentName, tuple[str, ...]]] = {
    "none": ("none", ()),
    "notch": ("notch", ()),
    "notch_designed": ("notch-designed", ("design",)),
    "cancellation": ("cancellation", ("ate",)),
    "cancellation_learnt": ("cancellation-learnt", ("learn",)),
}
"""Runs of the path: treatment, and the steps that must be done before."""
Steps = StepsInProcess | StepsOverBus
"""Steps of the path, each by the product."""


@dataclass(frozen=True)
class PathOptions:
    """Options of a path.

    Attributes:
        over_bus: Go over a bus: a served robot, and the tools as processes.
        with_causes: Look whether the cause that the product names for what it leaves is the true one.
        keeps_files: Keep recordings and results in the folder; otherwise only the model files stay.
    """

    over_bus: bool = False
    with_design: bool = True
    with_probes: bool = True
    with_causes: bool = True
    keeps_files: bool = False


def run_path(
    robot: Robot, bench: Bench, folder: Path, options: PathOptions | None = None, reporter: Reporter = SILENT
) -> PathRecord:
    """Run the documented path.

    A refusal by the product raises nothing: the record states how each step ended. Ctrl-C and SIGTERM end the path.

    Args:
        robot: The robot that is treated, all its truth in it.
        bench: The bench file, which knows nothing of it.
        folder: Directory for what the steps write; created if missing.

    Raises:
        KeyboardInterrupt: A signal ended a motion.
    """
    return _Path(robot, bench, folder, options or PathOptions(), reporter).record()


@dataclass
class _Path:
    robot: Robot
    bench: Bench
    folder: Path
    options: PathOptions
    reporter: Reporter
    result: PathRecord = field(init=False)
    left_out: dict[str, Sequence[Part]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.axis = min(self.bench.axis)
        self.result = PathRecord(self.robot.name, self.robot.seed, self.axis, self.options.over_bus)
        self.files = PathFiles(self.folder)

    def record(self) -> PathRecord:
        """Run, measure the truth, and return the record."""
        result, began = self.result, time.process_time()
        self.folder.mkdir(parents=True, exist_ok=True)
        result.facts = facts_of(self.robot, self.bench, self.axis)
        with self._steps() as steps:
            self._run_steps(steps)
        known = self.files.identified(), self._knowledge().learnt
        result.quantities = quantities_of(self.robot, self.axis, *known, self._identified_at())
        finished = time.process_time()
        result.cpu_s = finished - began
        self._survey()
        result.survey_cpu_s = time.process_time() - finished
        if not self.options.keeps_files:
            for path in self.folder.iterdir():
                if path.is_dir():
                    shutil.rmtree(path)
        return result

    def _identified_at(self) -> NDArray[np.float64]:
        """Return the arm angles between which the plant was identified; all around without a recording."""
        path = self.files.folder / "plant" / "runs" / f"identify-plant-axis{self.axis}-main.csv"
        if not path.is_file():
            return ALL_AROUND_RAD
        motor_rad = Recording.load(path).axis(self.axis, "position_rad")
        if not len(motor_rad):
            return ALL_AROUND_RAD
        arm_rad = motor_rad / self.robot.axis[self.axis].reduction_ratio + self.robot.home_angle(self.axis)
        return np.linspace(float(arm_rad.min()), float(arm_rad.max()), len(ALL_AROUND_RAD))

    @contextmanager
    def _steps(self) -> Iterator[Steps]:
        """Return the steps on the robot behind its bus."""
        if not self.options.over_bus:
            steps = StepsInProcess(self.robot, self.bench, self.axis, self.files)
            yield steps
            self.result.simulated_s = steps.channel.syncs * self.robot.sync_period_s
            return
        file = self.folder / "robot.toml"
        file.write_text(file_text(self.robot), encoding="utf-8")
        with EmulatorProcess(str(file), self.robot.bus.bitrate) as served:
            yield StepsOverBus(self.bench, self.axis, self.files, served.address)

    def _run_steps(self, steps: Steps) -> None:
        self._take("plant", steps.plant)
        self._take("ate", steps.ate)
        if self.options.with_design:
            self._take("design", steps.design, ("plant",))
        else:
            self.result.steps["design"] = StepRecord("skipped", "", "not asked for")
        for name in ("none", "notch", "notch_designed", "cancellation"):
            self._run(steps, name)
        self._take("learn", steps.learn)
        self._run(steps, "cancellation_learnt")

    def _run(self, steps: Steps, name: str) -> None:
        treatment, needs = RUNS[name]

        def act() -> Note:
            outcome = steps.run(treatment, is_learnt=self._is_done("learn"))
            self.left_out[name], self.result.causes[name] = outcome.left_out, (outcome.causes, outcome.left)
            self.result.left[name], self.result.hidden[name] = outcome.left_mm, outcome.noise_mm
            return outcome.note

        self._take(name, act, needs)

    def _take(self, name: str, act: Callable[[], Note], needs: tuple[str, ...] = ()) -> None:
        """Take a step; the record gets its note, or error in words."""
        missing = [need for need in needs if not self._is_done(need)]
        if missing:
            self.result.steps[name] = StepRecord("skipped", "", f"needs {missing[0]}")
            return
        self.reporter.step(name)
        began = time.process_time()
        step = _ended(act)
        self.result.steps[name] = replace(step, cpu_s=time.process_time() - began)

    # -- what is known -------------------------------------------------------------------------------------------------

    def _is_done(self, step: str) -> bool:
        return step in self.result.steps and self.result.steps[step].is_done

    def _knowledge(self) -> Knowledge:
        return self.files.knowledge(is_learnt=self._is_done("learn"))

    def _survey(self) -> None:
        survey, knowledge = Survey(self.robot, self.bench, self.axis), self._knowledge()
        for name in TREATMENTS:
            if all(self._is_done(need) for need in RUNS[name][1]):
                self.result.tips[name] = survey.tip(name, knowledge, self.left_out.get(name, ()))
        self.result.floor = survey.floor()
        if self.options.with_causes and self.result.is_quiet is False:
            self.result.without_cause_mm = self._without_cause(knowledge)
        if self.options.with_probes:
            self.result.probes = probe(self.robot, self.bench, self.axis, survey, self.result.tips["none"])

    def _without_cause(self, knowledge: Knowledge) -> float | None:
        """Return the path's true tip without the stated causes, None without any."""
        name, causes = self.result.end_treatment, self.result.end_causes[0]
        model = knowledge.learnt if name == "cancellation_learnt" else knowledge.identified
        if not causes or model is None:
            return None

        def rerun(robot: Robot, bench: Bench) -> float | None:
            options = replace(self.options, with_design=False, with_probes=False, with_causes=False)
            return run_path(robot, bench, self.folder / "without", options).end_tip_mm

        left_out = self.left_out.get(name, ())
        return tip_without(causes, PathEnd(self.robot, self.bench, self.axis, model, left_out), rerun)


def _ended(act: Callable[[], Note]) -> StepRecord:
    """Take a step; return how it ended."""
    try:
        note = act()
    except InterruptedRunError as error:
        raise KeyboardInterrupt from error
    except SafetyStopError as error:
        return StepRecord("stopped", type(error).__name__, str(error), causes=error.causes)
    except (HilError, ValueError, OSError) as error:
        causes = error.causes if isinstance(error, HilError) else ()
        return StepRecord("refused", type(error).__name__, str(error), causes=causes)
    except Exception as error:  # noqa: BLE001 - the record states what happened to each robot, and the next one follows
        return StepRecord("crashed", type(error).__name__, str(error))
    return StepRecord("noted" if note else "done", "", note or "")
