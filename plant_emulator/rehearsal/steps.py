"""The steps of the documented path on one robot."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

from hil.bench.bench import Bench
from hil.bench.design import load_designs, update_designs
from hil.bench.model import Identified, load_identified, update_file
from hil.control.treatments import TreatmentName
from hil.design.notch_search import Effort
from hil.errors import HilError
from hil.experiments.ate.on_bus import identify_ate
from hil.experiments.ate.request import AteRequest
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.learn_run import LearnRequest, learn_on_bus
from hil.experiments.notch_design import design, designed_axis
from hil.experiments.notch_problem import NotchDesignRequest
from hil.experiments.plan import Experiment
from hil.experiments.plant.motion import PlantRequest
from hil.experiments.plant.on_bus import run_identify_plant
from hil.experiments.runner import run_experiments
from hil.experiments.treatment import Knowledge
from hil.results.ate import AteResult
from hil.results.runs import CancellationTrial, ExperimentsResult
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import Robot
from plant_emulator.world import World

SMALL_EFFORT = Effort(16, 6, 6, 2)
"""Effort of the notch's search in a rehearsal: a tenth of the quick one."""
Note = str | None
"""Words of a step that is done, with less than was asked."""


class RunNote(NamedTuple):
    """Outcome of a run that was made.

    Attributes:
        causes: Causes of the excess over the goal; empty if there is none, or none was stated.
        left: Its remainder of the vibration, in words.
        left_mm: The tip's peak in the worst window, as the trial saw it; None without a trial.
        noise_mm: Peak that the noise may hide.
    """

    note: Note = None
    left_out: tuple[Part, ...] = ()
    causes: tuple[str, ...] = ()
    left: str = ""
    left_mm: float | None = None
    noise_mm: float = 0.0


class TrialRefusedError(HilError):
    """Refusal of a cancellation or of filters by the trial."""

    exit_code: ClassVar[int] = 9

    def __init__(self, words: str, trial: CancellationTrial | None = None) -> None:
        self.causes = ("noise",) if trial is not None and any(part.verdict == "not judged" for part in trial.parts) else ()
        super().__init__(words)


@dataclass(frozen=True)
class PathFiles:
    """The files of a path."""

    folder: Path

    @property
    def model(self) -> Path:
        """Model file of the identifications."""
        return self.folder / "model.toml"

    @property
    def learnt(self) -> Path:
        """Model file of learning."""
        return self.folder / "learnt.toml"

    @property
    def designs(self) -> Path:
        """Design file."""
        return self.folder / "design.toml"

    def identified(self) -> Identified | None:
        """Return what has been identified so far, or None."""
        return load_identified(self.model) if self.model.exists() else None

    def knowledge(self, *, is_learnt: bool) -> Knowledge:
        """Return all knowledge of the robot."""
        designs = load_designs(self.designs) if self.designs.exists() else None
        return Knowledge(self.identified(), designs, load_identified(self.learnt) if is_learnt else None)


def channel_of(robot: Robot) -> InProcessChannel:
    """Return a bus of this process for a robot of its own; nobody reads single frames."""
    return InProcessChannel(World(robot), bitrate=robot.bus.bitrate, is_logged=False)


class StepsInProcess:
    """Steps by the product's functions, on a robot of this process."""

    def __init__(self, robot: Robot, bench: Bench, axis: int, files: PathFiles) -> None:
        self.channel = channel_of(robot)
        self._bench, self._axis, self._files = bench, axis, files

    def plant(self) -> Note:
        """Identify the plant."""
        outcome = run_identify_plant(
            self._bench, PlantRequest(self._axis), self._out("plant"), model=self._files.model, channel=self.channel
        )
        raise_failure(outcome.failure)
        return None

    def ate(self) -> Note:
        """Identify the ATE, and add it to the model file."""
        outcome = identify_ate(
            self._bench, AteRequest(self._axis), self._out("ate"), self._files.identified(), channel=self.channel
        )
        raise_failure(outcome.failure)
        if outcome.part is not None:
            update_file(self._files.model, self._bench.name, self._axis, outcome.part)
        return note_of_error(outcome.result)

    def design(self) -> Note:
        """Design a notch, and write it into the design file."""
        outcome = design(self._bench, NotchDesignRequest(self._axis, effort=SMALL_EFFORT), self._files.identified())
        if not outcome.is_usable:
            raise_failure(outcome.failure)
        update_designs(self._files.designs, self._bench.name, self._axis, designed_axis(outcome))
        return None if outcome.failure is None else str(outcome.failure)

    def run(self, treatment: TreatmentName, *, is_learnt: bool) -> RunNote:
        """Run the user's motion with a treatment."""
        experiment = Experiment("constant-acceleration", self._axis, treatment)
        knowledge = self._files.knowledge(is_learnt=is_learnt)
        return note_of_run(run_of(self._bench, experiment, self._out(treatment), knowledge, self.channel))

    def learn(self) -> Note:
        """Learn the ATE from what is known, into its own model file."""
        files, request = self._files, LearnRequest((self._axis,))
        known = files.model if files.model.exists() else None
        outcome = learn_on_bus(self._bench, request, self._out("learn"), files.learnt, plant=known, channel=self.channel)
        raise_failure(outcome.failure)
        return None

    def _out(self, name: str) -> Path:
        return self._files.folder / name


def run_of(
    bench: Bench, experiment: Experiment, folder: Path, knowledge: Knowledge, channel: InProcessChannel
) -> ExperimentsResult:
    """Execute one run; raise the error that ended it."""
    outcome = run_experiments(bench, [experiment], folder, knowledge=knowledge, channel=channel)
    raise_failure(outcome.failure)
    return outcome.result


def note_of_error(result: AteResult) -> Note:
    """Return an identification's standard errors beyond demand in words, or None."""
    return None if result.is_within_goal else "; ".join(result.notes or ()) or "not within the goal"


def note_of_run(result: ExperimentsResult) -> RunNote:
    """Return the outcome of a run.

    Raises:
        TrialRefusedError: The trial refused the cancellation, or the filters.
    """
    run = result.runs[0]
    notes = list(dict.fromkeys(each.invalid for each in result.runs if each.invalid is not None))
    if run.filter_trial is not None and not run.filter_trial.is_good:
        raise TrialRefusedError(run.filter_trial.words)
    if run.trial is None:
        return RunNote("; ".join(notes) or None)
    if not run.trial.is_good:
        raise TrialRefusedError(str(run.invalid), run.trial)
    notes += [part.words for part in run.trial.left_out]
    left_out = tuple(Part(part.axis, part.order) for part in run.trial.left_out)
    note, rest = "; ".join(notes) or None, run.trial.remainder
    if rest is None:
        return RunNote(note, left_out)
    return RunNote(note, left_out, rest.causes, rest.words, rest.left_mm, rest.noise_mm)


def raise_failure(failure: Exception | None) -> None:
    """Raise what has ended a measurement, if anything has."""
    if failure is not None:
        raise failure
