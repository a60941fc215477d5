"""The emulated accelerometer on a serial line.

It samples the tip at a rate of its own, and uses the two framings of docs/serial.md.

The frames are built from that page alone, without the master's code, so a test of the master compares two implementations.
"""

import functools
import operator
import struct
from collections.abc import Callable

import numpy as np

from hil.can.frame import Frame
from plant_emulator.motion.axes import tip_sensor
from plant_emulator.robots.robot import Robot
from plant_emulator.world import SECOND, World

SYNC_BYTES = b"\xaa\x55"
COUNTS_PER_M_S2 = 1000.0
LINE_BYTES = 128
"""Bytes that a sensor's transmitter keeps without a reader; older samples are lost, as on a wire."""
_BODY = struct.Struct("<Hhhh")
_COUNTER_MODULO = 1 << 16
_LIMIT = 2**15 - 1

Vector = tuple[float, float, float]


def line_frame(counter: int, acceleration: Vector) -> bytes:
    r"""Return ``$ACC,counter,x,y,z*XX\r\n`` in m/s².

    XX is the exclusive or of the characters between $ and *, in hexadecimal.
    """
    body = f"ACC,{counter},{acceleration[0]:.5f},{acceleration[1]:.5f},{acceleration[2]:.5f}".encode("ascii")
    return b"$%s*%02X\r\n" % (body, functools.reduce(operator.xor, body))


def binary_frame(counter: int, acceleration: Vector) -> bytes:
    """Return a binary frame.

    It is AA 55, counter and x, y, z in mm/s² as little-endian 16-bit words, then the CRC-16 of Modbus over all that, low
    byte first.
    """
    counts = (max(-_LIMIT, min(_LIMIT, round(value * COUNTS_PER_M_S2))) for value in acceleration)
    body = SYNC_BYTES + _BODY.pack(counter, *counts)
    return body + struct.pack("<H", _modbus(body))


def _modbus(data: bytes) -> int:
    """Return the CRC-16 with reflected polynomial A001h from FFFFh.

    Source: MODBUS over serial line V1.02, 6.2.2.
    """
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


FRAMES: dict[str, Callable[[int, Vector], bytes]] = {"line": line_frame, "binary": binary_frame}


class EmulatedSerialAccelerometer:
    """The sensor, sans IO; it sends a frame every period.

    It has the noise, resolution and range of the robot file's accelerometer, and a generator of its own, so that what the node on
    the bus measures does not depend on it.

    Attributes:
        due: The world's time of the next sample, in ns.
        write: Called with each frame; set it to the port's writer.
    """

    def __init__(self, robot: Robot, rate_hz: float, framing: str) -> None:
        """Make the sensor.

        Args:
            rate_hz: Samples per second of the world's time.
            framing: A key of `FRAMES`.
        """
        setting = robot.accelerometer
        generator = np.random.default_rng((robot.seed, 1))
        self._sensor = tip_sensor(setting, generator)
        self._period_ns = SECOND / rate_hz
        self._frame = FRAMES[framing]
        self.samples = 0
        self.write: Callable[[bytes], object] = lambda frame: None

    @property
    def due(self) -> int:
        """Instant of the next sample."""
        return round(self.samples * self._period_ns)

    def sample(self, acceleration: Vector) -> None:
        """Measure, and write a frame."""
        self.write(self._frame(self.samples % _COUNTER_MODULO, self._sensor.sample(acceleration)))
        self.samples += 1


class MeasuredWorld(World):
    """A world that stops at each sample of a serial accelerometer."""

    def __init__(self, robot: Robot, sensor: EmulatedSerialAccelerometer) -> None:
        self._serial = sensor
        super().__init__(robot)

    @property
    def due(self) -> int:
        """Next instant at which a node acts or a sample is due."""
        due, sample = super().due, max(self.now, self._serial.due)
        return sample if due is None else min(due, sample)

    def move(self, until: int) -> list[tuple[int, Frame]]:
        """Let time pass up to `due`; take the sample that is due."""
        frames = super().move(until)
        if self._serial.due <= until:
            self._serial.sample(self.axes.sensed_acceleration())
        return frames
