"""The world's clock, its determinism, and what holds the robot while nobody commands it."""

import math
import random
import struct
import tracemalloc
from types import SimpleNamespace

import canopen.lss
import pytest

from drive_profiles.standard.cia402 import Mode, Object, State
from hil.can.frame import Frame
from plant_emulator.robots.robot import load_robot
from plant_emulator.slave.node import Slave
from plant_emulator.world import World
from tests.plant_emulator.rig import CONTROL, COUNTS_PER_REV, GAINS, MS, POSITION, STATUS, TARGET, TORQUE, Rig, Stranger

REFERENCE = load_robot("reference")
WITH_GAINS = REFERENCE.model_copy(
    update={"axis": {n: a.model_copy(update={"control": GAINS}) for n, a in REFERENCE.axis.items()}}
)
SYNC = Frame(0x080, b"")
SECOND = 1000 * MS
ACCELEROMETER = 16


def started(robot=REFERENCE):
    world = World(robot)
    world.power_on()
    return world


def expedited(node, index, sub, data):
    return Frame(0x600 + node, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub) + data.ljust(4, b"\0"))


def write(world, node, index, sub, data):
    answers = world.receive(expedited(node, index, sub, data))
    assert [f.data[0] for f in answers if f.can_id == 0x580 + node] == [0x60]


def test_all_nodes_boot_in_the_order_of_their_identifiers():
    assert World(REFERENCE).power_on() == [Frame(0x700 + node, b"\0") for node in (2, 3, 5, ACCELEROMETER)]


# -- the clock ---------------------------------------------------------------------------------------------------------


def test_each_sync_is_worth_the_robot_files_period():
    world = started()
    for i in range(1, 6):
        world.receive(SYNC)
        assert world.now == (i - 1) * 2 * MS  # the answers are those of this instant …
        world.finish_period()
        assert world.now == i * 2 * MS  # … and then the period passes


@pytest.mark.parametrize("period_us", [250, 1000, 4000])
def test_1006h_of_a_node_decides_what_a_sync_is_worth(period_us):
    world = started()
    write(world, 3, 0x1006, 0, struct.pack("<I", period_us))
    world.receive(SYNC)
    world.finish_period()
    assert world.now == period_us * 1000


@pytest.mark.parametrize(
    ("period_us", "code"), [(300, 0x06090030), (50, 0x06090030), (1_000_001, 0x06090031), (0, None), (750, None)]
)
def test_a_drive_takes_a_1006h_of_whole_control_periods_up_to_a_second(period_us, code):
    world = started()
    [answer] = world.receive(expedited(3, 0x1006, 0, struct.pack("<I", period_us)))
    assert (answer.data[0] == 0x60) == (code is None)
    assert code is None or int.from_bytes(answer.data[4:], "little") == code


def test_of_several_periods_the_shortest_counts_and_0_does_not():
    world = started()
    for node, period_us in ((2, 4000), (3, 1000), (5, 0), (ACCELEROMETER, 2000)):
        write(world, node, 0x1006, 0, struct.pack("<I", period_us))
    assert world.period_ns == 1 * MS


@pytest.mark.parametrize("data", [b"", b"\x01"], ids=["plain", "with counter"])
def test_a_sync_with_a_counter_is_a_sync(data):
    world = started()
    world.receive(Frame(0x080, data))
    world.finish_period()
    assert world.now == 2 * MS


@pytest.mark.parametrize("flag", [0x4000_0000, 0x8000_0000, 0x2000_0000], ids=["remote", "extended", "error"])
def test_what_only_looks_like_a_sync_moves_no_time(flag):
    world = started()
    assert world.receive(Frame(0x080 | flag, b"")) == []
    assert world.finish_period() == []
    assert world.now == 0


def test_a_frame_that_comes_before_the_period_has_passed_finds_it_passed():
    world = started()
    world.receive(SYNC)
    world.receive(Frame(0x123, b""))
    assert world.now == 2 * MS
    world.finish_period()
    assert world.now == 2 * MS


