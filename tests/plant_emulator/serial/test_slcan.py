"""The slcan adapter: its commands byte for byte, any garbage, and strangers on a real pseudo-terminal."""

import os
import subprocess
import sys
import time

import can
import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.address import Address, parse_address
from hil.can.adapter import AdapterChannel
from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, Frame
from hil.can.local import connect_local
from plant_emulator.serial.pseudo_terminal import PseudoTerminal
from plant_emulator.serial.slcan import POLL_FRAMES, Adapter, SlcanPort
from tests.plant_emulator.bus.conftest import PATIENCE_S, drain, frames_until, wait_for

READ_STATUS_WORD = Frame(0x603, bytes.fromhex("4041600000000000"))


def opened(settings=b""):
    adapter = Adapter()
    answers, _ = adapter.receive(settings + b"S8\rO\r")
    assert b"\a" not in answers
    return adapter


# -- the protocol ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "command", "answer"),
    [
        (b"", b"V", b"V1013\r"),
        (b"", b"N", b"NHILB\r"),
        (b"", b"", b"\r"),
        (b"", b"O", b"\a"),  # no bit rate yet
        (b"", b"C", b"\a"),
        (b"", b"S8", b"\r"),
        (b"", b"S9", b"\a"),
        (b"", b"S", b"\a"),
        (b"", b"s031C", b"\r"),
        (b"", b"s31C", b"\a"),
        (b"s031C\r", b"O", b"\r"),
        (b"S8\r", b"O", b"\r"),
        (b"S8\r", b"L", b"\r"),
        (b"S8\rO\r", b"O", b"\a"),
        (b"S8\rO\r", b"S6", b"\a"),
        (b"S8\rO\r", b"Z1", b"\a"),
        (b"S8\rO\r", b"C", b"\r"),
        (b"S8\rO\r", b"F", b"F00\r"),
        (b"S8\r", b"F", b"\a"),
        (b"", b"Z1", b"\r"),
        (b"", b"Z2", b"\a"),
        (b"", b"X1", b"\r"),
        (b"", b"M00000000", b"\r"),
        (b"", b"m0000000", b"\a"),
        (b"S8\r", b"t1230", b"\a"),
        (b"S8\rL\r", b"t1230", b"\a"),
        (b"S8\rO\r", b"t1230", b"z\r"),
        (b"S8\rO\r", b"T123456780", b"Z\r"),
        (b"S8\rO\r", b"T1234567", b"\a"),
        (b"S8\rO\r", b"TFFFFFFFF0", b"\a"),
        (b"S8\rO\r", b"t8000", b"\a"),
        (b"S8\rO\r", b"t12390011223344556677889", b"\a"),
        (b"S8\rO\r", b"t12320011223", b"\a"),
        (b"S8\rO\r", b"t123200GG", b"\a"),
        (b"S8\rO\r", b"r1238", b"z\r"),
        (b"S8\rO\r", b"r123100", b"\a"),
        (b"X0\rS8\rO\r", b"t1230", b"\r"),
        (b"X0\rS8\rO\r", b"P", b"\r"),
        (b"X0\rS8\rO\r", b"A", b"A\r"),
        (b"S8\rO\r", b"P", b"\a"),
        (b"", b"Q1", b"\a"),
        (b"", b"\xff\x00", b"\a"),
        (b"", b"V" * 5000, b"\a"),
    ],
)
def test_a_command_has_its_answer(before, command, answer):
    adapter = Adapter()
    adapter.receive(before)
    assert adapter.receive(command + b"\r")[0] == answer
    assert adapter.receive(b"V\r")[0] == b"V1013\r"  # whatever it was, the next one is read


@pytest.mark.parametrize(
    ("text", "frame"),
    [
        (b"t1232A1b2", Frame(0x123, b"\xa1\xb2")),
        (b"t7FF80011223344556677", Frame(0x7FF, bytes.fromhex("0011223344556677"))),
        (b"T1FFFFFFF0", Frame(0x1FFF_FFFF | CAN_EFF_FLAG, b"")),
        (b"r0805", Frame(0x80 | CAN_RTR_FLAG, bytes(5))),
        (b"R000001232", Frame(0x123 | CAN_RTR_FLAG | CAN_EFF_FLAG, bytes(2))),
    ],
)
def test_a_frame_passes_both_ways(text, frame):
    adapter = opened()
    assert adapter.receive(text + b"\r")[1] == [frame]
    assert adapter.deliver(frame, 0) == text.replace(b"A1b2", b"A1B2") + b"\r"


