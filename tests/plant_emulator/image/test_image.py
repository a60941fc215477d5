"""The process image does for drives that only follow what their slaves do, to the bit."""

import random
import struct

import numpy as np
import pytest

from drive_profiles.standard.cia402 import FOLLOWING_ERROR, FOLLOWS_COMMAND, INTERNAL_LIMIT, Mode, Object, State
from hil.can.frame import Frame, frames_of, pack
from plant_emulator.core import CORE
from plant_emulator.motion.record import NEGATIVE_SWITCH, POSITIVE_SWITCH
from plant_emulator.robots.fleet import draw
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World
from tests.plant_emulator.rig import GAINS

REFERENCE = load_robot("reference")
SYNC = Frame(0x80, b"")
STATUS, POSITION, TORQUE = 0x60410010, 0x60640020, 0x60770010
WORD, TARGET, TARGET_TORQUE, OFFSET = 0x60400010, 0x607A0020, 0x60710010, 0x60B20010
FILTER = (0x21120108, 0x21120220)
SPEED = 0x606C0020
MODES = {Mode.CSP: (WORD, TARGET, OFFSET), Mode.CST: (WORD, TARGET_TORQUE)}
LAYOUT = {Mode.CSP: "<Hih", Mode.CST: "<Hh"}


def robot_with_gains(robot=REFERENCE):
    return robot.model_copy(update={"axis": {n: a.model_copy(update={"control": GAINS}) for n, a in robot.axis.items()}})


class Twin:
    """A robot twice: one gets every cycle as a message, the other frame by frame.

    Attributes:
        plain: Cycles for which the image acted.
    """

    def __init__(self, robot=None):
        self.robot = robot_with_gains() if robot is None else robot
        self.image, self.slaves = World(self.robot), World(self.robot)
        self.plain = 0
        for world in (self.image, self.slaves):
            world.power_on()

    def tell(self, can_id, data=b""):
        """A frame outside of a cycle; the answers, which are the same."""
        answers = [world.receive(Frame(can_id, bytes(data))) for world in (self.image, self.slaves)]
        assert answers[0] == answers[1]
        return answers[0]

    def write(self, node, index, subindex, value, size):
        data = (value & (1 << 8 * size) - 1).to_bytes(size, "little")
        answers = self.tell(0x600 + node, struct.pack("<BHB", 0x23 | (4 - size) << 2, index, subindex) + data.ljust(4, b"\0"))
        return [answer.data[0] for answer in answers if answer.can_id == 0x580 + node]

    def map(self, node, index, number, objects, can_id):
        """Map objects into a PDO that acts at every SYNC; index is 1400h or 1800h."""
        steps = [(index + number, 1, 0x80000000 | can_id, 4), (index + number, 2, 1, 1), (index + 0x200 + number, 0, 0, 1)]
        steps += [(index + 0x200 + number, sub, value, 4) for sub, value in enumerate(objects, start=1)]
        steps += [(index + 0x200 + number, 0, len(objects), 1), (index + number, 1, can_id, 4)]
        for step in steps:
            assert self.write(node, *step) == [0x60], step

    def prepare(self, node, mode=Mode.CSP, told=((STATUS, POSITION, TORQUE), FILTER)):
        """Map what a run maps."""
        self.map(node, 0x1400, 0, MODES[mode], 0x200 + node)
        for number in range(4):
            assert self.write(node, 0x1800 + number, 1, 0x80000000, 4) == [0x60]
            if number < len(told):
                self.map(node, 0x1800, number, told[number], 0x180 + 0x100 * number + node)
        assert self.write(node, Object.INTERPOLATION_PERIOD, 1, 2, 1) == [0x60]
        assert self.write(node, Object.MODES_OF_OPERATION, 0, int(mode), 1) == [0x60]

    def start(self, *nodes):
        for node in (*nodes, 16):
            self.tell(0x000, bytes((1, node)))

    def cycle(self, *frames):
        """One period: the same answers, and the same robot behind them."""
        together = [*frames, SYNC]
        message = self.image.exchange(b"".join(pack(frame) for frame in together))
        if message is None:
            by_image = sorted(
                (answer for frame in together for answer in self.image.receive(frame)), key=lambda each: each.can_id
            )
        else:
            self.plain += 1
            by_image = frames_of(message)
        by_frames, ended = self.by_frames(self.slaves, together), [self.image.finish_period(), self.slaves.finish_period()]
        if any(axis.behaviour.delays_frames for axis in self.robot.axis.values()):
            assert sorted(by_image + ended[0]) == sorted(by_frames + ended[1])
        else:
            assert (by_image, ended[0]) == (by_frames, ended[1])
        self.compare()
        return by_image

    @staticmethod
    def by_frames(world, frames):
        return sorted((answer for frame in frames for answer in world.receive(frame)), key=lambda each: each.can_id)

    def compare(self):
        image, slaves = self.image, self.slaves
        assert image.now == slaves.now
        assert image.due == slaves.due
        for field in image.axes.rows.dtype.names:
            np.testing.assert_array_equal(image.axes.rows[field], slaves.axes.rows[field], err_msg=field)
        for one, other in zip(image.drives.values(), slaves.drives.values(), strict=True):
            assert one.status_word() == other.status_word()
            for index in (Object.TARGET_POSITION, Object.POSITION_OFFSET, Object.TARGET_TORQUE, Object.TORQUE_OFFSET):
                assert one.slave.dictionary.get(index) == other.slave.dictionary.get(index)
        shown = [[cell.value for cell in world.accelerometer.channels] for world in (image, slaves)]
        assert shown[0] == shown[1]

    def enable(self, nodes, mode=Mode.CSP, cycles=1):
        """Bring drives to operation enabled where they stand, with so many cycles for each word."""
        for word in (0x06, 0x07, 0x0F, 0x0F):
            for _ in range(cycles):
                self.cycle(*(self.command(node, word, mode) for node in nodes))
        for axis in self.image.drives.values():
            assert axis.node_id not in nodes or axis.state is State.OPERATION_ENABLED

    def command(self, node, word=0x0F, mode=Mode.CSP, target=None, offset=0):
        drive = next(drive for drive in self.image.drives.values() if drive.node_id == node)
        if mode is Mode.CST:
            return Frame(0x200 + node, struct.pack("<Hh", word, target or 0))
        value = drive.data.position_counts() if target is None else target
        return Frame(0x200 + node, struct.pack("<Hih", word, value, offset))


