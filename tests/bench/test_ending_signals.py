"""Signals before and after a motion of a real process: one line, the truth about the arm, the shell's exit status."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.drive_profiles.cli.test_on_a_bus import serving

HOLDS = """
import pathlib, time
import {module} as held
from {package}.__main__ import main
whole = held.{function}
def hold(*values, **named):
    {first}
    pathlib.Path("held").touch()
    time.sleep(600.0)
held.{function} = hold
main()
"""
"""A tool that stands still before or after one of its functions."""
PATIENCE_S = 300.0
"""For a machine on which much else runs; a process that stands still lasts twice as long."""
BEFORE, AFTER = "pass", "whole(*values, **named)"
RUN = ("run", "constant-acceleration", "--axis", "2", "--bench", "reference", "--no-report")
MOVE = ("move", "--axis", "2", "--by", "0.5", "--bench", "reference")
PLANT = ("identify", "plant", "--axis", "2", "--bench", "reference", "--model", "model.toml")
UPLOAD = ("upload", "gain.toml", "--node", "2", "--yes")
CASES = {
    "run before its session": ("hil", "hil.bench.bench", "load_bench", BEFORE, RUN, "hil run constant-acceleration"),
    "run after its session": ("hil", "hil.experiments.runner", "run_experiments", AFTER, RUN, "hil run constant-acceleration"),
    "move before": ("hil", "hil.experiments.move", "plan_move", BEFORE, MOVE, "hil move"),
    "move between plan and motion": ("hil", "hil.experiments.move", "plan_move", AFTER, MOVE, "hil move"),
    "move after": ("hil", "hil.experiments.move", "make_move", AFTER, MOVE, "hil move"),
    "identify": ("hil", "hil.bench.bench", "load_bench", BEFORE, PLANT, "hil identify plant"),
    "upload": ("drive_profiles", "drive_profiles.upload.fleet", "prepare", BEFORE, UPLOAD, "drive-profiles upload gain.toml"),
}
EVERY_DAY = {
    ("move between plan and motion", signal.SIGTERM),
    ("upload", signal.SIGHUP),
}
SAID = {
    "run before its session": "before anything moved",
    "run after its session": r"after the last motion; axis 2 is at \S+ rev",
    "move before": "before anything moved",
    "move between plan and motion": r"before anything moved; axis 2 is at \S+ rev",
    "move after": r"after the last motion; axis 2 is at \S+ rev",
    "identify": "before anything moved",
    "upload": "before anything was written",
}


@pytest.fixture(scope="module")
def robot() -> Iterator[str]:
    with serving("--tuning", "reference") as address:
        yield address


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("gain.toml").write_text('[tuning]\nposition_gain_per_s = { value = 13.5, unit = "1/s" }\n')


@contextlib.contextmanager
def held(case: str, robot: str) -> Iterator[subprocess.Popen[str]]:
    """Yield the process of a command that stands still there."""
    package, module, function, first, words, _ = CASES[case]
    code = HOLDS.format(package=package, module=module, function=function, first=first)
    with subprocess.Popen(
        [sys.executable, "-c", code, *words, "--bus", robot], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            end = time.monotonic() + PATIENCE_S
            while not Path("held").exists():
                assert process.poll() is None, process.communicate()
                assert time.monotonic() < end
                time.sleep(0.01)
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize(
    ("case", "number"),
    [
        pytest.param(
            case,
            number,
            id=f"{case}, {number.name}",
            marks=() if (case, number) in EVERY_DAY else pytest.mark.ci if number == signal.SIGINT else pytest.mark.slow,
        )
        for case in CASES
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
        if number == signal.SIGTERM or "run" in case or case == "upload"
    ],
)
def test_a_signal_outside_of_a_motion_is_one_true_line_and_the_status_of_the_shell(
    robot: str, case: str, number: signal.Signals
) -> None:
    with held(case, robot) as process:
        process.send_signal(number)
        _, err = process.communicate(timeout=PATIENCE_S)
    who = "interrupted" if number == signal.SIGINT else f"{CASES[case][-1]} was interrupted by {number.name}"
    assert re.fullmatch(f"{who} {SAID[case]}", err.splitlines()[-1])
    assert process.returncode == 128 + number


def test_a_second_sigterm_ends_a_process_that_does_not_end() -> None:
    code = "import time; from drive_profiles.cli import entry; entry.hear(entry.interrupt)\n"
    code += "try:\n    print(flush=True); time.sleep(60)\nexcept KeyboardInterrupt:\n    print(flush=True); time.sleep(60)\n"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        for _ in range(2):
            process.stdout.readline()
            process.send_signal(signal.SIGTERM)
        process.wait(PATIENCE_S)
    assert process.returncode == -signal.SIGTERM


def test_the_end_of_a_terminal_is_129_although_nobody_reads_the_line(robot: str) -> None:
    """Hold a command that writes into a terminal, and close that."""
    package, module, function, first, words, _ = CASES["run before its session"]
    code = HOLDS.format(package=package, module=module, function=function, first=first)
    mine, its = os.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", code, *words, "--bus", robot], stdin=its, stdout=its, stderr=its, start_new_session=True
    )
    os.close(its)
    end = time.monotonic() + PATIENCE_S
    while not Path("held").exists() and time.monotonic() < end:
        time.sleep(0.01)
    os.close(mine)
    process.send_signal(signal.SIGHUP)
    assert process.wait(PATIENCE_S) == 128 + signal.SIGHUP
