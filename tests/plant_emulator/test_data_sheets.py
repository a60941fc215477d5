"""The committed EDS files against what is generated, and against the nodes themselves: entry by entry, over SDO."""

import struct
import subprocess
import sys
from configparser import RawConfigParser
from pathlib import Path

import canopen
import pytest
from canopen.objectdictionary import ODVariable
from typer.testing import CliRunner

import drive_profiles
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType, SdoAbortCode, decode, encode
from drive_profiles.standard.cia402 import Mode, Object, State
from hil.can.frame import Frame
from plant_emulator.cli.main import app
from plant_emulator.data_sheets import data_sheets
from plant_emulator.drive.dictionary.manufacturer_objects import drive_entries
from plant_emulator.robots.robot import load_robot, with_drives
from plant_emulator.sensor.accelerometer import AccelerometerNode, accelerometer_entries
from plant_emulator.slave.dictionary import Access, Dictionary
from plant_emulator.slave.node import Slave
from plant_emulator.world import World
from tests.plant_emulator.rig import Rig, Stranger

pytestmark = pytest.mark.ci

VENDORS = Path(drive_profiles.__file__).parent / "vendors"
DRIVE, ACCELEROMETER = "emulated_drive.eds", "emulated_accelerometer.eds"
NAMES = (DRIVE, ACCELEROMETER)
NODE = 9
OF_THE_MOTOR = {
    *((0x1018, 4), (Object.MAX_TORQUE, 0), (Object.MOTOR_RATED_TORQUE, 0), (Object.MOTOR_RATED_CURRENT, 0)),
    *((Object.ENCODER_RESOLUTION, 1),),
    *((0x2100, 1), (0x2101, 1), (0x2101, 2), (0x2101, 3)),
}
"""What a drive in a robot holds of its own: serial number, motor and gains."""


def imported(name, node_id=NODE):
    return canopen.import_od(str(VENDORS / name), node_id=node_id)


def variables(od):
    """Every entry that the stranger reads from a file, dummies left out."""
    for index, thing in od.items():
        if index > 0x1F:
            yield from [thing] if isinstance(thing, ODVariable) else thing.values()


def reals_in(path):
    """Defaults of the real numbers by (index, sub): no tool reads them, so they stand in the comments only."""
    parser = RawConfigParser()
    parser.read(path)
    found = {}
    for line in list(parser["Comments"].values())[2:]:
        place, _, words = line.partition(" ")
        index, _, sub = place.partition("sub")
        assert "DefaultValue" not in parser[place]
        found[int(index, 16), int(sub or "0", 16)] = float(words.rpartition(": ")[2].split(",")[0])
    return found


def default_bytes(variable, reals):
    """The default as the node holds it."""
    kind = DataType(variable.data_type)
    assert (variable.default is None) == kind.is_real
    return encode(kind, reals[variable.index, variable.subindex] if kind.is_real else variable.default)


class Bare:
    """A node made of the factory's entries, and raw SDO to it."""

    def __init__(self, entries):
        self.dictionary = Dictionary(entries)
        self.slave = Slave(NODE, self.dictionary)
        self.slave.power_on(0)

    def request(self, *data):
        (answer,) = self.slave.receive(Frame(0x600 + NODE, bytes(data).ljust(8, b"\0")), 0)
        return answer.data

    def read(self, index, sub):
        """The bytes, segments joined, or the abort code."""
        answer = self.request(0x40, *struct.pack("<HB", index, sub))
        if answer[0] == 0x80:
            return SdoAbortCode(int.from_bytes(answer[4:], "little"))
        if answer[0] & 2:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        data, toggle = b"", 0
        while True:
            answer = self.request(0x60 | toggle)
            data += answer[1 : 8 - (answer[0] >> 1 & 7)]
            toggle ^= 0x10
            if answer[0] & 1:
                return data

    def write(self, index, sub, data):
        answer = self.request(0x23 | (4 - len(data)) << 2, *struct.pack("<HB", index, sub), *data)
        return SdoAbortCode(int.from_bytes(answer[4:], "little")) if answer[0] == 0x80 else None


def entries_of(name):
    return drive_entries(serial_number=0) if name == DRIVE else accelerometer_entries(serial_number=0)