def test_time_never_goes_back():
    world = started()
    world.advance(5 * MS)
    with pytest.raises(ValueError, match="does not go back"):
        world.advance(4 * MS)
    world.advance(5 * MS)
    assert world.now == 5 * MS


def test_lock_step_begins_on_a_whole_second():
    world = started()
    world.begin_lock_step()
    assert world.now == 0  # which it is already
    world.free_step(1_234_567_891)
    world.begin_lock_step()
    assert world.now == 2 * SECOND


@pytest.mark.ci
def test_free_steps_and_one_step_make_the_same_world():
    one, many = Rig(WITH_GAINS), Rig(WITH_GAINS)
    for rig in (one, many):
        rig.enable(Mode.PP)
        rig.set(Object.TARGET_POSITION, 0, COUNTS_PER_REV)
        rig.word(0x1F)
    one.world.advance(300 * MS)
    many.world.free_step(300 * MS)
    assert one.world.axes.plant_state.tobytes() == many.world.axes.plant_state.tobytes()


# -- heartbeats --------------------------------------------------------------------------------------------------------


def test_heartbeats_count_in_the_worlds_clock():
    world = started()
    write(world, 3, 0x1017, 0, struct.pack("<H", 10))
    beats = []
    for _ in range(50):
        world.receive(SYNC)
        beats += [world.now for f in world.finish_period() if f.can_id == 0x703]
    assert beats == [10 * MS * i for i in range(1, 11)]


def test_a_watched_heartbeat_is_lost_in_the_worlds_clock():
    rig = Rig(WITH_GAINS)
    rig.set(0x1016, 1, 127 << 16 | 30)
    rig.cyclic(Mode.CSP)
    rig.heartbeat()
    rig.sync(14)
    assert rig.drive.state is State.OPERATION_ENABLED
    rig.sync(1)
    assert rig.drive.state is State.QUICK_STOP_ACTIVE


def test_frames_of_one_instant_come_lowest_identifier_first():
    world = started()
    for node in (5, 3, ACCELEROMETER, 2):
        write(world, node, 0x1017, 0, struct.pack("<H", 10))
    world.receive(Frame(0x000, b"\x01\x00"))
    world.finish_period()
    frames = world.advance(10 * MS)
    assert [f.can_id for f in frames if f.can_id >= 0x700] == [0x702, 0x703, 0x705, 0x710]


# -- determinism -------------------------------------------------------------------------------------------------------


def run(rig, free_run_ns):
    """Some time by itself, set-up, and a short run in lock-step: its frames."""
    rig.world.free_step(free_run_ns)
    rig.set(0x1017, 0, 100)
    rig.map_pdo(0x1400, (CONTROL, TARGET))
    rig.map_pdo(0x1800, (STATUS, POSITION, TORQUE))
    rig.set(Object.MODES_OF_OPERATION, 0, Mode.CSP)
    rig.nmt(1, node=0)
    rig.world.begin_lock_step()
    rig.seen.clear()
    for word in (0x06, 0x07, 0x0F):
        rig.cycle(0, word)
    rig.turn(4.0, 0.4)
    assert rig.drive.state is State.OPERATION_ENABLED
    return [(f.can_id, f.data) for f in rig.seen]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_same_seed_gives_the_same_frames_however_long_the_world_ran_by_itself(seed):
    """Up to the enabling the arm hangs in its brakes: a free run of any length leaves no trace."""
    length = random.Random(seed).randrange(1, 3 * SECOND)
    first, second = run(Rig(WITH_GAINS), 0), run(Rig(WITH_GAINS), length)
    assert len(first) > 400
    assert {0x183, 0x190, 0x703} <= {can_id for can_id, _ in first}
    assert first == second


def test_another_seed_changes_the_accelerometer_and_nothing_else():
    def frames(seed):
        return run(Rig(WITH_GAINS.model_copy(update={"seed": seed})), 0)

    first, other = frames(1), frames(2)
    assert [f for f in first if f[0] != 0x190] == [f for f in other if f[0] != 0x190]
    assert [f for f in first if f[0] == 0x190] != [f for f in other if f[0] == 0x190]


# -- the robot ---------------------------------------------------------------------------------------------------------


