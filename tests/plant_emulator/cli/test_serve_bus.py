"""The bus that `plant-emulator serve` serves: its option, then HIL_BUS, then its default."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from plant_emulator.cli.main import app

SERVE = [sys.executable, "-m", "plant_emulator", "serve", "--until-stdin-closes"]


def served(*options: str, **environment: str) -> tuple[str, str]:
    """The first line of what it prints, and all that it says on standard error, of a server that ends at once."""
    done = subprocess.run(
        [*SERVE, *options], input="", capture_output=True, text=True, timeout=300, check=False, env=os.environ | environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[0], done.stderr


@pytest.mark.slow
def test_the_environment_names_the_bus_and_the_option_comes_before_it(tmp_path: Path) -> None:
    one, other = f"local:{tmp_path}/one.sock", f"local:{tmp_path}/other.sock"
    line, said = served(HIL_BUS=one)
    assert line.startswith(f"serving reference on {one}: ")
    assert said == f"bus {one}, from HIL_BUS\n"
    line, said = served("--bus", other, HIL_BUS=one)
    assert line.startswith(f"serving reference on {other}: ")
    assert said.startswith(f"bus {other}, from --bus; not {one}, as HIL_BUS says")


@pytest.mark.slow
def test_one_axis_is_served_alone_with_a_drive_that_holds_its_gains(tmp_path: Path) -> None:
    bus = f"local:{tmp_path}/one.sock"
    line, _ = served("--axis", "2", "--drive", "2=maxon_epos2", "--tuning", "reference", "--bus", bus)
    assert line == f"serving reference on {bus}: axis 2 at node 2, accelerometer at node 16"


@pytest.mark.parametrize(
    ("options", "status", "said"),
    [
        (("--axis", "4"), 2, "robot 'reference' has no axis 4; it has 2, 3, 5"),
        (("--axis", "2", "--drive", "3=maxon_epos2"), 2, "the robot has no axis 3; it has 2"),
        (("--robot", "reference-arm", "--axis", "2"), 2, "the links of this robot couple all axes"),
        (("--tuning", "nowhere.toml"), 3, "nowhere.toml"),
    ],
)
def test_what_cannot_be_served_is_said_before_a_bus_is_there(options: tuple[str, ...], status: int, said: str) -> None:
    ended = CliRunner().invoke(app, ["serve", *options, "--bus", "local:/nowhere/at/all.sock"])
    assert (ended.exit_code, said in " ".join(ended.output.split())) == (status, True), ended.output


def test_a_bit_rate_that_can_cannot_have_is_refused_with_those_that_it_can() -> None:
    ended = CliRunner().invoke(app, ["serve", "--bus", "local:/nowhere/at/all.sock@7k"])
    assert ended.exit_code == 2
    assert "'7k' is not a bit rate of classic CAN; expected 10k, 20k, 50k, " in " ".join(ended.output.split())


@pytest.mark.slow
def test_the_reference_arm_is_served_with_six_drives_and_nothing_is_loaded_meanwhile(tmp_path: Path) -> None:
    line, said = served("--robot", "reference-arm", "--bus", f"local:{tmp_path}/arm.sock")
    drives = ", ".join(f"axis {number} at node {number}" for number in range(1, 7))
    assert line == f"serving reference arm on local:{tmp_path}/arm.sock: {drives}, accelerometer at node 16"
    assert [line for line in said.splitlines() if "the emulator was " not in line] == []  # a busy machine is no fault
