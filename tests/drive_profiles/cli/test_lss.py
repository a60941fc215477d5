"""`drive-profiles lss` on a served robot one drive of which has left the factory without a node-ID."""

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

import plant_emulator
from drive_profiles.cli.main import app
from tests.drive_profiles.cli.test_on_a_bus import serving

PATIENT = ("--timeout-s", "0.6")  # on a machine that has other work: who is late does not answer
REFERENCE = Path(plant_emulator.__file__).parent / "robots" / "reference.toml"


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    file = tmp_path_factory.mktemp("robot") / "robot.toml"
    file.write_text(REFERENCE.read_text() + "\n[axis.3.behaviour]\nunconfigured = true\n")
    with serving("--robot", str(file)) as address:
        yield address


@pytest.fixture(autouse=True)
def bus(monkeypatch, robot):
    monkeypatch.setenv("HIL_BUS", robot)


def run(*arguments, code=0):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == code, (arguments, result.output, result.exception)
    return result.output


@pytest.mark.slow
def test_a_node_without_a_node_id_is_found_and_given_one_that_acts_after_a_reset():
    assert re.findall(r"^(\d+) ", run("scan"), re.MULTILINE) == ["2", "5", "16"]
    found = run("lss", "show", "--unconfigured", *PATIENT)
    identity = re.search(r"^(\S+): no node-ID", found, re.MULTILINE)[1]
    assert identity.endswith(",3")  # its serial number

    assert "node-ID 5 is taken" in run("lss", "node-id", 5, "--identity", identity, "--yes", *PATIENT, code=3)
    run("lss", "node-id", 7, "--identity", identity, *PATIENT, code=2)  # not a terminal
    assert "no node-ID" in run("lss", "show", "--identity", identity, *PATIENT)
    run("lss", "node-id", 7, "--identity", identity, "--store", "--yes", *PATIENT)
    run("nmt", "reset-communication", "--all", "--yes")
    assert re.findall(r"^(\d+) ", run("scan"), re.MULTILINE) == ["2", "5", "7", "16"]

    assert f"{identity}: node-ID 7" in run("lss", "show", "--identity", identity, *PATIENT)
    said = run("lss", "show", "--unconfigured", *PATIENT, code=5)  # there is none any more
    assert "no node answers the LSS fast scan within" in said
    assert "node 0" not in said
    run("lss", "bit-rate", "500k", "--identity", identity, "--yes", *PATIENT)
    run("lss", "bit-rate", "123456", "--identity", identity, "--yes", *PATIENT, code=3)


@pytest.mark.slow
def test_what_would_mean_several_nodes_or_none_is_refused():
    assert "needs a single node" in run("lss", "show", "--only", code=2)
    run("lss", "show", code=2)
    run("lss", "show", "--identity", "1,2,3", code=2)
    run("lss", "show", "--identity", "1,2,3,4", code=5)
