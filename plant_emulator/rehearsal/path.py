"""The documented path, walked on one robot by the product's own functions, without an edit: docs/tuning.md as a function."""

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from hil.bench.bench import Bench
from hil.bench.design import load_designs, update_designs
from hil.bench.model import Identified, load_identified, update_file
from hil.control.treatments import TreatmentName
from hil.design.notch_search import Effort
from hil.errors import HilError, SafetyStopError
from hil.experiments.ate.on_bus import identify_ate
from hil.experiments.ate.request import AteRequest
from hil.experiments.cancellation.learn_run import LearnRequest, learn_on_bus
from hil.experiments.notch_design import design, designed_axis
from hil.experiments.notch_problem import NotchDesignRequest
from hil.experiments.plan import Experiment
from hil.experiments.plant.motion import PlantRequest
from hil.experiments.plant.on_bus import run_identify_plant
from hil.experiments.runner import run_experiments
from hil.experiments.treatment import Knowledge
from hil.reporter import SILENT, Reporter
from plant_emulator.rehearsal.direct import DirectChannel
from plant_emulator.rehearsal.estimates import facts_of, quantities_of
from plant_emulator.rehearsal.record import TREATMENTS, PathRecord, StepRecord
from plant_emulator.rehearsal.survey import Survey
from plant_emulator.robots.robot import Robot
from plant_emulator.world import World

SMALL_EFFORT = Effort(16, 6, 6, 2)
"""Effort of the notch's search in a rehearsal: a tenth of the quick one."""


@dataclass(frozen=True)
class PathOptions:
    """Options of a walk.

    Attributes:
        axis: The axis that is treated; None for the robot's first.
        over_bus: Go over a bus: a served robot, and the tools as processes.
        with_design: Design a notch.
        with_probes: Try wrong corrections.
        effort: Effort of the notch's search.
        keeps_files: Keep recordings and results in the folder; otherwise only the model files stay.
    """

    axis: int | None = None
    over_bus: bool = False
    with_design: bool = True
    with_probes: bool = True
    effort: Effort = SMALL_EFFORT
    keeps_files: bool = False


def walk(robot: Robot, bench: Bench, folder: Path, options: PathOptions | None = None, reporter: Reporter = SILENT) -> PathRecord:
    """Walk the documented path: plant, transmission error, design, runs with every treatment, learning.

    Nothing that the product refuses is raised: how each step ended is in the record.

    Args:
        robot: The robot that is treated, all its truth in it.
        bench: The bench file, which knows nothing of it.
        folder: Directory for what the steps write; made where it is missing.
        options: Options; the defaults unless given.
        reporter: Listener of each step.
    """
    walked = _Walk(robot, bench, folder, options or PathOptions(), reporter)
    return walked.record()


