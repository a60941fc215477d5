"""The SDO server: every transfer, every way to go wrong, and that each leaves the server free (CiA 301, 7.2.4)."""

import struct

import pytest

from tests.conformance.sdo_client import (
    BLOCK_SIZE,
    CRC,
    DEVICE_STATE,
    INCOMPATIBLE,
    INVALID,
    LENGTH,
    MEMORY,
    SEQUENCE,
    TIMED_OUT,
    TOGGLE,
    TOO_LONG,
    TOO_SHORT,
    UNKNOWN_COMMAND,
    Abort,
    abort_of,
    place_bytes,
)

PRODUCER, NAME = 0x1017, 0x1008
IDLE, UPLOADING, DOWNLOADING = "idle", "uploading", "downloading"
BLOCKS = (1, 2, 3, 7, 8, 126, 127)
LENGTHS = (1, 4, 5, 7, 8, 13, 14, 15, 21, 100)


@pytest.fixture
def sdo(device):
    return device.sdo


@pytest.fixture
def text(device, needs):
    """Place of an entry that is uploaded in segments."""
    needs(NAME)
    if len(device.sdo.upload(NAME)) <= 4:
        pytest.skip("1008h is shorter than a segmented transfer")
    return NAME, 0


@pytest.fixture
def long(device):
    """Place of an entry that takes text of any length."""
    for (index, subindex), variable in sorted(device.entries.items()):
        if variable.data_type in {0x09, 0x0F} and variable.readable and variable.writable and not device.is_untouchable(index):
            device.is_touched = True
            before = device.sdo.upload(index, subindex)
            yield index, subindex
            device.sdo.download(index, subindex, before)
            return
    pytest.skip("the EDS has no writable entry of variable length")


@pytest.fixture
def producer(device, needs):
    """Place of an UNSIGNED16 that every value may be written to."""
    needs(PRODUCER)
    device.is_touched = True
    return PRODUCER, 0


def enter(sdo, state, text):
    """Bring the server into a state; the command that would go on from there."""
    if state == UPLOADING:
        sdo.request(b"\x40" + place_bytes(*text))
    elif state == DOWNLOADING:
        sdo.request(b"\x21" + place_bytes(PRODUCER, 0) + struct.pack("<I", 2))


def is_free(device, text):
    """Whether a whole transfer of either direction works."""
    return not isinstance(device.sdo.upload(*text), Abort) and device.sdo.download(PRODUCER, 0, b"\0\0", segmented=False) is None


# -- expedited ---------------------------------------------------------------------------------------------------------


def test_an_expedited_upload_says_how_many_bytes_are_meant(device, sdo):
    for (index, subindex), variable in device.entries.items():
        size = device.size(index, subindex)
        if variable.readable and size is not None and size <= 4 and index != 0x1003:
            answer = sdo.request(b"\x40" + place_bytes(index, subindex))
            assert answer[0] == 0x43 | 4 - size << 2, f"{index:04X}h:{subindex:02X}h: {answer.hex(' ')}"


def test_an_expedited_download_is_read_back(device, producer):
    for value in (0, 1, 0x1234, 0xFFFF, 0):
        device.set(*producer, value)
        assert device.read(*producer) == value


def test_an_expedited_download_without_a_size_takes_that_of_the_object(device, sdo, producer):
    answer = sdo.request(b"\x22" + place_bytes(*producer) + b"\x20\x03\0\0")
    assert answer == b"\x60" + place_bytes(*producer) + bytes(4)
    assert device.read(*producer) == 0x320


def test_a_server_answers_its_own_identifier_only(device, sdo, permit):
    permit("alone")
    mark = len(device.port.seen)
    other = 1 if device.node_id != 1 else 2
    device.port.send(0x600 + other, b"\x40\0\x10\0".ljust(8, b"\0"))
    assert sdo.is_silent()
    assert device.port.expect(0x580 + device.node_id, 0.0, mark) is None


# -- segmented ---------------------------------------------------------------------------------------------------------


def test_a_long_value_is_uploaded_in_segments_with_its_size_announced(sdo, text):
    answer = sdo.request(b"\x40" + place_bytes(*text))
    assert answer[0] == 0x41
    size = struct.unpack("<I", answer[4:])[0]
    assert len(sdo.upload(*text)) == size


