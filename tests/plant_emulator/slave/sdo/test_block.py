"""SDO block transfer frame by frame, then over a wire that loses segments, then with the canopen package as client."""

import struct

import canopen
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drive_profiles.standard.cia301 import SdoAbortCode
from hil.can.frame import Frame
from plant_emulator.drive.dictionary.manufacturer_objects import USER_TEXT
from plant_emulator.slave.dictionary import Postponed
from plant_emulator.slave.sdo.block import BlockDownload, BlockUpload, crc_of
from plant_emulator.slave.sdo.server import SdoServer, SdoState
from tests.plant_emulator.rig import Rig, Stranger
from tests.plant_emulator.slave.sdo.sdo_rig import (
    BLOB,
    KEY,
    LABEL,
    LIMITED,
    NODE,
    SECOND,
    STATUS,
    TEXT,
    WIDE,
    BlockClient,
    Wire,
    abort,
    ask,
    ask_all,
    crc16,
    make_server,
)

MS = 1_000_000
REST = bytes(7)


@pytest.fixture
def server():
    return make_server()[0]


# -- frames, beside their clauses --------------------------------------------------------------------------------------


def test_a_block_download_is_as_the_standard_draws_it():
    server, dictionary = make_server()
    # 7.2.4.3.9: ccs 6, cc 1, s 1, cs 0; index, sub-index, size 9. Answered scs 5, sc 1, ss 0, a block of 2.
    assert ask(server, 0xC6, *LABEL, 9, 0, 0, 0) == bytes((0xA4, *LABEL, 2, 0, 0, 0))
    # 7.2.4.3.10: c, seqno, data; the last of the sub-block is answered scs 5, ss 2, ackseq, blksize.
    assert ask(server, 0x01, *b"1234567") is None
    assert ask(server, 0x82, *b"89") == bytes((0xA2, 2, 2, 0, 0, 0, 0, 0))
    # 7.2.4.3.11: ccs 6, n 5, cs 1, the checksum that the standard gives for the test string (7.2.4.3.16). Answered scs 5, ss 1.
    assert dictionary.get(0x2001) == TEXT
    assert ask(server, 0xC1 | 5 << 2, 0xC3, 0x31) == bytes((0xA1, *REST))
    assert dictionary.get(0x2001) == "123456789"
    assert (server.state, server.due, server.buffered_bytes) == (SdoState.IDLE, None, 0)


def test_a_block_upload_is_as_the_standard_draws_it():
    server, dictionary = make_server()
    dictionary.set(0x2001, 0, "123456789")
    # 7.2.4.3.12: ccs 5, cc 1, cs 0; index, sub-index, blksize 1, pst 0. Answered scs 6, sc 1, s 1, ss 0, size 9; then cs 3.
    assert ask(server, 0xA4, *LABEL, 1, 0) == bytes((0xC6, *LABEL, 9, 0, 0, 0))
    # 7.2.4.3.13: c, seqno, data; answered ccs 5, cs 2, ackseq, blksize.
    assert ask(server, 0xA3) == b"\x011234567"
    assert ask(server, 0xA2, 1, 127) == b"\x8189\0\0\0\0\0"
    # 7.2.4.3.14: scs 6, n 5, ss 1, checksum; answered ccs 5, cs 1, after which there is silence.
    assert ask(server, 0xA2, 1, 127) == bytes((0xC1 | 5 << 2, 0xC3, 0x31, 0, 0, 0, 0, 0))
    assert ask(server, 0xA1) is None
    assert (server.state, server.due) == (SdoState.IDLE, None)


def test_the_checksum_is_the_standards_and_its_test_value_is_31c3h():
    assert crc_of(b"123456789") == crc16(b"123456789") == 0x31C3
    assert crc_of(b"") == 0


