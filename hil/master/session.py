"""A session on the bus: check the nodes, and for each run set them up, enable, move, disable, and leave all as it was found."""

import contextlib
import gc
import math
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from drive_profiles.cia301 import DataType, FunctionCode, NmtCommand, NmtState
from drive_profiles.cia402 import Mode, Object, State, control_word_towards, state_of
from drive_profiles.profile import Profile
from drive_profiles.units import interpolation_period
from hil.can.channel import Channel, ChannelError
from hil.can.frame import Frame
from hil.control.servo import Servo, ServoConfig
from hil.control.trajectory import Smooth, sample_times
from hil.design.frequency import Loop as LoopModel
from hil.design.frequency import margins
from hil.errors import HilError, InterruptedRunError, NodeError, NotPossibleError, SafetyStopError, UnsafeRequestError
from hil.master.axis import DriveAxis, check_identity
from hil.master.bench import Bench
from hil.master.cyclic import CyclicPlan
from hil.master.guard import AxisGuard, heartbeat_fault
from hil.master.network import Network
from hil.recording import BusLog, Recording

Real = NDArray[np.float64]
Loop = Literal["drive", "host"]
Compensation = Literal["none", "notch"]

LISTEN_S = 0.1
"""How long the bus is listened to before the first frame is sent."""
ENABLE_TIMEOUT_S = 2.0
MAX_SENSITIVITY = 4.0
"""M_s up to which a host-closed loop is run: a quarter of the way from the edge is left."""
STOP_TIMEOUT_S = 2.0
"""How long beyond its ramp a drive may take to say that it is disabled."""
APPROACH_RAMP_S = 0.5
REST_S = 0.1
"""How long the axes stand before their brakes close."""
SHUTDOWN, SWITCH_ON, QUICK_STOP, DISABLE_VOLTAGE, FAULT_RESET = 0x0006, 0x0007, 0x0002, 0x0000, 0x0080

_DISABLED = {
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
    State.FAULT,
    State.NOT_READY_TO_SWITCH_ON,
}


@dataclass(frozen=True)
class Motion:
    """What is asked of the robot in one run.

    Attributes:
        axes: Axis numbers, in the order of the columns.
        time_s: From 0, one row per SYNC; shape (n,).
        motor_angle_rad: Relative to where each axis starts; shape (n, axes).
        starts_at_home: The motion is one of the tool, so it begins where all motor angles are zero; else where the axis stands.
    """

    axes: tuple[int, ...]
    time_s: Real
    motor_angle_rad: Real
    starts_at_home: bool


@dataclass(frozen=True)
class RunResult:
    """What a run left.

    Attributes:
        recording: What the master received; shorter than the motion where it was stopped.
        cycles: SYNCs of the motion.
        missed_cycles: Cycles of the motion in which an answer did not come.
        sensor_missed: Cycles of the motion without the accelerometer.
        wall_s: What the whole run took, set-up, settling, return and restoration included.
        motion_s: How long the motion lasts in the bench's time.
        control_period_s: Sampling time of the loop.
        stopped: Why it was stopped, or None.
    """

    recording: Recording
    cycles: int
    missed_cycles: int
    sensor_missed: int
    wall_s: float
    motion_s: float
    control_period_s: float
    stopped: SafetyStopError | None