def test_brakes_hold_the_arm_against_gravity():
    world = started()
    before = world.axes.plant_state.copy()
    world.free_step(2 * SECOND)
    after = world.axes.plant_state
    assert (after["motor_angle_rad"] == before["motor_angle_rad"]).all()
    assert (after["motor_speed_rad_s"] == 0.0).all()
    assert abs(after["arm_angle_rad"] - before["arm_angle_rad"]).max() < 1e-12
    assert abs(after["arm_speed_rad_s"]).max() < 1e-12


def test_a_brake_that_closes_on_a_moving_axis_stops_its_motor_and_the_arm_settles():
    rig = Rig(WITH_GAINS)
    rig.cyclic(Mode.CSP)
    rig.turn(5.0, 0.5)
    rig.word(0x00)
    rig.wait(1)
    assert rig.speed_rps == 0.0
    held = float(rig.plant["motor_angle_rad"])
    rig.wait(5000)
    assert float(rig.plant["motor_angle_rad"]) == held
    assert abs(float(rig.plant["arm_speed_rad_s"])) < 1e-4


def test_axes_that_are_not_enabled_do_not_move_with_one_that_is():
    rig = Rig(WITH_GAINS)
    rig.cyclic(Mode.CSP)
    before = rig.world.axes.plant_state["motor_angle_rad"].copy()
    rig.turn(5.0, 0.3)
    moved = rig.world.axes.plant_state["motor_angle_rad"] != before
    assert moved.tolist() == [number == 3 for number in rig.world.axes.numbers]


def test_a_drive_that_ends_its_stop_during_a_free_run_says_so_then_and_not_at_its_end():
    rig = Rig(WITH_GAINS)
    rig.enable(Mode.CSP)
    rig.set(0x1017, 0, 10)
    rig.wait(1)
    rig.word(0x02)
    frames = rig.world.begin_lock_step()
    said = next(i for i, f in enumerate(frames) if f.can_id == 0x183 and f.data[0] & 0x6F == 0x40)
    beats = [f.can_id for f in frames].count(0x703)
    assert beats == 100
    assert [f.can_id for f in frames[:said]].count(0x703) < 10


@pytest.mark.slow
@pytest.mark.parametrize("can_id", [0x000, 0x080, 0x203, 0x603, 0x7FF, 0x8000_0603, 0x2000_0004, 0xFFFF_FFFF])
@pytest.mark.parametrize("data", [b"", b"\xff" * 8, b"\x81\x00", b"\x2f" + b"\0" * 7])
def test_no_frame_makes_the_world_raise(can_id, data):
    world = started()
    world.receive(Frame(can_id, data))
    world.finish_period()
    world.free_step(world.now + 20 * MS)


# -- who hears a frame -------------------------------------------------------------------------------------------------


def read(world, node, index, sub=0):
    answers = world.receive(Frame(0x600 + node, struct.pack("<BHBI", 0x40, index, sub, 0)))
    return next(f.data[4:] for f in answers if f.can_id == 0x580 + node)


def test_a_frame_reaches_a_node_at_the_identifier_that_it_has_been_given_last():
    world = started()
    world.receive(Frame(0, b"\x01\x00"))
    world.receive(Frame(0x203, b"\x06\x00"))
    assert world.drives[3].state is State.READY_TO_SWITCH_ON
    world.receive(Frame(0x333, b"\x07\x00"))  # nobody's
    write(world, 3, 0x1400, 1, struct.pack("<I", 0x8000_0203))
    write(world, 3, 0x1400, 1, struct.pack("<I", 0x333))
    world.receive(Frame(0x203, b"\x07\x00"))
    assert world.drives[3].state is State.READY_TO_SWITCH_ON
    world.receive(Frame(0x333, b"\x07\x00"))
    assert world.drives[3].state is State.SWITCHED_ON
    # two nodes at one identifier hear both
    write(world, 5, 0x1400, 1, struct.pack("<I", 0x8000_0205))
    write(world, 5, 0x1400, 1, struct.pack("<I", 0x333))
    world.receive(Frame(0x333, b"\x06\x00"))
    assert [world.drives[n].state for n in (2, 3, 5)] == [State.SWITCH_ON_DISABLED, *[State.READY_TO_SWITCH_ON] * 2]


