"""The cyclic path: set-points out, SYNC, answers in; on pre-packed structs, once per period."""

import math
import struct
import time
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

_POSITION_COMMAND = struct.Struct("<Hi")
_TORQUE_COMMAND = struct.Struct("<Hh")
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
        status_word: As received.
        position_counts: As received.
        torque_per_mille: As received.
        notch_hz: Zero frequency of the first filter, 0 while it is out.
        missing: Cycles in a row without an answer.
    """

    axis: DriveAxis
    control_word: int = 0
    target: int = 0
    status_word: int = 0
    position_counts: int = 0
    torque_per_mille: int = 0
    notch_hz: float = 0.0
    missing: int = 0
    feedback_id: int = 0
    notch_id: int = 0
    _command_id: int = 0
    _packer: struct.Struct = field(default=_POSITION_COMMAND)

    def command(self) -> Frame:
        """The RPDO of this cycle."""
        return Frame(self._command_id, self._packer.pack(self.control_word, self.target))


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
        self._accelerometer = accelerometer
        self._sync_s = 0.0
        self._acceleration_scale = 1.0
        self._sets: list[PdoSet] = []
        self._expected: frozenset[int] = frozenset()
        self._may_be_behind = False
        self._acceleration_id = 0
        self._by_id: dict[int, Slot] = {}

    def configure(self) -> None:
        """Map the PDOs; the nodes are pre-operational."""
        command = mapping.command(self.mode)
        expected: set[int] = set()
        for slot in self.slots:
            pdos = PdoSet(self.network, slot.axis.node)
            self._sets.append(pdos)
            slot._command_id = pdos.rpdo(1, command)
            slot._packer = _POSITION_COMMAND if self.mode is Mode.CSP else _TORQUE_COMMAND
            slot.feedback_id = pdos.tpdo(1, mapping.FEEDBACK)
            expected.add(slot.feedback_id)
            self._by_id[slot.feedback_id] = slot
            state = mapping.notch_state(slot.axis.profile) if self._with_notch_state else ()
            if state:
                slot.notch_id = pdos.tpdo(2, state)
                expected.add(slot.notch_id)
                self._by_id[slot.notch_id] = slot
            else:
                pdos.silence(0x1801)
        if isinstance(self._accelerometer, int):
            pdos = PdoSet(self.network, self._accelerometer)
            self._sets.append(pdos)
            self._acceleration_scale = self._read_acceleration_scale(self._accelerometer)
            self._acceleration_id = pdos.tpdo(1, mapping.ACCELERATION)
            expected.add(self._acceleration_id)
        self._expected = frozenset(expected)

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
        for slot in self.slots:
            network.send(slot.command())
        network.sync()
        pending = set(self._expected)
        deadline = time.monotonic() + network.timeout_s
        while pending:
            frame = network.receive(network.timeout_s)
            if frame is None:
                break
            if frame[0] in self._expected and frame[0] > min(pending):
                self._may_be_behind = True  # the lowest identifier leaves first: this one is of an earlier cycle
            if not self._take(frame, pending):
                network.dispatch(frame)
                if time.monotonic() > deadline:
                    break  # others talk, and what is waited for does not come
        if pending or self._may_be_behind:
            # An answer that came late, or twice, would be taken for that of every cycle to come, one behind for good: from now
            # on all that is there is taken, and the newest value wins. A run in which nothing is lost never gets here.
            self._may_be_behind = True
            self._drain(pending)
        self._count(pending)

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
        can_id, data = frame
        if can_id not in self._expected:
            return False
        if can_id == self._acceleration_id:
            if len(data) == _ACCELERATION.size:
                scale = self._acceleration_scale
                x, y, z = _ACCELERATION.unpack(data)
                self.acceleration_m_s2 = (x * scale, y * scale, z * scale)
                pending.discard(can_id)
            return True
        slot = self._by_id[can_id]
        if can_id == slot.feedback_id:
            if len(data) == _FEEDBACK.size:
                slot.status_word, slot.position_counts, slot.torque_per_mille = _FEEDBACK.unpack(data)
                pending.discard(can_id)
        elif len(data) == _NOTCH.size:
            active, frequency = _NOTCH.unpack(data)
            slot.notch_hz = frequency if active and math.isfinite(frequency) else 0.0
            pending.discard(can_id)
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
