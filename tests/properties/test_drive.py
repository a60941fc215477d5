"""Whatever comes over the bus: the drive does not raise, and its brake and its torque keep their promises."""

import math
import struct

import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

from drive_profiles.standard.cia301 import NmtState
from drive_profiles.standard.cia402 import Mode, Object, State, state_of
from hil.can.frame import Frame
from plant_emulator.motion import record
from plant_emulator.world import World
from tests.plant_emulator.rig import AXIS, MS, NODE, ONE_AXIS

ROBOT = ONE_AXIS
POWERED = {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE}
SHOWN = [(Object.STATUS_WORD, 0), (Object.POSITION_ACTUAL, 0), (Object.VELOCITY_ACTUAL, 0), (Object.TORQUE_ACTUAL, 0),
         (Object.FOLLOWING_ERROR_ACTUAL, 0), (Object.TARGET_POSITION, 0), (0x2112, 2), (0x2130, 0)]  # fmt: skip
SIZES = {(e.index, e.subindex): e.data_type.size for e in World(ROBOT).drives[AXIS].slave.dictionary
         if e.access.is_writable and e.data_type.size in {1, 2, 4}}  # fmt: skip
SET_POINTS = [(Object.TARGET_POSITION, 0), (Object.TARGET_TORQUE, 0), (Object.MAX_TORQUE, 0), (Object.TORQUE_OFFSET, 0),
              (Object.VELOCITY_OFFSET, 0), (Object.POSITION_OFFSET, 0), (Object.QUICK_STOP_OPTION, 0),
              (Object.FAULT_REACTION_OPTION, 0), (Object.ABORT_CONNECTION_OPTION, 0), (Object.MAX_MOTOR_SPEED, 0),
              (Object.FOLLOWING_ERROR_WINDOW, 0), (Object.SOFTWARE_POSITION_LIMIT, 2), (Object.INTERPOLATION_PERIOD, 1),
              (0x2100, 1), (0x2101, 1), (0x2110, 1), (0x2110, 4), (Object.TARGET_VELOCITY, 0), (Object.MODES_OF_OPERATION, 0),
              (Object.HALT_OPTION, 0), (Object.SHUTDOWN_OPTION, 0), (Object.DISABLE_OPERATION_OPTION, 0),
              (Object.HOMING_METHOD, 0), (Object.INTERPOLATION_DATA, 1), (Object.TORQUE_SLOPE, 0),
              (Object.POSITIVE_TORQUE_LIMIT, 0), (Object.NEGATIVE_TORQUE_LIMIT, 0)]  # fmt: skip


class Watched:
    """A drive in its world, and the promises that are checked after every step."""

    def __init__(self):
        self.world = World(ROBOT)
        self.world.power_on()
        self.drive = self.world.drives[AXIS]
        self.dictionary = self.drive.slave.dictionary
        self.motion, self.plant = self.world.axes.motion[0], self.world.axes.plant_state[0]
        self.was_operational = False
        self.enabled = 0
        self.word = 0
        self._state = self.drive.state
        cell = self.dictionary.cell(Object.CONTROL_WORD)
        self._hook = cell.write_hook
        cell.write_hook = self._on_control_word
        on_nmt, on_reset = self.drive.slave.on_nmt, self.drive.slave.on_reset

        def nmt(old, new):
            self.was_operational = self.was_operational or new is NmtState.OPERATIONAL
            on_nmt(old, new)

        def reset(kind):
            on_reset(kind)
            if kind.value == "node":
                self.was_operational, self.word, self._state = False, 0, self.drive.state

        self.drive.slave.on_nmt, self.drive.slave.on_reset = nmt, reset

    def _on_control_word(self, word):
        """Judge each step of the state machine from outside: by the standard's table in words, not by the project's own."""
        before, previous = self.drive.state, self.word
        code = self._hook(word)
        after, self.word = self.drive.state, word
        if after is not before:
            self._judge(before, after, word, previous)
        self._state = after
        return code

    def _judge(self, before, after, word, previous):
        if after is State.OPERATION_ENABLED:
            assert word & 0x8F == 0x0F
            assert before in {State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.QUICK_STOP_ACTIVE}
            if before is State.QUICK_STOP_ACTIVE:
                assert self.dictionary.get_int(Object.QUICK_STOP_OPTION) >= 5
            assert self.drive.slave.nmt_state is NmtState.OPERATIONAL
            self.enabled += 1
        elif before is State.FAULT:
            assert after is State.SWITCH_ON_DISABLED
            assert word & 0x80
            assert not previous & 0x80
        elif before is State.SWITCH_ON_DISABLED:
            assert after is State.READY_TO_SWITCH_ON
            assert word & 0x87 == 0x06
        else:
            assert before is not State.FAULT_REACTION_ACTIVE

    def send(self, can_id, data):
        self.world.receive(Frame(can_id, data))
        self.check()

    def wait(self, ticks):
        self.world.finish_period()
        self.world.free_step(self.world.now + ticks * 250_000)
        self.check()
        quantum = self.drive.scaling.torque_quantum_nm
        limit = min(ROBOT.axis[AXIS].torque_limit_nm, self.dictionary.get_int(Object.MAX_TORQUE) * quantum)
        assert abs(self.motion["torque_nm"]) <= limit
        assert abs(self.plant["torque_nm"]) <= limit

    def check(self):
        state = self.drive.state
        if state is not self._state:  # by itself, not by a control word: never towards power
            assert state is not State.OPERATION_ENABLED
            assert not (self._state is State.FAULT and state is not State.FAULT)
            self._state = state
        if self.motion["mode"] != record.BRAKED:
            assert state in POWERED
            assert self.was_operational
        for place in SHOWN:
            self.dictionary.read(*place)
        assert state_of(struct.unpack("<H", self.dictionary.read(Object.STATUS_WORD, 0))[0]) is state
        assert all(math.isfinite(self.plant[name]) for name in self.plant.dtype.names)