def test_without_the_clients_checksum_there_is_none():
    server, dictionary = make_server()
    assert ask(server, 0xC2, *LABEL, 2)[0] == 0xA0
    assert ask(server, 0x81, *b"AB")[0] == 0xA2
    assert ask(server, 0xC1 | 5 << 2, 0xBA, 0xAD)[0] == 0xA1
    assert dictionary.get(0x2001) == "AB"
    assert ask(server, 0xA0, *LABEL, 127, 0)[0] == 0xC2
    assert ask(server, 0xA3) == b"\x81AB\0\0\0\0\0"
    assert ask(server, 0xA2, 1, 127) == bytes((0xC1 | 5 << 2, *REST))


def test_an_empty_value_takes_one_segment_that_carries_nothing():
    server, dictionary = make_server()
    client = BlockClient(server, LABEL)
    client.download(b"", Wire())
    assert dictionary.get(0x2001) == ""
    assert client.upload(Wire(), [127]) == b""


@pytest.mark.parametrize("length", [1, 4, 6, 7, 8, 14, 31 * 7, 127 * 7, 127 * 7 + 1, 254 * 7, 1000, 1023, 1024])
@pytest.mark.parametrize("block_size", [1, 2, 31, 127])
def test_lengths_at_the_edges_of_segments_and_sub_blocks_survive_both_ways(length, block_size):
    data = bytes(i % 251 for i in range(length))
    server, dictionary = make_server(max_bytes=2048, block_size=block_size)
    client = BlockClient(server)
    for announce in (True, False):
        dictionary.set(0x2004, 0, b"")
        client.download(data, Wire(), announce=announce)
        assert dictionary.get(0x2004) == data
    assert client.upload(Wire(), [block_size]) == data


# -- protocol switch ---------------------------------------------------------------------------------------------------


def test_a_value_up_to_the_clients_threshold_is_uploaded_without_blocks(server):
    assert ask(server, 0xA4, *LIMITED, 127, 2) == bytes((0x4B, *LIMITED, 10, 0, 0, 0))
    assert server.state is SdoState.IDLE
    assert ask(server, 0xA4, *LABEL, 127, 21) == bytes((0x41, *LABEL, 21, 0, 0, 0))
    assert ask(server, 0x60) == b"\x00a label"


@pytest.mark.parametrize("threshold", [0, 20])
def test_a_value_above_the_clients_threshold_is_uploaded_in_blocks(server, threshold):
    assert ask(server, 0xA4, *LABEL, 127, threshold)[0] == 0xC6


def test_a_threshold_of_zero_forbids_the_switch_of_the_smallest_value(server):
    assert ask(server, 0xA4, *LIMITED, 127, 0) == bytes((0xC6, *LIMITED, 2, 0, 0, 0))
    assert ask(server, 0xA3) == bytes((0x81, 10, 0, 0, 0, 0, 0, 0))


# -- what is refused ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ((0xC6, 0xFF, 0x2F, 0), SdoAbortCode.NO_OBJECT),
        ((0xC6, 0x00, 0x20, 1), SdoAbortCode.NO_SUBINDEX),
        ((0xC6, *STATUS, 2), SdoAbortCode.READ_ONLY),
        ((0xC6, *WIDE, 9), SdoAbortCode.TOO_LONG),
        ((0xC6, *WIDE, 7), SdoAbortCode.TOO_SHORT),
        ((0xC6, *BLOB, 0x01, 0x04), SdoAbortCode.OUT_OF_MEMORY),
        ((0xC6, *BLOB, 0xFF, 0xFF, 0xFF, 0xFF), SdoAbortCode.OUT_OF_MEMORY),
        ((0xA4, 0xFF, 0x2F, 0, 127), SdoAbortCode.NO_OBJECT),
        ((0xA4, 0x00, 0x20, 1, 127), SdoAbortCode.NO_SUBINDEX),
        ((0xA4, *KEY, 127), SdoAbortCode.WRITE_ONLY),
        ((0xA4, *LABEL, 0), SdoAbortCode.INVALID_BLOCK_SIZE),
        ((0xA4, *LABEL, 128), SdoAbortCode.INVALID_BLOCK_SIZE),
        ((0xA4, *LABEL, 255), SdoAbortCode.INVALID_BLOCK_SIZE),
        ((0xA4, *LABEL, 0, 255), SdoAbortCode.INVALID_BLOCK_SIZE),
    ],
)
def test_a_refused_initiate_names_its_object(server, request_, code):
    assert ask(server, *request_) == abort(code, *request_[1:4])
    assert (server.state, server.due) == (SdoState.IDLE, None)


def test_a_wrong_checksum_is_refused_and_nothing_is_written():
    server, dictionary = make_server()
    ask(server, 0xC6, *LABEL, 7)
    ask(server, 0x81, *b"segment")
    assert ask(server, 0xC1, 0x01, 0x02) == abort(SdoAbortCode.CRC, *LABEL)
    assert dictionary.get(0x2001) == TEXT
    assert server.state is SdoState.IDLE


@pytest.mark.parametrize(
    ("announced", "unused", "code"),
    [(5, 1, SdoAbortCode.TOO_LONG), (5, 3, SdoAbortCode.TOO_SHORT), (7, 7, SdoAbortCode.TOO_SHORT)],
)
def test_an_end_that_contradicts_the_announced_length_is_refused(server, announced, unused, code):
    ask(server, 0xC2, *LABEL, announced)
    ask(server, 0x81, *b"segment")
    assert ask(server, 0xC1 | unused << 2) == abort(code, *LABEL)


def test_less_than_announced_is_too_short(server):
    ask(server, 0xC2, *LABEL, 20)
    ask(server, 0x81, *b"segment")
    assert ask(server, 0xC1) == abort(SdoAbortCode.TOO_SHORT, *LABEL)


def test_more_than_announced_is_found_out_where_the_sub_block_ends(server):
    assert ask(server, 0xC2, *LABEL, 10)[4] == 2
    assert ask(server, 0x01, *b"segment") is None
    assert ask(server, 0x02, *b"segment") == abort(SdoAbortCode.TOO_LONG, *LABEL)


@pytest.mark.parametrize(("segments", "code"), [(1, SdoAbortCode.TOO_SHORT), (2, SdoAbortCode.TOO_LONG)])
def test_a_length_that_was_not_announced_is_checked_against_the_object_at_the_end(server, segments, code):
    ask(server, 0xC0, *WIDE)
    for number in range(1, segments):
        assert ask(server, number, *REST) is None
    assert ask(server, 0x80 | segments, *REST) is not None
    assert ask(server, 0xC1) == abort(code, *WIDE)


@pytest.mark.parametrize(("data", "code"), [((101, 0), SdoAbortCode.VALUE_TOO_HIGH), ((0x9B, 0xFF), SdoAbortCode.VALUE_TOO_LOW)])
def test_a_value_that_the_object_refuses_is_refused_at_the_end(server, data, code):
    ask(server, 0xC2, *LIMITED, 2)
    ask(server, 0x81, *data)
    assert ask(server, 0xC1 | 5 << 2) == abort(code, *LIMITED)


@pytest.mark.parametrize("bound", [1, 7, 20, 1024])
def test_a_client_that_never_ends_is_stopped_at_the_bound(bound):
    server, _ = make_server(max_bytes=bound)
    size, most = ask(server, 0xC0, *BLOB)[4], 0
    while True:
        for number in range(1, size + 1):
            answer = ask(server, number, *REST)
            most = max(most, server.buffered_bytes)
            assert (answer is None) == (number < size)
        if answer[0] == 0x80:
            break
        size = answer[2]
    assert answer == abort(SdoAbortCode.OUT_OF_MEMORY, *BLOB)
    assert most <= bound + 6 + 7 * size
    assert server.buffered_bytes == 0


def test_the_last_segment_may_fill_the_bound_but_not_pass_it():
    for unused, first in ((4, 0xA1), (3, 0x80)):
        server, _ = make_server(max_bytes=10)
        assert ask(server, 0xC0, *BLOB)[4] == 2
        ask(server, 0x01, *REST)
        assert ask(server, 0x82, *REST)[0] == 0xA2
        answer = ask(server, 0xC1 | unused << 2)
        assert answer[0] == first
        if first == 0x80:
            assert answer == abort(SdoAbortCode.OUT_OF_MEMORY, *BLOB)