def test_a_command_may_come_in_pieces_and_with_line_feeds():
    adapter = Adapter()
    assert adapter.receive(b"S") == (b"", [])
    assert adapter.receive(b"8\r\nO\r\nt12") == (b"\r\r", [])
    assert adapter.receive(b"31FF\r\n") == (b"z\r", [Frame(0x123, b"\xff")])


def test_time_stamps_are_milliseconds_of_a_minute():
    adapter = opened(b"Z1\r")
    assert adapter.deliver(Frame(0x123, b"\1"), 59_999) == b"t123101EA5F\r"
    assert adapter.deliver(Frame(0x123, b""), 60_000) == b"t12300000\r"


def test_closed_it_shows_nothing_and_listening_everything():
    adapter = Adapter()
    assert adapter.deliver(Frame(1, b""), 0) == b""
    adapter.receive(b"S8\rL\r")
    assert adapter.deliver(Frame(1, b""), 0) == b"t0010\r"


def test_an_error_frame_shows_in_the_flags_once():
    adapter = opened()
    assert adapter.deliver(Frame(CAN_ERR_FLAG | 0x40, bytes(8)), 0) == b""
    assert adapter.receive(b"F\rF\r")[0] == b"F80\rF00\r"


def test_at_the_wrong_bit_rate_nothing_passes():
    adapter = Adapter()
    adapter.bus_bitrate = 500_000
    adapter.receive(b"S8\rO\r")
    assert adapter.deliver(Frame(1, b""), 0) == b""
    assert adapter.receive(b"t1230\rF\r") == (b"z\rF80\r", [])
    for right in (b"S6", b"s031C"):
        adapter.receive(b"C\r" + right + b"\rO\r")
        assert adapter.deliver(Frame(1, b""), 0) == b"t0010\r"
        assert adapter.receive(b"t1230\rF\r") == (b"z\rF00\r", [Frame(0x123, b"")])


def test_a_polling_host_gets_bounded_frames_and_is_told_of_the_loss():
    adapter = opened(b"X0\r")
    for number in range(POLL_FRAMES + 1):
        assert adapter.deliver(Frame(number, b""), 0) == b""
    assert adapter.receive(b"P\r")[0] == b"t0010\r"
    assert adapter.receive(b"A\r")[0].count(b"\r") == POLL_FRAMES
    assert adapter.receive(b"F\r")[0] == b"F09\r"


def test_code_and_mask_choose_identifiers():
    # the upper filter lets 181h pass, the lower one all of 580h to 5FFh
    code, mask = (0x181 << 5) << 16 | 0x580 << 5, 0x001F << 16 | 0x7F << 5 | 0x1F
    adapter = opened(b"M%08X\rm%08X\r" % (code, mask))
    seen = [can_id for can_id in range(0x800) if adapter.deliver(Frame(can_id, b""), 0)]
    assert seen == [0x181, *range(0x580, 0x600)]
    extended = opened(b"M12345678\rm0000FFFF\r")
    assert extended.deliver(Frame(0x1234 << 13 | CAN_EFF_FLAG, b""), 0)
    assert not opened(b"M12340000\rm00000000\r").deliver(Frame(0x4321 << 13 & 0x1FFF_FFFF | CAN_EFF_FLAG, b""), 0)


pieces = st.lists(
    st.one_of(st.binary(max_size=40), st.text("tTrRSOCLZXMmFVNPA0123456789abcdefABCDEF\r", max_size=40)), max_size=20
)


