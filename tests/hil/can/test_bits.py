"""The length of a frame on the wire: counted by hand, against published worst cases, and between both for every frame."""

import itertools
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.can.bits import (
    arbitration_key,
    duration_ns,
    fd_bits,
    fd_sent_bits,
    frame_bits,
    sent_bits,
    worst_case_bits,
)
from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, Frame
from tests.oracles.can_fd import counted_fd, crc_of, sent_by_fd

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
    return text + f"{crc15(text):015b}"


def crc15(text):
    """The CRC as what a division leaves."""
    remainder = int(text, 2) << 15
    for shift in range(len(text) - 1, -1, -1):
        if remainder >> (shift + 15) & 1:
            remainder ^= 0xC599 << shift
    return remainder


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
    assert sent_bits(Frame(0, b"")) == "000001" * 6 + "0000"
    assert frame_bits(Frame(0, b"")) == 34 + 6 + 13
    assert frame_bits(Frame(0, b""), stuffed=False) == 47


def test_sync_is_counted_by_hand():
    # header 0000 1 00000000000000, CRC 001110000000101 by long division; a stuff bit (in brackets) after each five equal bits:
    # 0000 1 00000[1] 00000[1] 0000 0[1] 0 111 00000[1] 00 101
    text = "0000100000000000000" + "001110000000101"
    assert as_sent(Frame(0x080, b"")) == text
    sent = "0000100000" + "1" + "00000" + "1" + "00000" + "1" + "011100000" + "1" + "00101"
    assert sent_bits(Frame(0x080, b"")) == stuffed(text) == sent
    assert frame_bits(Frame(0x080, b"")) == 34 + 4 + 13


def test_the_crc_of_the_written_out_bits_is_that_of_the_published_check_value():
    # CRC-15/CAN: polynomial 4599h, start 0, no reflection; "123456789" gives 059Eh (catalogue of parametrised CRC algorithms)
    assert crc15(f"{int.from_bytes(b'123456789', 'big'):072b}") == 0x059E


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
def test_the_bits_are_those_written_out_and_so_is_their_number(can_id, data, is_remote):
    frame = Frame(can_id | (CAN_RTR_FLAG if is_remote else 0), data)
    assert sent_bits(frame) == stuffed(as_sent(frame))
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


