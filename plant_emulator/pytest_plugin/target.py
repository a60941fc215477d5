"""The target of a test."""

import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NoReturn

import pytest

from drive_profiles.address import LOCAL, AddressError, parse_address, parse_bit_rate
from drive_profiles.errors import DriveProfileError
from hil.bench.bench import Bench, load_bench
from hil.can.channel import Channel, OneByOne
from hil.can.errors import BusLostError, BusUnavailableError
from hil.can.frame import Frame
from hil.can.opening import open_channel
from hil.emulator import EmulatorProcess
from hil.recording import BusLog
from plant_emulator.pytest_plugin.artefacts import Artefacts
from plant_emulator.pytest_plugin.emulated import EmulatedRobot
from plant_emulator.pytest_plugin.interference import Interference
from plant_emulator.robots.robot import Robot, load_robot

EMULATED_ANSWER_TIMEOUT_S = 0.05
"""Time-out in one process, where an answer comes at once or never."""
PORT_OF_THE_BUS, PORT_OF_THE_MASTER = 0, 1000


class RealChannel(OneByOne):
    """An existing bus, with loss of frames if the test demands it."""

    def __init__(self, inner: Channel, interference: Interference) -> None:
        self._inner, self.interference = inner, interference
        self.address = inner.address
        self.is_lock_step, self.waits = inner.is_lock_step, inner.waits
        self.lost = False
        interference.join(time.monotonic_ns, inner.send, self)

    @property
    def overflows(self) -> int | None:
        """Received frames lost in full buffers; None if they are not counted."""
        return self._inner.overflows

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus, unless a fault drops it."""
        self._check()
        self.interference.run_due()
        self._check()
        if self.interference.frames.apply(frame, PORT_OF_THE_MASTER, time.monotonic_ns()):
            self._inner.send(frame)

    def receive(self, timeout_s: float) -> Frame | None:
        """Return the next frame that no fault drops, or None."""
        self._check()
        deadline = time.monotonic() + timeout_s
        while True:
            frame = self._inner.receive(max(0.0, deadline - time.monotonic()))
            if frame is None or self.interference.frames.apply(frame, PORT_OF_THE_BUS, time.monotonic_ns()):
                return frame

    def close(self) -> None:
        """Leave the bus."""
        self._inner.close()

    def _check(self) -> None:
        if self.lost:
            raise BusLostError(self.address, "pulled")


class Target:
    """The bench of all fixtures of one test.

    Attributes:
        bench: The bench file, with the address at which the robot is.
        artefacts: Frames and recordings that are saved if the test fails.
        interference: Faults of the bus that the test asks for.
        robot: The emulated robot, or None on another bus.
    """

    def __init__(self, config: pytest.Config, bench: Bench, artefacts: Artefacts, robot: EmulatedRobot | None = None) -> None:
        self.config, self.bench, self.artefacts, self.robot = config, bench, artefacts, robot
        self.interference = Interference(artefacts.trace) if robot is None else robot.channel.interference
        self.where = "the emulated robot" if robot is not None else f"the bus {bench.bus.address} of --hil-bench"
        self._opened: Channel | None = None

    @property
    def log(self) -> BusLog:
        """Log to which the master writes its frames.

        The emulated bus carries more frames than its master receives, and traces them itself.
        """
        return self.artefacts.trace if self.robot is None else BusLog(None)

    def channel(self) -> Channel:
        """Bus, opened at first use."""
        if self.robot is not None:
            return self.robot.channel
        if self._opened is None:
            try:
                self._opened = RealChannel(open_channel(parse_address(self.bench.bus.address)), self.interference)
            except BusUnavailableError as error:
                self.is_missing(str(error))
        assert self._opened is not None  # noqa: S101 - a missing bus has ended the test
        return self._opened

    def is_missing(self, what: str) -> NoReturn:
        """Skip, or fail with `--hil-require-hardware`, because hardware is missing."""
        if self.config.getoption("hil_require_hardware"):
            pytest.fail(f"--hil-require-hardware: {what}", pytrace=False)
        pytest.skip(what)

    def check_motion_is_allowed(self) -> None:
        """Skip a motion of a real robot without `--hil-allow-motion`."""
        is_real = self.robot is None and parse_address(self.bench.bus.address).interface != LOCAL
        if is_real and not self.config.getoption("hil_allow_motion"):
            pytest.skip(f"would move the robot on {self.bench.bus.address}; give --hil-allow-motion to permit it")

    def close(self) -> None:
        """Leave the bus."""
        if self._opened is not None:
            self._opened.close()


def load_model(config: pytest.Config) -> Robot:
    """Load the robot file of `--hil-robot`, else the reference."""
    try:
        return load_robot(config.getoption("hil_robot") or "reference")
    except DriveProfileError as error:
        pytest.fail(f"--hil-robot: {error}", pytrace=False)


def open_target(config: pytest.Config, model: Callable[[], Robot], artefacts: Artefacts) -> Target:
    """Open the target that `--hil-bench` and `--hil-robot` name."""
    name: str = config.getoption("hil_bench")
    try:
        bench = load_bench(name)
    except DriveProfileError as error:
        pytest.fail(f"--hil-bench: {error}", pytrace=False)
    if name != "reference" and config.getoption("hil_robot") is None:
        return Target(config, bench, artefacts)
    bitrate = bit_rate(config)
    robot = EmulatedRobot(model(), bitrate, Interference(artefacts.trace))
    changes = {"address": str(robot.channel.address), "answer_timeout_s": EMULATED_ANSWER_TIMEOUT_S}
    bus = bench.bus.model_copy(update=changes)
    return Target(config, bench.model_copy(update={"bus": bus}), artefacts, robot)


def bit_rate(config: pytest.Config) -> int | None:
    """Return `--hil-bitrate` in bit/s, spelled as in an address."""
    text: str | None = config.getoption("hil_bitrate")
    if text is None:
        return None
    try:
        return parse_bit_rate(text)
    except AddressError as error:
        pytest.fail(f"--hil-bitrate {error}", pytrace=False)


class ServedBus:
    """`plant-emulator serve` as a process.

    Attributes:
        address: The bus as `--bus` and a bench file have it.
    """

    def __init__(self, process: subprocess.Popen[str], socket: Path, bitrate: int | None) -> None:
        self.process, self.socket = process, socket
        self.address = f"local:{socket}" + ("" if bitrate is None else f"@{bitrate}")

    def __str__(self) -> str:
        return self.address


@contextmanager
def local_bus_servers(config: pytest.Config) -> Iterator[Callable[..., ServedBus]]:
    """Yield a starter of servers of local buses; at the end, all of them end and their sockets are removed."""
    own_robot: str = config.getoption("hil_robot") or "reference"
    bitrate = bit_rate(config)

    def start(*options: str, robot: str | None = None) -> ServedBus:
        """Start one and wait until it serves.

        Args:
            options: More of `plant-emulator serve`.
            robot: Robot file; `--hil-robot` of pytest unless it is given.
        """
        emulator = EmulatorProcess(robot or own_robot, bitrate, *options)
        try:
            emulators.enter_context(emulator)
        except BusUnavailableError as error:
            pytest.fail(error.reason, pytrace=False)
        assert emulator.process is not None  # noqa: S101 - it has been started
        return ServedBus(emulator.process, Path(emulator.address.channel), bitrate)

    with ExitStack() as emulators:
        yield start