def test_a_node_that_stops_and_one_that_starts_again_hear_what_their_state_lets_them():
    world = started()
    world.receive(Frame(0, b"\x01\x00"))
    for _ in range(2):
        world.receive(Frame(0, b"\x02\x03"))
        assert world.receive(Frame(0x603, bytes(8))) == []  # stopped: no SDO
        world.receive(Frame(0, b"\x01\x03"))
        assert len(world.receive(Frame(0x603, b"\x40\x00\x10\0\0\0\0\0"))) == 1
        assert world.power_cycle(3) == [Frame(0x703, b"\0")]
        world.receive(Frame(0x203, b"\x06\x00"))
        assert world.drives[3].state is State.SWITCH_ON_DISABLED  # pre-operational: no PDO
        world.receive(Frame(0, b"\x01\x03"))
        world.receive(Frame(0x203, b"\x06\x00"))
        assert world.drives[3].state is State.READY_TO_SWITCH_ON
        world.receive(Frame(0x203, b"\x00\x00"))


def test_a_deadline_of_another_node_is_served_before_the_frame_that_comes_after_it():
    world = started()
    write(world, 2, 0x1017, 0, struct.pack("<H", 100))
    world.now += 150 * MS  # the caller comes late
    assert world.hear(Frame(0x605, b"\x40\x00\x10\0\0\0\0\0")) == [
        (2, Frame(0x702, b"\x7f")),
        (5, Frame(0x585, b"\x43\x00\x10\x00\x92\x01\x02\x00")),
    ]
    assert world.due == 200 * MS


def test_what_a_node_has_to_say_leaves_with_the_next_frame_whomever_that_is_for():
    world = started()
    assert world.due is None
    world.drives[3].slave.emergencies.raise_cause("owner", 0x5000)
    assert world.due == world.now
    assert [(node, frame.can_id) for node, frame in world.hear(Frame(0x605, bytes(8)))] == [(3, 0x083), (5, 0x585)]
    assert world.due is None
    world.drives[3].slave.emergencies.clear_cause("owner")
    assert [frame.can_id for frame in world.advance(world.now + 10 * MS)] == [0x083]
    assert world.due is None


def test_a_due_that_changes_is_known_at_once():
    world = started()
    assert world.due is None
    write(world, 2, 0x1017, 0, struct.pack("<H", 100))
    assert world.due == 100 * MS
    write(world, 3, 0x1017, 0, struct.pack("<H", 30))
    assert world.due == 30 * MS
    write(world, 3, 0x1017, 0, struct.pack("<H", 0))
    assert world.due == 100 * MS
    world.receive(Frame(0, b"\x81\x02"))
    assert world.due is None


def test_identifiers_that_nobody_listens_to_leave_nothing_behind():
    world = started()
    world.receive(Frame(0x7FF, b""))
    tracemalloc.start()
    try:
        for can_id in range(0x8000_0000, 0x8000_4000):
            world.receive(Frame(can_id, b""))
        left, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert left < 10_000


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_world_in_which_every_node_is_given_every_frame_is_no_other(seed, monkeypatch):
    rng = random.Random(seed)
    frames = [rng.choice(STIMULI)(rng, rng.choice((2, 3, 5, ACCELEROMETER))) for _ in range(1500)]

    def run():
        world, said = started(WITH_GAINS), []
        for number, frame in enumerate(frames):
            said.append(world.hear(frame) if number % 7 == 0 else world.receive(frame))
            if number % 11 == 0:
                said.append(world.free_step(world.now + number * 1000))
        return said, world.axes.motion.tobytes(), world.axes.plant_state.tobytes()

    routed = run()
    monkeypatch.setattr(Slave, "listens", lambda self, can_id: True)
    assert run() == routed
    assert sum(map(len, routed[0])) > 500


