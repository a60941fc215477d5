"""The record of a frame, held against Linux's layout of struct can_frame."""

import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, RECORD, Frame, pack, unpack


@given(st.integers(0, 0x7FF), st.binary(max_size=8), st.sampled_from([0, CAN_RTR_FLAG, CAN_EFF_FLAG, CAN_ERR_FLAG]))
def test_unpack_is_the_inverse_of_pack(can_id, data, flag):
    frame = Frame(can_id | flag, data)
    record = pack(frame)
    assert len(record) == RECORD.size == 16
    assert unpack(record) == frame


def test_the_record_is_struct_can_frame():
    assert pack(Frame(0x181, b"\x01\x02")) == (0x181).to_bytes(4, sys.byteorder) + bytes.fromhex("02 000000 0102000000000000")


@given(st.binary(max_size=32))
def test_no_record_makes_unpack_raise(record):
    frame = unpack(record)
    assert (frame is None) == (len(record) != 16 or record[4] > 8)
    assert frame is None or len(frame.data) == record[4]


@pytest.mark.parametrize("can_id", [-1, -(2**31), 0x800, 0x1FFFFFFF, 0x800 | CAN_RTR_FLAG, 1 << 32])
def test_an_identifier_that_needs_29_bits_must_say_so(can_id):
    with pytest.raises(ValueError, match="identifier"):
        pack(Frame(can_id, b""))


def test_29_bits_with_the_flag_are_accepted():
    frame = Frame(0x1FFFFFFF | CAN_EFF_FLAG, bytes(8))
    assert unpack(pack(frame)) == frame


def test_nine_bytes_are_refused():
    with pytest.raises(ValueError, match="at most 8"):
        pack(Frame(1, bytes(9)))


@pytest.mark.parametrize("length", [9, 64, 255])
def test_a_record_that_announces_more_than_eight_bytes_is_no_frame(length):
    record = bytearray(pack(Frame(1, bytes(8))))
    record[4] = length
    assert unpack(bytes(record)) is None