def test_a_short_value_may_be_downloaded_in_segments(device, sdo, producer):
    assert sdo.download(*producer, b"\x10\x27", segmented=True) is None
    assert device.read(*producer) == 10000


@pytest.mark.parametrize("length", LENGTHS)
def test_a_long_value_of_any_length_is_downloaded_in_segments(sdo, long, length):
    value = bytes(0x20 + i % 90 for i in range(length))
    answer = sdo.download(*long, value, segmented=True)
    if answer == MEMORY:
        pytest.skip(f"the device has no room for {length} bytes")
    assert answer is None
    assert sdo.upload(*long) == value


def test_a_download_in_segments_may_leave_its_size_open(device, sdo, producer):
    answer = sdo.request(b"\x20" + place_bytes(*producer))
    assert answer[0] == 0x60
    assert sdo.download_segments(b"\x39\x05") is None
    assert device.read(*producer) == 0x539


@pytest.mark.parametrize(
    ("announced", "codes"), [(3, (TOO_LONG, LENGTH)), (1, (TOO_SHORT, LENGTH)), (2**32 - 1, (TOO_LONG, LENGTH, MEMORY))]
)
def test_a_size_that_is_not_the_objects_is_refused(device, sdo, producer, announced, codes):
    answer = sdo.request(b"\x21" + place_bytes(*producer) + struct.pack("<I", announced))
    if abort_of(answer) is None:
        answer = sdo.request(bytes((0x01 | 7 - min(announced, 7) << 1, *bytes(7))))
    assert device.refused(abort_of(answer), *codes)


@pytest.mark.parametrize(("sent", "codes"), [(1, (TOO_SHORT, LENGTH)), (3, (TOO_LONG, LENGTH))])
def test_other_bytes_than_announced_are_refused_and_change_nothing(device, sdo, producer, sent, codes):
    before = sdo.upload(*producer)
    sdo.request(b"\x21" + place_bytes(*producer) + struct.pack("<I", 2))
    answer = sdo.request(bytes((0x01 | 7 - sent << 1, 1, 1, 1)))
    assert device.refused(abort_of(answer), *codes)
    assert sdo.upload(*producer) == before


def test_a_toggle_bit_that_does_not_alternate_aborts_an_upload(device, sdo, text):
    enter(sdo, UPLOADING, text)
    assert device.refused(abort_of(sdo.request(b"\x70")), TOGGLE)
    assert device.refused(abort_of(sdo.request(b"\x60")), UNKNOWN_COMMAND)  # the transfer is over
    enter(sdo, UPLOADING, text)
    sdo.request(b"\x60")
    assert device.refused(abort_of(sdo.request(b"\x60")), TOGGLE, UNKNOWN_COMMAND)
    assert is_free(device, text)


def test_a_toggle_bit_that_does_not_alternate_aborts_a_download(device, sdo, text, producer):
    enter(sdo, DOWNLOADING, text)
    assert device.refused(abort_of(sdo.request(b"\x1b\x01\x02")), TOGGLE)
    assert device.refused(abort_of(sdo.request(b"\x0b\x01\x02")), UNKNOWN_COMMAND)
    assert is_free(device, text)


# -- any state ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("state", [IDLE, UPLOADING, DOWNLOADING])
def test_an_abort_of_the_client_ends_any_transfer_and_is_not_answered(device, sdo, text, producer, state):
    enter(sdo, state, text)
    sdo.abort(*producer)
    assert sdo.is_silent()
    for segment in (b"\x60", b"\x0b"):
        assert device.refused(abort_of(sdo.request(segment)), UNKNOWN_COMMAND)
    assert is_free(device, text)


@pytest.mark.parametrize("state", [UPLOADING, DOWNLOADING])
def test_a_new_transfer_takes_the_place_of_an_unfinished_one(device, sdo, text, producer, state):
    whole = sdo.upload(*text)
    enter(sdo, state, text)
    assert sdo.upload(*text) == whole
    enter(sdo, state, text)
    assert sdo.download(*producer, b"\x21\x03") is None
    assert device.read(*producer) == 0x321


@pytest.mark.parametrize("state", [IDLE, UPLOADING, DOWNLOADING])
@pytest.mark.parametrize("command", [0xE0, 0xFF])
def test_an_unknown_command_is_aborted_in_any_state(device, sdo, text, producer, state, command):
    enter(sdo, state, text)
    assert device.refused(abort_of(sdo.request(bytes((command,)))), UNKNOWN_COMMAND)
    assert is_free(device, text)


