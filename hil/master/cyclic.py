"""The exchange of each cycle: set-points out, SYNC, answers in.

It uses pre-packed structs.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from hil.can.clock import MAX_RECORDS
from hil.can.frame import Frame
from hil.master.drive import mapping
from hil.master.drive.axis import DriveAxis
from hil.master.drive.mapping import CyclicMode
from hil.master.drive.pdo import PdoSet
from hil.master.joint_encoder import JointEncoder
from hil.master.lateness import CycleSchedule
from hil.master.motion import LoopName
from hil.master.network import SYNC, Network
from hil.master.realtime import Clock, MonotonicClock
from hil.master.sensor import FrameHandler, JointsOnly, TipAccelerometer
from hil.master.whole_cycle import WholeCycle

POSITION_COMMAND = struct.Struct("<Hi")
TORQUE_COMMAND = struct.Struct("<Hh")
OFFSET_COMMAND = struct.Struct("<Hih")
_FEEDBACK = struct.Struct("<Hih")
_NOTCH = struct.Struct("<Bf")

MAX_LATE_FRAMES = 1024


@dataclass
class Slot:
    """Process data of one axis; the newest value wins.

    Attributes:
        axis: The axis.
        control_word: Control word for the next cycle.
        target: Set-point for the next cycle: counts (CSP) or per mille of the rated torque (CST).
        torque_offset: Torque offset for the next cycle, if the exchange has it: per mille of the rated torque.
        status_word: Last status word.
        position_counts: Last position, in counts.
        torque_per_mille: Last torque, in per mille of the rated torque.
        notch_hz: Zero frequency of the first filter, 0 while it is out.
        missing: Cycles in a row without an answer.
        mode: Mode in which the drive takes its set-points.
        feedback_id: Identifier of the TPDO that brings status word, position and torque.
        notch_id: Identifier of the TPDO that brings the filter's state; 0 if the drive does not send it.
    """

    axis: DriveAxis
    control_word: int = 0
    target: int = 0
    torque_offset: int = 0
    status_word: int = 0
    position_counts: int = 0
    torque_per_mille: int = 0
    notch_hz: float = 0.0
    missing: int = 0
    mode: CyclicMode = mapping.CSP
    feedback_id: int = 0
    notch_id: int = 0
    _command_id: int = 0
    _packer: struct.Struct = field(default=POSITION_COMMAND)

    def __post_init__(self) -> None:
        """Compute the scales of position and torque once."""
        self._rad_per_count = self.axis.scaling.position_rad(1)
        self._nm_per_mille = self.axis.scaling.torque_nm(1)

    def send_command_as(self, can_id: int, packer: struct.Struct) -> None:
        """Set identifier and content of the RPDO: `POSITION_COMMAND`, `TORQUE_COMMAND` or `OFFSET_COMMAND`."""
        self._command_id, self._packer = can_id, packer

    def command(self) -> Frame:
        """The RPDO of this cycle."""
        packer = self._packer
        if packer is OFFSET_COMMAND:
            return Frame(self._command_id, packer.pack(self.control_word, self.target, self.torque_offset))
        return Frame(self._command_id, packer.pack(self.control_word, self.target))

    def command_into(self, buffer: bytearray, place: int) -> None:
        """Write the data of this cycle's RPDO to a place."""
        packer = self._packer
        if packer is OFFSET_COMMAND:
            packer.pack_into(buffer, place, self.control_word, self.target, self.torque_offset)
        else:
            packer.pack_into(buffer, place, self.control_word, self.target)

    def take_feedback(self, data: bytes) -> bool:
        """Unpack the first TPDO; False if its length is wrong."""
        if len(data) != _FEEDBACK.size:
            return False
        self.status_word, self.position_counts, self.torque_per_mille = _FEEDBACK.unpack(data)
        return True

    def take_notch(self, data: bytes) -> bool:
        """Unpack the second TPDO; False if its length is wrong."""
        if len(data) != _NOTCH.size:
            return False
        active, frequency = _NOTCH.unpack(data)
        self.notch_hz = frequency if active and math.isfinite(frequency) else 0.0
        return True

    @property
    def position_rad(self) -> float:
        """Last motor angle."""
        return self.position_counts * self._rad_per_count

    @property
    def torque_nm(self) -> float:
        """Last torque."""
        return self.torque_per_mille * self._nm_per_mille


