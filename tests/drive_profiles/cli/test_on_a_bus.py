"""`drive-profiles` as a user runs it: real processes, a real local bus, emulated drives of three families."""

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time

import pytest
from typer.testing import CliRunner

from drive_profiles.cli.main import app
from drive_profiles.cli.transact import MAX_ROWS
from drive_profiles.device.bus import SdoBus
from drive_profiles.device.device import Device
from drive_profiles.device.sdo import SdoPort
from drive_profiles.device.target import device_at
from drive_profiles.errors import NoAnswerError, SdoAbortedError
from drive_profiles.family.profile import Profile
from drive_profiles.parameter_set.parameters import ParameterSet
from drive_profiles.standard.cia301 import abort_text
from drive_profiles.upload import journal

runner = CliRunner()
START_TIMEOUT_S = 120.0


def served(path, *options):
    """`plant-emulator serve` as a process that ends with us."""
    command = [sys.executable, "-m", "plant_emulator", "serve", "--bus", f"local:{path}", "--until-stdin-closes", *options]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    deadline = time.monotonic() + START_TIMEOUT_S
    while not _answers(path):
        assert process.poll() is None, process.communicate()[0]
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return process


@contextlib.contextmanager
def serving(*options):
    """Address of a robot that is served in a folder of its own, as long as this is open."""
    with tempfile.TemporaryDirectory(prefix="hil-") as folder:
        process = served(f"{folder}/r.sock", *options)
        yield f"local:{folder}/r.sock"
        process.stdin.close()
        process.wait(60)
        process.stdout.close()


