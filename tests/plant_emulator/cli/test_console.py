"""Exit statuses and the handlers of errors of `plant-emulator`."""

import re

import pytest
import typer
from typer.testing import CliRunner

from drive_profiles.cli import completion
from drive_profiles.errors import OutOfRangeError
from plant_emulator.cli.console import EmulatorExitStatus, exit_on_error, exit_on_value_error
from plant_emulator.cli.main import app
from plant_emulator.robots.robot import SHIPPED


@pytest.mark.parametrize(
    ("command", "statuses"),
    [
        ("serve", [0, 2, 3, 4, 130]),
        ("simulate", [0, 2, 3, 130]),
        ("eds", [0, 2, 3, 130]),
        ("robustness", [0, 2, 3, 4, 130]),
    ],
)
def test_help_lists_the_exit_statuses_of_the_command(command, statuses):
    text = " ".join(CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "300"}).output.split())
    found = re.findall(r"(?:^|; )(\d+) [^;]+", text.partition("Exit status: ")[2])
    assert [int(number) for number in found] == statuses
    assert set(statuses) <= set(EmulatorExitStatus)


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (PermissionError(13, "Permission denied", "robot.toml"), EmulatorExitStatus.FILE, "robot.toml: Permission denied\n"),
        (OutOfRangeError("torque", 3, "N·m", "at most 2"), EmulatorExitStatus.FILE, "torque 3 N·m: at most 2\n"),
        (KeyboardInterrupt(), EmulatorExitStatus.INTERRUPTED, "interrupted\n"),
        (ValueError("no axis 7"), EmulatorExitStatus.USAGE, "no axis 7\n"),
    ],
)
def test_an_error_becomes_a_message_and_a_status(capsys, error, status, said):
    with pytest.raises(typer.Exit) as caught, exit_on_error(), exit_on_value_error():
        raise error
    assert caught.value.exit_code == status
    assert capsys.readouterr().err == said


def test_a_value_of_a_file_is_the_files_fault(capsys):
    with pytest.raises(typer.Exit) as caught, exit_on_value_error("robot.toml"):
        raise ValueError("two axes at one node")
    assert caught.value.exit_code == EmulatorExitStatus.FILE
    assert capsys.readouterr().err == "robot.toml: two axes at one node\n"


def test_an_error_that_nobody_expected_passes():
    with pytest.raises(RuntimeError), exit_on_error(), exit_on_value_error():
        raise RuntimeError


def test_a_simulation_that_cannot_be_written_names_the_place(tmp_path):
    (tmp_path / "file").write_text("")
    bench = "plant_emulator/robots/reference.toml"
    found = CliRunner().invoke(app, ["simulate", "--robot", bench, "--axis", "2", "--out", str(tmp_path / "file" / "run.csv")])
    assert found.exit_code == 3


def test_the_shell_completes_the_robots_of_the_package():
    assert {name: path.name for name, path in SHIPPED.items()} == completion.SHIPPED
