"""How long one waits: for help, for the core, for the demo; and what a call of the core costs."""

import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

from benchmarks.measure import Row, progress, seconds, table, turns

ROOT = Path(__file__).parents[1]
PACKAGES = ("hil", "plant_emulator", "drive_profiles")
READY = """
from hil.control.notch import Notch
from hil.control.cascade import Cascade
from hil.control.servo import Servo, ServoConfig
from plant_emulator.motion.axes import Axes
from plant_emulator.robots.robot import load_robot
axes = Axes(load_robot("reference"))
axes.open_brake(0, 1); axes.advance(1); axes.counts(0)
servo = Servo(ServoConfig(Cascade(25.0, 0.2, 4.0), 7.0, (Notch(),)), 250e-6)
servo.start(0.0); servo.step(0.0, 0.0)
"""
"""Everything that a host-closed run of the emulated robot calls."""

CALLS = """
import json, statistics, time
from hil.control.cascade import Cascade
from hil.control.notch import Notch
from hil.control.servo import ServoConfig
from hil.control.servo_bank import ServoBank
from plant_emulator.motion.axes import Axes
from plant_emulator.robots.robot import load_robot
axes = Axes(load_robot("reference"))
for row in range(3):
    axes.open_brake(row, 1)
bank = ServoBank([ServoConfig(Cascade(25.0, 0.2, 4.0), 7.0, (Notch(),))] * 3, 250e-6)
zeros = [0.0] * 3
calls = {
    "one control period of three drives and their plant": lambda: axes.advance(1),
    "the laws of three axes": lambda: bank.step(zeros, zeros),
    "the law of one axis": lambda: bank.step_one(0, 0.0, 0.0),
}
def us(call):
    begin = time.process_time()
    for _ in range(4000):
        call()
    return 250.0 * (time.process_time() - begin)
print(json.dumps({name: statistics.median(us(call) for _ in range(6)) for name, call in calls.items()}))
"""
"""Prints the microseconds of single calls: pointer, call, and what it computes."""


class Times(NamedTuple):
    """Times of a start: until it was there, and of the processor."""

    waited_s: float
    worked_s: float


def _environment(path: Path) -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(path), os.environ.get("PYTHONPATH", "")])}


def _python(*arguments: str, path: Path = ROOT, cwd: str | None = None) -> Times:
    def run() -> None:
        command, nowhere = [sys.executable, *arguments], subprocess.DEVNULL
        subprocess.run(command, check=True, stdout=nowhere, stderr=nowhere, cwd=cwd or path, env=_environment(path))  # noqa: S603

    return _waited_and_worked(lambda: seconds(run))


def _copy(folder: Path) -> Path:
    """Our packages with their core, and without Python's caches."""
    for name in PACKAGES:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def startup(repeats: int = 5) -> list[str]:
    """A fresh process each time; first is a copy of our packages without Python's caches."""
    progress("start-up: help and core")
    bare = _medians(_python("-c", "pass") for _ in range(turns(repeats)))
    assisted = _medians(_python("-m", "hil", "--help") for _ in range(turns(repeats)))
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        _copy(Path(folder))
        cold = _python("-c", READY, path=Path(folder))
        warm = _medians(_python("-c", READY, path=Path(folder)) for _ in range(turns(repeats)))
        served = _medians([_waited_and_worked(lambda: _served(Path(folder))) for _ in range(turns(repeats) + 1)][1:])
    progress("start-up: demo")
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        demo = _python("-m", "hil", "demo", "--no-tour", "--out", str(Path(folder) / "demo"), cwd=folder)
    found = {
        "`python -c pass`": bare,
        "`hil --help`": assisted,
        "law, drives and plant ready to run, first start": cold,
        "the same, later starts": warm,
        "`plant-emulator serve` until it serves": served,
        "`hil demo --no-tour`, warm: eleven runs, figures and report": demo,
    }
    rows: list[Row] = [(name, times.waited_s, times.worked_s, times.worked_s / bare.worked_s) for name, times in found.items()]
    return table(("a new process", "s", "processor time, s", "`python -c pass` = 1"), rows)


def calls(repeats: int = 5) -> list[str]:
    """Calls of the core from Python."""
    progress("core: calls")
    found = [_calls(ROOT) for _ in range(turns(repeats))]
    rows: list[Row] = [(name, statistics.median(turn[name] for turn in found)) for name in found[0]]
    return table(("a call of the core", "µs"), rows)


def _medians(times: Iterable[Times]) -> Times:
    waited_s, worked_s = zip(*times, strict=True)
    return Times(statistics.median(waited_s), statistics.median(worked_s))


def _waited_and_worked(start: Callable[[], float]) -> Times:
    """Seconds that `start` says one waits, and all processes' work until they have ended."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    waited = start()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return Times(waited, after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)


def _served(path: Path) -> float:
    """Until the emulator says that it serves; then it ends."""
    command = [sys.executable, "-m", "plant_emulator", "serve", "--bus", f"local:{path}/robot.sock", "--until-stdin-closes"]
    begin = time.perf_counter()
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, cwd=path, env=_environment(path), stdin=pipe, stdout=pipe)  # noqa: S603
    said = process.stdout.readline() if process.stdout else b""
    waited = time.perf_counter() - begin
    process.communicate()
    if not said or process.returncode:
        raise RuntimeError("the emulator does not serve")
    return waited


def _calls(path: Path) -> dict[str, float]:
    command = [sys.executable, "-c", CALLS]
    found: dict[str, float] = json.loads(subprocess.check_output(command, cwd=path, env=_environment(path)))  # noqa: S603
    return found