@pytest.mark.parametrize("first", [0x00, 0x0B, 0x1F, 0x8B, 0xE0, 0xA1, 0xC1])
def test_a_sequence_number_that_was_not_granted_is_invalid(server, first):
    assert ask(server, 0xC2, *LABEL, 70)[4] == 10
    assert ask(server, first, *REST) == abort(SdoAbortCode.INVALID_SEQUENCE_NUMBER, *LABEL)
    assert server.state is SdoState.IDLE


@pytest.mark.parametrize(
    ("number", "size", "code"),
    [
        (3, 2, SdoAbortCode.INVALID_SEQUENCE_NUMBER),
        (255, 2, SdoAbortCode.INVALID_SEQUENCE_NUMBER),
        (2, 0, SdoAbortCode.INVALID_BLOCK_SIZE),
        (0, 128, SdoAbortCode.INVALID_BLOCK_SIZE),
    ],
)
def test_an_acknowledgement_of_the_impossible_aborts_the_upload(server, number, size, code):
    ask(server, 0xA4, *LABEL, 2)
    assert len(ask_all(server, 0xA3)) == 2
    assert ask(server, 0xA2, number, size) == abort(code, *LABEL)
    assert server.state is SdoState.IDLE


def test_the_size_of_a_block_that_will_not_come_does_not_matter(server):
    ask(server, 0xA4, *LABEL, 127)
    ask_all(server, 0xA3)
    assert ask(server, 0xA2, 3, 0)[0] == 0xC1


@pytest.mark.parametrize("block_size", [0, 128])
def test_a_server_cannot_have_an_impossible_block_size(block_size):
    with pytest.raises(ValueError, match=f"block size {block_size}"):
        make_server(block_size=block_size)


# -- lost segments -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lost", range(1, 5))
def test_a_lost_segment_of_a_download_is_asked_for_at_the_end_of_its_sub_block(server, lost):
    assert ask(server, 0xC2, *BLOB, 100)[4] == 15
    for number in range(1, 15):
        if number != lost:
            assert ask(server, number, *REST) is None
    assert ask(server, 0x8F, *REST) == bytes((0xA2, lost - 1, 15, 0, 0, 0, 0, 0))


def test_a_sub_block_whose_end_is_lost_is_acknowledged_when_the_client_falls_silent(server):
    ask(server, 0xC2, *LABEL, 21)
    ask(server, 0x01, *REST, now=SECOND)
    ask(server, 0x02, *REST, now=SECOND)
    assert server.due == SECOND + 250 * MS
    assert server.advance(server.due - 1) == []
    assert [frame.data for frame in server.advance(server.due)] == [bytes((0xA2, 2, 3, 0, 0, 0, 0, 0))]
    assert server.due == SECOND + 250 * MS + 5 * SECOND
    assert ask(server, 0x81, *REST, now=2 * SECOND) == bytes((0xA2, 1, 3, 0, 0, 0, 0, 0))
    assert ask(server, 0xC1, now=2 * SECOND)[0] == 0xA1


def test_a_sub_block_of_which_nothing_came_is_not_acknowledged_but_aborted(server):
    # The client may wait for the acknowledgement of the sub-block before, and would take this one for it.
    ask(server, 0xC2, *LABEL, 21)
    assert server.due == 5 * SECOND
    assert [frame.data for frame in server.advance(server.due)] == [abort(SdoAbortCode.TIMED_OUT, *LABEL)]


def test_the_silence_is_never_longer_than_the_time_out():
    server, _ = make_server(timeout_ns=100)
    ask(server, 0xC0, *BLOB)
    ask(server, 0x01)
    assert server.due == 100


