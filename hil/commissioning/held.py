"""One enabled axis, cycle by cycle, near its position."""

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from typing import Final

import numpy as np

from drive_profiles.standard.cia301 import DataType
from drive_profiles.standard.cia402 import Object, State, state_of
from hil.bench.bench import Bench
from hil.bench.load_encoder import watched_axes, with_load_encoders
from hil.bench.tip import with_tip
from hil.control.arrays import Real
from hil.control.trajectory import sample_times
from hil.errors import HilError, InterruptedRunError, SafetyStopError
from hil.master.control_words import DISABLE_VOLTAGE, DISABLED, SHUTDOWN
from hil.master.cyclic import CyclicExchange, Slot
from hil.master.drive.axis import DriveAxis
from hil.master.drive.limits import limit_of
from hil.master.motion import Motion
from hil.master.request import check_set_points
from hil.master.run import Run, RunStopError
from hil.master.session import Session
from hil.recording import Recording

ROOM_REV: Final = 0.75
"""How far from where it stands a check may find the motor, to either side."""
CHECK_SPEED_RPS: Final = 2.0
CHECK_FOLLOWING_REV: Final = 0.3
RECORDED_S: Final = 20.0
"""Time that is recorded of a check."""


def narrowed(bench: Bench, number: int, start_rev: float) -> Bench:
    """Return a bench with limits that suffice for the checks, none wider."""
    table = bench.axis[number]
    limits = table.limits
    update = {
        "speed_rps": min(limits.speed_rps, CHECK_SPEED_RPS),
        "position_min_rev": max(limits.position_min_rev, start_rev - ROOM_REV),
        "position_max_rev": min(limits.position_max_rev, start_rev + ROOM_REV),
        "following_error_rev": min(limits.following_error_rev, CHECK_FOLLOWING_REV),
    }
    narrow = table.model_copy(update={"limits": limits.model_copy(update=update)})
    return bench.model_copy(update={"axis": {**bench.axis, number: narrow}})


