"""--treatment: its names stand in every help."""

import re

import pytest
from typer.testing import CliRunner

from hil.cli.main import app
from hil.control.treatments import TABLE
from plant_emulator.cli.main import app as plant_emulator

ALL, PLAIN = TABLE, tuple(row for row in TABLE if row.is_plain)


@pytest.mark.parametrize(
    ("tool", "command", "rows"),
    [(app, "run", ALL), (app, "compare", ALL), (app, "plan", PLAIN), (plant_emulator, "robustness", PLAIN)],
)
def test_help_has_every_name_that_the_command_takes(tool, command, rows):
    text = CliRunner().invoke(tool, [command, "--help"], env={"COLUMNS": "500"}).output
    words = {word.rstrip(".") for word in re.split(r"[\s|,<>:]+", text)}
    assert "--treatment" in words
    assert {row.name for row in rows} <= words


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.name)
def test_help_says_for_which_treatments_a_file_is(row):
    text = " ".join(CliRunner().invoke(app, ["run", "--help"], env={"COLUMNS": "500"}).output.split())
    line = {
        "model": "Model file of hil identify, for ",
        "design": "Design file of hil design, for ",
        "learnt": "Model file of hil learn, for ",
    }
    for need, begin in line.items():
        listed = text.partition(begin)[2].partition(".")[0].partition(";")[0].split(", ")
        assert (row.name in listed) == (row.needs == need)


def test_a_name_that_is_none_is_a_mistake_of_usage(tmp_path):
    found = CliRunner().invoke(app, ["run", "line-motion", "--bench", "reference", "--treatment", "magic"])
    assert found.exit_code == 2
    assert "'magic' is not one of" in found.output