class Session:
    """The master on one bus. Use it as a context: on the way out the handlers of Ctrl-C are put back.

    Args:
        bench: The bench file.
        channel: The bus; the session does not close it.
        log: Where every frame goes.
        progress: Called with the share of the present motion that is done.

    Attributes:
        not_restored: What could not be put back, in words; empty when everything was.
    """

    def __init__(
        self, bench: Bench, channel: Channel, log: BusLog, progress: Callable[[float], None] = lambda share: None
    ) -> None:
        """Load the profiles; nothing is sent."""
        self.bench = bench
        self.log = log
        self.progress = progress
        self.network = Network(channel, log, bench.bus.answer_timeout_s, bench.bus.sync_period_s)
        self.axes = {number: DriveAxis(self.network, number, table) for number, table in sorted(bench.axis.items())}
        self._accelerometer_profile = Profile.load(bench.accelerometer.profile)
        if self._accelerometer_profile.kind != "accelerometer":
            raise NotPossibleError(f"profile {bench.accelerometer.profile} is no accelerometer")
        self.not_restored: list[str] = []
        self._interrupt: str | None = None
        self._handlers: dict[int, object] = {}
        self._last_heartbeat_s = -math.inf
        self._supervised_since_s = 0.0

    # -- context -------------------------------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        """Take Ctrl-C and SIGTERM: they end a motion by a ramp instead of ending the program."""
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                self._handlers[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        """Put the handlers back and write what is left of the log."""
        for number, handler in self._handlers.items():
            signal.signal(number, handler)  # type: ignore[arg-type]
        self.log.write()

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        self._interrupt = signal.Signals(number).name

    def check_interrupt(self) -> None:
        """Raise `InterruptedRunError` where Ctrl-C came while nothing moved."""
        if self._interrupt is not None:
            raise InterruptedRunError(f"interrupted by {self._interrupt}")

    # -- bring-up ------------------------------------------------------------------------------------------------------

    def bring_up(self, *, reset_faults: bool = False) -> None:
        """Find every node, check that it is the right one and stands still. Nothing is written, nothing enabled.

        Raises:
            NodeError: A node is silent, another device, already enabled, moving, or in fault.
        """
        if self.network.pump_until(lambda: self.network.foreign_sync, LISTEN_S):
            raise NodeError(self.bench.bus.master_node_id, "somebody else sends SYNC on this bus", "is another master running?")
        if self.network.channel.is_lock_step:
            self.network.sync()  # from here on the world's clock is ours, so that equal seeds give equal frames
        for axis in self.axes.values():
            self.check_interrupt()
            if reset_faults:
                check_identity(self.network, axis.node, axis.profile, axis.table.serial_number)
                self._reset_fault(axis)
            axis.identify()
        check_identity(self.network, self.bench.accelerometer.node_id, self._accelerometer_profile)

    def _reset_fault(self, axis: DriveAxis) -> None:
        """The rising edge of bit 7, by SDO; never further than switch on disabled."""
        read = self.network.read
        if state_of(read(axis.node, Object.STATUS_WORD, 0, DataType.UNSIGNED16)) is State.FAULT:
            for word in (DISABLE_VOLTAGE, FAULT_RESET, DISABLE_VOLTAGE):
                self.network.write_raw(axis.node, Object.CONTROL_WORD, 0, word.to_bytes(2, "little"), "control word")

    # -- a run ---------------------------------------------------------------------------------------------------------

    def run(self, motion: Motion, compensation: Compensation, loop: Loop) -> RunResult:
        """One run: set up, enable, settle, move and record, return, disable, restore.

        Raises:
            UnsafeRequestError: The motion would leave a limit; nothing has been sent.
            SafetyStopError: Only before anything is recorded; later the result says so in `stopped`.
            HilError: The set-up failed; what was changed has been put back as far as the bus allowed.
        """
        began = time.monotonic()
        period = self._period(motion)
        self.network.period_s = period
        axes = [self.axes[number] for number in motion.axes]
        if compensation == "notch" and not any(axis.table.notch for axis in axes):
            names = " or ".join(f"axis.{axis.number}.notch" for axis in axes)
            raise NotPossibleError(f"a run with the notch needs one: the bench file has no {names}")
        for axis in axes:
            axis.identify()
        servos = self._servos(axes, compensation, loop, period)
        mode = Mode.CST if loop == "host" else Mode.CSP
        plan = CyclicPlan(
            self.network,
            axes,
            self.bench.accelerometer.node_id,
            period,
            mode=mode,
            with_notch_state=compensation == "notch" and loop == "drive",
        )
        starts = [0.0 if motion.starts_at_home else axis.position_rad() for axis in axes]
        self._check_motion(motion, axes, starts)
        run = _Run(self, motion, axes, plan, servos, period, starts)
        control = period
        gc.collect()
        gc.disable()  # a collection in the middle of a motion is a late set-point
        try:
            if loop == "drive":
                control = axes[0].control_period_s()
            self._set_up(axes, plan, compensation, loop, mode, period)
            stopped = run.perform()
        finally:
            gc.enable()
            self._tear_down(axes, plan)
        wall_s = time.monotonic() - began
        self.log.write()
        duration = float(motion.time_s[-1])
        return RunResult(run.recording(), run.rows, run.missed, run.sensor_missed, wall_s, duration, control, stopped)

    def _period(self, motion: Motion) -> float:
        return float(round((motion.time_s[1] - motion.time_s[0]) * 1e9) / 1e9)

    def _servos(self, axes: list[DriveAxis], compensation: Compensation, loop: Loop, period: float) -> list[Servo]:
        """The host's own loops, where it closes them; refused where the model says that they are unstable."""
        if loop == "drive":
            return []
        servos = []
        for axis in axes:
            table = axis.table
            notches = tuple(notch.notch() for notch in table.notch) if compensation == "notch" else ()
            model = table.loop(period, 1, with_notch=compensation == "notch")
            if model is not None:
                speeds = [speed for n in notches for speed in np.linspace(n.start_rps, n.end_rps, 5).tolist()]
                self._check_host_loop(axis, model, [0.0, *speeds])
            config = ServoConfig(table.control.cascade(), table.limits.torque_nm, notches)
            servos.append(Servo(config, period))
        return servos

    @staticmethod
    def _check_host_loop(axis: DriveAxis, model: LoopModel, speeds_rps: list[float]) -> None:
        """Refuse a loop that the model shows unstable, or at the edge of it."""
        where = f"axis {axis.number} closed over the bus at {1e3 * model.period_s:g} ms"
        remedy = "shorten bus.host_sync_period_s, lower the gains, or close the loop in the drive (--loop drive)"
        for speed in speeds_rps:
            found = margins(model, speed)
            if not found.stable:
                raise UnsafeRequestError(f"{where} is unstable: its largest pole", found.pole_radius, 1.0, "", remedy)
            if found.sensitivity_peak > MAX_SENSITIVITY:
                peak = found.sensitivity_peak
                raise UnsafeRequestError(f"{where} is at the edge of stability: M_s", peak, MAX_SENSITIVITY, "", remedy)

    def _check_motion(self, motion: Motion, axes: list[DriveAxis], starts: list[float]) -> None:
        """The whole motion against the limits, before anything is enabled."""
        period, turn = self._period(motion), 2.0 * math.pi
        interpolation_period(period)
        for axis in axes:
            sync = axis.profile.sync
            if not sync.min_period_s <= period <= sync.max_period_s:
                limit = sync.min_period_s if period < sync.min_period_s else sync.max_period_s
                raise UnsafeRequestError(f"the SYNC period of axis {axis.number}", period, limit, "s", "see its profile")
        for column, axis in enumerate(axes):
            limits, name = axis.table.limits, f"axis {axis.number}"
            angle = (motion.motor_angle_rad[:, column] + starts[column]) / turn
            speed = float(np.max(np.abs(np.diff(angle)))) / period
            if speed > limits.speed_rps:
                raise UnsafeRequestError(f"the speed of {name}", speed, limits.speed_rps, "rps", "slow the motion down")
            if float(angle.max()) > limits.position_max_rev:
                raise UnsafeRequestError(f"the position of {name}", float(angle.max()), limits.position_max_rev, "rev")
            if float(angle.min()) < limits.position_min_rev:
                raise UnsafeRequestError(f"the position of {name}", float(angle.min()), limits.position_min_rev, "rev")

    def _set_up(
        self,
        axes: list[DriveAxis],
        plan: CyclicPlan,
        compensation: Compensation,
        loop: Loop,
        mode: Mode,
        period: float,
    ) -> None:
        """Write limits, gains, filters, PDOs and supervision, each read back; then start the nodes."""
        sensor = self.bench.accelerometer.node_id
        for node in (*(axis.node for axis in axes), sensor):
            self.network.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, node)
        for axis in axes:
            axis.write_limits()
            axis.write_gains()
            inside = compensation == "notch" and loop == "drive"
            axis.write_notches(tuple(table.notch() for table in axis.table.notch) if inside else ())
            axis.write_mode(mode, period)
        plan.configure()
        for axis in axes:
            axis.write_supervision(self.bench.bus.master_node_id, self.bench.bus.heartbeat_s)
        self._heartbeat(force=True)  # a drive watches from the first heartbeat on that it sees after it was told to
        for node in (*(axis.node for axis in axes), sensor):
            self.network.nmt(NmtCommand.START, node)
        self.network.emergencies.clear()
        self.network.boots.clear()
        self._supervised_since_s = self.network.now()

    def _tear_down(self, axes: list[DriveAxis], plan: CyclicPlan) -> None:
        """Put everything back; what a node refuses or the bus does not allow any more is noted in `not_restored`."""
        try:
            sensor = self.bench.accelerometer.node_id
            for node in (*(axis.node for axis in axes), sensor):
                self.network.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, node)
            disabled = [axis for axis in axes if self._is_disabled(axis)]
            for axis in axes:
                if axis in disabled:
                    self.not_restored += axis.restore()  # its supervision ends first
                else:  # it keeps its limits, and our heartbeat, which it watches, has stopped
                    self.not_restored.append(f"node {axis.node}: not confirmed to be disabled; limits and supervision stay")
            self.not_restored += plan.restore({sensor, *(axis.node for axis in disabled)})
        except ChannelError as error:
            self.not_restored.append(f"the bus: {error}")

    def _is_disabled(self, axis: DriveAxis) -> bool:
        """Whether a drive says by SDO that it is out of operation; it is told once more where it does not."""
        for attempt in range(2):
            try:
                if attempt:
                    self.network.write_raw(axis.node, Object.CONTROL_WORD, 0, DISABLE_VOLTAGE.to_bytes(2, "little"))
                word = self.network.read(axis.node, Object.STATUS_WORD, 0, DataType.UNSIGNED16, "status word")
            except HilError:
                return False
            if state_of(word) in _DISABLED:
                return True
        return False

    # -- what every cycle needs ----------------------------------------------------------------------------------------

    def _heartbeat(self, *, force: bool = False) -> None:
        """Send the master's heartbeat when it is due; by the loop itself, so that it stops when the loop does."""
        now = self.network.now()
        if force or now - self._last_heartbeat_s >= self.bench.bus.heartbeat_s - 1e-9:
            self._last_heartbeat_s = now
            master = self.bench.bus.master_node_id
            self.network.send(Frame(FunctionCode.HEARTBEAT + master, bytes((NmtState.OPERATIONAL,))))

    def cycle(self, plan: CyclicPlan) -> None:
        """One cycle with the master's heartbeat."""
        self._heartbeat()
        plan.exchange()

    def node_fault(self, axes: list[DriveAxis]) -> str | None:
        """The reason to stop that the nodes themselves give: an emergency, a reset, a lost heartbeat."""
        network = self.network
        while network.emergencies:
            emergency = network.emergencies.popleft()
            if emergency.code:
                return str(emergency)
        nodes = {axis.node for axis in axes}
        for node in network.boots & nodes:
            return f"node {node} has been reset"
        now, period = network.now(), self.bench.bus.heartbeat_s
        for node in nodes:
            last = network.heartbeats.get(node)
            fault = heartbeat_fault(node, None if last is None else last[0], now, self._supervised_since_s, period)
            if fault is not None:
                return fault
        if self._interrupt is not None:
            return self._interrupt
        return None

    @property
    def interrupt(self) -> str | None:
        """The signal that asked for an end, or None."""
        return self._interrupt


