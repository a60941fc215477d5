"""A world behind a wire with bit times: when frames end, when nodes hear them, and what happens when they do not fit."""

import pytest

from drive_profiles.standard.cia301 import NmtCommand
from hil.can.bits import frame_bits
from hil.can.frame import Frame
from plant_emulator.bus.faults import BusFaults, Fault
from plant_emulator.bus.instant import FIRST_CLIENT, Instant
from plant_emulator.bus.medium import medium_for
from plant_emulator.bus.timed import TimedBus
from plant_emulator.bus.wire import EmulatedWire
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World

SYNC = Frame(0x80, b"")
CLIENT = FIRST_CLIENT
ROBOT = load_robot("reference")
SDO_READ_TYPE = Frame(0x602, b"\x40\x00\x10\x00\x00\x00\x00\x00")


def bus(bitrate=1_000_000, *, latency_ns=0, faults=None, cyclic=(2, 3, 5), period_s=0.002):
    """A timed bus with one client; these nodes are operational and send their first TPDO with each SYNC."""
    world = World(ROBOT.model_copy(update={"sync_period_s": period_s}))
    made = TimedBus(world, EmulatedWire(bitrate, faults=faults), latency_ns)
    made.wire.attach(CLIENT)
    world.power_on()
    for node in (*cyclic, 16):
        dictionary = next(n for n in world._nodes if n.node_id == node).slave.dictionary
        dictionary.write(0x1800, 1, (0x8000_0180 + node).to_bytes(4, "little"))
        dictionary.write(0x1800, 2, b"\1")
        dictionary.write(0x1800, 1, (0x180 + node).to_bytes(4, "little"))
        made.offer(CLIENT, Frame(0, bytes((NmtCommand.START, node))))
    made.drain()
    made.run(made.world.now + 1_000_000)  # the intermission, too, is over
    return made


def test_a_request_and_its_answer_take_their_bits_and_the_answer_begins_when_the_request_has_been_heard():
    made = bus()
    began = made.world.now
    made.offer(CLIENT, SDO_READ_TYPE)
    request, answer = made.drain()
    assert (request.port, answer.port) == (CLIENT, 2)
    # the end of a frame is heard before its intermission of 3 bits is over
    assert request.end_ns - began == (frame_bits(SDO_READ_TYPE) - 3) * 1000
    assert answer.end_ns - began == (frame_bits(SDO_READ_TYPE) + frame_bits(answer.frame) - 3) * 1000
    assert answer.frame.can_id == 0x582


def test_host_latency_comes_before_the_first_bit():
    late, prompt = bus(latency_ns=70_000), bus()
    begins = late.world.now, prompt.world.now
    late.offer(CLIENT, SDO_READ_TYPE)
    prompt.offer(CLIENT, SDO_READ_TYPE)
    assert late.drain()[0].end_ns - begins[0] == prompt.drain()[0].end_ns - begins[1] + 70_000


def test_after_a_sync_the_answers_come_by_identifier_one_after_the_other_and_time_stops_at_the_next_beat():
    made = bus()
    began = made.world.now
    [heard] = made.cycle(CLIENT, SYNC)
    assert [h.frame.can_id for h in heard] == [0x80, 0x182, 0x183, 0x185, 0x190]
    ends = [h.end_ns - began for h in heard]
    bits = [frame_bits(h.frame) for h in heard]
    assert ends == [1000 * (sum(bits[: i + 1]) - 3) for i in range(len(bits))]
    assert made.world.now == began + 2_000_000


def test_set_points_before_sync_do_not_move_the_beat():
    made = bus()
    began = made.world.now
    made.cycle(CLIENT, SYNC)
    made.offer(CLIENT, Frame(0x202, b"\x06\x00"))
    [heard] = made.cycle(CLIENT, SYNC)
    assert [h.frame.can_id for h in heard[:2]] == [0x202, 0x80]
    assert heard[1].end_ns == began + 2_000_000 + 1000 * (frame_bits(heard[0].frame) + frame_bits(SYNC) - 3)
    assert made.world.now == began + 4_000_000


@pytest.mark.parametrize(("bitrate", "fits"), [(1_000_000, True), (500_000, False), (250_000, False), (125_000, False)])
def test_a_cycle_that_does_not_fit_lags_behind_its_beats_and_one_that_does_loses_nothing(bitrate, fits):
    made = bus(bitrate, period_s=0.001)
    answers = 0
    made.begin_cycles()
    for _ in range(200):
        for node in (2, 3, 5):
            made.offer(CLIENT, Frame(0x200 + node, b"\x06\x00"))
        answers += sum(h.frame.can_id & 0x780 == 0x180 for h in made.cycle(CLIENT, SYNC)[0])
    if fits:
        assert answers == 4 * 200
        assert made.wire.statistics.refused == 0
    else:
        assert made.wire.statistics.longest_wait_ns >= 10_000_000
        assert made.wire.statistics.longest_queue > 50
        assert answers < 4 * 200
    assert made.wire.statistics.lost == 0


def test_nothing_is_kept_of_syncs_that_the_bus_refused():
    made = bus(cyclic=(), period_s=0.001)
    kept = {name: len(value) for name, value in vars(made).items() if hasattr(value, "__len__")}
    made.wire.switch_off(CLIENT)
    for _ in range(20):
        assert made.cycle(CLIENT, SYNC) == ([],)
    assert made.wire.statistics.refused == 20
    assert {name: len(value) for name, value in vars(made).items() if hasattr(value, "__len__")} == kept


