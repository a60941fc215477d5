"""Exit statuses and the handler of errors: one table, one way of saying it, in every command."""

import importlib
import pkgutil
import re

import pytest
import typer
from typer.testing import CliRunner

import hil
from hil.can.errors import BusLostError, BusUnavailableError
from hil.cli.console import ExitStatus, RunProgress, exit_on_error, exit_status_of
from hil.cli.main import app
from hil.errors import HilError

ON_A_BUS = (["demo"], ["run"], ["compare"], ["identify", "plant"], ["identify", "ate"], ["learn"])
COMMANDS = (*ON_A_BUS, ["report"], ["plan"], ["design", "notch"])


def error_classes(root):
    """All classes of errors of `hil` below one."""
    for module in pkgutil.walk_packages(hil.__path__, "hil."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    found, waiting = set(), [root]
    while waiting:
        one = waiting.pop()
        waiting += one.__subclasses__()
        found.add(one)
    return {one for one in found if one.__module__.startswith("hil.")}


def statuses_in_help(words):
    text = " ".join(CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": "300"}).output.split())
    listed = text.partition("Exit status: ")[2]
    return {int(number): said.strip(" .") for number, said in re.findall(r"(?:^|; )(\d+) ([^;]+)", listed)}


def test_every_error_has_an_exit_status_of_the_table():
    classes = error_classes(HilError)
    assert len(classes) > 12
    for one in classes:
        assert ExitStatus(one.exit_code).sentence, one


@pytest.mark.parametrize("words", ON_A_BUS, ids=" ".join)
def test_help_of_a_command_that_moves_a_robot_lists_the_status_of_every_error(words):
    expected = {one.exit_code for one in error_classes(HilError)} - {ExitStatus.INTERNAL}
    assert expected <= set(statuses_in_help(words))
    assert {ExitStatus.DONE, ExitStatus.USAGE, ExitStatus.BUS} <= set(statuses_in_help(words))


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_help_of_every_command_lists_statuses_of_the_table_in_their_order(words):
    listed = statuses_in_help(words)
    assert {ExitStatus.DONE, ExitStatus.USAGE, ExitStatus.FILE} <= set(listed)
    assert list(listed) == sorted(listed)
    assert set(listed) <= set(ExitStatus)


def test_where_a_command_says_nothing_of_its_own_the_sentence_of_the_table_stands():
    table = {int(status): status.sentence for status in ExitStatus if status is not ExitStatus.INTERNAL}
    assert statuses_in_help([]) == table
    del table[ExitStatus.NOT_MET]  # a move is not judged
    assert statuses_in_help(["move"]) == table


@pytest.mark.parametrize(
    "words",
    [
        ["run", "line-motion"],
        ["compare"],
        ["learn", "--axis", "2", "--model", "model.toml"],
        ["identify", "plant", "--axis", "2"],
        ["identify", "ate", "--axis", "2"],
        ["design", "notch", "--axis", "2"],
        ["plan"],
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_every_command_says_of_a_file_its_name_and_the_reason(monkeypatch, words):
    def refuse(path):
        raise PermissionError(13, "Permission denied", path)

    monkeypatch.setattr("hil.bench.bench.load_bench", refuse)
    found = CliRunner().invoke(app, [*words, "--bench", "mine.toml"])
    assert found.exit_code == ExitStatus.FILE
    assert found.stderr == "mine.toml: Permission denied\n"


def test_an_interrupt_is_said_and_ends_with_130(capsys):
    with pytest.raises(typer.Exit) as caught, exit_on_error():
        raise KeyboardInterrupt
    assert caught.value.exit_code == 130
    assert capsys.readouterr().err == "interrupted before anything moved\n"


@pytest.mark.parametrize("error", [RuntimeError("a fault of the program"), BrokenPipeError()])
def test_an_error_that_nobody_expected_and_a_reader_that_has_gone_pass(error):
    with pytest.raises(type(error)) as caught, exit_on_error():
        raise error
    assert caught.value is error


def test_a_bus_that_is_not_there_is_another_status_than_one_that_is_lost():
    from drive_profiles.address import AddressError, parse_address  # noqa: PLC0415

    address = parse_address("socketcan:can0")
    assert exit_status_of(BusUnavailableError(address, "gone")) == ExitStatus.BUS
    assert exit_status_of(BusLostError(address, "gone")) == ExitStatus.SAFETY_STOP
    assert exit_status_of(AddressError("nonsense")) == ExitStatus.USAGE
    assert exit_status_of(RuntimeError()) == ExitStatus.INTERNAL


def test_the_bar_of_a_run_cuts_neither_its_fraction_nor_its_time(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "80")
    with RunProgress(1) as progress:
        progress.run("constant-acceleration, axis 2, drive-closed, with the designed notch")
        progress.progress(0.4)
    shown = capsys.readouterr().err
    assert " 40 %" in shown
    assert "0:00:0" in shown