def sdo(index, sub, data):
    return 0x600 + NODE, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub) + data.ljust(4, b"\0")


def written(place):
    size = SIZES[place]
    return st.binary(min_size=size, max_size=size).map(lambda data: [("frame", *sdo(*place, data))])


def word_by_sdo(word):
    return ("frame", *sdo(Object.CONTROL_WORD, 0, struct.pack("<H", word)))


def enabling(mode):
    start = ("frame", 0x000, bytes((1, NODE)))
    set_mode = ("frame", *sdo(Object.MODES_OF_OPERATION, 0, bytes((mode,))))
    return [("frame", *sdo(Object.CONTROL_WORD, 0, b"\0\0")), set_mode, start, *map(word_by_sdo, (0x80, 0x06, 0x07, 0x0F))]


WORDS = st.sampled_from([0x00, 0x02, 0x06, 0x07, 0x0F, 0x1F, 0x3F, 0x5F, 0x21F, 0x10F, 0x11F, 0x80, 0x86, 0x8F]) | st.integers(
    0, 0xFFFF
)
COUNTS = st.integers(-3000, 3000) | st.integers(-(2**31), 2**31 - 1)
STEPS = st.one_of(
    st.sampled_from(list(Mode)).map(enabling),
    WORDS.map(lambda word: [word_by_sdo(word)]),
    st.tuples(WORDS, COUNTS).map(lambda wt: [("frame", 0x200 + NODE, struct.pack("<Hi", *wt)), ("sync",)]),
    st.tuples(st.sampled_from([1, 1, 1, 2, 128, 129, 130]), st.sampled_from([0, NODE])).map(
        lambda command: [("frame", 0x000, bytes(command))]
    ),
    st.sampled_from([*SET_POINTS, *SET_POINTS, *SIZES]).flatmap(written),
    st.integers(1, 5).map(lambda count: [("sync",)] * count),
    st.just([("frame", 0x77F, b"\x05")]),
    st.tuples(st.integers(0, 0x7FF) | st.integers(0, 2**32 - 1), st.binary(max_size=8)).map(lambda frame: [("frame", *frame)]),
    st.integers(1, 400).map(lambda ticks: [("wait", ticks)]),
)
SETUP = [
    *(("frame", *sdo(0x1400, 1, struct.pack("<I", 0x200 + NODE | 1 << 31))), ("frame", *sdo(0x1600, 0, b"\0"))),
    ("frame", *sdo(0x1600, 2, struct.pack("<I", 0x607A0020))),
    *(("frame", *sdo(0x1600, 0, b"\2")), ("frame", *sdo(0x1400, 2, b"\1"))),
    ("frame", *sdo(0x1400, 1, struct.pack("<I", 0x200 + NODE))),
    ("frame", *sdo(0x1016, 1, struct.pack("<I", 127 << 16 | 50))),
]


def play(watched, steps):
    for step in steps:
        match step:
            case ("frame", can_id, data):
                watched.send(can_id, data)
            case ("sync",):
                watched.send(0x080, b"")
                watched.wait(0)
            case ("wait", ticks):
                watched.wait(ticks)


@pytest.mark.ci
@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(STEPS, min_size=1, max_size=40))
def test_no_sequence_of_frames_breaks_a_promise(sequence):
    watched = Watched()
    play(watched, SETUP)
    for steps in sequence:
        play(watched, steps)
    event("was enabled" if watched.enabled else "was never enabled")
    watched.world.finish_period()
    before = watched.world.now
    watched.wait(8)
    assert watched.world.now == before + 2 * MS


@pytest.mark.ci
@settings(max_examples=40)
@given(
    st.sampled_from(list(Mode)),
    st.integers(0, 65535),
    st.lists(st.tuples(COUNTS, st.integers(-32768, 32767), st.integers(-32768, 32767)), min_size=1, max_size=15),
)
def test_no_set_point_makes_more_torque_than_is_allowed(mode, limit, set_points):
    watched = Watched()
    play(watched, [*SETUP, *enabling(mode), ("frame", *sdo(Object.MAX_TORQUE, 0, struct.pack("<H", limit)))])
    assert watched.drive.state is State.OPERATION_ENABLED
    for counts, torque, offset in set_points:
        play(
            watched,
            [
                ("frame", *sdo(Object.TARGET_TORQUE, 0, struct.pack("<h", torque))),
                ("frame", *sdo(Object.TORQUE_OFFSET, 0, struct.pack("<h", offset))),
                ("frame", *sdo(Object.VELOCITY_OFFSET, 0, struct.pack("<i", counts))),
                ("frame", *sdo(Object.TARGET_VELOCITY, 0, struct.pack("<i", counts))),
                ("frame", *sdo(Object.INTERPOLATION_DATA, 1, struct.pack("<i", counts))),
                ("frame", 0x200 + NODE, struct.pack("<Hi", 0x1F, counts)),
                ("sync",),
                ("wait", 3),
            ],
        )
