"""The raw channel as it is on AF_CAN, on a socket pair in the place of a CAN interface: no kernel with CAN is needed."""

import contextlib
import errno
import select
import socket
import struct
import time
from types import SimpleNamespace

import pytest

from drive_profiles.address import Address
from hil.can import socketcan
from hil.can.errors import BusLostError
from hil.can.frame import CAN_ERR_FLAG, Frame, pack
from hil.can.raw import MAX_REPORTS
from hil.can.socketcan import SocketCanChannel


class Wrapped:
    """A socket that can be made to fail, and to tell of drops, as one of AF_CAN does."""

    def __init__(self, sock):
        self._sock = sock
        self.dropped = None
        self.failure = None

    def __getattr__(self, name):
        return getattr(self._sock, name)

    def recvmsg(self, *arguments):
        if self.failure is not None:
            failure, self.failure = self.failure, None
            raise failure
        record, _, flags, address = self._sock.recvmsg(*arguments)
        told = [] if self.dropped is None else [(socket.SOL_SOCKET, 40, struct.pack("=I", self.dropped))]
        return record, told, flags, address

    def send(self, *arguments):
        if self.failure is not None:
            failure, self.failure = self.failure, None
            raise failure
        return self._sock.send(*arguments)


class Wire:
    def __init__(self, monkeypatch):
        near, self.far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket = Wrapped(near)
        monkeypatch.setattr(socketcan, "bind_can", lambda address, filters: self.socket)
        self.channel = SocketCanChannel(Address("socketcan", "can0"))

    def send(self, *frames):
        for frame in frames:
            self.far.send(pack(frame))

    def close(self):
        self.channel.close()
        self.far.close()


@pytest.fixture
def wire(monkeypatch):
    with contextlib.closing(Wire(monkeypatch)) as wire:
        yield wire


def controller(state, *counters):
    return Frame(CAN_ERR_FLAG | 0x4, bytes((0, state, 0, 0, 0, 0, *counters)).ljust(8, b"\0"))


def assert_latched(channel, words):
    with pytest.raises(BusLostError, match=words) as first:
        channel.receive(0.5)
    for access in (lambda: channel.receive(0.0), lambda: channel.send(Frame(0x80, b""))):
        with pytest.raises(BusLostError) as again:
            access()
        assert again.value is first.value


def test_frames_pass_both_ways(wire):
    wire.send(Frame(0x123, b"\1\2"))
    assert wire.channel.receive(1.0) == Frame(0x123, b"\1\2")
    assert wire.channel.receive(0.0) is None
    wire.channel.send(Frame(0x80, b""))
    assert wire.far.recv(64) == pack(Frame(0x80, b""))


@pytest.fixture
def waits(monkeypatch):
    """The time-outs with which the channel waits."""
    asked = []

    def watched(reading, writing, failing, timeout_s):
        asked.append(timeout_s)
        return select.select(reading, writing, failing, timeout_s)

    monkeypatch.setattr(socketcan, "select", SimpleNamespace(select=watched))
    return asked


@pytest.mark.parametrize("timeout_s", [-1.0, 0.0, 0.05])
def test_without_a_frame_it_waits_as_long_as_it_is_told(wire, waits, timeout_s):
    started = time.monotonic()
    assert wire.channel.receive(timeout_s) is None
    assert time.monotonic() - started >= timeout_s
    assert waits == ([timeout_s] if timeout_s > 0.0 else [])


def test_a_record_that_is_no_frame_is_passed_over(wire):
    wire.far.send(b"\1" * 15)
    wire.far.send(struct.pack("=IB3x8s", 0x123, 9, bytes(8)))
    wire.send(Frame(0x124, b""))
    assert wire.channel.receive(1.0) == Frame(0x124, b"")


@pytest.mark.parametrize("state", [0x04, 0x08, 0x10, 0x20])
def test_a_warning_is_counted_told_and_handed_on(wire, state):
    warning = controller(state, 97, 0)
    wire.send(warning, Frame(0x123, b""))
    assert wire.channel.receive(1.0) == warning
    assert wire.channel.receive(1.0) == Frame(0x123, b"")
    assert wire.channel.error_warnings == 1
    assert wire.channel.overflows == 0
    assert "error counters: transmit 97" in wire.channel.reports[0]


