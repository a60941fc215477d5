"""The survey of a robot."""

import math
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import scipy

from hil.analysis import motor_speed_rps
from hil.bench.bench import Bench
from hil.bench.design import with_designs
from hil.bench.model import Identified
from hil.errors import HilError, InterruptedRunError
from hil.experiments.cancellation.cancellation import cancellation_on
from hil.experiments.cancellation.effect import Part
from hil.experiments.motions import constant_acceleration
from hil.experiments.treatment import Knowledge
from hil.master.motion import FilterUse, Motion
from hil.master.session import Session
from hil.recording import BusLog, Recording
from plant_emulator.rehearsal.steps import channel_of
from plant_emulator.rehearsal.truth import quiet, tip_by_order_mm, true_f_al_hz, without_error
from plant_emulator.robots.robot import Robot

SAMPLES_PER_SWING = 12.0
"""Samples of the true tip in a period of f_al: order 4 at the end of order 2's window, 2.6 f_al, has more than four."""


class Survey:
    """Runs of the user's motion, measured by an ideal sensor."""

    def __init__(self, robot: Robot, bench: Bench, axis: int) -> None:
        self._robot, self._bench, self._axis = robot, bench, axis
        self._f_al_hz = true_f_al_hz(bench, robot, axis)
        self._perfect: Recording | None = None

    def tip(self, treatment: str, knowledge: Knowledge, left_out: Collection[Part] = ()) -> dict[float, float]:
        """Return the true tip by order under a treatment, mm.

        Args:
            treatment: Name as in `record.TREATMENTS`.
            left_out: Orders of a cancellation that its trial has left out.
        """
        bench, model = self._bench, None
        filters: FilterUse = "none"
        if treatment == "notch":
            filters = "notch"
        elif treatment == "notch_designed" and knowledge.designs is not None:
            bench, filters = with_designs(bench, knowledge.designs), "notch"
        elif treatment == "cancellation":
            model = knowledge.identified
        elif treatment == "cancellation_learnt":
            model = knowledge.learnt
        return self._tip(bench, filters, model, left_out)

    def cancelled(self, model: Identified, left_out: Collection[Part]) -> dict[float, float]:
        """Return the true tip by order under a model's cancellation, mm."""
        return self._tip(self._bench, "none", model, left_out)

    def floor(self) -> dict[float, float]:
        """Return the true tip by order without an ATE, mm."""
        recording = self._with_perfect_gears()
        if recording is None:
            return {}
        return tip_by_order_mm(recording, self._axis, self._f_al_hz)

    def _tip(self, bench: Bench, filters: FilterUse, model: Identified | None, left_out: Collection[Part]) -> dict[float, float]:
        recording = self._record(self._robot, bench, filters, model, left_out)
        if recording is None:
            return {}
        perfect = self._with_perfect_gears()
        speed_rps = None if perfect is None else motor_speed_rps(perfect, self._axis)
        return tip_by_order_mm(recording, self._axis, self._f_al_hz, speed_rps)

    def _with_perfect_gears(self) -> Recording | None:
        if self._perfect is None:
            self._perfect = self._record(without_error(self._robot), self._bench, "none", None, ())
        return self._perfect

    def _record(
        self, robot: Robot, bench: Bench, filters: FilterUse, model: Identified | None, left_out: Collection[Part]
    ) -> Recording | None:
        """Run the user's motion; None if the product refuses or stops it.

        What the tip does above half of the SYNC rate looks in its samples like something else. So the motion is run several
        times, with a sensor that is late by another part of the SYNC period each time.
        """
        period_s, runs = bench.bus.sync_period_s, list[Recording]()
        count = max(1, math.ceil(SAMPLES_PER_SWING * self._f_al_hz * period_s))
        for part in range(count):
            with session_on(quiet(robot, part / count * period_s), bench) as session:
                motion = constant_acceleration(bench, self._axis, period_s)
                made = recorded(session, motion, model, left_out, filters)
            if made is None:
                return None
            runs.append(made)
        return interleaved(runs, self._axis)


@contextmanager
def session_on(robot: Robot, bench: Bench) -> Iterator[Session]:
    """Open a session on a robot of its own."""
    with Session(bench, channel_of(robot), BusLog(None)) as session:
        session.bring_up()
        yield session


def recorded(
    session: Session, motion: Motion, model: Identified | None, left_out: Collection[Part], filters: FilterUse = "none"
) -> Recording | None:
    """Run a motion with a model's cancellation; None if the product refuses or stops it.

    Raises:
        KeyboardInterrupt: A signal ended the run.
    """
    try:
        adder = None if model is None else cancellation_on(session, model, motion).without(left_out).adder()
        result = session.run(motion, filters, "drive", adder, shows_filter=False)
    except InterruptedRunError:
        raise KeyboardInterrupt from None
    except HilError:
        return None
    if isinstance(result.stopped, InterruptedRunError):
        raise KeyboardInterrupt
    return None if result.stopped is not None else result.recording


def interleaved(runs: Sequence[Recording], axis: int) -> Recording:
    """Return one recording of a motion that was run several times.

    In run i of n the tip's sample is i/n of a SYNC period old. The angle between its samples is a cubic spline.

    Args:
        runs: The runs, which are the same but for the tip; rows that some of them lack are left out.
        axis: Axis whose angle is kept.
    """
    count, rows, name = len(runs), min(len(run.time_s) for run in runs), f"axis{axis}_position_rad"
    sync_s, angle = runs[0].time_s[:rows], runs[0].columns[name][:rows]
    late_s = runs[0].period_s / count * np.arange(count)[::-1]
    time_s = (sync_s[:, np.newaxis] - late_s).ravel()[count - 1 :]
    tip = np.stack([run.columns["tip_z_m_s2"][:rows] for run in reversed(runs)], axis=1).ravel()[count - 1 :]
    if count > 1:
        angle = scipy.interpolate.CubicSpline(sync_s, angle)(time_s)
    return Recording({"time_s": time_s, name: angle, "tip_z_m_s2": tip})