class _Run:
    """One run while it lasts: the cycles from enabling to disabled."""

    def __init__(
        self,
        session: Session,
        motion: Motion,
        axes: list[DriveAxis],
        plan: CyclicPlan,
        servos: list[Servo],
        period: float,
        starts: list[float],
    ) -> None:
        self.session, self.motion, self.axes, self.plan, self.servos = session, motion, axes, plan, servos
        self.period, self.starts = period, starts
        self.rows = 0
        self.missed = 0
        self.sensor_missed = 0
        self._guards = [AxisGuard(axis.number, axis.table, session.bench.bus, period) for axis in axes]
        self._holding: dict[int, float] = {}
        self._table = np.zeros((len(motion.time_s), 5 + 4 * len(axes)))

    # -- the sequence --------------------------------------------------------------------------------------------------

    def perform(self) -> SafetyStopError | None:
        """Enable, settle, move, return and disable; why it was stopped, or None."""
        try:
            self._enable()
            here = [slot.axis.scaling.position_rad(slot.position_counts) for slot in self.plan.slots]
            self._move(here, self.starts)
            self._hold(self.starts, self.session.bench.settle_s)
            self._record()
            end = [start + float(angle) for start, angle in zip(self.starts, self.motion.motor_angle_rad[-1], strict=True)]
            self._move(end, self.starts)
            self._hold(self.starts, REST_S)
            if not self._disable(SHUTDOWN):
                return self._stop("not every drive has confirmed that it is disabled")
        except _StopRun as stop:
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
                    slot.target = 0 if self.servos else slot.position_counts
            self.session.cycle(self.plan)
            self._take_over()
            fault = self.session.node_fault(self.axes)
            if fault is not None:
                raise _StopRun(fault)
            for slot in self.plan.slots:
                if slot.missing > self.session.bench.bus.missing_limit:
                    raise _StopRun(f"axis {slot.axis.number} does not answer")
            if all(state_of(slot.status_word) is goal for slot in self.plan.slots):
                return
        shown = (
            f"axis {slot.axis.number}: {getattr(state_of(slot.status_word), 'value', 'unknown')}" for slot in self.plan.slots
        )
        raise _StopRun(f"not all drives are in {goal.value!r} within {ENABLE_TIMEOUT_S:g} s ({', '.join(shown)})")

    @staticmethod
    def _word_towards(goal: State, state: State | None) -> int:
        """The next control word on the way to a goal, and the one that keeps it."""
        if state is State.SWITCHED_ON and goal is State.SWITCHED_ON:
            return SWITCH_ON
        word = None if state is None else control_word_towards(state)
        return DISABLE_VOLTAGE if word is None else word

    def _take_over(self) -> None:
        """Host-closed, while drives are being enabled: hold each axis that is, where it was found."""
        for i, (servo, slot) in enumerate(zip(self.servos, self.plan.slots, strict=False)):
            if state_of(slot.status_word) is not State.OPERATION_ENABLED:
                continue
            angle = slot.axis.scaling.position_rad(slot.position_counts)
            if i not in self._holding:
                self._holding[i] = angle
                servo.start(angle)
            slot.target = slot.axis.scaling.torque_per_mille(servo.step(self._holding[i], angle))

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
        before, sensor_before = self.plan.missed_cycles, self.plan.accelerometer_missed
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
            self.session.progress(1.0)

    # -- one cycle -----------------------------------------------------------------------------------------------------

    def _step(self, references: list[float], row: int | None = None) -> None:
        """Set-points out, answers in, limits checked; recorded where a row is given."""
        plan = self.plan
        if not self.servos:
            for slot, reference in zip(plan.slots, references, strict=True):
                slot.target = slot.axis.scaling.position_counts(reference)
        self.session.cycle(plan)
        self._close_loops(references)
        if row is not None:
            self._keep(row, references)
        self._check(references)

    def _close_loops(self, references: list[float]) -> None:
        """Host-closed: the law on what has just been received; its torque leaves with the next cycle."""
        for servo, slot, reference in zip(self.servos, self.plan.slots, references, strict=False):
            scaling = slot.axis.scaling
            torque = servo.step(reference, scaling.position_rad(slot.position_counts))
            slot.target = scaling.torque_per_mille(torque)

    def _keep(self, row: int, references: list[float]) -> None:
        plan = self.plan
        values = [float(self.motion.time_s[row]), *plan.acceleration_m_s2, 0.0]
        for i, slot in enumerate(plan.slots):
            scaling = slot.axis.scaling
            frequency = slot.notch_hz
            if self.servos:
                state = self.servos[i].notch_state[0, 0]
                frequency = float(state["frequency_hz"]) if state["active"] else 0.0
            position, torque = scaling.position_rad(slot.position_counts), scaling.torque_nm(slot.torque_per_mille)
            values += [references[i], position, torque, frequency]
        values[4] = float(plan.missing_answers)
        self._table[row] = values
        self.rows = row + 1

    def _check(self, references: list[float]) -> None:
        for guard, slot, reference in zip(self._guards, self.plan.slots, references, strict=True):
            scaling = slot.axis.scaling
            position, torque = scaling.position_rad(slot.position_counts), scaling.torque_nm(slot.torque_per_mille)
            reason = guard.check(slot.status_word, position, reference, torque, slot.missing)
            if reason is not None:
                raise _StopRun(self.session.node_fault(self.axes) or reason)
        reason = self.session.node_fault(self.axes)
        if reason is not None:
            raise _StopRun(reason)

    # -- the end -------------------------------------------------------------------------------------------------------

    def _disable(self, word: int) -> bool:
        """Command all drives out of operation; whether every one of them has confirmed it in time."""
        ramp_s = max(axis.table.limits.speed_rps / axis.table.limits.quick_stop_rps_s for axis in self.axes)
        for _ in range(math.ceil((ramp_s + STOP_TIMEOUT_S) / self.period)):
            for slot in self.plan.slots:
                slot.control_word = word
            self.session.cycle(self.plan)
            states = [state_of(slot.status_word) for slot in self.plan.slots]
            if all(state in _DISABLED and not slot.missing for state, slot in zip(states, self.plan.slots, strict=True)):
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
            for j, name in enumerate(("reference_rad", "position_rad", "torque_nm", "notch_hz")):
                columns[f"axis{axis.number}_{name}"] = table[:, 5 + 4 * i + j]
        for j, name in enumerate(("tip_x_m_s2", "tip_y_m_s2", "tip_z_m_s2", "missing")):
            columns[name] = table[:, 1 + j]
        return Recording(columns)


class _StopRun(Exception):  # noqa: N818 - it ends a run, which is no error of the program
    """A reason to stop, on its way to the one place that stops."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)
