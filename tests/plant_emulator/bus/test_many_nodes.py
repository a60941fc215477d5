"""A bus that is full: 126 drives and the accelerometer, as nodes 1 to 127, boot, are found, and follow SYNC."""

import itertools
import json
import struct

import canopen
import pytest
from typer.testing import CliRunner

from drive_profiles.cli.main import app as drive_profiles
from drive_profiles.standard.cia301 import NmtCommand, NmtState
from hil.can.frame import Frame
from plant_emulator.announcement import announced, spans
from plant_emulator.bus.faults import BusFaults, Fault
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.bus.instant import FIRST_CLIENT
from plant_emulator.bus.medium import medium_for
from plant_emulator.bus.timed import TimedBus
from plant_emulator.bus.wire import EmulatedWire
from plant_emulator.world import World
from tests.plant_emulator.bus.conftest import wait_for
from tests.plant_emulator.many_axes import ACCELEROMETER, AXES, NODES, robot_file, robot_of

CLIENT = FIRST_CLIENT
SYNC = Frame(0x80, b"")
BOOT_UPS = [Frame(0x700 + node, b"\0") for node in NODES]
RESET = Frame(0, bytes((NmtCommand.RESET_COMMUNICATION, 0)))


@pytest.fixture(scope="module")
def robot():
    return robot_of(robot_file())


@pytest.fixture(scope="module")
def world(robot):
    """One for all tests, each of which begins with a reset."""
    made = World(robot)
    made.power_on()
    return made


@pytest.mark.slow
def test_127_nodes_boot_on_the_ideal_bus_lowest_identifier_first(world):
    assert world.node_ids == NODES
    assert world.power_on() == BOOT_UPS
    assert world.receive(RESET) == BOOT_UPS
    assert all(drive.slave.nmt_state is NmtState.PRE_OPERATIONAL for drive in world.drives.values())


@pytest.mark.slow
def test_on_a_bus_with_bit_times_127_boot_ups_arbitrate_and_none_is_lost(world):
    made = TimedBus(world, EmulatedWire(1_000_000, now_ns=world.now))
    made.wire.attach(CLIENT)
    made.offer(CLIENT, RESET)
    reset, *boots = made.drain()
    assert [h.frame for h in boots] == BOOT_UPS
    gaps = [after.end_ns - before.end_ns for before, after in itertools.pairwise(boots)]
    assert min(gaps) >= 55_000
    assert max(gaps) <= 66_000  # back to back, stuff bits included
    assert boots[-1].end_ns - reset.end_ns < 9_000_000


@pytest.mark.ci
def test_every_one_of_127_nodes_answers_who_it_is_and_each_has_an_identity_of_its_own(world):
    serials = []
    for node in NODES:
        [answer] = world.receive(Frame(0x600 + node, b"\x40\x18\x10\x04\x00\x00\x00\x00"))
        assert answer.can_id == 0x580 + node
        serials.append(answer.data[4:])
    assert len(set(serials)) == len(NODES)


@pytest.mark.ci
def test_127_nodes_sample_at_one_sync_and_their_tpdos_leave_in_order(world):
    channel = InProcessChannel(world, medium_for(world, 1_000_000))
    channel.send(RESET)
    for node in AXES:
        for sub, data in ((1, struct.pack("<I", 0x8000_0180 + node)), (2, b"\1"), (1, struct.pack("<I", 0x180 + node))):
            world.drives[node].slave.dictionary.write(0x1800, sub, data)
    channel.send(Frame(0, bytes((NmtCommand.START, 0))))
    while channel.receive_all(0.0):
        pass
    for node in NODES:
        world._ports[node].slave.dictionary.write(0x1006, 0, struct.pack("<I", 20_000))
    channel.send(SYNC)
    heard = [frame.can_id for frame in channel.receive_all(0.0)]
    assert heard == [0x180 + node for node in NODES]
    world.receive(RESET)


