"""Benches of all sizes: in one process for exactness, as processes on a real socket for truth."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hil.master.bench import Bench, load_bench
from plant_emulator.robot import Robot, load_robot

HIL = (sys.executable, "-m", "hil.cli")
START_TIMEOUT_S = 90.0


@pytest.fixture(scope="session")
def reference_bench() -> Bench:
    return load_bench("reference")


@pytest.fixture(scope="session")
def reference_robot() -> Robot:
    return load_robot("reference")


@pytest.fixture(scope="session")
def quiet_robot(reference_robot: Robot) -> Robot:
    """The reference robot with an accelerometer that has neither noise nor a coarse step."""
    sensor = reference_robot.accelerometer.model_copy(update={"noise_m_s2": 0.0, "resolution_m_s2": 0.0})
    return reference_robot.model_copy(update={"accelerometer": sensor})


def with_bus(bench: Bench, **changes: object) -> Bench:
    return bench.model_copy(update={"bus": bench.bus.model_copy(update=changes)})


def with_motion(bench: Bench, **changes: object) -> Bench:
    motion = bench.constant_acceleration
    assert motion is not None
    return bench.model_copy(update={"constant_acceleration": motion.model_copy(update=changes)})


@pytest.fixture
def short_bench(reference_bench: Bench) -> Bench:
    """A second of motion up to 4 rps: enough for what does not look at the vibration."""
    return with_motion(reference_bench, acceleration_rps_s=8.0, end_rps=4.0, tail_s=0.1)


class Emulator:
    """`plant-emulator serve` as a process."""

    def __init__(self, process: subprocess.Popen[str], socket: Path) -> None:
        self.process, self.socket = process, socket
        self.address = f"local:{socket}"


@pytest.fixture
def start_emulator(tmp_path: Path) -> Iterator[Callable[..., Emulator]]:
    processes: list[subprocess.Popen[str]] = []

    def start(*options: str, robot: str = "reference", name: str = "robot.sock") -> Emulator:
        socket = tmp_path / name
        process = subprocess.Popen(
            [sys.executable, "-m", "plant_emulator", "serve", "--robot", robot, "--bus", f"local:{socket}", *options],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        processes.append(process)
        deadline = time.monotonic() + START_TIMEOUT_S
        while not socket.is_socket():
            if process.poll() is not None or time.monotonic() > deadline:
                raise AssertionError(f"the emulator did not start: {process.communicate()[1]}")
            time.sleep(0.01)
        return Emulator(process, socket)

    yield start
    for process in processes:
        if process.poll() is None:
            process.terminate()
        process.communicate(timeout=10)


@pytest.fixture
def emulator(start_emulator: Callable[..., Emulator]) -> Emulator:
    return start_emulator()
