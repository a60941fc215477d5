"""SDO transfers of the client, with bytes alone: against the emulated server, over a wire that loses segments, and a stranger."""

import contextlib
import struct

import canopen
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from drive_profiles.device import transfer
from drive_profiles.device.sdo import SdoPort
from drive_profiles.device.transfer import MAX_UPLOAD_BYTES, TransferAbortedError, TransferBrokenError
from drive_profiles.errors import NoAnswerError, SdoAbortedError
from drive_profiles.standard.cia301 import SdoAbortCode
from tests.plant_emulator.slave.sdo.sdo_rig import NODE, Wire, crc16, make_server

BLOB, STATUS, NOTHING = (0x2004, 0), (0x2002, 0), (0x5555, 0)
WAYS = [(transfer.upload, transfer.download), (transfer.block_upload, transfer.block_download)]
contents = st.binary(max_size=2000)


class Client:
    """A client's end of a wire to a server, which loses segments of blocks.

    Two sub-blocks one after the other of which only the last segment arrives look like one with its last frame twice: the
    server is then silent. The wire does not lose that much.
    """

    def __init__(self, server, wire):
        self.server, self.passes = server, wire.passes
        self.was_hollow = False

    def arriving(self, sub_block):
        """What of a sub-block arrives; its last segment always does, as it brings the acknowledgement."""
        arrived = [frame for frame in sub_block[:-1] if self.passes()]
        is_hollow = len(sub_block) > 1 and not arrived
        if is_hollow and self.was_hollow:
            arrived, is_hollow = sub_block[:1], False
        self.was_hollow = is_hollow
        return [*arrived, sub_block[-1]]

    def run(self, make, *arguments):
        out, answers = [], []
        running = make(out, *arguments)
        try:
            is_segment = next(running)
            while True:
                is_block = make is transfer.block_download and len(out) > 1
                for frame in self.arriving(out) if is_block else out:
                    answers += [each.data for each in self.server.receive(frame, 0)]
                out.clear()
                answer = answers.pop(0)
                while is_segment and answers and not self.passes():  # its last segment arrives likewise
                    answer = answers.pop(0)
                is_segment = running.send(answer)
        except StopIteration as end:
            for frame in out:
                assert self.server.receive(frame, 0) == []
            assert not answers
            return end.value


def run(make, *arguments, server=None, lost=()):
    return Client(make_server(max_bytes=4000)[0] if server is None else server, Wire(lost)).run(make, *arguments)


@pytest.mark.parametrize(("read", "write"), WAYS, ids=["segments", "blocks"])
@given(content=contents)
def test_contents_of_any_length_go_there_and_back(read, write, content):
    server, dictionary = make_server(max_bytes=4000)
    assert run(write, BLOB, content, server=server) == b""
    assert dictionary.get(0x2004) == content
    assert run(read, BLOB, server=server) == content
    assert server.due is None


@given(content=contents, lost=st.sets(st.integers(0, 300)), size=st.integers(1, 127))
@example(content=bytes(8), lost={0, 1}, size=2)
def test_segments_that_are_lost_in_a_block_come_again(content, lost, size):
    server, dictionary = make_server(max_bytes=4000, block_size=size)
    run(transfer.block_download, BLOB, content, server=server, lost=lost)
    assert dictionary.get(0x2004) == content
    assert run(transfer.block_upload, BLOB, server=server, lost=lost) == content


@pytest.mark.parametrize("make", [transfer.upload, transfer.block_upload])
def test_a_refusal_of_a_read_has_the_servers_code(make):
    with pytest.raises(TransferAbortedError) as caught:
        run(make, NOTHING)
    assert caught.value.code == SdoAbortCode.NO_OBJECT


@pytest.mark.parametrize("make", [transfer.download, transfer.block_download])
@pytest.mark.parametrize("content", [b"\1\0", bytes(50)])
def test_a_refusal_of_a_write_has_the_servers_code(make, content):
    with pytest.raises(TransferAbortedError) as caught:
        run(make, STATUS, content)
    assert caught.value.code == SdoAbortCode.READ_ONLY


def fed(make, *arguments, answers):
    """Feed a transfer; give the error it ends with, or its value."""
    out = []
    running = make(out, *arguments)
    next(running)
    for answer in answers:
        out.clear()
        running.send(answer if isinstance(answer, bytes) else bytes.fromhex(answer))


