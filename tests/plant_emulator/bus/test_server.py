"""The local bus on a real Unix socket: who hears what, who can harm whom, and which clock is in force."""

import contextlib
import os
import signal
import socket
import stat
import struct
import subprocess
import time
from pathlib import Path

import pytest

from drive_profiles.address import Address
from drive_profiles.standard.cia402 import Mode, Object, State
from hil.can.frame import RECORD, Frame
from hil.can.local import LocalChannel
from plant_emulator.bus import clients as clients_module
from plant_emulator.bus.clients import MAX_CLIENTS
from plant_emulator.bus.server import Server
from plant_emulator.world import World
from tests.plant_emulator.bus.conftest import closing, drain, frames_until, record, wait_for
from tests.plant_emulator.rig import ONE_AXIS

READ_STATUS = Frame(0x603, bytes.fromhex("4041600000000000"))
SYNC = Frame(0x080, b"")
ANSWER, BEAT = 0x583, 0x703


def write(channel, index, sub, data, node=3):
    channel.send(Frame(0x600 + node, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub) + data.ljust(4, b"\0")))
    answer = frames_until(channel, 0x580 + node)[-1]
    assert answer.data[0] == 0x60, f"{index:04X}h:{sub:02X}h refused: {answer.data.hex()}"


def enable(channel):
    write(channel, Object.MODES_OF_OPERATION, 0, bytes((Mode.CSP,)))
    channel.send(Frame(0x000, b"\x01\x00"))
    for word in (0x06, 0x07, 0x0F):
        write(channel, Object.CONTROL_WORD, 0, struct.pack("<H", word))


def still(running, seconds=0.1):
    """Whether the world's time stands."""
    before = running.world.now
    time.sleep(seconds)
    return running.world.now == before


def lock(channel, running):
    """The first SYNC, and its period: whole seconds and 2 ms."""
    channel.send(SYNC)
    wait_for(lambda: running.server._clock is not None and running.world.now % 1_000_000_000 == 2_000_000)


# -- who hears what ----------------------------------------------------------------------------------------------------


def test_every_client_hears_the_others_and_the_nodes_but_not_itself(either):
    first, second, third = either.join(), either.join(), either.join()
    first.send(READ_STATUS)
    for other in (second, third):
        assert [f.can_id for f in frames_until(other, ANSWER)] == [0x603, ANSWER]
    assert [f.can_id for f in frames_until(first, ANSWER)] == [ANSWER]
    third.send(Frame(0x123, b"\1\2\3"))
    for other in (first, second):
        assert frames_until(other, 0x123)[-1] == Frame(0x123, b"\1\2\3")
    assert drain(third) == []


def test_frames_of_every_kind_pass_as_they_are(either):
    first, second = either.join(), either.join()
    frames = [
        Frame(0x7FF, bytes(range(8))),
        Frame(0x0, b""),
        Frame(0x8000_0000 | 0x1FFF_FFFF, b"\xff"),
        Frame(0x4000_0000 | 0x123, bytes(4)),
        Frame(0x2000_0000 | 0x04, bytes(8)),
    ]
    for frame in frames:
        first.send(frame)
    assert [second.receive(1.0) for _ in frames] == frames


def test_many_requests_are_all_answered_in_their_order(either):
    channel = either.join()
    for i in range(300):
        channel.send(Frame(0x603, struct.pack("<BHB4x", 0x40, 0x2110, i % 11)))
        assert frames_until(channel, ANSWER)[-1].data[3] == i % 11


def test_a_client_beyond_the_last_place_is_sent_away_and_the_others_stay(running):
    channels = [running.join() for _ in range(MAX_CLIENTS)]
    with closing(socket.socket(socket.AF_UNIX, running.kind)) as late:
        late.connect(running.path)
        late.settimeout(5.0)
        assert late.recv(16) == b""
    channels[0].send(READ_STATUS)
    assert frames_until(channels[-1], ANSWER)


# -- who can harm whom -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("length", [1, 15, 17, 32, 64, 1000, 60_000])
def test_records_of_a_wrong_length_harm_nothing(running, length):
    bad, good = running.plug(), running.join()
    bad.send(b"\xff" * length)
    bad.send(record(0x603, READ_STATUS.data))
    assert [f.can_id for f in frames_until(good, ANSWER)] == [0x603, ANSWER]
    assert RECORD.unpack(bad.recv(64))[0] == ANSWER  # and its sender is still there