@given(pieces)
def test_any_bytes_are_answered_and_the_adapter_lives_on(parts):
    adapter = Adapter()
    for part in parts:
        data = part if isinstance(part, bytes) else part.encode()
        answers, frames = adapter.receive(data)
        assert all(len(frame.data) <= 8 for frame in frames)
        assert len(answers) <= 33 * POLL_FRAMES * (data.count(b"\r") + 1)
    assert adapter.receive(b"\rV\r")[0].endswith(b"V1013\r")


@given(st.binary(max_size=200), st.integers(0, 0x7FF), st.binary(max_size=8))
def test_behind_garbage_a_frame_is_found_after_a_carriage_return(garbage, can_id, data):
    adapter = opened()
    adapter.receive(garbage.replace(b"C", b"c") + b"\r")
    assert adapter.receive(b"t%03X%d%s\r" % (can_id, len(data), data.hex().encode())) == (b"z\r", [Frame(can_id, data)])


# -- on a pseudo-terminal ----------------------------------------------------------------------------------------------


@pytest.fixture
def port(tmp_path, running):
    terminal = PseudoTerminal(str(tmp_path / "robot.tty"))
    before = len(running.server._clients)
    port = SlcanPort(terminal, connect_local(Address("local", running.path)))
    wait_for(lambda: len(running.server._clients) > before)
    yield port
    port.close()
    terminal.close()


@pytest.fixture
def stranger(port):
    with can.Bus(interface="slcan", channel=port.terminal.path, bitrate=1_000_000, sleep_after_open=0.0) as bus:
        yield bus


def sdo(bus, frame):
    bus.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        message = bus.recv(1.0)
        if message is not None and message.arbitration_id == frame.can_id - 0x80:
            return message
    raise AssertionError("no answer")


def test_python_can_reads_an_object(stranger):
    assert bytes(sdo(stranger, READ_STATUS_WORD).data[:6]) == bytes.fromhex("4b4160005002")


def test_python_can_reads_version_and_serial_number(stranger):
    assert stranger.get_version(PATIENCE_S) == (10, 13)
    assert stranger.get_serial_number(PATIENCE_S) == "HILB"


@pytest.mark.slow
def test_our_own_channel_reads_an_object(port):
    channel = AdapterChannel(parse_address(f"slcan:{port.terminal.path}@1M"))
    try:
        assert not channel.is_lock_step
        channel.send(READ_STATUS_WORD)
        assert frames_until(channel, 0x583)[-1].data[:6] == bytes.fromhex("4b4160005002")
    finally:
        channel.close()


def test_the_other_participants_see_its_frames_and_it_sees_theirs(running, port, stranger):
    sdo(stranger, READ_STATUS_WORD)  # it is open
    other = running.join()
    for message, frame in (
        (can.Message(arbitration_id=0x1234567, data=b"\1\2"), Frame(0x1234567 | CAN_EFF_FLAG, b"\1\2")),
        (
            can.Message(arbitration_id=0x321, is_extended_id=False, is_remote_frame=True, dlc=4),
            Frame(0x321 | CAN_RTR_FLAG, bytes(4)),
        ),
    ):
        stranger.send(message)
        assert frames_until(other, frame.can_id)[-1] == frame
        other.send(frame)
        deadline = time.monotonic() + PATIENCE_S
        while True:
            assert time.monotonic() < deadline
            seen = stranger.recv(1.0)
            if seen is not None and seen.arbitration_id == message.arbitration_id:
                assert seen.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
                break
    assert drain(other, 0.02) is not None


def test_time_passes_by_the_wall_clock_for_it(running, stranger):
    sdo(stranger, READ_STATUS_WORD)
    running.hold_wall()
    before = running.world.now
    running.pass_wall_s(0.2)
    wait_for(lambda: running.world.now == before + 200_000_000)


def test_its_sync_does_not_move_the_clock_but_is_a_sync(running, stranger):
    sdo(stranger, Frame(0x603, bytes.fromhex("2f00180201000000")))  # TPDO1 at every SYNC
    stranger.send(can.Message(arbitration_id=0, data=(1, 3), is_extended_id=False))
    running.hold_wall()
    before = running.world.now
    for _ in range(300):
        stranger.send(can.Message(arbitration_id=0x80, is_extended_id=False))
    seen = 0
    while seen < 300:
        message = stranger.recv(PATIENCE_S)
        assert message is not None, f"{seen} of 300"
        seen += message.arbitration_id == 0x183
    assert running.server._clock is None
    assert running.world.now == before
    running.pass_wall_s(0.3)
    wait_for(lambda: running.world.now == before + 300_000_000)


