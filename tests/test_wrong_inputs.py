"""Wrong inputs of distinct kinds: one message that names the cause and the value, its exit status, and no traceback.

No bus is there: a command that looked for one before it named the cause would end with 4.
"""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from drive_profiles.cli.main import app as drive_profiles
from hil.bench.bench import REFERENCE
from hil.cli.main import app as hil
from plant_emulator.cli.main import app as plant_emulator

NOWHERE = ("--bus", "local:/nowhere/x.sock")
TEXT = REFERENCE.read_text(encoding="utf-8")
RUN = ("run", "constant-acceleration", "--axis", "2", "--treatment", "none", "--bench", "bench.toml", *NOWHERE)
IDENTIFY = ("identify", "plant", "--axis", "2", "--bench", "reference", *NOWHERE)
TREATED = ("run", "constant-acceleration", "--axis", "2", "--bench", "reference", *NOWHERE, "--treatment")

BENCHES = {
    "a node twice": ("node_id = 3", "node_id = 2", "axis.3.node_id: node-ID 2 is given twice on this bus: axis.2.node_id has it"),
    "no such node": ("node_id = 3", "node_id = 128", "axis.3.node_id: found 128; expected at most 127"),
    "limits swapped": ("min_rev = -22.0, position_max_rev = 22.0", "min_rev = 22.0, position_max_rev = -22.0", "is not below"),
    "a negative limit": ("speed_rps = 12.0", "speed_rps = -12.0", "speed_rps: found -12.0; expected more than 0.0 rev/s"),
    "not a number": ("torque_nm = 7.1", "torque_nm = nan", "torque_nm: found nan; expected a finite number in N·m"),
    "infinite": ("reduction_ratio = 120.0", "reduction_ratio = inf", "reduction_ratio: found inf; expected a finite number"),
    "a unit in a text": ("speed_rps = 12.0", 'speed_rps = "12 rev/s"', "found '12 rev/s'; expected a number in rev/s"),
    "a unit in a key": ("torque_nm = 7.1", "torque_mnm = 7100.0", "wrong unit: 'torque_mnm'; expected torque_nm (N·m)"),
    "mm as m": ("tip_lever_m = 0.70", "tip_lever_m = 700.0", "700 m is too long for a lever; expected at most 20 m"),
    "ms as s": ("sync_period_s = 0.002", "sync_period_s = 2", "bus.sync_period_s: found 2; expected at most 0.1 s"),
    "a key twice": ("approach_rps = 10.0", "approach_rps = 1.0\napproach_rps = 2.0", "bench.toml:7: Cannot overwrite a value"),
    "an unknown key": ("[constant_acceleration]", "[constant_acceleration]\njerk = 3", "unknown key 'jerk'; expected one of"),
    "a table of another kind": ('name = "reference"', 'name = ["a"]', "name: found ['a']; expected a valid string"),
    "a line left to type": ("reduction_ratio = 120.0", 'reduction_ratio = "TYPE: gear"', "found 'TYPE: gear'; expected a number"),
    "no bus address": ('"local:/tmp/robot.sock"', '"robot"', "bus.address: 'robot' is not a bus address; expected INTERFACE"),
    "beyond the speed limit": ("approach_rps = 10.0", "approach_rps = 1e9", "is above axis 2's speed_rps 12.0"),
    "notch that ends early": ("start_rps = 4.0", "start_rps = 40.0", "start_rps 40.0 is not below end_rps 9.0"),
}

FILES = {
    "bench.toml": TEXT,
    "words.toml": "precious",
    "empty.toml": "",
    "x.log": "hello\nworld\n",
    "columns.csv": "a,b\n1,2\n",
    "old/result.json": '{"schema": 1}',
    "other/result.json": '{"schema": 2, "kind": "cake"}',
    "broken/result.json": "no",
    "worded/result.json": '{"schema": 2, "kind": "run", "runs": "two"}',
    "list/result.json": "[]",
}

