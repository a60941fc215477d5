"""What a file says against itself or against the standard is named with its line, and nothing that is right is."""

import codecs
import os
from pathlib import Path

import pytest

from drive_profiles import eds
from drive_profiles.errors import FileError
from drive_profiles.family.profile import VENDORS

CORPUS = Path(os.environ.get("HIL_EDS_CORPUS", Path(__file__).parents[4] / "shared" / "eds"))
SOUND = """
[DeviceInfo]
VendorNumber=0x65
ProductNumber=0
NrOfTXPDO=1
NrOfRXPDO=0
[MandatoryObjects]
SupportedObjects=3
1=0x1000
2=0x1001
3=0x1018
[OptionalObjects]
SupportedObjects=3
1=0x1003
2=0x1800
3=0x1A00
[ManufacturerObjects]
SupportedObjects=1
1=0x2000
"""


def variable(section, data_type=7, access="ro", default=None):
    value = "" if default is None else f"DefaultValue={default}\n"
    return f"[{section}]\nParameterName=x\nDataType={data_type}\nAccessType={access}\n{value}"


def compound(index, *subs, kind=9):
    return f"[{index}]\nParameterName=x\nObjectType={kind}\nSubNumber={len(subs)}\n" + "".join(subs)


def file(**changed):
    """A sound file, but for the objects that are changed."""
    objects = {
        "o1000": variable("1000"),
        "o1001": variable("1001", 5),
        "o1018": compound("1018", variable("1018sub0", 5, "const", 1), variable("1018sub1", 7, "ro", "0x65")),
        "o1003": compound("1003", variable("1003sub0", 5, "rw", 0), variable("1003sub1"), kind=8),
        "o1800": compound("1800", variable("1800sub0", 5, "const", 5), variable("1800sub1"), variable("1800sub5", 6, "rw")),
        "o1A00": compound(
            "1A00", variable("1A00sub0", 5, "rw", 1), variable("1A00sub1"), variable("1A00sub2"), variable("1A00subFF")
        ),
        "o2000": compound("2000", variable("2000sub0", 5, "rw", 0), variable("2000sub1"), kind=8),
        **changed,
    }
    return (SOUND + "".join(objects.values())).encode()


def said(data, **more):
    description = eds.loads(data, "a.eds", **more)
    return [(problem.key, problem.message) for problem in description.contradictions]


def test_a_sound_file_says_nothing_against_itself():
    assert said(file()) == []
    for own in VENDORS.glob("*.eds"):
        assert eds.load(own).contradictions == ()


@pytest.mark.parametrize(
    ("changed", "key", "words"),
    [
        (
            {"o1018": compound("1018", variable("1018sub0", 5, "const", 1), variable("1018sub1", 7, "ro", "0x66"))},
            "[DeviceInfo] VendorNumber", "0x65, but the default of 1018:1 is 0x66",
        ),
        (
            {"o2000": compound("2000", variable("2000sub0", 5, "const", 4), variable("2000sub1"), variable("2000sub5"))},
            "[2000sub0] DefaultValue", "'4', but the highest sub-index described is 5",
        ),
        (
            {"o2000": compound("2000", variable("2000sub0", 5, "rw", 2), variable("2000sub1"), kind=8)},
            "[2000sub0] DefaultValue", "'2', but the highest sub-index described is 1",
        ),
        (
            {"o2000": compound("2000", variable("2000sub0", 6, "rw", 1), variable("2000sub1"))},
            "[2000sub0] DataType", "sub-index 0 is UNSIGNED16",
        ),
        ({"o1001": ""}, "[1001]", "missing: the error register is mandatory"),
        ({"o1000": ""}, "[1000]", "missing: the device type is mandatory"),
        ({"o1018": ""}, "[1018]", "missing: the identity is mandatory"),
        (
            {"o1800": compound("1800", variable("1800sub0", 5, "const", 1), variable("1800sub1"))
             + compound("1801", variable("1801sub0", 5, "const", 1), variable("1801sub1"))},
            "[DeviceInfo] NrOfTXPDO", "1, but 2 have communication parameters",
        ),
    ],
)  # fmt: skip
def test_each_contradiction_is_named_where_it_stands(changed, key, words):
    [(where, message)] = said(file(**changed))
    assert where == key
    assert words in message
    with pytest.raises(FileError, match=r"\]"):
        eds.loads(file(**changed), "a.eds", strict=True)


def test_a_file_that_contradicts_itself_states_both_numbers():
    assert eds.loads(file(), "a.eds").vendor_ids == (0x65,)
    other = compound("1018", variable("1018sub0", 5, "const", 1), variable("1018sub1", 7, "ro", "0x66"))
    assert eds.loads(file(o1018=other), "a.eds").vendor_ids == (0x65, 0x66)
    assert eds.loads(file(), "a.eds").product_codes == ()


@pytest.mark.parametrize("codec", ["utf-16-le", "utf-16-be"])
def test_utf_16_is_read_with_and_without_its_mark_and_that_is_said(codec):
    text = file().decode()
    bare = text.encode(codec)
    marked = (codecs.BOM_UTF16_LE if codec == "utf-16-le" else codecs.BOM_UTF16_BE) + bare
    for data, words in ((bare, "is UTF-16 without a byte order mark"), (marked, "read as UTF-16")):
        description = eds.loads(data, "a.eds")
        assert 0x1018 in description.dictionary.indices
        assert words in description.warnings[0].message
        assert description.rewrite({}) == data


def test_text_with_some_nuls_is_not_taken_for_utf_16():
    assert eds.loads(file() + b"\0\0\0\0", "a.eds").warnings == ()


@pytest.mark.ci
@pytest.mark.skipif(not CORPUS.is_dir(), reason=f"no folder of vendors' files at {CORPUS}")
@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("Beckhoff_BK5120.eds", {"[DeviceInfo] ProductNumber"}),
        ("canopen-python_e35.eds", {"[DeviceInfo] VendorNumber", "[DeviceInfo] ProductNumber", "[DeviceInfo] RevisionNumber"}),
        ("ZeroErr_eDriver_V1.5.eds", {f"[1{n}0{k}sub0] DefaultValue" for n in "48" for k in range(4)}),
        ("Trinamic_TMCM-1636_Fw1.12.eds", {"[2041sub0] DefaultValue"}),
        ("Roboteq_v2.0_2019.eds", {"[2135sub0] DefaultValue"}),
        ("Infranor_Easy-ak_v1.30.eds", {"[1003sub0] DataType"}),
        ("SchneiderElectricMotion_NEMA23.eds", {"[5519sub0] DataType"}),
        ("maxon_EPOS-70-10.eds", {"[2FFFsub0] DefaultValue"}),
        ("maxon_EPOS4-Module-50-5.eds", set()),
        ("Ingenia_EVE-XCR-C_1.8.1.eds", set()),
        ("Elmo_Gold.eds", set()),
    ],
)
def test_vendors_files_contradict_themselves_where_they_were_found_to(name, wanted):
    if not (CORPUS / name).exists():
        pytest.skip("this file is not in the folder")
    assert {problem.key for problem in eds.load(CORPUS / name).contradictions} == wanted