@pytest.mark.parametrize("length", [9, 16, 64, 255])
def test_records_that_announce_too_many_bytes_harm_nothing(either, length):
    bad, good = either.plug(), either.join()
    bad.send(struct.pack("=IB3x8s", 0x603, length, b"\xff" * 8))
    bad.send(record(0x603, READ_STATUS.data))
    assert [f.can_id for f in frames_until(good, ANSWER)] == [0x603, ANSWER]


def test_an_empty_record_ends_the_connection_of_its_sender_only(running):
    """On a seqpacket socket it cannot be told from the end."""
    bad, good = running.plug(), running.join()
    bad.send(b"")
    assert bad.recv(16) == b""
    good.send(READ_STATUS)
    assert frames_until(good, ANSWER)


def test_a_stream_may_come_in_pieces(start_server):
    running = start_server(stream=True)
    split, good = running.plug(), running.join()
    whole = record(0x123, b"\1") + record(0x124, b"\2") + record(0x125, b"\3")
    for piece in (whole[:5], whole[5:16], whole[16:40], whole[40:]):
        split.send(piece)
        time.sleep(0.01)
    assert [f.can_id for f in frames_until(good, 0x125)] == [0x123, 0x124, 0x125]


def exchange(channel, count, first=0):
    """Frames with a number to the others, each followed by a request that must be answered."""
    for i in range(first, first + count):
        channel.send(Frame(0x123, struct.pack("<I", i)))
        channel.send(READ_STATUS)
        assert frames_until(channel, ANSWER)


def received(sock, silence_s=0.5):
    """What comes until nothing comes any more."""
    parts = []
    sock.settimeout(silence_s)
    with contextlib.suppress(TimeoutError):
        while True:
            parts.append(sock.recv(1 << 16))
    return parts


def numbers(records):
    return [struct.unpack_from("<I", data, 8)[0] for data in records if data[:4] == struct.pack("<I", 0x123)]


@pytest.mark.wall
def test_a_client_that_does_not_read_loses_frames_and_hurts_nobody(start_server, monkeypatch):
    monkeypatch.setattr(clients_module, "SEND_BUFFER_BYTES", 1 << 16)
    running = start_server()
    slow, fast, watcher = running.plug(), running.join(), running.join()
    client = next(iter(running.server._clients.values()))  # the first that joined
    for i in range(500):
        exchange(fast, 1, first=i)
        assert [f.can_id for f in frames_until(watcher, ANSWER)] == [0x123, 0x603, ANSWER]
    assert client.dropped > 0
    kept = received(slow)
    assert all(len(data) == 16 for data in kept)
    assert numbers(kept) == list(range(len(numbers(kept))))  # the oldest, in their order
    exchange(fast, 1, first=9999)
    assert numbers([slow.recv(64)]) == [9999]  # it hears again


@pytest.mark.wall
def test_a_stream_that_does_not_read_loses_whole_records_and_recovers(start_server, monkeypatch):
    monkeypatch.setattr(clients_module, "STREAM_BACKLOG_BYTES", 4096)
    running = start_server(stream=True)
    slow = running.plug()
    (client,) = running.server._clients.values()
    fast = running.join()
    deadline = time.monotonic() + 20.0
    count = 0
    while not client.dropped:
        exchange(fast, 100, first=count)
        count += 100
        assert time.monotonic() < deadline
    data = b"".join(received(slow))
    exchange(fast, 1, first=99_999)
    data += b"".join(received(slow))
    assert len(data) % 16 == 0
    seen = numbers([data[i : i + 16] for i in range(0, len(data), 16)])
    assert seen[:100] == list(range(100))
    assert seen[-1] == 99_999
    assert seen == sorted(seen)


def test_what_waits_for_a_stream_reaches_it_without_another_frame(start_server):
    """In lock-step nothing else may come for a long time."""
    running = start_server(stream=True)
    fast, slow = running.join(), running.plug()
    fast.send(SYNC)
    fast.send(SYNC)
    wait_for(lambda: running.server._clock is not None)
    client = list(running.server._clients.values())[-1]
    count = 0
    while not len(client._backlog) > 64:  # one record may be there for an instant
        exchange(fast, 50, first=count)
        count += 50
    data = b"".join(received(slow))
    assert numbers([data[i : i + 16] for i in range(0, len(data), 16)]) == list(range(count))


def test_a_client_that_goes_in_the_middle_of_everything_is_not_missed(either):
    stay = either.join()
    for _ in range(20):
        with closing(socket.socket(socket.AF_UNIX, either.kind)) as gone:
            gone.connect(either.path)
            gone.send(record(0x603, READ_STATUS.data))
        stay.send(READ_STATUS)
        assert frames_until(stay, ANSWER)
    wait_for(lambda: len(either.server._clients) == 1)