@dataclass
class _Walk:
    """A walk while it lasts."""

    robot: Robot
    bench: Bench
    folder: Path
    options: PathOptions
    reporter: Reporter
    result: PathRecord = field(init=False)

    def __post_init__(self) -> None:
        self.axis = min(self.bench.axis) if self.options.axis is None else self.options.axis
        self.result = PathRecord(self.robot.name, self.robot.seed, self.axis, self.options.over_bus)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.model, self.learnt, self.designs = (self.folder / f"{name}.toml" for name in ("model", "learnt", "design"))
        self.channel = DirectChannel(World(self.robot), self.robot.bus.bitrate)

    def record(self) -> PathRecord:
        """Walk, measure the truth, and give the record."""
        began = time.process_time()
        self.result.facts = facts_of(self.robot, self.bench, self.axis)
        self._step("plant", self._plant)
        if self.model.exists():
            shutil.copyfile(self.model, self.learnt)
        self._step("ate", self._ate)
        if self.options.with_design:
            self._step("design", self._design, needs=("plant",))
        self._step("none", lambda: self._run("none"))
        self._step("notch", lambda: self._run("notch"))
        self._step("notch_designed", lambda: self._run("notch-designed"), needs=("design",))
        self._step("cancellation", lambda: self._run("cancellation"), needs=("ate",))
        self._step("learn", self._learn)
        self._step("cancellation_learnt", lambda: self._run("cancellation-learnt"), needs=("learn",))
        self.result.quantities = quantities_of(self.robot, self.axis, self._identified(), self._learnt())
        self._survey()
        self.result.simulated_s = self.channel.syncs * self.robot.sync_period_s
        self.result.cpu_s = time.process_time() - began
        if not self.options.keeps_files:
            for path in self.folder.iterdir():
                if path.is_dir():
                    shutil.rmtree(path)
        return self.result

    # -- steps ---------------------------------------------------------------------------------------------------------

    def _step(self, name: str, act: Callable[[], str | None], needs: tuple[str, ...] = ()) -> None:
        """Take a step; its note, or its error in words, goes into the record."""
        missing = [need for need in needs if not self.result.steps[need].is_done]
        if missing:
            self.result.steps[name] = StepRecord("skipped", "", f"needs {missing[0]}")
            return
        self.reporter.step(name)
        began = time.process_time()
        try:
            note = act()
            step = StepRecord("noted" if note else "done", "", note or "")
        except SafetyStopError as error:
            step = StepRecord("stopped", type(error).__name__, str(error))
        except (HilError, ValueError, OSError) as error:
            step = StepRecord("refused", type(error).__name__, str(error))
        except Exception as error:  # noqa: BLE001 - a walk tells of every robot what happened, and goes on with the next
            step = StepRecord("crashed", type(error).__name__, str(error))
        self.result.steps[name] = StepRecord(step.ended, step.error, step.words, time.process_time() - began)

    def _plant(self) -> str | None:
        outcome = run_identify_plant(
            self.bench, PlantRequest(self.axis), self.folder / "plant", model=self.model, channel=self.channel
        )
        _raise(outcome.failure)
        return None

    def _ate(self) -> str | None:
        outcome = identify_ate(self.bench, AteRequest(self.axis), self.folder / "ate", self._identified(), channel=self.channel)
        _raise(outcome.failure)
        if outcome.part is not None:
            update_file(self.model, self.bench.name, self.axis, outcome.part)
        return None if outcome.result.is_within_goal else "; ".join(outcome.result.notes or ()) or "not within the goal"

    def _design(self) -> str | None:
        request = NotchDesignRequest(self.axis, effort=self.options.effort)
        outcome = design(self.bench, request, self._identified())
        if not outcome.is_usable:
            _raise(outcome.failure)
        update_designs(self.designs, self.bench.name, self.axis, designed_axis(outcome))
        return None if outcome.failure is None else str(outcome.failure)

    def _run(self, treatment: TreatmentName) -> str | None:
        experiment = Experiment("constant-acceleration", self.axis, treatment)
        outcome = run_experiments(
            self.bench, [experiment], self.folder / treatment, knowledge=self._knowledge(), channel=self.channel
        )
        _raise(outcome.failure)
        refusals = [run.invalid for run in outcome.result.runs if run.trial is not None and not run.trial.is_good]
        if refusals:
            raise TrialRefusedError(str(refusals[0]))
        return "; ".join(dict.fromkeys(outcome.invalid)) or None

    def _learn(self) -> str | None:
        outcome = learn_on_bus(self.bench, LearnRequest((self.axis,)), self.folder / "learn", self.learnt, channel=self.channel)
        _raise(outcome.failure)
        return None

    # -- what is known -------------------------------------------------------------------------------------------------

    def _identified(self) -> Identified | None:
        return load_identified(self.model) if self.model.exists() else None

    def _learnt(self) -> Identified | None:
        if "learn" not in self.result.steps or not self.result.steps["learn"].is_done:
            return None
        return load_identified(self.learnt)

    def _knowledge(self) -> Knowledge:
        designs = load_designs(self.designs) if self.designs.exists() else None
        return Knowledge(self._identified(), designs, self._learnt())

    def _survey(self) -> None:
        """Measure the true tip under each treatment that the path has."""
        survey = Survey(self.robot, self.bench, self.axis)
        knowledge, steps = self._knowledge(), self.result.steps
        needs = {"notch_designed": "design", "cancellation": "ate", "cancellation_learnt": "learn"}
        for name in TREATMENTS:
            if name in needs and (needs[name] not in steps or not steps[needs[name]].is_done):
                continue
            self.result.tips[name] = survey.tip(name, knowledge)
        self.result.floor = survey.floor()
        if self.options.with_probes:
            self.result.probes = survey.probes(knowledge)


class TrialRefusedError(HilError):
    """The trial refused a cancellation, in the run's own words."""

    exit_code = 9


def _raise(failure: Exception | None) -> None:
    if failure is not None:
        raise failure