@pytest.mark.parametrize("block_size", [1, 2, 3, 7, 31, 126, 127])
def test_losing_any_one_segment_changes_nothing_but_the_number_of_frames(block_size):
    data = bytes(i * 7 % 256 for i in range(300))
    count = 43
    for lost in range(count):
        server, dictionary = make_server(block_size=block_size)
        client = BlockClient(server)
        client.download(data, Wire({lost}))
        assert dictionary.get(0x2004) == data
        assert client.upload(Wire({lost}), [block_size]) == data


def test_a_client_that_takes_fewer_segments_than_were_sent_is_sent_the_rest_again(server):
    client = BlockClient(server, LABEL)
    assert client.upload(Wire(), [127], patience=2) == TEXT.encode()
    assert client.sub_blocks == [2, 1]


def test_the_last_segment_of_a_sub_block_delivered_twice_is_acknowledged_once():
    server, dictionary = make_server(block_size=2)
    ask(server, 0xC0, *LABEL)
    for segment in (b"\x01 first ", b"\x02second "):
        answer = ask(server, *segment)
    assert answer == bytes((0xA2, 2, 2, 0, 0, 0, 0, 0))
    assert ask(server, *b"\x02second ") is None
    assert ask(server, *b"\x01  third") is None
    assert ask(server, *b"\x82 fourth")[:3] == bytes((0xA2, 2, 2))
    assert ask(server, *b"\x82 fourth") is None
    assert ask(server, 0xC1)[0] == 0xA1
    assert dictionary.get(0x2001) == " first second   third fourth"


def test_equal_segments_are_both_meant_where_sub_blocks_are_of_one():
    server, dictionary = make_server(block_size=1)
    ask(server, 0xC2, *BLOB, 21)
    assert [ask(server, first, *REST)[1] for first in (0x01, 0x01, 0x81)] == [1, 1, 1]
    assert ask(server, 0x81, *REST) is None
    assert ask(server, 0xC1)[0] == 0xA1
    assert dictionary.get(0x2004) == bytes(21)


@settings(max_examples=120)
@given(
    data=st.integers(0, 1000).flatmap(lambda n: st.binary(min_size=n, max_size=n)),
    block_size=st.integers(1, 127),
    sizes=st.lists(st.integers(1, 127), min_size=1, max_size=4),
    lost=st.sets(st.integers(0, 200), max_size=40),
    announce=st.booleans(),
    has_crc=st.booleans(),
    patience=st.integers(1, 127),
)
@example(bytes(1000), 127, [127], set(range(1, 143)), True, True, 1)
def test_any_value_survives_any_losses_both_ways(data, block_size, sizes, lost, announce, has_crc, patience):
    server, dictionary = make_server(block_size=block_size)
    client = BlockClient(server)
    client.download(data, Wire(lost), announce=announce, has_crc=has_crc)
    assert dictionary.get(0x2004) == data
    assert client.upload(Wire(lost), sizes, has_crc=has_crc, patience=patience) == data
    assert (server.state, server.due, server.buffered_bytes) == (SdoState.IDLE, None, 0)


# -- one transfer after, or into, another ------------------------------------------------------------------------------


def test_a_request_right_after_the_end_of_an_upload_is_answered(server):
    ask(server, 0xA4, *LABEL, 127)
    ask_all(server, 0xA3)
    assert ask(server, 0xA2, 3, 127)[0] == 0xC1
    assert ask(server, 0x40, *LIMITED) == bytes((0x4B, *LIMITED, 10, 0, 0, 0))


BEGIN = {
    "expedited": (0x40, *LIMITED),
    "segmented upload": (0x40, *LABEL),
    "segmented download": (0x20, *LABEL),
    "block upload": (0xA4, *LABEL, 127),
    "block download": (0xC4, *LABEL),
}


@pytest.mark.parametrize("second", BEGIN)
@pytest.mark.parametrize("sent", [0, 1, 5])
def test_a_new_request_in_the_middle_of_a_sub_block_begins_anew(server, second, sent):
    ask(server, 0xC4, *BLOB)
    for number in range(1, sent + 1):
        ask(server, number, *REST)
    answer = ask(server, *BEGIN[second])
    assert answer[1:4] == bytes(BEGIN[second][1:4])
    assert answer[0] != 0x80
    assert server.buffered_bytes == 0