@pytest.fixture(params=NAMES)
def name(request):
    return request.param


# -- the files ---------------------------------------------------------------------------------------------------------


def test_the_committed_file_is_what_is_generated(name):
    assert (VENDORS / name).read_bytes() == data_sheets()[name].encode("ascii")


def test_the_command_writes_both_files(tmp_path):
    out = tmp_path / "new" / "folder"
    done = subprocess.run(
        [sys.executable, "-m", "plant_emulator", "eds", "--out", str(out)], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [str(out / each) for each in NAMES]
    for each in NAMES:
        assert (out / each).read_bytes() == (VENDORS / each).read_bytes()


def test_the_command_says_what_it_cannot_write(tmp_path):
    (tmp_path / "taken").write_text("a file")
    done = subprocess.run(
        [sys.executable, "-m", "plant_emulator", "eds", "--out", str(tmp_path / "taken")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 3
    assert str(tmp_path / "taken") in done.stderr
    assert "Traceback" not in done.stderr


def test_the_command_writes_the_file_of_every_node_of_a_robot_and_each_is_that_of_its_node(tmp_path):
    done = CliRunner().invoke(
        app, ["eds", "--robot", "reference", "--drive", "3=kollmorgen_akd", "--out", str(tmp_path / "sheets")]
    )
    assert done.exit_code == 0, done.output
    names = ["axis2.eds", "axis3.eds", "axis5.eds", "accelerometer.eds"]
    assert done.stdout.split() == [str(tmp_path / "sheets" / each) for each in names]
    world = World(with_drives(load_robot("reference"), {3: "kollmorgen_akd"}))
    nodes = [*world.drives.values(), world.accelerometer]
    for each, node in zip(names, nodes, strict=True):
        dictionary = node.slave.dictionary
        od = canopen.import_od(str(tmp_path / "sheets" / each), node_id=node.node_id)
        listed = {(variable.index, variable.subindex): variable for variable in variables(od)}
        assert set(listed) == {(entry.index, entry.subindex) for entry in dictionary}
        reals = reals_in(tmp_path / "sheets" / each)
        assert od.device_information.vendor_number == dictionary.get(0x1018, 1)
        for place, variable in listed.items():
            entry = dictionary.cell(*place).entry
            assert (variable.data_type, variable.access_type) == (entry.data_type, entry.access.value), entry
            if entry.data_type.size is not None:
                assert default_bytes(variable, reals) == encode(entry.data_type, entry.default_for(node.node_id)), entry


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (("--drive", "3=kollmorgen_akd"), 2, "--drive needs --robot"),
        (("--robot", "reference", "--drive", "4=kollmorgen_akd"), 2, "no axis 4"),
        (("--robot", "reference", "--drive", "3=unheard_of"), 3, "unheard_of"),
        (("--robot", "reference", "--drive", "3=emulated_accelerometer"), 3, "expected a drive profile"),
        (("--robot", "nowhere.toml"), 3, "nowhere.toml"),
    ],
)
def test_the_command_says_which_robot_has_no_files(tmp_path, arguments, status, words):
    done = CliRunner().invoke(app, ["eds", "--out", str(tmp_path / "sheets"), *arguments])
    assert done.exit_code == status
    assert words in done.output
    assert not (tmp_path / "sheets").exists()


def test_the_profile_and_the_data_sheet_agree_on_who_it_is_and_what_it_holds(name):
    profile, od = Profile.load(name.removesuffix(".eds")), imported(name)
    assert od[0x1000].default == profile.identity.device_type
    identity = profile.identity
    assert [od[0x1018][sub].default for sub in (1, 2, 3)] == [identity.vendor_id, identity.product_code, identity.revision]
    assert od.device_information.product_number == identity.product_code
    for parameter in profile.parameters.values():
        variable = od.get_variable(parameter.index, parameter.subindex)
        assert variable.data_type == DataType[parameter.data_type]
        assert variable.writable == (parameter.access == "rw")


def test_the_profile_states_the_defaults_of_the_real_numbers_that_the_file_cannot():
    profile, node = Profile.load("emulated_drive"), Bare(entries_of(DRIVE))
    reals = {p.address: p for p in profile.parameters.values() if p.type.is_real}
    assert len(reals) > 20
    for place, parameter in reals.items():
        assert parameter.default_bytes() == node.read(*place), parameter.written_address


# -- the files against the nodes ---------------------------------------------------------------------------------------


def test_every_entry_of_the_file_is_in_the_node_with_its_type_length_access_and_default(name):
    node, od, checked = Bare(entries_of(name)), imported(name), 0
    reals = reals_in(VENDORS / name)
    for variable in variables(od):
        place = variable.index, variable.subindex
        entry = node.dictionary.cell(*place).entry
        assert (variable.data_type, variable.access_type) == (entry.data_type, entry.access.value), entry
        held = node.read(*place)
        checked += 1
        if variable.index == 0x1003 and variable.subindex:
            assert held is SdoAbortCode.NO_DATA  # an empty history has no entries (CiA 301, 7.5.2.4)
            continue
        assert isinstance(held, bytes), f"{entry}: {held}"
        kind = DataType(variable.data_type)
        if kind is DataType.VISIBLE_STRING:
            assert held.decode() == variable.default
        else:
            assert len(held) == kind.size
            assert held == default_bytes(variable, reals), entry
    assert checked == len(node.dictionary)


def test_the_node_has_nothing_that_the_file_does_not_list(name):
    node, od = Bare(entries_of(name)), imported(name)
    listed = {(variable.index, variable.subindex) for variable in variables(od)}
    indices = {index for index, _ in listed}
    for index in sorted({near for i in indices for near in (i - 1, i, i + 1)} | {0x1010, 0x1011, 0x1200, 0x2000, 0x60FF, 0xFFFF}):
        subs = {sub for i, sub in listed if i == index}
        for sub in {0, 1, *(s + 1 for s in subs), 0xFE}:
            if (index, sub) not in listed:
                absent = SdoAbortCode.NO_SUBINDEX if subs else SdoAbortCode.NO_OBJECT
                assert node.read(index, sub) is absent, f"{index:04X}h:{sub:02X}h"
                assert node.write(index, sub, b"\0") is absent, f"{index:04X}h:{sub:02X}h"


def test_what_the_file_calls_read_only_cannot_be_written(name):
    node, refused = Bare(entries_of(name)), 0
    for variable in variables(imported(name)):
        if variable.access_type in {"ro", "const"}:
            assert node.write(variable.index, variable.subindex, b"\0") is SdoAbortCode.READ_ONLY, variable.qualname
            refused += 1
    assert refused > 10


def test_a_value_of_the_wrong_length_is_refused(name):
    node = Bare(entries_of(name))
    for variable in variables(imported(name)):
        if variable.writable:
            size = DataType(variable.data_type).size
            place = variable.index, variable.subindex
            if size is None:
                continue  # a text is as long as it is
            if size > 1:
                assert node.write(*place, bytes(size - 1)) is SdoAbortCode.TOO_SHORT, variable.qualname
            if size < 4:
                assert node.write(*place, bytes(size + 1)) is SdoAbortCode.TOO_LONG, variable.qualname


def limits_in(name):
    """(index, sub, type, key, value) of every limit that the file states; of real numbers in its comments."""
    parser = RawConfigParser()
    parser.read(VENDORS / name)
    for section in parser.sections():
        for key in ("LowLimit", "HighLimit"):
            if key in parser[section]:
                index, _, sub = section.partition("sub")
                kind = DataType(int(parser[section]["DataType"], 16))
                limit = int(parser[section][key], 0)
                if kind.is_real:
                    assert limit == 0, section  # any other spelling is misread by somebody
                else:
                    yield int(index, 16), int(sub or "0", 16), kind, key, limit
    for line in list(parser["Comments"].values())[2:]:
        place, _, words = line.partition(" ")
        index, _, sub = place.partition("sub")
        kind = DataType(int(parser[place]["DataType"], 16))
        for part in words.rpartition(": ")[2].split(", ")[1:]:
            key = {"at least": "LowLimit", "at most": "HighLimit"}[part.rpartition(" ")[0]]
            yield int(index, 16), int(sub or "0", 16), kind, key, float(part.rpartition(" ")[2])


def test_each_limit_of_the_file_is_that_of_the_node_and_is_held():
    node, checked = Bare(entries_of(DRIVE)), 0
    stated = set()
    for index, sub, kind, key, limit in limits_in(DRIVE):
        entry = node.dictionary.cell(index, sub).entry
        low = key == "LowLimit"
        stated.add((index, sub, low))
        held = decode(kind, encode(kind, limit))
        assert held == (entry.low if low else entry.high)
        assert node.write(index, sub, encode(kind, limit)) is None
        beyond = limit + (-1 if low else 1) * (1e-3 * abs(limit) + 1e-3 if kind.is_real else 1)
        try:
            data = encode(kind, beyond)
        except ValueError:
            continue  # the type itself ends there
        assert node.write(index, sub, data) is (SdoAbortCode.VALUE_TOO_LOW if low else SdoAbortCode.VALUE_TOO_HIGH)
        checked += 1
    assert checked > 40
    for entry in node.dictionary:
        for low, limit in ((True, entry.low), (False, entry.high)):
            assert ((entry.index, entry.subindex, low) in stated) == (limit is not None), entry


def test_what_the_file_calls_mappable_can_be_mapped_and_nothing_else(name):
    node = Bare(entries_of(name))
    for record, mapping, directions in (
        (0x1400, 0x1600, {"rw", "rww", "wo"}),
        (0x1800, 0x1A00, {"ro", "const", "rw", "rwr"}),
    ):
        cob_id = int.from_bytes(node.read(record, 1), "little")
        assert node.write(record, 1, struct.pack("<I", cob_id | 1 << 31)) is None
        assert node.write(mapping, 0, b"\0") is None
        mapped = 0
        for variable in variables(imported(name)):
            size = DataType(variable.data_type).size
            if size is None:
                continue
            value = struct.pack("<I", variable.index << 16 | variable.subindex << 8 | 8 * size)
            can = variable.pdo_mappable and variable.access_type in directions
            assert node.write(mapping, 1, value) is (None if can else SdoAbortCode.NOT_MAPPABLE), variable.qualname
            mapped += can
        assert mapped > 0 or name == ACCELEROMETER


def test_a_drive_in_a_robot_differs_from_the_file_in_its_motor_only():
    rig, od, reals = Rig(), imported(DRIVE, node_id=3), reals_in(VENDORS / DRIVE)
    dictionary = rig.drive.slave.dictionary
    differing = set()
    for variable in variables(od):
        entry = dictionary.cell(variable.index, variable.subindex).entry
        assert (variable.data_type, variable.access_type) == (entry.data_type, entry.access.value)
        if encode(entry.data_type, entry.default_for(3)) != default_bytes(variable, reals):
            differing.add((variable.index, variable.subindex))
    assert differing <= OF_THE_MOTOR
    assert len(list(variables(od))) == len(dictionary)


def test_the_accelerometer_on_the_bus_differs_from_the_file_in_its_serial_number_only():
    node, od = AccelerometerNode(16, lambda: (0.0, 0.0, 0.0), 20.0), imported(ACCELEROMETER, 16)
    differing = [
        (entry.index, entry.subindex)
        for entry in node.slave.dictionary
        if entry.default_for(16) != od.get_variable(entry.index, entry.subindex).default
    ]
    assert differing == [(0x1018, 4)]


# -- abort codes of a drive at work ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("index", "sub", "data", "code"),
    [
        (Object.STATUS_WORD, 0, b"\0\0", SdoAbortCode.READ_ONLY),
        (Object.SUPPORTED_MODES, 0, b"\0\0\0\0", SdoAbortCode.READ_ONLY),
        (0x2112, 1, b"\0", SdoAbortCode.READ_ONLY),
        (Object.QUICK_STOP_OPTION, 0, b"\x09\0", SdoAbortCode.VALUE_TOO_HIGH),
        (Object.QUICK_STOP_OPTION, 0, b"\xff\xff", SdoAbortCode.VALUE_TOO_LOW),
        (0x2100, 1, struct.pack("<f", 1e5), SdoAbortCode.VALUE_TOO_HIGH),
        (0x2101, 3, struct.pack("<f", 0.5), SdoAbortCode.VALUE_TOO_LOW),
        (0x2100, 1, struct.pack("<f", float("nan")), SdoAbortCode.INVALID_VALUE),
        (0x2101, 2, struct.pack("<f", float("inf")), SdoAbortCode.INVALID_VALUE),
        (Object.CONTROL_WORD, 0, b"\0\0\0", SdoAbortCode.TOO_LONG),
        (Object.TARGET_POSITION, 0, b"\0\0", SdoAbortCode.TOO_SHORT),
        (0x60F9, 1, b"\0\0", SdoAbortCode.NO_OBJECT),
        (0x2115, 1, b"\0", SdoAbortCode.NO_OBJECT),
        (Object.CONTROL_WORD, 1, b"\0\0", SdoAbortCode.NO_SUBINDEX),
        (0x2110, 11, b"\0", SdoAbortCode.NO_SUBINDEX),
        (0x1006, 0, struct.pack("<I", 1001), SdoAbortCode.INVALID_VALUE),
        (Object.MODES_OF_OPERATION, 0, b"\x05", SdoAbortCode.INVALID_VALUE),
        (Object.HOMING_METHOD, 0, b"\x0f", SdoAbortCode.INVALID_VALUE),
        (Object.PROFILE_ACCELERATION, 0, b"\0\0\0\0", SdoAbortCode.VALUE_TOO_LOW),
    ],
)
def test_a_drive_refuses_with_the_standards_code_and_changes_nothing(index, sub, data, code):
    rig = Rig()
    before = [cell.value for cell in rig.drive.slave.dictionary._cells.values()]
    assert rig.write_raw(index, sub, data) is code
    assert [cell.value for cell in rig.drive.slave.dictionary._cells.values()] == before
    assert rig.state is State.SWITCH_ON_DISABLED


