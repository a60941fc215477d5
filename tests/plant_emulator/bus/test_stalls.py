"""A world that has fallen behind the wall clock: what came meanwhile is heard first, and its stall is nobody's silence."""

import contextlib
import itertools
import os
import signal
import struct
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.address import Address
from hil.can.frame import CAN_RTR_FLAG, Frame
from hil.can.local import LocalChannel
from plant_emulator.bus.medium import medium_for
from plant_emulator.bus.server import Server
from plant_emulator.bus.stalls import MADE_UP_NS, QUIET_NS, SILENCE_NS, WallTime, made_up, spread
from plant_emulator.drive.dictionary.manufacturer_objects import USER_TEXT
from plant_emulator.world import World
from tests.plant_emulator.bus.conftest import drain, wait_for
from tests.plant_emulator.rig import ONE_AXIS

MS = 1_000_000
NODE = 3
BEAT = Frame(0x77F, b"\x05")
ASK = Frame(0x603, bytes.fromhex("4041600000000000"))
STALL_S = 0.25

times = st.integers(0, 2_000 * MS)


# -- the arithmetic ----------------------------------------------------------------------------------------------------


@given(times, times, st.lists(times, max_size=40).map(sorted))
def test_time_never_runs_back_nor_faster_than_the_wall(begin, lag, arrivals):
    instants, reached = made_up(begin, begin + lag, arrivals)
    assert len(instants) == len(arrivals)
    passed = [begin, *instants, reached]
    assert passed == sorted(passed)
    assert reached - begin <= min(lag, MADE_UP_NS)
    assert all(later - earlier <= SILENCE_NS for earlier, later in itertools.pairwise(passed))


@given(times, st.lists(st.integers(0, SILENCE_NS), min_size=1, max_size=10))
def test_a_stall_in_which_frames_kept_coming_is_made_up_for_frame_by_frame(begin, gaps):
    arrivals = [begin + sum(gaps[: i + 1]) for i in range(len(gaps))]
    assert made_up(begin, arrivals[-1], arrivals) == (arrivals, arrivals[-1])


def test_frames_of_before_and_of_after_count_as_those_of_begin_and_end():
    assert made_up(10, 20, [-5, 3, 15, 99]) == ([10, 10, 15, 20], 20)


def test_a_busy_machine_does_not_fill_the_terminal():
    """Ten minutes of stalls are ten lines, not six hundred; after ten quiet minutes the next stall is said at once."""
    now, words = [0], []
    wall = WallTime(lambda: now[0], 0, words.append)

    def stall(ms):
        now[0] += ms * MS
        wall.catch_up(0, ms * MS, [])

    for _ in range(6_000):
        stall(100)
    assert len(words) == 10
    assert words[-1].endswith(" in 2560 stalls; it first processed the frames that had arrived")
    now[0] += QUIET_NS
    stall(60)
    assert len(words) == 11


def test_frames_of_unknown_arrival_are_spread_evenly():
    assert spread(100, 200, 4) == [125, 150, 175, 200]
    assert spread(100, 200, 0) == []


# -- a process that is stopped -----------------------------------------------------------------------------------------


class Master:
    """Sends heartbeats every 100 ms, and keeps what it hears, in a thread of its own.

    Attributes:
        latest_s: Its own longest silence: a busy machine may stop it too, and then the drive is right to miss it.
    """

    def __init__(self, path):
        self.channel = LocalChannel(Address("local", str(path)))
        self.heard, self.latest_s = [], 0.0
        self._is_beating = self._is_on = True
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        due = before = time.monotonic()
        while self._is_on:
            now = time.monotonic()
            if self._is_beating and now >= due:
                self.latest_s, before, due = max(self.latest_s, now - before), now, now + 0.1
                self.channel.send(BEAT)
            frame = self.channel.receive(0.002)
            if frame is not None:
                self.heard.append(frame)

    def fall_silent(self):
        self._is_beating = False

    def of(self, can_id):
        return [frame.data for frame in tuple(self.heard) if frame.can_id == can_id]

    def ask(self, *data):
        """One SDO request that is answered."""
        before = len(self.of(0x580 + NODE))
        self.channel.send(Frame(0x600 + NODE, bytes(data).ljust(8, b"\0")))
        wait_for(lambda: len(self.of(0x580 + NODE)) > before)
        return self.of(0x580 + NODE)[-1]

    def be_heard(self):
        """Return when the server has heard all that has been sent: after it, a node guarding request is answered."""
        before = len(self.of(0x700 + NODE))
        self.channel.send(Frame(CAN_RTR_FLAG | 0x700 + NODE, bytes(1)))
        wait_for(lambda: len(self.of(0x700 + NODE)) > before)

    def lost_masters(self):
        return [data[:2].hex() for data in self.of(0x080 + NODE)].count("3081")

    def close(self):
        if self._is_on:
            self._is_on = False
            self._thread.join()
            self.channel.close()


