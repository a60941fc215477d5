"""The exchange of each cycle: set-points out, SYNC, answers in.

All process data lie in the records of `cyclic.h`, which are packed and unpacked there.
"""

import math
from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from hil.can.channel import MessageChannel
from hil.can.clock import MAX_RECORDS
from hil.can.frame import Frame, pack
from hil.control.treatments import LoopName
from hil.core.library import CORE
from hil.master.drive import mapping
from hil.master.drive.axis import DriveAxis
from hil.master.drive.mapping import CyclicMode
from hil.master.drive.pdo import PdoSet
from hil.master.lateness import CycleSchedule
from hil.master.network import SYNC, Network
from hil.master.realtime import Clock
from hil.master.sensor import TIP_ELSEWHERE, TipAccelerometer
from hil.recording import LoggedCycles
from hil.sensor.framing import Vector

POSITION_COMMAND: int = CORE.call.POSITION_COMMAND
TORQUE_COMMAND: int = CORE.call.TORQUE_COMMAND
OFFSET_COMMAND: int = CORE.call.OFFSET_COMMAND
"""Contents of an axis' RPDO."""
_COMMAND_BYTES = {POSITION_COMMAND: 6, TORQUE_COMMAND: 4, OFFSET_COMMAND: 8}

FEEDBACK: int = CORE.call.FEEDBACK
FILTER_STATE: int = CORE.call.FILTER_STATE
JOINT_POSITION: int = CORE.call.JOINT_POSITION
TIP_ACCELERATION: int = CORE.call.TIP_ACCELERATION
"""Contents of an answer."""

MAX_LATE_FRAMES = 1024
_RECORD: int = CORE.call.RECORD_BYTES
_DATA: int = CORE.call.DATA_AT
_NOT_SENT: int = CORE.call.NOT_SENT
_NOT_TAKEN: int = CORE.call.NOT_TAKEN
_pack_commands, _count_answers = CORE.call.pack_commands, CORE.call.count_answers
_await_answers, _take_answer = CORE.call.await_answers, CORE.call.take_answer
_begin_cycle, _run_cycles, _take_cycle = CORE.call.begin_cycle, CORE.call.run_cycles, CORE.call.take_cycle


def _number(name: str) -> Any:
    """Return a property for a number of the record `data`."""
    return property(attrgetter(f"data.{name}"), lambda self, value: setattr(self.data, name, value))


class Slot:
    """Process data of one axis; the newest value wins.

    Args:
        axis: The axis, whose units are known.
        mode: Mode in which the drive takes its set-points.

    Attributes:
        target: Set-point for the next cycle: counts (CSP) or per mille of the rated torque (CST).
        torque_offset: Torque offset for the next cycle, if the exchange has it: per mille of the rated torque.
        torque_per_mille: Last torque, in per mille of the rated torque.
        notch_hz: Zero frequency of the first filter, 0 while it is out.
        missing: Cycles in a row without an answer.
        feedback_id: Identifier of the TPDO that brings status word, position and torque.
        notch_id: Identifier of the TPDO that brings the filter's state; 0 if the drive does not send it.
    """

    control_word: int = _number("control_word")
    target: int = _number("target")
    torque_offset: int = _number("torque_offset")
    status_word: int = _number("status_word")
    position_counts: int = _number("position_counts")
    torque_per_mille: int = _number("torque_per_mille")
    notch_hz: float = _number("notch_hz")
    missing: int = _number("missing")

    def __init__(self, axis: DriveAxis, records: Any, row: int, mode: CyclicMode = mapping.CSP) -> None:
        self.axis, self.mode = axis, mode
        self.command_id = self.feedback_id = self.notch_id = 0
        self._records, self.data = records, records[row]  # a record does not keep its array
        scaling = axis.scaling
        self.data.counts_per_rad = scaling.position_sign * scaling.counts_per_rad
        self.data.rad_per_count = scaling.position_rad(1)
        self.data.per_mille_per_nm = 1000.0 / scaling.rated_torque_nm
        self.data.nm_per_mille = scaling.torque_nm(1)

    def send_command_as(self, can_id: int, command: int) -> None:
        """Set identifier and content of the RPDO: `POSITION_COMMAND`, `TORQUE_COMMAND` or `OFFSET_COMMAND`."""
        self.command_id, self.data.command = can_id, command

    @property
    def position_rad(self) -> float:
        """Last motor angle."""
        return float(self.data.position_counts * self.data.rad_per_count)

    @property
    def torque_nm(self) -> float:
        """Last torque."""
        return float(self.data.torque_per_mille * self.data.nm_per_mille)


