"""The emulated accelerometer on a serial line: its bytes, its times, and what it measures."""

import contextlib
import re
import struct
import subprocess
import sys

import numpy as np
import pytest
import serial

from drive_profiles.standard.cia301 import FunctionCode
from hil.can.frame import Frame
from plant_emulator.serial.accelerometer import FRAMES, EmulatedSerialAccelerometer, MeasuredWorld, binary_frame, line_frame
from plant_emulator.world import World
from tests.plant_emulator.rig import ONE_AXIS

MS = 1_000_000


@contextlib.contextmanager
def served(folder, *options):
    """`plant-emulator serve` as a process, with a serial accelerometer; the path of its port."""
    path = folder / "acc.tty"
    command = [sys.executable, "-m", "plant_emulator", "serve", "--bus", f"local:{folder / 'robot.sock'}"]
    process = subprocess.Popen(
        [*command, "--serial-accelerometer", str(path), *options],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        while "serial accelerometer at" not in (line := process.stdout.readline()):
            assert line, process.communicate()[1]
        yield path
    finally:
        process.terminate()
        process.communicate(timeout=10)


def measured(framing="line", rate_hz=1000.0, robot=ONE_AXIS):
    sensor = EmulatedSerialAccelerometer(robot, rate_hz, framing)
    written = []
    sensor.write = written.append
    world = MeasuredWorld(robot, sensor)
    world.power_on()
    return world, sensor, written


def test_the_line_is_what_the_page_says():
    line = line_frame(7, (1.5, -0.25, 9.80665))
    assert line == b"$ACC,7,1.50000,-0.25000,9.80665*72\r\n"
    remainder = 0x72
    for byte in b"ACC,7,1.50000,-0.25000,9.80665":
        remainder ^= byte
    assert remainder == 0


def test_the_binary_frame_is_what_the_page_says():
    frame = binary_frame(0x1234, (1.5, -0.25, 40.0))
    assert frame[:10] == bytes.fromhex("aa55 3412 dc05 06ff ff7f")  # the last one stands at the end of its range
    # the CRC of a frame with its CRC is zero
    register = 0xFFFF
    for byte in frame:
        for bit in range(8):
            feedback = (register ^ byte >> bit) & 1
            register = register >> 1 ^ 0xA001 * feedback
    assert register == 0


def test_samples_are_taken_at_their_instants_whatever_the_steps():
    for steps in ((100 * MS,), (1 * MS,) * 100, (333_333,) * 300 + (100_000,)):
        world, sensor, written = measured()
        for step in steps:
            world.advance(world.now + step)
        assert sensor.samples == len(written) == 101  # at 0 and every millisecond
        assert sensor.due == 101 * MS


def test_a_rate_that_is_no_whole_number_of_nanoseconds_does_not_drift():
    world, sensor, _ = measured(rate_hz=3333.3)
    world.advance(3_000 * MS)
    assert sensor.samples == 10_000


def test_the_counter_begins_anew():
    _, sensor, written = measured("binary")
    sensor.samples = 0xFFFF
    sensor.sample((0.0, 0.0, 0.0))
    sensor.sample((0.0, 0.0, 0.0))
    assert [struct.unpack_from("<H", frame, 2)[0] for frame in written] == [0xFFFF, 0]


def test_it_measures_the_tip_with_the_noise_of_the_robot_file():
    world, _, written = measured()
    world.axes.sensed_acceleration = lambda: (1.0, 0.0, -2.0)
    world.advance(2_000 * MS)
    values = np.array([[float(v) for v in frame[1:-5].split(b",")[2:]] for frame in written])
    setting = ONE_AXIS.accelerometer
    assert values.mean(axis=0) == pytest.approx((1.0, 0.0, -2.0), abs=0.005)
    step = setting.resolution_m_s2
    expected = np.hypot(setting.noise_m_s2, step / np.sqrt(12.0))
    assert values.std(axis=0) == pytest.approx((expected,) * 3, rel=0.1)


def test_the_bus_does_not_notice_it():
    def frames(world):
        sent = world.power_on()
        sent += world.receive(Frame(FunctionCode.NMT, b"\1\0"))
        for _ in range(50):
            sent += world.receive(Frame(FunctionCode.SYNC, b"")) + world.finish_period()
        return sent

    measured_world = MeasuredWorld(ONE_AXIS, EmulatedSerialAccelerometer(ONE_AXIS, 777.0, "binary"))
    assert frames(measured_world) == frames(World(ONE_AXIS))


@pytest.mark.slow
@pytest.mark.parametrize("framing", FRAMES)
def test_a_user_reads_a_thousand_samples_a_second(tmp_path, framing):
    with served(tmp_path, "--framing", framing) as path, serial.Serial(str(path), timeout=5.0) as port:
        port.read(port.in_waiting)
        data = b""
        while len(data) < 500 * {"line": 40, "binary": 12}[framing]:  # so many make 400 at least
            data += port.read(64)
    if framing == "line":
        lines = data.split(b"\r\n")[1:-1]
        assert all(re.fullmatch(rb"\$ACC,\d+(,-?\d+\.\d{5}){3}\*[0-9A-F]{2}", line) for line in lines)
        counters = [int(line.split(b",")[1]) for line in lines]
    else:
        start = data.index(b"\xaa\x55")
        frames = [data[i : i + 12] for i in range(start, len(data) - 12, 12)]
        assert all(frame[:2] == b"\xaa\x55" for frame in frames)
        counters = [struct.unpack_from("<H", frame, 2)[0] for frame in frames]
    gaps = np.diff(counters)
    assert np.count_nonzero(gaps != 1) <= 1  # the one behind what was thrown away at the beginning
    assert len(counters) > 400
