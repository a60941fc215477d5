"""The virtualcan port: who hears what, what passes, and that nobody harms the bus through it."""

import socket
import struct
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, Frame
from plant_emulator.bus import virtualcan
from plant_emulator.bus.virtualcan import EndpointError, Messages, VirtualcanListener, encode, parse_endpoint
from tests.plant_emulator.bus.conftest import frames_until, wait_for
from tests.strangers.conftest import Tcp, message

READ_STATUS, ANSWER = bytes.fromhex("4041600000000000"), 0x583
EXTENDED = 0x01

# -- the endpoint ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "endpoint"),
    [
        ("18000", ("127.0.0.1", 18000)),
        ("localhost:0", ("127.0.0.1", 0)),
        ("127.0.0.1:1", ("127.0.0.1", 1)),
        ("[::1]:65535", ("::1", 65535)),
        ("::1:18000", ("::1", 18000)),
    ],
)
def test_an_endpoint_is_a_port_on_this_machine(text, endpoint):
    assert parse_endpoint(text) == endpoint


@pytest.mark.parametrize("text", ["0.0.0.0:18000", ":::18000", "robot:18000", "192.168.0.2:18000", "127.0.0.2:1"])
def test_an_endpoint_that_others_could_reach_is_refused_with_the_reason(text):
    with pytest.raises(EndpointError, match="without a password"):
        parse_endpoint(text)


@pytest.mark.parametrize("text", ["", "localhost", "localhost:", "65536", "-1", "1e3", "127.0.0.1:http", "²"])
def test_an_endpoint_without_a_port_is_refused(text):
    with pytest.raises(EndpointError, match=r"expected \[HOST:\]PORT"):
        parse_endpoint(text)


def test_a_port_is_not_opened_to_others_by_whoever_calls_it():
    with pytest.raises(EndpointError, match=r"0\.0\.0\.0"):
        VirtualcanListener("0.0.0.0", 0)  # noqa: S104 - that it is refused is the test


# -- the format --------------------------------------------------------------------------------------------------------

FRAMES = st.builds(
    lambda wide, can_id, remote, data: Frame(
        (can_id | CAN_EFF_FLAG if wide else can_id & 0x7FF) | (CAN_RTR_FLAG if remote else 0),
        bytes(len(data)) if remote else data,
    ),
    st.booleans(),
    st.integers(0, 0x1FFF_FFFF),
    st.booleans(),
    st.binary(max_size=8),
)


def test_a_message_is_what_the_project_describes():
    assert encode(Frame(0x583, b"\x4b\x41")) == bytes.fromhex("0000000e 00000583 00 02 4b41000000000000")
    assert encode(Frame(0x1234_5678 | CAN_EFF_FLAG, bytes(range(8)))) == bytes.fromhex("0000000e 12345678 01 08 0001020304050607")
    assert encode(Frame(0x703 | CAN_RTR_FLAG, bytes(1))) == bytes.fromhex("0000000e 40000703 00 01 0000000000000000")
    assert encode(Frame(0x004 | CAN_ERR_FLAG, bytes(8))) == b""


@settings(max_examples=100)
@given(st.lists(FRAMES, max_size=5), st.data())
def test_frames_arrive_as_they_were_however_the_stream_is_cut(frames, data):
    stream = b"".join(encode(frame) for frame in frames)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    messages, heard = Messages(), []
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        heard += messages.receive(stream[begin:end])
    assert heard == frames
    assert messages.refused is None


@settings(max_examples=100)
@given(st.lists(st.binary(max_size=40), max_size=6))
def test_no_bytes_raise_and_none_are_kept_beyond_a_message(pieces):
    messages = Messages()
    for piece in pieces:
        assert all(isinstance(frame, Frame) for frame in messages.receive(piece))
        assert len(messages._rest) < 18
        if messages.refused is not None:
            assert messages.receive(encode(Frame(0x123, b""))) == []


def test_identifiers_of_29_bits_may_be_told_by_the_identifier_alone():
    assert Messages().receive(message(0x123 | CAN_EFF_FLAG, b"\1")) == [Frame(0x123 | CAN_EFF_FLAG, b"\1")]


