"""Robots are walked by any executors, and nothing that dies takes a finished robot with it."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from plant_emulator.cli.main import app
from plant_emulator.rehearsal.many.rows import CRASHED, crashed
from plant_emulator.trials.executors import (
    ATTEMPTS,
    SLOW_IMPORTS,
    DaskWorkers,
    ExecutorsLostError,
    ExecutorsRefusedError,
    LocalProcesses,
    run_all,
    scheduler_address,
)
from plant_emulator.trials.rows import csv_text
from plant_emulator.trials.rows import steady as steady_row
from tests.plant_emulator.trials import tasks

PROJECT = Path(__file__).parents[3]
PATIENCE_S = 60.0


def wait_until(condition):
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def lives(process):
    try:
        return Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] not in {"Z", "X"}
    except FileNotFoundError:
        return False


def steady(rows):
    """Rows in the order of their seeds, without what another day changes."""
    return [steady_row(row) for row in sorted(rows, key=lambda row: row["seed"])]


def rows_of(walk, values, executors, seeds=range(1, 7)):
    found = []
    with executors:
        run_all(seeds, walk, values, executors, found.append, crashed)
    return steady(found)


HERE = steady(map(tasks.squared, range(1, 7)))


# -- processes of this machine -----------------------------------------------------------------------------------------


def test_processes_are_forked_from_a_server_without_threads():
    """A fork beside threads may hang: what the server imports beforehand must begin none."""
    with LocalProcesses(1) as executors:
        server, modules = executors.submit(tasks.parent_and_modules).result(timeout=PATIENCE_S)
    assert len(list(Path(f"/proc/{server}/task").iterdir())) == 1
    assert set(SLOW_IMPORTS) <= set(modules)


@pytest.mark.parametrize("jobs", [1, 2])
def test_any_number_of_processes_gives_the_same_rows(jobs):
    assert rows_of(tasks.squared, (), LocalProcesses(jobs)) == HERE


def test_a_robot_whose_process_is_killed_is_walked_again(tmp_path):
    assert rows_of(tasks.dies_once, (str(tmp_path), 2), LocalProcesses(2)) == HERE
    assert (tmp_path / "died-2").exists()


def test_a_robot_whose_process_dies_again_is_recorded_as_crashed_and_the_others_are_walked(tmp_path):
    rows = rows_of(tasks.dies_always, (str(tmp_path), 3), LocalProcesses(2))
    assert [row["seed"] for row in rows if row["walk"] == CRASHED] == [3]
    assert [row for row in rows if row["seed"] != 3] == [row for row in HERE if row["seed"] != 3]
    assert len((tmp_path / "deaths").read_text()) == ATTEMPTS


def test_of_a_bundle_whose_process_dies_only_the_mortal_robot_is_recorded_as_crashed(tmp_path):
    found = []
    with LocalProcesses(1) as executors:
        run_all(range(1, 25), tasks.dies_always, (str(tmp_path), 3), executors, found.append, crashed, 50)
    assert [row["seed"] for row in found if row["walk"] == CRASHED] == [3]
    assert sorted(row["seed"] for row in found) == list(range(1, 25))
    assert len((tmp_path / "deaths").read_text()) == ATTEMPTS


def test_no_process_is_left_when_one_that_walks_is_not_wanted_any_more(tmp_path):
    def interrupted(row):
        raise KeyboardInterrupt

    def walked():
        with LocalProcesses(2) as executors:
            executors.submit(tasks.sleeps, 1, str(tmp_path))
            wait_until(lambda: (tmp_path / "at-1").exists() and (tmp_path / "at-1").read_text())
            run_all([2], tasks.squared, (), executors, interrupted, crashed)

    with pytest.raises(KeyboardInterrupt):
        walked()
    assert not lives(int((tmp_path / "at-1").read_text()))


def test_a_ctrl_c_while_a_robot_is_given_out_leaves_no_process(tmp_path):
    found = []

    def given_out():
        with LocalProcesses(1) as executors:
            [pool] = executors._free
            submit = pool.submit

            def interrupted(*values):
                future = submit(*values)
                found.extend(pool._processes)
                signal.raise_signal(signal.SIGINT)
                return future

            pool.submit = interrupted
            executors.submit(tasks.sleeps, 1, str(tmp_path))

    with pytest.raises(KeyboardInterrupt):
        given_out()
    assert found
    assert not any(lives(number) for number in found)


def test_the_processes_of_a_main_that_is_killed_end_with_it(tmp_path):
    code = (
        "import sys\n"
        "from plant_emulator.trials.executors import LocalProcesses\n"
        "from plant_emulator.trials.executors import run_all\n"
        "from tests.plant_emulator.trials.tasks import sleeps\n"
        "if __name__ == '__main__':\n"
        "    with LocalProcesses(2) as executors:\n"
        f"        run_all([1, 2], sleeps, ({str(tmp_path)!r},), executors, print, None)\n"
    )
    (tmp_path / "main.py").write_text(code)
    environment = os.environ | {"PYTHONPATH": str(PROJECT)}
    main = subprocess.Popen([sys.executable, str(tmp_path / "main.py")], cwd=PROJECT, env=environment)
    traces = [tmp_path / "at-1", tmp_path / "at-2"]
    try:
        wait_until(lambda: all(trace.exists() and trace.read_text() for trace in traces))
    finally:
        main.kill()
        main.wait()
    wait_until(lambda: not any(lives(int(trace.read_text())) for trace in traces))


@pytest.mark.parametrize("jobs", [0, 257])
def test_a_number_of_processes_that_cannot_be_is_refused(jobs):
    with pytest.raises(ValueError, match=f"{jobs} processes"):
        LocalProcesses(jobs)


# -- the workers of a Dask scheduler -----------------------------------------------------------------------------------


class Cluster:
    """A scheduler and workers as processes of this machine, on the loopback."""

    def __init__(self, folder):
        self.folder = folder
        self._environment = os.environ | {"PYTHONPATH": str(PROJECT)}
        file = folder / "scheduler.json"
        self.scheduler = self._start("scheduler", "--port", "0", "--scheduler-file", str(file))
        wait_until(lambda: file.exists() and file.read_text().endswith("}"))
        self.address = json.loads(file.read_text())["address"]
        self.workers = []

    def _start(self, *words):
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *words, "--host", "127.0.0.1", "--no-dashboard"], cwd=PROJECT, env=self._environment,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip

    def add(self, threads=1):
        self.workers.append(self._start("worker", self.address, "--nthreads", str(threads), "--no-nanny"))

    def close(self):
        for each in (*self.workers, self.scheduler):
            each.kill()
        for each in (*self.workers, self.scheduler):
            each.wait()


@pytest.fixture
def cluster(tmp_path):
    pytest.importorskip("distributed")
    started = Cluster(tmp_path)
    yield started
    started.close()


@pytest.mark.slow
def test_a_dask_scheduler_with_a_worker_that_is_killed_on_the_way_gives_the_table_of_one_process(cluster, tmp_path):
    cluster.add()
    cluster.add()
    found, seeds = [], range(1, 9)
    killed = []

    def kept(row):
        found.append(row)
        running = {int(path.read_text()) for path in tmp_path.glob("at-*") if path.read_text()}
        doomed = [each for each in cluster.workers if each.pid in running]
        if not killed and len(doomed) == len(cluster.workers):  # both have walked, both have more in hand
            doomed[0].kill()
            killed.append(doomed[0].pid)

    with DaskWorkers(cluster.address) as executors:
        run_all(seeds, tasks.tells_and_waits, (str(tmp_path),), executors, kept, crashed)
    assert killed
    local = []
    with LocalProcesses(1) as executors:
        run_all(seeds, tasks.squared, (), executors, local.append, crashed)
    assert csv_text(steady(found)) == csv_text(steady(local))


@pytest.mark.slow
def test_a_scheduler_that_is_lost_ends_the_run_in_words_and_what_was_walked_is_kept(cluster, tmp_path):
    cluster.add()
    found = []

    def kept(row):
        found.append(row)
        cluster.scheduler.kill()

    with pytest.raises(ExecutorsLostError, match=cluster.address), DaskWorkers(cluster.address) as executors:
        run_all(range(1, 9), tasks.tells_and_waits, (str(tmp_path),), executors, kept, crashed)
    assert [row["seed"] for row in found] == [1]


@pytest.mark.slow
def test_workers_that_would_walk_two_robots_in_one_process_are_refused(cluster, tmp_path):
    cluster.add(threads=2)
    done = CliRunner().invoke(app, ["rehearse", "--seeds", "1", "--on", f"dask:{cluster.address}", "--out", str(tmp_path / "r")])
    assert done.exit_code == 4
    assert "has 2 threads; each task needs a process of its own: dask worker" in done.output


@pytest.mark.ci
def test_a_scheduler_without_workers_is_refused(cluster):
    with pytest.raises(ExecutorsRefusedError, match=r"has no workers; start some: dask worker"):
        DaskWorkers(cluster.address, patience_s=0.5).__enter__()


def test_no_scheduler_is_said_in_words():
    pytest.importorskip("distributed")
    with pytest.raises(ExecutorsRefusedError, match=r"tcp://127.0.0.1:9: no Dask scheduler answers"):
        DaskWorkers("tcp://127.0.0.1:9", patience_s=0.5).__enter__()


@pytest.mark.parametrize(
    "text", ["tcp://h:8786", "dask:h:8786", "dask:tcp://h", "dask:tcp://h:99999", "dask:ucx://h:1", "dask:tcp://h:1/x", "dask:"]
)
def test_an_address_that_names_no_scheduler_is_refused(text):
    with pytest.raises(ValueError, match=r"expected .*, such as dask:tcp://127\.0\.0\.1:8786"):
        scheduler_address(text)
