"""Session on the bus: checks of the nodes, and runs."""

import math
import signal
import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from types import FrameType
from typing import Self

from drive_profiles.standard.cia301 import DataType, NmtCommand
from drive_profiles.standard.cia402 import Object, State, state_of
from hil.bench.bench import Bench, Bus
from hil.bench.load_encoder import watched_axes, with_load_encoders
from hil.bench.tip import with_tip
from hil.can.channel import Channel
from hil.can.errors import ChannelError
from hil.can.local import LocalChannel
from hil.control.notch import FixedFilter
from hil.control.treatments import LoopName
from hil.errors import HilError, InterruptedRunError, NodeError, UnsafeRequestError
from hil.master.control_words import DISABLE_VOLTAGE, DISABLED, FAULT_RESET
from hil.master.cyclic import CyclicExchange
from hil.master.drive.axis import DriveAxis, ask_emulated, check_identity
from hil.master.drive.needs import MissingObjectsError, ProfileGapsError, encoder_objects, objects_needed, profile_gaps
from hil.master.lateness import WallClockTiming
from hil.master.motion import FilterUse, Motion, RunResult
from hil.master.network import Network
from hil.master.realtime import Clock, RealTime, no_garbage_collection
from hil.master.request import RunRequest, check_motion
from hil.master.run import Run
from hil.master.sensor import sensor_of
from hil.master.set_point_adder import SetPointAdder
from hil.master.supervision import Supervisor
from hil.master.whereabouts import LastPositions, Whereabouts
from hil.recording import BusLog


class NodeSetup:
    """Set-up of a run's nodes, and restoration of their former contents."""

    def __init__(self, network: Network, bus: Bus, axes: list[DriveAxis], exchange: CyclicExchange) -> None:
        self._network, self._bus, self._axes, self._exchange = network, bus, axes, exchange

    def check(self, *, with_notch: bool) -> None:
        """Refuse a run for which a profile or a drive lacks something.

        The error has all that is missing; nothing is written.

        Raises:
            ProfileGapsError: A profile lacks what the run needs.
            MissingObjectsError: A drive lacks objects that the run needs.
            NoAnswerError: A drive is silent.
        """
        exchange = self._exchange
        gaps = [
            gap
            for axis in self._axes
            for gap in profile_gaps(axis.number, axis.table, axis.profile, exchange.loop, with_notch=with_notch)
        ]
        if gaps:
            raise ProfileGapsError(gaps)
        missing = []
        for axis in self._axes:
            needs = objects_needed(
                axis.table, axis.profile, exchange.loop, with_notch_state=exchange.with_notch_state,
                with_torque_offset=exchange.with_torque_offset,
            )  # fmt: skip
            missing.append((axis.number, axis.node, axis.snapshot.look(needs)))
        for axis in exchange.watched:
            needs = encoder_objects(axis.table, axis.profile, with_notch_state=exchange.with_notch_state)
            missing.append((axis.number, axis.node, axis.snapshot.look(needs)))
        if any(absent for _, _, absent in missing):
            raise MissingObjectsError([each for each in missing if each[2]])

    def set_up(self, supervisor: Supervisor, *, with_notch: bool) -> None:
        """Write limits, gains, filters, PDOs and supervision; start the nodes.

        Args:
            supervisor: Supervisor that sends the first heartbeat and watches the drives from then on.

        Raises:
            HilError: A node refuses, is silent, or does not hold a written value.
        """
        exchange, nodes = self._exchange, self._nodes(self._axes)
        for node in nodes:
            self._network.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, node)
        for axis, slot in zip(self._axes, exchange.slots, strict=True):
            axis.write_limits()
            axis.write_gains(exchange.loop)
            axis.write_notches(tuple(table.notch() for table in axis.table.notch) if with_notch else ())
            axis.write_mode(slot.mode, exchange.period_s)
        exchange.configure()
        for axis in self._axes:
            axis.write_supervision(self._bus.master_node_id, self._bus.heartbeat_s)
        supervisor.send_heartbeat()  # a drive watches from the first heartbeat on that it sees after it was told to
        for node in nodes:
            self._network.nmt(NmtCommand.START, node)
        supervisor.begin(axis.node for axis in self._axes)
        if exchange.with_torque_offset:
            for axis in self._axes:
                axis.snapshot.write(Object.TORQUE_OFFSET, 0, DataType.INTEGER16, 0, "torque offset")

    def tear_down(self) -> list[str]:
        """Restore all nodes; return the failures in words."""
        not_restored: list[str] = []
        try:
            for node in self._nodes(self._axes):
                self._network.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, node)
            disabled = [axis for axis in self._axes if self._is_disabled(axis)]
            for axis in self._axes:
                if axis in disabled:
                    not_restored += axis.restore()  # its supervision ends first
                else:  # it keeps its limits, and our heartbeat, which it watches, has stopped
                    not_restored.append(
                        f"node {axis.node} has not confirmed that it is disabled, so it keeps the limits of the run"
                    )
            not_restored += self._exchange.restore(set(self._nodes(disabled)))
        except ChannelError as error:
            not_restored.append(f"the bus: {error}")
        return not_restored

    def _nodes(self, axes: list[DriveAxis]) -> list[int]:
        """Return the nodes of these axes, of watched ones, and the sensor."""
        return [*(axis.node for axis in (*axes, *self._exchange.watched)), *self._exchange.sensor.nodes]

    def _is_disabled(self, axis: DriveAxis) -> bool:
        """True if a drive confirms by SDO that it is disabled."""
        for attempt in range(2):
            try:
                if attempt:
                    self._network.write_raw(axis.node, Object.CONTROL_WORD, 0, DISABLE_VOLTAGE.to_bytes(2, "little"))
                word = self._network.read(axis.node, Object.STATUS_WORD, 0, DataType.UNSIGNED16, "status word")
            except HilError:
                return False
            if state_of(word) in DISABLED:
                return True
        return False


