"""Whatever clients, masters and the bus do to a CANopen node: each request has its one answer, each reset its one boot-up."""

import struct

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from tests.plant_emulator.rig import NODE, ONE_AXIS
from tests.properties.watched import (
    CHANNEL_ANSWER,
    CHANNEL_REQUEST,
    LSS_ANSWER,
    LSS_REQUEST,
    MS,
    NOT_CONFIGURED,
    OPERATIONAL,
    REACHED,
    WatchedWorld,
    run_for,
)

SYNC = 0x080
SDO_STATES = (
    *("idle", "deaf", "download", "upload", "block download", "block download ends"),
    *("block upload ready", "block upload", "block upload ends"),
)
SENSOR = ONE_AXIS.accelerometer.node_id
PORTS = st.sampled_from((NODE, NODE, NODE, NODE, SENSOR))
USER_TEXT, DEVICE_NAME = (0x2FF0, 0), (0x1008, 0)
KNOWN = st.sampled_from(
    (
        *((0x1000, 0), (0x1003, 0), (0x1003, 1), (0x1010, 1), (0x1010, 3), (0x1011, 1), (0x1017, 0), (0x1018, 1), (0x1020, 1)),
        *((0x1400, 1), (0x1600, 0), (0x1800, 2), (0x1A00, 1), (0x6041, 0), (0x6065, 0), DEVICE_NAME, USER_TEXT),
    )
)
PLACES = KNOWN | KNOWN | st.tuples(st.integers(0, 0xFFFF), st.integers(0, 255))
LONG = st.just(USER_TEXT) | st.just(USER_TEXT) | st.just(DEVICE_NAME) | PLACES
"""Mostly what takes more than a frame."""
FATES = st.lists(st.sampled_from(("arrives",) * 12 + ("lost", "twice")), min_size=1, max_size=7)
BLOCK_SIZES = st.sampled_from((0, 1, 2, 7, 127, 128, 255))
TIMES = st.sampled_from((1_000, MS, 10 * MS, 249 * MS, 251 * MS, 400 * MS, 4_999 * MS, 5_001 * MS))


