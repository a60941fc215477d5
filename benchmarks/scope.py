"""The live page: what it costs its sender, what the page draws and loses, and what a run by the wall clock notices of it.

python -m benchmarks.scope --seconds 60 --runs 5
"""

import argparse
import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from importlib import resources
from pathlib import Path

from drive_profiles.address import parse_address
from hil.can.local import connect_local
from hil.can.opening import open_channel
from hil.emulator import EmulatorProcess
from hil.scope.process import ScopeProcess
from tests.hil.report.browser import Browser
from tests.hil.scope.traffic import Traffic, played

NODES = tuple(range(41, 47))
RATE_HZ = 1000
SLOW = (
    ("acceleration_rps_s = 4.0", "acceleration_rps_s = 1.0"),
    ("position_max_rev = 22.0", "position_max_rev = 2200.0"),
    ("speed_rps = 12.0", "speed_rps = 24.0"),
    ("missing_limit = 3 ", "missing_limit = 20 "),
    ("heartbeat_s = 0.1 ", "heartbeat_s = 0.5 "),
)
"""A motion of ten seconds instead of two and a half, and limits that bear other work on the machine: late cycles are counted."""
GAPS = "[...document.querySelectorAll('#events .gap')].map(each => each.textContent)"
"""Stretches in which the scope says that it has heard nothing."""
STEPS_PER_S = os.sysconf("SC_CLK_TCK")


class Url(str):
    """An address as `Browser.open` takes it."""

    def as_uri(self) -> str:
        """The address."""
        return str(self)


def processor_s(pid: int) -> float:
    """Processor time of a process, user and system."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / STEPS_PER_S


def stream(seconds: int, viewers: int) -> str:
    """A line of the table: six drives at 1 kHz by the wall clock, with so many pages that look on."""
    with (
        tempfile.TemporaryDirectory() as folder,
        EmulatorProcess("reference") as emulator,
        ScopeProcess(str(emulator.address), "reference", 0) as scope,
    ):
        browsers = [Browser(Path(folder, str(number))) for number in range(viewers)]
        for browser in browsers:
            browser.open(Url(scope.url))
        channel = open_channel(parse_address(str(emulator.address)))
        played(channel, Traffic(NODES).set_up().run(RATE_HZ).heard(), 10.0)
        time.sleep(2.0)
        traffic = Traffic(NODES, 1_000_000_000 // RATE_HZ).run(seconds * RATE_HZ).heard()
        before = [browser.value("[scope.store.received, scope.draws]") for browser in browsers]
        cpu_s, begin_s = processor_s(scope.pid), time.monotonic()
        thread = threading.Thread(target=played, args=(channel, traffic, 2.0 * seconds))
        thread.start()
        thread.join()
        wall_s, cpu_s = time.monotonic() - begin_s, processor_s(scope.pid) - cpu_s
        deadline = time.monotonic() + 30.0
        while time.monotonic() < deadline and any(
            browser.value("scope.store.received") - early[0] < seconds * RATE_HZ - 1
            for browser, early in zip(browsers, before, strict=True)
        ):
            time.sleep(0.2)
        after = [
            browser.value("[scope.store.received, scope.draws, scope.store.lost, scope.signals.length]") for browser in browsers
        ]
        gaps = browsers[0].value(GAPS) if browsers else []
        channel.close()
        for browser in browsers:
            browser.close()
    rows = ", ".join(str(late[0] - early[0]) for early, late in zip(before, after, strict=True))
    draws = ", ".join(f"{(late[1] - early[1]) / wall_s:.1f}" for early, late in zip(before, after, strict=True))
    lost, signals = sum(late[2] for late in after), after[0][3] if after else 0
    return (
        f"| {viewers} | {signals} | {wall_s:.1f} | {len(traffic) / wall_s:.0f} | {100.0 * cpu_s / wall_s:.1f} | {rows} of "
        f"{seconds * RATE_HZ} | {lost} | {draws} | {'; '.join(gaps) or 'none'} |"
    )


def slow_bench(folder: Path) -> Path:
    """The reference bench with a motion that lasts, over more turns than it allows."""
    text = (resources.files("hil.bench") / "reference.toml").read_text(encoding="utf-8")
    for before, after in SLOW:
        if before not in text:
            raise ValueError(f"the reference bench has no {before!r} any more")
        text = text.replace(before, after, 1)
    path = folder / "bench.toml"
    path.write_text(text, encoding="utf-8")
    return path


def free_port() -> int:
    """A port of loopback that nobody has."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def looked_at(run: subprocess.Popen[bytes], port: int, folder: Path, viewers: int) -> None:
    """Open so many pages beside a run as soon as there are any, and close them when it has ended."""
    while run.poll() is None:
        try:
            socket.create_connection(("127.0.0.1", port), 1.0).close()
            break
        except OSError:
            time.sleep(0.2)
    with contextlib.ExitStack() as pages:
        for number in range(viewers if run.poll() is None else 0):
            browser = pages.enter_context(Browser(folder / f"profile{number}"))
            browser.open(Url(f"http://127.0.0.1:{port}/"))
        run.wait()


