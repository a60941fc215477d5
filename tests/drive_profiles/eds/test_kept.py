"""What a conversion keeps: every key that CiA 306 has, and what it does not keep is said."""

import configparser
import os
from pathlib import Path

import pytest

from drive_profiles import eds
from drive_profiles.eds.export import as_data, as_text, lost
from drive_profiles.eds.variables import ObjectFlag

CORPUS = Path(os.environ.get("HIL_EDS_CORPUS", Path(__file__).parents[4] / "shared" / "eds"))
OF_CIA_306 = {"objflags", "uploadfile", "downloadfile", "denotation", "paramrefd", "nodename", "netnumber", "networkname",
              "canopenmanager", "lss_serialnumber", "nodeid", "baudrate", "ng_slave", "nrofng_monitorednodes"}  # fmt: skip
MASTER = """
[DeviceInfo]
VendorName=Somebody
VendorNumber=0x360
ExtendedBootUpMaster=1
NG_Slave=0
CompactPDO=0
[DeviceCommissioning]
NodeID=1
Baudrate=1000
NodeName=master
NetNumber=3
NetworkName=a\tnetwork
CANopenManager=1
LSS_SerialNumber=4711
[Tools]
Items=1
[Tool1]
Name=Theirs
Command=theirs.exe $DCF
[SupportedModules]
NrOfEntries=1
[M1ModuleInfo]
ProductName=Module 1
[DummyUsage]
Dummy0005=1
Dummy0010=1
[OurOwn]
Colour=red
[MandatoryObjects]
SupportedObjects=1
1=0x1000
[OptionalObjects]
SupportedObjects=1
1=0x1F22
[ManufacturerObjects]
SupportedObjects=2
1=0x2000
2=0x2001
[1000]
ParameterName=Device type
DataType=7
AccessType=ro
DefaultValue=0
[1F22]
ParameterName=Concise DCF
ObjectType=8
SubNumber=2
ObjFlags=3
[1F22sub0]
ParameterName=Highest
DataType=5
AccessType=const
DefaultValue=2
[1F22sub2]
ParameterName=Node 2
DataType=0xF
AccessType=rw
UploadFile=slave2.bin
Denotation=the first axis
[2000]
ParameterName=List
ObjectType=8
DataType=7
AccessType=rw
CompactSubObj=3
ObjFlags=1
[2000Denotation]
NrOfEntries=1
2=the second of them
[2001]
ParameterName=Text
DataType=9
AccessType=rw
DefaultValue=a\tb  c
ParameterValue=x\ty
SetPoint=7
"""


def keys(text: str) -> set[tuple[str, str, str]]:
    parser = configparser.RawConfigParser(strict=False, delimiters=("=",), comment_prefixes=(";",))
    parser.read_string(text)
    return {(section.lower(), key, value) for section in parser.sections() for key, value in parser.items(section)}


@pytest.fixture(scope="module")
def master():
    return eds.loads(MASTER.encode(), "master.dcf")


def test_a_dcf_keeps_its_commissioning_files_denotations_and_flags(master):
    written = keys(as_text(master, "dcf"))
    assert {
        ("devicecomissioning", "nodename", "master"),
        ("devicecomissioning", "netnumber", "3"),
        ("devicecomissioning", "networkname", "a\tnetwork"),
        ("devicecomissioning", "canopenmanager", "1"),
        ("devicecomissioning", "lss_serialnumber", "0x1267"),
        ("devicecomissioning", "nodeid", "1"),
        ("deviceinfo", "extendedbootupmaster", "1"),
        ("deviceinfo", "ng_slave", "0"),
        ("1f22", "objflags", "0x3"),
        ("1f22sub2", "uploadfile", "slave2.bin"),
        ("1f22sub2", "denotation", "the first axis"),
        ("2000", "objflags", "0x1"),
        ("2000sub2", "denotation", "the second of them"),
        ("dummyusage", "dummy0010", "1"),
        ("tool1", "command", "theirs.exe $DCF"),
        ("m1moduleinfo", "productname", "Module 1"),
        ("2001", "defaultvalue", "a\tb  c"),
        ("2001", "parametervalue", "x\ty"),
    } <= written
    assert not any(section == "ourown" or key == "setpoint" for section, key, _ in written)


