"""The emulated robot on somebody else's bus: the world follows the wall clock, and says when it could not."""

import struct
import subprocess
import sys

import can
import pytest

from drive_profiles.address import Address
from hil.can.errors import BusLostError
from hil.can.frame import CAN_ERR_FLAG, Frame
from hil.can.opening import open_channel
from plant_emulator.bus.attach import TURN_FRAMES, Attachment
from plant_emulator.bus.stalls import SILENCE_NS
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World

MS = 1_000_000
BEAT = Frame(0x77F, b"\x05")


class Bus:
    """A channel whose frames the test lays out, under a clock that the test moves."""

    is_lock_step = False
    waits = True
    overflows = 0
    address = Address("virtual", "test")

    def __init__(self):
        self.now, self.waiting, self.sent, self.closed = 0, [], [], False

    def clock(self):
        return self.now

    def send(self, frame):
        self.sent.append(frame)

    def receive(self, timeout_s):
        if self.waiting:
            return self.waiting.pop(0)
        self.now += max(0, round(1e9 * timeout_s))
        return None

    def close(self):
        self.closed = True


@pytest.fixture
def bus():
    return Bus()


@pytest.fixture
def words():
    return []


@pytest.fixture
def attachment(bus, words):
    attachment = Attachment(World(load_robot("reference")), bus, say=words.append, clock=bus.clock)
    attachment.world.power_on()
    return attachment


def ask(node=2, index=0x6041):
    return Frame(0x600 + node, bytes((0x40, index & 0xFF, index >> 8, 0, 0, 0, 0, 0)))


def test_the_world_keeps_to_the_clock(attachment, bus, words):
    for _ in range(100):
        attachment.turn(0.001)
    assert bus.now == 100 * MS
    assert 0 <= bus.now - attachment.world.now <= MS
    assert (attachment.time.stalls, words) == (0, [])


def test_a_request_is_answered_at_the_instant_at_which_it_is_read(attachment, bus):
    bus.now = 7 * MS
    bus.waiting = [ask()]
    attachment.turn(0.001)
    assert attachment.world.now == 7 * MS
    assert [frame.can_id for frame in bus.sent] == [0x582]
    assert attachment.frames == 1


def test_a_sync_moves_no_time(attachment, bus):
    bus.waiting = [Frame(0x80, b"")] * 10
    attachment.turn(0.0)
    attachment.turn(0.0)
    assert attachment.world.now == 0


def test_many_frames_are_answered_in_turns_and_none_is_lost(attachment, bus):
    bus.waiting = [ask() for _ in range(3 * TURN_FRAMES + 1)]
    for _ in range(4):
        attachment.turn(0.0)
    assert len(bus.sent) == attachment.frames == 3 * TURN_FRAMES + 1


def test_error_frames_are_not_for_the_nodes(attachment, bus):
    bus.waiting = [Frame(CAN_ERR_FLAG | 0x4, bytes(8)), ask()]
    attachment.turn(0.0)
    assert attachment.frames == 1


def test_a_short_delay_is_caught_up_with(attachment, bus, words):
    bus.now = SILENCE_NS
    attachment.turn(0.0)
    assert attachment.world.now == SILENCE_NS
    assert words == []


def test_a_stall_is_said_and_its_silence_not_made_up_for(attachment, bus, words):
    bus.now = 3_000 * MS
    attachment.turn(0.0)
    assert attachment.world.now == SILENCE_NS
    assert (attachment.time.stalls, attachment.time.lost_ns) == (1, 2_950 * MS)
    assert len(words) == 1
    assert "3000 ms late and skipped 2950 ms" in words[0]
    bus.now += 5 * MS
    attachment.turn(0.0)
    assert attachment.world.now == SILENCE_NS + 5 * MS


def test_stalls_are_said_after_a_second_with_their_sum(attachment, bus, words):
    for _ in range(12):
        bus.now += 100 * MS
        attachment.turn(0.0)
    assert attachment.time.stalls == 12
    assert len(words) == 2
    assert "1000 ms late and skipped 500 ms in 10 stalls" in words[1]


def watch_master(attachment, timeout_ms):
    """Heartbeat consumer of node 2: node 127 within the time, from its first heartbeat on."""
    attachment.world.receive(Frame(0x602, struct.pack("<BHBI", 0x23, 0x1016, 1, 127 << 16 | timeout_ms)))
    attachment.world.receive(BEAT)


def emergencies(bus):
    return [frame.data[:2].hex() for frame in bus.sent if frame.can_id == 0x82]


def test_heartbeats_that_came_during_a_stall_are_heard_before_their_deadline(attachment, bus):
    watch_master(attachment, 30)
    for stall_ms in (20, 45, 250, 400):
        bus.now += stall_ms * MS
        bus.waiting = [BEAT] * (stall_ms // 10)
        attachment.turn(0.0)
    assert emergencies(bus) == []


def test_a_frame_that_is_read_after_a_stall_is_heard_before_its_deadline(attachment, bus):
    """The stall comes between the look at the clock and the answer of `receive`."""
    watch_master(attachment, 30)
    receive = bus.receive

    def late(timeout_s):
        bus.receive = receive
        bus.now += 40 * MS
        bus.waiting = [BEAT] * 4
        return receive(timeout_s)

    bus.receive = late
    attachment.turn(0.001)
    assert attachment.world.now == 40 * MS
    assert emergencies(bus) == []


def test_a_master_that_is_silent_beyond_a_stall_is_found(attachment, bus):
    watch_master(attachment, 30)
    bus.now += 20 * MS
    attachment.turn(0.0)
    assert emergencies(bus) == []
    for _ in range(11):
        bus.now += MS
        attachment.turn(0.0)
    assert emergencies(bus) == ["3081"]


def test_it_runs_on_any_python_can_bus_until_it_is_stopped(request):
    with can.Bus(interface="virtual", channel=request.node.name) as stranger:
        attachment = Attachment(World(load_robot("reference")), open_channel(Address("virtual", request.node.name)))
        attachment.channel.send = lambda frame, send=attachment.channel.send: (send(frame), attachment.stop())
        attachment.run()
        attachment.close()
        assert stranger.recv(1.0).arbitration_id == 0x702  # boot-up


def test_a_lost_bus_ends_it(attachment, bus):
    def lose(timeout_s):
        raise BusLostError(bus.address, "the interface is down")

    bus.receive = lose
    with pytest.raises(BusLostError):
        attachment.run()
    attachment.close()
    assert bus.closed


def test_a_parent_that_goes_ends_it(attachment, bus, tmp_path):
    with (tmp_path / "nothing").open("w+") as file:
        attachment.watch(file.fileno())
        attachment.run()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "status", "words"),
    [
        (["--bus", "socketcan:nosuch0"], 4, "nosuch0"),
        (["--bus", "nosuch:x"], 2, "nosuch"),
        (["--bus", "socketcan:vcan0", "--slcan", "/nowhere/tty"], 2, "--slcan"),
    ],
)
def test_wrong_calls_say_what_is_wrong(options, status, words):
    done = subprocess.run(
        [sys.executable, "-m", "plant_emulator", "serve", *options], capture_output=True, text=True, timeout=100, check=False
    )
    assert done.returncode == status, done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr
