"""Emulated robots as processes, each on a socket of its own."""

import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from hil.can.errors import BusUnavailableError
from hil.emulator import EmulatorProcess
from plant_emulator.pytest_plugin.target import bit_rate


class ServedBus:
    """`plant-emulator serve` as a process.

    Attributes:
        socket: Path of its socket.
        address: The same, as `--bus` and a bench file have it.
    """

    def __init__(self, process: subprocess.Popen[str], socket: Path, bitrate: int | None) -> None:
        """Keep the process and its address."""
        self.process, self.socket = process, socket
        self.address = f"local:{socket}" + ("" if bitrate is None else f"@{bitrate}")

    def __str__(self) -> str:
        """Return the address as text."""
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
