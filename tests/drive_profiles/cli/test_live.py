"""`drive-profiles watch`, `faults`, `nmt`, `backup` and `diff --default` as a user runs them on a served robot."""

import json
import time
from collections import deque
from pathlib import Path

import pytest
from typer.testing import CliRunner

import drive_profiles
from drive_profiles.cli.main import app
from drive_profiles.cli.watch import plot_line
from drive_profiles.device.bus import SdoBus
from drive_profiles.parameter_set.parameters import ParameterSet
from drive_profiles.standard.cia301 import FunctionCode
from drive_profiles.standard.cia402 import State, state_of
from tests.drive_profiles.cli.test_on_a_bus import serving

MASTER = 100
EDS = Path(drive_profiles.__file__).parent / "vendors" / "emulated_drive.eds"


@pytest.fixture(scope="module")
def robot():
    with serving("--drive", "3=kollmorgen_akd") as address:
        yield address


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, robot):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HIL_BUS", robot)
    return tmp_path


def run(*arguments, code=0):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == code, (arguments, result.output, result.exception)
    return result


@pytest.mark.ci
def test_watch_gives_a_line_a_reading_and_ends_by_itself():
    lines = run("watch", "0x6064", "0x6041", "--node", 2, "--count", 3, "--every-s", 0.01, "--json").stdout.splitlines()
    documents = [json.loads(line) for line in lines]
    assert len(documents) == 3
    assert [document["time_s"] for document in documents] == sorted(document["time_s"] for document in documents)
    assert all(len(document) == 3 for document in documents)
    text = run("watch", "0x6064", "--node", 2, "--for-s", 0.05, "--every-s", 0.01).stdout.splitlines()
    assert 1 <= len(text) <= 7


def test_a_plot_line_is_as_high_as_its_values_and_keeps_gaps():
    assert plot_line(deque([0.0, float("nan"), 7.0])) == "▁ █"
    assert plot_line(deque()) == ""


def wait_for(happened):
    deadline = time.monotonic() + 10.0
    while not happened():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.005)


def lose_the_master(robot: str, node: int) -> None:
    """Let a node watch a master, which speaks once and never again."""
    run("set", f"0x1016:1={MASTER << 16 | 50}", "--type", "UNSIGNED32", "--node", node, "--yes")
    with SdoBus(robot) as bus:
        before = bus.port(node).read((0x1003, 0))
        bus.send(FunctionCode.HEARTBEAT + MASTER, b"\x05")
        wait_for(lambda: bus.port(node).read((0x1003, 0)) != before)
    run("set", "0x1016:1=0", "--type", "UNSIGNED32", "--node", node, "--yes")


@pytest.mark.slow
def test_faults_are_in_words_and_are_cleared_when_the_user_says_so(robot):
    assert "nothing is wrong" in run("faults", "--node", 2).stdout
    lose_the_master(robot, 2)
    shown = run("faults", "--node", 2).stdout
    assert "heartbeat or life guarding lost: the master was not heard" in shown
    assert "1003:1" in shown
    report = json.loads(run("faults", "--node", 2, "--json").stdout)
    assert report[0]["history"][0] & 0xFFFF == 0x8130

    run("faults", "--node", 2, "--clear", code=2)  # not a terminal
    assert json.loads(run("faults", "--node", 2, "--json").stdout)[0]["history"]
    run("faults", "--node", 2, "--clear", "--yes")
    assert json.loads(run("faults", "--node", 2, "--json").stdout)[0]["history"] == []


@pytest.mark.slow
def test_nmt_says_the_states_asks_and_tells_what_came_of_it():
    refused = run("nmt", "start", "--node", 2, code=2)
    assert "switch on disabled" in refused.output
    run("nmt", "start", "--node", 2, "--all", "--yes", code=2)
    run("nmt", "start", code=2)
    run("set", "0x1017=50", "--type", "UNSIGNED16", "--node", 2, "--yes")
    assert "node 2: operational" in run("nmt", "start", "--node", 2, "--yes").stdout
    assert "node 2: pre-operational" in run("nmt", "pre-operational", "--node", 2, "--yes").stdout
    assert "node 2: stopped" in run("nmt", "stop", "--node", 2, "--yes").stdout
    assert "does not answer; it may be stopped" in run("nmt", "start", "--node", 2, "--yes").output
    assert run("nmt", "reset-communication", "--all", "--yes").stdout.count("node ") == 4
    run("nmt", "start", "--node", 77, "--yes", code=5)


@pytest.mark.slow
def test_nmt_does_not_take_torque_away_unawares(robot):
    gains = ("position_gain_per_s=25", "velocity_gain_nm_s_rad=0.196", "velocity_integral_gain_nm_rad=3.9")
    run("set", *gains, "--node", 5, "--yes")
    run("nmt", "start", "--node", 5, "--yes")
    with SdoBus(robot) as bus:
        bus.port(5).write((0x6060, 0), b"\x08")
        for word, state in ((0x06, State.READY_TO_SWITCH_ON), (0x07, State.SWITCHED_ON), (0x0F, State.OPERATION_ENABLED)):
            bus.port(5).write((0x6040, 0), word.to_bytes(2, "little"))
            wait_for(lambda state=state: state_of(int.from_bytes(bus.port(5).read((0x6041, 0)), "little")) is state)
        refused = run("nmt", "stop", "--all", code=2).output
        assert "UNDER TORQUE: node 5; without process data" in refused
        assert "operation enabled" in refused
        assert run("get", "0x6041", "--node", 5, "--json").stdout  # it still answers: nothing has been sent
        run("faults", "--node", 5, "--clear", "--yes")  # nothing is wrong, so nothing is cleared
        bus.port(5).write((0x6040, 0), b"\0\0")


@pytest.mark.ci
def test_a_backup_of_all_nodes_is_a_file_each_that_the_drive_verifies(folder):
    index = json.loads(run("backup", "--out", "kept", "--json").stdout)
    assert [each["node"] for each in index["nodes"]] == [2, 3, 5, 16]
    written = json.loads((folder / "kept" / "backup.json").read_text())
    assert written == index
    for each in written["nodes"]:
        kept = ParameterSet.load(folder / "kept" / each["file"])
        assert kept.digest() == each["hash"]
        assert sum(1 for _ in kept.items()) == each["values"]
    run("verify", "kept/node2.toml", "--node", 2)
    run("backup", "--out", "kept", code=3)


@pytest.mark.ci
def test_a_node_that_is_silent_is_said_and_nothing_is_written(folder):
    run("backup", "--out", "kept", "--node", 2, "--node", 77, code=5)
    assert not (folder / "kept").exists()


@pytest.mark.ci
def test_what_is_not_as_delivered_is_shown_with_both_values():
    before = json.loads(run("diff", "--default", "--eds", EDS, "--node", 2, "--json", code=7).stdout)
    run("set", "following_error_timeout_s=0.123", "--node", 2, "--yes")
    after = json.loads(run("diff", "--default", "--eds", EDS, "--node", 2, "--json", code=7).stdout)
    new = [each for each in after if each["key"] not in {old["key"] for old in before}]
    assert [(each["key"], each["right"]) for each in new] == [("following_error_timeout_s", 0.123)]
    run("diff", "--default", "--node", 2, code=2)
    run("diff", code=2)
