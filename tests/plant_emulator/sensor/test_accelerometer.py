"""The accelerometer at the tip as a CiA 404 node: what it says, when, and that nothing else on the bus changes it."""

import math
import struct

import numpy as np
import pytest

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Mode, Object
from hil.can.frame import Frame
from plant_emulator.physics.tip import TipSensor
from plant_emulator.robots.robot import RobotAccelerometer as SensorTable
from plant_emulator.sensor.accelerometer import AccelerometerNode
from tests.plant_emulator.rig import ONE_AXIS, Rig

NODE = 16
TPDO = 0x180 + NODE
VALUE, UNIT, DIGITS, STATUS = 0x7130, 0x6131, 0x6132, 0x6150
RANGE = 19.62


class Bench:
    """The node alone, with what it shall feel."""

    def __init__(self, range_m_s2=RANGE):
        self.felt = (0.0, 0.0, 0.0)
        self.node = AccelerometerNode(NODE, lambda: self.felt, range_m_s2)
        self.now = 0
        self.boot = self.node.power_on(0)

    def send(self, can_id, data=b""):
        return self.node.slave.receive(Frame(can_id, bytes(data)), self.now)

    def sync(self):
        self.node.sample()
        return self.send(0x080)

    def feel(self, *acceleration):
        self.felt = acceleration
        (frame,) = self.sync()
        assert frame.can_id == TPDO
        return struct.unpack("<hhh", frame.data)

    def read(self, index, sub, layout):
        (answer,) = self.send(0x600 + NODE, struct.pack("<BHB4x", 0x40, index, sub))
        return struct.unpack_from(layout, answer.data, 4)[0]

    def write(self, index, sub, data):
        (answer,) = self.send(0x600 + NODE, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub) + data.ljust(4, b"\0"))
        return None if answer.data[0] == 0x60 else SdoAbortCode(int.from_bytes(answer.data[4:], "little"))


@pytest.fixture
def bench():
    bench = Bench()
    bench.send(0x000, (1, NODE))
    return bench


def test_it_boots_and_says_that_it_is_a_cia_404_device():
    bench = Bench()
    assert bench.boot == [Frame(0x700 + NODE, b"\0")]
    assert bench.read(0x1000, 0, "<I") & 0xFFFF == 404


def test_each_sync_brings_x_y_and_z_in_steps_of_a_thousandth(bench):
    assert bench.feel(1.2344, -2.5, 0.0) == (1234, -2500, 0)
    assert bench.feel(-0.0006, 0.0004, 9.81) == (-1, 0, 9810)


def test_unit_and_digits_say_how_to_read_the_values(bench):
    values = bench.feel(1.5, -2.5, 3.5)
    for sub, (value, felt) in enumerate(zip(values, (1.5, -2.5, 3.5), strict=True), 1):
        assert bench.read(UNIT, sub, "<I") == 0x00015700  # CiA 303-2: m, over s²
        digits = bench.read(DIGITS, sub, "<B")
        assert value * 10.0**-digits == pytest.approx(felt)
        assert bench.read(VALUE, sub, "<h") == value
    assert bench.read(VALUE, 0, "<B") == 3


def test_it_is_silent_until_nmt_starts_it():
    bench = Bench()
    bench.felt = (1.0, 1.0, 1.0)
    assert bench.sync() == []
    bench.send(0x000, (1, NODE))
    assert len(bench.sync()) == 1


def test_a_value_is_that_of_the_last_sync_whatever_is_asked_later(bench):
    bench.feel(1.0, 2.0, 3.0)
    bench.felt = (7.0, 8.0, 9.0)
    assert bench.read(VALUE, 1, "<h") == 1000
    assert bench.read(VALUE, 1, "<h") == 1000


@pytest.mark.parametrize("sign", [1, -1])
def test_at_the_end_of_its_range_the_channel_says_not_valid(bench, sign):
    assert bench.feel(sign * RANGE, sign * (RANGE - 0.001), 0.0)[0] == sign * 19620
    assert [bench.read(STATUS, sub, "<B") for sub in (1, 2, 3)] == [1, 0, 0]
    bench.feel(0.0, 0.0, 0.0)
    assert [bench.read(STATUS, sub, "<B") for sub in (1, 2, 3)] == [0, 0, 0]


@pytest.mark.parametrize(("felt", "shown"), [(32.767, 32767), (32.9, 32767), (-1e6, -32767)])
def test_beyond_its_numbers_the_value_stays_at_their_end(felt, shown):
    bench = Bench(range_m_s2=1e9)
    bench.send(0x000, (1, NODE))
    assert bench.feel(felt, 0.0, 0.0)[0] == shown


