"""Accelerometer at the tip in a run: CANopen node or serial device."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Set
from typing import TYPE_CHECKING, Protocol

from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType
from hil.bench.sensors import AccelerometerTable
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
_ACCELERATION = struct.Struct("<hhh")

FrameHandler = Callable[[bytes], bool]
"""Function that unpacks the data of a frame; it returns False if their length is wrong."""


class TipAccelerometer(Protocol):
    """The interface of an accelerometer to a run, however it is connected.

    Attributes:
        acceleration_m_s2: Last measurement of X, Y and Z; zeros before the first one of a run.
    """

    acceleration_m_s2: Vector

    @property
    def nodes(self) -> tuple[int, ...]:
        """Node-IDs of the sensor on the bus; empty for a serial one."""
        ...

    def open(self) -> None:
        """Find the sensor and check that it is the right one.

        Raises:
            HilError: The sensor is silent, or is another device.
        """
        ...

    def configure(self) -> Mapping[int, FrameHandler]:
        """Prepare the sensor for a run.

        Returns:
            Functions that take its frames, by the identifiers that are awaited after each SYNC.

        Raises:
            HilError: The sensor refuses, or measures in another unit than m/s².
        """
        ...

    def restore(self) -> list[str]:
        """Undo the changes of `configure`; return the refusals in words."""
        ...

    def has_measured(self, pending: Set[int], sync_s: float) -> bool:
        """True if the sensor has measured at the last SYNC.

        The value is then in `acceleration_m_s2`.

        Args:
            pending: Identifiers of the frames that have not come.
            sync_s: Time of SYNC by the master's clock; 0 in lock-step.
        """
        ...

    def close(self) -> None:
        """Release the sensor; a second call does nothing."""
        ...


class CanopenSensor:
    """A CANopen accelerometer (CiA 404) that answers each SYNC with a TPDO.

    Args:
        network: The bus.
        node: Node-ID of the sensor.
        profile: Profile with its expected identity.
    """

    def __init__(self, network: Network, node: int, profile: Profile) -> None:
        self.acceleration_m_s2: Vector = (0.0, 0.0, 0.0)
        self._network, self._node, self._profile = network, node, profile
        self._pdos = PdoSet(network, node)
        self._scale_m_s2 = 1.0
        self._can_id = 0

    @property
    def nodes(self) -> tuple[int, ...]:
        """Node-ID of the sensor, as a tuple of one."""
        return (self._node,)

    def open(self) -> None:
        """Check the identity of the sensor.

        Raises:
            NoAnswerError: The sensor is silent.
            WrongIdentityError: The sensor is another device than its profile says.
        """
        check_identity(self._network, self._node, self._profile)

    def configure(self) -> Mapping[int, FrameHandler]:
        """Map the three channels into TPDO1.

        Raises:
            NodeError: The sensor measures in another unit than m/s², or its channels differ in their scale.
        """
        self.acceleration_m_s2 = (0.0, 0.0, 0.0)
        self._scale_m_s2 = self._read_scale_m_s2()
        self._can_id = self._pdos.tpdo(1, mapping.ACCELERATION)
        return {self._can_id: self._take}

    def _read_scale_m_s2(self) -> float:
        """Read the scale of the process values in m/s² per step.

        It must be the same for all three channels.
        """
        node, scales = self._node, set()
        for sub in (1, 2, 3):
            unit = self._network.read(node, UNIT_OBJECT, sub, U32, "physical unit")
            if unit != METRE_PER_SECOND_SQUARED:
                raise NodeError(node, f"channel {sub} measures in unit 0x{unit:08X}, m/s² is 0x{METRE_PER_SECOND_SQUARED:08X}")
            scales.add(10.0 ** -self._network.read(node, DIGITS_OBJECT, sub, U8, "decimal digits"))
        if len(scales) != 1:
            raise NodeError(node, f"its channels have different scales: {sorted(scales)} m/s² per step")
        return float(scales.pop())

    def restore(self) -> list[str]:
        """Restore the TPDO of the sensor; return the refusals in words."""
        return self._pdos.restore()

    def has_measured(self, pending: Set[int], sync_s: float) -> bool:
        """True if the frame of the sensor has come."""
        return self._can_id not in pending

    def _take(self, data: bytes) -> bool:
        """Unpack the TPDO; False if its length is wrong."""
        if len(data) != _ACCELERATION.size:
            return False
        scale = self._scale_m_s2
        x, y, z = _ACCELERATION.unpack(data)
        self.acceleration_m_s2 = (x * scale, y * scale, z * scale)
        return True

    def close(self) -> None:
        """Do nothing: a node needs no release."""


class SerialSensor:
    """An accelerometer on a serial port; time must be the wall clock's.

    Args:
        network: The bus beside which it measures.
        reader: Reader of the port, on the master's clock.
    """

    nodes: tuple[int, ...] = ()

    def __init__(self, network: Network, reader: AccelerometerReader) -> None:
        self.acceleration_m_s2: Vector = (0.0, 0.0, 0.0)
        self._network, self._reader = network, reader

    def open(self) -> None:
        """Open the port and wait for the first sample.

        Raises:
            SerialAccelerometerError: Nothing can be read, or the bus counts its time in SYNCs.
        """
        self._reader.open(is_lock_step=self._network.channel.is_lock_step)

    def configure(self) -> Mapping[int, FrameHandler]:
        """Await no frames, since the sensor sends none on the bus."""
        self.acceleration_m_s2 = (0.0, 0.0, 0.0)
        return {}

    def restore(self) -> list[str]:
        """Do nothing: `configure` has changed nothing."""
        return []

    def has_measured(self, pending: Set[int], sync_s: float) -> bool:
        """True if a sample belongs to the instant of SYNC."""
        value = self._reader.value_at_sync(sync_s)
        self.acceleration_m_s2 = value or self.acceleration_m_s2
        return value is not None

    def close(self) -> None:
        """Close the port."""
        self._reader.close()


class JointsOnly:
    """Replacement of a sensor at the tip by encoders of the joints.

    `hil.bench.load_encoder` computes the tip's acceleration from them after a motion.

    Attributes:
        acceleration_m_s2: Zeros: a single cycle of encoder angles has no acceleration.
        can_ids: Identifiers of the encoders' answers.
    """

    nodes: tuple[int, ...] = ()

    def __init__(self) -> None:
        self.acceleration_m_s2: Vector = (0.0, 0.0, 0.0)
        self.can_ids: frozenset[int] = frozenset()

    def open(self) -> None:
        """Do nothing: nothing is there."""

    def configure(self) -> Mapping[int, FrameHandler]:
        """Await no frames."""
        return {}

    def restore(self) -> list[str]:
        """Do nothing: `configure` has changed nothing."""
        return []

    def has_measured(self, pending: Set[int], sync_s: float) -> bool:
        """True if every encoder has answered."""
        return self.can_ids.isdisjoint(pending)

    def close(self) -> None:
        """Do nothing."""


def sensor_of(table: AccelerometerTable, network: Network, clock: Clock) -> TipAccelerometer:
    """The accelerometer that a bench file names; nothing is sent or opened.

    Raises:
        NotPossibleError: The bench file names no accelerometer, or its profile is that of another device.
    """
    if table.from_load_encoders:
        return JointsOnly()
    profile = Profile.load(table.profile)
    if profile.kind != "accelerometer":
        raise NotPossibleError(f"profile {table.profile} is no accelerometer")
    if table.serial is not None:
        return SerialSensor(network, AccelerometerReader(table.serial.settings(), clock.now))
    if table.node_id is None:
        raise NotPossibleError("the bench has no accelerometer")
    return CanopenSensor(network, table.node_id, profile)