def _sdo(rng, node):
    index, sub, layout, value = rng.choice(
        (
            (0x1017, 0, "H", rng.choice((0, 7, 20))),
            (0x1016, 1, "I", rng.choice((0, 0x7F_0014))),
            (0x1400, 1, "I", rng.choice((0x8000_0200, 0x200, 0x310)) + node),
            (0x1800, 1, "I", rng.choice((0x8000_0180, 0x180)) + node),
            (0x1800, 2, "B", rng.choice((0, 1, 3, 255))),
            (0x1005, 0, "I", rng.choice((0x80, 0x80, 0x81))),
            (0x6060, 0, "b", rng.choice((1, 8, 10))),
            (0x6040, 0, "H", rng.choice((6, 7, 15))),
        )
    )
    return expedited(node, index, sub, struct.pack("<" + layout, value))


STIMULI = (
    lambda rng, node: SYNC,
    lambda rng, node: SYNC,
    lambda rng, node: Frame(0x200 + node, struct.pack("<H", rng.choice((0, 6, 7, 15, 15, 2, 128)))),
    lambda rng, node: Frame(rng.choice((0x310, 0x81, 0x77F)) + rng.choice((0, node)), b"\x06\x00"),
    lambda rng, node: Frame(0x77F, b"\x05"),
    lambda rng, node: Frame(0, bytes((rng.choice((1, 1, 1, 1, 2, 128, 129, 130)), rng.choice((0, node))))),
    _sdo,
    _sdo,
)


# -- what is read is what is there -------------------------------------------------------------------------------------


def test_what_a_drive_shows_is_what_the_arrays_hold_at_that_instant():
    world = started(WITH_GAINS)
    drive, axes = world.drives[3], world.axes
    row = drive.row
    for counts in (0, -7, 123_456):
        axes.plant_state["motor_angle_rad"][row] = counts / axes.motion["counts_per_rad"][row]
        assert read(world, 3, Object.POSITION_ACTUAL) == struct.pack("<i", counts)
    for torque in (0.0, 1.25, -2.5):
        axes.motion[row]["torque_nm"] = torque
        assert read(world, 3, 0x2130) == struct.pack("<f", torque)
        assert read(world, 3, Object.TORQUE_ACTUAL)[:2] == struct.pack("<h", round(1000 * torque / drive.scaling.rated_torque_nm))
    for column in (0, 1):
        state = axes.notch_state[row, column]
        state["frequency_hz"], state["zeta_rd"] = 12.5, 0.25
        for active in (0, 1):
            state["active"] = active
            shown = [read(world, 3, 0x2112 + column, sub) for sub in (1, 2, 3)]
            assert shown[0][0] == active
            assert shown[1:] == [struct.pack("<f", active * 12.5), struct.pack("<f", active * 0.25)]
    axes.motion[row]["following_count"] = 3
    assert read(world, 3, Object.STATUS_WORD)[1] & 0x20
    axes.motion[row]["following_count"] = 0
    assert not read(world, 3, Object.STATUS_WORD)[1] & 0x20


def test_a_limit_that_breaks_is_seen_in_the_same_step():
    world = started(WITH_GAINS)
    world.axes.motion[1]["trip"] = 1
    assert [frame.can_id for frame in world.free_step(world.now + MS)] == [0x083]
    assert world.drives[3].state is State.FAULT
    assert not world.axes.motion["trip"].any()


def test_the_encoder_shows_the_counts_that_the_law_works_with():
    axes, rng = started().axes, random.Random(1)
    for _ in range(300):
        axes.plant_state["motor_angle_rad"][1] = angle = rng.choice((1e-5, 1.0, 1e4)) * rng.uniform(-1.0, 1.0)
        assert axes.counts(1) == math.floor(angle * axes.motion["counts_per_rad"][1] + 0.5)


# -- node-IDs that an LSS master gives ---------------------------------------------------------------------------------


def lss(world, *data):
    return world.receive(Frame(0x7E5, bytes(data).ljust(8, b"\0")))


def give(world, serial_number, node_id):
    """Select an emulated drive by its identity, give it a node-ID, store it; what comes when it goes back to waiting."""
    for service, value in zip((0x40, 0x41, 0x42, 0x43), (0x48494C01, 0x402, 1, serial_number), strict=True):
        answers = lss(world, service, *struct.pack("<I", value))
    assert [frame.data[0] for frame in answers] == [0x44]
    assert lss(world, 0x11, node_id) == [Frame(0x7E4, b"\x11" + bytes(7))]
    assert lss(world, 0x17) == [Frame(0x7E4, b"\x17" + bytes(7))]
    return lss(world, 0x04, 0)


