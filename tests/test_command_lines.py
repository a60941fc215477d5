"""The three tools look alike: help that fits on 80 columns, examples that can be copied, one version, exit statuses."""

import contextlib
import importlib
import os
import pty
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

PROJECT = Path(__file__).parents[1]
TOOLS = {"hil": "hil", "drive-profiles": "drive_profiles", "plant-emulator": "plant_emulator"}


def group_of(tool):
    return typer.main.get_command(importlib.import_module(f"{TOOLS[tool]}.cli.main").app)


def commands(tool):
    """Every command and group of a tool: its words, and the command."""

    def below(command, words):
        yield words, command
        for name, each in getattr(command, "commands", {}).items():
            if not getattr(each, "hidden", False):  # an old name of another command
                yield from below(each, (*words, name))

    yield from below(group_of(tool), (tool,))


ALL = [pytest.param(words, command, id=" ".join(words)) for tool in TOOLS for words, command in commands(tool)]
LEAVES = [each for each in ALL if not hasattr(each.values[1], "commands")]


HELP = {}
"""The help of a command by its words and the width: several tests read the same."""


def help_of(words, command, columns, monkeypatch):
    """The help as a terminal of this width shows it."""
    if (words, columns) not in HELP:
        monkeypatch.setenv("COLUMNS", str(columns))
        HELP[words, columns] = command.get_help(command.make_context(" ".join(words), [], resilient_parsing=True))
    return HELP[words, columns]


def examples_in(text):
    """The commands below `Examples:`, as a user copies them: lines joined where a backslash says so."""
    _, found, rest = text.partition("\nExamples:\n")
    if not found:
        return []
    block = rest.partition("\n\n")[0]
    return re.sub(r" *\\\n *", " ", block).splitlines()


@pytest.mark.parametrize(("words", "command"), ALL)
@pytest.mark.parametrize("columns", [80, 60])
def test_no_line_of_the_help_is_wider_than_the_terminal(words, command, columns, monkeypatch):
    wide = [line for line in help_of(words, command, columns, monkeypatch).splitlines() if len(line) > columns]
    assert all(" " not in line.strip() for line in wide if columns < 80)  # one word that no terminal breaks
    assert columns < 80 or not wide


@pytest.mark.parametrize(("words", "command"), ALL)
def test_nothing_of_the_help_is_cut(words, command, monkeypatch):
    text = help_of(words, command, 80, monkeypatch)
    assert "..." not in re.sub(r"COMMAND \[ARGS\]\.\.\.|[}\]]\.\.\.", "", text)
    assert "…" not in text


def test_the_commands_of_lss_list_their_options_in_one_order():
    lists = [
        [each.name for each in command.params if each.param_type_name == "option"]
        for words, command in commands("drive-profiles")
        if words[1:2] == ("lss",) and len(words) == 3
    ]
    shortest, *others = sorted(lists, key=len)
    assert shortest[0] == "bus"
    assert all(each[: len(shortest)] == shortest for each in others), lists


@pytest.mark.parametrize(("words", "command"), LEAVES)
def test_the_help_has_no_type_of_python_and_says_what_can_be_repeated(words, command, monkeypatch):
    text = help_of(words, command, 80, monkeypatch)
    assert not re.search(r"list\[|<[A-Z]|^  \w[\w=-]* <", text, re.MULTILINE)
    for each in command.params:
        if getattr(each, "multiple", False):
            assert "repeat" in each.help or "Comma-separated" in each.help, each.name


@pytest.mark.parametrize(("words", "command"), LEAVES)
def test_a_command_ends_with_its_exit_statuses_and_shows_an_example(words, command, monkeypatch):
    text = help_of(words, command, 80, monkeypatch)
    assert text.count("Exit status: 0 ") == 1
    assert "Exit code" not in text
    assert examples_in(text)


@pytest.mark.parametrize(("words", "command"), LEAVES)
def test_the_examples_can_be_copied(words, command, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "demo").mkdir()  # of hil report
    for example in examples_in(help_of(words, command, 80, monkeypatch)):
        given = shlex.split(example)
        if given[0] not in TOOLS:
            assert given[0] == "can_viewer"
            continue
        assert tuple(given[: len(words)]) == words
        context = command.make_context(" ".join(words), given[len(words) :])  # refuses what it does not know
        assert context.args == []


def test_brackets_are_text(monkeypatch):
    (serve,) = (each.values for each in LEAVES if each.id == "plant-emulator serve")
    text = help_of(*serve, 80, monkeypatch)
    assert "[[fault]]" in text
    assert "local:PATH[@BITRATE]" in text


def called(package, *arguments):
    """What comes of a command line, in this process."""
    return CliRunner().invoke(importlib.import_module(f"{package}.cli.main").app, arguments)


