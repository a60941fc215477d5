"""The accelerometer as a run uses it, on the bus or on a serial port: the same questions, the same answers."""

import struct

import pytest

from drive_profiles.standard.cia301 import DataType
from hil.bench.bench import load_bench
from hil.bench.sensors import AccelerometerTable
from hil.can.frame import Frame
from hil.errors import NodeError, NotPossibleError, WrongIdentityError
from hil.master.cyclic import CyclicExchange
from hil.master.network import Network
from hil.master.realtime import Clock
from hil.master.sensor import DIGITS_OBJECT, UNIT_OBJECT, CanopenSensor, SerialSensor, TipAccelerometer, sensor_of
from hil.recording import BusLog
from hil.sensor.accelerometer import AccelerometerReader, SerialAccelerometerError
from hil.sensor.table import SerialTable
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World

NODE, TPDO1 = 16, 0x190
FRAME = struct.pack("<hhh", 1000, -2000, 3)
SERIAL = SerialTable(port="/dev/null", baud_rate=9600, framing="line", fields=("x", "y", "z"), sample_rate_hz=100.0)


@pytest.fixture
def network() -> Network:
    return Network(InProcessChannel(World(load_robot("reference"))), BusLog(None), 0.05, 0.002)


@pytest.fixture
def on_bus(network: Network) -> TipAccelerometer:
    return sensor_of(load_bench("reference").accelerometer, network, Clock())


class Reader:
    """A reader whose samples the test knows: by the SYNC that asks."""

    def __init__(self, samples: dict[float, tuple[float, float, float]]) -> None:
        self.samples = samples

    def value_at_sync(self, sync_s: float) -> tuple[float, float, float] | None:
        return self.samples.get(sync_s)


def test_a_node_and_a_serial_port_are_two_sensors_of_one_protocol(network: Network, on_bus: TipAccelerometer) -> None:
    serial = sensor_of(AccelerometerTable(serial=SERIAL), network, Clock())
    assert (type(on_bus), type(serial)) == (CanopenSensor, SerialSensor)
    assert (on_bus.nodes, serial.nodes) == ((NODE,), ())
    assert serial.configure().can_id is None
    assert serial.restore() == []


def test_a_node_is_awaited_after_each_sync_and_gets_its_tpdo_back(network: Network, on_bus: TipAccelerometer) -> None:
    before = [network.read_raw(NODE, 0x1A00, sub) for sub in range(4)]
    on_bus.open()
    assert on_bus.configure().can_id == TPDO1
    assert network.read(NODE, 0x1A00, 0, DataType.UNSIGNED8) == 3
    assert on_bus.restore() == []
    assert [network.read_raw(NODE, 0x1A00, sub) for sub in range(4)] == before


def test_a_frame_of_a_node_counts_where_it_is_whole(network: Network, on_bus: TipAccelerometer) -> None:
    exchange = CyclicExchange(network, [], on_bus, 0.002, loop="drive", with_notch_state=False)
    exchange.configure()
    assert exchange.take(Frame(TPDO1, FRAME[:-1]))
    assert exchange.tip_m_s2 == (0.0, 0.0, 0.0)
    exchange.exchange()
    assert exchange.sensor_missed == 1, "the node is not operational"
    network.channel.passes = lambda frame: False
    network.channel.hand_over(Frame(TPDO1, FRAME))
    exchange.exchange()
    assert exchange.tip_m_s2 == pytest.approx((1.0, -2.0, 0.003))
    assert exchange.sensor_missed == 1


@pytest.mark.parametrize(
    ("index", "value", "words"), [(UNIT_OBJECT, 0x00010000, "unit 0x00010000"), (DIGITS_OBJECT, 1, "have different scales")]
)
def test_a_node_that_measures_something_else_is_refused(
    network: Network, on_bus: TipAccelerometer, monkeypatch: pytest.MonkeyPatch, index: int, value: int, words: str
) -> None:
    read = network.read

    def other(node: int, at: int, sub: int, kind: DataType, name: str = "") -> object:
        return value if (at, sub) == (index, 2) else read(node, at, sub, kind, name)

    monkeypatch.setattr(network, "read", other)
    with pytest.raises(NodeError, match=words):
        on_bus.configure()


def test_another_device_at_its_node_is_refused(network: Network) -> None:
    table = load_bench("reference").accelerometer.model_copy(update={"node_id": 2})
    with pytest.raises(WrongIdentityError, match="node 2"):
        sensor_of(table, network, Clock()).open()


def test_a_profile_of_another_kind_of_device_is_refused(network: Network) -> None:
    table = load_bench("reference").accelerometer.model_copy(update={"profile": "emulated_drive"})
    with pytest.raises(NotPossibleError, match="emulated_drive is not an accelerometer"):
        sensor_of(table, network, Clock())


def test_a_serial_sensor_that_is_silent_leaves_its_last_value_and_the_next_run_begins_without(network: Network) -> None:
    sensor = SerialSensor(network, Reader({0.0: (1.0, 2.0, 3.0)}))  # type: ignore[arg-type]
    assert sensor.sample(5.0) is None
    first, second = (CyclicExchange(network, [], sensor, 0.002, loop="drive", with_notch_state=False) for _ in range(2))
    first.configure()
    first.exchange()
    assert (first.tip_m_s2, first.sensor_missed) == ((1.0, 2.0, 3.0), 0)
    sensor._reader.samples.clear()
    first.exchange()
    assert (first.tip_m_s2, first.sensor_missed) == ((1.0, 2.0, 3.0), 1)
    second.configure()
    assert second.tip_m_s2 == (0.0, 0.0, 0.0)


def test_a_serial_sensor_is_refused_where_time_is_counted_in_syncs(network: Network) -> None:
    with pytest.raises(SerialAccelerometerError, match="counts time in SYNCs"):
        SerialSensor(network, AccelerometerReader(SERIAL)).open()