def beside(runs: int, viewers: int) -> list[str]:
    """Lines of a table: runs by the wall clock, in turn without the page and with it and so many that look at it."""
    lines = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        address, bench = f"local:{folder}/robot.sock", slow_bench(folder)
        command = [sys.executable, "-m", "plant_emulator", "serve", "--robot", "reference", "--bus", address, "--wall"]
        emulator = subprocess.Popen(command, stdout=subprocess.DEVNULL)  # noqa: S603 - our own interpreter and module
        try:
            for _ in range(200):
                if (folder / "robot.sock").exists():
                    connect_local(parse_address(address)).close()
                    break
                time.sleep(0.1)
            for number in range(2 * runs):
                out, port, is_seen = folder / str(number), free_port(), bool(number % 2)
                run = subprocess.Popen(  # noqa: S603 - as above
                    [sys.executable, "-m", "hil", "run", "constant-acceleration", "--axis", "2", "--bench", str(bench),
                     "--bus", address, "--reset-faults", "--no-report", "--yes", "--out", str(out),
                     *(["--live", str(port)] if is_seen else [])],
                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )  # fmt: skip
                looked_at(run, port, folder / f"pages{number}", viewers) if is_seen else run.wait()
                lines += line_of(out, "with" if is_seen else "without")
        finally:
            emulator.terminate()
            emulator.wait()
    return sorted(lines, key=lambda line: "without" not in line)


def line_of(out: Path, name: str) -> list[str]:
    """The line of a run, with the load of the machine behind it; none where it has not moved."""
    path = out / "result.json"
    found = json.loads(path.read_text())["runs"][:1] if path.exists() else []
    return [
        f"| {name} | {each['timing']['cycles']} | {1e6 * each['timing']['lateness']['p50_s']:.0f} | "
        f"{1e6 * each['timing']['lateness']['p99_s']:.0f} | {1e6 * each['timing']['lateness']['max_s']:.0f} | "
        f"{each['timing']['dropped_cycles']} | {each['missed_cycles']} | {os.getloadavg()[0]:.1f} |"
        for each in found
    ]


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--viewers", type=int, default=2)
    parser.add_argument("--runs", type=int, default=5)
    asked = parser.parse_args()
    print(f"load of the machine before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")  # noqa: T201
    if asked.seconds:
        print("| viewers | signals | s | frames/s | sender % of a core | rows received | rows lost | draws/s | gaps said |")  # noqa: T201
        print("|---|---|---|---|---|---|---|---|---|")  # noqa: T201
        print(stream(asked.seconds, asked.viewers), flush=True)  # noqa: T201
    print("| page | cycles | lateness p50 µs | p99 µs | max µs | dropped | missed | load |")  # noqa: T201
    print("|---|---|---|---|---|---|---|---|")  # noqa: T201
    print("\n".join(beside(asked.runs, asked.viewers)))  # noqa: T201
    print(f"load of the machine behind: {os.getloadavg()[0]:.1f}")  # noqa: T201


if __name__ == "__main__":
    main()
