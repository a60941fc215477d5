"""One run, from the first control word to the last."""

import contextlib
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from drive_profiles.standard.cia402 import State, control_word_towards, state_of
from hil.bench.bench import Bench
from hil.can.errors import ChannelError
from hil.control.arrays import Real
from hil.control.servo_bank import ServoBank
from hil.control.trajectory import Smooth, sample_times
from hil.core.library import CORE
from hil.counting import times
from hil.errors import HilError, InterruptedRunError, SafetyStopError
from hil.master.control_words import DISABLE_VOLTAGE, DISABLED, QUICK_STOP, SHUTDOWN, SWITCH_ON
from hil.master.cyclic import CyclicExchange
from hil.master.drive.axis import DriveAxis
from hil.master.guard import GUARD, AxisGuard
from hil.master.lateness import duration_text
from hil.master.motion import Motion
from hil.master.set_point_adder import CompiledAdder, Sensed, SensingAdder, SetPointAdder, SteppedAdder
from hil.master.supervision import Supervisor
from hil.master.whereabouts import LastPositions, Whereabouts, stop_text
from hil.recording import Recording

ENABLE_TIMEOUT_S = 2.0
STOP_TIMEOUT_S = 2.0
"""Time beyond its ramp that a drive may take to say that it is disabled."""
APPROACH_RAMP_S = 0.5
REST_S = 0.1
"""Standstill of the axes before their brakes close."""
ADDED_UP_TO = 0.99
"""Fraction of an axis' speed limit up to which set-points with additions go: a drive rounds to its counts.

The next cycles make up for the rest. A SYNC that waits for another frame delays the measurement of an angle by some tenths of a
millisecond, and the addition then has a step.
"""

_COMMON: int = CORE.call.COMMON_COLUMNS
_PER_AXIS: int = CORE.call.AXIS_COLUMNS
_AXIS_COLUMNS = ("reference_rad", "position_rad", "torque_nm", "notch_hz")
_TIP_COLUMNS = ("tip_x_m_s2", "tip_y_m_s2", "tip_z_m_s2", "missing")
_end_cycle = CORE.call.end_cycle
_NOT_ENDED: int = CORE.call.NOT_ENDED
PROGRESS_ROWS = 256
"""Rows of the motion between two reports of its progress."""


class RunTable:
    """Recorded rows of a motion, one per SYNC.

    Time, tip, missing answers, four values of each axis, and the angle of each joint's encoder: see `run.h`.

    Args:
        time_s: Time of each row of the whole motion; shape (n,).
        encoders: Number of second encoders.

    Attributes:
        rows: Number of rows so far.
        room: Number of rows of the whole motion.
        values: All rows; the core fills them.
    """

    def __init__(self, time_s: Real, axes: int, encoders: int = 0) -> None:
        self.rows, self.room = 0, len(time_s)
        # written once, so that its pages are there before the motion needs them
        self.values = np.full((self.room, _COMMON + _PER_AXIS * axes + encoders), 0.0)
        self.values[:, 0] = time_s

    def recording(self, axes: Sequence[int], *, with_notch: bool, encoders: Sequence[int] = ()) -> Recording:
        """The rows that are kept, as columns.

        Args:
            with_notch: True if the drives send notch frequencies; else these have no columns.
            encoders: Numbers of the axes whose second encoders were kept.
        """
        table = self.values[: self.rows]
        columns, behind = {"time_s": table[:, 0]}, _COMMON + _PER_AXIS * len(axes)
        loads = {number: going_on(table[:, behind + i]) for i, number in enumerate(encoders)}
        for i, number in enumerate(axes):
            for j, name in enumerate(_AXIS_COLUMNS):
                if with_notch or name != "notch_hz":
                    columns[f"axis{number}_{name}"] = table[:, _COMMON + _PER_AXIS * i + j]
            if number in loads:
                columns[f"axis{number}_load_rad"] = loads.pop(number)
        columns |= {f"axis{number}_load_rad": angles for number, angles in loads.items()}
        for j, name in enumerate(_TIP_COLUMNS):
            columns[name] = table[:, 1 + j]
        return Recording(columns)


def going_on(angles_rad: Real) -> Real:
    """Unwrap the angles of a single-turn encoder; NaN remains; shape (n,)."""
    result, known = np.array(angles_rad), np.isfinite(angles_rad)
    result[known] = np.unwrap(result[known])
    return result


