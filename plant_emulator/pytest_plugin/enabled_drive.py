"""One enabled drive, controlled by a test.

The sender of its cycles is the test itself in virtual time, and a separate thread by the wall clock.
"""

import math
import queue
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from typing import Any, TypeVar

import numpy as np
import pytest

from drive_profiles.standard.cia301 import DataType
from drive_profiles.standard.cia402 import Object, State, state_of
from hil.bench.bench import Limits
from hil.can.errors import ChannelError
from hil.control.trajectory import Smooth, sample_times
from hil.errors import HilError, InterruptedRunError, NotPossibleError, SafetyStopError
from hil.experiments.move import check_position
from hil.master.control_words import SHUTDOWN
from hil.master.drive.axis import DriveAxis
from hil.master.motion import Motion
from hil.master.request import check_motion
from hil.master.run import APPROACH_RAMP_S, REST_S, Run, RunStopError
from hil.recording import Recording
from plant_emulator.pytest_plugin.master import BenchSession

T = TypeVar("T")

SWITCH_INTERVAL_S = 0.2e-3
"""Time that a computing test may keep the thread that owes a cycle; Python's own 5 ms are cycles."""
KEEPER_TIMEOUT_S = 30.0
"""Time that the thread that owes cycles may take to end."""


class Keeper:
    """Executor of actions on the bus, one at a time; in virtual time.

    Virtual time passes by cycles only, so nothing is done between them.

    Attributes:
        idle: What is called between the actions as long as it returns True, where time passes by itself.
    """

    idle: Callable[[], bool] | None = None

    def call(self, action: Callable[[], T]) -> T:
        """Do something on the bus and wait for it."""
        return action()

    def close(self) -> None:
        """Perform no more actions."""


class WallKeeper(Keeper):
    """Keeper with a thread that owns the bus.

    A drive whose master is silent stops, so the thread sends cycles while the test does other work.
    """

    def __init__(self) -> None:
        self._jobs: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]] | None] = queue.SimpleQueue()
        self._error: BaseException | None = None
        self._before_s = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        self._thread = threading.Thread(target=self._work, name="hil-bench", daemon=True)
        self._thread.start()

    def call(self, action: Callable[[], T]) -> T:
        """Perform an action between two cycles, and wait for its result.

        Raises:
            BaseException: The action raises it, or an idle cycle has raised it before.
        """
        error, self._error = self._error, None
        if error is not None:
            raise error
        done: Future[T] = Future()
        self._jobs.put((action, done))
        return done.result()

    def close(self) -> None:
        """End the thread."""
        self._jobs.put(None)
        self._thread.join(KEEPER_TIMEOUT_S)
        sys.setswitchinterval(self._before_s)

    def _work(self) -> None:
        while True:
            try:
                job = self._jobs.get(block=self.idle is None)
            except queue.Empty:
                self._idle()
                continue
            if job is None:
                return
            action, done = job
            try:
                done.set_result(action())
            except BaseException as error:  # noqa: BLE001 - whoever waits for it gets it
                done.set_exception(error)

    def _idle(self) -> None:
        try:
            if self.idle is not None and not self.idle():
                self.idle = None
        except BaseException as error:  # noqa: BLE001 - the next call gets it
            self.idle, self._error = None, error


MAX_RECORDED = 1 << 15
"""Cycles that are recorded for the case of a failure: the first 65 s at 2 ms."""


class HeldRun(Run):
    """A run that follows the test's commands instead of a motion."""

    def step(self, reference: float) -> None:
        """Run one cycle with a set-point."""
        rows = self.table.rows
        self.follow(np.array([[reference]]), rows if rows < MAX_RECORDED else None)