@pytest.fixture
def join():
    with contextlib.ExitStack() as ends:

        def joined(path):
            ends.callback((master := Master(path)).close)
            return master

        yield joined


@contextlib.contextmanager
def stopped(process, seconds=STALL_S):
    """Stop a process, as a debugger or a busy machine does, until the block has ended and the time is over."""
    end = time.monotonic() + seconds
    os.kill(process.pid, signal.SIGSTOP)
    try:
        yield
        time.sleep(max(0.0, end - time.monotonic()))
    finally:
        os.kill(process.pid, signal.SIGCONT)


def said(process):
    """What a server says on standard error until its end."""
    process.terminate()
    return process.communicate(timeout=30)[1]


@pytest.mark.wall
@pytest.mark.parametrize("options", [(), ("--stream",)], ids=["seqpacket", "stream"])
def test_a_stalled_server_misses_no_master_that_kept_sending_and_says_that_it_stalled(serve, join, options):
    process, path = serve("--wall", *options)
    for _ in range(10):
        master = join(path)
        master.ask(0x23, 0x16, 0x10, 1, *struct.pack("<I", 127 << 16 | 200))  # 1016h: within 200 ms
        for _ in range(4):
            with stopped(process):
                pass
            time.sleep(0.05)
        master.ask(0x40, 0x41, 0x60)  # whatever it has to say stands before the answer
        if master.latest_s < 0.15:
            break
        master.ask(0x23, 0x16, 0x10, 1, 0, 0, 0, 0)
        master.close()
    else:
        pytest.fail("this machine is too busy for a master that keeps 100 ms")
    assert master.lost_masters() == 0
    master.fall_silent()
    wait_for(lambda: master.lost_masters() == 1)  # and a real loss is found
    master.close()
    assert "ms late and skipped" in said(process)


@pytest.mark.wall
def test_a_block_download_under_way_in_a_stall_is_acknowledged_once(serve, join):
    process, path = serve("--wall")
    master = join(path)
    text = bytes(range(32, 32 + 70))
    master.ask(0xC2, *struct.pack("<HB", USER_TEXT, 0), *struct.pack("<I", len(text)))
    segments = [bytes((number + 1 | (0x80 if number == 9 else 0), *text[7 * number : 7 * number + 7])) for number in range(10)]
    before = len(master.of(0x580 + NODE))
    master.channel.send(Frame(0x600 + NODE, segments[0]))
    master.be_heard()
    with stopped(process, 0.3):
        for segment in segments[1:]:
            master.channel.send(Frame(0x600 + NODE, segment))
    wait_for(lambda: len(master.of(0x580 + NODE)) > before)
    end = master.ask(0xC1, 0, 0)
    answers = master.of(0x580 + NODE)[before:]
    assert [data[:3].hex() for data in answers] == ["a20a0a", "a10000"], "one acknowledgement, of all ten"
    assert end[0] == 0xA1


