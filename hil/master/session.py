"""A session on the bus: check the nodes, and for each run set them up, enable, move, disable, and leave all as it was found."""

import math
import signal
import threading
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from types import FrameType
from typing import Literal, Self

from drive_profiles.cia301 import DataType, FunctionCode, NmtCommand, NmtState
from drive_profiles.cia402 import Mode, Object, State, state_of
from drive_profiles.profile import Profile
from hil.can.channel import Channel, ChannelError
from hil.can.frame import Frame
from hil.control.notch import FixedFilter
from hil.errors import HilError, InterruptedRunError, NodeError, NotPossibleError, UnsafeRequestError
from hil.master.axis import DriveAxis, check_identity
from hil.master.bench import Bench
from hil.master.correction import Corrector
from hil.master.cyclic import CyclicPlan
from hil.master.guard import heartbeat_fault
from hil.master.lateness import Timing
from hil.master.motion import Motion, RunResult
from hil.master.network import Network
from hil.master.request import MAX_SENSITIVITY, check_motion, host_loops
from hil.master.run import DISABLE_VOLTAGE, DISABLED, FAULT_RESET, Run
from hil.realtime import Clock, MonotonicClock, RealTime, quiet_garbage_collection
from hil.recording import BusLog
from hil.serial_accelerometer import SerialAccelerometer

__all__ = ["MAX_SENSITIVITY", "Compensation", "Loop", "Session"]

Loop = Literal["drive", "host"]
Compensation = Literal["none", "notch"]

TWICE_S = 0.05
"""How long a second answer to the last question is waited for."""
LISTEN_S = 0.1
"""How long the bus is listened to before the first frame is sent."""


def _accelerometer(bench: Bench) -> int | SerialAccelerometer:
    """The node of the accelerometer, or its reader, which `bring_up` opens."""
    table = bench.accelerometer
    if table.serial is not None:
        return SerialAccelerometer(table.serial.settings())
    if table.node_id is None:
        raise NotPossibleError("the bench has no accelerometer")
    return table.node_id