class CyclicExchange:
    """Exchange of a run with its nodes: all PDOs of a cycle.

    Attributes:
        slots: Process data, one slot per axis that takes part, in their order.
        encoders: Second encoders of the axes that take part, in their order, then those of watched axes.
        watched: Axes that do not move, and whose second encoders are recorded.
        sensor: The accelerometer.
        with_torque_offset: True if a torque offset is sent beside each position set-point.
        with_notch_state: True if the drives send the state of their first filter.
        missing_answers: Answers that did not come in the last cycle.
        sensor_missed: Cycles without a measurement of the tip, by the accelerometer or by all encoders of the joints.
        missed_cycles: Cycles in which an answer did not come in time.
        cycles: Cycles since the start.
        was_dropped: True if the last cycle was too late to be sent; the slots then hold the data of the one before.
        schedule: Deadlines and statistics of the run's cycles; a lock-step bus has none, so nothing is counted there.
    """

    def __init__(
        self,
        network: Network,
        axes: list[DriveAxis],
        sensor: TipAccelerometer,
        period_s: float,
        *,
        loop: LoopName,
        with_notch_state: bool,
        with_torque_offset: bool = False,
        watched: Sequence[DriveAxis] = (),
        clock: Clock | None = None,
        max_lateness_s: float | None = None,
    ) -> None:
        """Prepare a run; `configure` writes it to the nodes.

        Args:
            network: The bus.
            axes: The axes that take part.
            sensor: The accelerometer.
            period_s: SYNC period.
            loop: Place of the loop: set-points are positions if drives close it, torques if the host does.
            with_notch_state: Let the drives send the state of their first filter in a second TPDO.
            with_torque_offset: Send a torque offset beside each position set-point.
            watched: Axes that do not take part, but whose second encoders do: braked, they swing on their gears.
            clock: The master's clock; the monotonic clock unless it is given.
            max_lateness_s: Largest lateness at which a cycle is still sent in wall-clock time; half the period unless given.
        """
        self.network = network
        self.period_s = period_s
        self.loop = loop
        self.slots = [Slot(axis, mode=mapping.mode_of(loop, axis.profile) or mapping.CSP) for axis in axes]
        self.watched = tuple(watched)
        self.encoders = [JointEncoder(axis) for axis in (*axes, *watched) if axis.table.load_encoder is not None]
        self.sensor = sensor
        self.with_torque_offset = with_torque_offset and loop == "drive"
        self.missing_answers = 0
        self.sensor_missed = 0
        self.missed_cycles = 0
        self.cycles = 0
        self.was_dropped = False
        self._clock = clock or MonotonicClock()
        limit_s = 0.5 * period_s if max_lateness_s is None else max_lateness_s
        self.schedule = CycleSchedule(self._clock, period_s, limit_s)
        self.with_notch_state = with_notch_state
        self._sync_s = 0.0
        self._sets: list[PdoSet] = []
        self._expected: frozenset[int] = frozenset()
        self._order: list[int] = []
        self._may_be_behind = False
        self._handlers: Mapping[int, FrameHandler] = {}
        self._whole: WholeCycle | None = None
        self._has_all = False

    @property
    def tells_filter(self) -> bool:
        """True if a drive sends the state of its first filter."""
        return any(slot.notch_id for slot in self.slots)

    def configure(self) -> None:
        """Map the PDOs of the nodes, which are pre-operational."""
        packer = POSITION_COMMAND if self.loop == "drive" else TORQUE_COMMAND
        handlers: dict[int, FrameHandler] = {}
        for slot in self.slots:
            pdos = PdoSet(self.network, slot.axis.node)
            self._sets.append(pdos)
            command = mapping.command(slot.mode, with_torque_offset=self.with_torque_offset)
            slot.send_command_as(pdos.rpdo(1, command), OFFSET_COMMAND if self.with_torque_offset else packer)
            slot.feedback_id = pdos.tpdo(1, mapping.feedback(slot.axis.profile))
            handlers[slot.feedback_id] = slot.take_feedback
            state = mapping.notch_state(slot.axis.profile) if self.with_notch_state else ()
            if state:
                slot.notch_id = pdos.tpdo(2, state)
                handlers[slot.notch_id] = slot.take_notch
            encoder = next((each for each in self.encoders if each.axis is slot.axis), None)
            if encoder is not None:
                encoder.configure(pdos, with_notch_state=self.with_notch_state)
            elif not state:
                pdos.silence(0x1801)
        for encoder in (each for each in self.encoders if each.axis in self.watched):
            pdos = PdoSet(self.network, encoder.axis.node)
            self._sets.append(pdos)
            for communication in (0x1800, 0x1801):
                pdos.silence(communication)
            encoder.configure(pdos, with_notch_state=self.with_notch_state)
        handlers |= {encoder.can_id: encoder.take for encoder in self.encoders}
        if isinstance(self.sensor, JointsOnly):
            self.sensor.can_ids = frozenset(encoder.can_id for encoder in self.encoders)
        self.expect({**handlers, **self.sensor.configure()})

    def expect(self, handlers: Mapping[int, FrameHandler]) -> None:
        """Await these identifiers with every SYNC, and register their handlers."""
        self._handlers = handlers
        self._expected, self._order = frozenset(handlers), sorted(handlers)
        self._whole = WholeCycle(self.slots, handlers, _FEEDBACK, SYNC) if len(self.slots) < MAX_RECORDS else None

    def restore(self, nodes: set[int]) -> list[str]:
        """Restore the former PDOs of the sensor and of these nodes.

        Return the refusals in words.
        """
        refused = self.sensor.restore()
        while self._sets:
            pdos = self._sets.pop()
            if pdos.node in nodes:
                refused += pdos.restore()
        return refused

    def exchange(self) -> None:
        """Run one cycle: RPDOs, SYNC, then answers until their time is over.

        In lock-step an answer may take as long as the bench file's time-out. Otherwise the cycle ends on its schedule,
        and a late answer counts as the newest one in the next cycle. A cycle that is too late is not sent at all: see
        `CycleSchedule`.
        """
        if self.network.channel.is_lock_step:
            self._exchange_in_lock_step()
        else:
            self._exchange_on_schedule()

    def saw(self, frame: Frame) -> None:
        """Count a frame of the master outside of the cycle."""
        if not self.network.channel.is_lock_step:
            self.schedule.saw(frame)

    def _exchange_in_lock_step(self) -> None:
        network = self.network
        if self._whole is not None and not self._may_be_behind and network.takes_messages:
            answer = network.cycle_in_messages(self._whole.command())
            missing = self._whole.take(answer)
            if missing is not None:
                network.log_message(answer)
                self._count(missing)
                return
            frames = network.frames_of(answer)
        else:
            network.sync_with([slot.command() for slot in self.slots])
            frames = network.receive_all(network.timeout_s)
        if not self._may_be_behind and self._take_whole(frames):
            return
        pending = set(self._expected)
        deadline = self._clock.now() + network.timeout_s
        while frames:
            for frame in frames:
                if frame[0] in self._expected and pending and frame[0] > min(pending):
                    self._may_be_behind = True  # the lowest identifier leaves first: this one is of an earlier cycle
                if not self._take(frame, pending):
                    network.dispatch(frame)
            if not pending or self._clock.now() > deadline:
                break  # or others talk, and what is waited for does not come
            frames = network.receive_all(network.timeout_s)
        if pending or self._may_be_behind:
            # An answer that came late, or twice, would be taken for that of every cycle to come, one behind for good: from now
            # on all that is there is taken, and the newest value wins. A run in which nothing is lost never gets here.
            self._may_be_behind = True
            self._drain(pending)
        self._count(pending)

    def _take_whole(self, frames: list[Frame]) -> bool:
        """Take a cycle's answers if they are complete and in order.

        This is the usual case, and fast.
        """
        if [frame[0] for frame in frames] != self._order:
            return False
        handlers = self._handlers
        self._count({can_id for can_id, data in frames if not handlers[can_id](data)})
        return True

    def _exchange_on_schedule(self) -> None:
        schedule = self.schedule
        schedule.wait()
        self._drain(set())
        self.was_dropped = schedule.gives_up() or not self._send_in_time()
        if self.was_dropped:
            self._count_dropped()
            return
        self._sync_s = schedule.sync_left()
        pending = set(self._expected)
        while pending and (left := schedule.end_s - self._clock.now()) > 0.0:
            frame = self.network.receive(left)
            if frame is not None:
                self._take_or_dispatch(frame, pending)
        if pending:  # the master itself may have slept meanwhile, and what it waits for be there
            self._drain(pending)
        self._count(pending)
        schedule.count_bits()

    def _send_in_time(self) -> bool:
        """Send RPDOs and SYNC; False if it was too late for SYNC.

        Drives apply RPDOs at SYNC: without SYNC, the RPDOs of the next cycle replace them.
        """
        network, schedule = self.network, self.schedule
        for slot in self.slots:
            command = slot.command()
            network.send(command)
            schedule.saw(command)
        if not schedule.gives_up():
            network.sync()
            schedule.saw(SYNC)
            return True
        return False

    def _drain(self, pending: set[int]) -> None:
        """Take the frames that have arrived.

        Before SYNC they are late answers: their values count, but they answer no SYNC.
        """
        for _ in range(MAX_LATE_FRAMES):
            frame = self.network.receive(0.0)
            if frame is None:
                return
            self._take_or_dispatch(frame, pending)

    def _take_or_dispatch(self, frame: Frame, pending: set[int]) -> None:
        self.saw(frame)
        if self._take(frame, pending):
            self.schedule.answered()
        else:
            self.network.dispatch(frame)

    def _take(self, frame: Frame, pending: set[int]) -> bool:
        """Unpack a frame with a handler; False for any other frame.

        A wrong length counts as a missing answer.
        """
        taker = self._handlers.get(frame[0])
        if taker is None:
            return False
        if taker(frame[1]):
            pending.discard(frame[0])
        return True

    def _count(self, pending: set[int]) -> None:
        self.cycles += 1
        if pending or not self._has_all:
            self.missed_cycles += bool(pending)
            for slot in self.slots:
                slot.missing = slot.missing + 1 if slot.feedback_id in pending else 0
            for encoder in self.encoders:
                encoder.has_answered = encoder.can_id not in pending
            self.missing_answers = len(pending)
            self._has_all = not pending
        self.sensor_missed += not self.sensor.has_measured(pending, self._sync_s)

    def _count_dropped(self) -> None:
        """Count a dropped cycle.

        No drive owes an answer to it, and the slots hold data of an older cycle.
        """
        self.cycles += 1
        self._has_all = False
        self.missing_answers = len(self._expected)
        self.sensor_missed += 1
        for encoder in self.encoders:
            encoder.has_answered = False
        self.schedule.count_bits()
