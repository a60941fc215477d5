"""The true tip of an arm on a line."""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from hil.bench.bench import Bench
from hil.bench.model import Identified
from hil.errors import HilError, InterruptedRunError
from hil.experiments.cancellation.cancellation import cancellation_on
from hil.experiments.cancellation.effect import Part
from hil.experiments.motions import line_motion
from hil.recording import Recording
from hil.tip_vector import displacement_mm, steady_window_s, tip_acceleration
from plant_emulator.rehearsal.arms.conditions import Condition
from plant_emulator.rehearsal.record import FLOOR_FACTOR, QUIET_MM, WORSE_FRACTION, WORSE_MM
from plant_emulator.rehearsal.survey import session_on
from plant_emulator.rehearsal.truth import quiet, without_error
from plant_emulator.robots.robot import Robot


class LineTip(NamedTuple):
    """Largest displacement of the tip in the judged times, mm.

    It is given along x, y and z, and in its worst direction.
    """

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
        """True if the tip moves more than permitted in any direction.

        The bound is the larger of the tips without a treatment and without an ATE, with a tolerance.
        """
        if self.learnt is None:
            return False
        most = (max(_no_harm(before), _no_harm(least)) for before, least in zip(self.none, self.floor, strict=True))
        return any(own > allowed for own, allowed in zip(self.learnt, most, strict=True))


def _no_harm(tip_mm: float) -> float:
    return tip_mm + max(WORSE_MM, WORSE_FRACTION * tip_mm)


def true_line(condition: Condition, model: Identified | None, left_out: Collection[Part]) -> TrueLine:
    """Return the true tip in a condition, with equal windows.

    Args:
        condition: The condition.
        model: What was learnt; None if nothing was.
        left_out: Orders that the trial has left out.
    """
    none = _tip(condition.robot, condition.bench, None, ())
    floor = _tip(without_error(condition.robot), condition.bench, None, ())
    assert none is not None  # noqa: S101 - nothing can be refused
    assert floor is not None  # noqa: S101 - likewise
    return TrueLine(none, none if model is None else _tip(condition.robot, condition.bench, model, left_out), floor)


def _tip(robot: Robot, bench: Bench, model: Identified | None, left_out: Collection[Part]) -> LineTip | None:
    """Return the tip of one run.

    The result is None if the product refuses or stops the run.

    Raises:
        KeyboardInterrupt: A signal ended the run.
    """
    ideal = bench.model_copy(update={"accelerometer": bench.accelerometer.model_copy(update={"mounting": None})})
    still = quiet(robot)
    still = still.model_copy(update={"accelerometer": still.accelerometer.model_copy(update={"mounting": None})})
    with session_on(still, ideal) as session:
        motion = line_motion(ideal, ideal.bus.sync_period_s)
        try:
            adder = None if model is None else cancellation_on(session, model, motion).without(left_out).adder()
            result = session.run(motion, "none", "drive", adder, shows_filter=False)
        except InterruptedRunError:
            raise KeyboardInterrupt from None
        except HilError:
            return None
    if isinstance(result.stopped, InterruptedRunError):
        raise KeyboardInterrupt
    return None if result.stopped is not None else _judged(bench, result.recording)


def _judged(bench: Bench, recording: Recording) -> LineTip:
    line, band_hz = bench.line_motion, bench.specification.band_hz
    assert line is not None  # noqa: S101 - it was run
    assert band_hz is not None  # noqa: S101 - it was learnt in it
    begin_s, end_s = (line.dwell_s + each for each in steady_window_s(line.duration_s, line.ramp_s))
    rows = (recording.time_s >= begin_s) & (recording.time_s <= end_s)
    moved = displacement_mm(tip_acceleration(recording), recording.period_s, band_hz)[rows]
    x, y, z = np.max(np.abs(moved), axis=0).tolist()
    return LineTip(x, y, z, float(np.max(np.linalg.norm(moved, axis=1))))