@pytest.mark.parametrize(("state", "command"), [(IDLE, 0x00), (IDLE, 0x60), (UPLOADING, 0x00), (DOWNLOADING, 0x60)])
def test_a_segment_of_a_transfer_that_is_not_going_on_is_aborted(device, sdo, text, producer, state, command):
    enter(sdo, state, text)
    assert device.refused(abort_of(sdo.request(bytes((command,)))), UNKNOWN_COMMAND)
    assert is_free(device, text)


@pytest.mark.parametrize("length", [0, 1, 4, 7])
def test_a_request_of_a_wrong_length_is_ignored(device, sdo, text, producer, length):
    device.port.send(sdo.request_id, b"\x40\0\x10\0\0\0\0\0"[:length])
    assert sdo.is_silent()
    assert is_free(device, text)


@pytest.mark.slow
@pytest.mark.parametrize("state", [UPLOADING, DOWNLOADING])
def test_a_client_that_falls_silent_is_given_up(device, sdo, text, producer, state):
    if not device.is_emulated:
        pytest.skip("the standard leaves the time open, or whether there is one")
    mark = len(device.port.seen)
    enter(sdo, state, text)
    answers = [heard for heard in device.port.during(30.0) if heard.can_id == sdo.response_id]
    assert abort_of(answers[-1].data) == TIMED_OUT
    assert sum(heard.can_id == sdo.response_id for heard in device.port.seen[mark:]) == 2
    assert is_free(device, text)


# -- block transfer ----------------------------------------------------------------------------------------------------


@pytest.fixture
def blocks(device, sdo, text):
    """Skip a device without block transfer, which is optional."""
    begun = sdo.begin_block_upload(*text)
    if begun == UNKNOWN_COMMAND:
        pytest.skip("the device has no block transfer")
    assert not isinstance(begun, Abort)
    sdo.abort(*text)


@pytest.mark.parametrize("block", BLOCKS)
def test_a_block_upload_of_any_block_size_brings_the_value(sdo, text, blocks, block):
    assert sdo.block_upload(*text, block) == sdo.upload(*text)


