"""The raw channel against a bare socket at the other end: frames, time-outs, and failures that are latched."""

import contextlib
import errno
import os
import select
import signal
import socket
import struct
import threading
import time

import numpy as np
import pytest

from drive_profiles.address import Address
from hil.can import clock, local
from hil.can.errors import BusLostError, BusUnavailableError, ChannelError
from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, Frame, pack
from hil.can.local import LocalChannel
from hil.can.opening import open_channel
from hil.core.library import CORE

FOR_EVER_S = 600.0
"""Longer than a test may take."""

KINDS = {"seqpacket": socket.SOCK_SEQPACKET, "stream": socket.SOCK_STREAM}


def answered(listener, kind=clock.LOCK_STEP, bitrate=None, several=False):
    """The next connection, its question about the clock answered."""
    sock, _ = listener.accept()
    sock.settimeout(5.0)
    is_stream = sock.type == socket.SOCK_STREAM
    assert sock.recv(16) == pack(clock.question(several=not is_stream))
    sock.send(pack(clock.answer(kind, bitrate, several=several)))
    return sock


class Peer:
    """A listening socket, and the connection that the channel made."""

    def __init__(self, path, kind, **says):
        self.address = Address("local", str(path))
        self.listener = socket.socket(socket.AF_UNIX, kind)
        self.listener.bind(str(path))
        self.listener.listen(4)
        accepted = []
        welcome = threading.Thread(target=lambda: accepted.append(answered(self.listener, **says)))
        welcome.start()
        self.channel = LocalChannel(self.address)
        welcome.join()
        [self.socket] = accepted

    def send(self, *frames):
        for frame in frames:
            self.socket.send(pack(frame))

    def close(self):
        for each in (self.socket, self.listener, self.channel):
            each.close()


@pytest.fixture(params=KINDS)
def peer(request, tmp_path):
    with contextlib.closing(Peer(tmp_path / "bus.sock", KINDS[request.param])) as peer:
        yield peer


@pytest.fixture
def packets(tmp_path):
    with contextlib.closing(Peer(tmp_path / "bus.sock", socket.SOCK_SEQPACKET)) as peer:
        yield peer


@pytest.fixture
def lumps(tmp_path):
    """A bus that understands messages of several records."""
    with contextlib.closing(Peer(tmp_path / "bus.sock", socket.SOCK_SEQPACKET, several=True)) as peer:
        yield peer


# -- several records in one message ------------------------------------------------------------------------------------

THREE = [Frame(0x201, b"\1"), Frame(0x202 | CAN_RTR_FLAG, b""), Frame(0x80, b"")]


def message(*frames):
    return b"".join(pack(frame) for frame in frames)


def test_frames_that_are_sent_together_go_out_as_one_message(lumps):
    lumps.channel.send_all(THREE)
    assert lumps.socket.recv(1024) == message(*THREE)


def test_a_bus_that_does_not_say_so_is_sent_a_message_per_frame(packets):
    packets.channel.send_all(THREE)
    assert [packets.socket.recv(1024) for _ in THREE] == [pack(frame) for frame in THREE]


def test_more_than_a_message_holds_is_sent_one_by_one(lumps):
    many = [Frame(0x100 + i, b"") for i in range(clock.MAX_RECORDS + 1)]
    lumps.channel.send_all(many)
    assert [lumps.socket.recv(2048) for _ in many] == [pack(frame) for frame in many]


def test_a_frame_that_cannot_be_spoils_the_whole_message_before_it_is_sent(lumps):
    with pytest.raises(ValueError, match="8 bytes"):
        lumps.channel.send_all([THREE[0], Frame(0x123, bytes(9))])
    lumps.channel.send(THREE[2])
    assert lumps.socket.recv(1024) == pack(THREE[2])


def test_the_frames_of_a_message_come_together_or_one_by_one(lumps):
    lumps.socket.send(message(*THREE))
    assert lumps.channel.receive_all(1.0) == THREE
    lumps.socket.send(message(*THREE))
    assert [lumps.channel.receive(1.0) for _ in THREE] == THREE
    assert lumps.channel.receive_all(0.0) == []


def test_of_a_message_only_the_records_that_are_frames_are_taken(lumps):
    lumps.socket.send(pack(THREE[0]) + struct.pack("=IB3x8s", 0x123, 9, bytes(8)) + pack(THREE[1]))
    assert lumps.channel.receive_all(1.0) == THREE[:2]
    lumps.socket.send(message(*THREE) + b"\0")
    lumps.socket.send(pack(THREE[2]))
    assert lumps.channel.receive_all(1.0) == [THREE[2]]


