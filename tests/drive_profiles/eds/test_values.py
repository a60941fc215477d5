"""What the text of a value is taken for: what has one reading is read, a guess is dropped, and neither in silence."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.eds import values

INTEGERS = sorted({**values.SIGNED, **values.UNSIGNED})
I8, I16, I32, U8, U16, U32, REAL32, REAL64 = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x08, 0x11


@pytest.mark.parametrize(
    ("text", "data_type", "wanted"),
    [
        ("0", U8, 0),
        ("-0", I8, 0),
        ("255", U8, 255),
        ("0xff", U8, 255),
        ("0XFF", U8, 255),
        ("-128", I8, -128),
        ("+5", I8, 5),
        ("001", U16, 1),
        ("00000000000000000", U32, 0),
        ("0x0000000000000005", U8, 5),
        ("$NODEID+0x180", U32, 0x180),
        ("$NODEID", U32, 0),
        ("1", 0x01, 1),
        ("1.5", REAL32, 1.5),
        ("-2e3", REAL64, -2000.0),
        (".5", REAL32, 0.5),
        ("0x0", REAL32, 0.0),
        ("0x40490FDB", REAL32, struct.unpack(">f", b"\x40\x49\x0f\xdb")[0]),
        ("text # and ; more", 0x09, "text # and ; more"),
        ("00 0A ff", 0x0A, b"\x00\x0a\xff"),
        ("", U8, None),
    ],
)
def test_what_the_standard_has_is_read_without_a_remark(text, data_type, wanted):
    reading = values.value(text, data_type)
    assert reading.value == wanted
    assert reading.remark == ""


@pytest.mark.parametrize(
    ("text", "data_type", "wanted", "words"),
    [
        ("0xFD", I8, -3, "read as -3, which has these bits"),
        ("253", I8, -3, "read as -3"),
        ("0xFFFD", I8, -3, "read as -3"),
        ("0xFFFFFFFD", I8, -3, "read as -3"),
        ("0xFFFFFFFFFFFFFFFD", I16, -3, "read as -3"),
        ("0x80000000", I32, -(2**31), "these bits"),
        ("0xFFFFFF", 0x10, -1, "these bits"),
        ("0x1FF", I8, None, "out of the range"),
        ("65536", U16, None, "out of the range"),
        ("-1", U16, None, "out of the range"),
        ("4294967296", U32, None, "out of the range"),
        ("010", U16, 8, "octal; read as 8, not 10"),
        ("-010", I16, -8, "octal; read as -8"),
        ("019", U16, 19, "8 and 9 are not octal digits; read as 19"),
        ("5u", U16, 5, "suffix u"),
        ("0x10LL", U16, 16, "suffix LL"),
        ("7ULL", U16, 7, "suffix ULL"),
        ("7.0", U16, 7, "read as 7"),
        ("7.5", U16, None, "not a whole number"),
        ("1e999", U16, None, "not a whole number"),
        ("5 # five", U16, 5, "comment"),
        ("5;five", U16, 5, "comment"),
        ("# nothing", U16, None, "not a number"),
        ("4x0", U16, None, "not a number"),
        ("No", U16, None, "not a number"),
        ("9" * 5000, U16, None, "too long"),
        ("0000 0080h", U32, 0x80, "hexadecimal"),
        ("0x180+$NODEID", U32, 0x180, "read as $NODEID+0x180"),
        ("$NodeID + 0x80", U32, 0x80, "read as $NODEID+0x80"),
        ("$nodeid", U32, 0, "read as"),
        ("$NODEID+$NODEID", U32, None, "not understood"),
        ("$NODEID+", U32, None, "not understood"),
        ("$NODEID-5", U32, None, "not understood"),
        ("2*$NODEID", U32, None, "not understood"),
        ("true", 0x01, 1, "read as 1"),
        ("2", 0x01, None, "out of the range"),
        ("0x7F800000", REAL32, None, "no finite number"),
        ("0x64", REAL32, None, "not a bit pattern"),
        ("1e39", REAL32, None, "out of the range"),
        ("1e999", REAL64, None, "out of the range"),
        ("nan", REAL64, None, "not a number"),
        ("0,5", REAL32, None, "not a number"),
        ("0x0", 0x0F, None, "not pairs"),
        ("0x00FF", 0x0A, b"\x00\xff", "without its 0x"),
        ("x" * 1025, 0x09, None, "1025 characters"),
    ],
)
def test_what_is_unlike_the_standard_is_read_or_dropped_with_a_remark(text, data_type, wanted, words):
    reading = values.value(text, data_type)
    assert reading.value == wanted
    assert words in reading.remark


def test_the_node_id_is_added_and_marked():
    assert values.integer("$NODEID+0x180", U32, 5) == values.ValueReading(0x185, relative=True)
    assert values.integer("$NODEID+0x180", U32).relative


@pytest.mark.parametrize(
    ("text", "wanted", "remarked"),
    [("rw", "rw", False), ("RWR", "rwr", False), ("Const", "const", False), ("rww", "rww", False), ("rw # rw;", "rw", True),
     ("read/write", "rw", True), ("r", "ro", True), ("never", None, True), ("", None, True)],
)  # fmt: skip
def test_access_words(text, wanted, remarked):
    reading = values.access(text)
    assert reading.value == wanted
    assert bool(reading.remark) is remarked


@given(st.data())
def test_a_written_value_is_read_as_the_same_and_without_a_remark(data):
    data_type = data.draw(st.sampled_from([*INTEGERS, 0x01, REAL32, REAL64, 0x0A, 0x0F]))
    limits = values.limits_of(data_type)
    if limits is not None:
        value = data.draw(st.integers(*limits))
    elif data_type in values.REALS:
        value = data.draw(st.floats(allow_nan=False, allow_infinity=False, width=values.REALS[data_type]))
    else:
        value = data.draw(st.binary(min_size=1, max_size=40))
    reading = values.value(values.text_of(value, data_type), data_type)
    assert reading == values.ValueReading(value)


@given(st.text(max_size=80), st.sampled_from([*values.NAMES, 0x99]))
def test_no_text_raises_and_no_number_is_out_of_its_range(text, data_type):
    reading = values.value(text, data_type, 5)
    limits = values.limits_of(data_type)
    if limits is not None and reading.value is not None:
        assert limits[0] <= reading.value <= limits[1]
    if isinstance(reading.value, float):
        assert math.isfinite(reading.value)
    assert not (text and reading.value is None and not reading.remark)


@given(st.sampled_from(sorted(values.SIGNED)), st.data())
def test_a_bit_pattern_is_the_number_that_it_stands_for(data_type, data):
    width = values.SIGNED[data_type]
    number = data.draw(st.integers(-(1 << width - 1), (1 << width - 1) - 1))
    assert values.value(f"0x{number & (1 << width) - 1:X}", data_type).value == number


@pytest.mark.parametrize(
    ("value", "data_type"),
    [(256, U8), (True, 0x01), (1, REAL32), (math.nan, REAL32), (math.inf, REAL64), (1e39, REAL32), ("", 0x09), (" a", 0x09),
     ("a\nb", 0x09),      ("\x1b[2J", 0x09), (b"", 0x0A), ("x", U8), (b"x", U8), (1.0, U8), ("x" * 1025, 0x09)],
)  # fmt: skip
def test_what_cannot_be_written_so_that_it_is_read_again_is_refused(value, data_type):
    with pytest.raises(ValueError, match=r"."):
        values.text_of(value, data_type)