@pytest.mark.parametrize("block", [2, 3, 127])
def test_a_segment_that_is_lost_of_a_block_upload_is_sent_again(sdo, text, blocks, block):
    value = sdo.upload(*text)
    for lost in range(-(-len(value) // 7)):
        assert sdo.block_upload(*text, block, {lost}) == value, f"segment {lost} lost"


def test_a_request_right_after_the_end_of_a_block_upload_is_answered(sdo, text, producer, blocks):
    for _ in range(5):
        value = sdo.block_upload(*text)  # its last frame is the confirmation, which nothing answers
        assert sdo.upload(*text) == value
        sdo.block_upload(*text)
        assert sdo.download(*producer, b"\x01\0") is None


@pytest.mark.parametrize("block", [0, 128, 255])
def test_a_block_size_outside_of_1_to_127_is_refused(device, sdo, text, producer, blocks, block):
    assert device.refused(sdo.begin_block_upload(*text, block), BLOCK_SIZE)
    assert is_free(device, text)


@pytest.mark.parametrize("block", [0, 128])
def test_a_next_block_size_outside_of_1_to_127_is_refused(device, sdo, text, producer, blocks, block):
    sdo.begin_block_upload(*text, 1)
    mark = len(device.port.seen)
    sdo.send(b"\xa3")
    sdo.receive_block(1, mark)
    assert device.refused(abort_of(sdo.request(bytes((0xA2, 1, block)))), BLOCK_SIZE)
    assert is_free(device, text)


def test_more_segments_acknowledged_than_sent_are_refused(device, sdo, text, producer, blocks):
    sdo.begin_block_upload(*text, 1)
    mark = len(device.port.seen)
    sdo.send(b"\xa3")
    sdo.receive_block(1, mark)
    assert device.refused(abort_of(sdo.request(bytes((0xA2, 2, 1)))), SEQUENCE)
    assert is_free(device, text)


def test_the_size_of_a_block_upload_is_that_of_the_value(sdo, text, blocks):
    _, size = sdo.begin_block_upload(*text)
    sdo.abort(*text)
    assert size in {None, len(sdo.upload(*text))}


def test_an_abort_ends_a_block_upload_between_and_inside_blocks(device, sdo, text, producer, blocks):
    sdo.begin_block_upload(*text, 1)
    sdo.abort(*text)
    assert sdo.is_silent()
    sdo.begin_block_upload(*text, 1)
    sdo.send(b"\xa3")
    sdo.port.during(0.05)
    sdo.abort(*text)
    assert sdo.is_silent()
    assert is_free(device, text)


def test_a_new_transfer_takes_the_place_of_an_unfinished_block_transfer(device, sdo, text, producer, blocks):
    value = sdo.upload(*text)
    sdo.begin_block_upload(*text, 1)
    assert sdo.upload(*text) == value
    answer = sdo.request(b"\xc6" + place_bytes(*producer) + struct.pack("<I", 2))
    assert answer[0] & 0xFB == 0xA0
    # segments of a block have no command that could be told apart; the server ends the transfer by an abort of the client
    sdo.abort(*producer)
    assert is_free(device, text)


def test_a_block_download_of_a_short_value_is_read_back(device, sdo, producer, blocks):
    assert sdo.block_download(*producer, b"\x34\x12") is None
    assert device.read(*producer) == 0x1234


@pytest.mark.parametrize("length", [*LENGTHS, 889, 1000])
def test_a_block_download_of_any_length_is_read_back(sdo, long, blocks, length):
    value = bytes(0x20 + i % 90 for i in range(length))
    answer = sdo.block_download(*long, value)
    if answer == MEMORY:
        pytest.skip(f"the device has no room for {length} bytes")
    assert answer is None
    assert sdo.upload(*long) == value


def test_a_segment_that_is_lost_of_a_block_download_is_asked_for_again(sdo, long, blocks):
    value = bytes(0x20 + i % 90 for i in range(100))
    for lost in range(14):  # the fifteenth is the last, which a client must not lose in silence
        assert sdo.block_download(*long, value, {lost}) is None, f"segment {lost} lost"
        assert sdo.upload(*long) == value


def test_a_wrong_crc_is_refused_and_changes_nothing(device, sdo, producer, blocks):
    has_crc, _ = sdo.begin_block_upload(NAME)
    sdo.abort(NAME, 0)
    if not has_crc:
        pytest.skip("the device does not use the CRC")
    before = sdo.upload(*producer)
    assert device.refused(sdo.block_download(*producer, b"\x77\x07", wrong_crc=True), CRC)
    assert sdo.upload(*producer) == before


@pytest.mark.parametrize(("size", "codes"), [(1, (TOO_SHORT, LENGTH)), (3, (TOO_LONG, LENGTH))])
def test_a_block_download_of_a_wrong_size_is_refused(device, sdo, producer, blocks, size, codes):
    assert device.refused(sdo.block_download(*producer, bytes(size)), *codes)


# -- the second channel ------------------------------------------------------------------------------------------------


def test_the_default_channel_cannot_be_moved(device, sdo, needs):
    needs((0x1200, 1), (0x1200, 2))
    assert device.read(0x1200, 1) == 0x600 + device.node_id
    assert device.read(0x1200, 2) == 0x580 + device.node_id
    for sub in (1, 2):
        assert isinstance(device.write(0x1200, sub, 0x123), Abort)


def test_a_second_channel_answers_beside_the_first(device, sdo, needs, permit):
    permit("alone")
    needs((0x1201, 1), (0x1201, 2))
    device.set(0x1201, 1, 0x6A0)
    device.set(0x1201, 2, 0x6A1)
    mark = len(device.port.seen)
    device.port.send(0x6A0, b"\x40\0\x10\0\0\0\0\0")
    heard = device.port.expect(0x6A1, device.patience_s, mark)
    assert heard is not None
    assert heard.data[:4] == b"\x43\0\x10\0"
    assert not isinstance(sdo.upload(0x1000), Abort)


@pytest.mark.parametrize("sub", [1, 2])
@pytest.mark.parametrize("can_id", [0x000, 0x001, 0x07F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x6E0, 0x701, 0x7FF])
def test_a_second_channel_takes_no_restricted_identifier(device, needs, sub, can_id):
    needs((0x1201, sub))
    assert device.refused(device.write(0x1201, sub, can_id), INVALID, DEVICE_STATE, INCOMPATIBLE)
