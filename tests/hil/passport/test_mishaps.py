"""Mishaps of a passport: files of another version, an interrupt, a full disk, clocks that were not set, places that are none."""

import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from hil.bench.model import Identified
from hil.passport.store import VERSION, PassportRun, add, read
from hil.passport.watch import trends
from tests.hil.passport.test_passport import called, error, model

pytestmark = pytest.mark.usefixtures("without_pictures")


def run(name: str) -> PassportRun:
    return PassportRun(name, "arm", 2, "2026-01-01T00:00:00+00:00", "identify", "")


@pytest.mark.parametrize("version", [VERSION - 1, VERSION + 1])
def test_a_passport_of_another_version_is_refused(tmp_path: Path, version: int):
    add(tmp_path / "p.sqlite", [])
    newer = sqlite3.connect(tmp_path / "p.sqlite")
    newer.execute(f"PRAGMA user_version = {version}")
    newer.close()
    done = called(tmp_path, "--file", tmp_path / "p.sqlite")
    assert done.exit_code == 3, done.output
    assert f"a passport of version {version}" in done.stderr


def test_an_interrupt_while_writing_loses_nothing_and_adds_nothing(tmp_path: Path):
    add(tmp_path / "p.sqlite", [run("h0")])

    def interrupted():
        yield from (run("h1"), run("h2"))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        add(tmp_path / "p.sqlite", interrupted())
    assert [each.content for each in read(tmp_path / "p.sqlite")] == ["h0"]
    assert add(tmp_path / "p.sqlite", [run("h1"), run("h2")]) == 2, "and it can be written again"


@pytest.mark.slow
def test_a_disk_that_is_full_is_said_and_the_passport_is_as_before(tmp_path: Path):
    """The kernel refuses to let files grow beyond a limit, as a full disk does."""
    model(tmp_path / "runs", *(error(note="x" * 3000, day=day) for day in range(1, 28)))
    add(tmp_path / "p.sqlite", [run("h")])
    command = (
        "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (60000, 60000)); from hil.__main__ import main; main()"
    )
    words = [sys.executable, "-c", command, "passport", str(tmp_path / "runs"), "--file", str(tmp_path / "p.sqlite")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 3, done.stderr
    assert "Traceback" not in done.stderr
    assert "p.sqlite" in done.stderr
    assert [each.content for each in read(tmp_path / "p.sqlite")] == ["h"]


def test_a_run_with_a_date_that_cannot_be_is_left_out_and_named(tmp_path: Path):
    dates = ("2026-01-01", "2199-01-01", "1970-01-01")
    model(tmp_path, *(error().model_copy(update={"note": f"identified {date}T00:00:00+00:00"}) for date in dates))
    done = called(tmp_path)
    assert done.exit_code == 0, done.output
    assert "1 new runs, 1 in all" in done.stderr
    assert "dated 2199-01-01, which is in the future: the clock of that computer was wrong" in done.stderr
    assert "dated 1970-01-01, which is before 2000" in done.stderr


def test_texts_of_a_run_are_bounded(tmp_path: Path):
    model(tmp_path, error(note="x" * 5000))
    done = called(tmp_path)
    assert done.exit_code == 3, done.output
    assert "the limits are 4000 and 200" in done.stderr
    assert "no identified transmission error" in done.stderr


def test_two_robots_in_one_file_are_two_gears(tmp_path: Path):
    model(tmp_path / "a", *(error(5.0 + 0.02 * (-1) ** day, day) for day in range(1, 10)))
    for day in range(1, 10):
        Identified(robot="other").with_part(2, error(9.0 + 0.02 * (-1) ** day, day)).save(tmp_path / f"other-{day}.toml")
    assert called(tmp_path).exit_code == 0
    found = trends(read(tmp_path / "passport.sqlite"), {})
    assert {(trend.robot, len(trend.values)) for trend in found} == {("arm", 9), ("other", 9)}


def test_a_folder_that_is_none_and_a_page_that_cannot_be_written_end_with_3(tmp_path: Path):
    assert called(tmp_path / "nowhere").exit_code == 3
    model(tmp_path, error())
    (tmp_path / "passport.html").mkdir()
    done = called(tmp_path)
    assert done.exit_code == 3, done.output
    assert "passport.html" in done.stderr
    assert len(read(tmp_path / "passport.sqlite")) == 1, "the run is kept all the same"
