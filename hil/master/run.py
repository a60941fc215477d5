"""One run, from the first control word to the last: enable, settle, move and record, return, disable; and how it is stopped."""

import contextlib
import math
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from drive_profiles.cia402 import State, control_word_towards, state_of
from hil.can.channel import ChannelError
from hil.control.servo_bank import ServoBank
from hil.control.trajectory import Smooth, sample_times
from hil.errors import InterruptedRunError, SafetyStopError
from hil.master.axis import DriveAxis
from hil.master.correction import Corrector
from hil.master.cyclic import CyclicPlan
from hil.master.guard import AxisGuard
from hil.master.lateness import duration_text
from hil.master.motion import Motion, RunResult
from hil.recording import Recording

if TYPE_CHECKING:  # the session makes its runs
    from hil.master.session import Session

__all__ = ["DISABLED", "DISABLE_VOLTAGE", "FAULT_RESET", "Motion", "Run", "RunResult"]

ENABLE_TIMEOUT_S = 2.0
STOP_TIMEOUT_S = 2.0
"""How long beyond its ramp a drive may take to say that it is disabled."""
APPROACH_RAMP_S = 0.5
REST_S = 0.1
"""How long the axes stand before their brakes close."""
SHUTDOWN, SWITCH_ON, QUICK_STOP, DISABLE_VOLTAGE, FAULT_RESET = 0x0006, 0x0007, 0x0002, 0x0000, 0x0080

DISABLED = {
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
    State.FAULT,
    State.NOT_READY_TO_SWITCH_ON,
}


