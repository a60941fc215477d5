"""python-can and the canopen package on the local bus, by the plug-in's name: strangers that know nothing of this project."""

import select
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import can
import canopen
import pytest

import drive_profiles
from drive_profiles.standard.cia402 import State
from hil.can.frame import Frame
from plant_emulator.bus import interface
from tests.plant_emulator.bus.conftest import frames_until, wait_for

EDS = Path(drive_profiles.__file__).parent / "vendors" / "emulated_drive.eds"
ANSWER = 0x583
READ_STATUS = can.Message(arbitration_id=0x603, data=bytes.fromhex("4041600000000000"), is_extended_id=False)
FILLER = Frame(0x321, bytes(8))


@pytest.fixture
def bus(either):
    """A python-can bus on either kind of socket."""
    before = len(either.server._clients)
    with can.Bus(interface="hil_local", channel=either.path) as bus:
        wait_for(lambda: len(either.server._clients) > before)
        yield bus


def test_python_can_finds_the_plug_in_by_name(bus):
    assert type(bus).__module__ == "plant_emulator.bus.interface"
    assert "hil_local" in can.VALID_INTERFACES
    assert bus.protocol is can.CanProtocol.CAN_20


def test_a_request_is_answered(bus):
    bus.send(READ_STATUS)
    answer = bus.recv(5.0)
    assert (answer.arbitration_id, answer.is_extended_id, answer.dlc) == (ANSWER, False, 8)
    assert bytes(answer.data[:4]) == bytes.fromhex("4b416000")
    assert 0.0 <= answer.timestamp < 60.0  # the end of the frame, in the time of the world, which has just begun


def test_a_time_out_gives_none(bus, monkeypatch):
    asked = []

    def watched(reading, writing, failing, timeout_s):
        asked.append(timeout_s)
        return select.select(reading, writing, failing, timeout_s)

    monkeypatch.setattr(interface, "select", SimpleNamespace(select=watched))
    started = time.monotonic()
    assert bus.recv(0.05) is None
    assert time.monotonic() - started > 0.04
    assert 0.0 < asked[0] <= 0.05
    assert max(asked) == asked[0]
    assert bus.recv(0) is None


@pytest.mark.ci
@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=0x123, data=b"\1\2\3", is_extended_id=False),
        can.Message(arbitration_id=0x1FFFFFFF, data=b"", is_extended_id=True),
        can.Message(arbitration_id=0x123, is_remote_frame=True, dlc=5, is_extended_id=False),
        can.Message(arbitration_id=0x4, is_error_frame=True, data=bytes(8), is_extended_id=False),
    ],
    ids=["standard", "extended", "remote", "error"],
)
def test_messages_of_every_kind_arrive_as_they_were_sent(either, bus, message):
    with can.Bus(interface="hil_local", channel=either.path) as other:
        wait_for(lambda: len(either.server._clients) > 1)
        bus.send(message)
        assert other.recv(5.0).equals(message, timestamp_delta=None, check_channel=False, check_direction=False)


def test_a_bus_and_a_channel_of_ours_understand_each_other(either, bus):
    channel = either.join()
    channel.send(Frame(0x4000_0123, bytes(3)))
    message = bus.recv(5.0)
    assert (message.arbitration_id, message.is_remote_frame, message.dlc) == (0x123, True, 3)
    bus.send(can.Message(arbitration_id=0x8000, data=b"\7", is_extended_id=True))
    assert frames_until(channel, 0x8000_8000)[-1].data == b"\7"


def test_filters_are_python_cans(either):
    filters = [{"can_id": ANSWER, "can_mask": 0x7FF, "extended": False}]
    with can.Bus(interface="hil_local", channel=either.path, can_filters=filters) as bus:
        wait_for(lambda: either.server._clients)
        channel = either.join()
        channel.send(Frame(0x123, b"\1"))
        channel.send(Frame(0x603, bytes(READ_STATUS.data)))
        channel.send(Frame(0x124, b"\2"))
        assert bus.recv(5.0).arbitration_id == ANSWER
        assert bus.recv(0.1) is None


def test_a_message_that_can_no_longer_be_sent_is_an_error(bus):
    with pytest.raises(can.CanOperationError):
        bus.send(can.Message(arbitration_id=0x800, is_extended_id=False, data=b""))


def test_a_server_that_ends_is_an_error_to_all_who_joined(either, bus):
    either.stop()
    with pytest.raises(can.CanOperationError):
        bus.recv(5.0)
    with pytest.raises(can.CanOperationError):
        bus.send(READ_STATUS)


def test_a_message_waits_for_room_as_long_as_its_time_out_says(tmp_path):
    path = str(tmp_path / "busy.sock")

    def fill(bus):
        for _ in range(100_000):  # nobody reads them
            bus.send(READ_STATUS, timeout=0.0)

    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(path)
        listener.listen()
        with can.Bus(interface="hil_local", channel=path) as bus, listener.accept()[0] as server:
            with pytest.raises(can.CanOperationError, match="accepts no more frames"):
                fill(bus)
            late = threading.Timer(0.05, lambda: [server.recv(16) for _ in range(250)])
            late.start()
            bus.send(READ_STATUS)
            late.join()


