"""`drive-profiles upload --store --reset` as a process that is interrupted at any moment: all that it leaves says the same."""

import contextlib
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from drive_profiles.device.bus import SdoBus
from drive_profiles.device.target import device_at
from drive_profiles.upload import journal
from tests.drive_profiles.cli.test_on_a_bus import serving

VALUES = (13.5, 20.0)
IN_TIME, TOO_LATE = "interrupted: restoring every written value", "the interrupt came too late"


@pytest.fixture(scope="module")
def robot() -> Iterator[str]:
    with serving("--store-time-s", "0.05") as address:
        yield address


@dataclass
class Interrupted:
    """An upload that was interrupted.

    Attributes:
        status: Exit status as a shell sees it.
        out: What it said.
        took_s: Time from the start to the end.
        shown_s: Time from the start to the table of changes; None where none came.
    """

    status: int
    out: str
    took_s: float
    shown_s: float | None


def upload(robot: str, folder: Path, value: float, after_s: float, from_table: bool) -> Interrupted:
    """Upload a gain; interrupt it so long after the start, or after the table of changes."""
    file = folder / "gain.toml"
    file.write_text(f'[tuning]\nposition_gain_per_s = {{ value = {value}, unit = "1/s" }}\n')
    command = [sys.executable, "-u", "-m", "drive_profiles", "upload", str(file), "--bus", robot, "--node", "2"]
    command += ["--store", "--reset", "--yes", "--journals", str(folder / "journals")]
    began, shown = time.monotonic(), None
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    first = ""
    if from_table:
        first = process.stdout.readline() + process.stdout.readline()
        shown = time.monotonic() - began
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(after_s)
    with contextlib.suppress(ProcessLookupError):
        process.send_signal(signal.SIGINT)
    out = first + process.communicate(timeout=600)[0]
    # a signal that ends the interpreter's own start has come before the first line of the tool
    ended_early = ("Fatal Python error: init", "Could not import runpy module")
    is_early = process.returncode == -signal.SIGINT or any(words in out for words in ended_early)
    status = 130 if is_early else process.returncode
    return Interrupted(status, out, time.monotonic() - began, shown)


def held(robot: str) -> tuple[float, float]:
    """The gain that the drive holds, and the one that it holds after a reset."""
    with SdoBus(robot) as bus:
        device = device_at(bus, 2)
        entry = device.catalogue.find("position_gain_per_s")
        scaling = device.scaling([entry])
        now = entry.decoded(device.read(entry.address), scaling)
        device.reset(15.0)
        return now, entry.decoded(device.read(entry.address), scaling)


def agrees(robot: str, folder: Path, before: float, wanted: float, made: Interrupted) -> float:
    """Assert that status, last sentence, journal and drive say the same; the gain that the drive holds."""
    assert made.status in {0, 130}, made
    kept = before if made.status == 130 else wanted
    assert held(robot) == (kept, kept), made
    journals = sorted((folder / "journals").glob("*.jsonl"))
    if made.status == 130 and not journals:
        assert IN_TIME not in made.out
        assert TOO_LATE not in made.out
        return kept
    noted = journal.read(journals[-1])
    if made.status == 130:
        assert (noted.outcome, noted.stored) == ("rolled back", "no"), made
        assert "node 2: rolled back" in made.out
        assert IN_TIME in made.out
        assert TOO_LATE not in made.out
    else:
        assert (noted.outcome, noted.stored) == ("done", "yes"), made
        assert "node 2: done" in made.out
        assert IN_TIME not in made.out
    return kept


def interrupt_often(robot: str, folder: Path, count: int, seed: int) -> list[Interrupted]:
    """Interrupt so many uploads at moments drawn by a seed: a quarter from the start on, the rest from the table on."""
    chance = random.Random(seed)
    whole = [upload(robot, folder, value, 60.0, True) for value in VALUES]
    took_s = max(each.took_s for each in whole)
    writing_s = max(each.took_s - each.shown_s for each in whole)
    made = []
    before, _ = held(robot)
    for number in range(count):
        place = folder / f"{number}"
        place.mkdir()
        wanted = VALUES[0] if before == VALUES[1] else VALUES[1]
        from_table = number % 4 != 0
        after_s = chance.uniform(0.0, 1.1 * (writing_s if from_table else took_s))
        made.append(upload(robot, place, wanted, after_s, from_table))
        before = agrees(robot, place, before, wanted, made[-1])
    return made


@pytest.mark.slow  # an interrupt while pydantic builds a schema, before the upload, still ends in its SchemaError
def test_an_interrupt_at_200_moments_of_an_upload_leaves_one_truth(robot, tmp_path):
    made = interrupt_often(robot, tmp_path, 200, 2)
    assert {each.status for each in made} == {0, 130}
    assert any(TOO_LATE in each.out for each in made)
    assert any(IN_TIME in each.out for each in made)
