"""Emulated robots as processes, each on a socket of its own."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Self

import pytest

from plant_emulator.pytest_plugin.target import bit_rate

START_TIMEOUT_S = 90.0
"""A start takes under a second; a machine that is busy takes longer."""
SERVER_TIMEOUT_S = 10.0


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
        self._directory = tempfile.TemporaryDirectory(prefix="hil-")  # a socket's path has room for 107 bytes; pytest's are long
        self._buses: list[ServedBus] = []

    def __enter__(self) -> Self:
        """Return the servers; nothing is started yet."""
        return self

    def start(self, *options: str, robot: str | None = None) -> ServedBus:
        """Start one and wait until it serves.

        Args:
            options: More of `plant-emulator serve`.
            robot: Robot file; `--hil-robot` of pytest unless it is given.
        """
        path = Path(self._directory.name) / f"robot{len(self._buses)}.sock"
        bus = ServedBus(
            subprocess.Popen(  # noqa: S603 - our own interpreter and module, no shell
                [sys.executable, "-m", "plant_emulator", "serve", "--robot", robot or self._robot, "--until-stdin-closes",
                 "--bus", f"local:{path}" + ("" if self._bitrate is None else f"@{self._bitrate}"), *options],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            ),
            path,
            self._bitrate,
        )  # fmt: skip
        self._buses.append(bus)
        deadline = time.monotonic() + START_TIMEOUT_S
        while not path.is_socket():
            if bus.process.poll() is not None:
                pytest.fail(f"the emulator did not start: {bus.process.communicate()[1].strip()}", pytrace=False)
            if time.monotonic() > deadline:
                pytest.fail(f"the emulator does not serve within {START_TIMEOUT_S:g} s", pytrace=False)
            time.sleep(0.01)
        return bus

    def __exit__(self, *_: object) -> None:
        """End all of them and remove their sockets."""
        for bus in self._buses:
            bus.process.terminate()
        for bus in self._buses:
            try:
                bus.process.communicate(timeout=SERVER_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                bus.process.kill()
                bus.process.communicate()
        self._directory.cleanup()