BAD = {
    "length 0": struct.pack(">I", 0),
    "length 13": struct.pack(">I", 13),
    "length 15": struct.pack(">I", 15),
    "a web page": b"POST / HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "nine bytes": struct.pack(">IIBB8s", 14, 0x123, 0, 9, b""),
    "255 bytes": struct.pack(">IIBB8s", 14, 0x123, 0, 255, b""),
    "12 bits without the flag": message(0x800),
    "an error frame": message(CAN_ERR_FLAG | 4, bytes(8)),
    "the question of the clock": message(0x3000_0000, bytes(8)),
}


@pytest.mark.parametrize("wrong", BAD.values(), ids=BAD)
def test_who_sends_no_message_is_dropped_with_the_reason_and_nobody_else(served, wrong):
    bad, good = served.join(), served.join()
    bad.socket.sendall(message(0x123, b"\1") + wrong)
    assert bad.receive() is None
    assert good.receive() == (0x123, 0, b"\1")  # what came before is heard
    good.send(0x603, READ_STATUS)
    assert good.until(ANSWER)
    wait_for(lambda: served.told)
    assert len(served.told) == 1
    assert served.told[0].startswith(f"virtualcan client {bad.name} is dropped: ")


# -- who hears what ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"stream": True}, {"host": "::1"}], ids=["seqpacket", "stream", "IPv6"])
def test_everyone_hears_the_others_and_the_nodes_but_not_itself(start_served, options):
    served = start_served(**options)
    local, first, second = served.join_local(), served.join(), served.join()
    first.send(0x603, READ_STATUS)
    assert first.receive()[:2] == (ANSWER, 0)
    assert [second.receive()[0] for _ in range(2)] == [0x603, ANSWER]
    assert [frame.can_id for frame in frames_until(local, ANSWER)] == [0x603, ANSWER]
    local.send(Frame(0x123, b"\1\2\3"))
    assert first.receive() == second.receive() == (0x123, 0, b"\1\2\3")
    second.send(0x124, b"")
    assert first.receive() == (0x124, 0, b"")
    assert frames_until(local, 0x124)
    second.socket.setblocking(False)
    with pytest.raises(BlockingIOError):
        second.socket.recv(1)


def test_frames_of_every_kind_pass_and_error_frames_do_not(served):
    local, tcp = served.join_local(), served.join()
    wait_for(lambda: len(served.server._clients) == 2)
    wide, remote = Frame(0x1FFF_FFFF | CAN_EFF_FLAG, b"\xff"), Frame(0x123 | CAN_RTR_FLAG, bytes(3))
    for frame in (Frame(0x004 | CAN_ERR_FLAG, bytes(8)), wide, remote):
        local.send(frame)
    assert tcp.receive() == (0x1FFF_FFFF, EXTENDED, b"\xff")
    assert tcp.receive() == (0x4000_0123, 0, bytes(3))
    tcp.send(0x1FFF_FFFF, b"\xff", EXTENDED)
    tcp.send(0x4000_0123, bytes(3))
    assert frames_until(local, remote.can_id) == [wide, remote]


def test_frames_in_pieces_and_many_at_once_arrive_in_their_order(served):
    first, second = served.join(), served.join()
    stream = b"".join(message(0x100 + i % 0x400, struct.pack("<H", i)) for i in range(2000))
    for begin in range(0, 7 * 18, 5):
        first.socket.sendall(stream[begin : begin + 5])
    first.socket.sendall(stream[130:])
    assert [struct.unpack("<H", second.receive()[2])[0] for _ in range(2000)] == list(range(2000))


def test_its_sync_does_not_move_the_clock_and_the_worlds_time_goes_on(served):
    tcp = served.join()
    before = served.world.now
    for _ in range(3):
        tcp.send(0x080)
    tcp.send(0x603, READ_STATUS)
    tcp.until(ANSWER)
    assert served.server._clock is None
    wait_for(lambda: served.world.now > before + 20_000_000)


def test_a_master_in_lock_step_leads_and_the_client_follows(served):
    local, tcp = served.join_local(), served.join()
    local.send(Frame(0x080, b""))
    tcp.until(0x080)
    tcp.send(0x080)
    tcp.send(0x603, READ_STATUS)
    frames_until(local, ANSWER)
    wait_for(lambda: served.world.now % 1_000_000_000 == 2_000_000)  # one period of the one that leads