class Run:
    """One run while it lasts: the cycles from enabling to disabled.

    Attributes:
        axes: The axes, in the order of the motion's columns.
        exchange: PDOs of the axes and the sensor.
        bench: Bench file, for waiting times and counts of missing answers.
        supervisor: Supervisor that sends the heartbeat, and knows the reasons to stop that no PDO contains.
        bank: The loops that the host closes; None if the drives close them.
        adder: Additions to the set-points of a drive-closed run.
        dropped: Cycles of the motion whose set-points were not sent in time.
    """

    def __init__(
        self,
        motion: Motion,
        axes: list[DriveAxis],
        exchange: CyclicExchange,
        bench: Bench,
        supervisor: Supervisor,
        starts: list[float],
        *,
        bank: ServoBank | None = None,
        adder: SetPointAdder | None = None,
        progress: Callable[[float], None] = lambda fraction: None,
    ) -> None:
        """Prepare the run; nothing is sent. See the attributes."""
        self.motion, self.axes, self.exchange, self.bench, self.supervisor = motion, axes, exchange, bench, supervisor
        self.starts, self.bank, self.adder, self.progress = starts, bank, adder, progress
        self.period_s = exchange.period_s
        self.missed = 0
        self.sensor_missed = 0
        self.dropped = 0
        self.table = RunTable(motion.time_s, len(axes), len(exchange.encoders))
        self._guard_data = CORE.pointer(np.zeros(len(axes), GUARD), "guard")
        self._guards = [
            AxisGuard(axis.number, axis.table, bench.bus.missing_limit, self.period_s, self._guard_data + row)
            for row, axis in enumerate(axes)
        ]
        self._lay_out()
        self._holding: dict[int, float] = {}
        self._began_rad: list[float] = []
        self._listener, self._sensor_missed = adder if isinstance(adder, SensingAdder) else None, 0
        self._stepped = adder if isinstance(adder, SteppedAdder) else None
        self._bus_errors = Counter(supervisor.network.bus_errors)

    def _lay_out(self) -> None:
        """Fill the record `data` of `run.h`, and keep the arrays to which it points."""
        call, count, motion = CORE.call, len(self.axes), self.motion
        records = np.zeros(count, CORE.dtype("axis_run"))
        records["torque_limit_nm"] = [axis.table.limits.torque_nm for axis in self.axes]
        records["step_rad"] = [ADDED_UP_TO * math.tau * axis.table.limits.speed_rps * self.period_s for axis in self.axes]
        self._records = CORE.pointer(records, "axis_run")
        self._values = np.zeros((call.VALUE_ROWS, count))
        rows = [CORE.pointer(each) for each in self._values]
        self._references, self._additions, self._offsets = rows[: call.POSITION_ROW]
        self._all = slice(0, count)
        self._motion_offsets = None
        if motion.torque_offset_nm is not None:
            offsets = np.broadcast_to(motion.torque_offset_nm, (len(motion.time_s), count))
            self._motion_offsets = CORE.pointer(np.array(offsets, np.float64, order="C"))
        self._rows = CORE.pointer(self.table.values)
        data = self.data = CORE.new("run")
        data.exchange, data.guards, data.axes, data.values = self.exchange.data, self._guard_data, self._records, rows[0]
        if self.bank is not None:
            data.laws, data.loop, data.period_s = self.bank.laws, self.bank.values, self.bank.period_s
        data.rows, data.columns = self._rows, self.table.values.shape[1]
        self.exchange.run = data
        self.exchange.stretch.has_additions = self.adder is not None
        self.exchange.stretch.torque_offset_nm = CORE.NULL
        if isinstance(self.adder, CompiledAdder):
            data.cancellation = self.adder.data

    # -- the sequence --------------------------------------------------------------------------------------------------

    def perform(self) -> SafetyStopError | None:
        """Enable, settle, move, return and disable.

        Return the reason of a stop, or None.
        """
        try:
            self.enable()
            here = [slot.position_rad for slot in self.exchange.slots]
            first, end = self._at(0), self._at(-1)
            self._move(here, first)
            self._hold(first, self.bench.settle_s)
            self._record()
            last = list(self.starts) if self.motion.returns else end
            self._move(end, last)
            self._hold(last, REST_S)
            if not self.disable(SHUTDOWN):
                return self.stop("not every drive has confirmed that it is disabled")
        except RunStopError as stop:
            return self.stop(stop.reason)
        except ChannelError as error:
            where = stop_text([Whereabouts(axis.number, None, None) for axis in self.axes])
            return SafetyStopError(str(error), all_disabled=False, where=where)
        except BaseException:
            self.stop("an error in the master")  # whatever it is: the axes come to rest before anyone hears of it
            raise
        return None

    def _at(self, row: int) -> list[float]:
        """Motor angles in a row of the motion."""
        return [start + float(angle) for start, angle in zip(self.starts, self.motion.motor_angle_rad[row], strict=True)]

    def enable(self) -> None:
        """Switch all drives on together, then enable their operation together.

        Each has its own control words, and no drive is enabled before all can be. Host-closed, the host closes a loop
        in the cycle in which its drive shows that the brake is open, and holds the arm in its place. A drive in
        interpolated position mode follows set-points only after that.
        """
        for goal in (State.SWITCHED_ON, State.OPERATION_ENABLED):
            self._reach(goal)
        for slot in self.exchange.slots:
            slot.control_word |= slot.mode.enabling
        self._began_rad = [slot.position_rad for slot in self.exchange.slots]

    def _reach(self, goal: State) -> None:
        for _ in range(math.ceil(ENABLE_TIMEOUT_S / self.period_s)):
            for slot in self.exchange.slots:
                state = state_of(slot.status_word) if self.exchange.cycles else None
                slot.control_word = self._word_towards(goal, state)
                if state is not State.OPERATION_ENABLED:
                    slot.target = slot.position_counts if self.bank is None else 0
            if self.supervisor.cycle(self.exchange) is None:
                self._check_master()
            CORE.call.accept_positions(self.data, self.exchange.was_dropped)
            self._take_over()
            fault = self.supervisor.fault()
            if fault is not None:
                raise RunStopError(self._own_fault() or fault)
            for slot in self.exchange.slots:
                if slot.missing >= self.bench.bus.missing_limit:
                    raise RunStopError(f"axis {slot.axis.number} does not answer")
            if all(state_of(slot.status_word) is goal for slot in self.exchange.slots):
                return
        shown = (
            f"axis {slot.axis.number}: {getattr(state_of(slot.status_word), 'value', 'unknown')}" for slot in self.exchange.slots
        )
        raise RunStopError(f"not all drives are in {goal.value!r} within {ENABLE_TIMEOUT_S:g} s ({', '.join(shown)})")

    @staticmethod
    def _word_towards(goal: State, state: State | None) -> int:
        """Return the next control word towards a goal, or to keep it."""
        if state is State.SWITCHED_ON and goal is State.SWITCHED_ON:
            return SWITCH_ON
        word = None if state is None else control_word_towards(state)
        return DISABLE_VOLTAGE if word is None else word

    def _take_over(self) -> None:
        """Hold each enabled axis at its start, host-closed."""
        if self.bank is None:
            return
        for i, slot in enumerate(self.exchange.slots):
            if state_of(slot.status_word) is not State.OPERATION_ENABLED:
                continue
            angle = slot.position_rad
            if i not in self._holding:
                self._holding[i] = angle
                self.bank.start(i, angle)
            slot.target = slot.axis.scaling.torque_per_mille(self.bank.step_one(i, self._holding[i], angle))

    def _move(self, start: list[float], end: list[float]) -> None:
        """Move smoothly between two points, without a recording."""
        distance = max((abs(b - a) for a, b in zip(start, end, strict=True)), default=0.0) / (2.0 * math.pi)
        if distance < 1e-3:
            return
        stated = [axis.table.limits.acceleration_rps_s for axis in self.axes]
        least = min((each for each in stated if each is not None), default=None)
        smooth = Smooth.way(distance, self.bench.approach_rps, APPROACH_RAMP_S, least)
        fraction = np.asarray(smooth.position(sample_times(smooth.duration_s, self.period_s)))
        self.follow(np.array(start) + fraction[:, np.newaxis] * (np.array(end) - np.array(start)))

    def _hold(self, where: list[float], duration_s: float) -> None:
        self.follow(np.tile(where, (round(duration_s / self.period_s), 1)))

    def _record(self) -> None:
        """Run and record the motion, one row per SYNC."""
        before, sensor_before, late_before = self.exchange.missed_cycles, self.exchange.sensor_missed, self._late
        angles = self.motion.motor_angle_rad + np.asarray(self.starts)
        count, done = len(angles), 0
        try:
            for row in range(0, count, PROGRESS_ROWS):
                self.follow(angles[done : row + 1], done)
                done = row + 1
                self.progress(row / count)
            self.follow(angles[done:], done)
        finally:
            self.missed = self.exchange.missed_cycles - before
            self.sensor_missed = self.exchange.sensor_missed - sensor_before
            self.dropped = self._late - late_before
            self.progress(self.table.rows / count)

    # -- one cycle -----------------------------------------------------------------------------------------------------

    def follow(self, references: Real, row: int | None = None) -> None:
        """Run cycles: set-points out, answers in, limits checked.

        They are recorded from a row on, if one is given. Host-closed, the laws run on the values just received, and their
        torques are sent with the next cycle.

        Args:
            references: Motor angles, a row for each cycle; shape (cycles, axes).
            row: Row of the motion for the first.

        Raises:
            RunStopError: A node, an axis, the user or the master gives a reason to stop.
            ValueError: A row is not one of all axes.
            IndexError: The motion does not have these rows.
        """
        rows = np.ascontiguousarray(references, np.float64)
        count, axes = len(rows), len(self.axes)
        if rows.shape != (count, axes):
            raise ValueError(f"set-points of shape {rows.shape}; expected a row of {axes} for each cycle")
        if row is not None and not 0 <= row <= self.table.room - count:
            raise IndexError(f"rows {row} to {row + count - 1} of a motion of {self.table.room} rows")
        angles = CORE.pointer(rows) if count else CORE.NULL
        at = 0
        while at < count:
            place = None if row is None else row + at
            if self._stepped is not None:
                self._add(self._stepped, rows[at].tolist(), place)
            at += self._go(angles + at * axes if at else angles, count - at, place)

    def _go(self, angles: Any, count: int, row: int | None) -> int:
        """Run at least one of some cycles; return their number."""
        stretch = self.exchange.stretch
        stretch.reference, stretch.count = angles, count if self._stepped is None else 1
        if self._motion_offsets is not None:
            stretch.torque_offset_nm = CORE.NULL if row is None else self._motion_offsets + row * len(self.axes)
        stretch.row = place = -1 if row is None else row
        stretch.done = 0
        try:
            found = self.supervisor.cycle(self.exchange)
        finally:
            done: int = stretch.done
            if stretch.row != _NOT_ENDED:
                stretch.reference, stretch.count, stretch.row = CORE.NULL, 1, _NOT_ENDED
            if row is not None:
                self.table.rows = row + done
        if found is None:
            self._check_master()
            found = _end_cycle(self.data, place if row is None else place + done - 1, self.exchange.was_dropped)
        if found:
            raise RunStopError(self._own_fault() or self.supervisor.fault() or self._with_bus_errors(self._words(found)))
        reason = self.supervisor.fault()
        if reason is not None:
            raise RunStopError(self._own_fault() or reason)
        return done

    def _add(self, adder: SteppedAdder, references: list[float], row: int | None) -> None:
        """Ask for the additions to the next cycle's set-points."""
        self._tell(row)
        positions, felt = self._values[CORE.call.POSITION_ROW :].tolist()
        self._additions[self._all], self._offsets[self._all] = adder.step(references, positions, felt)

    def _words(self, found: int) -> str:
        """Return what the core has found in a cycle, in words.

        Raises:
            OutOfRangeError: A set-point does not fit its object.
        """
        data, row = self.data, int(self.data.refused)
        slot, guard = self.exchange.slots[row], self._guards[row]
        if found == CORE.call.POSITION_REFUSED:
            slot.axis.scaling.position_counts(data.value)
        if found == CORE.call.TORQUE_REFUSED:
            slot.axis.scaling.torque_per_mille(data.value)
        if found == CORE.call.OFFSET_BEYOND_LIMIT:
            limit = slot.axis.table.limits.torque_nm
            return f"axis {slot.axis.number}: a torque offset of {data.value:.3g} N·m; the limit is {limit:g} N·m"
        return guard.words(found, slot.status_word, slot.position_rad, self._references[row], slot.torque_nm, slot.missing)

    def _tell(self, row: int | None) -> None:
        """Pass the last cycle's measurements to a sensing adder."""
        if self._listener is None:
            return
        missed, exchange = self._sensor_missed, self.exchange
        self._sensor_missed = exchange.sensor_missed
        has_measured = exchange.cycles > 0 and exchange.sensor_missed == missed
        has_turned = exchange.cycles > 0 and exchange.encoders and all(each.has_answered for each in exchange.encoders)
        load_rad = tuple(each.angle_rad for each in exchange.encoders) if has_turned else None
        self._listener.sense(Sensed(exchange.tip_m_s2 if has_measured else None, row, load_rad))

    def _check_master(self) -> None:
        """Stop after too many late cycles in a row."""
        reason = self._own_fault()
        if reason is not None:
            raise RunStopError(reason)

    def _own_fault(self) -> str | None:
        """Return the reason to stop that lies in the master."""
        overdue, limit = self.exchange.schedule.missing_now(), self.bench.bus.missing_limit
        if overdue <= limit:
            return None
        late = f"{overdue} cycles of {duration_text(self.period_s)} in a row were not sent; the limit is {limit}"
        return f"the master was late: {late}; see docs/realtime.md"

    @property
    def discarded(self) -> int:
        """Number of impossible positions, which were ignored."""
        return sum(guard.discarded for guard in self._guards)

    @property
    def _late(self) -> int:
        """Number of cycles so far that did not leave in time."""
        return self.exchange.schedule.dropped + self.exchange.schedule.late

    def _with_bus_errors(self, reason: str) -> str:
        """Return a reason with the errors on the bus since the start."""
        errors = self.supervisor.network.bus_errors - self._bus_errors
        reports = ", ".join(f"{words} ({times(number)})" for words, number in errors.most_common(3))
        return f"{reason}; on the bus: {reports}" if reports else reason

    # -- the end -------------------------------------------------------------------------------------------------------

    def disable(self, word: int) -> bool:
        """Command all drives to disable; True if all confirm in time."""
        self.exchange.schedule.is_stopping = True
        are_disabled = False
        try:
            are_disabled = self._disabled_by(word)
        finally:
            found = tuple(str(each) for each in self._whereabouts())
            LastPositions.note(found, have_moved=True, are_disabled=are_disabled)
        return are_disabled

    def _disabled_by(self, word: int) -> bool:
        ramp_s = max(axis.table.limits.speed_rps / axis.table.limits.quick_stop_rps_s for axis in self.axes)
        # drives whose answers are lost may still be slowing down; in lock-step nothing moves without answers
        patience = 0 if self.exchange.network.channel.is_lock_step else math.ceil(ramp_s / self.period_s)
        for cycle in range(math.ceil((ramp_s + STOP_TIMEOUT_S) / self.period_s)):
            for slot in self.exchange.slots:
                slot.control_word = word
                slot.torque_offset = 0
            self.supervisor.cycle(self.exchange)
            states = [state_of(slot.status_word) for slot in self.exchange.slots]
            if all(state in DISABLED and not slot.missing for state, slot in zip(states, self.exchange.slots, strict=True)):
                return True
            if cycle >= patience and all(slot.missing > self.bench.bus.missing_limit for slot in self.exchange.slots):
                return False
        return False

    def stop(self, reason: str) -> SafetyStopError:
        """Quick-stop all axes, and wait until they are disabled."""
        disabled = False
        for word in (QUICK_STOP, DISABLE_VOLTAGE):
            with contextlib.suppress(Exception):
                disabled = self.disable(word)
        if reason == self.supervisor.interrupted_by:
            return InterruptedRunError(f"interrupted by {reason}", all_disabled=disabled, where=self._where())
        return SafetyStopError(reason, all_disabled=disabled, where=self._where())

    def _whereabouts(self) -> list[Whereabouts]:
        """Return the positions of the axes as their last answers show them."""
        found = []
        for i, slot in enumerate(self.exchange.slots):
            stands_rev = None if slot.missing or not self.exchange.cycles else slot.position_rad / math.tau
            began_rev = self._began_rad[i] / math.tau if self._began_rad else None
            found.append(Whereabouts(slot.axis.number, stands_rev, began_rev))
        return found

    def _where(self) -> str:
        """Return the positions of the axes in words, with the remedy."""
        found = self._whereabouts()
        for i, slot in enumerate(self.exchange.slots):
            if found[i].stands_rev is None:
                with contextlib.suppress(HilError, ChannelError):
                    found[i] = replace(found[i], stands_rev=slot.axis.position_rad() / math.tau)
        return stop_text(found)

    def recording(self) -> Recording:
        """The recorded rows; the filters' frequencies only if drives send them."""
        with_notch = self.exchange.tells_filter or self.bank is not None
        encoders = [encoder.axis.number for encoder in self.exchange.encoders]
        return self.table.recording([axis.number for axis in self.axes], with_notch=with_notch, encoders=encoders)


class RunStopError(Exception):
    """A reason to stop the run; `perform` catches it."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)
