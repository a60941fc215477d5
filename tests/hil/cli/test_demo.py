"""The demo ends with what can be done next, in commands that can be typed as they stand."""

import importlib
import re
import shlex

import pytest
import typer

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
