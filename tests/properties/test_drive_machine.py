"""Whatever a master, a bus and a hand on the switches do to a drive, in any order: it keeps the promises of its standards."""

import struct

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from plant_emulator.drive.inputs import INPUTS
from plant_emulator.motion import record
from plant_emulator.motion.record import FOLLOWING, OVERSPEED, SET_POINT_LATE
from plant_emulator.robots.behaviour import Behaviour, Switches
from plant_emulator.robots.robot import Robot
from tests.plant_emulator.rig import AXIS, NODE, ONE_AXIS
from tests.properties.watched import MS, REACHED, WatchedWorld, run_for

SYNC, TIME, LSS = 0x080, 0x100, 0x7E5
STATES = (
    *("SWITCH_ON_DISABLED", "READY_TO_SWITCH_ON", "SWITCHED_ON", "OPERATION_ENABLED"),
    *("QUICK_STOP_ACTIVE", "FAULT_REACTION_ACTIVE", "FAULT"),
)
UNDER_TORQUE = (
    *((1, record.PROFILE), (3, record.PROFILE_VELOCITY), (4, record.PROFILE_TORQUE), (6, record.PROFILE), (7, record.POSITION)),
    *((8, record.POSITION), (9, record.VELOCITY), (10, record.TORQUE), (1, record.STOPPING)),
)
"""Modes of operation with the mode of the law in which each acts."""
MODES = (1, 3, 4, 6, 7, 8, 9, 10)
WORDS = st.sampled_from((0x00, 0x02, 0x06, 0x07, 0x0F, 0x0F, 0x1F, 0x3F, 0x5F, 0x7F, 0x10F, 0x11F, 0x21F, 0x80, 0x86, 0x8F)) | (
    st.integers(0, 0xFFFF)
)
COUNTS = st.integers(-3000, 3000) | st.integers(-200_000, 200_000) | st.integers(-(2**31), 2**31 - 1)
SMALL = st.integers(-32768, 32767)
OPTIONS = {0x6007: (0, 1, 2, 3), 0x605A: range(9), 0x605B: (0, 1), 0x605C: (0, 1), 0x605D: (1, 2, 3, 4), 0x605E: (0, 1, 2, 3, 4)}
SET_POINTS = {0x607A: 4, 0x60B0: 4, 0x60FF: 4, 0x60B1: 4, 0x6071: 2, 0x60B2: 2}
LIMITS = {
    **{0x6072: 2, 0x6073: 2, 0x60E0: 2, 0x60E1: 2, 0x6087: 4, 0x6065: 4, 0x6066: 2, 0x6080: 4, 0x607F: 4, 0x6081: 4},
    **{0x6083: 4, 0x6084: 4, 0x6085: 4, 0x60C5: 4, 0x60C6: 4, 0x6067: 4, 0x6068: 2, 0x606D: 2, 0x606E: 2, 0x60F2: 2, 0x60F8: 4},
}
WAITS = st.sampled_from((1_000, MS // 4, MS // 4, MS, 2 * MS, 10 * MS)) | st.integers(1_000, 20 * MS) | st.just(1000 * MS)
FATES = st.sampled_from(("arrives",) * 8 + ("lost", "twice", "late"))


def _signed(value, size):
    return (value & (1 << 8 * size) - 1).to_bytes(size, "little")


class DriveMachine(RuleBasedStateMachine):
    """One drive, its accelerometer, and everything that may happen to them."""

    robot, modes = ONE_AXIS, MODES
    transition_ns = 0
    """What a patient master waits after each control word."""

    @initialize()
    def power_on(self):
        self.watched = WatchedWorld(self.robot)
        self.watched.power_on()
        self.drive = self.watched.world.drives[AXIS]
        self.watch = self.watched.drives[AXIS]
        self.late = []
        self.has_tripped = False
        self.map_pdos()

    def teardown(self):
        if hasattr(self, "watch"):
            self.watched.judge_memory()
            REACHED[type(self)].update(self.watched.reached)

    # -- what the rules are made of

    def send(self, can_id, data=b"", fate="arrives"):
        """A frame, as a bus may deliver it: a late one comes after the next."""
        if fate == "late":
            self.late.append((can_id, data))
            return
        if fate != "lost":
            self.watched.send(can_id, data)
        if fate == "twice":
            self.watched.send(can_id, data)
        while self.late:
            self.watched.send(*self.late.pop())

    def write(self, index, subindex, data, fate="arrives"):
        self.send(0x600 + NODE, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0"), fate)

    def map_pdos(self):
        """RPDO 1 with control word and target position, on SYNC; RPDO 2 with a torque, at once; 2 ms per set-point."""
        self.write(0x60C2, 1, b"\2")
        for place, data in (
            ((0x1400, 1), 0x80000200 + NODE), ((0x1600, 0), b"\0"), ((0x1600, 1), 0x60400010), ((0x1600, 2), 0x607A0020),
            ((0x1600, 0), b"\2"), ((0x1400, 2), b"\1"), ((0x1400, 1), 0x200 + NODE),
            ((0x1401, 1), 0x80000300 + NODE), ((0x1601, 0), b"\0"), ((0x1601, 1), 0x60710010),
            ((0x1601, 0), b"\1"), ((0x1401, 2), b"\xff"), ((0x1401, 1), 0x300 + NODE),
        ):  # fmt: skip
            self.write(*place, data if isinstance(data, bytes) else struct.pack("<I", data))

    # -- a master that means it

    def enable(self, mode, speed, command=1):
        self.write(0x6040, 0, b"\0\0")
        self.write(0x6060, 0, bytes((mode,)))
        self.send(0x000, bytes((command, NODE)))
        for word in (0x80, 0x06, 0x07, 0x0F):
            self.write(0x6040, 0, struct.pack("<H", word))
            if self.transition_ns:
                self.watched.wait(self.transition_ns)
        self.write(0x60FF, 0, struct.pack("<i", 20 * speed))

    @rule(mode=st.sampled_from(MODES), speed=SMALL, command=st.sampled_from((1, 1, 1, 128, 129)))
    def enable_drive(self, mode, speed, command):
        """As a master does it, also one that has forgotten to start the node."""
        self.enable(mode, speed, command)

    @rule(
        index=st.sampled_from((0x6072, 0x6073, 0x60E0, 0x60E1)),
        limit=st.integers(0, 3000),
        slope=st.integers(0, 10_000_000),
        torque=SMALL,
        mode=st.sampled_from((4, 10)),
    )
    def ask_for_torque(self, index, limit, slope, torque, mode):
        """More than a limit leaves, in a torque mode, and back."""
        self.write(index, 0, _signed(limit, 2))
        self.write(0x6087, 0, _signed(slope, 4))
        self.enable(mode, 0)
        for wanted in (torque, -torque):
            self.write(0x6071, 0, _signed(wanted, 2))
            self.watched.wait(2 * MS)

    @rule(mode=st.sampled_from(MODES), words=st.lists(WORDS, max_size=4), wait=WAITS)
    def enable_then(self, mode, words, wait):
        """The more of what is done to it is done under torque."""
        self.enable(mode, 300)
        self.watched.wait(min(wait, 10 * MS))
        for word in words:
            self.write(0x6040, 0, struct.pack("<H", word))
            self.watched.wait(MS // 4)

    @rule(mode=st.sampled_from(MODES), far=SMALL, word=st.sampled_from((0x00, 0x02, 0x06, 0x07, 0x10F)), code=st.integers(0, 8))
    def stop_on_the_way(self, mode, far, word, code):
        """A move that has begun, also of a drive that takes its time, is ended by a control word as 605Ah to 605Dh say."""
        which = sorted(OPTIONS)[code % len(OPTIONS)]
        self.write(which, 0, _signed(OPTIONS[which][code % len(OPTIONS[which])], 2))
        self.enable(mode, far)
        self.watched.wait(10 * MS)
        self.write(0x607A, 0, _signed(far * 1000, 4))
        for each in (0x0F, 0x3F, word):
            self.write(0x6040, 0, struct.pack("<H", each))
            self.watched.wait(4 * MS)

    @rule(far=SMALL, word=st.sampled_from((0x02, 0x06, 0x07)))
    def stop_a_move(self, far, word):
        """A ramp from a position mode's speed: by chance alone hardly any move is under way when it ends."""
        self.write(0x605A, 0, b"\2\0")
        self.write(0x605C, 0, b"\1\0")
        self.enable(1, 0)
        self.watched.wait(10 * MS)
        self.write(0x607A, 0, _signed(far * 1000, 4))
        for each in (0x0F, 0x3F, word):
            self.write(0x6040, 0, struct.pack("<H", each))
            self.watched.wait(10 * MS)

    @rule(bit=st.sampled_from((FOLLOWING, OVERSPEED, SET_POINT_LATE)), code=st.sampled_from((1, 2)))
    def trip_at_speed(self, bit, code):
        """A limit is broken in motion, and the drive reacts with a ramp."""
        self.write(0x605E, 0, _signed(code, 2))
        self.enable(3, 300)
        self.watched.wait(10 * MS)
        self.drive.stage.motion["trip"] |= bit
        self.watched.wait(MS // 4)

    @rule(word=WORDS, by_pdo=st.booleans(), counts=COUNTS, fate=FATES)
    def control_word(self, word, by_pdo, counts, fate):
        if by_pdo:
            self.send(0x200 + NODE, struct.pack("<Hi", word, counts), fate)
            self.send(SYNC)
        else:
            self.write(0x6040, 0, struct.pack("<H", word), fate)

    @rule(mode=st.sampled_from((*MODES, *MODES, 0)) | st.integers(-128, 127))
    def choose_mode(self, mode):
        self.write(0x6060, 0, _signed(mode, 1))

    @rule(places=st.lists(st.tuples(st.sampled_from(sorted(SET_POINTS)), COUNTS | SMALL), min_size=1, max_size=3), fate=FATES)
    def set_points(self, places, fate):
        for index, value in places:
            self.write(index, 0, _signed(value, SET_POINTS[index]), fate)
        self.write(0x60C1, 1, _signed(places[0][1], 4))

    @rule(index=st.sampled_from(sorted(LIMITS)), value=st.sampled_from((0, 1, 100, 1000, 3000, 65535, 2**32 - 1)) | COUNTS)
    def limit(self, index, value):
        self.write(index, 0, _signed(value, LIMITS[index]))

    @rule(which=st.sampled_from(sorted(OPTIONS)), choice=st.integers(0, 8))
    def option_code(self, which, choice):
        self.write(which, 0, _signed(OPTIONS[which][choice % len(OPTIONS[which])], 2))

    @rule(method=st.sampled_from((0, 1, 2, 3, 7, 11, 17, 19, 23, 33, 34, 35, 37)), speeds=st.tuples(COUNTS, COUNTS), wait=WAITS)
    def home(self, method, speeds, wait):
        self.write(0x6098, 0, bytes((method,)))
        for subindex, speed in enumerate(speeds, 1):
            self.write(0x6099, subindex, _signed(abs(speed), 4))
        self.write(0x6060, 0, b"\6")
        self.write(0x6040, 0, b"\x0f\0")
        self.write(0x6040, 0, b"\x1f\0")
        self.watched.wait(wait)

    @rule(torque=SMALL, fate=FATES)
    def torque_by_pdo(self, torque, fate):
        self.send(0x300 + NODE, struct.pack("<h", torque), fate)

    @rule(count=st.integers(1, 12), counter=st.sampled_from((None, None, 0, 1, 240)), period=st.sampled_from((0, MS // 2, MS)))
    def synchronise(self, count, counter, period):
        for number in range(count):
            self.send(SYNC, b"" if counter is None else bytes(((counter + number) % 256,)))
            self.watched.wait(period)

    # -- what happens to it

    @rule(command=st.sampled_from((1, 1, 1, 2, 128, 129, 130)), node=st.sampled_from((0, NODE)), fate=FATES)
    def nmt(self, command, node, fate):
        self.send(0x000, bytes((command, node)), fate)

    @rule(time=WAITS)
    def wait(self, time):
        self.watched.wait(time)

    @rule()
    def power_cycle(self):
        self.watched.power_cycle(NODE)
        self.map_pdos()

    @rule(active=st.booleans())
    def safe_torque_off(self, active):
        self.drive.inputs.set_sto(active)
        self.watched.judge()
        self.watched.wait(1)  # what the drive says of it goes with the next frames: not with those of a reset

    @rule(inputs=st.integers(1, INPUTS), active=st.booleans())
    def force(self, inputs, active):
        self.drive.inputs.force(inputs, active=active)

    @rule(bit=st.sampled_from((FOLLOWING, OVERSPEED, SET_POINT_LATE)))
    def trip(self, bit):
        """A limit is broken, as the control period finds it."""
        self.drive.stage.motion["trip"] |= bit
        self.watched.wait(MS // 4)

    @rule(entry=st.sampled_from((0x7F0032, 0x7F03E8, 0)), behaviour=st.integers(0, 3), silence=WAITS)
    def lose_the_master(self, entry, behaviour, silence):
        self.write(0x1029, 1, bytes((behaviour,)))
        self.write(0x1016, 1, struct.pack("<I", entry))
        self.send(0x77F, b"\5")
        self.watched.wait(silence)

    @rule(factor=st.integers(0, 3), silence=WAITS)
    def guard(self, factor, silence):
        self.write(0x100C, 0, b"\x05\0")
        self.write(0x100D, 0, bytes((factor,)))
        self.send(0x700 + NODE | 1 << 30)
        self.watched.wait(silence)

    @rule(length=st.sampled_from((0, 1, 5, 6, 8)))
    def drop_or_stretch_a_pdo(self, length):
        self.send(0x200 + NODE, bytes(length))

    @rule(can_id=st.integers(0, 0x7FF) | st.integers(0, 2**32 - 1), data=st.binary(max_size=8))
    def anything(self, can_id, data):
        if can_id != LSS:  # which may give it another number: of that the slave's machine
            self.send(can_id, data)

    @rule(index=st.integers(0x1000, 0x1FFF) | st.integers(0x6000, 0x60FF), subindex=st.integers(0, 3), data=st.binary(max_size=4))
    def write_anything(self, index, subindex, data):
        if len(data) in {1, 2, 4}:
            self.write(index, subindex, data)

    @rule(data=st.binary(min_size=6, max_size=6))
    def tell_the_time(self, data):
        self.send(TIME, data)

    @invariant()
    def keeps_its_promises(self):
        if hasattr(self, "watched"):
            self.watched.judge()


SWITCHES = Switches(
    negative_limit_deg=-2.0,
    positive_limit_deg=2.0,
    home_deg=(-0.2, 0.3),
    probe_1_deg=(0.5, 0.6),
    probe_2_deg=(-1.0, 1.0),
)
TAKES_ITS_TIME = Behaviour(
    tpdo_delay_us=300.0,
    tpdo_jitter_us=200.0,
    sdo_delay_ms=2.0,
    transition_delay_ms=3.0,
    halt_blocks_mode_change=True,
    quick_stop_ends_disabled_at_once=True,
    pp_handshake_cycles=2,
    operational_at_boot=True,
)


def _robot(**update):
    return Robot(axis={AXIS: ONE_AXIS.axis[AXIS].model_copy(update=update)})


class SwitchedDrive(DriveMachine):
    """The same between limit switches, with a home switch and probes."""

    robot = _robot(switches=SWITCHES)


class SlowDrive(DriveMachine):
    """One that takes its time, and differs where makers differ."""

    robot, transition_ns = _robot(behaviour=TAKES_ITS_TIME), 4 * MS


class VendorDrive(DriveMachine):
    """A maker's drive, with its own dictionary."""

    robot, modes = _robot(profile="maxon_epos4"), (1, 3, 6, 8, 9, 10)


MACHINES = [DriveMachine, SwitchedDrive, SlowDrive, VendorDrive]


@pytest.mark.ci
@pytest.mark.part
@pytest.mark.timeout(900)
@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.__name__)
def test_a_drive_keeps_its_promises_for_a_tenth_of_a_long_time(machine):
    run_for(machine, examples=12, steps=100)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.__name__)
def test_a_drive_keeps_its_promises_for_a_long_time(machine):
    wanted = {f"state {state}" for state in STATES} | {
        f"mode {mode} law {each}" for mode, each in UNDER_TORQUE if mode in machine.modes
    }
    run_for(machine, examples=120, steps=100)
    assert not wanted - set(REACHED[machine])