def test_a_message_that_is_not_taken_as_a_whole_is_read_frame_by_frame(lumps):
    lumps.channel.send_message(message(*THREE))
    assert lumps.socket.recv(1024) == message(*THREE)
    lumps.socket.send(message(*THREE))
    received = lumps.channel.receive_message(1.0)
    assert received == message(*THREE)
    assert lumps.channel.takes_messages
    lumps.channel.put_back(received)
    assert not lumps.channel.takes_messages  # an answer of this cycle would be taken for one of the next
    assert lumps.channel.receive(1.0) == THREE[0]
    assert lumps.channel.receive_all(1.0) == THREE[1:]
    assert lumps.channel.takes_messages


def test_the_bus_clock_at_the_end_of_a_message_is_heard_and_left_out(lumps):
    lumps.channel.send_message(message(*THREE))
    lumps.socket.send(message(THREE[0], clock.period_over(1)))
    assert lumps.channel.receive_message(1.0) == message(THREE[0])
    lumps.socket.send(message(THREE[1], clock.period_over(7)))  # of another cycle than ours: left to the slow way
    assert lumps.channel.receive_message(1.0) == message(THREE[1], clock.period_over(7))


def test_a_message_that_does_not_come_is_empty_and_a_bus_that_has_gone_is_lost(lumps):
    assert lumps.channel.receive_message(0.01) == b""
    lumps.socket.close()
    with pytest.raises(BusLostError):
        lumps.channel.receive_message(1.0)
    with pytest.raises(BusLostError):
        lumps.channel.send_message(message(*THREE))


def exchanged(channel, timeout_s):
    """What the core says to a cycle with this channel, and what has come."""
    command, room = message(*THREE), np.zeros(1024, np.uint8)
    found = CORE.call.exchange_message(channel.line, command, len(command), timeout_s, CORE.pointer(room, "uint8_t"))
    return found, room[: max(found, 0)].tobytes()


def test_the_core_exchanges_messages_as_the_channel_does(lumps):
    assert exchanged(lumps.channel, 0.01) == (CORE.call.NOT_SENT, b"")  # the socket has another time-out
    assert lumps.channel.receive_message(0.01) == b""
    for count, answer in enumerate((message(THREE[0]), message(*THREE), b""), 1):
        lumps.socket.send(answer + message(clock.period_over(count)))
        assert exchanged(lumps.channel, 0.01) == (len(answer), answer)
        assert lumps.socket.recv(1024) == message(*THREE)
        assert lumps.channel.receive(FOR_EVER_S) is None  # the period is over
        assert lumps.channel.receive_message(0.01) == b""
    lumps.socket.send(stale := message(THREE[1], clock.period_over(7)))
    assert exchanged(lumps.channel, 0.01) == (32, stale)
    assert exchanged(lumps.channel, 0.01) == (0, b"")
    lumps.socket.send(message(THREE[0], clock.period_over(6)))
    lumps.channel.send_message(message(*THREE))
    assert lumps.channel.receive_message(0.01) == message(THREE[0])  # its SYNCs are counted with ours


def test_the_core_leaves_a_bus_that_has_gone_and_one_that_is_closed_to_the_channel(lumps):
    assert lumps.channel.receive_message(0.01) == b""
    lumps.socket.close()
    assert exchanged(lumps.channel, 0.01)[0] in {CORE.call.NOT_SENT, CORE.call.NOT_RECEIVED}
    with pytest.raises(BusLostError):
        lumps.channel.receive_message(0.01)
    assert not lumps.channel.takes_messages
    lumps.channel.close()
    assert exchanged(lumps.channel, 0.01)[0] == CORE.call.NOT_SENT


def test_a_signal_ends_the_waiting_of_the_core(lumps):
    lumps.socket.send(message(THREE[0]))
    assert lumps.channel.receive_message(FOR_EVER_S) == message(THREE[0])
    before = signal.signal(signal.SIGALRM, lambda *_: None)
    signal.setitimer(signal.ITIMER_REAL, 0.05)
    try:
        assert exchanged(lumps.channel, FOR_EVER_S)[0] == CORE.call.NOT_RECEIVED
    finally:
        signal.signal(signal.SIGALRM, before)
    assert lumps.socket.recv(1024) == message(*THREE)


def test_other_buses_take_no_messages(peer):
    assert not peer.channel.takes_messages


def test_the_end_of_a_period_is_told_once_and_behind_its_frames(lumps):
    lumps.channel.send_all(THREE)
    lumps.socket.send(message(THREE[0], clock.period_over(1)))
    assert lumps.channel.receive(5.0) == THREE[0]
    assert lumps.channel.receive(FOR_EVER_S) is None
    lumps.socket.send(pack(THREE[1]))
    assert lumps.channel.receive(5.0) == THREE[1]


