"""Quirks of real files, each in a small file of our own: what becomes of it, and that it is said where."""

from pathlib import Path

import pytest

from drive_profiles import eds
from drive_profiles.eds import objects as eds_objects
from drive_profiles.errors import FileError, OutOfRangeError
from drive_profiles.family.profile import VENDORS

QUIRKS = Path(__file__).parent / "quirks"
MINIMAL = "[MandatoryObjects]\nSupportedObjects=1\n1=0x1000\n[1000]\nParameterName=Type\nDataType=7\nAccessType=ro\n"


def said(description: eds.Description) -> dict[tuple[int, str], str]:
    return {(problem.line, problem.key): problem.message for problem in (*description.warnings, *description.refused)}


@pytest.fixture(scope="module")
def numbers():
    return eds.load(QUIRKS / "numbers.eds")


@pytest.fixture(scope="module")
def structure():
    return eds.load(QUIRKS / "structure.eds")


@pytest.fixture(scope="module")
def configured():
    return eds.load(QUIRKS / "configured.dcf")


@pytest.mark.parametrize("path", sorted(VENDORS.glob("*.eds")), ids=lambda path: path.name)
def test_our_own_files_have_no_fault(path):
    description = eds.load(path, strict=True)
    assert (description.warnings, description.refused, description.file_format) == ((), (), "eds")
    assert description.vendor_id == 0x48494C01


@pytest.mark.parametrize(
    ("index", "default", "low", "high", "lines"),
    [
        (0x2000, -3, -128, 63, (39, 40)),
        (0x2001, -3, None, None, (47,)),
        (0x2002, -(2**31), -(2**31), 2**31 - 1, (53, 54)),
        (0x2003, 8, None, None, (61,)),
        (0x2004, 1, None, None, ()),
        (0x2005, 89, None, None, (73,)),
        (0x2006, 16, None, 255, (79, 80)),
        (0x2007, 3, None, None, (86,)),
        (0x2008, None, None, None, (92,)),
        (0x2009, 65535, None, None, (99,)),
        (0x200A, None, None, None, (105,)),
        (0x200B, 255, None, None, (111,)),
        (0x200C, 5, None, None, (115, 116, 117, 118, 119)),
        (0x200D, pytest.approx(3.14159265), -1500.0, 1000.0, ()),
        (0x200E, 7, None, None, (134,)),
        (0x200F, 7, 10, 100, (141,)),
        (0x2010, None, None, None, ()),
        (0x2011, None, None, None, (157,)),
    ],
)
def test_numbers_and_limits(numbers, index, default, low, high, lines):
    variable = numbers.dictionary[index]
    assert (variable.default, variable.min, variable.max) == (default, low, high)
    assert tuple(problem.line for problem in numbers.warnings if problem.key.startswith(f"[{index:04X}]")) == lines


def test_a_warning_says_where_what_was_read_and_what_was_made_of_it(numbers):
    with pytest.raises(FileError) as caught:
        eds.load(numbers.path, strict=True)
    assert caught.value.problems == tuple(sorted((*numbers.warnings, *numbers.contradictions)))
    assert (
        f"{numbers.path}:39: [2000] DefaultValue: '0xFD' read as -3, which has these bits; expected INTEGER8, -128 to 127"
        in str(caught.value)
    )


def test_a_hash_in_a_name_is_no_comment(numbers, structure):
    assert numbers.dictionary[0x200C].name == "Comments #1 and ;2 belong to a name"
    assert structure.dictionary[0x1008].default == "Servo #7 ; rev. 2"