def sent_bit_by_bit(can_id, data, is_remote, is_extended):
    """A sender as the standard tells it: fields, a CRC register shifted once per bit, a counter of equal bits."""
    fields = [(0, 1)]
    if is_extended:
        fields += [(can_id >> 18, 11), (1, 1), (1, 1), (can_id % 2**18, 18), (int(is_remote), 1), (0, 2)]
    else:
        fields += [(can_id, 11), (int(is_remote), 1), (0, 2)]
    fields += [(len(data), 4)] + ([] if is_remote else [(byte, 8) for byte in data])
    bits = [value // 2**k % 2 for value, width in fields for k in reversed(range(width))]
    register = [0] * 15
    for bit in bits:
        carry = bit ^ register[0]
        register = [*register[1:], 0]
        if carry:  # 4599h = 100 0101 1001 1001b
            register = [have ^ tap for have, tap in zip(register, (1, 0, 0, 0, 1, 0, 1, 1, 0, 0, 1, 1, 0, 0, 1), strict=True)]
    sent, equal = [], 0
    for bit in bits + register:
        equal = equal + 1 if sent and sent[-1] == bit else 1
        sent.append(bit)
        if equal == 5:
            sent.append(1 - bit)
            equal = 1
    return sent


@pytest.mark.slow
def test_100_000_random_frames_are_as_long_as_a_second_implementation_says():
    chance = random.Random(11898)
    for _ in range(100_000):
        is_extended, is_remote = chance.random() < 0.3, chance.random() < 0.1
        can_id = chance.getrandbits(29 if is_extended else 11) & chance.choice([-1, 0x1F000000, 0x1F, 0])
        data = bytes(chance.choice([0, 255, chance.getrandbits(8)]) for _ in range(chance.randrange(9)))
        expected = sent_bit_by_bit(can_id, data, is_remote, is_extended)
        frame = Frame(can_id | (CAN_EFF_FLAG if is_extended else 0) | (CAN_RTR_FLAG if is_remote else 0), data)
        assert frame_bits(frame) == len(expected) + 13
        if chance.random() < 0.02:
            assert sent_bits(frame) == "".join(map(str, expected))


def test_a_frame_lasts_as_many_bits_as_it_has_rounded_up():
    frame = Frame(0, b"")
    assert duration_ns(frame, 1_000_000) == 53_000
    assert duration_ns(frame, 83_333) == -(-53 * 10**9 // 83_333)


@given(STANDARD | EXTENDED, STANDARD | EXTENDED, st.booleans(), st.booleans())
def test_the_key_orders_frames_as_their_first_different_bit_does(one, other, one_remote, other_remote):
    frames = [Frame(one | CAN_RTR_FLAG * one_remote, b""), Frame(other | CAN_RTR_FLAG * other_remote, b"")]
    first, second = (as_sent(frame)[1:33] if frame.can_id & CAN_EFF_FLAG else as_sent(frame)[1:14] for frame in frames)
    bits = list(itertools.takewhile(lambda pair: pair[0] == pair[1], zip(first, second, strict=False)))
    keys = [arbitration_key(frame.can_id) for frame in frames]
    if len(bits) == min(len(first), len(second)):
        assert keys[0] == keys[1]
        assert frames[0].can_id == frames[1].can_id
    else:
        assert (keys[0] < keys[1]) == (first[len(bits)] < second[len(bits)])


# --- CAN FD ---


def test_the_crc_of_can_fd_is_that_of_the_published_check_value():
    # CRC-17/CAN-FD of the catalogue of parametrised CRC algorithms; it starts at 0, the standard with a leading 1
    assert crc_of(f"{int.from_bytes(b'123456789', 'big'):072b}", 17, set()) == f"{0x04F03:017b}"


def counted(can_id, data, is_extended=False):
    """Bits at the slow and at the fast rate, with the intermission."""
    return fd_bits(can_id, data, extended=is_extended)


# sizes without stuff bits by contents, with intermission: header + data + CRC field + 9 + 3 of Linux' length.h
LINUX_HEADER = {False: 22, True: 41}
LINUX_CRC_FIELD = 28


@pytest.mark.ci
@given(st.integers(0, 0x7FF), st.integers(0, 8), st.booleans(), st.data())
def test_a_can_fd_frame_lies_between_the_least_and_the_most_that_linux_counts(can_id, length, is_extended, draw):
    data = draw.draw(st.binary(min_size=length, max_size=length) | st.just(bytes(length)))
    stuffable = LINUX_HEADER[is_extended] + 8 * length
    fixed = LINUX_CRC_FIELD + 9 + 3
    assert stuffable + fixed <= sum(counted(can_id, data, is_extended)) <= stuffable + (stuffable - 1) // 4 + fixed


@pytest.mark.parametrize("length", range(9))
def test_alternating_bits_need_no_stuff_bits_but_the_fixed_ones(length):
    # 555h after SOF 0 is 10101010101; RRS, IDE 00, FDF 1, res 0, BRS 1, ESI 0; only a DLC with a run of 5 could need one
    assert counted(0x555, b"\x55" * length) == (17 + 12, 5 + 8 * length + LINUX_CRC_FIELD)


@pytest.mark.slow
def test_5_000_random_can_fd_frames_are_what_a_second_implementation_sends():
    chance = random.Random(2015)
    for _ in range(5_000):
        is_extended = chance.random() < 0.5
        can_id = chance.getrandbits(29 if is_extended else 11) & chance.choice([-1, 0x1F])
        data = bytes(chance.choice([0, 255, chance.getrandbits(8)]) for _ in range(chance.randrange(9)))
        assert counted(can_id, data, is_extended) == counted_fd(can_id, data, is_extended)
        if chance.random() < 0.02:
            expected = "".join(bit for bit, _ in sent_by_fd(can_id, data, is_extended))
            assert fd_sent_bits(can_id, data, extended=is_extended) == expected


@given(st.integers(0, 0x7FF), DATA)
def test_a_can_fd_frame_is_as_long_as_a_second_implementation_sends_it(can_id, data):
    assert counted(can_id, data) == counted_fd(can_id, data)
    assert fd_sent_bits(can_id, data) == "".join(bit for bit, _ in sent_by_fd(can_id, data))


def test_the_empty_can_fd_frame_with_identifier_0_is_counted_by_hand():
    # 00000[1] 00000[1] 0000 | FDF 1 res 0 BRS 1 → SOF … IDE are 14 bits: stuff bits after 5 and, itself a 1, after the next 5
    # ESI, DLC 00000 end the contents: the bit that would follow them is the fixed one. 14 + 2 + 3 nominal, then 12 of the end.
    assert counted(0, b"") == (14 + 2 + 3 + 12, 5 + 28)
    assert fd_sent_bits(0, b"").startswith("000001000001000010100000" + "1" + "0110" + "1")


@pytest.mark.parametrize(
    ("can_id", "data", "is_extended"), [(0x800, b"", False), (1 << 29, b"", True), (-1, b"", False), (1, bytes(9), False)]
)
def test_what_a_can_fd_bus_does_not_send_has_no_length(can_id, data, is_extended):
    with pytest.raises(ValueError, match=r"identifier|expected at most 8"):
        counted(can_id, data, is_extended)