def test_the_end_of_a_period_that_nobody_waited_for_does_not_end_the_next(lumps):
    lumps.channel.send_all(THREE)
    lumps.socket.send(message(THREE[0], clock.period_over(1)))
    assert lumps.channel.receive_all(5.0) == [THREE[0]]
    lumps.channel.send_all(THREE)
    answer = threading.Timer(0.05, lambda: lumps.socket.send(pack(THREE[1])))
    answer.start()
    assert lumps.channel.receive_all(5.0) == [THREE[1]]
    answer.join()


# -- frames ------------------------------------------------------------------------------------------------------------


def test_a_frame_goes_out_as_one_record_of_linux(peer):
    peer.channel.send(Frame(0x123 | CAN_RTR_FLAG, b"\1\2"))
    assert peer.socket.recv(64) == struct.pack("=IB3x8s", 0x4000_0123, 2, b"\1\2")


def test_frames_come_in_their_order_as_they_were_sent(peer):
    frames = [Frame(0x123, b""), Frame(0x1FFF_FFFF | CAN_EFF_FLAG, bytes(range(8))), Frame(0x7FF | CAN_RTR_FLAG, bytes(3))]
    peer.send(*frames)
    assert [peer.channel.receive(1.0) for _ in frames] == frames
    assert peer.channel.receive(0.0) is None


def test_a_stream_may_come_in_pieces_and_in_lumps(tmp_path):
    with contextlib.closing(Peer(tmp_path / "bus.sock", socket.SOCK_STREAM)) as peer:
        whole = b"".join(pack(Frame(0x100 + i, bytes((i,)))) for i in range(4))
        for piece in (whole[:7], whole[7:20], whole[20:]):
            peer.socket.send(piece)
        assert [peer.channel.receive(1.0).can_id for _ in range(4)] == [0x100, 0x101, 0x102, 0x103]


@pytest.mark.parametrize("record", [b"\1", b"\xff" * 15])
def test_a_record_of_a_wrong_length_is_passed_over(packets, record):
    packets.socket.send(record)
    packets.send(Frame(0x124, b""))
    assert packets.channel.receive(1.0) == Frame(0x124, b"")


def test_a_record_that_announces_too_many_bytes_is_passed_over(peer):
    """The frame behind it is there already: it must not wait for the next one."""
    peer.socket.send(struct.pack("=IB3x8s", 0x123, 9, bytes(8)))
    peer.send(Frame(0x124, b""), Frame(0x125, b""))
    assert [peer.channel.receive(1.0).can_id for _ in range(2)] == [0x124, 0x125]


def test_a_frame_that_cannot_be_is_its_callers_mistake_and_not_the_buses(peer):
    with pytest.raises(ValueError, match="8 bytes"):
        peer.channel.send(Frame(0x123, bytes(9)))
    peer.channel.send(Frame(0x123, b""))
    assert len(peer.socket.recv(64)) == 16


def test_time_on_a_local_bus_is_counted_in_syncs(packets):
    assert packets.channel.is_lock_step
    assert packets.channel.address == packets.address


# -- time --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("timeout_s", [0.0, 50e-6, 0.02, 0.1])
def test_without_a_frame_it_waits_as_long_as_it_is_told(packets, timeout_s):
    started = time.monotonic()
    assert packets.channel.receive(timeout_s) is None
    assert time.monotonic() - started >= timeout_s
    if timeout_s:
        asked = packets.channel._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, 16)
        seconds, microseconds = struct.unpack("ll", asked)
        assert -1e-9 <= seconds + 1e-6 * microseconds - timeout_s <= 0.01  # the kernel counts in jiffies


def test_a_negative_time_out_is_none(packets):
    packets.send(Frame(0x123, b""))
    assert packets.channel.receive(-1.0) is not None
    assert packets.channel.receive(-1.0) is None


def test_a_frame_ends_the_wait(packets):
    timer = threading.Timer(0.05, packets.send, [Frame(0x123, b"")])
    started = time.monotonic()
    timer.start()
    assert packets.channel.receive(FOR_EVER_S) == Frame(0x123, b"")
    assert time.monotonic() - started > 0.04
    timer.join()


def test_a_long_wait_sleeps(packets):
    """It polls for 150 µs, not for the whole time."""
    before = time.thread_time()
    packets.channel.receive(0.3)
    assert time.thread_time() - before < 0.1


# -- a bus that is not there -------------------------------------------------------------------------------------------


def test_where_nobody_serves_it_says_what_to_start(tmp_path):
    address = Address("local", str(tmp_path / "nobody.sock"))
    with pytest.raises(BusUnavailableError) as refused:
        LocalChannel(address)
    assert refused.value.address == address
    assert os.strerror(errno.ENOENT) in str(refused.value)
    assert f"plant-emulator serve --bus {address}" in str(refused.value)