def test_identity_and_an_empty_one(numbers, structure):
    assert (numbers.vendor_id, numbers.product_code, numbers.revision) == (0x123, 7, 0x10002)
    assert (numbers.vendor_name, numbers.product_name) == ("Quirk works", "Numbers")
    assert (structure.vendor_id, structure.product_code, structure.revision, structure.vendor_name) == (None, None, None, "")
    assert structure.dictionary.device_information.allowed_baudrates == {1_000_000}
    assert structure.dictionary.device_information.nr_of_RXPDO == 2
    assert said(structure)[6, "[DeviceInfo] VendorNumber"] == "empty; read as unknown"


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ((3, ""), "'stray=1' is outside any section; ignored"),
        ((13, "[Comments] Lines"), "9; there are 2 lines"),
        ((23, "[MandatoryObjects] Supported Objects"), "read as SupportedObjects"),
        ((27, "[OptionalObjects] SupportedObjects"), "'5'; 4 objects are listed"),
        ((30, "[OptionalObjects] 3"), "'0x1018' listed already, line 29"),
        ((31, "[OptionalObjects] 4"), "'zero' is not an index; ignored"),
        ((45, "[ManufacturerObjects] 10"), "'0x200A' is ignored; '0x2009' is taken from line 44"),
        ((54, "[1008]"), "'# the name' after a section header; ignored"),
        ((64, "[1018] DataType"), "'0x0023' ignored: it belongs to the sub-objects"),
        ((65, "[1018] SubNumber"), "'9' wrong: there are 2 sub-objects"),
        ((76, "[2000] ParameterName"), "missing; named '2000'"),
        ((81, "[2001] DataType"), "missing; taken as DOMAIN, bytes of any number"),
        ((85, "[2002] AccessType"), "missing; taken as ro, so that no tool writes it"),
        ((92, "[2003] AccessType"), "'read/write' read as rw"),
        ((93, "[2003] PDOMapping"), "'yes' read as 1"),
        ((98, "[2004] AccessType"), "'sometimes' not an access type; taken as ro"),
        ((112, "[2006sub0]"), "[2006] is a VAR; left out"),
        ((117, "[2007] ObjectType"), "missing, but there are sub-objects; taken as RECORD"),
        ((131, "[2008] DefaultValue"), "'2' is ignored; '1' is taken from line 130"),
        ((137, "[2009sub0]"), 'section header lacks "]"; assumed'),
        ((142, "[200a] ObjectType"), "0 is not an object that holds a value; left out"),
        ((148, "[200b]"), "not in any list of objects; read anyway"),
        ((153, "[200Csub1]"), "no section [200C] above it; a record is assumed"),
        ((158, "[200Dsub100]"), "sub-index above FFh; left out"),
        ((165, "[2008] LowLimit"), "taken from a second [2008], line 163; the first is in line 125"),
        ((167, "[0012]"), "below 1000h there are only data types; left out"),
        ((171, "[0012]"), "'no equals sign' is not key=value; ignored"),
    ],
)
def test_a_faulty_structure_is_repaired_and_said_so(structure, place, message):
    assert said(structure)[place] == message


def test_what_is_made_of_a_faulty_structure(structure):
    dictionary = structure.dictionary
    assert dictionary[0x1000].access_type == "const"
    assert (dictionary[0x1008].name, dictionary[0x1008].access_type) == ("Device name #1 ; all of it", "ro")
    assert sorted(dictionary.indices[0x1018].subindices) == [0, 1]
    assert (dictionary[0x2002].access_type, dictionary[0x2003].access_type) == ("ro", "rw")
    assert dictionary[0x2003].pdo_mappable
    assert (dictionary[0x2001].data_type, dictionary[0x2005].data_type) == (0x0F, 0x0F)
    assert (dictionary[0x2006].access_type, dictionary.indices[0x2007].subindices[0].access_type) == ("rww", "rwr")
    assert (dictionary[0x2008].default, dictionary[0x2008].min) == (1, 1)
    assert 0x200A not in dictionary.indices
    assert sorted(dictionary.indices[0x200C].subindices) == [1]
    assert sorted(index for index in dictionary.indices if index < 0x1000) == [0x05, 0x1B]
    assert dictionary.comments == "only\ntwo"


def test_the_node_id_of_either_spelling_resolves_the_values(configured):
    assert (configured.file_format, configured.node_id, configured.bitrate_bit_s) == ("dcf", 10, 500_000)
    assert configured.values == {
        (0x1014, 0): 0x8000008A,
        (0x1016, 1): 0x007F03E8,
        (0x1016, 3): 7,
        (0x2000, 0): 0.5,
        (0x2001, 0): -2,
        (0x2002, 0): "left arm; #2",
        (0x2003, 0): b"\x00\xff\x10",
    }
    assert said(configured)[131, "[2004] ParameterValue"] == "'300' out of the range of its type; dropped"
    standard = (QUIRKS / "configured.dcf").read_text().replace("DeviceCommissioning", "DeviceComissioning")
    assert eds.loads(standard.encode(), "x.dcf").values == configured.values


def test_relative_defaults(configured):
    emergency = configured.dictionary[0x1014]
    assert (emergency.default, emergency.relative, emergency.default_raw) == (0x8A, True, "$NodeID + 0x80")
    given = eds.load(configured.path, node_id=7)
    assert (given.node_id, given.dictionary[0x1014].default) == (7, 0x87)
    unknown = eds.loads((QUIRKS / "configured.dcf").read_bytes().replace(b"NodeID=0x0A", b"NodeID=0"), "x.dcf")
    assert (unknown.node_id, unknown.dictionary[0x1014].default, unknown.dictionary[0x1014].relative) == (None, 0x80, True)
    assert (0x1014, 0) not in unknown.values
    assert said(unknown)[40, "[1014] ParameterValue"] in {
        "'0x80000080+$NODEID' read as $NODEID+0x80000080",
        "'0x80000080+$NODEID' left out: the node-ID is not known",
    }


def test_a_compact_array_is_written_out(configured):
    members = configured.dictionary.indices[0x1016].subindices
    assert [member.name for _, member in sorted(members.items())] == [
        "NrOfObjects", "Consumer heartbeat time1", "Heartbeat of the drive", "Consumer heartbeat time3",
        "Consumer heartbeat time4",
    ]  # fmt: skip
    assert [members[subindex].default for subindex in range(5)] == [4, 0, 0, 0, 0]
    assert [members[subindex].value for subindex in range(5)] == [None, 0x007F03E8, None, 7, None]
    assert said(configured)[53, "[1016Value] NrOfEntries"] == "3; there are 2"


