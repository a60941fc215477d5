"""The server in a thread of the test, where the test can look into its world, and as a process, as its user has it."""

import contextlib
import socket
import subprocess
import sys
import threading
import time

import pytest

from drive_profiles.address import Address
from hil.can.frame import RECORD
from hil.can.local import LocalChannel
from plant_emulator.bus.server import Server
from plant_emulator.world import World
from tests.plant_emulator.rig import ONE_AXIS

PATIENCE_S = 60.0
"""Longest wait for what comes: a test that only waits does not ask how soon."""


def wait_for(happened, timeout_s=PATIENCE_S):
    deadline = time.monotonic() + timeout_s
    while not happened():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.002)


class Wall:
    """The monotonic clock, until a test takes it in hand."""

    def __init__(self):
        self._held_ns = None

    def __call__(self):
        return time.monotonic_ns() if self._held_ns is None else self._held_ns

    def hold(self):
        self._held_ns = time.monotonic_ns()

    def pass_s(self, seconds):
        self._held_ns += round(1e9 * seconds)


class Running:
    """A server that serves in a thread."""

    def __init__(self, path, stream):
        self.path = str(path)
        self.world = World(ONE_AXIS)
        self.world.axes.advance(0)
        self.wall = Wall()
        self.server = Server(self.world, self.path, stream=stream, now_ns=self.wall)
        self.kind = socket.SOCK_STREAM if stream else socket.SOCK_SEQPACKET
        self._open = []
        self._thread = threading.Thread(target=self.server.run)
        self._thread.start()

    @property
    def drive(self):
        return self.world.drives[3]

    def hold_wall(self):
        """Stop the clock on the wall, and the world that follows it."""
        self.wall.hold()
        wait_for(lambda: self.world.now == self.server.time())

    def pass_wall_s(self, seconds):
        """Let a world that follows the clock pass some time, never so much at once that it has fallen behind."""
        for _ in range(round(seconds / 0.005)):
            self.wall.pass_s(0.005)
            wait_for(lambda: self.world.now == self.server.time())

    def _joined(self, participant, before):
        self._open.append(participant)
        wait_for(lambda: len(self.server._clients) > before)
        return participant

    def join(self):
        """A channel of ours."""
        before = len(self.server._clients)
        return self._joined(LocalChannel(Address("local", self.path)), before)

    def plug(self):
        """A bare socket."""
        before = len(self.server._clients)
        sock = socket.socket(socket.AF_UNIX, self.kind)
        sock.connect(self.path)
        sock.settimeout(5.0)
        return self._joined(sock, before)

    def stop(self):
        self.server.stop()
        self._thread.join(10.0)
        assert not self._thread.is_alive()

    def close(self):
        for participant in self._open:
            participant.close()
        self.stop()


@pytest.fixture
def start_server(tmp_path):
    running = []

    def start(stream=False, path=None):
        running.append(Running(path or tmp_path / "robot.sock", stream))
        return running[-1]

    yield start
    for each in running:
        each.close()


@pytest.fixture
def running(start_server):
    return start_server()


@pytest.fixture(params=[False, True], ids=["seqpacket", "stream"])
def either(request, start_server):
    return start_server(request.param)


@pytest.fixture
def serve(tmp_path):
    """`plant-emulator serve` as a process; give it an open standard input with stdin=subprocess.PIPE."""
    processes = []

    def start(*options, stdin=subprocess.DEVNULL, name="robot.sock", wait=True):
        path = tmp_path / name
        process = subprocess.Popen(
            [sys.executable, "-m", "plant_emulator", "serve", "--bus", f"local:{path}", *options],
            stdin=stdin, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        processes.append(process)
        if wait:
            line = process.stdout.readline()
            assert line.startswith("serving"), process.communicate()[1]
        return process, path

    yield start
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.communicate(timeout=10)


def record(can_id, data=b""):
    return RECORD.pack(can_id, len(data), data)


def frames_until(channel, wanted, timeout_s=PATIENCE_S):
    """The frames up to the first with this identifier."""
    frames, deadline = [], time.monotonic() + timeout_s
    while not frames or frames[-1].can_id != wanted:
        assert time.monotonic() < deadline, f"no frame {wanted:#x}, but {len(frames)}, the last {frames[-3:]}"
        frame = channel.receive(0.1)
        if frame is not None:
            frames.append(frame)
    return frames


def drain(channel, timeout_s=0.05):
    frames = []
    while (frame := channel.receive(timeout_s)) is not None:
        frames.append(frame)
    return frames


@contextlib.contextmanager
def closing(sock):
    try:
        yield sock
    finally:
        sock.close()
