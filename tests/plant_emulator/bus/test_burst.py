"""A cycle that passes a wire at once is the same, to the bit, as one whose frames are offered one by one."""

import itertools
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.standard.cia402 import Mode
from hil.can.bits import frame_bits
from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, RECORD, Frame, frames_of, pack
from plant_emulator.bus.faults import BusFaults
from plant_emulator.bus.instant import FIRST_CLIENT
from plant_emulator.bus.timed import TimedBus
from plant_emulator.bus.wire import EmulatedWire
from plant_emulator.core import CORE
from tests.plant_emulator.image.test_image import INSIDE, OUTSIDE, POSITION, SPEED, STATUS, SYNC, Twin

NODES = (2, 3, 5)


class TimedTwin(Twin):
    """A robot on a wire twice: one gets every cycle as a message, the other frame by frame."""

    def __init__(self, bitrate=1_000_000, data_bitrate=None, faults=None, latency_ns=0):
        super().__init__()
        self.buses = []
        for world in (self.image, self.slaves):
            wire = EmulatedWire(bitrate, data_bitrate, faults=faults, now_ns=world.now)
            wire.attach(FIRST_CLIENT)
            self.buses.append(TimedBus(world, wire, latency_ns))

    def tell(self, can_id, data=b""):
        heard = []
        for bus in self.buses:
            mark = bus.wire.mark
            bus.offer(FIRST_CLIENT, Frame(can_id, bytes(data)))
            heard.append(bus.drain(mark))
        assert heard[0] == heard[1]
        self.compare()
        return [each.frame for each in heard[0] if each.port != FIRST_CLIENT]

    def cycle(self, *frames):
        together, (quick, slow) = [*frames, SYNC], self.buses
        message = b"".join(pack(frame) for frame in together)
        answers = quick.exchange(FIRST_CLIENT, message)
        if answers is None:
            answers = self.one_by_one(quick, together)
        else:
            self.plain += 1
            answers = frames_of(answers)
        assert answers == self.one_by_one(slow, together)
        self.compare()
        return answers

    @staticmethod
    def one_by_one(bus, frames):
        *rpdos, sync = frames
        for frame in rpdos:
            bus.offer(FIRST_CLIENT, frame)
        return [each.frame for each in bus.cycle(FIRST_CLIENT, sync)[0] if each.port != FIRST_CLIENT]

    def compare(self):
        super().compare()
        quick, slow = (bus.wire for bus in self.buses)
        assert quick.now == slow.now
        assert quick.due == slow.due
        assert quick.statistics == slow.statistics


def following(mode=Mode.CSP, nodes=NODES, **options):
    twin = TimedTwin(**options)
    for node in nodes:
        twin.prepare(node, mode)
    twin.start(*nodes)
    twin.enable(nodes, mode, cycles=3)
    return twin


@pytest.mark.parametrize("mode", [Mode.CSP, Mode.CST])
@pytest.mark.parametrize("options", [{}, {"bitrate": 500_000}], ids=str)
def test_random_set_points_cross_the_wire_alike(mode, options):
    nodes = NODES if options.get("bitrate") is None else (2,)
    twin, dice = following(mode, nodes, **options), random.Random(3)
    targets, before = dict.fromkeys(nodes, 0), twin.plain
    for _ in range(200):
        for node in nodes:
            targets[node] += dice.randint(-300, 300)
        twin.cycle(
            *(twin.command(node, 0x0F, mode, targets[node] if mode is Mode.CSP else dice.randint(-60, 60)) for node in nodes)
        )
    assert twin.plain - before == 200