def test_nodes_without_a_node_id_are_silent_until_an_lss_master_gives_them_one():
    world = World(REFERENCE, unconfigured=(3, 5))
    assert [frame.can_id for frame in world.power_on()] == [0x702, 0x700 + ACCELEROMETER]
    assert lss(world, 0x4C) == [Frame(0x7E4, b"\x50" + bytes(7))] * 2  # on a bus the two are one frame
    assert world.receive(Frame(0x000, b"\x82\x00")) == [Frame(0x702, b"\0"), Frame(0x700 + ACCELEROMETER, b"\0")]
    assert give(world, 3, 40) == [Frame(0x728, b"\0")]
    assert give(world, 5, 41) == [Frame(0x729, b"\0")]
    assert lss(world, 0x4C) == []
    assert read(world, 40, 0x1014) == struct.pack("<I", 0x80 + 40)
    assert world.drives[3].node_id == 40
    assert world.power_cycle(41) == [Frame(0x729, b"\0")]
    assert world.power_cycle(5) == [Frame(0x729, b"\0")]  # by its port
    world.receive(Frame(0, b"\x01\x00"))
    world.receive(Frame(0x228, b"\x06\x00"))
    assert world.drives[3].state is State.READY_TO_SWITCH_ON


def test_two_nodes_swap_their_node_ids_and_keep_their_ports():
    world = started()
    for serial, node_id in ((2, 3), (3, 2)):
        assert give(world, serial, node_id) == []
    assert world.receive(Frame(0x000, b"\x82\x00")) == [Frame(0x700 + node, b"\0") for node in (2, 3, 5, ACCELEROMETER)]
    assert (world.drives[2].node_id, world.drives[3].node_id) == (3, 2)
    assert world.node_ids == [2, 3, 5, ACCELEROMETER]
    request = Frame(0x603, b"\x40\x18\x10\x04\0\0\0\0")
    assert world.hear(request) == [(2, Frame(0x583, b"\x43\x18\x10\x04\x02\0\0\0"))]
    write(world, 3, 0x1017, 0, struct.pack("<H", 10))
    world.advance(9 * MS)
    assert world.move(10 * MS) == [(2, Frame(0x703, b"\x7f"))]


def test_who_is_not_there_cannot_be_without_a_node_id_or_lose_its_supply():
    with pytest.raises(ValueError, match="no node 99"):
        World(REFERENCE, unconfigured=(99,))
    with pytest.raises(ValueError, match="no node 99"):
        started().power_cycle(99)


def test_every_node_has_an_identity_of_its_own():
    slaves = [drive.slave for drive in started().drives.values()] + [started().accelerometer.slave]
    assert len({tuple(slave.lss.address) for slave in slaves}) == len(slaves) == 4


def test_a_stranger_finds_all_unconfigured_nodes_by_fast_scan(monkeypatch):
    monkeypatch.setattr(canopen.lss, "time", SimpleNamespace(sleep=lambda seconds: None))
    monkeypatch.setattr(canopen.lss.LssMaster, "RESPONSE_TIMEOUT", 0)
    rig = Rig(WITH_GAINS)
    rig.world = World(WITH_GAINS, unconfigured=(2, 3, 5, ACCELEROMETER))
    assert rig.world.power_on() == []
    network, found = Stranger(rig), []
    for node_id in (11, 12, 13, 14):
        is_found, identity = network.lss.fast_scan()
        assert is_found
        found.append(identity)
        network.lss.configure_node_id(node_id)
        network.lss.send_switch_state_global(network.lss.WAITING_STATE)
    assert found == sorted(found)  # of those that remain the one with the smallest address answers to the end
    assert network.lss.fast_scan() == (False, None)
    assert sorted(drive.node_id for drive in rig.world.drives.values()) == [11, 12, 13]
    assert rig.world.accelerometer.node_id == 14