# -- strangers ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def stranger():
    rig = Rig()
    network = Stranger(rig)
    node = canopen.BaseNode402(rig.node, str(VENDORS / DRIVE))
    network.add_node(node)
    network.deliver(rig.seen)
    yield rig, node
    network.disconnect()


def test_the_canopen_package_reads_and_writes_every_entry_by_our_data_sheet(stranger):
    rig, node = stranger
    for variable in variables(node.object_dictionary):
        if variable.index == 0x1003 and variable.subindex:
            continue  # an empty history has no entries
        group = node.sdo[variable.index]
        cell = group if isinstance(node.object_dictionary[variable.index], ODVariable) else group[variable.subindex]
        value = cell.raw
        is_command = variable.index in {0x1010, 0x1011}
        if variable.access_type in {Access.RW.value, Access.RWW.value} and not (0x1400 <= variable.index < 0x1C00 or is_command):
            cell.raw = value
        assert value == rig.drive.slave.dictionary.get(variable.index, variable.subindex)


def test_the_canopen_packages_402_profile_enables_the_drive_and_disables_it(stranger):
    rig, node = stranger
    node.setup_402_state_machine()
    node.op_mode = "CYCLIC SYNCHRONOUS POSITION"
    node.nmt.state = "OPERATIONAL"
    assert node.state == "SWITCH ON DISABLED"
    node.state = "OPERATION ENABLED"
    assert rig.drive.state is State.OPERATION_ENABLED
    assert node.op_mode == "CYCLIC SYNCHRONOUS POSITION"
    node.state = "SWITCHED ON"
    assert rig.drive.state is State.SWITCHED_ON
    node.state = "SWITCH ON DISABLED"
    assert rig.drive.state is State.SWITCH_ON_DISABLED


@pytest.mark.ci
def test_the_canopen_package_is_told_of_a_fault_and_resets_it(stranger):
    rig, node = stranger
    node.setup_402_state_machine()
    heard = []
    node.emcy.add_callback(heard.append)
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 2, 1000)
    rig.enable(Mode.PP)
    rig.set(Object.TARGET_POSITION, 0, 2000)
    rig.word(0x1F)
    node.network.deliver(rig.wait(100))
    assert [error.code for error in heard] == [0x8612]
    assert node.state == "FAULT"  # by the event-driven TPDO
    node.controlword = 0x00
    node.controlword = 0x80
    assert node.state == "SWITCH ON DISABLED"
    assert [error.code for error in heard] == [0x8612, 0]