def test_a_controller_that_recovers_gives_no_warning_but_a_word(wire):
    wire.send(controller(0x40))
    wire.channel.receive(1.0)
    assert wire.channel.error_warnings == 0
    assert list(wire.channel.reports) == ["error-active again"]


def test_a_frame_lost_in_the_controller_is_an_overflow(wire):
    wire.send(controller(0x01))
    wire.channel.receive(1.0)
    assert wire.channel.overflows == 1


def test_what_is_told_is_bounded(wire):
    for _ in range(MAX_REPORTS + 10):
        wire.send(controller(0x04))
        wire.channel.receive(1.0)
    assert len(wire.channel.reports) == MAX_REPORTS
    assert wire.channel.error_warnings == MAX_REPORTS + 10


@pytest.mark.parametrize(("error_class", "words"), [(0x40, "bus-off"), (0x100, "restarted automatically"), (0x44, "bus-off")])
def test_bus_off_is_a_lost_bus_and_so_is_one_that_has_restarted(wire, error_class, words):
    wire.send(Frame(0x123, b""), Frame(CAN_ERR_FLAG | error_class, bytes(8)), Frame(0x124, b""))
    assert wire.channel.receive(1.0) == Frame(0x123, b"")
    assert_latched(wire.channel, words)


def test_drops_of_the_kernel_are_counted_once_each(wire):
    for dropped, counted in ((None, 0), (3, 3), (3, 3), (5, 5), (None, 5)):
        wire.socket.dropped = dropped
        wire.send(Frame(0x123, b""))
        wire.channel.receive(1.0)
        assert wire.channel.overflows == counted


def test_the_kernels_count_may_wrap(wire):
    for dropped in (0xFFFF_FFFE, 1):
        wire.socket.dropped = dropped
        wire.send(Frame(0x123, b""))
        wire.channel.receive(1.0)
    assert wire.channel.overflows == 0xFFFF_FFFE + 3


FAILURES = [(errno.ENETDOWN, "is down"), (errno.ENODEV, "is gone"), (errno.ENXIO, "is gone"), (errno.EIO, "Input/output")]


@pytest.mark.parametrize(("number", "words"), FAILURES)
def test_an_interface_that_fails_once_is_lost_for_ever(wire, number, words):
    wire.socket.failure = OSError(number, "Input/output error")
    wire.send(Frame(0x123, b""))  # it would work again
    assert_latched(wire.channel, words)


@pytest.mark.parametrize(("number", "words"), [*FAILURES, (errno.ENOBUFS, "does not drain")])
def test_a_send_that_fails_once_is_the_last(wire, number, words):
    wire.socket.failure = OSError(number, "Input/output error")
    with pytest.raises(BusLostError, match=words):
        wire.channel.send(Frame(0x80, b""))
    assert_latched(wire.channel, words)


def send_many(channel, count):
    for _ in range(count):
        channel.send(Frame(0x80, b""))


def test_a_full_socket_is_not_waited_for(wire, waits):
    with pytest.raises(BusLostError, match="does not drain"):
        send_many(wire.channel, 100_000)
    assert waits == []


def test_a_closed_channel_is_lost(wire):
    wire.channel.close()
    assert_latched(wire.channel, "socketcan:can0")


def test_filters_reach_the_kernel_as_pairs(monkeypatch):
    class Kernel:
        def __init__(self, *_):
            self.options, self.bound = {}, None

        def setsockopt(self, level, option, value):
            self.options[level, option] = value
            if option == 33:
                raise PermissionError(errno.EPERM, "no")

        def bind(self, address):
            self.bound = address

        def close(self):
            pass

    monkeypatch.setattr(socket, "AF_CAN", 29, raising=False)
    monkeypatch.setattr(socket, "CAN_RAW", 1, raising=False)
    monkeypatch.setattr(socketcan.socket, "socket", Kernel)
    sock = socketcan.bind_can(Address("socketcan", "nosuch0"), [(0x182, 0x7FF), (0x80, 0x780)])
    assert sock.bound == ("nosuch0",)
    assert sock.options[101, 1] == struct.pack("=4I", 0x182, 0x7FF, 0x80, 0x780)
    assert sock.options[101, 2] == 0x1FFF_FFFF
    assert sock.options[socket.SOL_SOCKET, 40] == 1
    assert sock.options[socket.SOL_SOCKET, socket.SO_RCVBUF] == socketcan.CAN_BUFFER_BYTES
