"""A session whose cycles need no frames.

The master's own run drives the drives and axes behind the bus directly.

Set-up, enabling, stops and everything but a plain cycle still use the in-process bus, frame by frame. In a plain cycle every
drive is enabled in cyclic position mode and receives only the next set-point. Such a cycle is done at the interface that
frames would reach: counts, torque in per mille and the sensor's sample are read, set-points written, and the world advances
by one period. A recording is the same, to the bit.
"""

from collections.abc import Callable, Sequence

from drive_profiles.address import LOCAL, Address
from hil.bench.bench import Bench
from hil.can.frame import Frame
from hil.master.cyclic import CyclicExchange, Slot
from hil.master.drive import mapping
from hil.master.drive.axis import DriveAxis
from hil.master.joint_encoder import JointEncoder
from hil.master.motion import LoopName
from hil.master.sensor import CanopenSensor, JointsOnly
from hil.master.session import Session
from hil.recording import BusLog
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.sensor.accelerometer import DIGITS
from plant_emulator.slave.dictionary import Cell
from plant_emulator.world import World

_PER_UNIT: int = 10**DIGITS
_SCALE: float = 10.0**-DIGITS
_LARGEST = 2**15 - 1


class DirectChannel(InProcessChannel):
    """The in-process bus to a robot, for sessions without frames.

    Only set-up and stops use frames.

    Args:
        world: The world behind it.
        bitrate: Bit rate by which the load of the bus is checked, as on a bus that has one; None for an ideal bus.
    """

    def __init__(self, world: World, bitrate: int | None = None) -> None:
        super().__init__(world)
        self.address = Address(LOCAL, "in-process", bitrate)

    def session(self, bench: Bench, progress: Callable[[float], None] = lambda fraction: None) -> "DirectSession":
        """Open a session on this robot."""
        return DirectSession(bench, self, progress)


class DirectSession(Session):
    """A session of the master on a robot in this process.

    Frames are not logged.
    """

    def __init__(self, bench: Bench, channel: DirectChannel, progress: Callable[[float], None]) -> None:
        super().__init__(bench, channel, BusLog(None), progress)
        self._direct = channel

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
            axes: The axes that take part.
            period_s: SYNC period.
            loop: Place of the loop: set-points are positions where drives close it, torques where the host does.
            with_notch_state: Record the state of each drive's first filter.
            with_torque_offset: Send a torque offset beside each position set-point.
            watched: Axes that do not take part, but whose second encoders do.
        """
        return DirectExchange(
            self._direct, self, axes, period_s, loop, with_notch_state=with_notch_state, with_torque_offset=with_torque_offset,
            watched=watched,
        )  # fmt: skip


class DirectExchange(CyclicExchange):
    """An exchange that executes plain cycles without frames."""

    def __init__(
        self,
        channel: DirectChannel,
        session: Session,
        axes: list[DriveAxis],
        period_s: float,
        loop: LoopName,
        *,
        with_notch_state: bool,
        with_torque_offset: bool,
        watched: Sequence[DriveAxis] = (),
    ) -> None:
        """Prepare a run.

        Args:
            channel: The in-process bus.
            session: The session.
            axes: The axes that take part.
            period_s: SYNC period.
            loop: Place of the loop; only CSP does without frames.
            with_notch_state: Record the state of each drive's first filter.
            with_torque_offset: Send a torque offset beside each position set-point.
            watched: Axes that do not take part, but whose second encoders do.
        """
        super().__init__(
            session.network, axes, session.sensor, period_s, loop=loop, with_notch_state=with_notch_state,
            with_torque_offset=with_torque_offset, watched=watched, clock=session.clock,
        )  # fmt: skip
        self._channel, self._world = channel, channel.world
        by_node = {drive.node_id: drive for drive in self._world.drives.values()}
        self._by_node = by_node
        self._drives = [(slot, by_node[slot.axis.node]) for slot in self.slots]
        self._notches: list[tuple[Slot, list[Cell]]] = []
        self._loads: list[tuple[JointEncoder, Cell]] = []
        is_csp = all(slot.mode is mapping.CSP for slot in self.slots)
        self._can_be_direct = is_csp and isinstance(self.sensor, (CanopenSensor, JointsOnly))

    def configure(self) -> None:
        """Map the PDOs of the nodes.

        References to the filters' states are kept.
        """
        super().configure()
        self._notches = [
            (slot, [drive.slave.dictionary.cell(each.index, each.subindex) for each in mapping.notch_state(slot.axis.profile)])
            for slot, drive in self._drives
            if slot.notch_id
        ]
        self._loads = [
            (encoder, self._by_node[encoder.axis.node].slave.dictionary.cell(each.index, each.subindex))
            for encoder in self.encoders
            for each in mapping.load_position(encoder.axis.table, encoder.axis.profile)
        ]

    def _exchange_in_lock_step(self) -> None:
        if self._can_be_direct and all(drive.repeats(slot.control_word) for slot, drive in self._drives):
            self._exchange_directly()
        else:
            super()._exchange_in_lock_step()

    def _exchange_directly(self) -> None:
        """Execute a SYNC: sample, apply set-points, let the period pass."""
        world = self._world
        self._channel.syncs += 1
        if isinstance(self.sensor, CanopenSensor):
            x, y, z = world.measure()
            self.data.tip_m_s2 = _shown(x), _shown(y), _shown(z)
        for slot, drive in self._drives:
            slot.status_word = drive.status_word()
            slot.position_counts, slot.torque_per_mille = drive.data.position_counts(), drive.data.shown_torque()
        for encoder, cell in self._loads:
            self.take(Frame(encoder.can_id, cell.encoded()))
        for slot, cells in self._notches:
            self.take(Frame(slot.notch_id, b"".join(cell.encoded() for cell in cells)))
        for slot, drive in self._drives:
            drive.data.take_cyclic_target(slot.target, slot.torque_offset if self.with_torque_offset else None)
        self.network.pass_cycle()
        for frame in world.pass_period():
            self.network.dispatch(frame)
        for which in range(self.data.answer_count):
            self.data.answers[which].has_come = 1
        self.data.pending = 0
        self._count()


def _shown(acceleration: float) -> float:
    """Return an acceleration as its process value shows it, m/s²."""
    steps = round(acceleration * _PER_UNIT)
    return (steps if -_LARGEST <= steps <= _LARGEST else max(-_LARGEST, min(_LARGEST, steps))) * _SCALE
