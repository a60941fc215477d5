"""A controller that goes bus-off takes its node with it: what the node then does, hears and says, and how it comes back."""

import struct

import pytest

from drive_profiles.standard.cia301 import NmtCommand, NmtState
from drive_profiles.standard.cia402 import Mode, Object, State
from hil.can.frame import Frame
from plant_emulator.bus.confinement import RECOVERY_BITS
from plant_emulator.bus.controller import ErrorState
from plant_emulator.bus.faults import BusFaults, Fault
from plant_emulator.bus.instant import FIRST_CLIENT
from plant_emulator.bus.timed import TimedBus
from plant_emulator.bus.wire import EmulatedWire
from plant_emulator.robots.behaviour import Behaviour
from plant_emulator.world import World
from tests.plant_emulator.rig import NODE, ONE_AXIS, Rig

CLIENT = FIRST_CLIENT
MS = 1_000_000
SYNC = Frame(0x80, b"")
OFF_NS, BACK_NS = 21 * MS, 61 * MS
OFF = Fault(kind="bus_off", port=NODE, from_s=0.021, to_s=0.061)
RECOVERED = [Frame(0x80 + NODE, b"\x40\x81\x11" + bytes(5)), Frame(0x80 + NODE, bytes(8))]
READ_TYPE = Frame(0x600 + NODE, b"\x40\x00\x10\x00\x00\x00\x00\x00")


def robot_with(**behaviour):
    axis = ONE_AXIS.axis[NODE].model_copy(update={"behaviour": Behaviour(**behaviour)})
    return ONE_AXIS.model_copy(update={"axis": {NODE: axis}})


def bus(*faults, bitrate=1_000_000, robot=ONE_AXIS, heartbeat_ms=5, behaviour_1029h=0):
    """A timed bus with one client and one drive that is operational and sends heartbeats."""
    world = World(robot)
    made = TimedBus(world, EmulatedWire(bitrate, faults=BusFaults(faults)))
    made.wire.attach(CLIENT)
    world.power_on()
    dictionary = world.drives[NODE].slave.dictionary
    dictionary.write(0x1017, 0, struct.pack("<H", heartbeat_ms))
    dictionary.write(0x1029, 1, bytes((behaviour_1029h,)))
    made.offer(CLIENT, Frame(0, bytes((NmtCommand.START, 0))))
    made.run(4 * MS)
    return made


def of_the_drive(heard):
    return [(h.frame, h.end_ns) for h in heard if h.port == NODE]


@pytest.mark.parametrize("bitrate", [1_000_000, 125_000, None])
def test_a_node_is_silent_and_deaf_from_bus_off_until_its_controller_is_back_and_then_says_so(bitrate):
    made = bus(OFF, bitrate=bitrate)
    before = of_the_drive(made.run(OFF_NS + 10_000))
    assert [f.can_id for f, _ in before] == [0x703] * 4
    made.offer(CLIENT, READ_TYPE)
    made.offer(CLIENT, Frame(0, bytes((NmtCommand.START, NODE))))
    assert of_the_drive(made.run(BACK_NS - 1)) == []
    assert made.world.drives[NODE].slave.nmt_state is NmtState.PRE_OPERATIONAL  # by 1029h, and the start was not heard
    after = of_the_drive(made.run(BACK_NS + 20 * MS))
    assert [f for f, _ in after][:2] == RECOVERED
    assert {f for f, _ in after[2:]} == {Frame(0x703, bytes((NmtState.PRE_OPERATIONAL,)))}
    recovery_ns = 0 if bitrate is None else RECOVERY_BITS * 1_000_000_000 // bitrate
    assert after[0][1] >= BACK_NS + recovery_ns
    made.offer(CLIENT, READ_TYPE)
    assert [f.can_id for f, _ in of_the_drive(made.drain())] == [0x583]


@pytest.mark.parametrize(
    ("behaviour", "state"), [(0, NmtState.PRE_OPERATIONAL), (1, NmtState.OPERATIONAL), (2, NmtState.STOPPED)]
)
def test_1029h_says_what_bus_off_makes_of_the_nmt_state(behaviour, state):
    made = bus(OFF, behaviour_1029h=behaviour)
    made.run(OFF_NS - 1)
    assert made.world.drives[NODE].slave.nmt_state is NmtState.OPERATIONAL
    made.run(OFF_NS + 1)
    assert made.world.drives[NODE].slave.nmt_state is state
    made.run(BACK_NS + 5 * MS)
    assert made.world.drives[NODE].slave.nmt_state is state


def test_the_node_is_told_at_the_instant_however_far_time_is_let_pass():
    told = []
    made = bus(OFF)
    slave = made.world.drives[NODE].slave
    for name in ("bus_off", "bus_recovered"):
        hook = getattr(slave, name)
        setattr(slave, name, lambda name=name, hook=hook: (told.append((name, made.world.now)), hook()))
    made.run(BACK_NS + 50 * MS)
    assert told == [("bus_off", OFF_NS), ("bus_recovered", BACK_NS)]