def test_above_31_segments_at_once_the_same_bytes_are_segments():
    server, _ = make_server(block_size=127)
    ask(server, 0xC4, *BLOB)
    assert ask(server, 0x40, *LABEL) is None
    assert server.state is SdoState.BLOCK_DOWNLOADING


@pytest.mark.parametrize("address", [BLOB, LABEL])
def test_an_abort_in_the_middle_of_a_sub_block_ends_it_in_silence(server, address):
    ask(server, 0xC4, *address)
    ask(server, 0x01, *REST)
    assert ask(server, 0x80, *address) is None
    assert (server.state, server.due, server.buffered_bytes) == (SdoState.IDLE, None, 0)


def transfer(server, dictionary, kind, data):
    client = BlockClient(server)
    if kind == "block download":
        client.download(data, Wire())
    elif kind == "block upload":
        assert client.upload(Wire(), [127]) == dictionary.get(0x2004)
    elif kind == "download":
        segments = [data[i : i + 7] for i in range(0, len(data), 7)]
        assert ask(server, 0x20, *BLOB)[0] == 0x60
        for number, segment in enumerate(segments):
            is_last = number == len(segments) - 1
            assert ask(server, number % 2 << 4 | (7 - len(segment)) << 1 | is_last, *segment)[0] >> 5 == 1
    else:
        ask(server, 0x40, *BLOB)
        joined, number = b"", 0
        while len(joined) < len(dictionary.get(0x2004)):
            answer = ask(server, 0x60 | number % 2 << 4)
            joined, number = joined + answer[1 : 8 - (answer[0] >> 1 & 7)], number + 1
        assert joined == dictionary.get(0x2004)


KINDS = ("block download", "block upload", "download", "upload")


@pytest.mark.parametrize("first", KINDS)
@pytest.mark.parametrize("second", KINDS)
def test_no_transfer_leaves_anything_to_the_next(first, second):
    server, dictionary = make_server()
    dictionary.set(0x2004, 0, bytes(range(50)))
    for kind, data in ((first, b"the value of the first one"), (second, b"another value, of the second transfer")):
        transfer(server, dictionary, kind, data)
        if "download" in kind:
            assert dictionary.get(0x2004) == data


# -- an owner who needs time -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("code", [None, SdoAbortCode.HARDWARE])
def test_the_end_of_a_download_is_answered_when_the_owner_has_finished(code):
    server, dictionary = make_server()

    def write(value):
        raise Postponed(SECOND, lambda: code)

    dictionary.on_write(0x2001, 0, write)
    ask(server, 0xC2, *LABEL, 7)
    ask(server, 0x81, *b"segment")
    assert ask(server, 0xC1) is None
    assert server.state is SdoState.WAITING
    assert ask(server, 0x40, *LIMITED) is None
    assert [frame.data for frame in server.advance(SECOND)] == [bytes((0xA1, *REST)) if code is None else abort(code, *LABEL)]
    assert (server.state, server.due) == (SdoState.IDLE, None)


# -- anything ----------------------------------------------------------------------------------------------------------

requests = st.builds(
    lambda first, address, rest: bytes((first, *address)) + rest,
    st.integers(0, 255) | st.sampled_from([0xC0, 0xC2, 0xC4, 0xC6, 0xA0, 0xA4, 0xA3, 0xA2, 0xA1, 0xC1, 0x80]),
    st.sampled_from([LABEL, BLOB, WIDE, (1, 5, 0), (3, 127, 0)]),
    st.binary(min_size=4, max_size=4) | st.just(b"\x7f\0\0\0") | st.just(b"\x10\0\0\0"),
)


