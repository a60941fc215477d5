"""The documented path of an arm, docs/arm.md, as a function.

The cancellation is learnt on the arm's line, used in a run there, and tested elsewhere, by the true tip.
"""

from collections.abc import Callable, Collection
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from drive_profiles.files.toml import loads
from hil.arm.straight_line import LineError
from hil.bench.bench import Bench, load_bench
from hil.bench.model import Identified, load_identified
from hil.errors import HilError, InterruptedRunError, UnsafeRequestError
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.probing.on_bus import MotionLearningOutcome, MotionLearnRequest, learn_motion_on_bus
from hil.experiments.cancellation.probing.pace import paced_line
from hil.experiments.motions import LINE_MOTION, line_motion
from hil.experiments.plan import Experiment
from hil.experiments.treatment import Knowledge
from hil.recording import Recording
from hil.tip_vector import displacement_mm, steady_window_s, tip_acceleration
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.rehearsal.arms.conditions import LEARNT, Condition, conditions_of
from plant_emulator.rehearsal.many.one import walked
from plant_emulator.rehearsal.record import FLOOR_FACTOR, MAX_WORDS, QUIET_MM, WORSE_FRACTION, WORSE_MM
from plant_emulator.rehearsal.steps import TrialRefusedError, channel_of, note_of_run, raise_failure, run_of
from plant_emulator.rehearsal.survey import recorded, session_on
from plant_emulator.rehearsal.truth import quiet, without_error
from plant_emulator.robots.blank_bench import blank_bench
from plant_emulator.robots.drawn_arms import arm_facts, draw_arm
from plant_emulator.robots.robot import ArmRobot, Robot, load_robot
from plant_emulator.trials.rows import Row, Value


class LineTip(NamedTuple):
    """Largest tip displacement while judged (x, y, z, worst direction), mm."""

    x: float
    y: float
    z: float
    worst: float


class TrueLine(NamedTuple):
    """The true tip in one condition.

    Attributes:
        none: Without a treatment.
        learnt: With what was learnt; None if the product refuses it, or stops.
        floor: Without transmission errors.
    """

    none: LineTip
    learnt: LineTip | None
    floor: LineTip

    @property
    def is_quiet(self) -> bool:
        """True if the tip meets the goal along x, y and z."""
        if self.learnt is None:
            return False
        return all(own <= max(QUIET_MM, FLOOR_FACTOR * least) for own, least in zip(self.learnt[:3], self.floor[:3], strict=True))

    @property
    def is_worse(self) -> bool:
        """True if the tip moves more than permitted in any direction."""
        if self.learnt is None:
            return False
        most = (max(_no_harm(before), _no_harm(least)) for before, least in zip(self.none, self.floor, strict=True))
        return any(own > allowed for own, allowed in zip(self.learnt, most, strict=True))


def _no_harm(tip_mm: float) -> float:
    return tip_mm + max(WORSE_MM, WORSE_FRACTION * tip_mm)


def true_line(condition: Condition, model: Identified | None, left_out: Collection[Part]) -> TrueLine:
    """Return the true tip in a condition, with equal windows.

    Args:
        model: What was learnt; None if nothing was.
        left_out: Orders that the trial has left out.
    """
    none = _tip(condition.robot, condition.bench, None, ())
    floor = _tip(without_error(condition.robot), condition.bench, None, ())
    assert none is not None  # noqa: S101 - nothing can be refused
    assert floor is not None  # noqa: S101 - likewise
    return TrueLine(none, none if model is None else _tip(condition.robot, condition.bench, model, left_out), floor)


def _tip(robot: Robot, bench: Bench, model: Identified | None, left_out: Collection[Part]) -> LineTip | None:
    """Return a run's tip; None if the product refuses or stops it.

    Raises:
        KeyboardInterrupt: A signal ended the run.
    """
    ideal = bench.model_copy(update={"accelerometer": bench.accelerometer.model_copy(update={"mounting": None})})
    still = quiet(robot)
    still = still.model_copy(update={"accelerometer": still.accelerometer.model_copy(update={"mounting": None})})
    with session_on(still, ideal) as session:
        made = recorded(session, line_motion(ideal, ideal.bus.sync_period_s), model, left_out)
    return None if made is None else _judged(bench, made)


def _judged(bench: Bench, recording: Recording) -> LineTip:
    line, band_hz = bench.line_motion, bench.specification.band_hz
    assert line is not None  # noqa: S101 - it was run
    assert band_hz is not None  # noqa: S101 - it was learnt in it
    begin_s, end_s = (line.dwell_s + each for each in steady_window_s(line.duration_s, line.ramp_s))
    rows = (recording.time_s >= begin_s) & (recording.time_s <= end_s)
    moved = displacement_mm(tip_acceleration(recording), recording.period_s, band_hz)[rows]
    x, y, z = np.max(np.abs(moved), axis=0).tolist()
    return LineTip(x, y, z, float(np.max(np.linalg.norm(moved, axis=1))))


Made = TypeVar("Made")

