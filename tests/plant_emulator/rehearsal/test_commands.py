"""plant-emulator fleet and rehearse: robots on disk, and the documented path walked on them, as a user types it."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.bench.bench import load_bench
from plant_emulator.cli.main import app
from plant_emulator.rehearsal.many.one import drawn, kind_of, run_seed
from plant_emulator.rehearsal.many.rows import BROKEN, WALKED, Kept, RehearsalSettings
from plant_emulator.robots.robot import load_robot
from plant_emulator.trials.rows import steady
from tests.plant_emulator.rehearsal.made import refused, row

PROJECT = Path(__file__).parents[3]
CHEAP = 4
"""Seed of a robot whose walk costs little: its linear twin is refused early today; whatever it does, it is walked."""


PATIENCE_S = 500.0
"""For one robot, on a machine that has other work."""


def invoke(*words):
    return CliRunner().invoke(app, [*map(str, words)])


# -- fleet ------------------------------------------------------------------------------------------------------------


def test_a_stable_is_robots_that_load_with_benches_that_know_nothing_of_them(tmp_path):
    done = invoke("fleet", "--seeds", "1-3", "--out", tmp_path / "s")
    assert done.exit_code == 0, done.output
    with (tmp_path / "s" / "robots.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(each["seed"], each["kind"]) for each in rows] == [("1", "linear"), ("2", "real"), ("3", "linear")]
    for each in rows:
        robot, bench = (
            load_robot(tmp_path / "s" / f"robot-{each['seed']}.toml"),
            load_bench(tmp_path / "s" / f"bench-{each['seed']}.toml"),
        )
        assert robot == drawn(int(each["seed"]), each["kind"])[0]
        [number] = bench.axis
        assert bench.axis[number].model is None
        assert float(each["a2_arcsec"]) == robot.axis[number].apparent_ate.amplitudes_arcsec()[2]
        assert f"{robot.axis[number].reduction_ratio:g}" in done.stdout


def test_a_stable_overwrites_nothing(tmp_path):
    (tmp_path / "bench-2.toml").write_text("mine")
    done = invoke("fleet", "--seeds", "1-3", "--out", tmp_path)
    assert done.exit_code == 3
    assert "bench-2.toml already exists; nothing was written" in done.output
    assert [path.name for path in tmp_path.iterdir()] == ["bench-2.toml"]
    assert (tmp_path / "bench-2.toml").read_text() == "mine"


def test_a_second_seed_joins_the_robots_of_a_folder(tmp_path):
    assert invoke("fleet", "--seeds", "1-2", "--out", tmp_path / "apart").exit_code == 0
    for seed in (1, 2):
        assert invoke("fleet", "--seeds", seed, "--out", tmp_path / "joined").exit_code == 0
    assert len({(tmp_path / folder / "robots.csv").read_text() for folder in ("apart", "joined")}) == 1
    again = invoke("fleet", "--seeds", "2-3", "--out", tmp_path / "joined")
    assert again.exit_code == 3
    assert "bench-2.toml and 1 more already exist; nothing was written; choose other seeds or another folder" in again.output
    assert not (tmp_path / "joined" / "robot-3.toml").exists()


@pytest.mark.parametrize("text", ["", "seed,mass\n7,3.0\n", "mine\n", "\0,\n\1\n"])
def test_a_table_of_something_else_is_neither_replaced_nor_joined(tmp_path, text):
    (tmp_path / "robots.csv").write_text(text)
    done = invoke("fleet", "--seeds", "1", "--out", tmp_path)
    assert done.exit_code == 3
    assert f"robots.csv is not the list of the robots in {tmp_path}; nothing was written" in done.output
    assert (tmp_path / "robots.csv").read_text() == text


def test_one_seed_is_one_robot(tmp_path):
    assert invoke("stable", "--seed", "7", "--kind", "real", "--out", tmp_path).exit_code == 0, "the old name works too"
    assert tomllib.loads((tmp_path / "robot-7.toml").read_text())["name"] == "fleet-real-7"
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize("command", ["fleet", "rehearse"])
def test_seeds_that_are_none_are_a_matter_of_usage(command, tmp_path):
    done = invoke(command, "--seeds", "5-3", "--out", tmp_path / "s")
    assert done.exit_code == 2
    assert "ends before it begins" in done.output
    assert not (tmp_path / "s").exists()


def test_both_kinds_take_turns():
    assert [kind_of(seed, "both") for seed in range(4)] == ["real", "linear", "real", "linear"]
    with pytest.raises(ValueError, match="expected one of linear, real, any, both"):
        kind_of(1, "tame")


# -- rehearse: a robot that is walked ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rehearsed(tmp_path_factory):
    """One robot, walked by the command in a process of its own."""
    folder = tmp_path_factory.mktemp("rehearsed") / "r"
    words = ("rehearse", "--seeds", str(CHEAP), "--kind", "linear", "--jobs", "1", "--out", str(folder))
    done = subprocess.run(
        [sys.executable, "-m", "plant_emulator", *words],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0, done.stderr
    return folder, done


@pytest.mark.slow
def test_a_rehearsal_leaves_row_table_claims_and_page(rehearsed):
    folder, done = rehearsed
    [found] = Kept(folder).rows()
    assert (found["seed"], found["kind"], found["walk"]) == (CHEAP, "linear", WALKED)
    assert {path.name for path in folder.iterdir()} >= {"robots", "rehearsal.json", "robots.csv", "claims.json", "report.html"}
    assert json.loads((folder / "claims.json").read_text())["robots"] == 1
    assert "robots: 1 in " in done.stderr
    assert "processor time of a robot" in done.stdout


@pytest.mark.slow
def test_a_robot_walked_again_in_another_process_gives_the_same_row(rehearsed):
    folder, _ = rehearsed
    assert steady(run_seed(CHEAP, "linear", False)) == steady(Kept(folder).rows()[0])


@pytest.mark.slow
def test_a_rehearsal_that_is_complete_walks_nobody_again(rehearsed):
    folder, _ = rehearsed
    before = (folder / "robots" / f"seed-{CHEAP}.json").stat().st_mtime_ns
    done = invoke("rehearse", "--seeds", CHEAP, "--kind", "linear", "--out", folder, "--resume")
    assert done.exit_code == 0
    assert "1 of 1 robots are done already" in done.output
    assert (folder / "robots" / f"seed-{CHEAP}.json").stat().st_mtime_ns == before


@pytest.mark.wall
@pytest.mark.slow
def test_ctrl_c_ends_a_rehearsal_with_its_processes_and_says_how_to_go_on(tmp_path):
    words = ("rehearse", "--seeds", "1-40", "--jobs", "2", "--out", str(tmp_path / "r"))
    main = subprocess.Popen(
        [sys.executable, "-m", "plant_emulator", *words], cwd=PROJECT, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL,
        text=True, start_new_session=True,
    )  # fmt: skip
    try:
        deadline = time.monotonic() + 60.0
        while len(_group(main.pid)) < 3:  # the command, and two processes that walk
            assert time.monotonic() < deadline
            time.sleep(0.05)
        os.killpg(main.pid, signal.SIGINT)  # as a terminal does
        _, said = main.communicate(timeout=60.0)
    finally:
        if main.poll() is None:
            os.killpg(main.pid, signal.SIGKILL)
            main.communicate()
    assert main.returncode == 130, said
    assert "interrupted; " in said
    assert "continue with --resume" in said
    assert "Traceback" not in said
    deadline = time.monotonic() + 10.0  # what a process had asked the system meanwhile may end after it
    while (left := _group(main.pid)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert left == {}


def _group(leader):
    """Processes of a group that are at work, with their command lines."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text(encoding="utf-8").rpartition(")")[2].split()
            line = (path.parent / "cmdline").read_text(encoding="utf-8")
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(fields[2]) == leader and fields[0] not in {"Z", "X"} and "resource_tracker" not in line:
            found[int(path.parent.name)] = line.replace("\0", " ")
    return found