class JointEncoder:
    """Last position of a drive's second encoder, on the joint, from its own TPDO.

    Attributes:
        can_id: Identifier of its TPDO; 0 before it is mapped.
    """

    def __init__(self, axis: DriveAxis, records: Any, row: int) -> None:
        encoder = axis.table.load_encoder
        self.axis = axis
        self.can_id = 0
        self._records, self.data = records, records[row]  # a record does not keep its array
        self.data.rad_per_count = math.nan if encoder is None else encoder.rad_per_count

    def configure(self, pdos: PdoSet, *, with_notch_state: bool) -> None:
        """Map the encoder's position into its TPDO; the drive is pre-operational."""
        number = mapping.load_tpdo(self.axis.profile, with_notch_state=with_notch_state)
        self.can_id = pdos.tpdo(number, mapping.load_position(self.axis.table, self.axis.profile))

    @property
    def has_answered(self) -> bool:
        """True if the last cycle brought it."""
        return bool(self.data.has_answered)

    @property
    def angle_rad(self) -> float:
        """Angle of the joint in the last cycle; NaN without an answer."""
        return float(self.data.counts * self.data.rad_per_count) if self.data.has_answered else math.nan


class CyclicExchange:
    """Exchange of a run with its nodes: all PDOs of a cycle.

    Attributes:
        data: Its record, with those of all axes, joints and answers.
        slots: Process data, one slot per axis that takes part, in their order.
        encoders: Second encoders of the axes that take part, in their order, then those of watched axes.
        watched: Axes that do not move, and whose second encoders are recorded.
        sensor_missed: Cycles without a measurement of the tip, by the accelerometer or by all encoders of the joints.
        cycles: Cycles since the start.
        was_dropped: True if the last cycle was too late to be sent; the slots then hold the data of the one before.
        schedule: Deadlines and statistics of the run's cycles; a lock-step bus has none, so nothing is counted there.
        run: The record of the run that the cycles belong to.
        stretch: The record of the cycles to come, `stretch` of `run.h`: one, which the core does not end, unless a run fills it.
    """

    missing_answers: int = _number("missing_answers")
    sensor_missed: int = _number("sensor_missed")
    missed_cycles: int = _number("missed_cycles")
    cycles: int = _number("cycles")

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
            loop: Place of the loop: set-points are positions if drives close it, torques if the host does.
            with_notch_state: Let the drives send the state of their first filter in a second TPDO.
            watched: Axes that do not take part, but whose second encoders do: braked, they swing on their gears.
            clock: The master's clock; the monotonic clock unless it is given.
            max_lateness_s: Largest lateness at which a cycle is still sent in wall-clock time; half the period unless given.
        """
        self.network = network
        self.period_s = period_s
        self.loop = loop
        turning = [axis for axis in (*axes, *watched) if axis.table.load_encoder is not None]
        self.data = CORE.new("exchange")
        self._axes = CORE.pointer(np.zeros(len(axes), CORE.dtype("axis_data")), "axis_data")
        self._joints = CORE.pointer(np.zeros(len(turning), CORE.dtype("joint_data")), "joint_data")
        self.data.axes, self.data.axis_count = self._axes, len(axes)
        self.data.joints, self.data.joint_count = self._joints, len(turning)
        self.slots = [
            Slot(axis, self._axes, row, mapping.mode_of(loop, axis.profile) or mapping.CSP) for row, axis in enumerate(axes)
        ]
        self.watched = tuple(watched)
        self.encoders = [JointEncoder(axis, self._joints, row) for row, axis in enumerate(turning)]
        self.sensor = sensor
        self.with_torque_offset = with_torque_offset and loop == "drive"
        self.was_dropped = False
        self._clock = clock or Clock()
        limit_s = 0.5 * period_s if max_lateness_s is None else max_lateness_s
        self.schedule = CycleSchedule(self._clock, period_s, limit_s)
        self.with_notch_state = with_notch_state
        self._sync_s = 0.0
        self._sets: list[PdoSet] = []
        self._which: dict[int, int] = {}
        self._order: list[int] = []
        self._may_be_behind = False
        self._fits_message = False
        self._received = bytearray(CORE.call.MOST_RECORDS * _RECORD)
        self._received_data = CORE.pointer(np.frombuffer(self._received, np.uint8), "uint8_t")
        self.data.message = self._received_data
        if network is not None and network.messages is not None and network.messages.line is not None:
            self.data.line, self.data.timeout_s = network.messages.line, network.timeout_s
        self.run, self.stretch = CORE.NULL, CORE.new("stretch")
        self.stretch.count, self.stretch.row, self.stretch.period_s = 1, CORE.call.NOT_ENDED, period_s
        self.expect({})

    @property
    def tells_filter(self) -> bool:
        """True if a drive sends the state of its first filter."""
        return any(slot.notch_id for slot in self.slots)

    @property
    def tip_m_s2(self) -> Vector:
        """Last acceleration of the tip; zeros before the first measurement of a run."""
        x, y, z = self.data.tip_m_s2
        return x, y, z

    def configure(self) -> None:
        """Map the PDOs of the nodes, which are pre-operational."""
        content = POSITION_COMMAND if self.loop == "drive" else TORQUE_COMMAND
        answers: dict[int, tuple[int, int]] = {}
        for row, slot in enumerate(self.slots):
            pdos = PdoSet(self.network, slot.axis.node)
            self._sets.append(pdos)
            command = mapping.command(slot.mode, with_torque_offset=self.with_torque_offset)
            slot.send_command_as(pdos.rpdo(1, command), OFFSET_COMMAND if self.with_torque_offset else content)
            slot.feedback_id = pdos.tpdo(1, mapping.feedback(slot.axis.profile))
            answers[slot.feedback_id] = FEEDBACK, row
            state = mapping.notch_state(slot.axis.profile) if self.with_notch_state else ()
            if state:
                slot.notch_id = pdos.tpdo(2, state)
                answers[slot.notch_id] = FILTER_STATE, row
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
        answers |= {encoder.can_id: (JOINT_POSITION, row) for row, encoder in enumerate(self.encoders)}
        tip = self.sensor.configure()
        self.data.tip, self.data.tip_scale = tip.source, tip.scale_m_s2
        self.expect(answers if tip.can_id is None else {**answers, tip.can_id: (TIP_ACCELERATION, 0)})

    def expect(self, answers: Mapping[int, tuple[int, int]]) -> None:
        """Await these answers with every SYNC: content and row of each identifier."""
        self._order = sorted(answers)
        self._which = {can_id: which for which, can_id in enumerate(self._order)}
        records = np.zeros(len(answers), CORE.dtype("answer"))
        for record, can_id in zip(records, self._order, strict=True):
            record["can_id"], record["content"], record["row"] = can_id, *answers[can_id]
        self._answers = CORE.pointer(records, "answer")
        self.data.answers, self.data.answer_count = self._answers, len(answers)
        _await_answers(self.data)
        heads = [Frame(slot.command_id, bytes(_COMMAND_BYTES[slot.data.command])) for slot in self.slots]
        self._message = bytearray(b"".join(map(pack, (*heads, SYNC))))
        self._message_data = CORE.pointer(np.frombuffer(self._message, np.uint8), "uint8_t")
        self.data.command, self.data.command_bytes = self._message_data, len(self._message)
        is_logged = self.network is not None and self.network.log.is_on
        self._cycle_bytes = len(self._message) + len(answers) * _RECORD
        self._logged = memoryview(bytearray(is_logged * CORE.call.LOGGED_CYCLES * self._cycle_bytes))
        self.stretch.log = CORE.pointer(np.frombuffer(self._logged, np.uint8), "uint8_t") if is_logged else CORE.NULL
        places = range(_DATA, len(self._message), _RECORD)
        self._contents = [(can_id, slice(at, at + len(data))) for (can_id, data), at in zip(heads, places, strict=False)]
        self._fits_message = len(heads) < MAX_RECORDS

    def command(self) -> bytes:
        """The records of this cycle's RPDOs, and SYNC behind them."""
        _pack_commands(self.data)
        return bytes(self._message)

    def commands(self) -> list[Frame]:
        """The frames of this cycle's RPDOs."""
        message = self.command()
        return [Frame(can_id, message[content]) for can_id, content in self._contents]

    def restore(self, nodes: set[int]) -> list[str]:
        """Restore the former PDOs of the sensor and of these nodes."""
        refused = self.sensor.restore()
        while self._sets:
            pdos = self._sets.pop()
            if pdos.node in nodes:
                refused += pdos.restore()
        return refused

    def exchange(self) -> int | None:
        """Run the cycles of the stretch: RPDOs, SYNC, then answers until their time is over.

        In lock-step an answer may take as long as the bench file's time-out. Otherwise the cycle ends on its schedule,
        and a late answer counts as the newest one in the next cycle. A cycle that is too late is not sent at all: see
        `CycleSchedule`.

        Where a cycle is one message each way, several may pass; otherwise one does.

        Return what `run_cycles` of `run.h` has found if the core has ended the last cycle, and None if it has not.
        """
        network, messages, stretch = self.network, self.network.messages, self.stretch
        if messages is not None and messages.takes_messages and self._fits_message and not self._may_be_behind:
            stretch.now_s = network.lock_step_s
            messages.open_line()
            found: int = _run_cycles(self.data, self.run, stretch)
            messages.close_line()
            if self._logged and (done := stretch.done):
                size, began_s = self._cycle_bytes, network.lock_step_s
                records = self._logged[: done * size].tobytes()
                network.log.add(LoggedCycles(began_s, network.period_s, records, len(self._message), size))
            network.lock_step_s = stretch.now_s
            return self._go_on(found, messages) if found < 0 else found
        stretch.done = 0
        refused: int = _begin_cycle(self.run, stretch)
        if refused:
            return refused
        if network.channel.is_lock_step:
            network.sync_with(self.commands())
            self._take_frames(network.receive_all(network.timeout_s))
        else:
            self._exchange_on_schedule()
        stretch.done = 1
        return None

    def saw(self, frame: Frame) -> None:
        """Count a frame of the master outside of the cycle."""
        if not self.network.channel.is_lock_step:
            self.schedule.saw(frame)

    def _go_on(self, found: int, messages: MessageChannel) -> int | None:
        """Go on where the core has not run a cycle to its end: see `NOT_SENT` and its neighbours in `line.h`."""
        network = self.network
        if found == _NOT_SENT:
            messages.send_message(bytes(self._message))
        network.log_message(self._message, is_received=False)
        network.lock_step_s += network.period_s
        if found == _NOT_TAKEN:
            answer = bytes(self._received[: self.data.message_bytes])
        else:
            answer = messages.receive_message(network.timeout_s)
        stretch = self.stretch
        row = stretch.row if stretch.row < 0 else stretch.row + stretch.done
        found = _take_cycle(self.data, self.run, row, answer, len(answer))
        if found >= 0:
            network.log_message(answer, is_received=True)
        else:
            messages.put_back(answer)
            self._take_frames(network.receive_all(network.timeout_s) if answer else [])
        stretch.done += 1
        return found if found >= 0 else None

    def _take_frames(self, frames: list[Frame]) -> None:
        """Take the frames of a cycle, and those that it still waits for."""
        network = self.network
        _await_answers(self.data)
        if not self._may_be_behind and self._take_whole(frames):
            return
        data, deadline = self.data, self._clock.now() + network.timeout_s
        while frames:
            for frame in frames:
                if data.pending and network.channel.waits and self._which.get(frame[0], 0) > data.lowest:
                    # on a real bus the lowest identifier leaves first: this one is of an earlier cycle
                    self._may_be_behind = True
                if not self.take(frame):
                    network.dispatch(frame)
            if not data.pending or self._clock.now() > deadline:
                break  # or others talk, and what is waited for does not come
            frames = network.receive_all(network.timeout_s)
        if data.pending or self._may_be_behind:
            # An answer that came late, or twice, would be taken for that of every cycle to come, one behind for good: from now
            # on all that is there is taken, and the newest value wins. A run in which nothing is lost never gets here. It stays
            # so to the end of the run (the next one has an exchange of its own), since no later cycle shows that nothing more is
            # under way.
            self._may_be_behind = True
            self._drain()
        self._count()

    def _take_whole(self, frames: list[Frame]) -> bool:
        """Take a cycle's answers if they are complete and in order."""
        if [frame[0] for frame in frames] != self._order:
            return False
        for which, (_, content) in enumerate(frames):
            _take_answer(self.data, which, content, len(content))
        self._count()
        return True

    def _exchange_on_schedule(self) -> None:
        schedule = self.schedule
        schedule.wait()
        self._drain()
        self.was_dropped = schedule.gives_up() or not self._send_in_time()
        if self.was_dropped:
            CORE.call.count_dropped(self.data)
            schedule.count_bits()
            return
        self._sync_s = schedule.sync_left()
        _await_answers(self.data)
        while self.data.pending and (left := schedule.end_s - self._clock.now()) > 0.0:
            frame = self.network.receive(left)
            if frame is not None:
                self._take_or_dispatch(frame)
        if self.data.pending:  # the master itself may have slept meanwhile, and what it waits for be there
            self._drain()
        self._count()
        schedule.count_bits()

    def _send_in_time(self) -> bool:
        """Send RPDOs and SYNC; False if it was too late for SYNC.

        Drives apply RPDOs at SYNC: without SYNC, the RPDOs of the next cycle replace them.
        """
        network, schedule = self.network, self.schedule
        for command in self.commands():
            network.send(command)
            schedule.saw(command)
        if not schedule.gives_up():
            network.sync()
            schedule.saw(SYNC)
            return True
        return False

    def _drain(self) -> None:
        """Take the frames that have arrived.

        Before SYNC they are late answers: their values count, but they answer no SYNC.
        """
        for _ in range(MAX_LATE_FRAMES):
            frame = self.network.receive(0.0)
            if frame is None:
                return
            self._take_or_dispatch(frame)

    def _take_or_dispatch(self, frame: Frame) -> None:
        self.saw(frame)
        if self.take(frame):
            self.schedule.answered()
        else:
            self.network.dispatch(frame)

    def take(self, frame: Frame) -> bool:
        """Take an answer; False for any other frame.

        A wrong length counts as a missing answer.
        """
        which = self._which.get(frame[0])
        if which is None:
            return False
        _take_answer(self.data, which, frame[1], len(frame[1]))
        return True

    def _count(self) -> None:
        if self.data.tip == TIP_ELSEWHERE:
            sample = self.sensor.sample(self._sync_s)
            self.data.tip_has_come = sample is not None
            self.data.tip_m_s2 = self.tip_m_s2 if sample is None else sample
        _count_answers(self.data)
