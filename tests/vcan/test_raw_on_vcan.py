"""The raw channel on a real SocketCAN interface: what breaks there is told once and latched."""

import contextlib
import socket
import struct
import time

import can
import pytest

from drive_profiles.address import Address
from hil.can.errors import BusLostError, BusUnavailableError
from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, Frame, pack
from hil.can.opening import open_channel
from hil.can.socketcan import CAN_BUFFER_BYTES, SocketCanChannel
from tests.vcan.conftest import ip, tc

pytestmark = pytest.mark.vcan


@pytest.fixture
def pair(spare):
    near, far = SocketCanChannel(spare), SocketCanChannel(spare)
    yield near, far
    near.close()
    far.close()


def assert_latched(channel, words):
    with pytest.raises(BusLostError, match=words) as first:
        channel.receive(1.0)
    for access in (lambda: channel.receive(0.0), lambda: channel.send(Frame(0x80, b""))):
        with pytest.raises(BusLostError) as again:
            access()
        assert again.value is first.value


def send_many(channel, count):
    for number in range(count):
        channel.send(Frame(0x200 + number, b""))


FRAMES = [
    Frame(0x123, bytes(range(8))),
    Frame(0, b""),
    Frame(0x1FFF_FFFF | CAN_EFF_FLAG, b"\7"),
    Frame(0x7FF | CAN_RTR_FLAG, bytes(5)),
]


@pytest.mark.parametrize("frame", FRAMES)
def test_frames_pass_as_they_are_and_their_sender_does_not_hear_them(pair, frame):
    near, far = pair
    near.send(frame)
    assert far.receive(1.0) == frame
    assert near.receive(0.05) is None


def test_python_can_on_the_same_interface_understands(spare):
    channel = open_channel(spare)
    with can.Bus(interface="socketcan", channel=spare.channel) as stranger:
        channel.send(Frame(0x182, b"\1\2"))
        message = stranger.recv(1.0)
        assert (message.arbitration_id, bytes(message.data)) == (0x182, b"\1\2")
        stranger.send(can.Message(arbitration_id=0x202, data=b"\3", is_extended_id=False))
        assert channel.receive(1.0) == Frame(0x202, b"\3")
    channel.close()


def test_an_interface_that_is_down_is_not_opened(spare):
    ip("link", "set", spare.channel, "down")
    with pytest.raises(BusUnavailableError, match=f"is down; run: ip link set {spare.channel} up"):
        SocketCanChannel(spare)


def test_no_interface_is_no_bus():
    with pytest.raises(BusUnavailableError, match="No such device"):
        SocketCanChannel(Address("socketcan", "nosuch0"))


def test_an_interface_that_goes_down_is_lost_although_it_comes_back(pair, spare):
    near, far = pair
    ip("link", "set", spare.channel, "down")
    assert_latched(near, "is down")
    ip("link", "set", spare.channel, "up")
    assert_latched(near, "is down")
    assert_latched(far, "is down")  # it has not asked before; the kernel has kept the failure for it
    new = SocketCanChannel(spare)  # re-armed by a person: a new channel
    new.send(Frame(0x80, b""))
    new.close()


def test_a_send_finds_an_interface_that_is_down(pair, spare):
    ip("link", "set", spare.channel, "down")
    with pytest.raises(BusLostError, match="is down"):
        pair[0].send(Frame(0x80, b""))


def test_an_interface_that_is_deleted_is_lost(pair, spare):
    ip("link", "del", spare.channel)
    for channel in pair:
        assert_latched(channel, r"is down|is gone")


def test_a_full_transmit_queue_is_a_lost_bus_and_no_set_point_is_sent_late(pair, spare, netem):
    near, far = pair
    tc("add", "dev", spare.channel, "root", "netem", "delay", "500ms", "limit", "3")
    started = time.monotonic()
    with pytest.raises(BusLostError, match="does not drain"):
        send_many(near, 10)
    assert time.monotonic() - started < 0.2
    tc("del", "dev", spare.channel, "root")
    assert_latched(near, "does not drain")
    assert far.receive(0.6) is None  # what waited is gone with its queue


def test_frames_that_are_not_read_in_time_are_counted(spare, monkeypatch):
    monkeypatch.setattr("hil.can.socketcan.CAN_BUFFER_BYTES", 65536)
    with contextlib.closing(SocketCanChannel(spare)) as reader, contextlib.closing(SocketCanChannel(spare)) as writer:
        for number in range(1000):
            writer.send(Frame(0x100, struct.pack("<I", number)))
            if number % 100 == 99:
                time.sleep(0.01)  # a busy kernel hands frames on late: it has none left when the reader begins
        time.sleep(0.2)
        seen = 0
        while reader.receive(0.0) is not None:
            seen += 1
        writer.send(Frame(0x100, b""))
        assert reader.receive(1.0) is not None
        assert 50 < seen < 900
        assert reader.overflows == 1000 - seen


def test_the_buffer_holds_a_third_of_a_second_at_full_load(pair):
    near, far = pair
    for number in range(2500):
        near.send(Frame(0x100, struct.pack("<I", number)))
        if number % 100 == 99:
            time.sleep(0.001)  # before any buffer the kernel holds at most netdev_max_backlog = 1000 frames
    assert [struct.unpack("<I", far.receive(1.0).data)[0] for _ in range(2500)] == list(range(2500))
    assert far.overflows == 0
    assert far._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) >= 2 * CAN_BUFFER_BYTES  # the kernel doubles it


def test_filters_are_the_kernels(spare):
    picky, writer = SocketCanChannel(spare, [(0x182, 0x7FF)]), SocketCanChannel(spare)
    for can_id in (0x181, 0x182, 0x183):
        writer.send(Frame(can_id, b""))
    assert picky.receive(1.0) == Frame(0x182, b"")
    assert picky.receive(0.05) is None
    picky.close()
    writer.close()


def bare(spare):
    sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    sock.bind((spare.channel,))
    return sock


def test_error_frames_warn_and_bus_off_is_lost(pair, spare):
    """vcan has no controller; what one would say is said by another process, as the kernel allows."""
    with bare(spare) as controller:
        controller.send(pack(Frame(CAN_ERR_FLAG | 0x4, b"\0\x20\0\0\0\0\x80\0")))
        assert pair[0].receive(1.0).can_id == CAN_ERR_FLAG | 0x4
        assert pair[0].error_warnings == 1
        assert "error-passive by sent frames" in pair[0].reports[0]
        controller.send(pack(Frame(CAN_ERR_FLAG | 0x40, bytes(8))))
    assert_latched(pair[0], "bus-off")