OPEN_BLOCK = "c4 04 20 00 00 00 00 00"
BROKEN = [
    (transfer.upload, (), ["41 04 20 00 09 00 00 00", "10 31 32 33 34 35 36 37"], SdoAbortCode.TOGGLE_BIT),
    (transfer.upload, (), ["60 04 20 00 00 00 00 00"], SdoAbortCode.UNKNOWN_COMMAND),
    (transfer.upload, (), ["41 04 20 00 09 00 00 00", "e0 31 32 33 34 35 36 37"], SdoAbortCode.UNKNOWN_COMMAND),
    (transfer.download, (bytes(9),), ["60 04 20 00 00 00 00 00", "30 00 00 00 00 00 00 00"], SdoAbortCode.TOGGLE_BIT),
    (transfer.block_upload, (), [OPEN_BLOCK, "81 31 00 00 00 00 00 00", "d9 00 00 00 00 00 00 00"], SdoAbortCode.CRC),
    (transfer.block_upload, (), [OPEN_BLOCK, *["ff 31 00 00 00 00 00 00"] * 17], SdoAbortCode.INVALID_SEQUENCE_NUMBER),
    (transfer.block_download, (bytes(9),), ["a4 04 20 00 00 00 00 00"], SdoAbortCode.INVALID_BLOCK_SIZE),
    (transfer.block_download, (bytes(9),), ["a4 04 20 00 80 00 00 00"], SdoAbortCode.INVALID_BLOCK_SIZE),
    (transfer.block_download, (bytes(9),), ["a4 04 20 00 02 00 00 00", "a2 03 02 00 00 00 00 00"],
     SdoAbortCode.INVALID_SEQUENCE_NUMBER),
    (transfer.block_download, (bytes(9),), ["a4 04 20 00 02 00 00 00", *["a2 00 02 00 00 00 00 00"] * 17],
     SdoAbortCode.INVALID_SEQUENCE_NUMBER),
]  # fmt: skip


@pytest.mark.parametrize(("make", "more", "answers", "code"), BROKEN)
def test_an_answer_that_makes_no_sense_ends_the_transfer(make, more, answers, code):
    with pytest.raises(TransferBrokenError) as caught:
        fed(make, BLOB, *more, answers=answers)
    assert caught.value.code is code