class EnabledDrive:
    """A drive that holds its position until a test moves it.

    The limits of the bench file apply; the master monitors the drive as in a run, and may stop it.

    Positions are the motor's, in revolutions.
    """

    def __init__(self, session: BenchSession, axis: DriveAxis, run: HeldRun, keeper: Keeper) -> None:
        """Prepare the drive; it is not enabled yet."""
        self.number, self.axis = axis.number, axis
        self.limits: Limits = axis.table.limits
        self._session, self._run, self._keeper = session, run, keeper
        self._slot = run.exchange.slots[0]
        self._reference = run.starts[0]
        self._stopped: SafetyStopError | None = None
        self._is_seen = False

    # -- what it is doing ----------------------------------------------------------------------------------------------

    @property
    def state(self) -> State | None:
        """State of the drive in the last cycle.

        After a stop it is read by SDO, and None if the drive does not answer.
        """
        return state_of(self._slot.status_word) if self._stopped is None else self._keeper.call(self._ask_state)

    @property
    def is_enabled(self) -> bool:
        """True while it is in operation; see `state`."""
        return self.state is State.OPERATION_ENABLED

    @property
    def position_rev(self) -> float:
        """Motor position in revolutions as of the last cycle."""
        return self.axis.scaling.position_rad(self._slot.position_counts) / math.tau

    @property
    def torque_nm(self) -> float:
        """Motor torque as of the last cycle."""
        return self.axis.scaling.torque_nm(self._slot.torque_per_mille)

    @property
    def stopped(self) -> SafetyStopError | None:
        """Reason of the drive's stop, or None.

        A stop that the test does not read makes the test fail at its end.
        """
        self._is_seen = True
        return self._stopped

    # -- what it is to do ----------------------------------------------------------------------------------------------

    def hold(self, duration_s: float) -> None:
        """Hold the position for a time of the bench.

        Raises:
            SafetyStopError: Something stops it; it is disabled.
        """
        self._follow([self._reference] * max(1, round(duration_s / self._run.period_s)))

    def move_to(self, position_rev: float) -> None:
        """Move to a position at the bench file's `approach_rps`, and stop.

        Raises:
            UnsafeRequestError: It would leave a limit; it stays where it is.
            SafetyStopError: Something stops it before its target; it is disabled.
        """
        check_position(self.number, position_rev, self.axis.table.limits)  # before a way of any length is planned
        distance = math.tau * position_rev - self._reference
        period = self._run.period_s
        most_rps_s = self.axis.table.limits.acceleration_rps_s
        smooth = Smooth.way(distance / math.tau, self._session.bench.approach_rps, APPROACH_RAMP_S, most_rps_s)
        times = sample_times(smooth.duration_s, period)
        angles = distance * np.asarray(smooth.position(times))
        motion = Motion((self.number,), times, angles[:, np.newaxis], starts_at_home=False)
        check_motion(motion, [self.axis], [self._reference])
        self._follow([self._reference + angle for angle in angles.tolist()])
        self.hold(REST_S)

    def move_by(self, distance_rev: float) -> None:
        """Move by a distance from the present set-point; see `move_to`."""
        self.move_to(self._reference / math.tau + distance_rev)

    def wait_for_stop(self, within_s: float) -> SafetyStopError:
        """Hold until the drive is stopped, and return the reason.

        The test fails if nothing stops it in time.
        """
        try:
            self.hold(within_s)
        except SafetyStopError as stop:
            return stop
        pytest.fail(f"axis {self.number} is still enabled after {within_s:g} s")

    def read(self, name: str) -> float:
        """Read a parameter of its profile, in the profile's unit.

        Raises:
            DriveProfileError: The profile does not have it.
            HilError: The drive does not give it.
        """
        parameter = self.axis.profile.parameter(name)
        kind = DataType[parameter.data_type]
        raw = self._keeper.call(
            lambda: self._session.network.read(self.axis.node, parameter.index, parameter.subindex, kind, name)
        )
        return float(parameter.value(raw, self.axis.scaling))

    def write(self, name: str, value: float) -> None:
        """Write a parameter of its profile.

        The old value is restored after the test.

        Raises:
            DriveProfileError: The profile does not have it, or the object cannot hold the value.
            HilError: The drive refuses.
        """
        self._keeper.call(lambda: self.axis.write_parameter(name, value))

    # -- how -----------------------------------------------------------------------------------------------------------

    def _ask_state(self) -> State | None:
        """Read the state by SDO.

        A drive that has lost its master sends no more PDOs.
        """
        try:
            word = self._session.network.read(self.axis.node, Object.STATUS_WORD, 0, DataType.UNSIGNED16, "status word")
        except (HilError, ChannelError):
            return None
        return state_of(word)

    def _follow(self, references: list[float]) -> None:
        with self._session.interruptible():  # Ctrl-C ends a motion by a ramp, and then the tests
            self._keeper.call(lambda: self._cycles(references))
        if self._stopped is not None:
            self._is_seen = True
            if isinstance(self._stopped, InterruptedRunError):
                raise KeyboardInterrupt
            raise self._stopped

    def _cycles(self, references: list[float]) -> None:
        """Run cycles in the thread that owns the bus.

        A stop is kept, for the test to find.
        """
        if self._stopped is not None:
            return
        try:
            for reference in references:
                self._reference = reference
                self._run.step(reference)
        except RunStopError as stop:
            self._stopped = self._run.stop(stop.reason)
        except ChannelError as error:
            self._stopped = SafetyStopError(str(error), all_disabled=False)
        except BaseException:
            self._stopped = self._run.stop("an error in the master")
            raise

    def idle(self) -> bool:
        """Run one holding cycle between the test's commands.

        Returns False if another one makes no sense.
        """
        self._cycles([self._reference])
        return self._stopped is None

    def enable(self) -> None:
        """Enable the drive, up to Operation enabled."""
        try:
            self._run.enable()
        except RunStopError as stop:
            raise self._run.stop(stop.reason) from None
        except BaseException:
            self._run.stop("an error in the master")
            raise
        self._reference = self._run.starts[0] = self.axis.scaling.position_rad(self._slot.position_counts)

    def end(self) -> str | None:
        """Disable the drive; return a failure in words, or None."""
        if self._stopped is None:
            return None if self._run.disable(SHUTDOWN) else f"axis {self.number} has not confirmed that it is disabled"
        return None if self._is_seen else f"axis {self.number} was {self._stopped}; the test did not read `stopped`"

    def recorded(self) -> tuple[dict[str, Any], Recording]:
        """Return the recording of all cycles, for a failed test."""
        summary = {"cycles": self._run.table.rows, "stopped": None if self._stopped is None else str(self._stopped)}
        return summary, self._run.recording()