COMMANDS = {
    "an axis that is not there": (hil, (*RUN, "--axis", "7"), 3, "has no axis 7; it has 2, 3, 5"),
    "an axis too many": (hil, ("run", "line-motion", "--axis", "2", "--bench", "reference"), 2, "takes no --axis"),
    "a folder in use": (hil, (*RUN, "--out", "old"), 3, "old/result.json already exists, from an earlier command"),
    "a file as a folder": (hil, (*RUN, "--out", "x.log"), 3, "x.log is a file; expected a folder"),
    "a folder below a file": (hil, (*RUN, "--out", "x.log/a/b"), 3, "x.log is a file; expected a folder"),
    "no design file": (hil, (*TREATED, "notch-designed"), 3, "needs a design file: --design design.toml, from hil design notch"),
    "an empty file": (hil, (*TREATED, "notch-designed", "--design", "empty.toml"), 3, "empty.toml:1: robot: is missing"),
    "no TOML": (hil, (*TREATED, "cancellation", "--model", "words.toml"), 3, "words.toml:1: Expected '='"),
    "a file that is missing": (hil, (*TREATED, "none", "--model", "no.toml"), 3, "no.toml: cannot be read"),
    "a file of another kind": (hil, (*TREATED, "none", "--model", "bench.toml"), 3, "is a bench file; expected a model file"),
    "a model file to write": (hil, (*IDENTIFY, "--model", "words.toml"), 3, "words.toml:1: Expected '='"),
    "a folder that is missing": (hil, (*IDENTIFY, "--model", "/no/m.toml"), 3, "/no/m.toml: cannot be written: there is no"),
    "an option that is no number": (hil, (*IDENTIFY, "--bias-rps", "nan"), 2, "--bias-rps: 'nan': expected a finite number"),
    "a number out of range": (hil, (*RUN, "--repeat", "0"), 2, "'0': expected at least 1"),
    "an order of 0": (hil, ("identify", "ate", "--axis", "2", "--bench", "reference", "--orders", "0"), 2, "must be above 0"),
    "a folder as a log": (hil, ("explain", "old"), 3, "old: is a folder; expected a log of a bus"),
    "a device as a log": (hil, ("explain", "/dev/null"), 3, "/dev/null: is a device; expected a log of a bus"),
    "a device to export": (hil, ("export", "/dev/null", "--to", "x.mcap"), 3, "/dev/null: is a device; expected a log of a bus"),
    "an export onto its source": (hil, ("export", "log.mf4", "--to", "log.mf4"), 2, "log.mf4: is the source itself; expected"),
    "a folder to show that is missing": (hil, ("scope", "no"), 2, "'no' does not exist"),
    "a file to show": (hil, ("scope", "x.log"), 2, "'x.log' is a file"),
    "a node that none can be": (hil, ("scope", *NOWHERE, "--ask", "2,²"), 2, "--ask: 2,²: expected a comma-separated list"),
    "a file as a bus": (hil, (*RUN, "--bus", "local:x.log"), 4, "x.log is a file; expected the socket of an emulator"),
    "a folder as a bus": (hil, (*RUN, "--bus", "local:old"), 4, "old is a folder; expected the socket of an emulator"),
    "no adapter": (
        hil, (*RUN, "--bus", "slcan:/dev/no@1M"), 4, "no bus at slcan:/dev/no@1M: could not open port /dev/no: No such file",
    ),
    "no adapter to scan": (
        drive_profiles, ("scan", "--bus", "slcan:/dev/no@1M"), 4,
        "no bus at slcan:/dev/no@1M: could not open port /dev/no: No such file",
    ),
    "no log": (hil, ("explain", "x.log"), 3, "x.log: no frame in it: none of its 2 lines is a line of candump"),
    "a design file to write": (
        hil, ("design", "notch", "--axis", "2", "--bench", "reference", "--design", "bench.toml"), 3,
        "bench.toml: is a bench file; expected a design file",
    ),
    "a recording without the motor": (
        hil, ("identify", "ate", "--axis", "2", "--recording", "columns.csv", "--bench", "reference", "--model", "m.toml"), 3,
        "columns.csv: no column is recognised as motor; give --column motor=NAME,UNIT; there are a, b",
    ),
    "an excitation of no torque": (hil, (*IDENTIFY, "--amplitude-nm", "-1"), 3, "excitation of -1 N·m; expected more than 0"),
    "a limit of 0": (
        hil, ("design", "notch", "--axis", "2", "--bench", "reference", "--tip-mm", "0"), 2, "tip_mm = 0.0 must be above 0",
    ),
    "an axis that no bench has": (
        hil, ("compare", "--bench", "reference", "--axis", "9", *NOWHERE), 3, "has no axis 9; it has 2, 3, 5",
    ),
    "an emulator that does not start": (
        hil, ("compare", "--bench", "reference", "--emulate", "no.toml"), 4, "the emulator did not start: no.toml: cannot",
    ),
    "an unknown treatment": (
        hil, ("compare", "--bench", "reference", *NOWHERE, "--treatment", "none,cake"), 2, "--treatment cake: expected one of",
    ),
    "an old result": (hil, ("report", "old"), 3, "old/result.json: schema 1; expected 2; run the command again"),
    "a result of no kind": (hil, ("report", "other"), 3, "its kind is 'cake'; expected one of run, compare"),
    "a result that is no JSON": (hil, ("report", "broken"), 3, "broken/result.json: not JSON"),
    "a result without a schema": (hil, ("report", "list"), 3, "list/result.json: not a result: it has no `schema`"),
    "a result that is no text": (hil, ("report", "bytes"), 3, "result.json: not JSON: byte 0xff; expected UTF-8 text"),
    "a result with words for numbers": (hil, ("report", "worded"), 3, "bench: is missing; runs: found 'two'; expected"),
    "a value without its key": (drive_profiles, ("set", "gain", "--node", "2", *NOWHERE), 2, "'gain': expected OBJECT=VALUE"),
    "no such profile": (drive_profiles, ("show", "cake"), 2, "no drive profile 'cake'; available: copley_plus"),
    "no such interface": (drive_profiles, ("scan", "--bus", "cake:1"), 2, "unknown interface 'cake'; expected one of local"),
    "a notch at no speed": (
        drive_profiles, ("realise", "emulated_drive", "--speed-rps", "-1"), 2, "--speed-rps: -1 must be positive",
    ),
    "a notch that lifts": (
        drive_profiles, ("realise", "emulated_drive", "--speed-rps", "5.9", "--zeta-rn", "5"), 2,
        "zeta_zero = 5 must be below zeta_pole = 0.1 to make a notch",
    ),
    "more sets than nodes": (
        drive_profiles, ("upload", "bench.toml", "x.toml", "--node", "2", *NOWHERE), 2, "2 parameter sets for 1 node; give one",
    ),
    "a file for a backup": (drive_profiles, ("backup", "--out", "x.log", *NOWHERE), 3, "x.log is a file; expected a folder"),
    "a file for pages": (drive_profiles, ("pages", "--out", "x.log"), 3, "x.log is a file; expected a folder"),
    "a set that is none": (drive_profiles, ("upload", "bench.toml", "--node", "2", *NOWHERE), 3, "is a bench file; expected a"),
    "an assignment that is none": (plant_emulator, ("serve", "--drive", "3:x"), 2, "--drive 3:x: expected AXIS=VALUE, such as"),
    "a file to serve on": (
        plant_emulator, ("serve", "--bus", "local:x.log"), 4, "cannot serve local:x.log: x.log is a file; choose another path",
    ),
    "a folder to serve on": (plant_emulator, ("serve", "--bus", "local:old"), 4, "old is a folder; choose another path"),
    "no folder to serve in": (
        plant_emulator, ("serve", "--bus", "local:/no/x.sock"), 4, "there is no folder /no; make it first, or",
    ),
    "a file for EDS files": (plant_emulator, ("eds", "--out", "x.log"), 3, "x.log: is a file; expected a folder"),
    "a file for a fleet": (plant_emulator, ("fleet", "--seed", "1", "--out", "x.log"), 3, "x.log is a file; expected a folder"),
    "a file for a study": (plant_emulator, ("robustness", "--out", "x.log"), 3, "x.log is a file; expected a folder"),
    "a folder for a study": (plant_emulator, ("following", "--out", "old"), 3, "old: is not a regular file"),
    "a robot without gains": (
        plant_emulator, ("simulate", "--robot", "reference-arm", "--out", "o.csv"), 3, "a simulation needs the gains: add [axis.",
    ),
    "seeds backwards": (plant_emulator, ("fleet", "--seeds", "3-1", "--out", "q"), 2, "3-1 ends before it begins"),
    "a robot that is a bench": (plant_emulator, ("serve", "--robot", "bench.toml"), 3, "is a bench file; expected a robot file"),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "bytes").mkdir()
    (tmp_path / "bytes" / "result.json").write_bytes(b"\xff\xfe")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("HIL_BUS", raising=False)
    return tmp_path


def refused(app, arguments):
    done = CliRunner().invoke(app, [*arguments])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    assert "Traceback" not in done.output
    return done.exit_code, " ".join(done.stderr.replace("Invalid value for ", "").replace("'--bias-rps'", "--bias-rps").split())


@pytest.mark.parametrize(("found", "wrong", "words"), BENCHES.values(), ids=BENCHES)
def test_a_mistake_in_a_bench_file_is_named_with_line_and_value(folder, found, wrong, words):
    assert found in TEXT
    (folder / "bench.toml").write_text(TEXT.replace(found, wrong, 1), encoding="utf-8")
    status, said = refused(hil, RUN)
    assert (status, said.startswith("bench.toml:")) == (3, True), said
    assert words in said


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(("app", "arguments", "status", "words"), COMMANDS.values(), ids=COMMANDS)
def test_a_wrong_input_is_named_before_a_bus_is_looked_for(app, arguments, status, words):
    code, said = refused(app, arguments)
    assert (code, words in said) == (status, True), said
