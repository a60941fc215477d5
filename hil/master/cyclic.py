"""The cyclic path: set-points out, SYNC, answers in; on pre-packed structs, once per period."""

import math
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from drive_profiles.cia301 import DataType
from drive_profiles.cia402 import Mode
from hil.can.frame import Frame
from hil.errors import NodeError
from hil.master import mapping
from hil.master.axis import DriveAxis
from hil.master.lateness import Beat
from hil.master.network import SYNC, Network
from hil.master.pdo import PdoSet
from hil.realtime import Clock, MonotonicClock
from hil.serial_accelerometer import SerialAccelerometer

U8, U32 = DataType.UNSIGNED8, DataType.UNSIGNED32

POSITION_COMMAND = struct.Struct("<Hi")
TORQUE_COMMAND = struct.Struct("<Hh")
OFFSET_COMMAND = struct.Struct("<Hih")
_FEEDBACK = struct.Struct("<Hih")
_NOTCH = struct.Struct("<Bf")
_ACCELERATION = struct.Struct("<hhh")

MAX_LATE_FRAMES = 1024

UNIT_OBJECT, DIGITS_OBJECT = 0x6131, 0x6132
METRE_PER_SECOND_SQUARED = 0x00015700


@dataclass
class Slot:
    """One axis' process data; the newest value wins.

    Attributes:
        axis: Whose.
        control_word: Sent with the next cycle.
        target: Sent with it: counts (CSP) or per mille of the rated torque (CST).
        torque_offset: Sent with it in CSP where the plan has it: per mille of the rated torque.
        status_word: As received.
        position_counts: As received.
        torque_per_mille: As received.
        notch_hz: Zero frequency of the first filter, 0 while it is out.
        missing: Cycles in a row without an answer.
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
    feedback_id: int = 0
    notch_id: int = 0
    _command_id: int = 0
    _packer: struct.Struct = field(default=POSITION_COMMAND)

    def __post_init__(self) -> None:
        """Keep the scale at hand."""
        self._rad_per_count = self.axis.scaling.position_rad(1)
        self._nm_per_mille = self.axis.scaling.torque_nm(1)

    def command(self) -> Frame:
        """The RPDO of this cycle."""
        packer = self._packer
        if packer is OFFSET_COMMAND:
            return Frame(self._command_id, packer.pack(self.control_word, self.target, self.torque_offset))
        return Frame(self._command_id, packer.pack(self.control_word, self.target))

    def take_feedback(self, data: bytes) -> bool:
        """What the first TPDO has brought; whether it is whole."""
        if len(data) != _FEEDBACK.size:
            return False
        self.status_word, self.position_counts, self.torque_per_mille = _FEEDBACK.unpack(data)
        return True

    def take_notch(self, data: bytes) -> bool:
        """What the second TPDO has brought; whether it is whole."""
        if len(data) != _NOTCH.size:
            return False
        active, frequency = _NOTCH.unpack(data)
        self.notch_hz = frequency if active and math.isfinite(frequency) else 0.0
        return True

    @property
    def position_rad(self) -> float:
        """Motor angle as received."""
        return self.position_counts * self._rad_per_count

    @property
    def torque_nm(self) -> float:
        """Torque as received."""
        return self.torque_per_mille * self._nm_per_mille


class CyclicPlan:
    """All PDOs of a run, and the exchange of one cycle.

    Attributes:
        slots: One per axis that takes part, in their order.
        acceleration_m_s2: X, Y, Z as received last.
        missing_answers: Answers that did not come in the last cycle.
        accelerometer_missed: Cycles without the accelerometer.
        missed_cycles: Cycles in which an answer did not come in time.
        cycles: Cycles since the start.
        was_dropped: Whether the last cycle was too late to be sent; what the slots hold is then of the one before.
        beat: The deadlines, and how they were kept; a lock-step bus has none, so nothing is counted there.
    """

    def __init__(
        self,
        network: Network,
        axes: list[DriveAxis],
        accelerometer: int | SerialAccelerometer,
        period_s: float,
        *,
        mode: Mode,
        with_notch_state: bool,
        with_torque_offset: bool = False,
        clock: Clock | None = None,
        max_lateness_s: float | None = None,
    ) -> None:
        """Plan a run; `configure` writes it to the nodes.

        Args:
            network: The bus.
            axes: The axes that take part.
            accelerometer: Node of the accelerometer, or the reader of one on a serial port; then time is the wall clock's.
            period_s: SYNC period.
            mode: CSP (position set-points) or CST (torque set-points).
            with_notch_state: Let the drives tell what their first filter does, in a second TPDO.
            with_torque_offset: Send a torque offset beside each position set-point.
            clock: The time of a bus that is not in lock-step; the monotonic clock unless it is given.
            max_lateness_s: How late a cycle is still sent on such a bus; half the period unless it is given.
        """
        self.network = network
        self.period_s = period_s
        self.mode = mode
        self.slots = [Slot(axis) for axis in axes]
        self.acceleration_m_s2 = (0.0, 0.0, 0.0)
        self.missing_answers = 0
        self.accelerometer_missed = 0
        self.missed_cycles = 0
        self.cycles = 0
        self.was_dropped = False
        self.beat = Beat(clock or MonotonicClock(), period_s, 0.5 * period_s if max_lateness_s is None else max_lateness_s)
        self._with_notch_state = with_notch_state
        self._with_torque_offset = with_torque_offset and mode is Mode.CSP
        self._accelerometer = accelerometer
        self._sync_s = 0.0
        self._acceleration_scale = 1.0
        self._sets: list[PdoSet] = []
        self._expected: frozenset[int] = frozenset()
        self._order: list[int] = []
        self._may_be_behind = False
        self._acceleration_id = 0
        self._takers: dict[int, Callable[[bytes], bool]] = {}

    @property
    def tells_filter(self) -> bool:
        """Whether any drive tells what its first filter does."""
        return any(slot.notch_id for slot in self.slots)

    def configure(self) -> None:
        """Map the PDOs; the nodes are pre-operational."""
        command = mapping.command(self.mode, with_torque_offset=self._with_torque_offset)
        packer = POSITION_COMMAND if self.mode is Mode.CSP else TORQUE_COMMAND
        expected: set[int] = set()
        for slot in self.slots:
            pdos = PdoSet(self.network, slot.axis.node)
            self._sets.append(pdos)
            slot._command_id = pdos.rpdo(1, command)
            slot._packer = OFFSET_COMMAND if self._with_torque_offset else packer
            slot.feedback_id = pdos.tpdo(1, mapping.FEEDBACK)
            expected.add(slot.feedback_id)
            self._takers[slot.feedback_id] = slot.take_feedback
            state = mapping.notch_state(slot.axis.profile) if self._with_notch_state else ()
            if state:
                slot.notch_id = pdos.tpdo(2, state)
                expected.add(slot.notch_id)
                self._takers[slot.notch_id] = slot.take_notch
            else:
                pdos.silence(0x1801)
        if isinstance(self._accelerometer, int):
            pdos = PdoSet(self.network, self._accelerometer)
            self._sets.append(pdos)
            self._acceleration_scale = self._read_acceleration_scale(self._accelerometer)
            self._acceleration_id = pdos.tpdo(1, mapping.ACCELERATION)
            self._takers[self._acceleration_id] = self._take_acceleration
            expected.add(self._acceleration_id)
        self.expect(expected)

    def expect(self, identifiers: set[int]) -> None:
        """Await these with every SYNC."""
        self._expected, self._order = frozenset(identifiers), sorted(identifiers)

    def _read_acceleration_scale(self, node: int) -> float:
        """m/s² per step of the process values; all three channels must say the same."""
        scales = set()
        for sub in (1, 2, 3):
            unit = self.network.read(node, UNIT_OBJECT, sub, U32, "physical unit")
            if unit != METRE_PER_SECOND_SQUARED:
                raise NodeError(node, f"channel {sub} measures in unit 0x{unit:08X}, m/s² is 0x{METRE_PER_SECOND_SQUARED:08X}")
            scales.add(10.0 ** -self.network.read(node, DIGITS_OBJECT, sub, U8, "decimal digits"))
        if len(scales) != 1:
            raise NodeError(node, f"its channels count differently: {sorted(scales)} m/s² per step")
        return float(scales.pop())

    def restore(self, nodes: set[int]) -> list[str]:
        """Give these nodes their PDOs back; what they refuse, in words."""
        refused = []
        while self._sets:
            pdos = self._sets.pop()
            if pdos.node in nodes:
                refused += pdos.restore()
        return refused

    def exchange(self) -> None:
        """One cycle: RPDOs, SYNC, then the answers until all are there or the time is up.

        In lock-step an answer may take as long as the bench file's time-out; otherwise the cycle ends on its beat, and a late
        answer is taken as the newest one in the next. A cycle that is too late is not sent at all: see `Beat`.
        """
        if self.network.channel.is_lock_step:
            self._exchange_in_lock_step()
        else:
            self._exchange_on_the_beat()

    def saw(self, frame: Frame) -> None:
        """Count a frame that the master has sent beside the cycle."""
        if not self.network.channel.is_lock_step:
            self.beat.saw(frame)

    def _exchange_in_lock_step(self) -> None:
        network = self.network
        network.sync_with([slot.command() for slot in self.slots])
        frames = network.receive_all(network.timeout_s)
        if not self._may_be_behind and self._take_whole(frames):
            return
        pending = set(self._expected)
        deadline = time.monotonic() + network.timeout_s
        while frames:
            for frame in frames:
                if frame[0] in self._expected and pending and frame[0] > min(pending):
                    self._may_be_behind = True  # the lowest identifier leaves first: this one is of an earlier cycle
                if not self._take(frame, pending):
                    network.dispatch(frame)
            if not pending or time.monotonic() > deadline:
                break  # or others talk, and what is waited for does not come
            frames = network.receive_all(network.timeout_s)
        if pending or self._may_be_behind:
            # An answer that came late, or twice, would be taken for that of every cycle to come, one behind for good: from now
            # on all that is there is taken, and the newest value wins. A run in which nothing is lost never gets here.
            self._may_be_behind = True
            self._drain(pending)
        self._count(pending)

    def _take_whole(self, frames: list[Frame]) -> bool:
        """Take a cycle's answers if these are exactly all of them, in their order, and whole; the rule, and quick."""
        if [frame[0] for frame in frames] != self._order:
            return False
        takers = self._takers
        self._count({can_id for can_id, data in frames if not takers[can_id](data)})
        return True

    def _exchange_on_the_beat(self) -> None:
        beat = self.beat
        beat.wait()
        self._drain(set())
        self.was_dropped = beat.gives_up() or not self._send_in_time()
        if self.was_dropped:
            self._count_dropped()
            return
        beat.sync_left()
        self._sync_s = time.monotonic()
        pending = set(self._expected)
        while pending and (left := beat.end_s - beat.clock.now()) > 0.0:
            frame = self.network.receive(left)
            if frame is not None:
                self._take_or_dispatch(frame, pending)
        if pending:  # the master itself may have slept meanwhile, and what it waits for be there
            self._drain(pending)
        self._count(pending)
        beat.count_bits()

    def _send_in_time(self) -> bool:
        """RPDOs and SYNC; whether SYNC was sent.

        Without it the RPDOs, which wait for SYNC in the drives, never come into force: those of the next cycle replace them.
        """
        network, beat = self.network, self.beat
        for slot in self.slots:
            command = slot.command()
            network.send(command)
            beat.saw(command)
        if not beat.gives_up():
            network.sync()
            beat.saw(SYNC)
            return True
        return False

    def _drain(self, pending: set[int]) -> None:
        """Take what is there. Before SYNC that has come too late: the newest value wins, and it is not an answer to that SYNC."""
        for _ in range(MAX_LATE_FRAMES):
            frame = self.network.receive(0.0)
            if frame is None:
                return
            self._take_or_dispatch(frame, pending)

    def _take_or_dispatch(self, frame: Frame, pending: set[int]) -> None:
        self.saw(frame)
        if self._take(frame, pending):
            self.beat.answered()
        else:
            self.network.dispatch(frame)

    def _take(self, frame: Frame, pending: set[int]) -> bool:
        """Unpack a frame if it is one of ours; whether it was. A wrong length counts as missing."""
        taker = self._takers.get(frame[0])
        if taker is None:
            return False
        if taker(frame[1]):
            pending.discard(frame[0])
        return True

    def _take_acceleration(self, data: bytes) -> bool:
        """What the accelerometer has sent; whether it is whole."""
        if len(data) != _ACCELERATION.size:
            return False
        scale = self._acceleration_scale
        x, y, z = _ACCELERATION.unpack(data)
        self.acceleration_m_s2 = (x * scale, y * scale, z * scale)
        return True

    def _count(self, pending: set[int]) -> None:
        self.cycles += 1
        if pending:
            self.missed_cycles += 1
        for slot in self.slots:
            slot.missing = slot.missing + 1 if slot.feedback_id in pending else 0
        self.missing_answers = len(pending)
        if isinstance(self._accelerometer, int):
            self.accelerometer_missed += self._acceleration_id in pending
        else:
            value = self._accelerometer.value_at_sync(self._sync_s)
            self.accelerometer_missed += value is None
            self.acceleration_m_s2 = value or self.acceleration_m_s2

    def _count_dropped(self) -> None:
        """Nothing was asked, so no drive owes an answer; and what the slots hold is not of this cycle."""
        self.cycles += 1
        self.missing_answers = len(self._expected)
        self.accelerometer_missed += 1
        self.beat.count_bits()
