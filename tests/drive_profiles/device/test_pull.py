"""Pulls that meet a silent object, flags of the EDS, a bus that is lost; and what was pulled is always taken for a comparison."""

import pytest

from drive_profiles import eds
from drive_profiles.device.device import Device, identity_at
from drive_profiles.device.sdo import SdoPort
from drive_profiles.errors import BusError, NoAnswerError
from drive_profiles.family.catalogue import Catalogue
from drive_profiles.parameter_set.parameters import Item, ParameterSet
from drive_profiles.standard.cia301 import DataType
from plant_emulator.slave.dictionary import Access, Entry
from tests.drive_profiles import upload_rig as rig
from tests.drive_profiles.profiles import DRIVES
from tests.drive_profiles.world_bus import WorldBus, robot_with


class Silent(rig.Line):
    """The node does not answer requests for some objects; `gone_after` so many requests it answers none."""

    def __init__(self, slave, *objects, gone_after=1_000_000, lost_after=1_000_000):
        super().__init__(slave)
        self.objects = [index.to_bytes(2, "little") + bytes((sub,)) for index, sub in objects]
        self.gone_after, self.lost_after, self.asked = gone_after, lost_after, 0

    def send(self, can_id, data):
        self.asked += 1
        if self.asked > self.lost_after:
            raise BusError("bus lost")
        if data[1:4] not in self.objects and self.asked <= self.gone_after:
            super().send(can_id, data)


def device(line, description=None):
    return Device(SdoPort(rig.NODE, line, 0.5), Catalogue(rig.PROFILE, description))


def test_one_silent_object_is_left_out_and_named():
    pulled = device(Silent(rig.node(), (0x2003, 1), (0x2100, 0))).pull()
    assert len(pulled.tuning) == rig.PARAMETERS - 1
    assert pulled.header.not_read == (
        "2003:1 (p3): no answer to the read of 2003h:1 (p3) within 0.5 s",
        "2100:0 (text): no answer to the read of 2100h:0 (text) within 0.5 s",
    )


def test_a_silent_name_does_not_hide_a_device():
    identity = identity_at(SdoPort(rig.NODE, Silent(rig.node(), (0x1008, 0), (0x100A, 0)), 0.5))
    assert (identity.serial_number, identity.name, identity.firmware) == (7, "", "")


def test_a_node_that_is_gone_or_a_bus_that_is_lost_gives_no_set():
    with pytest.raises(NoAnswerError, match=r"no answer to the read of 20..h:1 \(p\d+\)"):
        device(Silent(rig.node(), gone_after=40)).pull()
    with pytest.raises(BusError):
        device(Silent(rig.node(), lost_after=40)).pull()


def test_an_absent_node_is_said_to_be_silent_at_what_was_asked():
    with pytest.raises(NoAnswerError, match=r"no answer to the read of 2003h:1 \(p3\) within 0\.5 s; check its supply"):
        device(Silent(rig.node(), gone_after=0)).read((0x2003, 1))


FLAGGED = b"""
[ManufacturerObjects]
SupportedObjects=3
1=0x2000
2=0x2001
3=0x2003
[2000]
ParameterName=a
ObjectType=8
SubNumber=1
ObjFlags=2
[2000sub1]
ParameterName=p
DataType=5
AccessType=rw
[2001]
ParameterName=b
ObjectType=8
SubNumber=1
[2001sub1]
ParameterName=p
DataType=6
AccessType=rw
ObjFlags=1
[2003]
ParameterName=c
ObjectType=8
SubNumber=1
[2003sub1]
ParameterName=p
DataType=7
AccessType=rw
ObjFlags=0
"""


