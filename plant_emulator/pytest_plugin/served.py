"""Emulated robots as processes, each on a socket of its own."""

import subprocess
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import pytest

from hil.can.errors import BusUnavailableError
from hil.emulator import EmulatorProcess
from plant_emulator.pytest_plugin.target import bit_rate


class ServedBus:
    """`plant-emulator serve` as a process.

    Attributes:
        process: The process.
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


class LocalBusServers:
    """Servers of local buses, which a `with` statement starts and ends."""

    def __init__(self, config: pytest.Config) -> None:
        """Keep the options of pytest; nothing is started."""
        self._robot: str = config.getoption("hil_robot") or "reference"
        self._bitrate = bit_rate(config)
        self._emulators = ExitStack()

    def __enter__(self) -> Self:
        """Return the servers; nothing is started yet."""
        return self

    def start(self, *options: str, robot: str | None = None) -> ServedBus:
        """Start one and wait until it serves.

        Args:
            options: More of `plant-emulator serve`.
            robot: Robot file; `--hil-robot` of pytest unless it is given.
        """
        emulator = EmulatorProcess(robot or self._robot, self._bitrate, *options)
        try:
            self._emulators.enter_context(emulator)
        except BusUnavailableError as error:
            pytest.fail(error.reason, pytrace=False)
        assert emulator.process is not None  # noqa: S101 - it has been started
        return ServedBus(emulator.process, Path(emulator.address.channel), self._bitrate)

    def __exit__(self, *_: object) -> None:
        """End all of them and remove their sockets."""
        self._emulators.close()