# -- which clock -------------------------------------------------------------------------------------------------------


def test_before_the_first_sync_the_world_runs_by_itself(running):
    channel = running.join()
    write(channel, 0x1017, 0, struct.pack("<H", 20))
    running.hold_wall()
    drain(channel)
    before = running.world.now
    assert still(running)
    running.pass_wall_s(0.2)
    for _ in range(10):
        frames_until(channel, BEAT)
    wait_for(lambda: running.world.now == before + 200_000_000)
    assert drain(channel) == []
    assert still(running)


def test_with_the_first_sync_time_is_counted_in_syncs(running):
    channel = running.join()
    lock(channel, running)
    assert still(running)
    write(channel, 0x1017, 0, struct.pack("<H", 20))
    drain(channel)
    before = running.world.now
    for _ in range(100):
        channel.send(SYNC)
    frames = drain(channel)
    assert running.world.now == before + 200_000_000
    assert [f.can_id for f in frames].count(BEAT) == 10
    assert still(running)


def test_the_clocks_holder_is_served_in_its_own_turn_alone(running, monkeypatch):
    """What is read beside that turn passes frame by frame, not as a cycle: half of it did, and runs took twice as long."""
    channel = running.join()
    lock(channel, running)
    beside, read = [], running.server._read
    monkeypatch.setattr(running.server, "_read", lambda descriptor: (beside.append(descriptor), read(descriptor)))
    before = running.world.now
    for _ in range(1000):
        channel.send(SYNC)
    wait_for(lambda: running.world.now == before + 2_000_000_000)
    assert not beside


def test_requests_are_answered_while_time_stands(running):
    channel = running.join()
    lock(channel, running)
    before = running.world.now
    channel.send(READ_STATUS)
    assert frames_until(channel, ANSWER)
    assert running.world.now == before


def test_after_the_sender_of_sync_has_gone_the_world_goes_on_by_itself(running):
    channel, other = running.join(), running.join()
    lock(channel, running)
    frames_until(other, 0x080)
    running.wall.hold()
    running.wall.pass_s(10.0)
    assert still(running)
    before = running.world.now
    channel.close()
    wait_for(lambda: running.server._clock is None)
    assert still(running)  # no jump over the time that stood
    running.pass_wall_s(0.1)
    assert running.world.now == before + 100_000_000


def test_a_drive_stops_by_itself_when_its_master_has_gone(running):
    master = running.join()
    lock(master, running)
    write(master, 0x1016, 1, struct.pack("<I", 127 << 16 | 60))
    write(master, 0x1006, 0, struct.pack("<I", 2000))
    enable(master)
    master.send(Frame(0x77F, b"\x05"))
    for _ in range(10):
        master.send(SYNC)
    wait_for(lambda: running.drive.state is State.OPERATION_ENABLED)
    wait_for(lambda: running.world.now % 1_000_000_000 == 22_000_000)
    running.wall.hold()
    running.wall.pass_s(0.2)
    assert still(running)
    assert running.drive.state is State.OPERATION_ENABLED  # lock-step: no time has passed for the drive either
    master.close()
    wait_for(lambda: not running.server._clients)
    assert running.drive.state is State.OPERATION_ENABLED
    witness = running.join()
    running.pass_wall_s(1.0)
    wait_for(lambda: running.drive.state is State.SWITCH_ON_DISABLED)
    witness.send(Frame(0x603, bytes.fromhex("4003100100000000")))  # its error history
    assert frames_until(witness, ANSWER)[-1].data[4:6] == b"\x30\x81"


def test_the_last_sender_of_sync_holds_the_clock(running):
    first, second = running.join(), running.join()
    first.send(SYNC)
    frames_until(second, 0x080)
    second.send(SYNC)
    frames_until(first, 0x080)
    first.close()
    wait_for(lambda: len(running.server._clients) == 1)
    assert still(running)
    second.close()
    wait_for(lambda: not still(running, 0.01))


def test_the_answers_to_a_sync_come_before_what_its_period_brings(running):
    channel = running.join()
    lock(channel, running)
    channel.send(Frame(0x000, b"\x01\x10"))
    write(channel, 0x1017, 0, struct.pack("<H", 2))
    drain(channel)
    for _ in range(5):
        channel.send(SYNC)
        assert [f.can_id for f in (channel.receive(1.0), channel.receive(1.0))] == [0x190, BEAT]