@pytest.mark.parametrize("is_block", [False, True])
def test_a_server_does_not_make_us_hold_what_it_likes(is_block):
    def segments():
        number = 0
        while True:
            yield bytes((number % 127 + 1 if is_block else number % 2 << 4, *bytes(7)))
            number += 1

    begin = bytes.fromhex(OPEN_BLOCK if is_block else "41 04 20 00 00 00 00 00")
    out = []
    running = (transfer.block_upload if is_block else transfer.upload)(out, BLOB)
    next(running)
    running.send(begin)
    taken = segments()
    for _ in range(MAX_UPLOAD_BYTES // 7):
        running.send(next(taken))
    with pytest.raises(TransferBrokenError) as caught:
        running.send(next(taken))
    assert caught.value.code is SdoAbortCode.OUT_OF_MEMORY


@given(st.lists(st.binary(min_size=8, max_size=8), max_size=40), st.sampled_from(WAYS), st.booleans())
def test_any_answers_end_a_transfer_in_one_of_its_ways(answers, way, reads):
    with contextlib.suppress(StopIteration, TransferAbortedError, TransferBrokenError):
        fed(way[0], BLOB, answers=answers) if reads else fed(way[1], BLOB, bytes(30), answers=answers)


def test_the_checksum_is_that_of_the_standards_example():
    """CRC-16-CCITT of "123456789" is 31C3h (CiA 301, 7.2.4.3.16)."""
    out = []
    running = transfer.block_download(out, BLOB, b"123456789")
    next(running)
    running.send(bytes.fromhex("a4 04 20 00 7f 00 00 00"))
    out.clear()
    running.send(bytes.fromhex("a2 02 7f 00 00 00 00 00"))
    assert out == [bytes((0xC1 | 5 << 2, 0xC3, 0x31, *bytes(5)))]
    assert struct.unpack("<H", out[0][1:3])[0] == crc16(b"123456789")


# -- on a line -------------------------------------------------------------------------------------------------------------


class Line:
    """A line to a server that answers at once."""

    boots = 0

    def __init__(self, answer):
        self.answer, self.sent, self.coming = answer, [], []

    def send(self, can_id, data):
        self.sent.append(data)
        self.coming += self.answer(data)

    def receive(self, timeout_s):
        return self.coming.pop(0) if self.coming else None

    def clear(self):
        old, self.coming = self.coming, []
        return old


def stranger():
    """The `canopen` package's server, which sends no blocks and takes none."""
    dictionary = canopen.ObjectDictionary()
    variable = canopen.objectdictionary.ODVariable("Blob", 0x2004)
    variable.data_type, variable.access_type = canopen.objectdictionary.DOMAIN, "rw"
    dictionary.add_object(variable)
    local = canopen.LocalNode(NODE, dictionary)
    local.set_data(0x2004, 0, bytes(range(100)))
    answers = []

    class Network(canopen.Network):
        def send_message(self, can_id, data, remote=False):
            answers.append(bytes(data))

    local.associate_network(Network())

    def answer(data):
        answers.clear()
        local.sdo.on_request(0x600 + NODE, data, 0.0)
        return list(answers)

    return local, answer


def test_a_server_without_blocks_answers_in_segments_and_is_written_in_segments():
    local, answer = stranger()
    port = SdoPort(NODE, Line(answer), 0.1)
    assert port.read(BLOB, in_blocks=True) == bytes(range(100))
    port.write(BLOB, b"a new content of some length", in_blocks=True)
    assert local.get_data(0x2004, 0) == b"a new content of some length"
    assert port.read(BLOB, in_blocks=True) == b"a new content of some length"


@pytest.mark.parametrize("code", [None, SdoAbortCode.UNKNOWN_COMMAND, SdoAbortCode.UNSUPPORTED_ACCESS, SdoAbortCode.GENERAL])
def test_a_node_that_does_not_know_blocks_is_asked_for_one_once(code):
    server, _ = make_server()

    def answer(data):
        if data[0] >> 5 == 5:
            return [] if code is None else [struct.pack("<B3sI", 0x80, data[1:4], code)]
        return [frame.data for frame in server.receive(data, 0)]

    line = Line(answer)
    port = SdoPort(NODE, line, 0.1)
    assert port.read((0x2001, 0), in_blocks=True) == b"a label of 21 letters"
    assert port.read((0x2001, 0), in_blocks=True) == b"a label of 21 letters"
    port.write((0x2001, 0), b"another", in_blocks=True)
    assert len([frame for frame in line.sent if frame[0] >> 5 in (5, 6)]) == 1


def test_an_object_that_is_refused_tells_nothing_of_blocks():
    server, _ = make_server()
    line = Line(lambda data: [frame.data for frame in server.receive(data, 0)])
    port = SdoPort(NODE, line, 0.1)
    with pytest.raises(SdoAbortedError) as caught:
        port.read(NOTHING, in_blocks=True)
    assert caught.value.code == SdoAbortCode.NO_OBJECT
    line.sent.clear()
    port.read((0x2001, 0), in_blocks=True)
    assert line.sent[0][0] >> 5 == 5


def test_a_long_object_crosses_in_blocks_both_ways():
    server, dictionary = make_server(max_bytes=4000)
    line = Line(lambda data: [frame.data for frame in server.receive(data, 0)])
    port = SdoPort(NODE, line, 0.1)
    content = bytes(n % 251 for n in range(3000))
    assert port.read(BLOB, in_blocks=True) == b""
    port.write(BLOB, content, in_blocks=True)
    assert dictionary.get(0x2004) == content
    line.sent.clear()
    assert port.read(BLOB, in_blocks=True) == content
    assert len(line.sent) == 2 + -(-429 // 127) + 1, "a request, a start, an acknowledgement for each block, an end"
    with pytest.raises(SdoAbortedError):
        port.write(STATUS, bytes(50), in_blocks=True)
    assert server.due is None


def test_a_block_that_does_not_come_ends_in_an_abort_with_its_object():
    line = Line(lambda data: [bytes.fromhex("c4 04 20 00 00 00 00 00")] if data[0] == 0xA4 else [])
    port = SdoPort(NODE, line, 0.1)
    port._has_blocks = True
    with pytest.raises(NoAnswerError):
        port.read(BLOB, in_blocks=True)
    assert line.sent[-1] == bytes.fromhex("80 04 20 00 00 00 04 05")
