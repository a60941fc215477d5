"""The command: what it prints, where it writes, and with which code it leaves."""

import json
import re
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drive_profiles import eds
from drive_profiles.cli.eds import app
from drive_profiles.family.profile import VENDORS

QUIRKS = Path(__file__).parents[1] / "eds" / "quirks"
NUMBERS, STRUCTURE, CONFIGURED = QUIRKS / "numbers.eds", QUIRKS / "structure.eds", QUIRKS / "configured.dcf"
CLEAN = VENDORS / "emulated_drive.eds"
MANDATORY = (("1000", "device type"), ("1001", "error register"), ("1018", "identity"))
runner = CliRunner()


def run(*arguments: object):
    return runner.invoke(app, [str(argument) for argument in arguments])


def test_check_of_a_clean_file():
    result = run("check", CLEAN, "--strict")
    assert result.exit_code == 0
    assert re.fullmatch(
        rf"{re.escape(str(CLEAN))}: eds, \d+ objects, \d+ entries; 0 warnings, 0 contradictions, 0 left out\n", result.stdout
    )


def test_check_names_file_line_key_and_what_was_made_of_it():
    result = run("check", NUMBERS)
    assert result.exit_code == 0
    lines = [re.sub(r" for every CANopen device; expected .*", "", line) for line in result.stdout.splitlines()]
    wanted = f"{NUMBERS}:39: [2000] DefaultValue: '0xFD' read as -3, which has these bits; expected INTEGER8, -128 to 127"
    missing = [f"{NUMBERS}: [{index}]: missing: the {name} is mandatory" for index, name in MANDATORY]
    assert lines[:4] == [*missing, wanted]
    assert lines[-1] == f"{NUMBERS}: eds, 18 objects, 18 entries; {len(lines) - 4} warnings, 3 contradictions, 0 left out"


@pytest.mark.parametrize(("path", "options"), [(NUMBERS, ["--strict"]), (STRUCTURE, []), ("missing.eds", [])])
def test_check_leaves_with_three_when_something_is_refused(path, options):
    assert run("check", CLEAN, path, *options).exit_code == 3


def test_check_as_json():
    result = run("check", CLEAN, STRUCTURE, "missing.eds", "--json")
    assert result.exit_code == 3
    clean, faulty, missing = json.loads(result.stdout)
    assert (clean["accepted"], clean["warnings"], clean["vendor_id"]) == (True, [], 0x48494C01)
    assert faulty["refused"][0] == {
        "line": 112, "key": "[2006sub0]", "message": "[2006] is a VAR; left out", "expected": "an ARRAY or RECORD above it",
    }  # fmt: skip
    assert (missing["accepted"], missing["refused"][0]["line"]) == (False, 0)


def test_show_has_identity_and_objects():
    result = run("show", CONFIGURED, "--node-id", 7)
    assert result.exit_code == 0
    shown = {tuple(line.split()) for line in result.stdout.splitlines()}
    assert ("vendor", "id", "0xFFFFFFFF") in shown
    assert ("node", "id", "7") in shown
    assert ("1014:00", "COB-ID", "EMCY", "UNSIGNED32", "rw", "0x00000087", "with", "node-ID", "no", "0x80000087") in shown
    assert ("2003:00", "Key", "OCTET_STRING", "rw", "no", "00FF10") in shown
    assert "drive-profiles eds check" in result.stderr


@pytest.mark.parametrize("wanted", ["0x1016:2", "1016sub2", "1016:02", "1016h:2", "heartbeat of the"])
def test_show_one_entry(wanted):
    result = run("show", CONFIGURED, wanted)
    assert [line.split()[0] for line in result.stdout.splitlines()] == ["object", "1016:02"]


@pytest.mark.parametrize(("wanted", "count"), [("1016", 5), ("0x1016", 5), ("consumer", 8), ("gain", 1)])
def test_show_some_entries_as_json(wanted, count):
    result = run("show", CONFIGURED, wanted, "--json")
    assert len(json.loads(result.stdout)["objects"]) == count


def test_show_of_what_is_not_there_is_usage():
    result = run("show", CONFIGURED, "warp core")
    assert result.exit_code == 2
    assert "has no object 'warp core'" in " ".join(result.stderr.replace("│", " ").split())