@contextmanager
def enabled(session: BenchSession, number: int) -> Iterator[EnabledDrive]:
    """Enable a drive for the time of a `with` statement."""
    session.target.check_motion_is_allowed()
    if number not in session.axes:
        pytest.fail(f"the bench has no axis {number}; it has {', '.join(map(str, session.axes))}", pytrace=False)
    if session.held is not None:
        raise NotPossibleError("one drive is enabled already")
    keeper = Keeper() if session.network.channel.is_lock_step else WallKeeper()
    bus = ExitStack()  # what only the thread that owns the bus may undo
    problems: list[str | None] = []
    try:
        held = keeper.call(lambda: _enable(session, number, keeper, bus))
        keeper.idle = held.idle
        try:
            yield held
        finally:
            keeper.idle = None
            session.target.interference.end()
            problems.append(keeper.call(held.end))
    finally:
        session.held = None
        keeper.idle = None
        session.target.interference.end()
        keeper.call(bus.close)
        keeper.close()
    for problem in filter(None, problems):
        pytest.fail(problem, pytrace=False)


def _enable(session: BenchSession, number: int, keeper: Keeper, bus: ExitStack) -> EnabledDrive:
    """Set the drive up and enable it; `bus` restores it."""
    period = session.network.period_s = session.bench.bus.sync_period_s
    axis = session.axes[number]
    axis.identify()
    exchange = session.exchange([axis], period, "drive")
    rest = Motion((number,), sample_times((MAX_RECORDED - 1) * period, period), np.zeros((MAX_RECORDED, 1)), starts_at_home=False)
    run = HeldRun(rest, [axis], exchange, session.bench, session.supervisor, [axis.position_rad()])
    held = EnabledDrive(session, axis, run, keeper)
    session.prepare(bus, [axis], exchange)
    session.held = exchange
    session.target.artefacts.add_live(f"axis-{number}-held", held.recorded)
    held.enable()
    return held