def _answers(path):
    """Whether somebody serves there: a socket file alone may not be listened to yet."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        return probe.connect_ex(path) == 0


@pytest.fixture(scope="module")
def robot():
    with serving("--drive", "3=kollmorgen_akd", "--drive", "5=maxon_epos4", "--store-time-s", "0.3") as address:
        yield address


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, robot):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HIL_BUS", robot)
    return tmp_path


def run(*arguments, code=0):
    result = runner.invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == code, (arguments, result.output, result.exception)
    assert "Traceback" not in result.output
    return result


def cells(text):
    """The words of each line of a table."""
    return [line.split() for line in text.splitlines()]


@pytest.mark.slow
def test_scan_finds_every_node_with_its_profile():
    rows = [line.split() for line in run("scan").stdout.splitlines()]
    assert [row[0] for row in rows[1:]] == ["2", "3", "5", "16"]
    assert [row[-1] for row in rows[1:]] == [
        "emulated_drive",
        "kollmorgen_akd",
        "maxon_epos4/module-50-5",
        "emulated_accelerometer",
    ]
    found = json.loads(run("scan", "--nodes", "2,16", "--json").stdout)
    assert [(node["node"], node["profiles"]) for node in found] == [(2, ["emulated_drive"]), (16, ["emulated_accelerometer"])]
    run("scan", "--nodes", "99", "--timeout-s", "0.05", code=5)
    for wrong in ("0-5", "128", "x", "", "5-", "5-2"):
        run("scan", "--nodes", wrong, code=2)


@pytest.mark.ci
def test_the_first_line_says_which_bus_is_taken_and_who_names_it(robot, monkeypatch):
    assert run("info", "--node", "5").stderr.splitlines()[0] == f"bus {robot}, from HIL_BUS"
    monkeypatch.setenv("HIL_BUS", "local:/nowhere/else.sock")
    done = run("info", "--node", "5", "--bus", robot, "--json")
    assert done.stderr.splitlines()[0] == f"bus {robot}, from --bus; not local:/nowhere/else.sock, as HIL_BUS says"
    assert json.loads(done.stdout)["vendor_id"] == 0xFB
    assert run("info", "--node", "5", code=4).stderr.startswith("bus local:/nowhere/else.sock, from HIL_BUS\n")
    monkeypatch.setenv("HIL_BUS", "foo:bar")
    assert "HIL_BUS: 'foo:bar': unknown interface 'foo'; expected one of local, socketcan" in run("scan", code=2).stderr
    monkeypatch.delenv("HIL_BUS")
    assert "HIL_BUS" in run("scan", code=2).stderr


def test_two_sets_are_compared_without_a_bus(robot):
    run("pull", "--node", "2", "--out", "axis2.toml")
    assert run("diff", "axis2.toml", "axis2.toml").stderr == ""
    assert run("diff", "axis2.toml", "--node", "2").stderr == f"bus {robot}, from HIL_BUS\n"


def test_a_profile_of_another_vendor_is_doubted_aloud():
    said = run("pull", "--node", "2", "--profile", "kollmorgen_akd", "--out", "odd.toml").stderr
    assert "node 2: profile kollmorgen_akd is for vendor-ID 0x0000006A; the device is another (vendor 0x48494C01" in said
    assert "is for vendor-ID" not in run("pull", "--node", "2", "--profile", "emulated_drive", "--out", "even.toml").stderr


def test_a_set_of_another_family_is_not_compared_with_a_drive():
    """Its first object would end the command with an abort that names neither file nor device."""
    run("realise", "emulated_drive", "--order", "2", "--speed-rps", "5.92", "--out", "notch.toml")
    for command in (("verify", "notch.toml"), ("diff", "notch.toml")):
        said = " ".join(run(*command, "--node", "5", code=5).stderr.split())
        assert "node 5: notch.toml is for another device: its vendor (1018h:1) is 0xFB, profile emulated_drive says 0x" in said
        assert "check node-ID and file" in said


def test_info_says_who_a_node_is_and_in_which_state():
    facts = json.loads(run("info", "--node", "5", "--json").stdout)
    assert facts["vendor_id"] == 0xFB
    assert facts["state"] == "switch on disabled"
    assert "maxon_epos4" in run("info", "--node", "5").stdout
    assert "-" in run("info", "--node", "16").stdout


@pytest.mark.slow
def test_the_page_of_the_readme_from_scan_to_a_stored_notch(folder):
    run("pull", "--node", "2", "--out", "axis2.toml")
    before = ParameterSet.load(folder / "axis2.toml")
    text = (folder / "axis2.toml").read_text()
    text = text.replace('"notch_1.mode" = { value = 0 }', '"notch_1.mode" = { value = 1 }')
    text = text.replace('"notch_1.start_rps" = { value = 4.0', '"notch_1.start_rps" = { value = 4.5')
    (folder / "notch.toml").write_text(text)
    assert ["notch_1.mode", "0", "1"] in cells(run("diff", "axis2.toml", "notch.toml", code=7).stdout)
    assert "notch_1.mode" in run("diff", "notch.toml", "--node", "2", code=7).stdout
    shown = run("upload", "notch.toml", "--node", "2", "--dry-run")
    assert ["2", "2110:1", "(notch_1.mode)", "0", "1"] in cells(shown.stdout)
    assert cells(run("get", "notch_1.mode", "--node", "2").stdout)[1][2] == "0"
    run("upload", "notch.toml", "--node", "2", code=2)  # nobody to ask, and no --yes
    done = run("upload", "notch.toml", "--node", "2", "--store", "--reset", "--yes")
    assert "done, 2 written and read back, stored" in done.stdout
    assert "edited" in done.stderr
    run("verify", "notch.toml", "--node", "2")
    assert run("diff", "notch.toml", "--node", "2").stdout == "no difference\n"
    again = run("upload", "notch.toml", "--node", "2", "--yes")
    assert "nothing to write" in again.stdout
    [journal] = (folder / "drive-journals").glob("*.jsonl")
    back = run("restore", "--snapshot", journal, "--yes", "--store")
    assert "done" in back.stdout
    run("pull", "--node", "2", "--out", "after.toml")
    assert ParameterSet.load(folder / "after.toml").differences(before) == []
    run("verify", "notch.toml", "--node", "2", code=7)


def test_one_set_for_two_drives_of_different_families_is_refused_before_anything_is_written(folder):
    run("pull", "--node", "2", "--out", "axis2.toml")
    result = run("upload", "axis2.toml", "--node", "2", "--node", "3", "--yes", code=5)
    assert "vendor" in result.stderr
    assert not (folder / "drive-journals").exists()


def test_two_drives_are_written_together(folder):
    for node in (2, 5):
        run("pull", "--node", str(node), "--out", f"{node}.toml")
    result = run("upload", "2.toml", "5.toml", "--node", "2", "--node", "5", "--yes", "--allow-unverified", "--json")
    assert [outcome["kind"] for outcome in json.loads(result.stdout)] == ["done", "done"]


@pytest.mark.slow
def test_get_and_set_take_addresses_and_names_and_say_units():
    assert "1/s" in run("set", "position_gain_per_s=17.5", "--node", "2", "--yes").stdout
    row = json.loads(run("get", "0x2100:1", "--node", "2", "--json").stdout)[0]
    assert (row["name"], row["value"], row["unit"]) == ("position_gain_per_s", 17.5, "1/s")
    assert json.loads(run("get", "2100sub1", "--node", "2", "--json").stdout) == [row]
    word = json.loads(run("get", "status_word", "--node", "2", "--json").stdout)[0]
    assert (word["object"], word["value"] & 0x4F) == ("0x6041:0", 0x40)  # switch on disabled
    run("set", "2100:1=0", "--node", "2", "--yes")
    result = run("get", "gain", "--node", "2", code=2)
    assert "2100:1 (position_gain_per_s), 2101:1" in result.stderr
    assert "did you mean notch_1.mode" in run("get", "notch_1.mod1", "--node", "2", code=2).stderr
    beyond = f"position_gain_per_s={10**400}"
    for wrong in (
        "position_gain_per_s",
        "position_gain_per_s=",
        "position_gain_per_s=fast",
        "=3",
        "position_gain_per_s=nan",
        beyond,
    ):
        run("set", wrong, "--node", "2", "--yes", code=2)
    refused = run("set", "position_gain_per_s=1e9", "--node", "2", "--yes", code=3)
    assert "outside 0 to 10000" in refused.stderr
    run("set", "0x6040=15", "--node", "2", "--yes", code=3)
    run("set", "0x1018:1=15", "--node", "2", "--yes", code=3)


def test_get_prints_what_it_got_even_where_one_object_fails():
    result = run("get", "0x5FFF", "position_gain_per_s", "0x5FFE", "status_word", "--node", "2", code=6)
    assert [line.split()[0] for line in result.stdout.splitlines()[1:]] == ["2100:1", "6041:0"]
    assert "5FFFh:0 aborted: 0x06020000" in result.stderr
    assert "5FFEh:0 aborted: 0x06020000" in result.stderr
    rows = json.loads(run("get", "position_gain_per_s", "0x5FFF", "--node", "2", "--json", code=6).stdout)
    assert "value" in rows[0]
    assert "aborted" in rows[1]["error"]


def test_a_long_table_does_not_push_the_reason_out_of_sight(folder):
    run("pull", "--node", "5", "--out", "a.toml")
    pulled, known = ParameterSet.load(folder / "a.toml"), Profile.load("maxon_epos4").parameters
    table = {
        key: item.model_copy(update={"value": item.value + 1})
        for key, item in pulled.tuning.items()
        if key in known and isinstance(item.value, int) and (known[key].maximum is None or item.value + 1 <= known[key].maximum)
    }
    ParameterSet(header=pulled.header, tuning=table).save(folder / "b.toml")
    whole = run("upload", "b.toml", "--node", "5", "--dry-run", "--allow-unverified").stdout.splitlines()
    assert len(whole) == 1 + len(table)
    assert len(table) > MAX_ROWS + 1
    asked = run("upload", "b.toml", "--node", "5", "--allow-unverified", code=2)
    assert asked.stdout.splitlines()[-1] == f"… and {len(table) - MAX_ROWS} more; --dry-run shows all"
    assert len(asked.stdout.splitlines()) == MAX_ROWS + 2
    assert "give --yes" in asked.stderr.splitlines()[-1]


def test_an_abort_is_told_in_words_with_the_objects_name():
    result = run("get", "0x5FFF", "--node", "2", code=6)
    assert "5FFFh:0 aborted: 0x06020000, Object does not exist" in result.stderr


def reset(node):
    """As a loss of power would."""
    with SdoBus(os.environ["HIL_BUS"]) as bus:
        device_at(bus, node).reset(10.0)


def held(name, node=2):
    return json.loads(run("get", name, "--node", node, "--json").stdout)[0]["value"]


@pytest.mark.slow
def test_store_and_factory_defaults():
    factory = held("position_gain_per_s")
    run("set", "position_gain_per_s=9", "--node", "2", "--yes")
    reset(2)
    assert held("position_gain_per_s") == factory
    run("set", "position_gain_per_s=9", "--node", "2", "--yes")
    assert "has stored" in run("store", "--node", "2", "--yes").stdout
    run("set", "position_gain_per_s=11", "--node", "2", "--yes")
    reset(2)
    assert held("position_gain_per_s") == 9
    assert "1011:1" in run("restore", "--defaults", "--node", "2", "--dry-run").stdout
    assert "factory" in run("restore", "--defaults", "--node", "2", "--yes").stdout
    assert held("position_gain_per_s") == 9
    reset(2)
    assert held("position_gain_per_s") == factory
    run("restore", "--node", "2", code=2)
    run("restore", "--defaults", "--snapshot", "x", "--node", "2", code=2)
    run("restore", "--defaults", "--store", "--node", "2", code=2)
    run("restore", "--snapshot", "nowhere.jsonl", code=3)


def aborting(place, code):
    """A port whose writes of one object are answered so; 0: not at all."""
    write = SdoPort.write

    def instead(self, where, data, *more, **named):
        if where != place:
            write(self, where, data, *more, **named)
        elif code:
            raise SdoAbortedError(self.node, *where, code, abort_text(code))
        else:
            raise NoAnswerError(self.node, "the write", 1.0)

    return instead


@pytest.mark.slow
@pytest.mark.parametrize(("code", "status", "words"), [
    (0x0800_0022, 6, "present device state"), (0x0606_0000, 8, "unknown"), (0, 8, "store again"),
])  # fmt: skip
def test_a_store_is_judged_as_that_of_an_upload(code, status, words, monkeypatch):
    write = SdoPort.write
    monkeypatch.setattr(SdoPort, "write", aborting((0x1010, 1), code))
    assert words in run("store", "--node", "2", "--yes", code=status).stderr
    assert ("unknown" in run("store", "--node", "2", "--yes", "--json", code=status).stdout) == (status == 8)
    before = held("position_gain_per_s")
    result = run("set", "position_gain_per_s=21", "--store", "--node", "2", "--yes", code=status)
    assert ("drive-profiles store --bus" in result.stderr) == (code == 0)
    assert ("drive-profiles restore --snapshot" in result.stderr) == (code == 0x0606_0000)
    assert held("position_gain_per_s") == (21 if code == 0 else before)
    monkeypatch.setattr(SdoPort, "write", aborting((0x1011, 1), code))
    assert ("after the next reset are unknown" in run("restore", "--defaults", "--node", "2", "--yes", code=status).stderr) == (
        status == 8
    )
    monkeypatch.setattr(SdoPort, "write", write)
    run("set", f"position_gain_per_s={before}", "--node", "2", "--yes")


def test_set_takes_whole_names_and_one_value_each():
    before = held("position_gain_per_s")
    assert "did you mean position_gain_per_s" in run("set", "position_gain=17.5", "--node", "2", "--yes", code=2).stderr
    twice = run("set", "position_gain_per_s=5", "2100:1=6", "--node", "2", "--yes", code=2)
    assert "two values for 2100:1 (position_gain_per_s)" in twice.stderr
    assert held("position_gain_per_s") == before


def test_what_will_change_is_shown_before_the_question_also_with_json():
    result = run("set", "position_gain_per_s=5.5", "--node", "2", "--json", code=2)  # nobody to ask
    assert ["2", "2100:1", "(position_gain_per_s)"] in [row[:3] for row in cells(result.stderr)]
    assert result.stdout == ""
    result = run("set", "position_gain_per_s=5.5", "--node", "2", "--json", "--dry-run")
    assert json.loads(result.stdout)[0]["new"] == 5.5


def test_a_snapshot_goes_to_another_device_only_if_that_is_forced(folder):
    run("set", "position_gain_per_s=5.5", "--node", "2", "--yes")
    [path] = (folder / "drive-journals").glob("*.jsonl")
    serial = json.loads(run("info", "--node", "2", "--json").stdout)["serial_number"]
    original = path.read_text()
    path.write_text(original.replace(f'"serial_number":{serial}', '"serial_number":99999'))
    assert "--force-commissioning" in run("restore", "--snapshot", path, "--yes", code=3).stderr
    run("restore", "--snapshot", path, "--dry-run", "--force-commissioning")
    path.write_text(original.replace(f'"serial_number":{serial}', '"serial_number":0'))
    assert "had no serial number" in run("restore", "--snapshot", path, "--yes").stderr
    assert held("position_gain_per_s") != 5.5


@pytest.mark.ci
def test_the_newest_journal_of_a_folder_is_the_snapshot(folder):
    before = held("position_gain_per_s")
    first = run("set", "position_gain_per_s=5.5", "--node", "2", "--yes")
    assert f"its previous values are in {folder}/drive-journals/node2-" in first.stderr, "whole, for another day elsewhere"
    run("set", "position_gain_per_s=6.5", "--node", "2", "--yes")
    run("restore", "--snapshot", "drive-journals", "--node", "3", code=3)
    run("restore", "--snapshot", "drive-journals", "--node", "2", "--yes")
    assert held("position_gain_per_s") == 5.5
    run("set", f"position_gain_per_s={before}", "--node", "2", "--yes")


def test_what_is_no_parameter_set_or_no_file_is_refused(folder):
    (folder / "empty.toml").write_text("[header]\n")
    assert "holds no values" in run("upload", "empty.toml", "--node", "2", "--yes", code=3).stderr
    (folder / "gain.toml").write_text('[tuning]\nposition_gain_per_s = { value = 9.5, unit = "1/s" }\n')
    refused = run("upload", "gain.toml", "--node", "2", "--yes", "--classes", "limits", code=3).stderr
    assert "holds no values of limits (--classes)" in refused
    (folder / "nan.toml").write_text('[tuning]\nposition_gain_per_s = { value = nan, unit = "1/s" }\n')
    refused = run("upload", "nan.toml", "--node", "2", "--yes", code=3).stderr.splitlines()
    assert [line for line in refused if "nan.toml" in line] == [
        "nan.toml:2: tuning.position_gain_per_s.value: found nan; expected a finite number in 1/s"
    ]
    os.mkfifo(folder / "pipe")
    assert "is not a regular file" in run("pull", "--node", "2", "--out", "pipe", "--force", code=3).stderr
    assert "[header]" in run("pull", "--node", "2", "--out", "-").stdout
    assert not (folder / "-").exists()


@pytest.mark.slow
def test_a_set_of_another_device_is_refused_whatever_is_answered(folder):
    run("pull", "--node", "2", "--out", "pulled.toml")
    text = (folder / "pulled.toml").read_text()
    other = text.replace("serial_number = ", "serial_number = 9999").replace("= { value = 12.5, unit", "= { value = 13.5, unit")
    (folder / "other.toml").write_text(other)
    chosen = ("--node", "2", "--classes", "tuning,limits")
    for answer in ("--dry-run", "--yes"):
        refused = run("upload", "other.toml", *chosen, answer, code=3).stderr
        assert "the set is for another device (serial number 99992; node 2 has 2)" in refused
        assert "it contains limits: 6065:0" in refused
        assert "give --other-device to write it nevertheless" in refused
    assert "9999" in run("upload", "other.toml", *chosen, "--dry-run", "--other-device").stderr
    assert "--yes, or answer" in run("upload", "other.toml", *chosen, "--other-device", "--store", code=2).stderr
    (folder / "moved.toml").write_text(other.replace("[limits]", "[commissioning]"))
    assert "--force-commissioning" in run("upload", "moved.toml", "--node", "2", "--other-device", "--dry-run", code=3).stderr
    run("upload", "other.toml", "--node", "2", "--force-commissioning", "--dry-run")
    # of a device without a serial number the node-ID speaks, and a set written by hand has neither
    bare = "".join(line + "\n" for line in text.splitlines() if not line.startswith("serial_number"))
    (folder / "bare.toml").write_text(bare)
    run("upload", "bare.toml", *chosen, "--dry-run")
    (folder / "bare.toml").write_text(bare.replace("node_id = 2", "node_id = 5"))
    assert "of node 5, without a serial number" in run("upload", "bare.toml", *chosen, "--dry-run", code=3).stderr
    (folder / "hand.toml").write_text('[tuning]\n"position_gain_per_s" = { value = 9.5, unit = "1/s" }\n')
    run("upload", "hand.toml", "--node", "2", "--dry-run")


def test_an_interrupt_while_the_drive_stores_is_remembered_until_it_has_answered(monkeypatch, capfd):
    write = SdoPort.write

    def interrupted(self, place, *more, **named):
        if place in {(0x1010, 1), (0x1011, 1)}:
            os.kill(os.getpid(), signal.SIGINT)
            os.kill(os.getpid(), signal.SIGTERM)
        write(self, place, *more, **named)

    monkeypatch.setattr(SdoPort, "write", interrupted)
    for command, said in ((["store"], "has stored"), (["restore", "--defaults"], "after its next reset")):
        result = run(*command, "--node", "2", "--yes")
        assert said in result.stdout
        assert "too late" in capfd.readouterr().err  # of the signal's handler, which writes past the interpreter's streams
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_while_the_bus_is_closed_hides_no_outcome(monkeypatch):
    close, opened = SdoBus.close, []

    def interrupted(self):
        close(self)
        opened.append(self)
        if len(opened) == 2:  # the first is that of looking up the names
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(SdoBus, "close", interrupted)
    result = run("set", "position_gain_per_s=6.5", "--node", "2", "--yes")
    assert "done" in result.stdout


def test_an_interrupt_before_anything_is_written_says_only_that(monkeypatch):
    monkeypatch.setattr(Device, "identify", lambda self: os.kill(os.getpid(), signal.SIGINT))
    result = run("set", "position_gain_per_s=6.5", "--node", "2", "--yes", code=130)
    assert result.stderr.splitlines()[-1] == "interrupted before anything was written"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["pull", "--node", "77", "--timeout-s", "0.05"], 5, "node 77: no answer"),
        (["pull", "--node", "2", "--bus", "local:/nowhere/x.sock"], 4, "no bus at local:/nowhere/x.sock"),
        (["pull", "--node", "2", "--bus", "nonsense"], 2, "not a bus address"),
        (["pull", "--node", "2", "--bus", "sockettin:can0"], 2, "did you mean socketcan"),
        (["pull", "--node", "2", "--profile", "nobody"], 2, "no drive profile 'nobody'"),
        (["pull", "--node", "2", "--eds", "missing.eds"], 3, "missing.eds"),
        (["pull", "--node", "2", "--classes", "tuned"], 2, "--classes tuned"),
        (["pull", "--node", "0"], 2, "--node"),
        (["upload", "missing.toml", "--node", "2"], 3, "missing.toml"),
        (["upload", "missing.toml", "--node", "2", "--node", "2"], 2, "a drive is given twice"),
        (["upload", "missing.toml", "--node", "2", "--reset"], 2, "--reset without --store"),
        (["diff", "missing.toml"], 3, "missing.toml"),
    ],
)
def test_a_mistake_ends_with_its_code_and_says_what_to_do(arguments, code, words):
    assert words in run(*arguments, code=code).stderr


def test_a_file_that_is_there_is_not_replaced_in_silence(folder):
    (folder / "axis2.toml").write_text("mine")
    assert "--force" in run("pull", "--node", "2", "--out", "axis2.toml", code=3).stderr
    assert (folder / "axis2.toml").read_text() == "mine"
    run("pull", "--node", "2", "--out", "axis2.toml", "--force")


HELD = """
import pathlib, time
from drive_profiles.__main__ import main
from drive_profiles.device import sdo
write, written = sdo.SdoPort.write, []
def held(*arguments, **named):
    end = time.monotonic() + 60.0
    while written and not pathlib.Path("signalled").exists() and time.monotonic() < end:
        time.sleep(0.001)
    write(*arguments, **named)
    written.append(True)
