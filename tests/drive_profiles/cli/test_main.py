"""The command: what it prints, and with which code it leaves."""

import json
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from drive_profiles.cli.main import app
from drive_profiles.family.profile import VENDORS, Profile, available

runner = CliRunner()


def test_list_names_every_profile():
    result = runner.invoke(app, ["list"])
    assert result.exit_code == 0
    rows = [line.split() for line in result.stdout.splitlines()]
    assert [row[0] for row in rows] == ["name", *available()]
    by_name = {row[0]: row for row in rows}
    assert by_name["emulated_drive"][1:5] == ["CSP", "exact", "exact", "yes"]
    assert all(len(row) == 5 for row in rows[1:])  # an answer each; the reasons stand in `show`


def test_list_as_json():
    result = runner.invoke(app, ["list", "--json"])
    assert result.exit_code == 0
    facts = json.loads(result.stdout)
    assert [fact["name"] for fact in facts] == available()
    drive = next(fact for fact in facts if fact["name"] == "emulated_drive")
    assert drive["product_code"] == 0x402
    assert drive["capabilities"]["notch_inside"]["answer"] == "exact"


def test_show_has_identity_reasons_objects_and_units():
    result = runner.invoke(app, ["show", "emulated_drive"])
    assert result.exit_code == 0
    for words in (
        "0x00000402",
        "250 µs",
        "PP, PV, TQ, HM, IP, CSP, CSV, CST",
        "6072:0  UNSIGNED16  N·m        1 ‰ of 6076h",
        "take the paper's two dampings",
    ):
        assert words in result.stdout
    assert "\x1b" not in result.stdout


def test_show_as_json_is_the_whole_profile():
    result = runner.invoke(app, ["show", "emulated_drive", "--json"])
    assert result.exit_code == 0
    assert Profile.model_validate_json(result.stdout, strict=True) == Profile.load("emulated_drive")


def test_show_lists_the_products_and_shows_one():
    family = runner.invoke(app, ["show", "trinamic_tmcm16xx"]).stdout
    line = next(line.split() for line in family.splitlines() if line.startswith("tmcm-1670"))
    assert line == ["tmcm-1670", "Trinamic", "TMCM-1670", "0x00000686", "any", "0x00420192", "36", "eds"]
    product = runner.invoke(app, ["show", "trinamic_tmcm16xx/tmcm-1670"]).stdout
    assert "PP, PV, HM, CST" in product
    gains = [line.split()[1] for line in product.splitlines() if line.startswith("position_gain ")]
    assert gains == ["2050:4"]
    listed = json.loads(runner.invoke(app, ["list", "--json"]).stdout)
    names = {each["name"]: [product["product"] for product in each["products"]] for each in listed}
    assert names["maxon_epos4"] == ["module-50-5", "module-24-1.5", "70-15"]
    assert names["emulated_drive"] == []


@pytest.mark.parametrize(("code", "status"), [(0x6450_0000, 0), (0x6150_0000, 3)])
def test_convert_goes_by_the_product_that_the_set_is_of(tmp_path, code, status):
    """12 A is a nominal current of the 70/15, and none of the Module 50/5."""
    path = tmp_path / "set.toml"
    path.write_text(
        f'[header]\nprofile = "maxon_epos4"\nproduct_code = {code}\n[commissioning]\nnominal_current = {{ value = 12000 }}\n'
    )
    result = runner.invoke(app, ["convert", str(path), "--out", str(tmp_path / "set.cdcf")])
    assert result.exit_code == status
    assert ("must be at most 5000" in result.stderr) == (status != 0)
    assert "inf" not in result.stderr


@pytest.mark.parametrize("name", available())
def test_show_has_the_reason_for_every_answer(name):
    capabilities = Profile.load(name).capabilities
    shown = runner.invoke(app, ["show", name]).stdout
    for _, entry in () if capabilities is None else capabilities:
        assert entry.reason in shown


def test_a_gain_has_the_unit_that_the_loops_facts_give_it():
    shown = runner.invoke(app, ["show", "maxon_epos4"]).stdout
    assert [line.split()[3] for line in shown.splitlines() if line.startswith("position_") and "_gain  " in line] == [
        "µA/rad", "µA/(rad·s)", "µA·s/rad",
    ]  # fmt: skip


def test_a_profile_may_be_a_file(tmp_path):
    path = tmp_path / "drive.toml"
    path.write_text((VENDORS / "emulated_drive.toml").read_text(encoding="utf-8"), encoding="utf-8")
    assert runner.invoke(app, ["show", str(path)]).exit_code == 0


@pytest.mark.parametrize("arguments", [["show", "nothing"], ["show", "elmo_gold/x"], ["show"], ["bogus"], ["list", "--bogus"]])
def test_wrong_usage_is_2(arguments):
    result = runner.invoke(app, arguments)
    assert result.exit_code == 2
    assert "Traceback" not in result.output


def test_an_unknown_name_lists_what_there_is():
    assert "available: copley_plus, elmo_gold" in runner.invoke(app, ["show", "nothing"]).output
    wrong = runner.invoke(app, ["show", "maxon_epos4/50-5"])
    assert wrong.exit_code == 2
    assert "no product '50-5'; it has 0x61500000 (module-50-5)" in wrong.stderr


def test_a_bad_file_is_3_with_every_problem_on_stderr(tmp_path):
    path = tmp_path / "drive.toml"
    path.write_text("name = 3\nbogus = 1\n")
    result = runner.invoke(app, ["show", str(path)])
    assert result.exit_code == 3
    assert result.stdout == ""
    assert f"{path}:1: name: found 3; expected a valid string" in result.stderr
    assert f"{path}:2: bogus: unknown key" in result.stderr
    assert runner.invoke(app, ["show", str(tmp_path / "none.toml")]).exit_code == 3


def test_help_loads_nothing_heavy():
    code = (
        "import sys, drive_profiles.cli.main\n"
        "heavy = {'numpy', 'pydantic', 'canopen', 'can', 'scipy', 'cffi', 'matplotlib'} & set(sys.modules)\n"
        "sys.exit(f'imported: {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_help_ends_with_the_exit_statuses():
    assert "Exit status: 0 done; 2 usage; 3 invalid file" in " ".join(runner.invoke(app, ["--help"]).stdout.split())


@pytest.mark.parametrize("command", ["list", "show"])
def test_help_of_a_command_has_an_example_and_its_exit_statuses(command):
    result = runner.invoke(app, [command, "--help"])
    assert result.exit_code == 0
    assert f"\nExamples:\n  drive-profiles {command}" in result.stdout
    assert "Exit status: 0 done; 2 usage; 3 invalid file" in " ".join(result.stdout.split())


def test_the_package_runs_as_a_module():
    done = subprocess.run(
        [sys.executable, "-m", "drive_profiles", "--help"], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert "Usage: python -m drive_profiles [OPTIONS] COMMAND" in done.stdout