# -- bounds ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_who_does_not_read_is_dropped_and_the_others_go_on(served, monkeypatch):
    monkeypatch.setattr(virtualcan, "MAX_BACKLOG_BYTES", 1 << 12)
    silent, busy, reader = served.join(), served.join(), served.join()
    silent.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    wait_for(lambda: len(served.server._clients) == 3)
    sent = 0
    while not served.told and sent < 2_000_000:
        busy.socket.sendall(message(0x123, bytes(8)) * 100)
        sent += 100
        for _ in range(100):
            assert reader.receive()[0] == 0x123
    assert [line.split(":", 2)[0] for line in served.told] == ["virtualcan client 127.0.0.1"]
    assert served.told[0].startswith(f"virtualcan client {silent.name} is dropped: it has not read ")
    wait_for(lambda: len(served.server._clients) == 2)
    busy.send(0x603, READ_STATUS)
    assert busy.until(ANSWER)


def test_a_client_beyond_the_last_place_is_turned_away_and_the_others_stay(served, monkeypatch):
    monkeypatch.setattr("plant_emulator.bus.server.MAX_CLIENTS", 3)
    clients = [served.join() for _ in range(3)]
    wait_for(lambda: len(served.server._clients) == 3)
    late = Tcp(served.listener.endpoint)
    assert late.receive() is None
    late.close()
    assert served.told == [f"virtualcan client {late.name} is rejected: 32 clients are on the bus already"]
    clients[0].send(0x603, READ_STATUS)
    assert clients[2].until(ANSWER)
    clients[1].close()
    wait_for(lambda: len(served.server._clients) == 2)
    again = served.join()  # its place is free again
    again.send(0x603, READ_STATUS)
    assert again.until(ANSWER)
    assert len(served.told) == 1


def test_clients_that_come_and_go_at_once_leave_nothing(served):
    for i in range(40):
        client = Tcp(served.listener.endpoint)
        client.send(0x123)
        if i % 2:  # with a reset instead of an end
            client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        client.close()
    wait_for(lambda: not served.server._clients)
    assert served.told == []


# -- as its user has it ------------------------------------------------------------------------------------------------


def start(tmp_path, *options):
    return subprocess.Popen(
        [sys.executable, "-m", "plant_emulator", "serve", "--bus", f"local:{tmp_path / 'robot.sock'}", *options],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


@pytest.mark.ci
def test_the_command_prints_the_port_answers_there_and_ends(tmp_path):
    process = start(tmp_path, "--virtualcan", "0", "--wall", "--until-stdin-closes")
    line = ""
    while not line.startswith("virtualcan: "):
        line = process.stdout.readline()
        assert line, process.communicate()[1]
    host, _, port = line.removeprefix("virtualcan: ").strip().partition(":")
    client, bad = Tcp((host, int(port))), Tcp((host, int(port)))
    bad.socket.sendall(b"GET / HTTP/1.1\r\n\r\n")
    assert bad.receive() is None
    client.send(0x603, READ_STATUS)
    assert client.until(ANSWER)[2][:4] == bytes.fromhex("4b416000")
    _, errors = process.communicate(timeout=30)  # closes standard input
    assert client.receive() is None
    client.close()
    bad.close()
    assert process.returncode == 0
    said = [line for line in errors.splitlines() if "ms late" not in line]  # a busy machine may be
    assert said == [f"virtualcan client {bad.name} is dropped: a message of {int.from_bytes(b'GET ', 'big')} bytes; expected 14"]


def test_the_command_refuses_what_cannot_be_with_the_reason(tmp_path):
    from typer.testing import CliRunner  # noqa: PLC0415

    from plant_emulator.cli.main import app  # noqa: PLC0415

    def refused(*options):
        result = CliRunner().invoke(app, ["serve", *options])
        return result.exit_code, result.output

    local = f"local:{tmp_path / 'robot.sock'}"
    assert refused("--bus", local, "--virtualcan", "0.0.0.0:1")[0] == 2
    assert "without a password" in refused("--bus", local, "--virtualcan", "0.0.0.0:1")[1]
    assert refused("--bus", "socketcan:vcan0", "--virtualcan", "1") == (
        2, "--virtualcan needs a bus local:PATH, not socketcan:vcan0\n"
    )  # fmt: skip
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        code, output = refused("--bus", local, "--virtualcan", str(port))
    assert code == 4
    assert f"--virtualcan 127.0.0.1:{port}: Address already in use; --virtualcan 0 takes a free port\n" in output