sdo.SdoPort.write = held
main()
"""
"""The tool, which stands still before its second write until it has been signalled."""


@pytest.mark.ci
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_ctrl_c_in_the_middle_puts_everything_back(number, folder):
    before = {name: held(name) for name in ("notch_1.mode", "notch_1.start_rps", "position_gain_per_s", "velocity_gain_nm_s_rad")}
    values = [f"{name}={value + 1}" for name, value in before.items()]
    command = [sys.executable, "-c", HELD, "set", *values, "--node", "2", "--yes", "--store"]
    with subprocess.Popen(
        command, cwd=folder, env=os.environ, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        deadline = time.monotonic() + 60.0
        while not any('"written"' in path.read_text() for path in folder.glob("drive-journals/*.jsonl")):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.001)
        process.send_signal(number)
        process.send_signal(number)  # impatience changes nothing
        (folder / "signalled").touch()
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130, (out, err)
    assert "rolled back, every object holds its old value" in err
    assert {name: held(name) for name in before} == before
    [path] = folder.glob("drive-journals/*.jsonl")
    assert journal.read(path).outcome == "rolled back"


def test_help_of_every_command_is_there_and_says_an_example():
    for command in ("scan", "info", "pull", "diff", "upload", "verify", "store", "restore", "get", "set", "list", "show"):
        text = run(command, "--help").stdout
        assert "Example" in text
        assert "drive-profiles" in text


def test_words_of_bits_are_hexadecimal_and_gains_have_the_drives_unit():
    shown = cells(run("get", "status_word", "1014", "1A00:1", "position_proportional_gain", "1018:4", "--node", "5").stdout)
    assert re.fullmatch("0x[0-9A-F]{4}", shown[1][2])
    assert shown[2][2] == "0x00000085"
    assert shown[3][2] == "0x60410010"  # no profile and no EDS says its type
    assert shown[4][3] == "µA/rad"
    assert shown[5][2] == "5"
    exact = json.loads(run("get", "status_word", "speed_limit_rad_s", "--node", "5", "--json").stdout)
    assert isinstance(exact[0]["value"], int)
    assert len(str(exact[1]["value"])) > len("1234.5")  # all digits for machines


@pytest.mark.ci
def test_restore_shows_units_as_upload_does(folder):
    shown = run("set", "speed_limit_rad_s=20", "--node", "5", "--yes", "--journals", "units")
    change = next(row for row in cells(shown.stdout) if row[1] == "6080:0")
    back = run("restore", "--snapshot", "units", "--node", "5", "--dry-run")
    assert ["5", "6080:0", "(speed_limit_rad_s)", change[4], change[3], "rad/s"] in cells(back.stdout)
    run("restore", "--snapshot", "units", "--node", "5", "--yes", "--journals", "units")
