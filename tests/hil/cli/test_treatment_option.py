"""--treatment: its names stand in every help, former names are understood and stand in none."""

import json
import re

import pytest
from typer.testing import CliRunner

from hil.cli.main import app
from hil.control.treatments import TABLE
from plant_emulator.cli.main import app as plant_emulator

FORMER = {alias: row for row in TABLE for alias in row.aliases}
ALL, PLAIN = TABLE, tuple(row for row in TABLE if row.is_plain)


@pytest.mark.parametrize(
    ("tool", "command", "rows"),
    [(app, "run", ALL), (app, "compare", ALL), (app, "plan", PLAIN), (plant_emulator, "robustness", PLAIN)],
)
def test_help_has_every_name_that_the_command_takes_and_no_former_one(tool, command, rows):
    text = CliRunner().invoke(tool, [command, "--help"], env={"COLUMNS": "500"}).output
    words = {word.rstrip(".") for word in re.split(r"[\s|,<>:]+", text)}
    assert "--treatment" in words
    assert {row.name for row in rows} <= words
    assert "--compensation" not in text
    assert not set(FORMER) & words


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


@pytest.mark.parametrize("former", FORMER)
@pytest.mark.parametrize("option", ["--treatment", "--compensation"])
def test_run_understands_former_names_and_answers_with_the_present_ones(tmp_path, former, option):
    row = FORMER[former]
    words = ["run", "line-motion", "--bench", "reference", "--bus", f"local:{tmp_path}/none.sock", "--out", str(tmp_path / "out")]
    found = CliRunner().invoke(app, [*words, option, former, "--loop", "host"])  # each lacks something, or acts in the drives
    assert found.exit_code == 3, found.output
    assert found.stderr.splitlines()[-1].startswith(row.name)


def test_a_name_that_is_none_is_a_mistake_of_usage(tmp_path):
    found = CliRunner().invoke(app, ["run", "line-motion", "--bench", "reference", "--treatment", "magic"])
    assert found.exit_code == 2
    assert "'magic' is not one of" in found.output


def test_plan_understands_the_former_option():
    def document(*options):
        return json.loads(CliRunner().invoke(app, ["plan", "--bench", "reference", "--json", *options]).stdout)

    assert document("--compensation", "none") == document("--treatment", "none") != document()


def test_robustness_understands_the_former_option():
    found = CliRunner().invoke(plant_emulator, ["robustness", "--compensation", "none", "--notch", "x.toml"])
    assert found.exit_code == 2
    assert "--treatment none has no filter" in found.stderr