def test_a_pull_does_not_read_what_the_eds_keeps_out_of_scans_nor_what_it_keeps_out_of_downloads():
    line = Silent(rig.node(), (0x2000, 1))
    asked, send = [], line.send
    line.send = lambda can_id, data: (asked.append(data[1:4]), send(can_id, data))
    pulled = device(line, eds.loads(FLAGGED, "a.eds")).pull()
    assert {"p0", "p1"}.isdisjoint(pulled.tuning)
    assert "p3" in pulled.tuning
    assert pulled.header.not_read == ("2000:1 (p0), 2001:1 (p1): excluded from scans or downloads by the ObjFlags of the EDS",)
    assert b"\x00\x20\x01" not in asked
    assert b"\x01\x20\x01" not in asked


def test_an_upload_leaves_out_what_the_eds_keeps_out_of_downloads_and_says_so(tmp_path):
    slave = rig.node()
    made = rig.Upload(
        device(rig.Line(slave), eds.loads(FLAGGED, "a.eds")),
        ParameterSet(tuning={name: Item(value=150) for name in ("p0", "p1", "p3")}),
        rig.UploadOptions(journals=tmp_path),
    )
    rig.fleet.prepare([made])
    assert made.warnings == ["left out, since the EDS excludes them from downloads (ObjFlags): p1"]
    assert rig.fleet.run([made])[0].kind == "done"
    assert [slave.dictionary.get(0x2000 + n, 1) for n in (0, 1, 3)] == [150, rig.old_value(1), 150]


@pytest.mark.ci
@pytest.mark.parametrize("name", sorted(DRIVES))
def test_a_set_that_was_just_pulled_is_taken_for_a_comparison_whatever_the_drive_holds(name, tmp_path):
    bus = WorldBus(robot_with(axis2={"profile": name}))
    drive = bus.device(2, name)
    dictionary = bus.world.drives[2].slave.dictionary
    for parameter in DRIVES[name].parameters.values():
        bounded = parameter.maximum is not None or parameter.minimum is not None
        if bounded and parameter.access == "rw" and parameter.type.is_integer and parameter.type.size:
            cell = dictionary.cell(*parameter.address)  # whatever a drive may hold: a limit of the profile is a fact of paper
            cell.value = (1 << (8 * parameter.type.size - 1)) - 1
    drive.pull().save(tmp_path / "a.toml")
    pulled = ParameterSet.load(tmp_path / "a.toml")
    writes = drive.resolve(pulled, limits=False)
    assert len(writes) == sum(1 for _ in pulled.items())
    assert [str(write.entry) for write in writes if drive.read(write.address) != write.data] == []


def test_a_header_says_how_the_drive_counts_where_values_count_in_it():
    header = WorldBus(robot_with()).device(2, "emulated_drive").pull().header
    assert (header.counts_per_rev, round(header.rated_torque_nm, 6)) == (131072, 2.367)
    assert WorldBus(robot_with(axis2={"profile": "nanotec_cl4e"})).device(2, "nanotec_cl4e").pull().header.counts_per_rev is None


@pytest.mark.slow
def test_a_device_of_very_many_objects_is_pulled_into_a_file_that_every_reader_takes(tmp_path):
    addresses = [(0x3000 + n // 250, 1 + n % 250) for n in range(11_782)]
    entries = [Entry(i, sub, f"P {i:X} {sub}", DataType.UNSIGNED32, Access.RW, 0xFFFFFFFF - sub) for i, sub in addresses]
    name = "Value of an object with a name of a usual length"
    text = "".join(f"[{i:X}]\nParameterName={name}\nObjectType=8\nSubNumber=251\n" for i, sub in addresses if sub == 1)
    text += "".join(f"[{i:X}sub{sub:X}]\nParameterName={name}\nDataType=7\nAccessType=rw\n" for i, sub in addresses)
    described = device(rig.Line(rig.node(more=entries)), eds.loads(text.encode(), "a.eds"))
    path = tmp_path / "all.toml"
    described.pull().save(path)
    assert path.stat().st_size > 1 << 20
    pulled = ParameterSet.load(path)
    assert not pulled.is_edited
    assert sum(1 for _ in pulled.items()) > len(addresses)
    upload = rig.Upload(described, pulled, rig.UploadOptions(journals=tmp_path))
    rig.fleet.prepare([upload])
    assert upload.changes == []