class SlaveMachine(RuleBasedStateMachine):
    """Two nodes, a drive and the accelerometer, and clients that may do anything."""

    unconfigured = ()

    @initialize()
    def power_on(self):
        self.watched = WatchedWorld(ONE_AXIS, unconfigured=self.unconfigured)
        for can_id in (0x000, LSS_REQUEST + 1, 0x600 + NODE, SYNC):
            assert self.watched.send(can_id, bytes(8)) == []  # without power a node is silent
        self.watched.power_on()
        self.channel = "predefined"
        self._turn = 0

    def teardown(self):
        if hasattr(self, "watched"):
            self.watched.judge_memory()
            REACHED[type(self)].update(self.watched.reached)

    # -- what the rules are made of

    def number(self, port):
        number = self.watched.nodes[port].number
        return port if number == NOT_CONFIGURED else number

    def ask(self, port, data, fates=("arrives",)):
        """A request; the last answer, or None."""
        fate, self._turn = fates[self._turn % len(fates)], self._turn + 1
        is_additional = self.channel == "additional" and port == NODE
        request = CHANNEL_REQUEST if is_additional else 0x600 + self.number(port)
        answer_id = CHANNEL_ANSWER if is_additional else 0x580 + self.number(port)
        answers = []
        for _ in range({"arrives": 1, "lost": 0, "twice": 2}[fate]):
            answers += [f.data for f in self.watched.send(request, data) if f.can_id == answer_id]
        return answers[-1] if answers else None

    def write(self, port, index, subindex, data):
        return self.ask(port, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0"))

    # -- SDO

    @rule(
        port=PORTS,
        first=st.integers(0, 255),
        place=PLACES,
        data=st.binary(min_size=4, max_size=4),
        length=st.sampled_from((8,) * 9 + (0, 7)),
    )
    def request(self, port, first, place, data, length):
        self.ask(port, (struct.pack("<BHB", first, *place) + data)[:length])

    @rule(port=PORTS, place=PLACES, data=st.binary(min_size=1, max_size=4), fates=FATES)
    def write_expedited(self, port, place, data, fates):
        self.ask(port, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, *place) + data.ljust(4, b"\0"), fates)

    @rule(port=PORTS, subindex=st.integers(1, 4), is_load=st.booleans())
    def store_or_restore(self, port, subindex, is_load):
        self.write(port, 0x1011 if is_load else 0x1010, subindex, b"load" if is_load else b"save")

    @rule(port=PORTS, place=LONG, fates=FATES, steps=st.integers(0, 12))
    def upload(self, port, place, fates, steps):
        self.ask(port, struct.pack("<BHB4x", 0x40, *place), fates)
        for step in range(steps):
            self.ask(port, bytes((0x60 | step % 2 << 4, *bytes(7))), fates)

    @rule(port=PORTS, place=LONG, silence=st.sampled_from((4_999 * MS, 5_001 * MS)))
    def fall_silent(self, port, place, silence):
        """A transfer with which nobody goes on: by chance alone one hardly ever outlasts its time."""
        self.ask(port, struct.pack("<BHB4x", 0x40, *place))
        self.watched.wait(silence)

    @rule(
        port=PORTS,
        place=LONG,
        data=st.binary(max_size=40) | st.just(b"save"),
        is_announced=st.booleans(),
        error=st.integers(-3, 3),
        fates=FATES,
    )
    def download(self, port, place, data, is_announced, error, fates):
        announced = max(0, len(data) + (error if abs(error) == 1 else 0))
        self.ask(port, struct.pack("<BHBI", 0x21 if is_announced else 0x20, *place, announced if is_announced else 0), fates)
        pieces = [data[i : i + 7] for i in range(0, len(data), 7)] or [b""]
        for step, piece in enumerate(pieces):
            is_last = step == len(pieces) - 1
            self.ask(port, bytes((step % 2 << 4 | (7 - len(piece)) << 1 | is_last,)) + piece.ljust(7, b"\0"), fates)

    @rule(
        port=PORTS,
        place=LONG,
        length=st.sampled_from((0, 1, 4, 7, 8, 60, 217, 218, 900, 1024, 1025)),
        flags=st.integers(0, 3),
        fates=FATES,
        ends=st.booleans(),
    )
    def block_download(self, port, place, length, flags, fates, ends):
        has_size, has_crc = flags & 1, flags >> 1
        answer = self.ask(port, struct.pack("<BHBI", 0xC0 | has_crc << 2 | has_size << 1, *place, length if has_size else 0))
        size = answer[4] if answer is not None and answer[0] & 0xE0 == 0xA0 else 31
        count, sent = max(1, -(-length // 7)), 0
        for _ in range(6):
            answer = None
            for number in range(1, min(size, count - sent) + 1):
                is_last = sent + number == count
                answer = self.ask(port, bytes((is_last << 7 | number,)) + b"segment", fates)
            if answer is None or answer[0] != 0xA2:
                break
            sent += answer[1]
            if sent >= count:
                break
        if ends:
            unused = 7 * count - length
            crc = 0 if has_crc and length else 1
            self.ask(port, struct.pack("<BH5x", 0xC1 | unused << 2, crc), fates)

    @rule(
        port=PORTS,
        place=LONG,
        size=BLOCK_SIZES,
        threshold=st.sampled_from((0, 0, 4, 255)),
        flags=st.integers(0, 1),
        fates=FATES,
        acknowledged=st.lists(st.tuples(st.integers(0, 9), BLOCK_SIZES), max_size=5),
        plays_along=st.booleans(),
    )
    def block_upload(self, port, place, size, threshold, flags, fates, acknowledged, plays_along):
        self.ask(port, struct.pack("<BHBBB2x", 0xA0 | flags << 2, *place, size, threshold))
        answer = self.ask(port, b"\xa3".ljust(8, b"\0"), fates)
        for number, next_size in acknowledged:
            taken = answer[0] & 0x7F if plays_along and answer is not None else number
            answer = self.ask(port, bytes((0xA2, taken, next_size)) + bytes(5), fates)
        self.ask(port, b"\xa1".ljust(8, b"\0"), fates)

    @rule(port=PORTS, place=PLACES, code=st.integers(0, 2**32 - 1))
    def give_up(self, port, place, code):
        """A client's abort, in the middle of something or not."""
        self.ask(port, struct.pack("<BHBI", 0x80, *place, code))

    @rule(data=st.text("abcdefgh ", max_size=60))
    def leave_a_text(self, data):
        """So that uploads have something to do."""
        data = data.encode().ljust(5, b".")
        self.ask(NODE, struct.pack("<BHBI", 0x21, *USER_TEXT, len(data)))
        for step in range(0, len(data), 7):
            piece = data[step : step + 7]
            first = step // 7 % 2 << 4 | (7 - len(piece)) << 1 | (step + 7 >= len(data))
            self.ask(NODE, bytes((first,)) + piece.ljust(7, b"\0"))

    @rule(is_open=st.booleans())
    def second_client(self, is_open):
        for subindex, cob_id in ((1, CHANNEL_REQUEST), (2, CHANNEL_ANSWER)):
            self.channel = "predefined"
            self.write(NODE, 0x1201, subindex, struct.pack("<I", cob_id if is_open else cob_id | 1 << 31))

    @rule(channel=st.sampled_from(("predefined", "additional")))
    def another_client(self, channel):
        self.channel = channel

    # -- the rest of the node

    @rule(time=TIMES)
    def wait(self, time):
        self.watched.wait(time)

    @rule(
        command=st.sampled_from((1, 1, 2, 128, 129, 130, 0, 255)),
        port=PORTS,
        to_all=st.booleans(),
        length=st.sampled_from((2, 2, 2, 1, 3)),
    )
    def nmt(self, command, port, to_all, length):
        self.watched.send(0x000, bytes((command, 0 if to_all else self.number(port), 0))[:length])

    @rule(port=PORTS)
    def power_cycle(self, port):
        self.watched.power_cycle(port)

    @rule(node_id=st.sampled_from((1, 17, NODE, SENSOR, 127, 0, 128, 255)), stores=st.booleans(), back=st.booleans())
    def configure_by_lss(self, node_id, stores, back):
        before = {port: node.state for port, node in self.watched.nodes.items()}
        answers = self.watched.send(LSS_REQUEST, bytes((0x04, 1, *bytes(6))))
        assert answers == []
        answers = self.watched.send(LSS_REQUEST, bytes((0x11, node_id, *bytes(6))))
        assert len(answers) == sum(state != OPERATIONAL for state in before.values())
        assert all(answer.can_id == LSS_ANSWER for answer in answers)
        if stores:
            self.watched.send(LSS_REQUEST, bytes((0x17, *bytes(7))))
        self.watched.send(LSS_REQUEST, bytes((0x5E, *bytes(7))))
        if back:
            self.watched.send(LSS_REQUEST, bytes(8).replace(b"\0", b"\4", 1))

    @rule(data=st.binary(max_size=8))
    def any_lss(self, data):
        if data[:1] != b"\x11":
            self.watched.send(LSS_REQUEST, data)

    @rule(port=PORTS, period=st.sampled_from((0, 10, 500)))
    def send_heartbeats(self, port, period):
        self.write(port, 0x1017, 0, struct.pack("<H", period))

    @rule(
        port=PORTS,
        behaviour=st.integers(0, 3),
        watched=st.sampled_from((5, 127, NODE, SENSOR)),
        period=st.sampled_from((0, 5, 300)),
    )
    def watch_heartbeats(self, port, behaviour, watched, period):
        self.write(port, 0x1029, 1, bytes((behaviour,)))
        self.write(port, 0x1016, 1, struct.pack("<I", watched << 16 | period))
        self.watched.send(0x700 + watched, b"\5")

    @rule(port=PORTS, time=st.sampled_from((0, 3, 100)), factor=st.integers(0, 3))
    def guard(self, port, time, factor):
        self.write(port, 0x100C, 0, struct.pack("<H", time))
        self.write(port, 0x100D, 0, bytes((factor,)))
        for _ in range(2):
            self.watched.send(0x700 + self.number(port) | 1 << 30)

    @rule(count=st.integers(1, 5), data=st.binary(max_size=2))
    def synchronise(self, count, data):
        for _ in range(count):
            self.watched.send(SYNC, data)
            self.watched.wait(MS)

    @rule(
        port=PORTS,
        pdo=st.integers(0, 3),
        transmission=st.sampled_from((0, 1, 3, 252, 253, 254, 255)),
        inhibit=st.sampled_from((0, 50)),
    )
    def set_up_a_tpdo(self, port, pdo, transmission, inhibit):
        cob_id = (0x180, 0x280, 0x380, 0x480)[pdo] + self.number(port)
        self.write(port, 0x1800 + pdo, 1, struct.pack("<I", cob_id | 1 << 31))
        self.write(port, 0x1800 + pdo, 2, bytes((transmission,)))
        self.write(port, 0x1800 + pdo, 3, struct.pack("<H", inhibit))
        self.write(port, 0x1800 + pdo, 1, struct.pack("<I", cob_id))
        self.watched.send(cob_id | 1 << 30)

    @rule(port=PORTS, inhibit=st.sampled_from((0, 10, 5000)), times=st.integers(1, 12))
    def fail_and_recover(self, port, inhibit, times):
        """The owner of the node reports an error that is soon over, again and again."""
        self.write(port, 0x1015, 0, struct.pack("<H", inhibit))
        slave = self.watched.nodes[port].slave
        for _ in range(times):
            slave.emergencies.raise_cause("test", 0xFF00)
            slave.emergencies.clear_cause("test")
        self.watched.judge_memory()
        self.watched.wait(1_000)

    @rule(port=PORTS, behaviour=st.integers(0, 3))
    def lose_the_bus(self, port, behaviour):
        """The controller goes bus-off and recovers."""
        self.write(port, 0x1029, 1, bytes((behaviour,)))
        node = self.watched.nodes[port]
        if node.number != NOT_CONFIGURED:
            node.slave.bus_off()
            node.failed()
            self.watched.wait(1_000)
            node.slave.bus_recovered()
            self.watched.wait(1_000)

    @rule(can_id=st.integers(0, 0x7FF) | st.integers(0, 2**32 - 1), data=st.binary(max_size=8))
    def anything(self, can_id, data):
        if can_id != LSS_REQUEST:
            self.watched.send(can_id, data)

    @invariant()
    def keeps_little(self):
        if hasattr(self, "watched"):
            self.watched.judge_memory()


class UnconfiguredSlave(SlaveMachine):
    """The drive has left the factory without a node-ID."""

    unconfigured = (NODE,)


MACHINES = [SlaveMachine, UnconfiguredSlave]


@pytest.mark.ci
@pytest.mark.part
@pytest.mark.timeout(900)
@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.__name__)
def test_a_node_answers_each_request_once_for_a_tenth_of_a_long_time(machine):
    run_for(machine, examples=20, steps=100)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.__name__)
def test_a_node_answers_each_request_once_for_a_long_time(machine):
    run_for(machine, examples=200, steps=100)
    missing = {f"SDO {state}" for state in SDO_STATES} - set(REACHED[machine])
    assert not missing