def following(nodes=(2, 3, 5), mode=Mode.CSP, robot=None, **options):
    twin = Twin(robot)
    for node in nodes:
        twin.prepare(node, mode, **options)
    twin.start(*nodes)
    twin.enable(nodes, mode)
    return twin


def test_the_bits_of_the_status_word_are_those_of_cia_402():
    shown = CORE.call.INTERNAL_LIMIT_BIT, CORE.call.FOLLOWS_COMMAND_BIT, CORE.call.FOLLOWING_ERROR_BIT
    assert shown == (INTERNAL_LIMIT, FOLLOWS_COMMAND, FOLLOWING_ERROR)


@pytest.mark.parametrize("nodes", [(2,), (2, 3, 5)], ids=["one axis", "three axes"])
@pytest.mark.parametrize("mode", [Mode.CSP, Mode.CST])
def test_random_set_points_move_both_robots_alike(nodes, mode):
    twin, dice = following(nodes, mode), random.Random(7)
    targets, before = dict.fromkeys(nodes, 0), twin.plain
    for _ in range(300):
        frames = []
        for node in nodes:
            targets[node] += dice.randint(-400, 400)
            target = targets[node] if mode is Mode.CSP else dice.randint(-60, 60)
            frames.append(twin.command(node, 0x0F, mode, target, dice.randint(-50, 50)))
        dice.shuffle(frames)
        twin.cycle(*frames)
    assert twin.plain - before == 300


def late_robot(**delays):
    """The reference robot with these delays of its second axis."""
    robot = robot_with_gains()
    late = robot.axis[2].model_copy(update={"behaviour": robot.axis[2].behaviour.model_copy(update=delays)})
    return robot.model_copy(update={"axis": {**robot.axis, 2: late}})


@pytest.mark.parametrize(
    ("delays", "plain"),
    [({"tpdo_delay_us": 700.0}, 50), ({"tpdo_delay_us": 5000.0}, 0), ({"tpdo_jitter_us": 100.0}, 0)],
    ids=["within the period", "beyond the period", "with jitter"],
)
def test_answers_that_are_late_within_the_period_come_with_the_others(delays, plain):
    twin = Twin(late_robot(**delays))
    for node in (2, 3):
        twin.prepare(node)
    twin.start(2, 3)
    twin.enable((2, 3), cycles=4)
    before = twin.plain
    for step in range(50):
        twin.cycle(*(twin.command(node, target=20 * step) for node in (2, 3)))
    assert twin.plain - before == plain


def held_input(twin, node, dice):
    held = dice.choice((NEGATIVE_SWITCH, POSITIVE_SWITCH))
    for world in (twin.image, twin.slaves):
        world.drives[node].inputs.force(held)


def lost_bus(twin, node, _dice):
    for world in (twin.image, twin.slaves):
        world.bus_off(node)
        world.bus_recovered(node)


def switched_torque(twin, node, dice):
    active = dice.random() < 0.5
    for world in (twin.image, twin.slaves):
        world.drives[node].inputs.set_sto(active)


