"""The adapter to python-can, on python-can's own virtual bus."""

import time

import can
import pytest

from drive_profiles.address import Address, parse_address
from hil.can.adapter import AdapterChannel
from hil.can.errors import BusLostError, BusUnavailableError
from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, Frame
from hil.can.opening import open_channel


@pytest.fixture
def stranger(request):
    with can.Bus(interface="virtual", channel=request.node.name) as bus:
        yield bus


@pytest.fixture
def channel(request, stranger):
    channel = open_channel(Address("virtual", request.node.name))
    yield channel
    channel.close()


FRAMES = [
    Frame(0x123, bytes(range(8))),
    Frame(0x0, b""),
    Frame(0x1FFF_FFFF | CAN_EFF_FLAG, b"\7"),
    Frame(0x123 | CAN_EFF_FLAG, b"\7"),
    Frame(0x7FF | CAN_RTR_FLAG, bytes(5)),
]


def test_any_interface_but_our_own_opens_as_an_adapter(channel):
    assert isinstance(channel, AdapterChannel)
    assert not channel.is_lock_step


@pytest.mark.parametrize("frame", FRAMES)
def test_a_frame_goes_out_as_python_can_means_it(channel, stranger, frame):
    channel.send(frame)
    message = stranger.recv(1.0)
    assert message.arbitration_id == frame.can_id & 0x1FFF_FFFF
    assert message.is_extended_id == bool(frame.can_id & CAN_EFF_FLAG)
    assert message.is_remote_frame == bool(frame.can_id & CAN_RTR_FLAG)
    assert message.dlc == len(frame.data)
    assert bytes(message.data) == (b"" if message.is_remote_frame else frame.data)


@pytest.mark.parametrize("frame", FRAMES)
def test_a_frame_comes_back_as_it_went_out(channel, frame):
    with can.Bus(interface="virtual", channel=channel.address.channel) as echo:
        channel.send(frame)
        echo.send(echo.recv(1.0))
    assert channel.receive(1.0) == frame


def test_error_frames_carry_their_flag(channel, stranger):
    stranger.send(can.Message(arbitration_id=0x4, is_error_frame=True, data=bytes(8), is_extended_id=False))
    assert channel.receive(1.0) == Frame(0x4 | CAN_ERR_FLAG, bytes(8))


def test_can_fd_frames_are_passed_over(channel, stranger):
    stranger.send(can.Message(arbitration_id=0x123, is_fd=True, data=bytes(64), is_extended_id=False))
    stranger.send(can.Message(arbitration_id=0x124, data=b"", is_extended_id=False))
    assert channel.receive(1.0) == Frame(0x124, b"")


def test_can_fd_frames_do_not_end_a_wait_before_its_time(channel, stranger):
    stranger.send(can.Message(arbitration_id=0x123, is_fd=True, data=bytes(64), is_extended_id=False))
    started = time.monotonic()
    assert channel.receive(0.1) is None
    assert time.monotonic() - started > 0.09


@pytest.mark.parametrize("timeout_s", [0.0, 0.05, -1.0])
def test_without_a_frame_it_waits_as_long_as_it_is_told(channel, timeout_s, monkeypatch):
    asked, receive = [], channel._bus.recv

    def watched(patience_s):
        asked.append(patience_s)
        return receive(patience_s)

    monkeypatch.setattr(channel._bus, "recv", watched)
    started = time.monotonic()
    assert channel.receive(timeout_s) is None
    assert max(0.0, timeout_s) <= time.monotonic() - started + 1e-3
    assert len(asked) == 1
    assert 0.0 <= asked[0] <= max(0.0, timeout_s)


def test_a_closed_bus_is_lost_for_ever(channel):
    channel.close()
    with pytest.raises(BusLostError) as first:
        channel.send(Frame(0x123, b""))
    for _ in range(2):
        with pytest.raises(BusLostError) as again:
            channel.receive(0.0)
        assert again.value is first.value
    channel.close()


def test_one_failure_is_latched_although_the_bus_would_work_again(channel, monkeypatch):
    def fail(*_args):
        raise can.CanOperationError("the adapter was pulled")

    with monkeypatch.context() as patched:
        patched.setattr(channel._bus, "send", fail)
        with pytest.raises(BusLostError, match="pulled"):
            channel.send(Frame(0x123, b""))
    with pytest.raises(BusLostError, match="pulled"):
        channel.send(Frame(0x123, b""))


@pytest.mark.parametrize(
    ("text", "words"), [("nosuch:x", "nosuch"), ("slcan:/dev/nosuch@1M", "nosuch"), ("hil_local:/nowhere", "plant-emulator")]
)
def test_what_python_can_cannot_open_is_unavailable_with_its_words(text, words):
    with pytest.raises(BusUnavailableError, match=words) as refused:
        open_channel(parse_address(text))
    assert refused.value.address == parse_address(text)


def test_the_bit_rate_reaches_the_adapter(monkeypatch):
    seen = {}

    def bus(**settings):
        seen.update(settings)
        raise can.CanInitializationError("enough")

    monkeypatch.setattr(can, "Bus", bus)
    with pytest.raises(BusUnavailableError):
        open_channel(parse_address("slcan:/dev/ttyACM0@500k"))
    assert seen == {"interface": "slcan", "channel": "/dev/ttyACM0", "bitrate": 500_000}