# -- rehearse: what needs no walk --------------------------------------------------------------------------------------


@pytest.fixture
def kept(tmp_path):
    """A folder whose robots have been walked: nine are cured, one is refused for a wrong cause."""
    found = Kept(tmp_path / "r")
    found.begin(RehearsalSettings("both", over_bus=False), resume=False)
    for seed in range(1, 10):
        found.keep(row(seed, kind_of(seed, "both")))
    found.keep(refused(10, "check that this is the axis that moved", "real"))
    return found


@pytest.mark.slow
def test_a_summary_makes_table_and_page_again_and_prints_markdown(kept):
    done = invoke("rehearse", "--summary", kept.folder)
    assert done.exit_code == 0, done.output
    assert "| Claim | Asked | Measured | Holds |" in done.stdout
    assert "| **Linear gears: 5 robots** |" in done.stdout
    assert (kept.folder / "report.html").is_file()
    assert len((kept.folder / "robots.csv").read_text().splitlines()) == 11


@pytest.mark.slow
def test_a_number_that_is_not_reached_is_said_and_with_check_is_a_status(kept):
    plain, checked = invoke("rehearse", "--summary", kept.folder), invoke("rehearse", "--summary", kept.folder, "--check")
    assert (plain.exit_code, checked.exit_code) == (0, 9)
    for each in (plain, checked):
        assert "not reached: The other robots are refused, with the true cause; goal 90 %" in each.output