# -- the path ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stream", [False, True])
def test_only_its_user_may_join(start_server, tmp_path, stream):
    before = os.umask(0o022)
    try:
        start_server(stream, tmp_path / "private.sock")
        assert stat.S_IMODE((tmp_path / "private.sock").stat().st_mode) == 0o600
        assert os.umask(0o022) == 0o022  # and the umask is what it was
    finally:
        os.umask(before)


def test_a_socket_that_nobody_serves_is_replaced(start_server, tmp_path):
    path = tmp_path / "stale.sock"
    for kind in (socket.SOCK_SEQPACKET, socket.SOCK_STREAM):
        with closing(socket.socket(socket.AF_UNIX, kind)) as stale:
            stale.bind(str(path))
        assert path.is_socket()
        running = start_server(path=path)
        running.join().send(READ_STATUS)
        running.close()
        assert not path.exists()


@pytest.mark.parametrize("stream", [False, True])
def test_whoever_sees_the_socket_can_join(monkeypatch, tmp_path, stream):
    path, listen, named = tmp_path / "robot.sock", socket.socket.listen, []

    def watched(sock, *backlog):
        named.append(path.exists())
        listen(sock, *backlog)

    monkeypatch.setattr(socket.socket, "listen", watched)
    server = Server(World(ONE_AXIS), str(path), stream=stream)
    try:
        assert named == [False]
        assert [each.name for each in tmp_path.iterdir()] == ["robot.sock"]
    finally:
        server.close()


@pytest.mark.parametrize("stream", [False, True])
@pytest.mark.parametrize("second", [False, True])
def test_a_path_where_another_server_answers_is_refused(start_server, stream, second):
    running = start_server(stream)
    with pytest.raises(OSError, match=f"another server answers at {running.path}"):
        Server(World(ONE_AXIS), running.path, stream=second)
    assert Path(running.path).is_socket()
    wait_for(lambda: not running.server._clients)  # the other one's question, whether anyone is there
    channel = running.join()
    channel.send(READ_STATUS)
    assert frames_until(channel, ANSWER)


def test_a_file_that_is_no_socket_is_left_alone(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("keep me")
    with pytest.raises(OSError, match="is a file; choose another path"):
        Server(World(ONE_AXIS), str(path))
    assert path.read_text() == "keep me"


def test_at_its_end_it_leaves_a_path_that_is_another_servers_now(start_server, tmp_path):
    first = start_server()
    Path(first.path).unlink()
    second = start_server()
    first.close()
    assert Path(second.path).is_socket()
    channel = second.join()
    channel.send(READ_STATUS)
    assert frames_until(channel, ANSWER)


# -- the process -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("number", "state"), [(signal.SIGINT, "free"), (signal.SIGTERM, "lock-step")])
def test_a_signal_ends_it_and_removes_the_socket(serve, number, state):
    process, path = serve()
    channel = LocalChannel(Address("local", str(path)))
    try:
        if state == "lock-step":
            channel.send(SYNC)
            drain(channel, 0.3)
        process.send_signal(number)
        _, errors = process.communicate(timeout=10)
        assert process.returncode == 0, errors
        assert errors == ""
        assert not path.exists()
    finally:
        channel.close()


@pytest.mark.slow
def test_a_second_server_at_the_same_path_ends_with_status_4(serve):
    first, path = serve()
    second, _ = serve(wait=False)
    _, errors = second.communicate(timeout=60)
    assert second.returncode == 4
    assert str(path) in errors
    assert "Traceback" not in errors
    assert first.poll() is None
    assert path.is_socket()


def test_it_lives_as_long_as_its_standard_input_is_open(serve):
    process, path = serve("--until-stdin-closes", stdin=subprocess.PIPE)
    process.stdin.write("anything\n")
    process.stdin.flush()
    channel = LocalChannel(Address("local", str(path)))
    exchange(channel, 1)  # so it has looked at both
    channel.close()
    assert process.poll() is None
    process.stdin.close()
    assert process.wait(timeout=10) == 0
    assert not path.exists()
    process.stdin = None  # communicate must not flush it again


@pytest.mark.ci
def test_it_ends_at_once_where_nobody_holds_its_standard_input(serve):
    process, path = serve("--until-stdin-closes", wait=False)
    output, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")
    assert output.startswith("serving")
    assert not path.exists()


@pytest.mark.ci
def test_a_path_that_cannot_be_bound_ends_with_status_4(serve):
    process, path = serve(name="no/such/folder.sock", wait=False)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 4
    assert str(path) in errors
    assert "Traceback" not in errors