@pytest.mark.parametrize(("suffix", "kind"), [(".eds", "eds"), (".dcf", "dcf"), (".DCF", "dcf")])
@pytest.mark.parametrize("path", [CONFIGURED, NUMBERS, QUIRKS / "types.eds", QUIRKS / "flat.xdd"], ids=lambda path: path.name)
def test_convert_gives_a_file_without_faults(tmp_path, path, suffix, kind):
    out = tmp_path / f"out{suffix}"
    result = run("convert", path, "--out", out, "--node-id", 9)
    assert result.exit_code == 0
    before, after = eds.load(path, node_id=9), eds.load(out, node_id=9)
    # That a default is outside its limits, or that there are modules, is said of the device, in any file.
    assert all("outside its own limits" in each.message or "a modular device" in each.message for each in after.warnings)
    assert (after.file_format, after.vendor_id) == (kind, before.vendor_id)
    assert after.values == (before.values if kind == "dcf" else {})
    assert ("parameter values left out" in result.stderr) is (kind == "eds" and bool(before.values))


def test_convert_to_json(tmp_path):
    out = tmp_path / "out.json"
    assert run("convert", CONFIGURED, "--out", out).exit_code == 0
    document = json.loads(out.read_text())
    assert document["values"]["2003:00"] == "00FF10"
    assert document["objects"][0]["name"] == "COB-ID EMCY"
    assert document["warnings"][0]["line"] == 3


def test_convert_overwrites_only_when_told(tmp_path):
    out = tmp_path / "out.eds"
    out.write_text("precious")
    result = run("convert", CLEAN, "--out", out)
    assert result.exit_code == 2
    assert out.read_text() == "precious"
    assert run("convert", CLEAN, "--out", out, "--force", "--json").exit_code == 0
    assert eds.load(out, strict=True).product_name == "Emulated servo drive"


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["convert", CLEAN, "--out", "x.toml"], 2),
        (["convert", CLEAN, "--out", "no/such/folder/x.eds"], 2),
        (["convert", CLEAN], 2),
        (["show", CLEAN, "--node-id", 128], 2),
        (["show", "missing.eds"], 3),
        (["convert", "missing.eds", "--out", "x.eds"], 3),
        (["check"], 2),
    ],
)
def test_exit_codes(arguments, code):
    assert run(*arguments).exit_code == code


def test_convert_twice_gives_files_that_owe_nothing_to_each_other(tmp_path):
    shutil.copy(CONFIGURED, tmp_path / "in.dcf")
    for name in ("a.eds", "b.eds"):
        run("convert", CLEAN if name == "b.eds" else tmp_path / "in.dcf", "--out", tmp_path / name)
    assert "Emulated servo drive, written" not in (tmp_path / "a.eds").read_text()
    assert "Emulated servo drive, written" in (tmp_path / "b.eds").read_text()


def test_check_with_a_node_id_reads_what_needs_one(tmp_path):
    path = tmp_path / "a.dcf"
    path.write_text("[1000]\nParameterName=x\nDataType=7\nAccessType=rw\nParameterValue=$NODEID+0x200\n")
    assert "left out: the node-ID is not known" in run("check", path).stdout
    assert "node-ID" not in run("check", path, "--node-id", "5").stdout
    assert run("check", path, "--node-id", "128").exit_code == 2


def test_contradictions_are_counted_and_listed_on_their_own(tmp_path):
    path = tmp_path / "a.eds"
    path.write_text(CLEAN.read_text().replace("ProductNumber=0x00000402", "ProductNumber=0x999"))
    result = run("check", path)
    assert result.exit_code == 0
    assert f"{path}:18: [DeviceInfo] ProductNumber: 0x999, but the default of 1018:2 is 0x402" in result.stdout
    assert "0 warnings, 1 contradiction, 0 left out" in result.stdout
    [report] = json.loads(run("check", path, "--json").stdout)
    assert [problem["line"] for problem in report["contradictions"]] == [18]
    assert run("check", path, "--strict").exit_code == 3
    assert "1 problem in this file" in run("show", path).stderr