def test_where_nobody_serves_python_can_is_told_what_to_do(tmp_path):
    with pytest.raises(can.CanInitializationError, match="plant-emulator serve"):
        can.Bus(interface="hil_local", channel=str(tmp_path / "nobody.sock"))


@pytest.mark.slow
def test_a_notifier_hears_everything(bus, either):
    heard = can.BufferedReader()
    notifier = can.Notifier(bus, [heard])
    try:
        channel = either.join()
        for i in range(100):
            channel.send(Frame(0x100 + i, b""))
        ids = []
        while (message := heard.get_message(1.0)) is not None:
            ids.append(message.arbitration_id)
            if len(ids) == 100:
                break
        assert ids == [0x100 + i for i in range(100)]
    finally:
        notifier.stop()


@pytest.mark.wall
def test_can_logger_joins_and_writes_what_passes(running, tmp_path):
    log = tmp_path / "bus.log"
    logger = subprocess.Popen(
        [sys.executable, "-m", "can.logger", "-i", "hil_local", "-c", running.path, "-f", str(log)],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        wait_for(lambda: running.server._clients, 30.0)
        channel = running.join()
        for i in range(50):
            channel.send(Frame(0x123, bytes((i,))))
        channel.send(Frame(0x603, bytes(READ_STATUS.data)))
        frames_until(channel, ANSWER)
        wait_for(lambda: len(running.server._clients) == 2)

        def has_written():  # the logger writes a block at a time
            channel.send(FILLER)
            return log.exists() and f"{ANSWER:03X}#" in log.read_text()

        wait_for(has_written)
        logger.send_signal(signal.SIGINT)
        _, errors = logger.communicate(timeout=30)
    finally:
        if logger.poll() is None:
            logger.kill()
            logger.communicate()
    messages = [m for m in can.LogReader(log) if m.arbitration_id != FILLER.can_id]
    assert [m.data[0] for m in messages if m.arbitration_id == 0x123] == list(range(50)), errors
    assert [m.arbitration_id for m in messages][-2:] == [0x603, ANSWER]


# -- the canopen package -----------------------------------------------------------------------------------------------


@pytest.fixture
def network(running):
    network = canopen.Network()
    network.connect(interface="hil_local", channel=running.path)
    yield network
    network.disconnect()


@pytest.mark.ci
def test_a_canopen_network_reads_and_writes_the_drives_objects(network, running):
    node = network.add_node(3, str(EDS))
    assert node.sdo["Manufacturer device name"].raw == "Emulated servo drive"
    assert node.sdo["Identity object"]["Product code"].raw == 0x402
    assert node.sdo[0x6502].raw == sum(1 << (mode - 1) for mode in (1, 3, 4, 6, 7, 8, 9, 10))
    node.sdo["Notch filter 1"]["Harmonic order k"].raw = 4
    assert running.world.axes.notch_config[0, 0]["order"] == 4
    with pytest.raises(canopen.SdoAbortedError) as refused:
        node.sdo[0x6041].raw = 0
    assert refused.value.code == 0x0601_0002


def test_a_canopen_network_hears_heartbeats_and_starts_the_node(network, running):
    node = network.add_node(3, str(EDS))
    node.sdo["Producer heartbeat time"].raw = 20
    assert node.nmt.wait_for_heartbeat(5.0) == "PRE-OPERATIONAL"
    node.nmt.state = "OPERATIONAL"
    node.nmt.wait_for_heartbeat(5.0)
    assert node.nmt.wait_for_heartbeat(5.0) == "OPERATIONAL"


@pytest.mark.ci
def test_a_canopen_network_finds_the_nodes_by_scanning(network):
    network.scanner.search(20)
    wait_for(lambda: {3, 16} <= set(network.scanner.nodes))
    assert sorted(network.scanner.nodes) == [3, 16]


@pytest.mark.ci
def test_a_canopen_network_enables_the_drive_by_its_402_profile(network, running):
    node = canopen.BaseNode402(3, str(EDS))
    network.add_node(node)
    node.nmt.send_command(0x80)
    node.setup_402_state_machine()
    node.op_mode = "PROFILED POSITION"
    node.nmt.send_command(0x01)
    wait_for(lambda: running.drive.slave.nmt_state.name == "OPERATIONAL")
    node.state = "OPERATION ENABLED"
    assert running.drive.state is State.OPERATION_ENABLED
    node.sdo["Target position"].raw = 20_000
    node.controlword = 0x1F
    wait_for(lambda: abs(node.sdo["Position actual value"].raw - 20_000) < 100)
    node.state = "SWITCH ON DISABLED"
    assert running.drive.state is State.SWITCH_ON_DISABLED
