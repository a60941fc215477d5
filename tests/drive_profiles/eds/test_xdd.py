"""XDD files: the same objects as an EDS would give, and nothing followed, fetched or expanded."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles import eds
from drive_profiles.eds import export as eds_export
from drive_profiles.eds import xdd
from drive_profiles.errors import FileError
from drive_profiles.files.xml_tree import MAX_ELEMENTS

QUIRKS = Path(__file__).parent / "quirks"
FLAT = (QUIRKS / "flat.xdd").read_text()


@pytest.fixture(scope="module")
def flat():
    return eds.load(QUIRKS / "flat.xdd")


def test_objects_of_the_flat_form(flat):
    dictionary = flat.dictionary
    assert sorted(dictionary.indices) == [0x0005, 0x1000, 0x1014, 0x6040, 0x6041, 0x60C2]
    assert (dictionary[0x1000].data_type, dictionary[0x1000].access_type, dictionary[0x1000].default) == (7, "const", 0x20192)
    assert (dictionary[0x1014].default, dictionary[0x1014].relative) == (0x80, True)
    members = dictionary.indices[0x60C2].subindices
    assert (members[1].min, members[1].max, members[2].default) == (1, 20, -3)
    assert (dictionary[0x6040].access_type, dictionary[0x6040].pdo_mappable) == ("rww", True)
    assert (dictionary[0x6041].access_type, dictionary[0x6041].pdo_mappable) == ("ro", True)
    assert flat.values == {(0x60C2, 1): 2}


def test_identity_and_abilities(flat):
    assert (flat.file_format, flat.vendor_id, flat.product_code, flat.revision) == ("xdd", 0x123, 0x42, None)
    assert (flat.vendor_name, flat.product_name) == ("Quirk works", "Flat")
    information = flat.dictionary.device_information
    assert (information.nr_of_RXPDO, information.nr_of_TXPDO, information.allowed_baudrates) == (4, 4, {500_000})


def test_faults_have_the_line_of_the_xml(flat):
    assert [(problem.line, problem.key) for problem in flat.warnings] == [(18, "[60C2sub2] DefaultValue")]
    assert [(problem.line, problem.message) for problem in flat.refused] == [
        (22, "described already in line 20; left out"),
        (23, "'xyz' is not an index; the object is left out"),
    ]
    with pytest.raises(FileError, match=r"flat\.xdd:18"):
        eds.load(flat.path, strict=True)


def test_objects_that_refer_to_parameters():
    description = eds.load(QUIRKS / "parameters.xdd")
    offset, text, bits = (description.dictionary[index] for index in (0x2000, 0x2001, 0x2002))
    assert (offset.data_type, offset.access_type, offset.default, offset.min, offset.max) == (3, "rw", -5, -10, 10)
    assert offset.pdo_mappable
    assert (text.data_type, text.access_type, text.default) == (9, "ro", "text")
    assert (bits.data_type, bits.access_type, bits.default, bits.value) == (0x0A, "rwr", b"\x00\x0a", b"\x00\x0b")
    assert [problem.key for problem in description.warnings] == ["[2003] AccessType", "[2003] DataType"]


def test_an_xdd_becomes_an_eds_without_faults(flat):
    again = eds.loads(eds_export.as_text(flat, "dcf").encode(), "again.dcf")
    assert (again.warnings, again.values) == ((), flat.values)


def test_an_xdd_is_not_rewritten(flat):
    with pytest.raises(FileError, match="convert it first"):
        flat.rewrite({(0x6040, 0): 1})


BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
EXTERNAL = '<!DOCTYPE x SYSTEM "http://localhost:9/x.dtd">'
FILE = '<!DOCTYPE x [<!ENTITY f SYSTEM "file:///etc/hostname">]>'


@pytest.mark.parametrize("declaration", [BOMB, EXTERNAL, FILE, "<!DOCTYPE x>"])
def test_declarations_are_refused(declaration):
    head, _, rest = FLAT.partition("\n")
    with pytest.raises(FileError, match="declares a document type"):
        eds.loads(f"{head}{declaration}\n{rest}".encode(), "x.xdd")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"<a>" * 70, "deeper than 64"),
        (b"<a>" + b"<b/>" * (MAX_ELEMENTS + 1) + b"</a>", "elements"),
        (b"<a>" + b" " * xdd.MAX_BYTES + b"</a>", "4 MiB"),
        (b"<a>", "is not XML: no element found"),
        (b"<a/>", "has no CANopenObjectList"),
        (b"<a>&lost;</a>", "is not XML"),
        (b'<?xml version="1.0" encoding="klingon"?><a/>', "is not readable XML"),
        (b'<?xml version="1.0" encoding="utf-7"?><a/>', "is not readable XML"),
        (b"<CANopenObjectList/>", "no object"),
    ],
)
def test_what_is_no_description_or_too_much_is_refused(data, words):
    with pytest.raises(FileError, match=words):
        eds.loads(data, "x.xdd")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "iso-8859-1", "windows-1252"])
def test_encodings_are_those_that_the_file_declares(encoding):
    text = FLAT.replace('encoding="utf-8"', f'encoding="{encoding}"').replace(">Flat<", ">Größe<")
    assert eds.loads(text.encode(encoding), "x.xdd").product_name == "Größe"


@given(st.binary(max_size=200), st.integers(0, len(FLAT)))
def test_anything_in_its_middle_is_read_or_refused(data, at):
    try:
        eds.loads(FLAT.encode()[:at] + data + FLAT.encode()[at:], "x.xdd")
    except FileError as error:
        assert error.problems  # noqa: PT017 - either may happen