def test_compact_pdos_are_written_out_where_there_are_none(configured):
    dictionary = configured.dictionary
    assert sorted(dictionary.indices[0x1400].subindices) == [0, 1]
    assert 0x1401 not in dictionary.indices
    assert sorted(dictionary.indices[0x1800].subindices) == [0, 1, 2, 5]
    assert dictionary.indices[0x1800].subindices[1].default == 0x18A
    assert dictionary.indices[0x1804].subindices[1].default == 0x8000_0000
    assert len(dictionary.indices[0x1A04].subindices) == 65
    assert 0x1805 not in dictionary.indices


def test_types_of_the_vendor():
    description = eds.load(QUIRKS / "types.eds")
    types = [description.dictionary[index].data_type for index in range(0x2000, 0x2005)]
    assert types == [0x0F, 0x06, 0x03, 0x0F, 0x0C]
    assert [description.dictionary[index].default for index in range(0x2000, 0x2005)] == [None, 7, -7, b"\x01\x02", 0]
    assert said(description)[41, "[2000] DataType"] == "'0x0040' not a type of CiA 301; taken as DOMAIN, bytes of any number"
    assert said(description)[68, "[SupportedModules]"] == "a modular device: 3 sections of modules ignored"
    assert min(index for index in description.dictionary.indices) == 0x2000


def test_a_second_axis_is_there_like_the_first():
    text = MINIMAL + "".join(
        f"[{0x6040 + 0x800 * axis:04X}]\nParameterName=Controlword\nDataType=6\nAccessType=rww\n" for axis in range(3)
    )
    dictionary = eds.loads(text.encode(), "x.eds").dictionary
    assert [dictionary[0x6040 + 0x800 * axis].name for axis in range(3)] == ["Controlword"] * 3


def test_a_missing_section_and_missing_lists_are_said():
    listed = eds.loads(MINIMAL.replace("=1\n1=", "=2\n2=0x1001\n1=").encode(), "x.eds")
    assert said(listed) == {(3, "[MandatoryObjects] 2"): "'0x1001' has no section; there is no such object"}
    unlisted = eds.loads(MINIMAL.partition("[1000]")[2].join(("[1000]", "")).encode(), "x.eds")
    assert said(unlisted) == {(0, ""): "has none of the lists of objects; all sections of objects are read"}


def test_kind_is_of_the_name_or_else_of_the_content():
    assert eds.loads(MINIMAL.encode()).file_format == "eds"
    assert eds.loads(MINIMAL.encode() + b"[DeviceComissioning]\nNodeID=3\n").file_format == "dcf"
    assert eds.loads(MINIMAL.encode(), "x.DCF").file_format == "dcf"
    assert eds.loads(MINIMAL.encode(), "x.eds", file_format="dcf").file_format == "dcf"
    assert said(eds.loads(MINIMAL.encode(), "x.xdd")) == {(0, ""): "is named as xdd, but is read as eds"}


@pytest.mark.parametrize(
    "data", [b"", b"\0" * 100, b"hello", b"[FileInfo]\nx=1\n", b"[0005]\nParameterName=a\nDataType=5\n", b"<a/>", b"\xff\xfe"]
)
def test_a_file_with_no_object_is_refused(data):
    with pytest.raises(FileError):
        eds.loads(data)


@pytest.mark.parametrize("path", ["missing.eds", ".", "a\0b.eds"])
def test_what_cannot_be_opened_is_a_file_error(path):
    with pytest.raises(FileError, match="cannot be read"):
        eds.load(path)


@pytest.mark.parametrize("node_id", [0, 128, -1])
def test_a_wrong_node_id_is_the_caller_s_mistake(node_id):
    with pytest.raises(OutOfRangeError, match="node-ID"):
        eds.loads(MINIMAL.encode(), node_id=node_id)


@pytest.mark.slow
def test_compact_notations_do_not_explode():
    text = "".join(
        f"[{index:04X}]\nParameterName=x\nObjectType=8\nDataType=7\nAccessType=rw\nCompactSubObj=0xFE\n"
        for index in range(0x1000, 0x3000)
    )
    description = eds.loads(text.encode())
    count = sum(len(item.subindices) for item in description.dictionary.indices.values())
    assert eds_objects.MAX_VARIABLES - 0xFF < count <= eds_objects.MAX_VARIABLES
    assert "too many entries" in description.refused[0].message


def test_control_characters_never_reach_a_name():
    text = MINIMAL.replace("=Type", "=Ty\x1b[2Jpe")
    description = eds.loads(text.encode())
    assert description.dictionary[0x1000].name == "Ty\ufffd[2Jpe"
    assert "control characters replaced" in description.warnings[0].message
