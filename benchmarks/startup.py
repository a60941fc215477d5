"""How long one waits: for help, for the compiled parts cold and warm, for the demo."""

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.measure import Row, progress, seconds, table

ROOT = Path(__file__).parents[1]
PACKAGES = ("hil", "plant_emulator", "drive_profiles")
COMPILED = """
from hil.control.notch import Notch
from hil.control.cascade import Cascade
from hil.control.servo import Servo, ServoConfig
from plant_emulator.axes import Axes
from plant_emulator.robot import load_robot
axes = Axes(load_robot("reference"))
axes.energise(0, 1); axes.advance(1); axes.counts(0)
servo = Servo(ServoConfig(Cascade(25.0, 0.2, 4.0), 7.0, (Notch(),)), 250e-6)
servo.start(0.0); servo.step(0.0, 0.0)
"""
"""Everything that a host-closed run of the emulated robot calls."""


def _python(*arguments: str, path: Path = ROOT, cwd: str | None = None) -> float:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(path), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, *arguments]
    where = {"cwd": cwd or str(path), "env": environment}
    return seconds(lambda: subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **where))  # noqa: S603


def startup(repeats: int = 5) -> list[str]:
    """A fresh process each time; cold is a copy of our packages without any cache, Python's own included."""
    progress("start-up: help, and compiled parts cold and warm")
    bare = statistics.median(_python("-c", "pass") for _ in range(repeats))
    numba = statistics.median(_python("-c", "import numba, numpy") for _ in range(3))
    assisted = statistics.median(_python("-m", "hil.cli", "--help") for _ in range(repeats))
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        for name in PACKAGES:
            shutil.copytree(ROOT / name, Path(folder) / name, ignore=shutil.ignore_patterns("__pycache__"))
        cold = _python("-c", COMPILED, path=Path(folder))
        warm = statistics.median(_python("-c", COMPILED, path=Path(folder)) for _ in range(3))
    progress("start-up: demo")
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        demo = _python("-m", "hil.cli", "demo", "--no-story", "--out", str(Path(folder) / "demo"), cwd=folder)
    rows: list[Row] = [
        ("`python -c pass`", bare, 1.0),
        ("`hil --help`", assisted, assisted / bare),
        ("`import numba, numpy`", numba, numba / bare),
        ("law, drives and plant ready to run, cold: everything compiled", cold, cold / bare),
        ("the same, warm", warm, warm / bare),
        ("`hil demo --no-story`, warm: eight runs, figures and report", demo, demo / bare),
    ]
    return table(("a new process", "s", "`python -c pass` = 1"), rows)
