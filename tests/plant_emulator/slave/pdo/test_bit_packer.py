"""Bits side by side: against `struct` where both can, and against a string of bits everywhere."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_profiles.standard.cia301 import PACKERS, DataType, decode, encode
from plant_emulator.slave.pdo.setup import BitPacker, bits_of

TYPES = sorted(PACKERS)

fields = st.lists(
    st.sampled_from(TYPES).map(lambda kind: (kind, bits_of(kind))) | st.tuples(st.none(), st.integers(1, 64)), max_size=12
)


def value_of(draw, kind):
    """Any value of a type, from any bytes that can be one."""
    if kind is DataType.BOOLEAN:
        return draw(st.booleans())
    return decode(kind, draw(st.binary(min_size=kind.size, max_size=kind.size)))


@st.composite
def layouts(draw):
    chosen = draw(fields)
    return chosen, [value_of(draw, kind) for kind, _ in chosen if kind is not None]


def as_text(chosen, values):
    """The frame as the standard draws it: one character a bit, the least significant of the first object rightmost."""
    text, rest = "", iter(values)
    for kind, bits in chosen:
        number = 0 if kind is None else int.from_bytes(encode(kind, next(rest)), "little")
        text = f"{number:0{bits}b}"[-bits:] + text
    text = text.rjust(-(-len(text) // 8) * 8, "0")
    return bytes(int(text[i : i + 8], 2) for i in range(len(text) - 8, -1, -8))


@settings(max_examples=200)
@given(layouts())
def test_any_layout_is_packed_as_a_string_of_bits_would_be_and_comes_back(layout):
    chosen, values = layout
    packer = BitPacker(chosen)
    data = packer.pack(*values)
    assert data == as_text(chosen, values)
    assert len(data) == packer.size
    again = packer.unpack_from(data + b"\xff")
    assert [repr(value) for value in again] == [repr(value) for value in values]  # NaN is not equal to itself


@settings(max_examples=50)
@given(st.lists(st.sampled_from([kind for kind in TYPES if kind is not DataType.BOOLEAN]), max_size=8), st.data())
def test_whole_bytes_are_packed_as_struct_does(kinds, data):
    packer = struct.Struct("<" + "".join(kind.struct_format for kind in kinds))
    values = [value_of(data.draw, kind) for kind in kinds]
    bits = BitPacker([(kind, bits_of(kind)) for kind in kinds])
    assert (bits.size, bits.pack(*values)) == (packer.size, packer.pack(*values))


def test_the_first_object_lies_lowest():
    # CiA 301, 7.5.2.36: BOOLEAN, UNSIGNED8 and BOOLEAN are ten bits, in two bytes.
    packer = BitPacker([(DataType.BOOLEAN, 1), (DataType.UNSIGNED8, 8), (DataType.BOOLEAN, 1)])
    assert packer.size == 2
    assert packer.pack(True, 0x81, False) == b"\x03\x01"
    assert packer.pack(False, 0, True) == b"\x00\x02"
    assert packer.unpack_from(b"\x03\xfd") == (True, 0x81, False)


def test_a_gap_takes_its_bits_and_has_no_value():
    packer = BitPacker([(None, 3), (DataType.INTEGER8, 8), (None, 2)])
    assert packer.pack(-1) == b"\xf8\x07"
    assert packer.unpack_from(b"\xff\xff") == (-1,)


def test_a_value_that_its_field_cannot_hold_is_the_callers_mistake():
    packer = BitPacker([(DataType.BOOLEAN, 1), (DataType.INTEGER8, 8)])
    with pytest.raises(ValueError, match="128"):
        packer.pack(True, 128)
    with pytest.raises(ValueError, match="argument"):
        packer.pack(True)


def test_a_type_without_fixed_length_takes_no_bits():
    assert bits_of(DataType.DOMAIN) == 0
    assert (bits_of(DataType.BOOLEAN), bits_of(DataType.REAL64)) == (1, 64)