TWICE_S = 0.05
"""Time to listen for a second answer to the last question: two nodes may share a node ID."""
RESETS_READ, RESET_S = 20, 0.02
"""Times that a drive is asked whether a fault has gone, and the time between two."""
LISTEN_S = 0.1
"""Time to listen to the bus before the first frame is sent."""


class Session:
    """The master on one bus, as a context.

    At its end it restores the handlers of Ctrl-C.

    Args:
        channel: The bus; the session does not close it.
        clock: Clock of runs in wall-clock time; the monotonic clock unless it is given.

    Attributes:
        emulated: For each axis, and for an accelerometer on the bus, True if it is emulated; None if it did not answer.
        not_restored: Settings that could not be restored, in words; empty when all were.
    """

    def __init__(
        self,
        bench: Bench,
        channel: Channel,
        log: BusLog,
        progress: Callable[[float], None] = lambda fraction: None,
        clock: Clock | None = None,
    ) -> None:
        self.bench, self.log, self.progress = bench, log, progress
        self.clock = clock or Clock(bench.bus.real_time.spin_s)
        self.network = Network(channel, log, bench.bus.answer_timeout_s, bench.bus.sync_period_s, self.clock)
        self.axes = {number: DriveAxis(self.network, number, table) for number, table in sorted(bench.axis.items())}
        self.network.fault_texts = {axis.node: axis.profile.fault_texts for axis in self.axes.values()}
        self.sensor = sensor_of(bench.accelerometer, self.network, self.clock)
        self.supervisor = Supervisor(self.network, bench.bus)
        self.emulated: dict[str, bool | None] = {}
        self.not_restored: list[str] = []
        self._context = ExitStack()

    # -- context -------------------------------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        """Take Ctrl-C and SIGTERM, see `interruptible`; in lock-step, share a core with the emulator."""
        self._context.enter_context(self.interruptible())
        if isinstance(self.network.channel, LocalChannel):
            self._context.enter_context(self.network.channel.on_one_core())
        return self

    def __exit__(self, *_: object) -> None:
        """Close the session, and undo what entering it has changed."""
        self.close()
        self._context.close()

    def close(self) -> None:
        """Close the sensor, and write the rest of the log."""
        self.sensor.close()
        self.log.write()

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Context in which Ctrl-C and SIGTERM end a motion by a ramp."""
        handlers = {}
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                handlers[number] = signal.signal(number, self._on_signal)
        try:
            yield
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        self.interrupt(signal.Signals(number).name)

    def interrupt(self, name: str) -> None:
        """End a motion by a ramp, and refuse further motions."""
        self.supervisor.interrupted_by = name

    def check_interrupt(self) -> None:
        """Raise `InterruptedRunError` after Ctrl-C without a motion."""
        if self.supervisor.interrupted_by is not None:
            raise InterruptedRunError(f"interrupted by {self.supervisor.interrupted_by} {LastPositions.when()}")

    # -- bring-up ------------------------------------------------------------------------------------------------------

    def bring_up(self, *, reset_faults: bool = False, moving: Collection[int] | None = None, in_fault: int | None = None) -> None:
        """Find every node, check identity and standstill; write and enable nothing.

        Args:
            moving: Axes that will move; missing objects of the others do not matter. None: all axes.
            in_fault: Number of an axis whose drive may be in fault; None for none.

        Raises:
            ProfileGapsError: Profiles lack the units of drives; nothing has been sent.
            MissingObjectsError: Drives lack objects that every run needs.
            NodeError: A node is silent, another device, already enabled, moving, or in fault.
        """
        used = [axis for number, axis in self.axes.items() if moving is None or number in moving]
        if gaps := [gap for axis in used for gap in axis.scale_gaps()]:
            raise ProfileGapsError(gaps)
        if self.network.pump_until(lambda: self.network.foreign_sync, LISTEN_S):
            raise NodeError(self.bench.bus.master_node_id, "another node sends SYNC on this bus", "is another master running?")
        if self.network.channel.is_lock_step:
            self.network.sync()  # from here on the world's clock is ours, so that equal seeds give equal frames
        self._identify(used, reset_faults=reset_faults, in_fault=in_fault)
        self.sensor.open()
        for node in self.sensor.nodes:
            self.emulated["accelerometer"] = ask_emulated(self.network, node)
        begun = [(axis, self.clock.now(), axis.position_rad()) for axis in used]
        found = (Whereabouts(axis.number, position_rad / math.tau, None) for axis, _, position_rad in begun)
        LastPositions.note(tuple(map(str, found)), have_moved=LastPositions.have_moved)
        self.network.pump_until(lambda: False, 0.0 if self.network.channel.is_lock_step else TWICE_S)
        for node in (*(axis.node for axis in self.axes.values()), *self.sensor.nodes):
            if self.network.answers_twice(node):
                raise NodeError(node, "it answers more than once per request", "do two nodes have this node-ID?")
        if not self.network.channel.is_lock_step:
            for axis, begun_s, begun_rad in begun:
                axis.check_standing(begun_rad, self.clock.now() - begun_s)

    def _identify(self, used: list[DriveAxis], *, reset_faults: bool, in_fault: int | None) -> None:
        """Check every drive; one error lists all objects that moving ones lack."""
        missing = []
        for axis in self.axes.values():
            self.check_interrupt()
            if reset_faults:
                check_identity(self.network, axis.node, axis.profile, axis.table.serial_number)
                self.reset_fault(axis)
            try:
                if axis in used:
                    axis.identify(may_be_in_fault=axis.number == in_fault)
                else:
                    axis.identify_bystander()
            except MissingObjectsError as error:
                missing += error.missing
            self.emulated[f"axis {axis.number}"] = ask_emulated(self.network, axis.node)
        if missing:
            raise MissingObjectsError(missing)

    def reset_fault(self, axis: DriveAxis) -> None:
        """Reset a fault by a rising edge of bit 7, by SDO.

        The drive remains in switch on disabled.

        Raises:
            NodeError: The drive is still in fault.
        """
        read = self.network.read
        if state_of(read(axis.node, Object.STATUS_WORD, 0, DataType.UNSIGNED16)) is not State.FAULT:
            return
        for word in (DISABLE_VOLTAGE, FAULT_RESET, DISABLE_VOLTAGE):
            self.network.write_raw(axis.node, Object.CONTROL_WORD, 0, word.to_bytes(2, "little"), "control word")
        for _ in range(RESETS_READ):
            if (fault := axis.fault()) is None:
                return
            self.network.pump_until(lambda: False, 0.0 if self.network.channel.is_lock_step else RESET_S)
        remedy = "remove its cause, or switch the drive's supply off and on"
        raise NodeError(axis.node, f"axis {axis.number} is still {fault} after a reset", remedy)

    # -- a run ---------------------------------------------------------------------------------------------------------

    def adopt(self, bench: Bench) -> None:
        """Take the tables of the same axes from another bench file.

        Raises:
            ValueError: The bench file has other axes, nodes or drives.
        """
        for number, axis in self.axes.items():
            table = bench.axis.get(number)
            if table is None or (table.node_id, table.profile) != (axis.node, axis.table.profile):
                raise ValueError(
                    f"axis {number} of bench {bench.name!r} is missing, or has another node or profile than that of this session"
                )
        for number, axis in self.axes.items():
            axis.table = bench.axis[number]
        self.bench = bench

    def run(
        self,
        motion: Motion,
        filters: FilterUse,
        loop: LoopName,
        adder: SetPointAdder | None = None,
        fixed: Mapping[int, FixedFilter] | None = None,
        *,
        shows_filter: bool = True,
    ) -> RunResult:
        """Make one run, with set-up before and restoration after it.

        Args:
            filters: Filters that act: the drives' or, host-closed, the host's; or none.
            adder: Additions to the set-points of a drive-closed run.
            fixed: Fixed filters by axis, instead of the variable ones; host-closed only.
            shows_filter: Let the drives send the state of their first filter in a second TPDO; without it the recording has no
                `notch_hz`.

        Raises:
            UnsafeRequestError: The motion would leave a limit; nothing has been sent.
            SafetyStopError: The run was stopped before anything was recorded; a later stop is in `stopped` of the result.
            HilError: The set-up failed; changed settings have been restored as far as the bus allowed.
        """
        began_s = self.clock.now()
        request = RunRequest(motion, filters, loop, adder, fixed or {}, shows_filter)
        self.network.period_s = motion.period_s
        axes = [self.axes[number] for number in motion.axes]
        run, standing_rad = self._planned(request, axes), self._standing_rad(motion)
        control_period_s = axes[0].control_period_s() if loop == "drive" else motion.period_s
        timing = None
        with ExitStack() as context:
            real_time = self.prepare(context, axes, run.exchange, with_notch=request.filters_in_drives)
            acted = {axis.number: request.filters_of(axis) for axis in axes}
            overflows, errors = self._overflows(), Counter(self.network.bus_errors)
            self.log.write()  # with the positions before the motion, also if this process is killed in it
            stopped = run.perform()
            errors = self.network.bus_errors - errors
            if real_time is not None:
                timing = self._timing(run.exchange, real_time, overflows)
        wall_s = self.clock.now() - began_s
        try:
            self.log.write()
        except OSError as error:
            if stopped is not None:  # whether all drives are disabled is more than a file
                raise stopped from error
            raise
        return RunResult(
            recording=with_tip(self.bench, with_load_encoders(self.bench, run.recording(), standing_rad), standing_rad),
            cycles=run.table.rows,
            missed_cycles=run.missed,
            sensor_missed=run.sensor_missed,
            wall_s=wall_s,
            motion_s=float(motion.time_s[-1]),
            control_period_s=control_period_s,
            stopped=stopped,
            dropped_cycles=run.dropped,
            timing=timing,
            bus_errors=dict(errors),
            discarded=run.discarded,
            filters=acted,
        )

    def _standing_rad(self, motion: Motion) -> dict[int, float]:
        """Read the motor angles of axes that do not move."""
        if self.bench.arm is None:
            return {}
        return {number: axis.position_rad() for number, axis in self.axes.items() if number not in motion.axes}

    def _planned(self, request: RunRequest, axes: list[DriveAxis]) -> Run:
        """Return a request's checked run; nodes were read, nothing was written."""
        request.check(axes)
        for axis in axes:
            axis.identify()
        motion, bank = request.motion, request.host_loops(axes)
        exchange = self.exchange(
            axes,
            motion.period_s,
            request.loop,
            with_notch_state=request.shows_filter and request.filters_in_drives,
            with_torque_offset=request.uses_torque_offset,
            watched=[self.axes[number] for number in watched_axes(self.bench, motion.axes)],
        )
        starts = [0.0 if motion.starts_at_home else axis.position_rad() for axis in axes]
        check_motion(motion, axes, starts)
        return Run(
            motion, axes, exchange, self.bench, self.supervisor, starts,
            bank=bank, adder=request.adder, progress=self.progress,
        )  # fmt: skip

    # -- the parts of a run --------------------------------------------------------------------------------------------

    def exchange(
        self,
        axes: list[DriveAxis],
        period_s: float,
        loop: LoopName,
        *,
        with_notch_state: bool = False,
        with_torque_offset: bool = False,
        watched: Sequence[DriveAxis] = (),
    ) -> CyclicExchange:
        """Prepare the exchange with these axes and the sensor; nothing is sent.

        Args:
            watched: Axes that do not take part, but whose second encoders do.
        """
        return CyclicExchange(
            self.network,
            axes,
            self.sensor,
            period_s,
            loop=loop,
            with_notch_state=with_notch_state,
            with_torque_offset=with_torque_offset,
            watched=watched,
            clock=self.clock,
            max_lateness_s=self.bench.bus.max_lateness_s,
        )

    def prepare(
        self, context: ExitStack, axes: list[DriveAxis], exchange: CyclicExchange, *, with_notch: bool = False
    ) -> RealTime | None:
        """Enter real time and set the nodes up.

        Args:
            context: Context that restores all of it; failures are noted in `not_restored`.

        Returns:
            The real-time context; None in lock-step, where time waits for the master.

        Raises:
            HilError: A node refuses or is silent, or a set-point could be sent in a later cycle than its own.
        """
        limit = self.bench.bus.max_lateness_s
        if limit is not None and limit > exchange.period_s and not self.network.channel.is_lock_step:
            why = "a set-point is sent only in its own cycle"
            raise UnsafeRequestError("bus.max_lateness_s", limit, exchange.period_s, "s", why)
        real_time = self._real_time(context)
        self.supervisor.bus = self.bench.bus
        setup = NodeSetup(self.network, self.bench.bus, axes, exchange)
        setup.check(with_notch=with_notch)
        context.callback(lambda: self.not_restored.extend(setup.tear_down()))
        setup.set_up(self.supervisor, with_notch=with_notch)
        return real_time

    def _real_time(self, context: ExitStack) -> RealTime | None:
        """Enter real time for a run in wall-clock time."""
        if self.network.channel.is_lock_step:
            context.callback(no_garbage_collection())
            return None
        return context.enter_context(RealTime(self.bench.bus.real_time))

    def _overflows(self) -> int | None:
        return None if self.network.channel.is_lock_step else self.network.channel.overflows

    def _timing(self, exchange: CyclicExchange, real_time: RealTime, overflows_before: int | None) -> WallClockTiming:
        channel, overflows = self.network.channel, self._overflows()
        lost = None if overflows is None or overflows_before is None else overflows - overflows_before
        return WallClockTiming.of(exchange.schedule, exchange.missed_cycles, channel.address.bitrate, lost, real_time.measures)