@pytest.mark.parametrize("package", TOOLS.values())
def test_every_tool_says_the_version_that_reports_say_and_waits_for_no_numbers(package):
    """numpy, scipy and the compiler cost seconds, and neither help nor completion calculates."""
    from drive_profiles.version import DISTRIBUTION, version_text  # noqa: PLC0415
    from hil.results.base import versions  # noqa: PLC0415

    code = (
        "import sys; from importlib import import_module as load\n"
        f"app = load('{package}.cli.main').app\n"
        "try: app(['--version'])\nexcept SystemExit: pass\n"
        "print(sorted({'numpy', 'scipy', 'cffi', 'matplotlib', 'canopen', 'pydantic', 'rich'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=PROJECT)
    assert done.stdout == f"{DISTRIBUTION} {version_text()}\n[]\n"
    assert versions()[DISTRIBUTION] == version_text()


@pytest.mark.slow
def test_what_a_run_needs_before_it_moves_loads_no_part_of_scipy():
    """`import scipy` loads a part of it where the part is first used; its filters alone take longer than all that a run needs."""
    code = (
        "import sys, hil.experiments.runner, plant_emulator.world\n"
        "parts = {f'scipy.{part}' for part in ('fft', 'interpolate', 'linalg', 'optimize', 'signal', 'stats')}\n"
        "print(sorted(parts & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=PROJECT)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize("package", TOOLS.values())
def test_without_a_command_the_help_is_shown(package):
    done = called(package)
    assert done.exit_code == 2
    assert "Commands:" in done.output


@pytest.mark.ci
def test_a_package_that_is_started_is_its_tool():
    """Each in one way of its own: with nothing, for its help, for its version."""
    from drive_profiles.version import DISTRIBUTION, version_text  # noqa: PLC0415

    for package, arguments, status, words in (
        ("hil", [], 2, "Commands:"),
        ("drive_profiles", ["--help"], 0, "Commands:"),
        ("plant_emulator", ["--version"], 0, f"{DISTRIBUTION} {version_text()}\n"),
    ):
        done = subprocess.run(
            [sys.executable, "-m", package, *arguments], capture_output=True, text=True, check=False, cwd=PROJECT
        )
        assert done.returncode == status
        assert words in done.stdout + done.stderr


# -- tables on a terminal ----------------------------------------------------------------------------------------------


def on_a_terminal(columns, *command):
    """What a command prints on a terminal of so many columns."""
    master, slave = pty.openpty()
    environment = {**os.environ, "COLUMNS": str(columns), "TERM": "dumb"}
    process = subprocess.Popen(
        [sys.executable, "-m", *command], stdin=subprocess.DEVNULL, stdout=slave, stderr=subprocess.DEVNULL, cwd=PROJECT,
        env=environment,
    )  # fmt: skip
    os.close(slave)
    shown = b""
    with contextlib.suppress(OSError):  # EIO: the other end is closed
        while data := os.read(master, 65536):
            shown += data
    os.close(master)
    process.wait(60)
    return shown.decode().replace("\r\n", "\n").splitlines()


@pytest.mark.ci
def test_list_is_a_line_for_each_profile_at_80_columns():
    from drive_profiles.family.profile import available  # noqa: PLC0415

    lines = on_a_terminal(80, "drive_profiles", "list")
    assert [line.split()[0] for line in lines[2:]] == list(available())
    assert max(map(len, lines)) <= 80


@pytest.mark.slow
@pytest.mark.parametrize(
    ("columns", "command"),
    [
        (80, ("drive_profiles", "show", "maxon_epos4")),
        (80, ("drive_profiles", "show", "harmonic_drive_yukondrive")),
        (60, ("drive_profiles", "show", "copley_plus")),
        (80, ("drive_profiles", "realise", "emulated_drive", "--speed-rps", "5.92")),
        (80, ("drive_profiles", "eds", "show", "drive_profiles/vendors/emulated_drive.eds")),
        (80, ("hil", "plan", "--bench", "reference", "--bitrate", "1M")),
    ],
)
def test_tables_fit_and_break_no_word(columns, command, monkeypatch):
    lines = on_a_terminal(columns, *command)
    monkeypatch.chdir(PROJECT)
    piped = called(*command).stdout
    tables = [line for line in lines if not line.startswith("Fits")]  # the sentence at the end is the terminal's to wrap
    assert max(map(len, tables)) <= columns
    unbroken = set(piped.split()) - {"what", "change"}  # headings of first columns, which records leave out
    assert unbroken <= set(re.sub(r" · |: ", " ", "\n".join(lines)).split()) | set("\n".join(lines).split())


@pytest.mark.ci
def test_a_tool_whose_reader_has_gone_ends_as_one_that_the_signal_ends() -> None:
    command = [sys.executable, "-m", "drive_profiles", "list"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as tool:
        assert tool.stdout is not None
        tool.stdout.close()
        assert tool.wait(60.0) == 141
        assert tool.stderr is not None
        assert tool.stderr.read() == b""


LOADING = """
import importlib, signal
def load(name):
    try:
        signal.raise_signal(signal.SIGINT)
    finally:
        raise ImportError("a module has made its own error of it")
importlib.import_module = load
from {package}.__main__ import main
main()
"""


@pytest.mark.parametrize("package", TOOLS.values())
def test_ctrl_c_while_a_tool_loads_its_modules_is_one_line_and_130(package):
    done = subprocess.run([sys.executable, "-c", LOADING.format(package=package)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "interrupted before the command began\n")


def test_a_console_script_starts_the_module_of_its_tool():
    scripts = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    assert scripts == {tool: f"{package}.__main__:main" for tool, package in TOOLS.items()}
