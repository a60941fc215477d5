"""Lines, sections and keys, with their places; every byte is kept."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.eds import text as eds_text
from drive_profiles.eds.text import Findings, Replacement, read, section_id
from drive_profiles.errors import FileError

PATH = Path("some.eds")
SMALL = "[1000]\nParameterName=Größe\nDataType=7\n"


def parsed(data: bytes):
    findings = Findings()
    return read(data, PATH, findings), findings


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_every_line_end_is_understood(end):
    document, findings = parsed(SMALL.replace("\n", end).encode())
    assert [entry.line for entry in document.sections["1000"].entries.values()] == [2, 3]
    assert not findings.warnings


@pytest.mark.parametrize(
    ("data", "encoding"),
    [
        (SMALL.encode(), "utf-8"),
        (b"\xef\xbb\xbf" + SMALL.encode(), "utf-8"),
        (SMALL.encode("cp1252"), "cp1252"),
        (SMALL.encode("cp850"), "cp850"),
        (SMALL.encode("cp1252") + b";\x81\r\n", "cp850"),
        (SMALL.encode("cp1252") + b"; \xa0\xb5m \xb1\n", "cp1252"),
        (b"\xff\xfe" + SMALL.encode("utf-16-le"), "utf-16-le"),
        (b"\xfe\xff" + SMALL.encode("utf-16-be"), "utf-16-be"),
    ],
)
def test_every_encoding_is_read_named_and_kept(data, encoding):
    document, findings = parsed(data)
    assert document.encoding == encoding
    assert "1000" in document.sections
    if b"\x81" not in data:
        assert document.sections["1000"].text("ParameterName") == "Größe"
    assert bool(findings.warnings) is (encoding != "utf-8")
    assert document.rewritten({}, {}) == data


@given(st.binary(max_size=300))
def test_any_bytes_are_given_back_or_refused(data):
    try:
        document, _ = parsed(data)
    except FileError:
        return
    assert document.rewritten({}, {}) == data


@pytest.mark.parametrize(
    ("name", "wanted"),
    [("1A00sub0", "1A00sub0"), ("1a00Sub00", "1A00sub0"), ("1A00SUB1f", "1A00sub1F"), ("100a", "100A"),
     ("1016Value", "1016value"),
     ("40", "0040"), ("A0sub1", "00A0sub1"), ("Device Info", "deviceinfo"), ("DeviceComissioning", "devicecomissioning"),
     ("1000sub123456789", "1000sub123456789"), ("12345", "12345")],
)  # fmt: skip
def test_spellings_of_one_section_are_one(name, wanted):
    assert section_id(name) == wanted


def test_the_first_of_two_counts_and_both_lines_are_named():
    document, findings = parsed(b"[1000]\nDataType=7\ndatatype=5\nDataType=7\n[1000]\nAccessType=ro\nDataType=6\n")
    section = document.sections["1000"]
    assert (section.text("DataType"), section.text("AccessType")) == ("7", "ro")
    assert [(problem.line, problem.message) for problem in findings.warnings] == [
        (3, "'5' is ignored; '7' is taken from line 2"),
        (4, "repeats line 2"),
        (6, "taken from a second [1000], line 5; the first is in line 1"),
        (7, "'6' is ignored; '7' is taken from line 2"),
    ]


def test_a_value_is_replaced_and_all_around_it_stays():
    data = b"[1000]\r\nParameterValue =  5 # five\r\n[1001]\nName=\ta ; b \n[1002]"
    document, _ = parsed(data)
    new = document.rewritten({2: Replacement("66", keeps_comment=True), 4: Replacement("c", keeps_comment=False)}, {5: ["X=1"]})
    assert new == b"[1000]\r\nParameterValue =  66 # five\r\n[1001]\nName=\tc \n[1002]\r\nX=1\r\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"x" * (eds_text.MAX_BYTES + 1), "larger than 4 MiB"),
        (b"".join(b"[S%d]\n" % number for number in range(eds_text.MAX_SECTIONS + 1)), "too many sections"),
        (b"[S]\n" + b"".join(b"%d=\n" % number for number in range(eds_text.MAX_ENTRIES + 1)), "too many keys"),
        (b"\xff\xfea", "UTF-16"),
    ],
)
def test_what_is_out_of_bounds_is_refused(data, words):
    with pytest.raises(FileError, match=words):
        parsed(data)


def test_a_line_beyond_all_measure_is_passed_over_with_a_warning():
    document, findings = parsed(b"[1000]\nParameterName=" + b"x" * 5000 + b"\nDataType=7\n")
    assert list(document.sections["1000"].entries) == ["datatype"]
    assert "5015 characters" in findings.warnings[0].message


def test_problems_are_counted_beyond_the_bound():
    _, findings = parsed(b"[S]\n" + b"?\n" * (eds_text.MAX_PROBLEMS + 7))
    warnings, _ = findings.closed()
    assert len(warnings) == eds_text.MAX_PROBLEMS + 1
    assert "7 more problems" in warnings[-1].message


def test_messages_hold_no_control_characters():
    _, findings = parsed(b"[\x1b[2J]\n\x1b]0;x\x07\n")
    assert all(part.isprintable() for problem in findings.warnings for part in (problem.key, problem.message))
