"""What the tests on a kernel with SocketCAN share: vcan0, the emulated robot on it, and the bench's commands as processes."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest

from drive_profiles.address import Address
from hil.can.frame import Frame
from hil.can.socketcan import SocketCanChannel

VCAN = Address("socketcan", "vcan0")
REFERENCE = (Path(__file__).parents[2] / "hil" / "bench" / "reference.toml").read_text()
NODES = {2, 3, 5, 16}
SYNC_PERIOD_S = 0.016
"""What a virtual machine on a busy computer holds; the tests are about reactions, not about speed."""
START_TIMEOUT_S = 240.0
"""A program that is started there for the first time compiles, at a fraction of the computer's speed."""


def is_up(interface: str = VCAN.channel) -> bool:
    with contextlib.suppress(OSError):
        return bool(int(Path("/sys/class/net", interface, "flags").read_text(), 16) & 1)
    return False


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("vcan") and not is_up():
        pytest.skip("no vcan0 here; test_in_a_virtual_machine.py runs these where it can")


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True)  # noqa: S607 - where ip is depends on the system


def tc(*arguments: str) -> None:
    subprocess.run(["tc", "qdisc", *arguments], check=True, capture_output=True, text=True)  # noqa: S607 - as above


@pytest.fixture
def root() -> None:
    """The right to change interfaces."""
    if os.geteuid() != 0:
        pytest.skip("changing an interface needs root")


@pytest.fixture
def netem(root: None) -> Iterator[Callable[..., None]]:
    """What `tc netem` does to every frame on vcan0, until it is told "" or the test ends."""
    if Path("/sys/module/vcan/parameters/echo").read_text().strip() != "Y":
        pytest.skip("vcan hands frames back before its queueing discipline: load it with echo=1")

    def disturb(what: str) -> None:
        with contextlib.suppress(subprocess.CalledProcessError):  # nothing to remove
            tc("del", "dev", "vcan0", "root")
        if what:
            tc("add", "dev", "vcan0", "root", "netem", *what.split())

    yield disturb
    disturb("")


def interface(name: str) -> Iterator[Address]:
    ip("link", "add", name, "type", "vcan")
    ip("link", "set", name, "up")
    yield Address("socketcan", name)
    with contextlib.suppress(subprocess.CalledProcessError):  # a test may have deleted it
        ip("link", "del", name)


@pytest.fixture
def spare(root: None) -> Iterator[Address]:
    """An interface of the test's own, which it may break."""
    yield from interface("vcan7")


class Emulator:
    """`plant-emulator serve` on a SocketCAN interface, as a process."""

    def __init__(self, address: Address, folder: Path) -> None:
        self.address = address
        self._errors = folder / f"emulator-{address.channel}.txt"
        serve = [sys.executable, "-m", "plant_emulator", "serve", "--bus", str(address)]
        if os.geteuid() == 0:
            serve = ["nice", "-n", "-10", *serve]  # a drive has a processor of its own
        with self._errors.open("w") as errors:
            self.process = subprocess.Popen(
                serve, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors, text=True
            )  # fmt: skip
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line.startswith(f"serving reference on {address}"), self._errors.read_text()
        with Listener(address) as bus:
            bus.upload(2, 0x1000, timeout_s=START_TIMEOUT_S)

    def errors(self) -> str:
        return self._errors.read_text()

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
        self.process.communicate(timeout=20)


class Listener:
    """A stranger on the bus: it counts, asks, and commands."""

    def __init__(self, address: Address = VCAN, *can_ids: int) -> None:
        self.channel = SocketCanChannel(address, [(can_id, 0x7FF) for can_id in can_ids])
        self.counts: Counter[int] = Counter()

    def __enter__(self) -> "Listener":
        return self

    def __exit__(self, *_: object) -> None:
        self.channel.close()

    def wait_for(self, done: Callable[[Frame], bool], timeout_s: float = 60.0) -> Frame:
        deadline = time.monotonic() + timeout_s
        while True:
            left = deadline - time.monotonic()
            assert left > 0.0, f"it did not happen in time; heard: {self.counts}"
            frame = self.channel.receive(left)
            if frame is not None:
                self.counts[frame.can_id] += 1
                if done(frame):
                    return frame

    def wait_for_motion(self, run: subprocess.Popen[str], cycles: int = 60) -> None:
        """That many set-points for axis 2: enabled and settled takes 50 of them."""
        end, deadline = self.counts[0x202] + cycles, time.monotonic() + START_TIMEOUT_S
        while self.counts[0x202] < end:
            assert run.poll() is None, run.communicate()
            assert time.monotonic() < deadline, f"the run does not move; heard: {self.counts}"
            frame = self.channel.receive(1.0)
            if frame is not None:
                self.counts[frame.can_id] += 1

    def upload(self, node: int, index: int, subindex: int = 0, timeout_s: float = 5.0) -> bytes:
        """A stranger's expedited upload; asked again while nobody answers."""
        place = bytes((index & 0xFF, index >> 8, subindex))
        deadline = time.monotonic() + timeout_s
        while True:
            self.channel.send(Frame(0x600 + node, b"\x40" + place + bytes(4)))
            with contextlib.suppress(AssertionError):
                answer = self.wait_for(lambda frame: frame.can_id == 0x580 + node and frame.data[1:4] == place, 1.0)
                assert answer.data[0] & 0xE0 == 0x40
                return answer.data[4:]
            assert time.monotonic() < deadline, f"node {node} is silent"

    def reset_nodes(self) -> None:
        """All nodes as after power-on; waits for their boot-up messages."""
        self.channel.send(Frame(0x000, b"\x81\x00"))
        waiting = set(NODES)

        def booted(frame: Frame) -> bool:
            if frame.data == b"\0":
                waiting.discard(frame.can_id - 0x700)
            return not waiting

        self.wait_for(booted, 10.0)


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Emulator]:
    with contextlib.closing(Emulator(VCAN, tmp_path_factory.mktemp("emulator"))) as emulator:
        yield emulator


