"""The cyclic path: set-points out, SYNC, answers in; on pre-packed structs, once per period."""

import math
import struct
import time
from dataclasses import dataclass, field

from drive_profiles.cia301 import DataType
from drive_profiles.cia402 import Mode, Object
from hil.can.frame import Frame
from hil.errors import NodeError
from hil.master.axis import DriveAxis
from hil.master.network import Network
from hil.master.pdo import MappedObject, PdoSet

U8, U16, U32, I16, I32 = (
    DataType.UNSIGNED8,
    DataType.UNSIGNED16,
    DataType.UNSIGNED32,
    DataType.INTEGER16,
    DataType.INTEGER32,
)

_POSITION_COMMAND = struct.Struct("<Hi")
_TORQUE_COMMAND = struct.Struct("<Hh")
_FEEDBACK = struct.Struct("<Hih")
_NOTCH = struct.Struct("<Bf")
_ACCELERATION = struct.Struct("<hhh")

MAX_LATE_FRAMES = 1024

ACCELERATION_OBJECT, UNIT_OBJECT, DIGITS_OBJECT = 0x7130, 0x6131, 0x6132
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
    """

    def __init__(
        self,
        network: Network,
        axes: list[DriveAxis],
        accelerometer: int,
        period_s: float,
        *,
        mode: Mode,
        with_notch_state: bool,
    ) -> None:
        """Plan a run; `configure` writes it to the nodes.

        Args:
            network: The bus.
            axes: The axes that take part.
            accelerometer: Node of the accelerometer.
            period_s: SYNC period.
            mode: CSP (position set-points) or CST (torque set-points).
            with_notch_state: Let the drives tell what their first filter does, in a second TPDO.
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
        self._with_notch_state = with_notch_state
        self._accelerometer = accelerometer
        self._acceleration_scale = 1.0
        self._sets: list[PdoSet] = []
        self._expected: frozenset[int] = frozenset()
        self._acceleration_id = 0
        self._by_id: dict[int, Slot] = {}
        self._next_s: float | None = None

    def configure(self) -> None:
        """Map the PDOs; the nodes are pre-operational."""
        is_position = self.mode is Mode.CSP
        target = MappedObject(Object.TARGET_POSITION, 0, I32) if is_position else MappedObject(Object.TARGET_TORQUE, 0, I16)
        command = (MappedObject(Object.CONTROL_WORD, 0, U16), target)
        feedback = (
            MappedObject(Object.STATUS_WORD, 0, U16),
            MappedObject(Object.POSITION_ACTUAL, 0, I32),
            MappedObject(Object.TORQUE_ACTUAL, 0, I16),
        )
        expected: set[int] = set()
        for slot in self.slots:
            pdos = PdoSet(self.network, slot.axis.node)
            self._sets.append(pdos)
            slot._command_id = pdos.rpdo(1, command)
            slot._packer = _POSITION_COMMAND if is_position else _TORQUE_COMMAND
            slot.feedback_id = pdos.tpdo(1, feedback)
            expected.add(slot.feedback_id)
            self._by_id[slot.feedback_id] = slot
            state = self._notch_state_objects(slot.axis)
            if state:
                slot.notch_id = pdos.tpdo(2, state)
                expected.add(slot.notch_id)
                self._by_id[slot.notch_id] = slot
            else:
                pdos.silence(0x1801)
        pdos = PdoSet(self.network, self._accelerometer)
        self._sets.append(pdos)
        self._acceleration_scale = self._read_acceleration_scale()
        self._acceleration_id = pdos.tpdo(1, tuple(MappedObject(ACCELERATION_OBJECT, sub, I16) for sub in (1, 2, 3)))
        expected.add(self._acceleration_id)
        self._expected = frozenset(expected)

    def _notch_state_objects(self, axis: DriveAxis) -> tuple[MappedObject, ...]:
        parameters = axis.profile.parameters
        names = ("notch_1.active", "notch_1.frequency_hz")
        if not self._with_notch_state or not all(name in parameters for name in names):
            return ()
        return tuple(
            MappedObject(parameters[name].index, parameters[name].subindex, DataType[parameters[name].data_type])
            for name in names
        )

    def _read_acceleration_scale(self) -> float:
        """m/s² per step of the process values; all three channels must say the same."""
        node = self._accelerometer
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
        answer is taken as the newest one in the next.
        """
        network = self.network
        self._wait_for_the_beat()
        if not network.channel.is_lock_step:
            self._drain()
        for slot in self.slots:
            network.send(slot.command())
        network.sync()
        pending = set(self._expected)
        lock_step = network.channel.is_lock_step
        deadline = time.monotonic() + network.timeout_s if lock_step else (self._next_s or 0.0)
        while pending:
            frame = network.receive(network.timeout_s if lock_step else deadline - time.monotonic())
            if frame is None:
                break
            if not self._take(frame, pending):
                network.dispatch(frame)
                if time.monotonic() > deadline:
                    break  # others talk, and what is waited for does not come
        self._count(pending)

    def _drain(self) -> None:
        """Take what has come too late for the last cycle: the newest value wins, and it is not an answer of the next."""
        late = set(self._expected)
        for _ in range(MAX_LATE_FRAMES):
            frame = self.network.receive(0.0)
            if frame is None:
                return
            if not self._take(frame, late):
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
        self.accelerometer_missed += self._acceleration_id in pending

    def _wait_for_the_beat(self) -> None:
        """Sleep until the next absolute deadline; on a lock-step bus the beat is ours."""
        if self.network.channel.is_lock_step:
            return
        now = time.monotonic()
        if self._next_s is None or now > self._next_s + self.period_s:
            self._next_s = now  # the first cycle, or so late that the beat starts anew: set-points are not made up for
        elif now < self._next_s:
            time.sleep(self._next_s - now)
        self._next_s += self.period_s
