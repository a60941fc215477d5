"""Exit statuses of `drive-profiles`: one table, of which every command's help shows its part."""

import importlib
import pkgutil
import re
import subprocess
import sys

import pytest
from typer.testing import CliRunner

import drive_profiles
from drive_profiles.cli import console
from drive_profiles.cli.console import ExitStatus, ToolExitStatus, epilog
from drive_profiles.cli.main import app
from drive_profiles.errors import DriveProfileError

READING = (["scan"], ["info"], ["pull"], ["get"], ["diff"], ["verify"])
COMMANDING = (["faults"], ["nmt"], ["lss", "node-id"], ["lss", "bit-rate"])
WRITING = (["set"], ["upload"], ["store"], ["restore"])
ELSE = (["list"], ["show"], ["convert"], ["realise"], ["gains"], ["pages"], ["eds", "check"], ["eds", "show"], ["eds", "convert"])


def error_classes():
    for module in pkgutil.walk_packages(drive_profiles.__path__, "drive_profiles."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    found, waiting = set(), [DriveProfileError]
    while waiting:
        one = waiting.pop()
        waiting += one.__subclasses__()
        found.add(one)
    return {one for one in found if one.__module__.startswith("drive_profiles.")}


def listed(words):
    text = " ".join(CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": "300"}).output.split())
    numbers = re.findall(r"(?:^|; )(\d+) [^;]+", text.partition("Exit status: ")[2])
    return [int(number) for number in numbers]


def test_every_error_has_an_exit_status_of_the_table():
    classes = error_classes()
    assert len(classes) > 12
    for one in classes:
        assert ExitStatus(one.exit_code).sentence, one


@pytest.mark.ci
@pytest.mark.parametrize("words", [[], *READING, *WRITING, *ELSE], ids=" ".join)
def test_help_lists_exit_statuses_of_the_table_in_their_order(words):
    found = listed(words)
    assert found[:3] == [ExitStatus.DONE, ExitStatus.USAGE, ExitStatus.FILE]
    assert found == sorted(found)
    assert set(found) <= set(ExitStatus)


@pytest.mark.ci
@pytest.mark.parametrize("words", [*READING, *COMMANDING, *WRITING], ids=" ".join)
def test_help_of_a_command_on_a_bus_lists_the_status_of_every_error_but_of_realising(words):
    expected = {one.exit_code for one in error_classes()} - {ExitStatus.INTERNAL, ExitStatus.NOT_REALISABLE}
    assert expected <= set(listed(words))
    assert (ExitStatus.UNKNOWN in listed(words)) == (words in WRITING)


@pytest.mark.ci
@pytest.mark.parametrize("words", [*COMMANDING, ["store"]], ids=" ".join)
def test_help_of_a_command_that_restores_nothing_promises_no_restored_values(words):
    text = " ".join(CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": "300"}).output.split())
    assert "restored" not in text.partition("Exit status: ")[2]


def test_a_commands_own_sentence_stands_before_the_tables():
    assert epilog((ExitStatus.DONE, ExitStatus.BUS), {ExitStatus.DONE: "stored"}) == "Exit status: 0 stored; 4 no bus."


def test_a_member_is_its_number_and_keeps_its_sentence():
    class Statuses(ToolExitStatus):
        LATE = 7, "too late"

    assert Statuses.LATE == 7
    assert Statuses(7).sentence == "too late"


WRAPPED = """
import signal
import typer
from drive_profiles.cli.application import Tool

app = Tool("tool", "A tool.")

@app.command()
def wait() -> None:
    try:
        {before}
        typer.echo("goes on")
    finally:
        raise ValueError("an extension module has made its own error of it")

@app.command()
def other() -> None:
    pass

app.run(["wait"])
"""


@pytest.mark.parametrize(
    ("before", "status", "words"), [("signal.raise_signal(signal.SIGINT)", 130, "interrupted"), ("pass", 1, "ValueError")]
)
def test_an_interrupt_that_comes_back_as_another_error_is_an_interrupt(before, status, words):
    done = subprocess.run([sys.executable, "-c", WRAPPED.format(before=before)], capture_output=True, text=True, check=False)
    assert done.returncode == status
    assert words in done.stderr
    assert ("Traceback" in done.stderr) is (status == 1)


def test_without_a_terminal_progress_is_a_line_a_minute(monkeypatch, capsys):
    with console.progress("robots", 4) as step:
        step(1)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(console, "SAID_EVERY_S", 0.0)
    with console.progress("robots", 4) as step:
        step(1, "0 of 1 within the goal")
        step(3)
    said = capsys.readouterr().err.splitlines()
    assert said == ["robots: 1 of 4, 0 of 1 within the goal, 0 min left", "robots: 4 of 4, 0 min left"]
