"""What the strangers need: a served robot, its TCP port, Node.js with the npm package canopen, and our clients' helpers."""

import hashlib
import json
import os
import shutil
import socket
import struct
import subprocess
import tempfile
import threading
from pathlib import Path

import pytest

from drive_profiles.address import Address
from hil.can.local import LocalChannel
from plant_emulator.bus.medium import medium_for
from plant_emulator.bus.server import Server
from plant_emulator.bus.virtualcan import VirtualcanListener
from plant_emulator.world import World
from tests.plant_emulator.bus.conftest import wait_for
from tests.plant_emulator.rig import ONE_AXIS

NODE_FOLDER = Path(__file__).parent / "node"
NODE_FILES = ("package.json", "package-lock.json", "crc/package.json", "crc/index.js")
INSTALL_TIMEOUT_S = 60
SCENARIO_TIMEOUT_S = 40


class Tcp:
    """A client of virtualcan, written from the format's description alone."""

    def __init__(self, endpoint):
        self.socket = socket.create_connection(endpoint, timeout=5.0)
        self.name = "{}:{}".format(*self.socket.getsockname()[:2])
        self._rest = b""

    def send(self, can_id, data=b"", flags=0):
        self.socket.sendall(message(can_id, data, flags))

    def receive(self):
        """Identifier, flags, data; None where the connection has ended."""
        while len(self._rest) < 18:
            try:
                more = self.socket.recv(4096)
            except ConnectionResetError:
                return None
            if not more:
                return None
            self._rest += more
        head, self._rest = self._rest[:18], self._rest[18:]
        size, can_id, flags, length, data = struct.unpack(">IIBB8s", head)
        assert size == 14
        assert data[length:] == bytes(8 - length)
        return can_id, flags, data[:length]

    def until(self, can_id):
        while (found := self.receive()) is not None:
            if found[0] == can_id:
                return found
        raise AssertionError(f"the connection ended before {can_id:X}h")

    def close(self):
        self.socket.close()


def message(can_id, data=b"", flags=0):
    return struct.pack(">IIBB8s", 14, can_id, flags, len(data), bytes(data))


def forget_node_id(client, dictionary, node_id):
    """Take the id from a node by LSS: selected by its identity, it is told 255 and resets its communication (CiA 305)."""
    for subindex, command in enumerate((0x40, 0x41, 0x42, 0x43), 1):
        client.send(0x7E5, struct.pack("<BI3x", command, dictionary.get(0x1018, subindex)))
    assert client.until(0x7E4)[2][0] == 0x44
    client.send(0x7E5, bytes((0x11, 0xFF, 0, 0, 0, 0, 0, 0)))
    assert client.until(0x7E4)[2][:2] == b"\x11\x00"
    client.send(0x7E5, bytes((0x04, 0, 0, 0, 0, 0, 0, 0)))
    client.send(0x000, bytes((0x82, node_id)))


class Served:
    """A server and its TCP port in a thread of the test, so that the test can look into the world.

    Args:
        path: Of the local bus' socket.
        robot: Which one; left out, one axis at node 3 and an accelerometer at node 16.
        wall: Time follows the wall clock, whoever sends SYNC.
        stream: A stream socket instead of a seqpacket one.
        host: Where its TCP port listens.
    """

    def __init__(self, path, *, robot=ONE_AXIS, wall=False, stream=False, host="127.0.0.1"):
        self.path = str(path)
        self.told, self._open = [], []
        self.world = World(robot)
        self.world.axes.advance(0)
        self.server = Server(self.world, self.path, stream=stream, medium=medium_for(self.world, None, wall=wall))
        self.listener = VirtualcanListener(host, 0, self.told.append)
        self.server.open(self.listener)
        self._thread = threading.Thread(target=self.server.run)
        self._thread.start()

    @property
    def drive(self):
        [drive] = self.world.drives.values()
        return drive

    def _joined(self, join):
        before = len(self.server._clients)
        self._open.append(participant := join())
        wait_for(lambda: len(self.server._clients) > before)
        return participant

    def join(self):
        """A client of its TCP port."""
        return self._joined(lambda: Tcp(self.listener.endpoint))

    def join_local(self):
        """A channel of ours."""
        return self._joined(lambda: LocalChannel(Address("local", self.path)))

    def close(self):
        for participant in self._open:
            participant.close()
        self.server.stop()
        self._thread.join(10.0)
        assert not self._thread.is_alive()


@pytest.fixture
def start_served(tmp_path):
    served = []

    def start(**options):
        served.append(Served(tmp_path / f"robot{len(served)}.sock", **options))
        return served[-1]

    yield start
    for each in served:
        each.close()


@pytest.fixture
def served(start_served):
    return start_served()


# -- Node.js -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def packages(pytestconfig, tmp_path_factory):
    """The folder in which the npm packages are: installed once for each lock file, in pytest's own cache folder."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip("no Node.js with npm here")
    key = hashlib.sha256(b"".join((NODE_FOLDER / name).read_bytes() for name in NODE_FILES)).hexdigest()[:16]
    cache = (
        tmp_path_factory.mktemp("node")
        if getattr(pytestconfig, "cache", None) is None
        else pytestconfig.cache.mkdir("node-canopen")
    )
    folder = Path(cache) / key
    if (folder / "node_modules").is_dir():
        return folder
    fresh = Path(tempfile.mkdtemp(dir=cache))
    for name in NODE_FILES:
        (fresh / name).parent.mkdir(exist_ok=True)
        shutil.copy(NODE_FOLDER / name, fresh / name)
    try:
        done = subprocess.run(
            [npm, "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--fetch-retries=1", "--fetch-timeout=20000"],
            cwd=fresh, capture_output=True, text=True, timeout=INSTALL_TIMEOUT_S, check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        reason = done.stderr.strip().splitlines()[-1:] if done.returncode else None
    except subprocess.TimeoutExpired:
        reason = [f"not within {INSTALL_TIMEOUT_S} s"]
    if reason is not None:
        shutil.rmtree(fresh, ignore_errors=True)
        pytest.skip(f"npm ci has failed: {' '.join(reason)}")
    try:
        os.rename(fresh, folder)
    except OSError:  # another worker was quicker
        shutil.rmtree(fresh, ignore_errors=True)
    return folder


@pytest.fixture
def master(packages, served):
    """Runs a scenario of script.mjs on the served robot; what it has found, merged."""

    def run(scenario, **given):
        port = str(served.listener.endpoint[1])
        done = subprocess.run(
            ["node", str(NODE_FOLDER / "script.mjs"), str(packages), port, scenario, json.dumps(given)],  # noqa: S607
            capture_output=True, text=True, timeout=SCENARIO_TIMEOUT_S, check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        assert done.returncode == 0, f"{done.stderr}\n{done.stdout}"
        assert served.told == []
        return [json.loads(line) for line in done.stdout.splitlines()]

    return run