class Run:
    """One run while it lasts: the cycles from enabling to disabled."""

    def __init__(
        self,
        session: "Session",
        motion: Motion,
        axes: list[DriveAxis],
        plan: CyclicPlan,
        bank: ServoBank | None,
        period: float,
        starts: list[float],
        corrector: Corrector | None = None,
    ) -> None:
        self.session, self.motion, self.axes, self.plan, self.bank = session, motion, axes, plan, bank
        self.corrector = corrector
        self.period, self.starts = period, starts
        self.rows = 0
        self.missed = 0
        self.sensor_missed = 0
        self.dropped = 0
        self._guards = [AxisGuard(axis.number, axis.table, session.bench.bus, period) for axis in axes]
        self._holding: dict[int, float] = {}
        self._trusted = [0] * len(axes)
        self._bus_errors = Counter(session.network.bus_errors)
        self._table = np.full((len(motion.time_s), 5 + 4 * len(axes)), 0.0)  # its pages are there before the motion needs them

    # -- the sequence --------------------------------------------------------------------------------------------------

    def perform(self) -> SafetyStopError | None:
        """Enable, settle, move, return and disable; why it was stopped, or None."""
        try:
            self._enable()
            here = [slot.position_rad for slot in self.plan.slots]
            self._move(here, self.starts)
            self._hold(self.starts, self.session.bench.settle_s)
            self._record()
            end = [start + float(angle) for start, angle in zip(self.starts, self.motion.motor_angle_rad[-1], strict=True)]
            self._move(end, self.starts)
            self._hold(self.starts, REST_S)
            if not self._disable(SHUTDOWN):
                return self._stop("not every drive has confirmed that it is disabled")
        except StopRun as stop:
            return self._stop(stop.reason)
        except ChannelError as error:
            return SafetyStopError(str(error), all_disabled=False)
        except BaseException:
            self._stop("an error in the master")  # whatever it is: the axes come to rest before anyone hears of it
            raise
        return None

    def _enable(self) -> None:
        """Step all drives to switched on, then to operation enabled, side by side, each by its own control words.

        Nobody is enabled before all can be. Host-closed, a loop is closed in the very cycle in which its drive shows that the
        brake is open, and the arm held where it was.
        """
        for goal in (State.SWITCHED_ON, State.OPERATION_ENABLED):
            self._reach(goal)

    def _reach(self, goal: State) -> None:
        for _ in range(math.ceil(ENABLE_TIMEOUT_S / self.period)):
            for slot in self.plan.slots:
                state = state_of(slot.status_word) if self.plan.cycles else None
                slot.control_word = self._word_towards(goal, state)
                if state is not State.OPERATION_ENABLED:
                    slot.target = slot.position_counts if self.bank is None else 0
            self._cycle()
            self._discard_wild()
            self._take_over()
            fault = self.session.node_fault(self.axes)
            if fault is not None:
                raise StopRun(self._own_fault() or fault)
            for slot in self.plan.slots:
                if slot.missing >= self.session.bench.bus.missing_limit:
                    raise StopRun(f"axis {slot.axis.number} does not answer")
            if all(state_of(slot.status_word) is goal for slot in self.plan.slots):
                return
        shown = (
            f"axis {slot.axis.number}: {getattr(state_of(slot.status_word), 'value', 'unknown')}" for slot in self.plan.slots
        )
        raise StopRun(f"not all drives are in {goal.value!r} within {ENABLE_TIMEOUT_S:g} s ({', '.join(shown)})")

    @staticmethod
    def _word_towards(goal: State, state: State | None) -> int:
        """The next control word on the way to a goal, and the one that keeps it."""
        if state is State.SWITCHED_ON and goal is State.SWITCHED_ON:
            return SWITCH_ON
        word = None if state is None else control_word_towards(state)
        return DISABLE_VOLTAGE if word is None else word

    def _take_over(self) -> None:
        """Host-closed, while drives are being enabled: hold each axis that is, where it was found."""
        if self.bank is None:
            return
        for i, slot in enumerate(self.plan.slots):
            if state_of(slot.status_word) is not State.OPERATION_ENABLED:
                continue
            angle = slot.position_rad
            if i not in self._holding:
                self._holding[i] = angle
                self.bank.start(i, angle)
            slot.target = slot.axis.scaling.torque_per_mille(self.bank.step_one(i, self._holding[i], angle))

    def _move(self, start: list[float], end: list[float]) -> None:
        """A smooth move from here to there, not recorded."""
        distance = max((abs(b - a) for a, b in zip(start, end, strict=True)), default=0.0) / (2.0 * math.pi)
        if distance < 1e-3:
            return
        duration = distance / self.session.bench.approach_rps + APPROACH_RAMP_S
        smooth = Smooth(max(duration, 2.0 * APPROACH_RAMP_S), APPROACH_RAMP_S)
        for share in smooth.position(sample_times(smooth.duration_s, self.period)):
            self._step([a + float(share) * (b - a) for a, b in zip(start, end, strict=True)])

    def _hold(self, where: list[float], duration_s: float) -> None:
        for _ in range(round(duration_s / self.period)):
            self._step(where)

    def _record(self) -> None:
        """The motion itself, one row per SYNC."""
        before, sensor_before, late_before = self.plan.missed_cycles, self.plan.accelerometer_missed, self._late
        angles = self.motion.motor_angle_rad + np.asarray(self.starts)
        count = len(angles)
        try:
            for row, references in enumerate(angles.tolist()):
                self._step(references, row)
                if row % 256 == 0:
                    self.session.progress(row / count)
        finally:
            self.missed = self.plan.missed_cycles - before
            self.sensor_missed = self.plan.accelerometer_missed - sensor_before
            self.dropped = self._late - late_before
            self.session.progress(1.0)

    # -- one cycle -----------------------------------------------------------------------------------------------------

    def _step(self, references: list[float], row: int | None = None) -> None:
        """Set-points out, answers in, limits checked; recorded where a row is given."""
        if self.bank is None:
            self._set_points(references, row)
        self._cycle()
        self._discard_wild()
        self._close_loops(references)
        if row is not None:
            self._keep(row, references)
        self._check(references)

    def _set_points(self, references: list[float], row: int | None) -> None:
        """Drive-closed: the set-points of the next cycle, with what corrects them, as the drives count.

        Raises:
            StopRun: A torque offset beyond the axis' limit.
        """
        motion, slots = self.motion, self.plan.slots
        offsets = motion.torque_offset_nm
        torques = [0.0] * len(slots) if offsets is None or row is None else offsets[row].tolist()
        if self.corrector is not None:
            deltas, more = self.corrector.step(references, [slot.position_rad for slot in slots])
            references = [reference + delta for reference, delta in zip(references, deltas, strict=True)]
            torques = [torque + added for torque, added in zip(torques, more, strict=True)]
        for slot, reference, torque in zip(slots, references, torques, strict=True):
            slot.target = slot.axis.scaling.position_counts(reference)
            if torque or slot.torque_offset:
                limit = slot.axis.table.limits.torque_nm
                if not abs(torque) <= limit:
                    raise StopRun(f"axis {slot.axis.number}: a torque offset of {torque:.3g} N·m, the limit is {limit:g} N·m")
                slot.torque_offset = slot.axis.scaling.torque_per_mille(torque)

    def _discard_wild(self) -> None:
        """A position that cannot be is forgotten: the last one stays, as if no answer had come."""
        if self.plan.was_dropped:
            return
        for i, (guard, slot) in enumerate(zip(self._guards, self.plan.slots, strict=True)):
            if guard.accepts(slot.position_rad, slot.missing):
                self._trusted[i] = slot.position_counts
            else:
                slot.position_counts = self._trusted[i]

    def _cycle(self) -> None:
        """One cycle; a master that has come too late for too many in a row stops, and stays stopped."""
        self.session.cycle(self.plan)
        reason = self._own_fault()
        if reason is not None:
            raise StopRun(reason)

    def _own_fault(self) -> str | None:
        """The reason to stop that the master itself gives; before all others, since what a late one misses may be waiting."""
        overdue, limit = self.plan.beat.missing_now(), self.session.bench.bus.missing_limit
        if overdue <= limit:
            return None
        late = f"{overdue} cycles of {duration_text(self.period)} in a row were not sent, the limit is {limit}"
        return f"the master was late: {late}; see docs/realtime.md"

    @property
    def discarded(self) -> int:
        """Positions that could not be, and were forgotten."""
        return sum(guard.discarded for guard in self._guards)

    @property
    def _late(self) -> int:
        """Cycles that did not leave in time so far."""
        return self.plan.beat.dropped + self.plan.beat.late

    def _close_loops(self, references: list[float]) -> None:
        """Host-closed: the law on what has just been received; its torque leaves with the next cycle."""
        if self.bank is None:
            return
        slots = self.plan.slots
        torques = self.bank.step(references, [slot.position_rad for slot in slots])
        for slot, torque in zip(slots, torques, strict=True):
            slot.target = slot.axis.scaling.torque_per_mille(torque)

    def _keep(self, row: int, references: list[float]) -> None:
        plan = self.plan
        values = [self.motion.time_s[row], *plan.acceleration_m_s2, plan.missing_answers]
        bank = self.bank
        for i, slot in enumerate(plan.slots):
            frequency = slot.notch_hz if bank is None else bank.notch_hz[i]
            values += (references[i], slot.position_rad, slot.torque_nm, frequency)
        self._table[row] = values
        self.rows = row + 1

    def _check(self, references: list[float]) -> None:
        for guard, slot, reference in zip(self._guards, self.plan.slots, references, strict=True):
            if self.plan.was_dropped:
                guard.skip()
                continue
            reason = guard.check(slot.status_word, slot.position_rad, reference, slot.torque_nm, slot.missing)
            if reason is not None:
                raise StopRun(self._own_fault() or self.session.node_fault(self.axes) or self._with_bus_errors(reason))
        reason = self.session.node_fault(self.axes)
        if reason is not None:
            raise StopRun(self._own_fault() or reason)

    def _with_bus_errors(self, reason: str) -> str:
        """A reason, and what the controller has told of the bus meanwhile."""
        errors = self.session.network.bus_errors - self._bus_errors
        told = ", ".join(f"{words} ({number} times)" for words, number in errors.most_common(3))
        return f"{reason}; on the bus: {told}" if told else reason

    # -- the end -------------------------------------------------------------------------------------------------------

    def _disable(self, word: int) -> bool:
        """Command all drives out of operation; whether every one of them has confirmed it in time."""
        self.plan.beat.is_stopping = True
        ramp_s = max(axis.table.limits.speed_rps / axis.table.limits.quick_stop_rps_s for axis in self.axes)
        for _ in range(math.ceil((ramp_s + STOP_TIMEOUT_S) / self.period)):
            for slot in self.plan.slots:
                slot.control_word = word
                slot.torque_offset = 0
            self.session.cycle(self.plan)
            states = [state_of(slot.status_word) for slot in self.plan.slots]
            if all(state in DISABLED and not slot.missing for state, slot in zip(states, self.plan.slots, strict=True)):
                return True
            if all(slot.missing > self.session.bench.bus.missing_limit for slot in self.plan.slots):
                return False
        return False

    def _stop(self, reason: str) -> SafetyStopError:
        """Quick-stop all axes and wait until they are disabled; what goes wrong meanwhile does not end the stopping."""
        disabled = False
        for word in (QUICK_STOP, DISABLE_VOLTAGE):
            with contextlib.suppress(Exception):
                disabled = self._disable(word)
        if self.session.interrupt is not None and reason == self.session.interrupt:
            return InterruptedRunError(f"interrupted by {reason}", all_disabled=disabled)
        return SafetyStopError(reason, all_disabled=disabled)

    def recording(self) -> Recording:
        """The rows that were recorded."""
        table = self._table[: self.rows]
        columns = {"time_s": table[:, 0]}
        for i, axis in enumerate(self.axes):
            names = ("reference_rad", "position_rad", "torque_nm", "notch_hz")
            for j, name in enumerate(names if self.plan.tells_filter or self.bank is not None else names[:3]):
                columns[f"axis{axis.number}_{name}"] = table[:, 5 + 4 * i + j]
        for j, name in enumerate(("tip_x_m_s2", "tip_y_m_s2", "tip_z_m_s2", "missing")):
            columns[name] = table[:, 1 + j]
        return Recording(columns)


class StopRun(Exception):  # noqa: N818 - it ends a run, which is no error of the program
    """A reason to stop, on its way to the one place that stops."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)
