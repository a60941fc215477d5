"""The length of a frame on the wire: counted by hand, against published worst cases, and between both for every frame."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, Frame
from plant_emulator.bus.bits import crc15, frame_bits, stuff_bits, worst_case_bits

STANDARD = st.integers(0, 0x7FF)
EXTENDED = st.integers(0, 0x1FFF_FFFF).map(lambda i: i | CAN_EFF_FLAG)
DATA = st.binary(max_size=8)


def as_sent(frame):
    """The bits from SOF to CRC as text, put together from the standard's figure: slow and plain."""
    can_id, data = frame
    remote = "1" if can_id & CAN_RTR_FLAG else "0"
    if can_id & CAN_EFF_FLAG:
        identifier = f"{can_id & 0x1FFF_FFFF:029b}"
        header = "0" + identifier[:11] + "11" + identifier[11:] + remote + "00"
    else:
        header = "0" + f"{can_id & 0x7FF:011b}" + remote + "00"
    text = header + f"{len(data):04b}" + ("" if remote == "1" else "".join(f"{byte:08b}" for byte in data))
    remainder = int(text, 2) << 15  # the CRC as what a division leaves
    for shift in range(len(text) - 1, -1, -1):
        if remainder >> (shift + 15) & 1:
            remainder ^= 0xC599 << shift
    return text + f"{remainder:015b}"


def stuffed(text):
    """The same with the stuff bits in their places."""
    out = ""
    for bit in text:
        out += bit
        if len(out) >= 5 and len(set(out[-5:])) == 1:
            out += "1" if bit == "0" else "0"
    return out


def test_the_empty_frame_with_identifier_0_is_counted_by_hand():
    # SOF, identifier, RTR, IDE, r0 and DLC are 19 dominant bits, and so is their CRC: 34 bits of one value.
    # Stuffed 00000 1 00000 1 …: a stuff bit after each five, 6 of them; then 13 bits of tail.
    assert crc15(0, 19) == 0
    assert stuff_bits(0, 34) == 6
    assert frame_bits(Frame(0, b"")) == 34 + 6 + 13
    assert frame_bits(Frame(0, b""), stuffed=False) == 47


def test_sync_is_counted_by_hand():
    # header 0000 1 00000000000000, CRC 001110000000101 by long division; a stuff bit (in brackets) after each five equal bits:
    # 0000 1 00000[1] 00000[1] 0000 0[1] 0 111 00000[1] 00 101
    text = "0000100000000000000" + "001110000000101"
    assert as_sent(Frame(0x080, b"")) == text
    assert crc15(int(text[:19], 2), 19) == int(text[19:], 2)
    assert stuffed(text) == "0000100000" + "1" + "00000" + "1" + "00000" + "1" + "011100000" + "1" + "00101"
    assert frame_bits(Frame(0x080, b"")) == 34 + 4 + 13


def test_the_crc_is_that_of_the_published_check_value():
    # CRC-15/CAN: polynomial 4599h, start 0, no reflection; "123456789" gives 059Eh (catalogue of parametrised CRC algorithms)
    assert crc15(int.from_bytes(b"123456789", "big"), 72) == 0x059E


@pytest.mark.parametrize(
    ("text", "inserted"),
    [
        ("0000", 0),
        ("00000", 1),
        ("11111", 1),
        ("0000011111", 2),
        ("00000111101111", 2),
        ("0000011110000", 3),
        ("000001111", 2),
        ("0101010101", 0),
    ],
)
def test_a_stuff_bit_follows_five_equal_bits_and_counts_for_the_next_five(text, inserted):
    assert stuff_bits(int(text, 2), len(text)) == inserted == len(stuffed(text)) - len(text)


@pytest.mark.parametrize(("length", "bits"), [(0, 55), (1, 65), (2, 75), (4, 95), (6, 115), (8, 135)])
def test_the_worst_cases_of_11_bit_identifiers_are_the_published_ones(length, bits):
    assert worst_case_bits(length) == bits


@pytest.mark.parametrize(("length", "bits"), [(0, 80), (8, 160)])
def test_the_worst_cases_of_29_bit_identifiers_are_the_published_ones(length, bits):
    assert worst_case_bits(length, extended=True) == bits


@pytest.mark.parametrize(("can_id", "data", "bits"), [(0x201, bytes(8), 111), (0x1234 | CAN_EFF_FLAG, bytes(8), 131)])
def test_without_stuff_bits_the_length_follows_from_the_layout(can_id, data, bits):
    assert frame_bits(Frame(can_id, data), stuffed=False) == bits


@given(STANDARD | EXTENDED, DATA, st.booleans())
def test_the_actual_length_is_that_of_the_bits_written_out(can_id, data, is_remote):
    frame = Frame(can_id | (CAN_RTR_FLAG if is_remote else 0), data)
    assert frame_bits(frame) == len(stuffed(as_sent(frame))) + 13


@given(STANDARD | EXTENDED, DATA)
def test_the_actual_length_lies_between_no_stuff_bits_and_the_worst_case(can_id, data):
    frame = Frame(can_id, data)
    worst = worst_case_bits(len(data), extended=bool(can_id & CAN_EFF_FLAG))
    assert frame_bits(frame, stuffed=False) <= frame_bits(frame) <= worst


@given(STANDARD, DATA)
def test_a_remote_frame_has_no_data_on_the_wire(can_id, data):
    remote = Frame(can_id | CAN_RTR_FLAG, data)
    assert frame_bits(remote, stuffed=False) == 47
    assert frame_bits(remote) <= worst_case_bits(0)


@pytest.mark.parametrize("frame", [Frame(0x800, b""), Frame(1 | CAN_ERR_FLAG, bytes(8)), Frame(1, bytes(9)), Frame(-1, b"")])
def test_what_cannot_be_on_the_wire_has_no_length(frame):
    with pytest.raises(ValueError, match=r"identifier|wire|bytes"):
        frame_bits(frame)


@pytest.mark.parametrize("length", [-1, 9])
def test_there_is_no_worst_case_of_a_length_that_no_frame_has(length):
    with pytest.raises(ValueError, match=str(length)):
        worst_case_bits(length)