@pytest.mark.wall
def test_a_block_upload_under_way_in_a_stall_goes_on(serve, join):
    process, path = serve("--wall")
    master = join(path)
    opened = master.ask(0xA0, *struct.pack("<HB", 0x1008, 0), 1)  # one segment at a time
    length = int.from_bytes(opened[4:], "little")
    got = [master.ask(0xA3)]
    assert length > 14
    while not got[-1][0] & 0x80:
        before = len(master.of(0x580 + NODE))
        with stopped(process):
            master.channel.send(Frame(0x600 + NODE, bytes((0xA2, 1, 1, 0, 0, 0, 0, 0))))
        wait_for(lambda before=before: len(master.of(0x580 + NODE)) > before)
        got.append(master.of(0x580 + NODE)[-1])
    ended = master.ask(0xA2, 1, 1)
    assert ended[0] & 0xE3 == 0xC1
    assert b"".join(segment[1:] for segment in got)[:length] == b"Emulated servo drive"
    answers = master.of(0x580 + NODE)
    assert len(answers) == len(got) + 2, "nothing is sent twice"


# -- its clock in the test's hand --------------------------------------------------------------------------------------


class Held:
    """A server whose clock moves in the test's hand alone, and whose thread stands still there while the test wants it to."""

    def __init__(self, path, *, stream, wall):
        self.words, self._gate, self._stands = [], threading.Event(), threading.Event()
        self._gate.set()
        self._now_ns = time.monotonic_ns()
        self.world = World(ONE_AXIS)
        self.world.axes.advance(0)
        medium = medium_for(self.world, None, wall=wall)
        self.server = Server(self.world, str(path), stream=stream, medium=medium, now_ns=self._look, say=self.words.append)
        self._thread = threading.Thread(target=self.server.run)
        self._thread.start()

    def _look(self):
        if not self._gate.is_set():
            self._stands.set()
            self._gate.wait()
        return self._now_ns

    def pass_ms(self, count=1):
        for _ in range(count):
            self._now_ns += MS
            wait_for(lambda: self.world.now == self.server.time())

    def ask(self, channel, frame=ASK):
        """The frames up to the answer of the drive; time passes meanwhile, a millisecond at a time."""
        channel.send(frame)
        frames = []
        while not frames or frames[-1].can_id != 0x583:
            self.pass_ms()
            frames += drain(channel, 0.002)
        return frames

    def stand_still(self, milliseconds, meanwhile):
        self._stands.clear()
        self._gate.clear()
        assert self._stands.wait(10.0)  # it has looked at the clock, and stands there
        meanwhile()
        self._now_ns += milliseconds * MS
        self._gate.set()
        wait_for(lambda: self.world.now == self.server.time())

    def close(self):
        self._gate.set()
        self.server.stop()
        self._thread.join(10.0)


@pytest.fixture
def hold(tmp_path):
    with contextlib.ExitStack() as ends:

        def start(*, stream=False, wall=False):
            held = Held(tmp_path / "robot.sock", stream=stream, wall=wall)
            ends.callback(held.close)
            channel = LocalChannel(Address("local", str(tmp_path / "robot.sock")))
            ends.callback(channel.close)
            return held, channel

        yield start


@pytest.mark.parametrize(("stream", "wall"), [(True, True), (False, False), (True, False)])
def test_where_no_arrivals_are_known_frames_count_as_spread_over_the_stall(hold, stream, wall):
    """Without `--wall` too, as long as nobody has sent a SYNC: then the world follows the clock."""
    held, channel = hold(stream=stream, wall=wall)
    held.ask(channel, Frame(0x603, struct.pack("<BHBI", 0x23, 0x1016, 1, 127 << 16 | 30)))
    channel.send(BEAT)
    held.ask(channel)
    held.stand_still(250, lambda: [channel.send(BEAT) for _ in range(20)])
    heard = held.ask(channel)
    assert emergencies(heard) == []
    assert [words.split(" and ")[0] for words in held.words] == ["the emulator was 250 ms late"]
    held.pass_ms(40)
    assert emergencies(held.ask(channel)) == ["3081"]


def emergencies(frames):
    return [frame.data[:2].hex() for frame in frames if frame.can_id == 0x083]


def test_a_client_that_left_during_a_stall_was_heard_and_harms_nobody(hold):
    held, channel = hold(wall=True)
    guest = LocalChannel(channel.address)
    held.ask(guest)
    drain(channel)

    def leave():
        guest.send(Frame(0x124, b"\2"))
        guest.close()

    held.stand_still(250, leave)
    heard = held.ask(channel)
    assert Frame(0x124, b"\2") in heard
    assert len(held.server._clients) == 1