def test_the_widest_range_of_a_robot_file_fits_the_values():
    widest = next(m.le for m in SensorTable.model_fields["range_m_s2"].metadata if hasattr(m, "le"))
    assert widest * 1000 <= 32767


@pytest.mark.parametrize("index", [VALUE, UNIT, DIGITS, STATUS])
def test_what_it_measures_cannot_be_written(bench, index):
    assert bench.write(index, 1, b"\0") is SdoAbortCode.READ_ONLY


# -- the sensor behind it ----------------------------------------------------------------------------------------------


def test_the_sensor_adds_white_noise_of_the_stated_size_without_bias():
    sensor = TipSensor(0.02, 0.0, RANGE, np.random.default_rng(1))
    samples = np.array([sensor.sample((1.0, 0.0, -1.0)) for _ in range(20_000)])
    assert samples.std(axis=0) == pytest.approx([0.02] * 3, rel=0.03)
    assert samples.mean(axis=0) == pytest.approx([1.0, 0.0, -1.0], abs=5 * 0.02 / math.sqrt(20_000))
    centred = samples - samples.mean(axis=0)
    neighbours = (centred[1:] * centred[:-1]).mean(axis=0) / centred.var(axis=0)
    assert np.abs(neighbours).max() < 0.03
    assert np.abs(np.corrcoef(centred.T) - np.eye(3)).max() < 0.03


def test_the_sensor_gives_whole_steps_of_its_resolution_and_saturates():
    sensor = TipSensor(0.0, 0.00981, RANGE, np.random.default_rng(1))
    for true in (0.0, 0.004, 0.006, -0.123, 5.0):
        value = sensor.sample((true, 0.0, 0.0))[0]
        assert value / 0.00981 == pytest.approx(round(value / 0.00981), abs=1e-6)
        assert abs(value - true) <= 0.00981 / 2 + 1e-12
    assert sensor.sample((100.0, -100.0, 0.0))[:2] == (RANGE, -RANGE)


# -- in the world ------------------------------------------------------------------------------------------------------


def samples(rig, count, disturb=lambda i: None):
    rig.nmt(1, node=NODE)
    taken = []
    for i in range(count):
        disturb(i)
        taken += [f.data for f in rig.sync() if f.can_id == TPDO]
    assert len(taken) == count
    return taken


def seeded(seed):
    return Rig(ONE_AXIS.model_copy(update={"seed": seed}))


def test_the_same_seed_gives_the_same_noise_and_another_seed_another():
    first, again, other = (samples(seeded(seed), 100) for seed in (7, 7, 8))
    assert first == again
    assert first != other
    assert len(set(first)) > 50


def test_the_noise_does_not_depend_on_other_traffic():
    quiet, busy = seeded(7), seeded(7)

    def disturb(i):
        busy.read(Object.POSITION_ACTUAL)
        busy.send(0x600 + NODE, struct.pack("<BHB4x", 0x40, VALUE, 1))
        busy.send(0x123, b"\1\2\3")
        if i % 10 == 0:
            busy.nmt(1, node=NODE)
            busy.heartbeat()

    assert samples(quiet, 100) == samples(busy, 100, disturb)


def test_the_noise_does_not_depend_on_who_listens():
    """Stopped or started late, the node draws one sample per SYNC all the same."""
    early, late = seeded(7), seeded(7)
    wanted = samples(early, 60)[40:]
    late.sync(40)
    assert samples(late, 20) == wanted


def test_it_feels_the_arm_that_moves():
    rig = Rig(ONE_AXIS)
    rig.nmt(1, node=NODE)
    rig.cyclic(Mode.CSP)
    quiet = np.array([struct.unpack("<hhh", data) for data in samples(rig, 200)]) / 1000.0
    rig.turn(6.0, 0.25)
    lever, ratio = ONE_AXIS.axis[3].tip_lever_m, ONE_AXIS.axis[3].reduction_ratio
    frames = [f for f in rig.seen if f.can_id == TPDO][200:]
    moved = np.array([struct.unpack("<hhh", f.data) for f in frames]) / 1000.0
    wanted = lever * 20.0 * 2.0 * math.pi / ratio  # L θ̈ of the mean acceleration
    assert moved[:, 2].mean() == pytest.approx(wanted, rel=0.2)
    assert abs(quiet[100:, 2].mean()) < 0.01