class HeldAxis(Run):
    """One axis that follows given set-points, supervised as in a run.

    Attributes:
        is_masters_fault: True if the reason lies in the master: it was late.
    """

    def __init__(
        self, session: Session, axis: DriveAxis, exchange: CyclicExchange, start_rad: float, standing_rad: Mapping[int, float]
    ) -> None:
        times = sample_times(RECORDED_S, exchange.period_s)
        rest = Motion((axis.number,), times, np.zeros((len(times), 1)), starts_at_home=False)
        super().__init__(rest, [axis], exchange, session.bench, session.supervisor, [start_rad])
        self.stopped: str | None = None
        self.is_masters_fault = False
        self._standing_rad = standing_rad
        self._longest = len(times)

    @property
    def slot(self) -> Slot:
        """Process data of the axis."""
        return self.exchange.slots[0]

    @property
    def start_rad(self) -> float:
        """Motor angle at which it was enabled."""
        return self.starts[0]

    @property
    def state(self) -> State | None:
        """State of the drive by its last status word."""
        return state_of(self.slot.status_word)

    def rise(self) -> bool:
        """Enable the drive at its position; False after a stop."""
        if self._guarded(self.enable):
            self.starts[0] = self.slot.position_rad
        return self.stopped is None

    def go(self, angles_rad: Real) -> bool:
        """Follow motor angles from the start; False after a stop.

        The angles have the shape (n,).

        Raises:
            UnsafeRequestError: They accelerate by more than the limit; none of them is sent.
        """
        check_set_points(self.slot.axis.number, self.slot.axis.table.limits, angles_rad, self.period_s)
        return self._guarded(lambda: self._follow(np.reshape(self.start_rad + angles_rad, (-1, 1))))

    def rest(self, duration_s: float) -> bool:
        """Hold the start; False if something has stopped it."""
        return self.go(np.zeros(max(1, round(duration_s / self.period_s))))

    def watch(self, duration_s: float) -> Real:
        """Return motor angles while the drive has no torque; shape (n,)."""
        seen: list[float] = []
        for _ in range(max(1, round(duration_s / self.period_s))):
            self.slot.control_word = DISABLE_VOLTAGE
            self.supervisor.cycle(self.exchange)
            if not self.slot.missing:
                seen.append(self.slot.position_rad)
        return np.array(seen)

    def command(self, word: int, angles_rad: Sequence[float]) -> float | None:
        """Send a control word with set-points, until torque ends.

        Set-points count from the start; there are as many cycles as set-points.

        Returns:
            Time until the drive was out of operation; None if it remained in operation, and its voltage was disabled.

        Raises:
            SafetyStopError: It has not confirmed that either.
        """
        for row, angle in enumerate(angles_rad):
            self.slot.control_word = word
            self.slot.target = self.slot.axis.scaling.position_counts(self.start_rad + angle)
            self.supervisor.cycle(self.exchange)
            if not self.slot.missing and self.state in DISABLED:
                return (row + 1) * self.period_s
        self._cut()
        return None

    def silence(self, at_most_s: float) -> float | None:
        """Hold back the master's heartbeat.

        Returns:
            Time until the drive was out of operation; None if it was not, and has lost its voltage.

        Raises:
            SafetyStopError: It has not confirmed that either.
        """
        self.supervisor.is_silent, row = True, 0
        try:
            for row in range(round(at_most_s / self.period_s)):
                self.slot.target = self.slot.axis.scaling.position_counts(self.start_rad)
                self.supervisor.cycle(self.exchange)
                if self.slot.missing > self.bench.bus.missing_limit:
                    # a node that falls back to pre-operational sends no PDOs; that alone does not disable it
                    break
                if not self.slot.missing and self.state in DISABLED:
                    return (row + 1) * self.period_s
        finally:
            self.supervisor.is_silent = False
        if self.slot.missing and self._asked() in DISABLED:
            return (row + 1 - self.slot.missing) * self.period_s
        self._cut()
        return None

    def lower(self) -> None:
        """Disable the axis, as at the end of every run.

        Raises:
            SafetyStopError: The drive has not confirmed it.
        """
        if self.stopped is None and not self.disable(SHUTDOWN):
            self._cut()

    def _asked(self) -> State | None:
        """State of the drive by SDO."""
        axis, address = self.slot.axis, (Object.STATUS_WORD, 0)
        return state_of(self.supervisor.network.read(axis.node, *address, DataType.UNSIGNED16, "status word"))

    def _cut(self) -> None:
        """Disable the voltage of a drive that has not stopped."""
        self.stopped = "it did not stop as required"
        if self.disable(DISABLE_VOLTAGE):
            return
        axis, word = self.slot.axis, DISABLE_VOLTAGE.to_bytes(2, "little")
        with contextlib.suppress(HilError):  # one that sends no PDOs hears none either
            self.supervisor.network.write_raw(axis.node, Object.CONTROL_WORD, 0, word, "control word")
            if self._asked() in DISABLED:
                return
        raise self.stop(self.stopped)

    def recorded(self) -> Recording:
        """All cycles in which set-points were followed."""
        recording = with_load_encoders(self.bench, self.recording(), self._standing_rad)
        return with_tip(self.bench, recording, self._standing_rad)

    def _follow(self, references: Real) -> None:
        row = self.table.rows
        recorded = self._longest - row
        self.follow(references[:recorded], row)
        self.follow(references[recorded:])

    def _guarded(self, action: Callable[[], None]) -> bool:
        """Do something that a reason to stop may end.

        The axis is then brought to rest and disabled.
        """
        if self.stopped is not None:
            return False
        try:
            action()
        except RunStopError as stop:
            self.is_masters_fault = stop.reason == self._own_fault()
            error = self.stop(stop.reason)
            if isinstance(error, InterruptedRunError) or not error.all_disabled:
                raise error from None
            self.stopped = stop.reason
        return self.stopped is None


@contextmanager
def held_axis(session: Session, number: int, limits_si: Mapping[str, float] | None = None) -> Iterator[HeldAxis]:
    """Set up one axis under narrow limits, and restore it.

    The limits are those in master and drive. The axis is disabled until `rise`. `limits_si` are limits of the drive that differ
    from the master's, by their keys in the bench file.

    Raises:
        SafetyStopError: The drive has not confirmed that it is disabled.
        HilError: The set-up was refused.
    """
    session.check_interrupt()
    whole, axis = session.bench, session.axes[number]
    session.reset_fault(axis)  # a check before may have put it there on purpose
    session.adopt(narrowed(whole, number, axis.position_rad() / math.tau))
    period = session.network.period_s = whole.bus.sync_period_s
    try:
        axis.identify()
        watched = [session.axes[each] for each in watched_axes(whole, (number,))]
        exchange = session.exchange([axis], period, "drive", watched=watched)
        others = {each: other.position_rad() for each, other in session.axes.items() if each != number}
        held = HeldAxis(session, axis, exchange, axis.position_rad(), others if whole.arm is not None else {})
        with ExitStack() as context:
            session.prepare(context, [axis], exchange)
            for key, value in (limits_si or {}).items():
                axis.write_limit(limit_of(key), value)
            try:
                yield held
                held.lower()
            except BaseException as error:
                if not isinstance(error, SafetyStopError):
                    with contextlib.suppress(Exception):
                        held.stop("an error in the master")
                raise
    finally:
        session.adopt(whole)
        session.log.write()
