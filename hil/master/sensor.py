"""Accelerometer at the tip in a run: CANopen node or serial device."""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, NamedTuple

from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType
from hil.bench.sensors import AccelerometerTable
from hil.core.library import CORE
from hil.errors import NodeError, NotPossibleError
from hil.master.drive import mapping
from hil.master.drive.axis import check_identity
from hil.master.drive.pdo import PdoSet
from hil.master.realtime import Clock
from hil.sensor.accelerometer import AccelerometerReader
from hil.sensor.framing import Vector

if TYPE_CHECKING:
    from hil.master.network import Network

U8, U32 = DataType.UNSIGNED8, DataType.UNSIGNED32

UNIT_OBJECT, DIGITS_OBJECT = 0x6131, 0x6132
METRE_PER_SECOND_SQUARED = 0x00015700

TIP_ELSEWHERE: int = CORE.call.TIP_ELSEWHERE
TIP_BY_NODE: int = CORE.call.TIP_BY_NODE
TIP_BY_JOINTS: int = CORE.call.TIP_BY_JOINTS
"""Sources of the tip's acceleration: not on the bus; a node; all encoders of the joints."""


class TipSource(NamedTuple):
    """The way in which a sensor measures during a run.

    Attributes:
        source: `TIP_ELSEWHERE`, `TIP_BY_NODE` or `TIP_BY_JOINTS`.
        can_id: Identifier of the node's TPDO, which answers each SYNC; None without a node.
        scale_m_s2: m/s² per step of the node's values.
    """

    source: int
    can_id: int | None = None
    scale_m_s2: float = 1.0


class TipAccelerometer(ABC):
    """An accelerometer in a run, however it is connected.

    Attributes:
        nodes: Node-IDs of the sensor on the bus; empty without a node.
    """

    nodes: tuple[int, ...] = ()

    def open(self) -> None:
        """Find the sensor and check that it is the right one.

        Raises:
            HilError: The sensor is silent, or is another device.
        """
        return  # nothing is there, unless a sensor says so

    @abstractmethod
    def configure(self) -> TipSource:
        """Prepare the sensor for a run.

        Raises:
            HilError: The sensor refuses, or measures in another unit than m/s².
        """

    def restore(self) -> list[str]:
        """Undo the changes of `configure`; return the refusals in words."""
        return []

    def sample(self, sync_s: float) -> Vector | None:
        """Return X, Y and Z at the last SYNC, measured elsewhere than on the bus.

        None without such a measurement.

        Args:
            sync_s: Time of SYNC by the master's clock; 0 in lock-step.
        """
        return None

    def close(self) -> None:
        """Release the sensor; a second call does nothing."""
        return


class CanopenSensor(TipAccelerometer):
    """A CANopen accelerometer (CiA 404) that answers each SYNC with a TPDO."""

    def __init__(self, network: "Network", node: int, profile: Profile) -> None:
        self._network, self._node, self._profile = network, node, profile
        self.nodes = (node,)
        self._pdos = PdoSet(network, node)

    def open(self) -> None:
        """Check the identity of the sensor.

        Raises:
            NoAnswerError: The sensor is silent.
            WrongIdentityError: The sensor is another device than its profile says.
        """
        check_identity(self._network, self._node, self._profile)

    def configure(self) -> TipSource:
        """Map the three channels into TPDO1.

        Raises:
            NodeError: The sensor measures in another unit than m/s², or its channels differ in their scale.
        """
        scale_m_s2 = self._read_scale_m_s2()
        return TipSource(TIP_BY_NODE, self._pdos.tpdo(1, mapping.ACCELERATION), scale_m_s2)

    def _read_scale_m_s2(self) -> float:
        """Read the scale in m/s² per step, which all three channels share."""
        node, scales = self._node, set()
        for sub in (1, 2, 3):
            unit = self._network.read(node, UNIT_OBJECT, sub, U32, "physical unit")
            if unit != METRE_PER_SECOND_SQUARED:
                raise NodeError(node, f"channel {sub} measures in unit 0x{unit:08X}; expected 0x{METRE_PER_SECOND_SQUARED:08X}")
            scales.add(10.0 ** -self._network.read(node, DIGITS_OBJECT, sub, U8, "decimal digits"))
        if len(scales) != 1:
            raise NodeError(node, f"its channels have different scales: {sorted(scales)} m/s² per step")
        return float(scales.pop())

    def restore(self) -> list[str]:
        """Restore the TPDO of the sensor; return the refusals in words."""
        return self._pdos.restore()


class SerialSensor(TipAccelerometer):
    """An accelerometer on a serial port; time must be the wall clock's."""

    def __init__(self, network: "Network", reader: AccelerometerReader) -> None:
        self._network, self._reader = network, reader

    def open(self) -> None:
        """Open the port and wait for the first sample.

        Raises:
            SerialAccelerometerError: Nothing can be read, or the bus counts its time in SYNCs.
        """
        self._reader.open(is_lock_step=self._network.channel.is_lock_step)

    def configure(self) -> TipSource:
        """Await no frames, since the sensor sends none on the bus."""
        return TipSource(TIP_ELSEWHERE)

    def sample(self, sync_s: float) -> Vector | None:
        """Return the sample of the instant of SYNC."""
        return self._reader.value_at_sync(sync_s)

    def close(self) -> None:
        """Close the port."""
        self._reader.close()


class JointsOnly(TipAccelerometer):
    """Replacement of a sensor at the tip by encoders of the joints.

    `hil.bench.load_encoder` computes the tip's acceleration from them after a motion: a single cycle of encoder angles has none.
    """

    def configure(self) -> TipSource:
        """Await no frames but those of the encoders."""
        return TipSource(TIP_BY_JOINTS)


def sensor_of(table: AccelerometerTable, network: "Network", clock: Clock) -> TipAccelerometer:
    """The accelerometer that a bench file names; nothing is sent or opened.

    Raises:
        NotPossibleError: The bench file names no accelerometer, or its profile is that of another device.
    """
    if table.from_load_encoders:
        return JointsOnly()
    profile = Profile.load(table.profile)
    if profile.kind != "accelerometer":
        raise NotPossibleError(f"profile {table.profile} is not an accelerometer")
    if table.serial is not None:
        return SerialSensor(network, AccelerometerReader(table.serial, clock.now))
    if table.node_id is None:
        raise NotPossibleError("the bench has no accelerometer")
    return CanopenSensor(network, table.node_id, profile)