def test_a_copy_reads_as_its_original_and_a_copy_of_the_copy_is_the_same(master):
    text = as_text(master, "dcf")
    again = eds.loads(text.encode(), "again.dcf")
    assert (again.serial_number, again.node_id, again.flags) == (4711, 1, master.flags)
    assert again.values == master.values == {(0x2001, 0): "x\ty"}
    assert again.dictionary[0x2001].default == "a\tb  c"
    assert 0x10 in again.dictionary.indices
    assert as_text(again, "dcf") == text


def test_an_eds_has_no_keys_of_a_dcf_and_that_is_said(master):
    assert not keys(as_text(master, "eds")) & {
        ("1f22sub2", "uploadfile", "slave2.bin"),
        ("1f22sub2", "denotation", "the first axis"),
    }
    assert "objflags=0x3" in as_text(master, "eds").lower()
    said = [problem.message for problem in lost(master, "eds")]
    assert any("left out: commissioning, UploadFile, DownloadFile and Denotation" in each for each in said)
    assert not any("commissioning" in problem.message for problem in lost(master, "dcf"))


def test_what_cia_306_does_not_have_is_left_out_and_said(master):
    said = "\n".join(problem.message for problem in lost(master, "dcf"))
    assert "left out, as CiA 306 has no such keys (1): [2001] SetPoint" in said
    assert "left out, as CiA 306 has no such sections (1): [OurOwn]" in said


def test_flags_of_a_head_are_those_of_its_sub_objects(master):
    assert master.flags[0x1F22, 2] == ObjectFlag.REFUSES_WRITE_ON_DOWNLOAD | ObjectFlag.REFUSES_READ_ON_SCAN
    assert master.flags[0x2000, 3] == ObjectFlag.REFUSES_WRITE_ON_DOWNLOAD
    flags = {row["index"]: row["flags"] for row in as_data(master)["objects"]}
    assert (flags[0x1F22], flags[0x1000]) == (3, 0)


def test_a_text_that_cannot_stand_on_a_line_is_named_as_lost():
    xdd = (
        b'<ISO15745ProfileContainer><CANopenObjectList><CANopenObject index="1000" name="t" objectType="7" dataType="0009"'
        b' accessType="ro" objFlags="0003" defaultValue="a &#9; b   c"/>'
        b'<CANopenObject index="2000" name="u" objectType="7" dataType="0009" accessType="ro" defaultValue="bell&#127;"/>'
        b"</CANopenObjectList></ISO15745ProfileContainer>"
    )
    description = eds.loads(xdd, "a.xdd")
    assert (description.dictionary[0x1000].default, description.flags) == ("a \t b   c", {(0x1000, 0): 3})
    again = eds.loads(as_text(description, "eds").encode(), "a.eds")
    assert again.dictionary[0x1000].default == "a \t b   c"
    assert [problem.key for problem in lost(description, "eds")] == ["2000:00"]


@pytest.mark.slow
@pytest.mark.skipif(not CORPUS.is_dir(), reason=f"no folder of vendors' files at {CORPUS}")
@pytest.mark.parametrize("path", sorted(CORPUS.glob("*.[eEdD][dDcC][sSfF]")), ids=lambda path: path.name)
def test_no_key_of_cia_306_is_lost_from_a_vendor_s_file(path):
    description = eds.load(path)
    written = eds.loads(as_text(description, "dcf").encode(), "copy.dcf").document.sections
    missing = [
        (section.name, entry.key)
        for identity, section in description.document.sections.items()
        for key, entry in section.entries.items()
        if key in OF_CIA_306 and entry.value and identity[:4] >= "1000" and identity != "fileinfo"
        and key not in written.get("devicecomissioning" if identity.startswith("devicecom") else identity, section).entries
        and entry.value not in {"0", "0x0"}
    ]  # fmt: skip
    assert missing == []
    assert eds.loads(as_text(description, "dcf").encode(), "copy.dcf").flags == description.flags
