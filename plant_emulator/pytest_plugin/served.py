"""Emulated robots as processes, each on a socket of its own."""

import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Self

import pytest

from plant_emulator.pytest_plugin.target import bit_rate
from plant_emulator.sealed import LATE

START_TIMEOUT_S = 90.0
"""The first start compiles the plant."""
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
        """End all servers and remove their sockets.

        A late import or compilation in a server gives a warning.
        """
        for bus in self._buses:
            bus.process.terminate()
        late = [line for bus in self._buses for line in self._ended(bus.process).splitlines() if line.startswith(LATE)]
        self._directory.cleanup()
        for line in late:
            warnings.warn(line, RuntimeWarning, stacklevel=2)

    @staticmethod
    def _ended(process: subprocess.Popen[str]) -> str:
        """Return a process's standard error until its end."""
        try:
            return process.communicate(timeout=SERVER_TIMEOUT_S)[1]
        except subprocess.TimeoutExpired:
            process.kill()
            return process.communicate()[1]