@pytest.fixture
def robot(served: Emulator) -> Emulator:
    """The emulated robot on vcan0, as after power-on; one process for all tests, since its start takes seconds."""
    with Listener() as bus:
        bus.reset_nodes()
    return served


@pytest.fixture
def own_robot(spare: Address, tmp_path: Path) -> Iterator[Emulator]:
    """An emulated robot on an interface of the test's own."""
    with contextlib.closing(Emulator(spare, tmp_path)) as emulator:
        yield emulator


def bench_file(folder: Path, *changes: tuple[str, str]) -> Path:
    """The reference bench at a SYNC period that a virtual machine holds."""
    text = REFERENCE
    for before, after in (("sync_period_s = 0.002 ", f"sync_period_s = {SYNC_PERIOD_S} "), *changes):
        assert before in text
        text = text.replace(before, after, 1)
    path = folder / "bench.toml"
    path.write_text(text)
    return path


SLOW = (("acceleration_rps_s = 4.0", "acceleration_rps_s = 0.2"), ("position_max_rev = 22.0", "position_max_rev = 2200.0"))
"""50 s of motion, over more turns than the reference bench allows: time to interfere."""
ROOM = ("speed_rps = 12.0", "speed_rps = 24.0")
"""A SYNC that is early by a share of the period asks for a step that is longer by that share, and 6080h must allow it."""
GENTLE = (("acceleration_rps_s = 4.0", "acceleration_rps_s = 0.5"), ("end_rps = 10.0", "end_rps = 2.0"))
"""4 s at less than a tenth of what 6080h then allows: a set-point that steps over a few lost ones is none too far."""


Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start_run() -> Iterator[Start]:
    """`hil run` as a process; none outlives its test."""
    runs: list[subprocess.Popen[str]] = []

    def start(bench: Path, out: Path, address: Address = VCAN, *more: str) -> subprocess.Popen[str]:
        runs.append(_start_run(bench, out, address, *more))
        return runs[-1]

    yield start
    for run in runs:
        if run.poll() is None:
            run.kill()
            run.communicate()


def _start_run(bench: Path, out: Path, address: Address, *more: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "hil", "run", "constant-acceleration", "--axis", "2", "--bench", str(bench),
         "--bus", str(address), "--out", str(out), "--yes", "--no-report", *more],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def end_of(run: subprocess.Popen[str], timeout_s: float = START_TIMEOUT_S) -> tuple[int, str]:
    """Exit status, and what was said."""
    try:
        said, errors = run.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        run.kill()
        raise
    return run.returncode, said + errors


class Dump:
    """candump beside what a test does; into a file, since a pipe that nobody reads would hold it up."""

    def __init__(self, path: Path, address: Address = VCAN) -> None:
        self._path = path
        with path.open("w") as file:
            self._process = subprocess.Popen(["candump", "-L", "-r", str(4 << 20), address.channel], stdout=file)  # noqa: S607 - as above
        time.sleep(0.5)  # it says nothing before the first frame

    def end(self) -> list[str]:
        """Every frame, as ID#DATA."""
        time.sleep(0.5)
        self._process.send_signal(signal.SIGTERM)
        self._process.wait(20)
        return [line.split()[2] for line in self._path.read_text().splitlines()]


def frames_of(log: Path) -> Counter[str]:
    """Every frame of a bus log, as candump writes it."""
    return Counter(f"{message.arbitration_id:03X}#{bytes(message.data).hex().upper()}" for message in can.LogReader(log))