def test_nothing_is_lost_at_95_percent_of_load():
    made = bus(cyclic=())
    frame = Frame(0x300, bytes(8))
    gap = round(1000 * frame_bits(frame) / 0.95)
    begin, offered, heard = made.world.now, 0, 0
    while made.world.now < begin + 1_000_000_000:
        made.offer(CLIENT, frame)
        offered += 1
        heard += sum(h.frame.can_id == 0x300 for h in made.run(made.world.now + gap))
    assert offered - heard <= 1


def test_a_frame_that_is_destroyed_is_sent_again_and_arrives_later():
    faults = BusFaults([Fault(kind="corrupt", can_id=0x602, attempts=1)])
    clean, disturbed = bus(), bus(faults=faults)
    ends = []
    for made in (clean, disturbed):
        began = made.world.now
        made.offer(CLIENT, SDO_READ_TYPE)
        ends.append(made.drain()[-1].end_ns - began)
    assert ends[1] > ends[0] + 1000 * frame_bits(SDO_READ_TYPE) // 2


def test_what_can_be_on_no_bus_is_not_sent_and_harms_nobody():
    made = bus()
    for frame in (Frame(0x2000_0004, bytes(8)), Frame(0x800, b"")):
        made.offer(CLIENT, frame)
    assert made.drain() == []


def test_the_simplest_medium_that_does_what_is_asked_for():
    world = World(ROBOT)
    assert isinstance(medium_for(world, None), Instant)
    assert isinstance(medium_for(world, 500_000), TimedBus)
    assert isinstance(medium_for(world, None, wall=True), TimedBus)
    assert medium_for(world, None, wall=True).bitrate is None


@pytest.mark.ci
def test_equal_worlds_behind_equal_wires_hear_equal_frames_at_equal_instants():
    def history():
        faults = [Fault(kind="drop", probability=0.1), Fault(kind="delay", delay_ns=50_000, probability=0.2)]
        made = bus(500_000, faults=BusFaults(faults, seed=3), period_s=0.001)
        return [h for _ in range(100) for h in made.cycle(CLIENT, SYNC)[0]]

    assert history() == history()


def test_a_heartbeat_of_the_client_leaves_with_its_next_sync_and_does_not_move_the_beat():
    made = bus()
    for node in made.world._nodes:
        node.slave.dictionary.set(0x1006, 0, 2000)
    made.cycle(CLIENT, SYNC)
    beat = made.world.now
    assert made.frame(CLIENT, Frame(0x701, b"\5")) == []
    assert made.world.now == beat
    [heard] = made.cycle(CLIENT, SYNC)
    assert [h.frame.can_id for h in heard[:2]] == [0x701, 0x80]
    assert made.world.now == beat + 2_000_000


def test_a_fault_that_is_to_come_keeps_nobody_waiting():
    ends = []
    for faults in (None, BusFaults([Fault(kind="mute", port=5, from_s=5.0)])):
        made = bus(faults=faults)
        made.offer(CLIENT, SDO_READ_TYPE)
        made.drain()
        ends.append(made.world.now)
    assert ends[0] == ends[1]


def test_what_was_delayed_before_does_not_stretch_the_beats_and_what_is_asked_is_waited_for():
    made = bus(
        faults=BusFaults(
            [Fault(kind="delay", can_id=0x182, delay_ns=40_000_000), Fault(kind="delay", can_id=0x583, delay_ns=3_000_000)]
        )
    )
    made.cycle(CLIENT, SYNC)
    beat = made.world.now
    heard = made.frame(CLIENT, SDO_READ_TYPE)
    assert [h.frame.can_id for h in heard] == [0x602, 0x582]
    assert made.world.now < beat + 1_000_000
    heard = made.frame(CLIENT, Frame(0x603, SDO_READ_TYPE.data))
    assert [h.frame.can_id for h in heard] == [0x603, 0x583]
    assert beat + 3_000_000 < made.world.now < beat + 4_000_000
    late = made.free(beat + 50_000_000)
    assert 0x182 in [h.frame.can_id for h in late]


def test_on_a_fd_bus_a_cycle_takes_less_time_than_on_a_classic_one():
    ends = []
    for rates in ((1_000_000, None), (1_000_000, 5_000_000)):
        world = World(ROBOT)
        medium = medium_for(world, *rates)
        medium.join(CLIENT)
        world.power_on()
        for node in (2, 3, 5, 16):
            dictionary = next(n for n in world._nodes if n.node_id == node).slave.dictionary
            dictionary.write(0x1800, 1, (0x8000_0180 + node).to_bytes(4, "little"))
            dictionary.write(0x1800, 2, b"\1")
            dictionary.write(0x1800, 1, (0x180 + node).to_bytes(4, "little"))
            medium.frame(CLIENT, Frame(0, bytes((NmtCommand.START, node))))
        medium.begin_cycles()
        began = world.now
        [heard] = medium.cycle(CLIENT, SYNC)
        assert [h.frame.can_id for h in heard] == [0x80, 0x182, 0x183, 0x185, 0x190]
        ends.append(heard[-1].end_ns - began)
    assert ends[1] < 0.65 * ends[0]


def test_a_data_bit_rate_alone_is_refused():
    with pytest.raises(ValueError, match="data bit rate"):
        medium_for(World(ROBOT), None, 5_000_000)


def test_an_sdo_block_sent_at_once_finds_room_on_a_slow_bus():
    medium = medium_for(World(ROBOT), 125_000)
    medium.join(CLIENT)
    heard = []
    for number in range(127):  # the most segments of a block (CiA 301, 7.2.4.3.9)
        heard += medium.frame(CLIENT, Frame(0x1FF, bytes((number,))))
    heard += medium.idle()
    assert [frame.data[0] for frame, port, _ in heard if port == CLIENT] == list(range(127))