@pytest.mark.slow
def test_numbers_that_are_reached_pass_the_check(kept):
    (kept.folder / "robots" / "seed-10.json").unlink()
    assert invoke("rehearse", "--summary", kept.folder, "--check").exit_code == 0


@pytest.mark.slow
def test_json_is_one_document(kept):
    done = invoke("rehearse", "--summary", kept.folder, "--json")
    found = {each["key"]: each["holds"] for each in json.loads(done.stdout)["claims"]}
    assert (found["quiet_linear"], found["true_cause"], found["rms_z"]) == (True, False, None)


@pytest.mark.slow
def test_resuming_only_adds_what_is_missing(kept):
    done = invoke("rehearse", "--seeds", "1-10", "--out", kept.folder, "--resume")
    assert done.exit_code == 0
    assert "10 of 10 robots are done already" in done.output


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("--seeds", "1"), 3, "already holds a rehearsal; give --resume to continue it"),
        (("--seeds", "1", "--resume", "--kind", "real"), 3, "kind was both, now real"),
        (("--seeds", "1", "--resume", "--over-bus"), 3, "over_bus was False, now True"),
    ],
)
def test_a_folder_holds_one_rehearsal(kept, words, status, said):
    done = invoke("rehearse", *words, "--out", kept.folder)
    assert (done.exit_code, said in done.output) == (status, True), done.output


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        ((), 2, "--seeds is needed"),
        (("--seeds", "1", "--on", "tcp://127.0.0.1:1"), 2, "expected dask:tcp://HOST:PORT"),
        (("--seeds", "1", "--on", "dask:tcp://127.0.0.1:9", "--jobs", "2"), 2, "--jobs"),
        (("--seeds", "1", "--on", "dask:tcp://127.0.0.1:9", "--keep"), 2, "--keep"),
        (("--seeds", "1", "--summary", "x"), 2, "--summary only rewrites the report"),
        (("--summary", "x"), 3, "rehearsal.json"),
    ],
)
def test_what_cannot_be_walked_is_refused_before_anything_is_written(tmp_path, monkeypatch, words, status, said):
    monkeypatch.chdir(tmp_path)
    done = invoke("rehearse", *words)
    assert (done.exit_code, said in done.output) == (status, True), done.output
    assert list(tmp_path.iterdir()) == []


def test_an_error_that_nobody_expected_is_a_row_and_no_end(tmp_path, monkeypatch):
    """Where nothing can be written no robot can be walked; the others still can."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "gone"))
    found = run_seed(CHEAP, "linear", False)
    assert (found["seed"], found["kind"], found["walk"]) == (CHEAP, "linear", BROKEN)
    assert found["walk_words"].startswith("FileNotFoundError: ")