@settings(max_examples=150)
@given(
    st.lists(st.tuples(requests | st.binary(max_size=9), st.sampled_from([0, 1, 300 * MS, 6 * SECOND])), max_size=60),
    st.sampled_from([1, 31, 127]),
)
def test_any_frames_at_any_times_are_answered_as_promised(steps, block_size):
    server, _ = make_server(block_size=block_size, max_bytes=100)
    now = 0
    for data, pause in steps:
        now += pause
        assert len(server.advance(now)) <= 1
        state, was_whole = server.state, len(data) == 8
        answers = [frame.data for frame in server.receive(data, now)]
        if not was_whole or server.state is state is SdoState.BLOCK_DOWNLOAD_ENDING:
            assert answers == []  # no frame, or the last segment again
        elif state in {SdoState.BLOCK_UPLOAD_READY, SdoState.BLOCK_UPLOADING}:
            assert len(answers) <= 127
            assert answers or data[0] >> 5 == 4
        elif state is SdoState.BLOCK_DOWNLOADING or (state is SdoState.BLOCK_UPLOAD_ENDING and data[0] & 0xE3 == 0xA1):
            assert len(answers) <= 1
        else:
            assert len(answers) == (data[0] >> 5 != 4)
        assert all(len(answer) == 8 for answer in answers)
        assert server.buffered_bytes <= 106
        assert (server.due is None) == (server.state is SdoState.IDLE)


@settings(max_examples=100)
@given(st.lists(st.integers(0, 255), max_size=200), st.integers(1, 127), st.none() | st.integers(0, 300))
def test_a_download_keeps_no_more_than_its_limit_and_a_sub_block(numbers, block_size, announced):
    download = BlockDownload(announced, 300, block_size, has_crc=False)
    granted = download.block_size
    for first in numbers:
        number = first % (granted + 1) or 1
        if download.receive(bytes((number | (first & 0x80), *REST))):
            if download.is_complete:
                return
            if len(download) // 7 * 7 >= (300 if announced is None else announced):
                return
            accepted, size = download.acknowledge()
            assert 0 <= accepted <= granted
            assert size == granted <= block_size
        assert len(download) <= (300 if announced is None else max(announced, 1)) + 6 + 7 * granted


def test_an_upload_keeps_the_value_of_its_beginning():
    server, dictionary = make_server()
    ask(server, 0xA4, *LABEL, 1)
    dictionary.set(0x2001, 0, "something else altogether")
    sent = [ask(server, 0xA3)] + [ask(server, 0xA2, 1, 1) for _ in range(3)]
    assert b"".join(answer[1:] for answer in sent[:3]) == TEXT.encode()
    assert sent[3][1:3] == struct.pack("<H", crc16(TEXT.encode()))
    assert BlockUpload(b"", 1, has_crc=True).end() == (7, 0)


# -- a stranger --------------------------------------------------------------------------------------------------------


@pytest.fixture
def make_stranger():
    """The canopen package's client, to a server of a chosen block size, over a wire that loses segments."""

    class Network(canopen.Network):
        def __init__(self, server, wire):
            super().__init__()
            self.server, self.wire, self.now = server, wire, 0
            self.in_sub_block = False

        def send_message(self, can_id, data, remote=False):
            is_segment = self.server.state is SdoState.BLOCK_DOWNLOADING
            if is_segment and data[0] != 0x80 and not self.wire.passes():
                return
            self.deliver(self.server.receive(bytes(data), self.now))

        def deliver(self, frames):
            for frame in frames:
                if self.server.state is not SdoState.BLOCK_UPLOADING or self.wire.passes():
                    self.notify(frame.can_id, bytearray(frame.data), 0.0)

    opened = []

    def make(lost=(), **options):
        server, dictionary = make_server(**options)
        network = Network(server, Wire(lost))
        node = canopen.RemoteNode(NODE, canopen.ObjectDictionary())
        network[NODE] = node
        opened.append(network)
        return node.sdo, dictionary

    yield make
    for network in opened:
        network.disconnect()