OUTSIDE = (
    held_input,
    lost_bus,
    switched_torque,
    lambda twin, node, dice: twin.tell(0x200 + node, twin.command(node).data),
    lambda twin, node, dice: twin.write(node, Object.TARGET_POSITION, 0, dice.randint(-4000, 4000), 4),
    lambda twin, node, dice: twin.write(node, Object.POSITION_OFFSET, 0, dice.randint(-40, 40), 4),
    lambda twin, node, dice: twin.tell(0x000, bytes((dice.choice((1, 2, 0x80, 0x81, 0x82)), node))),
    lambda twin, node, dice: twin.write(node, Object.MODES_OF_OPERATION, 0, dice.choice((1, 3, 4, 6, 7, 8, 9, 10)), 1),
    lambda twin, node, dice: twin.tell(0x77F, b"\x05"),
)
"""What comes between two cycles."""
WORDS = (0x02, 0x06, 0x07, 0x0B, 0x0D, 0x0F, 0x10F, 0x80, 0x8F)
INSIDE = (
    lambda twin, node, dice: twin.command(node, dice.choice(WORDS)),
    lambda twin, node, dice: twin.command(node, target=dice.randint(-(2**31), 2**31 - 1)),
    lambda twin, node, dice: Frame(0x200 + node, twin.command(node).data[: dice.randrange(9)]),
    lambda twin, node, dice: Frame(dice.randrange(0x800), bytes(dice.randrange(256) for _ in range(dice.randrange(9)))),
)
"""A frame more in a cycle: another word, a wild set-point, a wrong length, any."""


@pytest.mark.parametrize("seed", range(6))
def test_whatever_else_comes_both_robots_do_the_same(seed):
    dice, twin, nodes = random.Random(seed), following(), (2, 3, 5)
    for _ in range(120):
        frames = [twin.command(node, offset=dice.randint(-80, 80)) for node in nodes]
        node, what = dice.choice(nodes), dice.randrange(16)
        if what == 0:
            dice.choice(OUTSIDE)(twin, node, dice)
        elif what == 1:
            frames.append(dice.choice(INSIDE)(twin, node, dice))
        elif what == 2:
            del frames[dice.randrange(3)]
        twin.cycle(*frames)
    assert twin.plain > 0


@pytest.mark.parametrize("seed", [1, 4])
def test_a_drawn_robot_with_a_slow_sensor_is_the_same(seed):
    robot = robot_with_gains(draw(seed))
    assert robot.accelerometer.filters
    nodes = tuple(robot.node_ids[number] for number in robot.axis)
    twin = Twin(robot)
    for node in nodes:
        twin.prepare(node)
    twin.start(*nodes)
    for _ in range(4):
        twin.cycle(*(twin.command(node, 0x06) for node in nodes))


def test_an_entry_that_the_image_does_not_know_is_sampled_by_the_slave():
    """The speed, 606Ch: the rest of the cycle is the image's."""
    twin = following((2,), told=((STATUS, POSITION), (SPEED,)))
    before = twin.plain
    for step in range(50):
        answers = twin.cycle(twin.command(2, target=20 * step))
    assert twin.plain - before == 50
    assert any(answer.can_id == 0x282 and int.from_bytes(answer.data, "little", signed=True) for answer in answers)


@pytest.mark.parametrize(
    ("index", "subindex", "value", "size"),
    [(0x1007, 0, 100, 4), (0x1019, 0, 10, 1), (0x1400, 5, 50, 2), (0x1800, 2, 2, 1)],
    ids=["window", "counter", "deadline", "every second SYNC"],
)
def test_what_the_standard_adds_to_a_sync_is_for_the_slave(index, subindex, value, size):
    twin = following((2,))
    before = twin.plain
    assert twin.write(2, index, subindex, value, size) == [0x60]
    for _ in range(10):
        twin.cycle(twin.command(2))
    assert twin.plain == before


def test_a_hook_that_is_changed_while_the_robot_moves_is_seen_at_once():
    twin = following((2,))
    for world in (twin.image, twin.slaves):
        world.drives[2].slave.dictionary.on_read(Object.POSITION_ACTUAL, 0, lambda: 4711)
    answers = twin.cycle(twin.command(2))
    assert [answer.data[2:6] for answer in answers if answer.can_id == 0x182] == [(4711).to_bytes(4, "little")]


def test_a_message_that_is_refused_has_changed_nothing():
    twin = following((2, 3))
    records = [twin.command(2, target=300), twin.command(3, 0x07), SYNC]
    before = twin.image.axes.rows.copy()
    assert twin.image.exchange(b"".join(pack(frame) for frame in records)) is None
    for field in before.dtype.names:
        np.testing.assert_array_equal(twin.image.axes.rows[field], before[field])
    twin.compare()
    assert twin.image.exchange(b"") is None
    assert twin.image.exchange(pack(twin.command(2))) is None, "no SYNC at its end"


def test_a_switch_that_is_forced_after_a_cycle_stops_a_motor_that_goes_on_without_a_master():
    twin = following((2,), Mode.CST)
    for _ in range(40):
        twin.cycle(twin.command(2, mode=Mode.CST, target=300))
    for world in (twin.image, twin.slaves):
        world.drives[2].inputs.force(POSITIVE_SWITCH)
        world.free_step(world.now + 20_000_000)
    twin.compare()
    assert twin.image.drives[2].limit_switches.blocked