def test_an_entry_that_the_core_does_not_know_is_sampled_at_the_sync():
    """The speed, 606Ch: the master gets it in the same cycle as the rest."""
    twin = TimedTwin()
    twin.prepare(2, told=((STATUS, POSITION), (SPEED,)))
    twin.start(2)
    twin.enable((2,), Mode.CSP, cycles=3)
    before = twin.plain
    for step in range(50):
        answers = twin.cycle(twin.command(2, target=20 * step))
    assert twin.plain - before == 50
    assert any(answer.can_id == 0x282 and int.from_bytes(answer.data, "little", signed=True) for answer in answers)


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.ci) for seed in range(2, 6))])
def test_whatever_else_comes_the_wire_is_the_same(seed):
    dice, twin = random.Random(seed), following()
    for _ in range(120):
        frames = [twin.command(node, offset=dice.randint(-80, 80)) for node in NODES]
        node, what = dice.choice(NODES), dice.randrange(16)
        if what == 0:
            dice.choice(OUTSIDE)(twin, node, dice)
        elif what == 1:
            frames.append(dice.choice(INSIDE)(twin, node, dice))
        elif what == 2:
            del frames[dice.randrange(3)]
        twin.cycle(*frames)
    assert twin.plain > 0


@pytest.mark.ci
def test_a_limit_that_breaks_while_the_frames_pass_ends_the_burst_and_not_the_cycle(monkeypatch):
    """The drive's emergency goes out between the client's frames, as it would without a burst."""
    seen, go_on = [], TimedBus._go_on

    def counted(bus, port, message, sent, until):
        seen.append(sum(end <= bus.world.now for end in ends_of(message, bus.wire.idle)))
        return go_on(bus, port, message, sent, until)

    monkeypatch.setattr(TimedBus, "_go_on", counted)
    for step in range(200, 4000, 400):
        twin = following()
        for world in (twin.image, twin.slaves):
            world.axes.motion["following_window_rad"], world.axes.motion["following_periods"] = 1e-4, 1
        for number in range(12):
            twin.cycle(*(twin.command(node, target=(number + 1) * step) for node in NODES))
    assert {1, 2, 3} & set(seen), "it broke between two frames"


OTHERS = {"latency_ns": 100_000}, {"faults": BusFaults(())}, {"data_bitrate": 2_000_000}


@pytest.mark.parametrize("options", OTHERS, ids=["latency", "faults", "CAN FD"])
def test_what_a_burst_does_not_know_goes_frame_by_frame(options):
    twin = following(nodes=(2,), **options)
    assert twin.plain == 0
    twin.cycle(twin.command(2))
    assert twin.plain == 0


def test_a_cycle_without_room_for_all_frames_goes_frame_by_frame():
    twin = following(bitrate=250_000)
    before = twin.plain
    for _ in range(20):
        twin.cycle(*(twin.command(node) for node in NODES))
    assert twin.plain == before


def test_answers_with_one_identifier_collide_on_the_wire():
    twin = following(nodes=(2, 3))
    twin.cycle(twin.command(2), twin.command(3))
    for step in ((0x1800, 1, 0x80000000 | 0x183, 4), (0x1800, 1, 0x182, 4)):
        assert twin.write(3, *step) == [0x60]
    before = twin.plain
    for _ in range(5):
        twin.cycle(twin.command(2), twin.command(3, offset=20))
    assert twin.plain == before
    assert twin.buses[0].wire.statistics.errors > 0


def ends_of(records, start):
    """The ends of frames that pass one behind the other at 1 Mbit/s."""
    ends = CORE.integers(len(records) // RECORD.size)
    CORE.call.frames_end(records, len(ends), start, 1000, ends)
    return list(ends)


def bits_in_a_row(records):
    """The bits of each frame of a message, intermission included."""
    return [(end - before) // 1000 for before, end in itertools.pairwise([-3000, *ends_of(records, 0)])]


@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=64))
def test_the_bits_of_a_message_are_those_of_its_frames(frames):
    records = b"".join(pack(Frame(*each)) for each in frames)
    assert bits_in_a_row(records) == [frame_bits(Frame(*each)) for each in frames]


def test_what_is_no_data_frame_with_a_short_identifier_has_no_bits_in_a_message():
    others = Frame(CAN_EFF_FLAG | 1, b""), Frame(CAN_RTR_FLAG | 0x181, b""), Frame(CAN_ERR_FLAG, bytes(8))
    assert bits_in_a_row(b"".join(map(pack, others)) + RECORD.pack(1, 9, bytes(8))) == [0, 0, 0, 0]