QUICKER = (0.75, 0.8, 0.85, 0.9)
"""Multiples of the line's time in which it is learnt as well: the first in which the arm can follow it."""
REFERENCE_SEED = 0
"""Seed of the reference arm, which is not drawn."""


def arm_of(seed: int) -> tuple[ArmRobot, Bench]:
    """Return a seed's arm and its blank bench file."""
    if seed == REFERENCE_SEED:
        robot = load_robot("reference-arm")
        assert isinstance(robot, ArmRobot)  # noqa: S101 - its file has an arm
        return robot, load_bench("reference-arm")
    robot = draw_arm(seed)
    return robot, loads(blank_bench(robot), Bench, "blank bench")


def run_arm_seed(seed: int, keep: str | None = None) -> Row:
    """Run the documented path on a seed's arm.

    Args:
        seed: Seed of the arm; 0 is the reference arm.
        keep: As of `walked`.
    """
    return walked({"seed": seed, "kind": "arm"}, keep, lambda folder: run_arm(*arm_of(seed), folder))


def run_arm(robot: ArmRobot, bench: Bench, folder: Path) -> dict[str, Value]:
    """Learn on an arm's line, run, measure the tip in all conditions."""
    row: dict[str, Value] = dict(arm_facts(robot))
    if bench.line_motion is None:
        return row | {
            "learn_ended": "refused",
            "learn_words": "the arm cannot follow a line",
            "is_quiet": False,
            "is_worse": False,
        }
    channel, model = channel_of(robot), folder / "learnt.toml"
    row |= _learnt(bench, folder, model, channel)
    learnt = load_identified(model) if model.exists() else None
    left_out: tuple[Part, ...] = ()
    if learnt is not None:
        known, experiment = Knowledge(learnt=learnt), Experiment(LINE_MOTION, None, "cancellation-learnt")
        ended, note = _step(lambda: note_of_run(run_of(bench, experiment, folder / "run", known, channel)), "run")
        row |= ended
        left_out = () if note is None else note.left_out
    used = learnt if row.get("run_ended") == "done" else None
    row["left_out"] = ", ".join(part.words for part in left_out)
    return row | _surveyed(robot, bench, used, left_out)


def quicker_pace(bench: Bench) -> float | None:
    """Return a quicker pace for the line.

    The line is learnt at this pace, too. The result is None if the arm can follow it at none.
    """
    for pace in QUICKER:
        try:
            paced_line(bench, pace)
        except (LineError, UnsafeRequestError):
            continue
        return pace
    return None


def _learnt(bench: Bench, folder: Path, model: Path, channel: InProcessChannel) -> dict[str, Value]:
    request = MotionLearnRequest(LINE_MOTION, pace=quicker_pace(bench))

    def learn() -> MotionLearningOutcome:
        outcome = learn_motion_on_bus(bench, request, folder / "learn", model, channel=channel)
        raise_failure(outcome.failure)
        return outcome

    ended, outcome = _step(learn, "learn")
    if outcome is not None:
        kept = next(run for run in outcome.result.runs if run.is_kept)
        ended |= {"learn_runs": len(outcome.result.runs), "learn_peak_mm": kept.tip_peak_mm}
        ended["learnt_parts"] = sum(part.outcome == "learnt" for part in outcome.result.parts)
        ended["left_at_0"] = sum(part.outcome != "learnt" for part in outcome.result.parts)
    return ended


def _step(act: Callable[[], Made], name: str) -> tuple[dict[str, Value], Made | None]:
    """Take a step of the path; return words on its end, result.

    Raises:
        KeyboardInterrupt: A signal ended a motion.
    """
    try:
        made = act()
    except InterruptedRunError:
        raise KeyboardInterrupt from None
    except TrialRefusedError as error:
        return {f"{name}_ended": "refused", f"{name}_words": str(error)[:MAX_WORDS]}, None
    except HilError as error:
        return {f"{name}_ended": "refused", f"{name}_words": f"{type(error).__name__}: {error}"[:MAX_WORDS]}, None
    return {f"{name}_ended": "done", f"{name}_words": ""}, made


def _surveyed(robot: ArmRobot, bench: Bench, learnt: Identified | None, left_out: tuple[Part, ...]) -> dict[str, Value]:
    row: dict[str, Value] = {}
    quiet, worse = [], []
    for condition in conditions_of(robot, bench):
        found = true_line(condition, learnt, left_out)
        for treatment, tip in zip(found._fields, found, strict=True):
            row |= {f"tip_{condition.name}_{treatment}_{way}_mm": value for way, value in tip._asdict().items()} if tip else {}
        row |= {f"{condition.name}_is_quiet": found.is_quiet}
        quiet += [condition.name] if found.is_quiet else []
        worse += [condition.name] if found.is_worse else []
    names = [name for name in row if name.endswith("_is_quiet")]
    row |= {
        "line_quiet": LEARNT in quiet,
        "is_quiet": len(quiet) == len(names),
        "is_worse": bool(worse),
        "worse": ", ".join(worse),
    }
    return row
