"""A session on the bus: check the nodes, and for each run set them up, enable, move, disable, and leave all as it was found."""

import gc
import math
import signal
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import Literal, Self

import numpy as np

from drive_profiles.cia301 import DataType, FunctionCode, NmtCommand, NmtState
from drive_profiles.cia402 import Mode, Object, State, state_of
from drive_profiles.profile import Profile
from drive_profiles.units import interpolation_period
from hil.can.channel import Channel, ChannelError
from hil.can.frame import Frame
from hil.control.servo import Servo, ServoConfig
from hil.design.frequency import Loop as LoopModel
from hil.design.frequency import margins
from hil.errors import HilError, InterruptedRunError, NodeError, NotPossibleError, UnsafeRequestError
from hil.master.axis import DriveAxis, check_identity
from hil.master.bench import Bench
from hil.master.cyclic import CyclicPlan
from hil.master.guard import heartbeat_fault
from hil.master.network import Network
from hil.master.run import DISABLE_VOLTAGE, DISABLED, FAULT_RESET, Motion, Run, RunResult
from hil.recording import BusLog

Loop = Literal["drive", "host"]
Compensation = Literal["none", "notch"]

LISTEN_S = 0.1
"""How long the bus is listened to before the first frame is sent."""
MAX_SENSITIVITY = 4.0
"""M_s up to which a host-closed loop is run: a quarter of the way from the edge is left."""


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
        run = Run(self, motion, axes, plan, servos, period, starts)
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
            too_short = sync.min_period_s is not None and period < sync.min_period_s
            too_long = sync.max_period_s is not None and period > sync.max_period_s
            if too_short or too_long:
                limit = (sync.min_period_s if too_short else sync.max_period_s) or 0.0
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
            if state_of(word) in DISABLED:
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