class Session:
    """The master on one bus. Use it as a context: on the way out the handlers of Ctrl-C are put back.

    Args:
        bench: The bench file.
        channel: The bus; the session does not close it.
        log: Where every frame goes.
        progress: Called with the share of the present motion that is done.
        clock: Where time is the wall clock's, this one; the monotonic clock unless it is given.

    Attributes:
        not_restored: What could not be put back, in words; empty when everything was.
    """

    def __init__(
        self,
        bench: Bench,
        channel: Channel,
        log: BusLog,
        progress: Callable[[float], None] = lambda share: None,
        clock: Clock | None = None,
    ) -> None:
        """Load the profiles; nothing is sent."""
        self.bench = bench
        self.log = log
        self.progress = progress
        self.clock = clock or MonotonicClock(bench.bus.real_time.spin_s)
        self.network = Network(channel, log, bench.bus.answer_timeout_s, bench.bus.sync_period_s, self.clock)
        self.axes = {number: DriveAxis(self.network, number, table) for number, table in sorted(bench.axis.items())}
        self._accelerometer = _accelerometer(bench)
        self._accelerometer_profile = Profile.load(bench.accelerometer.profile)
        if self._accelerometer_profile.kind != "accelerometer":
            raise NotPossibleError(f"profile {bench.accelerometer.profile} is no accelerometer")
        self.not_restored: list[str] = []
        self._interrupt: str | None = None
        self._handlers: dict[int, object] = {}
        self._last_heartbeat_s = -math.inf
        self._supervised_since_s = 0.0
        self._silent_until_s = -math.inf

    # -- context -------------------------------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        """Take Ctrl-C and SIGTERM: they end a motion by a ramp instead of ending the program."""
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                self._handlers[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        """Put the handlers back and write what is left of the log."""
        if not isinstance(self._accelerometer, int):
            self._accelerometer.close()
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
        if isinstance(self._accelerometer, int):
            check_identity(self.network, self._accelerometer, self._accelerometer_profile)
        else:
            self._accelerometer.open(is_lock_step=self.network.channel.is_lock_step)
        self.network.pump_until(lambda: False, 0.0 if self.network.channel.is_lock_step else TWICE_S)
        for node in self._nodes(list(self.axes.values())):
            if self.network.answers_twice(node):
                raise NodeError(node, "answers more often than it is asked", "do two nodes have this id?")

    def _reset_fault(self, axis: DriveAxis) -> None:
        """The rising edge of bit 7, by SDO; never further than switch on disabled."""
        read = self.network.read
        if state_of(read(axis.node, Object.STATUS_WORD, 0, DataType.UNSIGNED16)) is State.FAULT:
            for word in (DISABLE_VOLTAGE, FAULT_RESET, DISABLE_VOLTAGE):
                self.network.write_raw(axis.node, Object.CONTROL_WORD, 0, word.to_bytes(2, "little"), "control word")

    # -- a run ---------------------------------------------------------------------------------------------------------

    def adopt(self, bench: Bench) -> None:
        """Take gains, filters, limits and whatever else of the same axes from another bench file, for the runs to come.

        Raises:
            ValueError: It has other axes, other nodes or other drives.
        """
        for number, axis in self.axes.items():
            table = bench.axis.get(number)
            if table is None or (table.node_id, table.profile) != (axis.node, axis.table.profile):
                raise ValueError(f"axis {number} is not the same in bench {bench.name!r}")
        for number, axis in self.axes.items():
            axis.table = bench.axis[number]
        self.bench = bench

    def run(
        self,
        motion: Motion,
        compensation: Compensation,
        loop: Loop,
        corrector: Corrector | None = None,
        fixed: Mapping[int, FixedFilter] | None = None,
        *,
        shows_filter: bool = True,
    ) -> RunResult:
        """One run: set up, enable, settle, move and record, return, disable, restore.

        Args:
            motion: What is asked of the axes.
            compensation: Whether the drives' (or, host-closed, the host's) filters act.
            loop: Where the loop is closed.
            corrector: What is added to the set-points of a drive-closed run.
            fixed: Filters by axis in the place of the variable ones; host-closed only.
            shows_filter: Let the drives tell what their first filter does, in a TPDO of its own; without it the recording has no
                `notch_hz`.

        Raises:
            UnsafeRequestError: The motion would leave a limit; nothing has been sent.
            SafetyStopError: Only before anything is recorded; later the result says so in `stopped`.
            HilError: The set-up failed; what was changed has been put back as far as the bus allowed.
        """
        began = self.clock.now()
        period = motion.period_s
        self.network.period_s = period
        axes = [self.axes[number] for number in motion.axes]
        if compensation == "notch" and not any(axis.table.notch for axis in axes):
            names = " or ".join(f"axis.{axis.number}.notch" for axis in axes)
            raise NotPossibleError(f"a run with the notch needs one: the bench file has no {names}")
        for axis in axes:
            axis.identify()
        with_torque = motion.torque_offset_nm is not None or (corrector is not None and corrector.uses_torque)
        if loop == "host" and (corrector is not None or with_torque):
            raise NotPossibleError("set-points are corrected, and torques offset, where the drives close the loop (--loop drive)")
        if loop == "drive" and fixed:
            raise NotPossibleError("filters that do not follow the speed act where the host closes the loop (--loop host)")
        bank = host_loops(axes, period, with_notch=compensation == "notch", fixed=fixed or {}) if loop == "host" else None
        mode = Mode.CST if loop == "host" else Mode.CSP
        plan = CyclicPlan(
            self.network,
            axes,
            self._accelerometer,
            period,
            mode=mode,
            with_notch_state=shows_filter and compensation == "notch" and loop == "drive",
            with_torque_offset=with_torque,
            clock=self.clock,
            max_lateness_s=self.bench.bus.max_lateness_s,
        )
        starts = [0.0 if motion.starts_at_home else axis.position_rad() for axis in axes]
        check_motion(motion, axes, starts)
        self._check_lateness(period)
        run = Run(self, motion, axes, plan, bank, period, starts, corrector)
        control = period
        timing = None
        with ExitStack() as context:
            real_time = self._real_time(context)
            context.callback(self._tear_down, axes, plan)
            if loop == "drive":
                control = axes[0].control_period_s()
            self._set_up(axes, plan, compensation, loop, mode, period)
            if with_torque:
                for axis in axes:
                    axis.snapshot.write(Object.TORQUE_OFFSET, 0, DataType.INTEGER16, 0, "torque offset")
            overflows, errors = self._overflows(), Counter(self.network.bus_errors)
            stopped = run.perform()
            errors = self.network.bus_errors - errors
            if real_time is not None:
                timing = self._timing(plan, real_time, overflows)
        wall_s = self.clock.now() - began
        self.log.write()
        duration = float(motion.time_s[-1])
        return RunResult(
            run.recording(), run.rows, run.missed, run.sensor_missed, wall_s, duration, control, stopped, run.dropped, timing,
            dict(errors), run.discarded,
        )  # fmt: skip

    def _check_lateness(self, period: float) -> None:
        limit = self.bench.bus.max_lateness_s
        if limit is not None and limit > period and not self.network.channel.is_lock_step:
            raise UnsafeRequestError("bus.max_lateness_s", limit, period, "s", "a set-point is not sent in another's cycle")

    def _real_time(self, context: ExitStack) -> RealTime | None:
        """Enter real time where time is the wall clock's; in lock-step only the garbage collector rests."""
        if self.network.channel.is_lock_step:
            context.callback(quiet_garbage_collection())
            return None
        return context.enter_context(RealTime(self.bench.bus.real_time.settings()))

    def _overflows(self) -> int | None:
        return None if self.network.channel.is_lock_step else self.network.channel.overflows

    def _timing(self, plan: CyclicPlan, real_time: RealTime, overflows_before: int | None) -> Timing:
        channel, overflows = self.network.channel, self._overflows()
        lost = None if overflows is None or overflows_before is None else overflows - overflows_before
        return Timing.of(plan.beat, plan.missed_cycles, channel.address.bitrate, lost, real_time.measures)

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
        for node in self._nodes(axes):
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
        self._heartbeat()  # a drive watches from the first heartbeat on that it sees after it was told to
        for node in self._nodes(axes):
            self.network.nmt(NmtCommand.START, node)
        self.network.emergencies.clear()
        self.network.boots.clear()
        self._supervised_since_s = self.network.now()
        self._silent_until_s = -math.inf

    def _nodes(self, axes: list[DriveAxis]) -> list[int]:
        """The nodes that these axes need, and the accelerometer where it is one."""
        sensors = [self._accelerometer] if isinstance(self._accelerometer, int) else []
        return [*(axis.node for axis in axes), *sensors]

    def _tear_down(self, axes: list[DriveAxis], plan: CyclicPlan) -> None:
        """Put everything back; what a node refuses or the bus does not allow any more is noted in `not_restored`."""
        try:
            for node in self._nodes(axes):
                self.network.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, node)
            disabled = [axis for axis in axes if self._is_disabled(axis)]
            for axis in axes:
                if axis in disabled:
                    self.not_restored += axis.restore()  # its supervision ends first
                else:  # it keeps its limits, and our heartbeat, which it watches, has stopped
                    self.not_restored.append(f"node {axis.node}: not confirmed to be disabled; limits and supervision stay")
            self.not_restored += plan.restore(set(self._nodes(disabled)))
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
            if state_of(word) in DISABLED:
                return True
        return False

    # -- what every cycle needs ----------------------------------------------------------------------------------------

    def _heartbeat(self, plan: CyclicPlan | None = None) -> None:
        """Send the master's heartbeat when it is due, without a plan at once; by the loop itself, so that it stops with it."""
        now = self.network.now()
        if plan is None or now - self._last_heartbeat_s >= self.bench.bus.heartbeat_s - 1e-9:
            self._last_heartbeat_s = now
            master = self.bench.bus.master_node_id
            frame = Frame(FunctionCode.HEARTBEAT + master, bytes((NmtState.OPERATIONAL,)))
            self.network.send(frame)
            if plan is not None:
                plan.saw(frame)

    def cycle(self, plan: CyclicPlan) -> None:
        """One cycle with the master's heartbeat."""
        self._heartbeat(plan)
        plan.exchange()

    def node_fault(self, axes: list[DriveAxis]) -> str | None:
        """The reason to stop that the nodes themselves give: an emergency, a reset, a lost heartbeat."""
        network = self.network
        if not network.emergencies and not network.boots and network.now() <= self._silent_until_s:
            return self._interrupt
        while network.emergencies:
            emergency = network.emergencies.popleft()
            if emergency.code:
                return str(emergency)
        nodes = {axis.node for axis in axes}
        for node in network.boots & nodes:
            return f"node {node} has been reset"
        now, period, since = network.now(), self.bench.bus.heartbeat_s, self._supervised_since_s
        heard = {node: network.heartbeats[node][0] if node in network.heartbeats else None for node in nodes}
        for node, last in heard.items():
            fault = heartbeat_fault(node, last, now, since, period)
            if fault is not None:
                return fault
        # what has been heard by now keeps until then, and what will be heard longer
        self._silent_until_s = min((since if last is None else max(last, since)) for last in heard.values()) + 3.0 * period
        if self._interrupt is not None:
            return self._interrupt
        return None

    @property
    def interrupt(self) -> str | None:
        """The signal that asked for an end, or None."""
        return self._interrupt
