"""Strangers that read our EDS files: dcfchk and dcfgen of Lely's dcf-tools (CiA 306-1; CiA 302-3, concise DCF)."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import drive_profiles
from drive_profiles import eds
from drive_profiles.family.catalogue import CatalogueEntry
from drive_profiles.parameter_set.formats import from_concise, to_concise
from drive_profiles.parameter_set.parameters import Write
from drive_profiles.standard.cia301 import DataType, encode
from plant_emulator.data_sheets import data_sheets
from tests.conformance.emulated import NAMES, emulated_device

pytest.importorskip("dcf", reason="dcf-tools is not installed")

VENDORS = Path(drive_profiles.__file__).parent / "vendors"
STAND_INS = Path(__file__).parent / "stand_ins"
NODE = 5

BUS = """
options:
  dcf_path: "."
master:
  node_id: 1
  baudrate: 1000
  vendor_id: 0x360
  sync_period: 2000
  heartbeat_producer: 100
drive:
  dcf: "{path}"
  node_id: {node}
  mandatory: true
  heartbeat_consumer: true
  heartbeat_producer: 100
  error_behavior: {{1: 0}}
  rpdo:
    1:
      enabled: true
      transmission: 1
      mapping:
        - {{index: 0x6040, sub_index: 0}}
        - {{index: 0x607A, sub_index: 0}}
  tpdo:
    1:
      enabled: true
      transmission: 1
      mapping:
        - {{index: 0x6041, sub_index: 0}}
        - {{index: 0x6064, sub_index: 0}}
        - {{index: 0x6077, sub_index: 0}}
  sdo:
    - {{index: 0x6060, value: 8}}
    - {{index: 0x60C2, sub_index: 1, value: 2}}