def test_a_lost_node_is_the_one_of_127_that_went_bus_off(world):
    now_s = 1e-9 * world.now
    made = TimedBus(
        world, EmulatedWire(1_000_000, faults=BusFaults([Fault(kind="bus_off", port=77, from_s=now_s + 1e-6)]), now_ns=world.now)
    )
    made.wire.attach(CLIENT)
    made.run(world.now + 2_000)
    made.offer(CLIENT, RESET)
    assert [h.frame.can_id for h in made.drain()[1:]] == [0x700 + node for node in NODES if node != 77]
    world.power_cycle(77)


@pytest.mark.slow
def test_scan_and_the_canopen_package_find_127_nodes_of_a_served_robot(serve, tmp_path):
    (tmp_path / "many.toml").write_text(robot_file())
    process, path = serve("--robot", str(tmp_path / "many.toml"))
    assert process.stdout.readline() == "nodes 1-126: emulated_drive\n"
    result = CliRunner().invoke(drive_profiles, ["scan", "--bus", f"local:{path}", "--json", "--timeout-s", "10"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert [node["node"] for node in found] == NODES
    assert [node["profiles"] for node in found] == [["emulated_drive"]] * len(AXES) + [["emulated_accelerometer"]]
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05
    network.connect(interface="hil_local", channel=str(path))
    try:
        network.scanner.search()
        wait_for(lambda: len(network.scanner.nodes) >= len(NODES), 20.0)
        assert sorted(network.scanner.nodes) == NODES
    finally:
        network.disconnect()


def test_of_many_drives_those_with_equal_words_are_said_together(robot, world):
    assert list(announced(robot, world, "local:x")) == [
        "serving many on local:x: 126 axes at nodes 1-126, accelerometer at node 127",
        "nodes 1-126: emulated_drive",
    ]


def test_drives_of_one_kind_share_what_never_changes(world):
    first, other = (world.drives[number].slave.dictionary for number in (1, 2))
    shared = sum(a is b for a, b in zip(first, other, strict=True))
    assert shared > 0.8 * len(first)
    assert first.get(0x1018, 4) != other.get(0x1018, 4)


# -- what a robot file may ask for -------------------------------------------------------------------------------------


def test_an_axis_beyond_the_nodes_of_a_bus_is_refused():
    with pytest.raises(ValueError, match="126"):
        robot_of(robot_file([127]))


def test_who_shares_a_node_id_is_named():
    text = robot_file([16]).replace(f"node_id = {ACCELEROMETER}", "node_id = 16")
    with pytest.raises(ValueError, match="node-ID 16 is given to two nodes of the bus, axis 16 and the accelerometer"):
        robot_of(text)


def test_drives_that_the_file_calls_unconfigured_wait_for_lss():
    text = robot_file([1, 2, 3], more="[axis.{number}.behaviour]\nunconfigured = true\n").replace(
        f"node_id = {ACCELEROMETER}", f"node_id = {ACCELEROMETER}\nunconfigured = true"
    )
    robot = robot_of(text)
    assert robot.unconfigured == {1, 2, 3, ACCELEROMETER}
    made = World(robot)
    assert made.power_on() == []
    assert made.receive(Frame(0x7E5, b"\x4c" + bytes(7))) == [Frame(0x7E4, b"\x50" + bytes(7))] * 4
    assert made.receive(Frame(0x601, b"\x40\x00\x10\x00\x00\x00\x00\x00")) == []


def test_a_served_robot_says_what_is_not_as_usual():
    text = robot_file([1, 2], more="[axis.{number}.behaviour]\nunconfigured = true\nsdo_delay_ms = 2.5\n")
    robot = robot_of(text)
    lines = announced(robot, World(robot), "local:x")
    assert list(lines) == [
        "serving many on local:x: axis 1 at node 1 (without a node-ID: LSS), axis 2 at node 2 (without a node-ID: LSS), "
        "accelerometer at node 127",
        "node 1: emulated_drive",
        "  behaviour: sdo_delay_ms = 2.5, unconfigured = true",
        "node 2: emulated_drive",
        "  behaviour: sdo_delay_ms = 2.5, unconfigured = true",
    ]


@pytest.mark.parametrize(("numbers", "text"), [((), ""), ((4,), "4"), ((3, 1, 2), "1-3"), ((1, 2, 4, 9, 8), "1-2, 4, 8-9")])
def test_numbers_are_said_in_spans(numbers, text):
    assert spans(numbers) == text