@pytest.mark.parametrize("block_size", [1, 31, 127])
@pytest.mark.parametrize("length", [1, 4, 7, 889, 1024])
@pytest.mark.parametrize("has_crc", [True, False])
def test_a_stranger_moves_any_length_in_blocks_both_ways(make_stranger, block_size, length, has_crc):
    sdo, dictionary = make_stranger(block_size=block_size)
    data = bytes(i * 3 % 256 for i in range(length))
    options = {"block_transfer": True, "request_crc_support": has_crc}
    with sdo.open(0x2004, 0, "wb", size=length, buffering=7, **options) as stream:
        stream.write(data)
    assert dictionary.get(0x2004) == data
    with sdo.open(0x2004, 0, "rb", buffering=0, **options) as stream:
        assert stream.size == length
        assert stream.read() == data


@pytest.mark.parametrize("lost", [{0}, {4}, {8}, {3, 5}, {0, 12, 25}])
def test_a_stranger_sends_again_what_was_lost(make_stranger, lost):
    # 2.4.1 cannot send the last sub-block again, nor one whose last segment is lost.
    sdo, dictionary = make_stranger(lost, block_size=10)
    data = bytes(i * 3 % 256 for i in range(700))
    with sdo.open(0x2004, 0, "wb", size=700, buffering=7, block_transfer=True) as stream:
        stream.write(data)
    assert dictionary.get(0x2004) == data


@pytest.mark.parametrize("lost", [{0}, {63}, {125}, {127}, {140}])
def test_a_stranger_asks_again_for_what_was_lost(make_stranger, lost):
    # 2.4.1 skips a segment of its own where the last of a sub-block was lost; its checksum tells.
    sdo, dictionary = make_stranger(lost)
    data = bytes(i * 3 % 256 for i in range(1000))
    dictionary.set(0x2004, 0, data)
    with sdo.open(0x2004, 0, "rb", buffering=0, block_transfer=True) as stream:
        assert stream.read() == data


def test_a_stranger_hears_why_its_block_transfer_is_refused(make_stranger):
    sdo, _ = make_stranger()
    for index, mode, code in (
        (0x2FFF, "wb", SdoAbortCode.NO_OBJECT),
        (0x2002, "wb", SdoAbortCode.READ_ONLY),
        (0x2003, "rb", SdoAbortCode.WRITE_ONLY),
        (0x2005, "wb", SdoAbortCode.TOO_LONG),
    ):
        with pytest.raises(canopen.SdoAbortedError) as caught:
            sdo.open(index, 0, mode, size=100, block_transfer=True)
        assert caught.value.code == code


def test_a_stranger_moves_the_label_of_a_whole_node_in_blocks(stranger, bench):
    text = "a text that the node keeps, " * 30
    with stranger.sdo.open(0x2001, 0, "wb", size=len(text), block_transfer=True) as stream:
        stream.write(text.encode())
    assert bench.dictionary.get(0x2001) == text
    with stranger.sdo.open(0x2001, 0, "rb", block_transfer=True) as stream:
        assert stream.read().decode() == text
    assert stranger.sdo[0x2000].raw == 10


def test_a_stranger_leaves_a_text_in_a_drive_that_survives_a_loss_of_power():
    rig = Rig()
    network, text = Stranger(rig), b"what the user wants to remember of this drive; " * 21
    node = canopen.RemoteNode(rig.node, canopen.ObjectDictionary())
    network[rig.node] = node
    assert rig.upload(USER_TEXT) == b""
    with node.sdo.open(USER_TEXT, 0, "wb", size=len(text), block_transfer=True) as stream:
        stream.write(text)
    assert rig.save() is None
    rig.power_cycle()
    with node.sdo.open(USER_TEXT, 0, "rb", block_transfer=True) as stream:
        assert stream.read() == text
    network.disconnect()


def test_a_server_names_its_answers_by_the_identifier_that_it_is_given():
    server = SdoServer(make_server()[1], 0x599)
    assert server.receive(bytes((0xA4, *LABEL, 127, 0, 0, 0)), 0) == [Frame(0x599, bytes((0xC6, *LABEL, 21, 0, 0, 0)))]
