"""The bus of a command: its option, then HIL_BUS, then the bench file; and the first line says which."""

import json
import re
from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from hil.bench.bench import REFERENCE
from hil.cli.main import app

EMULATOR, ROBOT = "local:/nowhere/emulator.sock", "virtual:robot"
MOVING = {
    "run": ["run", "constant-acceleration", "--axis", "2"],
    "identify-plant": ["identify", "plant", "--axis", "2"],
    "identify-ate": ["identify", "ate", "--axis", "2"],
    "learn": ["learn", "--axis", "2", "--model", "learnt.toml"],
    "compare": ["compare", "--treatment", "notch"],
}


def bench_file(folder: Path, address: str) -> str:
    text = REFERENCE.read_text(encoding="utf-8")
    before = 'address = "local:/tmp/robot.sock"'
    assert before in text
    (folder / "bench.toml").write_text(text.replace(before, f'address = "{address}"'), encoding="utf-8")
    return str(folder / "bench.toml")


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def called(*arguments: str) -> Result:
    return CliRunner().invoke(app, arguments)


@pytest.mark.parametrize("command", MOVING.values(), ids=MOVING)
def test_the_environment_comes_before_the_bench_file_and_the_first_line_says_so(command, tmp_path, monkeypatch):
    bench = bench_file(tmp_path, ROBOT)
    monkeypatch.setenv("HIL_BUS", EMULATOR)
    done = called(*command, "--bench", bench)
    assert done.exit_code == 4, done.stderr
    lines = done.stderr.splitlines()
    assert lines[0] == f"bus {EMULATOR}, from HIL_BUS; not {ROBOT}, as bench file {bench} says"
    assert EMULATOR in lines[-1], "and that is the bus that it looked for"
    assert done.stdout == ""


ASKING = {name: command for name, command in MOVING.items() if name != "compare"}  # that looks for the bus before it asks


@pytest.mark.parametrize("command", ASKING.values(), ids=ASKING)
def test_a_robot_that_only_the_environment_names_is_asked_for_before_it_moves(command, tmp_path, monkeypatch):
    bench = bench_file(tmp_path, EMULATOR)
    monkeypatch.setenv("HIL_BUS", ROBOT)
    done = called(*command, "--bench", bench)
    assert done.exit_code == 2, done.stderr
    lines = done.stderr.splitlines()
    assert lines[0] == f"bus {ROBOT}, from HIL_BUS; not {EMULATOR}, as bench file {bench} says"
    assert f"on {ROBOT}" in done.stderr
    assert "not a terminal" in lines[-1]


@pytest.mark.parametrize("command", MOVING.values(), ids=MOVING)
def test_a_bus_that_does_not_exist_is_found_before_the_question(command, tmp_path):
    done = called(*command, "--bench", bench_file(tmp_path, "socketcan:can9"))
    assert (done.exit_code, "This moves" in done.stderr) == (4, False), done.stderr
    assert "can9" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize("command", MOVING.values(), ids=MOVING)
def test_the_option_comes_before_all(command, tmp_path, monkeypatch):
    bench = bench_file(tmp_path, ROBOT)
    monkeypatch.setenv("HIL_BUS", ROBOT)
    done = called(*command, "--bench", bench, "--bus", EMULATOR)
    assert done.exit_code == 4, done.stderr
    assert done.stderr.splitlines()[0].startswith(f"bus {EMULATOR}, from --bus; not {ROBOT}, as HIL_BUS says")


def test_an_environment_that_names_no_bus_is_refused_by_its_name(tmp_path, monkeypatch):
    monkeypatch.setenv("HIL_BUS", "can0")
    done = called(*MOVING["run"], "--bench", bench_file(tmp_path, EMULATOR))
    assert done.exit_code == 2
    assert done.stderr.startswith("HIL_BUS: 'can0' is not a bus address")


@pytest.mark.parametrize("command", MOVING.values(), ids=MOVING)
def test_an_interface_that_there_is_not_is_said_with_those_that_are_before_any_question(command, tmp_path):
    done = called(*command, "--bench", bench_file(tmp_path, "sockercan:can0"))
    assert done.exit_code == 2
    assert "unknown interface 'sockercan', did you mean socketcan; expected one of local, socketcan, " in done.stderr
    assert "slcan" in done.stderr
    assert "This moves" not in done.stderr


@pytest.mark.parametrize("command", [ASKING[name] for name in ("identify-plant", "learn")], ids=("identify-plant", "learn"))
def test_what_needs_the_gains_refuses_those_that_are_as_found_before_a_bus_is_looked_for(command, tmp_path):
    bench = Path(bench_file(tmp_path, EMULATOR))
    bench.write_text(re.sub("^control = .*$", 'control = "as found"', bench.read_text(), flags=re.M))
    done = called(*command, "--bench", str(bench))
    assert done.exit_code == 3, done.stderr
    assert 'axis 2 needs gains in the bench file: control = "as found"' in done.stderr


def test_several_robots_do_not_share_the_bus_of_the_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("HIL_BUS", EMULATOR)
    bench = bench_file(tmp_path, ROBOT)
    done = called("compare", "--bench", bench, "--bench", "reference", "--treatment", "notch")
    assert done.exit_code == 2
    assert "HIL_BUS is for one robot" in done.stderr


def test_a_plan_takes_the_same_bus_and_its_json_stays_alone_on_standard_output(tmp_path, monkeypatch):
    bench = bench_file(tmp_path, ROBOT)
    assert json.loads(called("plan", "--bench", bench, "--json").stdout)["bitrate"] is None
    monkeypatch.setenv("HIL_BUS", "socketcan:can1@1M")
    planned = called("plan", "--bench", bench, "--json")
    assert json.loads(planned.stdout)["bitrate"] == 1_000_000
    assert planned.stderr == f"bus socketcan:can1@1M, from HIL_BUS; not {ROBOT}, as bench file {bench} says\n"
    planned = called("plan", "--bench", bench, "--json", "--bus", "socketcan:can2@500k")
    assert json.loads(planned.stdout)["bitrate"] == 500_000