def test_bus_off_by_errors_on_the_wire_is_bus_off_to_the_node():
    made = bus(Fault(kind="corrupt", can_id=0x703, attempts=40))
    made.run(20 * MS)
    assert made.wire.controller(NODE).state is ErrorState.OFF
    assert made.world.drives[NODE].slave.nmt_state is NmtState.PRE_OPERATIONAL
    assert of_the_drive(made.run(500 * MS)) == []  # nothing brings it back


def test_a_drive_that_restarts_its_controller_comes_back_by_itself():
    made = bus(Fault(kind="bus_off", port=NODE, from_s=0.021), robot=robot_with(bus_off_restart_ms=30.0))
    assert of_the_drive(made.run(OFF_NS + 30 * MS))[-1][1] < OFF_NS
    frames = [f for f, _ in of_the_drive(made.run(OFF_NS + 40 * MS))]
    assert frames[:2] == RECOVERED


def test_the_supply_taken_away_and_given_back_ends_bus_off_without_a_word_about_it():
    made = bus(Fault(kind="bus_off", port=NODE, from_s=0.021))
    made.run(OFF_NS + 5 * MS)
    assert made.world.power_cycle(NODE) == [Frame(0x703, b"\0")]
    assert of_the_drive(made.run(OFF_NS + 50 * MS)) == []
    made.offer(CLIENT, READ_TYPE)
    assert [f.can_id for f, _ in of_the_drive(made.drain())] == [0x583]


def test_a_client_that_is_bus_off_is_no_nodes_concern():
    made = bus(Fault(kind="bus_off", port=CLIENT, from_s=0.021, to_s=0.061))
    heard = of_the_drive(made.run(BACK_NS))
    assert [f.can_id for f, _ in heard] == [0x703] * 12
    assert made.world.drives[NODE].slave.nmt_state is NmtState.OPERATIONAL


@pytest.mark.parametrize(
    ("option", "first", "last"),
    [
        (0, State.OPERATION_ENABLED, State.OPERATION_ENABLED),
        (1, State.FAULT_REACTION_ACTIVE, State.FAULT),
        (2, State.SWITCH_ON_DISABLED, State.SWITCH_ON_DISABLED),
        (3, State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED),
    ],
)
def test_an_enabled_drive_reacts_as_6007h_says_and_hears_no_more_set_points(option, first, last):
    rig = Rig()
    rig.set(Object.ABORT_CONNECTION_OPTION, 0, option)
    rig.cyclic(Mode.CSP)
    rig.turn(4.0, 0.3)
    rig.world.bus_off(NODE)
    rig.world.bus_off(NODE)  # nothing more
    assert rig.drive.state is first
    rig.sync(200)
    if last is not State.OPERATION_ENABLED:  # which holds the last set-point, and comes to rest in its own time
        assert abs(rig.speed_rps) < 1e-3
    assert rig.drive.state is last
    assert rig.send(0x600 + NODE, READ_TYPE.data) == []
    assert rig.sync(10) == []
    said = 1 if last is State.FAULT else 2  # a fault stays until it is reset
    assert rig.world.bus_recovered(NODE) == [(NODE, frame) for frame in RECOVERED[:said]]
    assert rig.world.bus_recovered(NODE) == []
    assert rig.state is last


def test_a_deadline_of_a_node_that_is_bus_off_delays_nobody_elses_answers():
    world = World(ONE_AXIS)
    world.power_on()
    world.drives[NODE].slave.dictionary.write(0x1017, 0, struct.pack("<H", 10))
    world.bus_off(NODE)
    world.now += 50 * MS  # the caller comes late
    assert [port for port, _ in world.hear(Frame(0x610, READ_TYPE.data))] == [16]
    assert world.move(world.now) == []


def test_a_port_that_is_no_nodes_is_refused():
    world = World(ONE_AXIS)
    for call in (world.bus_off, world.bus_recovered):
        with pytest.raises(ValueError, match="port 99"):
            call(99)
    assert world.bus_off_restart_ns(16) is None


def test_a_port_can_be_switched_off_and_restarted_by_hand_now_or_later():
    made = bus()
    made.wire.switch_off(NODE)
    made.run(5 * MS)
    assert made.world.drives[NODE].slave.nmt_state is NmtState.PRE_OPERATIONAL
    with pytest.raises(ValueError, match="cannot restart a port"):
        made.wire.restart(NODE, 1 * MS)
    made.wire.restart(NODE, 9 * MS)
    assert of_the_drive(made.run(9 * MS)) == []
    assert [f for f, _ in of_the_drive(made.run(11 * MS))][:2] == RECOVERED