"""


def run(module, *arguments, cwd):
    """A tool of dcf-tools; its warnings are what it has to say of a file."""
    paths = os.pathsep.join((str(STAND_INS), os.environ.get("PYTHONPATH", "")))
    done = subprocess.run(
        [sys.executable, "-m", module, *map(str, arguments)],
        cwd=cwd, env=os.environ | {"PYTHONPATH": paths}, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    return done.returncode, "\n".join(line for line in done.stderr.splitlines() if "SyntaxWarning" not in line)


def texts():
    """Name and text of every EDS that we write: the committed ones, and those of the emulated nodes."""
    committed = [(path.name, path.read_text(encoding="ascii")) for path in sorted(VENDORS.glob("*.eds"))]
    return committed + [(f"generated {name}", text) for name, text in data_sheets().items()]


@pytest.mark.ci
def test_dcfchk_has_nothing_to_say_of_our_eds(tmp_path):
    path = tmp_path / "device.eds"
    for name, text in texts():
        path.write_text(text, encoding="ascii")
        assert run("dcf.cli", "-n", NODE, path, cwd=tmp_path) == (0, ""), name


def test_dcfchk_is_strict(tmp_path):
    path = tmp_path / "device.eds"
    path.write_text(data_sheets()["emulated_drive.eds"].replace("LowLimit=-9", "LowLimit=0.5"), encoding="ascii")
    code, said = run("dcf.cli", "-n", NODE, path, cwd=tmp_path)
    assert code != 0
    assert "0.5" in said


@pytest.mark.ci
@pytest.mark.parametrize("name", NAMES)
def test_dcfchk_has_nothing_to_say_of_the_eds_of_an_emulated_node(tmp_path, name):
    device = emulated_device(name)
    path = tmp_path / "device.eds"
    path.write_bytes(device.eds_text.encode("latin-1"))
    assert run("dcf.cli", "-n", device.node_id, path, cwd=tmp_path) == (0, "")


def test_dcfchk_reads_every_default_as_we_do(tmp_path):
    path = tmp_path / "drive.eds"
    path.write_text(data_sheets()["emulated_drive.eds"], encoding="ascii")
    script = (
        "import sys, dcf\n"
        "device = dcf.Device.from_dcf(sys.argv[1], {'NODEID': 5})\n"
        "for index, thing in device.items():\n"
        "    for sub, entry in thing.items():\n"
        "        if entry.data_type.is_basic():\n"
        "            print(index, sub, entry.data_type.concise_value(index, sub, entry.parse_value())[7:].hex())\n"
    )
    done = subprocess.run([sys.executable, "-c", script, str(path)], capture_output=True, text=True, timeout=60, check=True)
    theirs = {(int(i), int(s)): bytes.fromhex(data) for i, s, data in (line.split() for line in done.stdout.splitlines())}
    dictionary = eds.load(path, node_id=NODE).dictionary
    for (index, sub), data in theirs.items():
        variable = dictionary.get_variable(index, sub)
        if variable.data_type == DataType.REAL32:  # not stated: nothing to us, and its type's 0 to them
            assert (variable.default, data) == (None, bytes(4))
        else:
            assert data == encode(DataType(variable.data_type), variable.default), f"{index:04X}h:{sub:02X}h"
    assert any(dictionary.get_variable(*place).data_type == DataType.REAL32 for place in theirs)


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    """What dcfgen makes of a bus with one emulated drive."""
    folder = tmp_path_factory.mktemp("dcfgen")
    path = folder / "drive.eds"
    path.write_text(data_sheets()["emulated_drive.eds"], encoding="ascii")
    (folder / "bus.yml").write_text(BUS.format(path=path, node=NODE))
    code, said = run("dcfgen.cli", "-d", folder, folder / "bus.yml", cwd=folder)
    assert (code, said) == (0, "")
    return folder


def test_dcfgen_makes_a_master_of_our_eds(generated):
    master = generated / "master.dcf"
    assert master.is_file()
    description = eds.load(master, node_id=1)
    assert description.refused == ()
    assert 0x1F81 in description.dictionary
    assert (generated / "drive.bin").is_file()


def test_the_generated_configuration_is_taken_by_the_emulated_drive(generated):
    device = emulated_device("drive")
    for index, sub, value in concise((generated / "drive.bin").read_bytes()):
        data = value
        if (index, sub) in {(0x1400, 1), (0x1800, 1)}:  # made for another node-ID
            data = bytes((value[0] - NODE + device.node_id, *value[1:]))
        assert device.sdo.download(index, sub, data) is None, f"{index:04X}h:{sub:02X}h = {data.hex(' ')}"
    device.nmt(1)
    mark = len(device.port.seen)
    device.sync()
    assert device.port.expect(0x180 + device.node_id, 0.1, mark) is not None


def test_our_concise_dcf_is_the_generated_one_byte_for_byte(generated):
    """Of entries whose order is free, in dcfgen's; of PDOs ours is longer, since it makes sure of the mapping's order."""
    data = (generated / "drive.bin").read_bytes()
    dictionary = eds.load(generated / "drive.eds", node_id=NODE).dictionary
    plain = [(i, s, value) for i, s, value in concise(data) if not 0x1400 <= i < 0x1C00]
    writes = []
    for index, sub, value in plain:
        variable = dictionary.get_variable(index, sub)
        entry = CatalogueEntry((index, sub), variable.name, DataType(variable.data_type), variable.access_type)
        writes.append(Write(entry, value, 0.0, "tuning"))
    ours = to_concise(writes)
    theirs = {(i, s): value for i, s, value in plain}
    assert from_concise(ours) == theirs
    assert sorted(concise(ours)) == sorted(plain)
    assert len(ours) == 4 + sum(7 + len(value) for _, _, value in plain)
    assert from_concise(data) == {(i, s): value for i, s, value in concise(data)}


def concise(data):
    """The entries of a concise DCF, in their order."""
    count, place, found = int.from_bytes(data[:4], "little"), 4, []
    for _ in range(count):
        index, sub = int.from_bytes(data[place : place + 2], "little"), data[place + 2]
        size = int.from_bytes(data[place + 3 : place + 7], "little")
        found.append((index, sub, data[place + 7 : place + 7 + size]))
        place += 7 + size
    assert place == len(data)
    return found
