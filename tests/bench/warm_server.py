"""`plant-emulator serve` without its second of loading: a process that has loaded everything is copied for each robot.

So a robot is as fresh as in a process of its own: dictionary, faults, time, noise and places of the axes are its own, which no
reset over the bus puts back.
"""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from hil.emulator import SERVER_TIMEOUT_S, START_TIMEOUT_S
from plant_emulator.pytest_plugin.target import ServedBus

IS_POSSIBLE = hasattr(os, "pidfd_open")


class Copy:
    """A copied process, as far as tests ask for one.

    Attributes:
        pid: Its number.
    """

    def __init__(self, pid: int) -> None:
        self.pid, self._handle = pid, os.pidfd_open(pid)

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has gone."""
        with contextlib.suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._handle, number)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)

    def has_ended(self, timeout_s: float = 0.0) -> bool:
        """Whether it ends in time."""
        return bool(select.select([self._handle], [], [], timeout_s)[0])

    def end(self) -> None:
        """End it in good order, or else at once."""
        self.send_signal(signal.SIGTERM)
        if not self.has_ended(SERVER_TIMEOUT_S):
            self.kill()
        os.close(self._handle)


class WarmServers:
    """The process that is copied; robots end with it.

    Args:
        folder: For the sockets, whose paths have to be short.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._count = folder, 0
        command = [sys.executable, "-m", "tests.bench.warm_server"]
        self._process = subprocess.Popen(
            command, cwd=Path(__file__).parents[2], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._answer() == "ready"

    def _answer(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()

    @contextlib.contextmanager
    def serving(self) -> Iterator[ServedBus]:
        """A robot on a bus of its own."""
        self._count += 1
        path, said = (self._folder / f"{self._count}.{what}" for what in ("sock", "said"))
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps([str(path), str(said)]) + "\n")
        self._process.stdin.flush()
        copy = Copy(int(self._answer()))
        deadline = time.monotonic() + START_TIMEOUT_S
        while not path.is_socket():
            assert not copy.has_ended(), said.read_text(encoding="utf-8")
            assert time.monotonic() < deadline
            time.sleep(0.002)
        try:
            yield ServedBus(copy, path, None)  # type: ignore[arg-type]
        finally:
            copy.end()

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(SERVER_TIMEOUT_S)
        self._process.stdout.close()


def _serve(path: str, said: str, alive: int) -> None:
    """Be a server: standard input is open as long as the process that was copied lives."""
    from plant_emulator.cli.main import app  # noqa: PLC0415

    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    words = os.open(said, os.O_WRONLY | os.O_CREAT)
    for target, source in enumerate((alive, words, words)):
        os.dup2(source, target)
    with contextlib.suppress(SystemExit):
        app(["serve", "--robot", "reference", "--bus", f"local:{path}", "--until-stdin-closes"])
    sys.stdout.flush()


def main() -> None:
    """Load everything, then copy this process for each line: paths of a socket and of a file for what is said."""
    from plant_emulator.announcement import announced  # noqa: F401, PLC0415
    from plant_emulator.bus.server import Server  # noqa: F401, PLC0415
    from plant_emulator.robots.robot import load_robot  # noqa: PLC0415
    from plant_emulator.serial.accelerometer import EmulatedSerialAccelerometer  # noqa: F401, PLC0415
    from plant_emulator.world import World  # noqa: PLC0415

    robot = load_robot("reference")
    World(robot).power_on()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for the copies
    alive, held = os.pipe()
    print("ready", flush=True)  # noqa: T201 - to whom has started it
    for line in iter(sys.stdin.readline, ""):
        pid = os.fork()
        if pid == 0:
            os.close(held)
            try:
                _serve(*json.loads(line), alive)
            finally:
                os._exit(0)
        print(pid, flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
