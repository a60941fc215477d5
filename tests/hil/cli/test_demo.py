"""The demo ends with what can be done next, in commands that can be typed as they stand."""

import importlib
import re
import shlex

import pytest
import typer

from hil.cli import demo
from hil.cli.demo import NEXT, next_steps, tool_prefix


@pytest.mark.parametrize("command", [command for _, command in NEXT])
def test_each_next_command_is_one_that_the_tools_take(command):
    tool, *arguments = shlex.split(command)
    group = typer.main.get_command(importlib.import_module(f"{tool.replace('-', '_')}.cli.main").app)
    while hasattr(group, "commands"):
        group, arguments = group.commands[arguments[0]], arguments[1:]
    assert group.make_context(tool, arguments).args == []


def test_the_lines_fit_and_hold_the_commands():
    lines = next_steps(".venv/bin/")
    assert max(map(len, lines[:-1])) <= 80
    text = re.sub(r" *\\\n *", " ", "\n".join(lines))
    for _, command in NEXT:
        assert f"    .venv/bin/{command}\n" in text


@pytest.mark.parametrize(
    ("own", "arm", "status", "is_run"),
    [(0, 0, 0, True), (0, 9, 9, True), (9, 0, 9, True), (130, 0, 130, False), (8, 0, 8, False)],
)
def test_the_arm_is_run_of_unless_what_came_before_was_stopped_and_the_report_links_to_both(
    own, arm, status, is_run, tmp_path, monkeypatch
):
    """The parts themselves take minutes: tests/bench runs them."""
    done = []
    monkeypatch.setattr(demo, "_run_tour", lambda *_, **__: done.append("own") or own)
    monkeypatch.setattr(demo, "_run_arm_tour", lambda *_, **__: done.append("arm") or arm)
    monkeypatch.setattr("hil.report.writer.write_report_of", done.append)
    assert demo._run_tours(1, tmp_path, None, as_json=False) == status
    assert done == ["own", *(["arm"] if is_run else []), tmp_path]


def test_the_folder_stands_before_a_tool_that_the_shell_does_not_find(tmp_path, monkeypatch):
    tool = tmp_path / ".venv" / "bin" / "hil"
    tool.parent.mkdir(parents=True)
    tool.write_text("#!/bin/sh\n")
    tool.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", "/nowhere")
    assert tool_prefix(str(tool)) == tool_prefix(".venv/bin/hil") == ".venv/bin/"
    monkeypatch.setenv("PATH", str(tool.parent))
    assert tool_prefix(str(tool)) == tool_prefix("hil") == ""
    assert tool_prefix("/somewhere/hil/__main__.py") == ""  # python -m hil
