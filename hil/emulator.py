"""Emulator processes for the demo: serve a robot, draw one.

A served robot ends with our process; a drawn one follows from a seed.
"""

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from drive_profiles.address import LOCAL, Address
from hil.can.errors import BusUnavailableError
from hil.can.local import connect_local
from hil.errors import NotPossibleError

START_TIMEOUT_S = 120.0
"""A start takes under a second; a machine that is busy takes longer."""

SERVER_TIMEOUT_S = 10.0
"""Time that a server may take to end."""

DRAW_TIMEOUT_S = 120.0


@dataclass(frozen=True)
class DrawnRobot:
    """A robot drawn by its seed.

    Attributes:
        robot_file: Robot file, with all its truth.
        bench_file: Bench file, without plant and transmission error.
    """

    seed: int
    robot_file: Path
    bench_file: Path


def draw_robot(seed: int, folder: Path) -> DrawnRobot:
    """Let `plant-emulator fleet` draw a robot with a real gear.

    Raises:
        NotPossibleError: It cannot; its output is in the message.
    """
    command = [sys.executable, "-m", "plant_emulator", "fleet", "--seeds", str(seed), "--kind", "real", "--out", str(folder)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=DRAW_TIMEOUT_S, check=False)  # noqa: S603 - our own interpreter and module, no shell
    except subprocess.TimeoutExpired:
        raise NotPossibleError(f"robot {seed} was not drawn within {DRAW_TIMEOUT_S:g} s") from None
    if done.returncode != 0:
        raise NotPossibleError(f"robot {seed} was not drawn: {done.stderr.strip()}")
    return DrawnRobot(seed, folder / f"robot-{seed}.toml", folder / f"bench-{seed}.toml")


class EmulatorProcess:
    """A process of `plant-emulator serve`, on a socket in a temporary directory.

    The emulator ends when our end of its standard input closes, so that it never outlives this process.

    Attributes:
        process: The process; None before its start and after its end.
    """

    def __init__(self, robot: str, bitrate: int | None = None, *options: str) -> None:
        """Keep the robot and the bit rate of its bus.

        A bus without a bit rate has no bit times; `options` are more of `plant-emulator serve`.
        """
        self.robot, self._options = robot, options
        self._directory = tempfile.TemporaryDirectory(prefix="hil-")  # a socket's path has room for 107 bytes
        self.address = Address(LOCAL, str(Path(self._directory.name) / "robot.sock"), bitrate)
        self.process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Self:
        """Start the process and wait until it serves.

        Raises:
            BusUnavailableError: The process has ended, or does not serve in time; its output is in the message.
        """
        errors = Path(self._directory.name) / "errors.txt"
        with errors.open("w") as sink:
            self.process = subprocess.Popen(  # noqa: S603 - our own interpreter and module, no shell
                [sys.executable, "-m", "plant_emulator", "serve", "--robot", self.robot, "--bus", str(self.address),
                 "--until-stdin-closes", *self._options],
                stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=sink, text=True, start_new_session=True,
                env={name: value for name, value in os.environ.items() if name != "HIL_BUS"},  # its address is given
            )  # fmt: skip
        deadline = time.monotonic() + START_TIMEOUT_S
        while not self._answers():
            if self.process.poll() is not None or time.monotonic() > deadline:
                said = errors.read_text().strip() or f"it does not serve within {START_TIMEOUT_S:g} s"
                self.__exit__(None, None, None)
                raise BusUnavailableError(self.address, f"the emulator did not start: {said}")
            time.sleep(0.02)
        return self

    def _answers(self) -> bool:
        """True if the emulator accepts connections."""
        try:
            connect_local(self.address).close()
        except BusUnavailableError:
            return False
        return True

    def __exit__(self, _type: type[BaseException] | None, _value: BaseException | None, _tb: TracebackType | None) -> None:
        if self.process is not None:
            end(self.process)
            self.process = None
        self._directory.cleanup()


def end(process: subprocess.Popen[str]) -> None:
    """Close the pipes of a process that ends with its standard input, and wait for its end."""
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
    try:
        process.wait(SERVER_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