def test_a_host_that_does_not_read_loses_frames_and_nobody_waits(running, port):
    with serial.Serial(port.terminal.path, timeout=PATIENCE_S) as host:
        host.write(b"S8\rO\r")
        assert host.read(2) == b"\r\r"
        other = running.join()
        flooded = 0
        while not port.terminal.dropped:
            other.send(Frame(0x123, bytes(8)))
            flooded += 1
            assert flooded < 100_000
        assert port.terminal.backlog <= 1 << 16
        host.write(b"F\r")
        text = b""
        while b"F09\r" not in text:  # what it missed shows in the flags, behind what it did not
            text += (more := host.read(host.in_waiting or 1))
            assert more
        host.write(b"C\r")


@pytest.mark.ci
def test_a_host_that_reopens_is_not_shown_what_the_last_one_left(running, port):
    with serial.Serial(port.terminal.path, timeout=PATIENCE_S) as host:
        host.write(b"S8\rO\r")
        assert host.read(2) == b"\r\r"
        other = running.join()
        while not port.terminal.dropped:
            for _ in range(20):
                other.send(Frame(0x123, bytes(8)))
            other.send(READ_STATUS_WORD)  # its answer says that the bus has taken what was sent before
            frames_until(other, 0x583)
        host.write(b"C\r")
        wait_for(lambda: not port._adapter.is_open)
        assert port.terminal.backlog <= 32


def test_the_bus_goes_and_the_port_stays_quiet(running, port):
    running.stop()
    port._thread.join(PATIENCE_S)
    assert not port._thread.is_alive()


def test_the_link_is_made_replaced_and_removed(tmp_path):
    path = tmp_path / "port"
    path.symlink_to("/dev/pts/100000")  # a crash has left it behind
    first = PseudoTerminal(str(path))
    assert os.readlink(path) == os.ttyname(first._port)
    with pytest.raises(FileExistsError, match=rf"leads to {os.ttyname(first._port)}, which is in use; end its server"):
        PseudoTerminal(str(path))
    assert os.readlink(path) == os.ttyname(first._port)
    path.unlink()
    second = PseudoTerminal(str(path))
    first.close()
    assert path.is_symlink()  # not ours any more
    second.close()
    assert not path.is_symlink()
    path.write_text("mine")
    with pytest.raises(FileExistsError, match="is not a link to a pseudo-terminal"):
        PseudoTerminal(str(path))
    assert path.read_text() == "mine"


# -- as processes ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_user_scans_through_the_adapter(serve, tmp_path):
    tty = tmp_path / "robot.tty"
    process, _ = serve("--slcan", str(tty))
    wait_for(tty.is_symlink)
    scan = [sys.executable, "-m", "drive_profiles", "scan", "--bus", f"slcan:{tty}@1M", "--nodes", "2-5,16"]
    done = subprocess.run(scan, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stderr
    assert [line.split()[0] for line in done.stdout.splitlines()[1:]] == ["2", "3", "5", "16"]
    process.terminate()
    assert process.wait(PATIENCE_S) == 0
    assert not tty.is_symlink()


def test_a_path_without_a_folder_is_refused_with_the_folder(tmp_path):
    with pytest.raises(FileNotFoundError, match=f"there is no folder {tmp_path / 'nowhere'}; make it first"):
        PseudoTerminal(str(tmp_path / "nowhere" / "robot.tty"))


@pytest.mark.ci
def test_a_path_that_is_taken_is_refused(serve, tmp_path):
    (tmp_path / "taken").write_text("mine")
    process, _ = serve("--slcan", str(tmp_path / "taken"), wait=False)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 4
    assert "taken exists and is not a link to a pseudo-terminal" in errors
    assert (tmp_path / "taken").read_text() == "mine"