def test_a_socket_that_was_left_behind_is_no_bus(tmp_path):
    path = tmp_path / "left.sock"
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)) as left:
        left.bind(str(path))
    with pytest.raises(BusUnavailableError, match="refused"):
        LocalChannel(Address("local", str(path)))


def test_an_interface_that_does_not_exist_is_no_bus():
    with pytest.raises(BusUnavailableError, match="socketcan:nosuch0"):
        open_channel(Address("socketcan", "nosuch0"))


@pytest.mark.parametrize("error", [BusUnavailableError, BusLostError])
def test_both_errors_are_the_channels(error):
    shown = error(Address("local", "/x"), "gone")
    assert isinstance(shown, ChannelError)
    assert (shown.address, shown.reason) == (Address("local", "/x"), "gone")


def send_many(channel, count):
    for _ in range(count):
        channel.send(Frame(0x123, b""))


# -- a bus that goes ---------------------------------------------------------------------------------------------------


def assert_lost_for_ever(channel):
    with pytest.raises(BusLostError) as first:
        channel.receive(1.0)
    for _ in range(2):
        with pytest.raises(BusLostError) as again:
            channel.send(Frame(0x123, b""))
        assert again.value is first.value
        with pytest.raises(BusLostError) as again:
            channel.receive(0.0)
        assert again.value is first.value


def test_a_server_that_goes_is_lost_now_and_for_ever(peer):
    peer.socket.close()
    assert_lost_for_ever(peer.channel)


def test_a_server_that_comes_back_needs_a_new_channel(peer):
    peer.socket.close()
    assert_lost_for_ever(peer.channel)
    accepted = []
    welcome = threading.Thread(target=lambda: accepted.append(answered(peer.listener)))
    welcome.start()
    with contextlib.closing(LocalChannel(peer.address)) as new:
        welcome.join()
        with contextlib.closing(accepted[0]) as served:
            new.send(Frame(0x123, b""))
            assert len(served.recv(64)) == 16
    assert_lost_for_ever(peer.channel)


def test_what_came_before_the_end_is_still_delivered(packets):
    packets.send(Frame(0x123, b""), Frame(0x124, b""))
    packets.socket.close()
    assert [packets.channel.receive(1.0).can_id for _ in range(2)] == [0x123, 0x124]
    assert_lost_for_ever(packets.channel)


def test_a_send_that_finds_the_end_latches_it_too(peer):
    peer.socket.close()
    with pytest.raises(BusLostError) as first:
        send_many(peer.channel, 3)
    with pytest.raises(BusLostError) as again:
        peer.channel.receive(0.0)
    assert again.value is first.value


def test_the_end_wakes_a_receiver_that_sleeps(packets):
    timer = threading.Timer(0.05, packets.socket.shutdown, [socket.SHUT_RDWR])
    timer.start()
    with pytest.raises(BusLostError):
        packets.channel.receive(FOR_EVER_S)
    timer.join()


def test_a_closed_channel_is_lost_and_may_be_closed_again(peer):
    peer.channel.close()
    peer.channel.close()
    with pytest.raises(BusLostError):
        peer.channel.send(Frame(0x123, b""))


def test_a_server_that_reads_late_is_waited_for_a_moment(packets):
    def fill():
        count = 0
        while select.select([], [packets.channel._socket], [], 0)[1]:
            packets.channel.send(Frame(0x123, struct.pack("<I", count)))
            count += 1
        return count

    count = fill()
    late = threading.Timer(0.1, packets.socket.recv, [64])
    late.start()
    packets.channel.send(Frame(0x123, struct.pack("<I", count)))  # no loss, no error
    late.join()
    seen = [struct.unpack_from("<I", packets.socket.recv(64), 8)[0] for _ in range(count)]
    assert seen == list(range(1, count + 1))


def test_a_server_that_never_reads_is_lost(packets, monkeypatch):
    monkeypatch.setattr(local, "_SENSIBLE_SEND_S", 0.05)
    with pytest.raises(BusLostError, match="does not drain"):
        send_many(packets.channel, 100_000)
    assert_lost_for_ever(packets.channel)


def test_bus_off_is_a_lost_bus(peer):
    peer.send(Frame(CAN_ERR_FLAG | 0x40, bytes(8)))
    assert_lost_for_ever(peer.channel)


@pytest.mark.parametrize("error_class", [0x01, 0x04, 0x08, 0x20, 0x80])
def test_other_error_frames_are_frames(packets, error_class):
    packets.send(Frame(CAN_ERR_FLAG | error_class, bytes(8)))
    assert packets.channel.receive(1.0) == Frame(CAN_ERR_FLAG | error_class, bytes(8))
