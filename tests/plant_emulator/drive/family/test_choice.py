"""Which drive moves which axis: in the robot file, on the command line, and what an EDS file adds."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

import drive_profiles
from drive_profiles.errors import DriveProfileError
from drive_profiles.files.toml import FileError
from drive_profiles.standard.cia301 import SdoAbortCode
from plant_emulator.cli.main import app
from plant_emulator.robots.robot import REFERENCE, load_robot, with_drives
from plant_emulator.world import World
from tests.plant_emulator.rig import Rig

VENDORS = Path(drive_profiles.__file__).parent / "vendors"
OUR_EDS = VENDORS / "emulated_drive.eds"
ROBOT = load_robot("reference")


def serve(tmp_path, *arguments):
    """Serve until the line of the last node is there; the lines, or the status and what was said."""
    process = subprocess.Popen(
        [sys.executable, "-m", "plant_emulator", "serve", "--bus", f"local:{tmp_path / 'bus.sock'}", *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | {"COLUMNS": "200"},
    )  # fmt: skip
    lines = []
    for line in process.stdout:
        lines.append(line.rstrip())
        if line.startswith("node 5"):
            process.send_signal(signal.SIGTERM)
            break
    process.wait(30)
    said = process.stderr.read()
    process.stdout.close()
    process.stderr.close()
    return process.returncode, lines, said


@pytest.mark.ci
def test_serving_says_which_node_is_which_profile(tmp_path):
    status, lines, said = serve(tmp_path, "--drive", "2=kollmorgen_akd", "--drive", f"3={VENDORS / 'elmo_gold.toml'}")
    assert (status, said) == (0, "")
    assert lines[0].startswith("serving reference on local:")
    nodes = [line for line in lines if line.startswith("node")]
    assert nodes == ["node 2: kollmorgen_akd", "node 3: elmo_gold", "node 5: emulated_drive"]
    assert any("torque constant of 1 N·m/A" in line for line in lines)


def test_serving_takes_a_product_of_a_family(tmp_path):
    status, lines, said = serve(tmp_path, "--drive", "2=maxon_epos4/70-15", "--drive", "3=trinamic_tmcm16xx/TMCM-1670")
    assert (status, said) == (0, "")
    nodes = [line for line in lines if line.startswith("node")]
    assert nodes == ["node 2: maxon_epos4/70-15", "node 3: trinamic_tmcm16xx/tmcm-1670", "node 5: emulated_drive"]


@pytest.mark.parametrize(
    ("arguments", "status", "word"),
    [
        (("--drive", "2"), 2, "AXIS=VALUE"),
        (("--drive", "x=elmo_gold"), 2, "AXIS=VALUE"),
        (("--drive", "2="), 2, "expected AXIS=VALUE, such as 2=VALUE"),
        (("--drive", "3:elmo_gold"), 2, "expected AXIS=VALUE, such as 3=elmo_gold"),
        (("--drive", "2=elmo_gold", "--drive", "2=elmo_gold"), 2, "given twice"),
        (("--drive", "4=elmo_gold"), 2, "no axis 4; it has 2, 3, 5"),
        (("--drive", "2=unheard_of"), 3, "unheard_of"),
        (("--drive", "2=maxon_epos4/70-16"), 3, "has no product '70-16'; it has 0x61500000 (module-50-5)"),
        (("--drive", "2=emulated_accelerometer"), 3, "expected a drive profile"),
        (("--drive", "2=./nowhere.toml"), 3, "nowhere.toml"),
        (("--eds", "2=nowhere.eds"), 3, "nowhere.eds"),
        (("--store-time-s", "-1"), 2, "store-time-s"),
    ],
)
def test_serving_says_what_it_cannot_be(tmp_path, arguments, status, word):
    bus = ["serve", "--bus", f"local:{tmp_path / 'bus.sock'}"]
    done = CliRunner().invoke(app, [*bus, *arguments], env={"COLUMNS": "200"})
    assert (done.exit_code, done.stdout) == (status, "")
    assert isinstance(done.exception, SystemExit), "no traceback"
    assert word in done.stderr


def test_the_robot_file_names_drives_and_files_by_its_own_folder(tmp_path):
    own = (VENDORS / "elmo_gold.toml").read_text()
    (tmp_path / "mine.toml").write_text(own)
    (tmp_path / "mine.eds").write_bytes(OUR_EDS.read_bytes())
    text = REFERENCE.read_text().replace(
        "node_id = 2\n",
        'node_id = 2\nprofile = "./mine.toml"\neds = "mine.eds"\nstore_time_s = 0.1\ntorque_constant_nm_a = 0.3\n',
    )
    (tmp_path / "robot.toml").write_text(text.replace("node_id = 3\n", 'node_id = 3\nprofile = "maxon_epos4/70-15"\n'))
    robot = load_robot(tmp_path / "robot.toml")
    world = World(robot)
    assert {n: drive.family.profile for n, drive in world.drives.items()} == {
        2: "elmo_gold", 3: "maxon_epos4/70-15", 5: "emulated_drive",
    }  # fmt: skip
    assert world.drives[2].slave.store.time_ns == 100_000_000
    assert (0x2110, 3) in world.drives[2].slave.dictionary


def test_storing_takes_no_longer_than_the_profile_says_that_the_drive_takes():
    robot = with_drives(ROBOT, {2: "elmo_gold"}, store_time_s=1000.0)
    limit = World(robot).drives[2].family.store_limit_s
    assert World(robot).drives[2].slave.store.time_ns == round(1e9 * limit) < 1000 * 10**9


def test_an_eds_file_adds_objects_that_hold_what_is_written_and_do_nothing():
    rig = Rig(with_drives(ROBOT, {2: "elmo_gold"}, eds={2: str(OUR_EDS)}), axis=2)
    assert rig.read(0x2110, 2) == 2  # a default of the file; it states none of real numbers
    assert rig.write(0x2110, 3, 3.0) is None
    assert rig.read(0x2110, 3) == 3.0
    assert rig.write(0x2110, 2, 9) is SdoAbortCode.VALUE_TOO_HIGH
    assert rig.write_raw(0x2112, 1, b"\0") is SdoAbortCode.READ_ONLY
    assert not rig.world.axes.notch_config[rig.drive.row]["mode"].any()
    assert rig.save() is None
    rig.power_cycle()
    assert rig.read(0x2110, 3) == 3.0


def test_an_eds_file_changes_nothing_that_the_drive_has_already():
    plain = Rig(with_drives(ROBOT, {2: "elmo_gold"}), axis=2).drive.slave.dictionary
    more = Rig(with_drives(ROBOT, {2: "elmo_gold"}, eds={2: str(OUR_EDS)}), axis=2).drive.slave.dictionary
    assert len(more) > len(plain)
    for entry in plain:
        if entry.subindex:  # sub-index 0 counts what is there
            assert more.cell(entry.index, entry.subindex).entry == entry


def test_our_own_drive_with_its_own_eds_file_is_itself():
    dictionary = Rig(with_drives(ROBOT, eds={3: str(OUR_EDS)})).drive.slave.dictionary
    assert [str(entry) for entry in dictionary] == [str(entry) for entry in Rig().drive.slave.dictionary]


@pytest.mark.parametrize(
    ("robot", "word"), [({"profiles": {9: "elmo_gold"}}, "axis 9"), ({"eds": {1: "x"}}, "axis 1"), ({"store_time_s": -1.0}, "-1")]
)
def test_an_axis_that_is_not_there_and_a_time_that_is_none_are_the_callers_mistake(robot, word):
    with pytest.raises(ValueError, match=word):
        with_drives(ROBOT, **robot)


def test_a_profile_or_file_that_is_not_there_is_told_by_its_name(tmp_path):
    with pytest.raises(DriveProfileError, match="unheard_of"):
        World(with_drives(ROBOT, {2: "unheard_of"}))
    with pytest.raises(FileError, match="nowhere"):
        World(with_drives(ROBOT, eds={2: str(tmp_path / "nowhere.eds")}))
