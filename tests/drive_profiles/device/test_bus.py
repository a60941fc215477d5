"""The bus itself, over python-can's `virtual` interface: a real slave engine in a thread, several ports, garbage, failures."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import can
import pytest

from drive_profiles.device.bus import SdoBus
from drive_profiles.device.device import Device, identity_at
from drive_profiles.errors import BusError, NoAnswerError, SdoAbortedError
from drive_profiles.family.catalogue import Catalogue
from drive_profiles.standard.cia301 import NmtCommand
from hil.can.frame import Frame
from tests.drive_profiles import upload_rig as rig

P1 = (0x2001, 1)
OTHER = 9


class Served:
    """Slaves on a virtual bus, each answering in one thread."""

    def __init__(self, channel):
        self.bus = can.Bus(interface="virtual", channel=channel)
        self.slaves = {rig.NODE: rig.node(), OTHER: rig.node()}
        self.garbage = ()
        self.silent = False
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self):
        while not self._ending.is_set():
            message = self.bus.recv(0.01)
            if message is None or self.silent:
                continue
            node = rig.NODE if message.arbitration_id != 0x600 + OTHER else OTHER
            asked = 0x600 + rig.NODE if message.arbitration_id == 0x600 + OTHER else message.arbitration_id
            for frame in self.slaves[node].receive(Frame(asked, bytes(message.data)), time.monotonic_ns()):
                for each in self.garbage:
                    self.bus.send(each)
                can_id = frame.can_id - rig.NODE + node if frame.can_id & 0x7F == rig.NODE else frame.can_id
                self.bus.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=frame.data))

    def close(self):
        self._ending.set()
        self._thread.join()
        self.bus.shutdown()


@pytest.fixture
def channel(request):
    return f"bus-{request.node.name}"


@pytest.fixture
def served(channel):
    made = Served(channel)
    yield made
    made.close()


@pytest.fixture
def bus(channel, served):
    with SdoBus(f"virtual:{channel}", 0.5) as opened:
        yield opened


def test_one_port_per_node_reads_and_writes(bus, served):
    port = bus.port(rig.NODE)
    assert port is bus.port(rig.NODE)
    port.write(P1, b"\x2a\x00")
    assert port.read(P1) == b"\x2a\x00"
    assert served.slaves[rig.NODE].dictionary.get(*P1) == 42
    assert served.slaves[OTHER].dictionary.get(*P1) == rig.old_value(1)
    assert identity_at(port).serial_number == 7
    for wrong in (0, 128):
        with pytest.raises(ValueError, match="node-ID"):
            bus.port(wrong)


def test_two_ports_in_two_threads_do_not_take_each_others_answers(bus):
    def count(node):
        port, seen = bus.port(node), []
        for number in range(150):
            value = (node * 1000 + number).to_bytes(2, "little")
            port.write(P1, value)
            port.write((0x2100, 0), b"%d of node %d, in segments" % (number, node))
            seen.append(port.read(P1) == value and port.read((0x2100, 0)) == b"%d of node %d, in segments" % (number, node))
        return seen

    with ThreadPoolExecutor(2) as pool:
        assert all(all(seen) for seen in pool.map(count, (rig.NODE, OTHER)))
    assert not bus.port(rig.NODE).strays | bus.port(OTHER).strays


def test_frames_that_are_no_answer_are_passed_over(bus, served):
    answer = bytes.fromhex("4b 01 20 01 ff ff 00 00")
    served.garbage = (
        can.Message(arbitration_id=0x580 + rig.NODE, is_extended_id=True, data=answer),
        can.Message(arbitration_id=0x580 + rig.NODE, is_extended_id=False, is_remote_frame=True, dlc=8),
        can.Message(arbitration_id=0x580 + rig.NODE, is_extended_id=False, is_error_frame=True, data=answer),
        can.Message(arbitration_id=0x580 + rig.NODE, is_extended_id=False, is_fd=True, data=answer),
        can.Message(arbitration_id=0x580 + rig.NODE, is_extended_id=False, data=b""),
        can.Message(arbitration_id=0x580 + rig.NODE, is_extended_id=False, data=answer[:5]),
        can.Message(arbitration_id=0x580 + rig.NODE, is_extended_id=False, data=bytes.fromhex("4b 02 20 01 ff ff 00 00")),
        can.Message(arbitration_id=0x580 + OTHER, is_extended_id=False, data=answer),
        can.Message(arbitration_id=0x181, is_extended_id=False, data=answer),
        can.Message(arbitration_id=0x700 + rig.NODE, is_extended_id=False, data=b"\x7f"),
    )
    port = bus.port(rig.NODE)
    assert [port.read(P1) for _ in range(20)] == [b"\x0b\x00"] * 20
    assert port.boots == 0


def test_a_babbling_node_loses_its_own_answers_and_nobody_elses(bus, served):
    served.garbage = [can.Message(arbitration_id=0x580 + OTHER, is_extended_id=False, data=bytes(8))] * 400
    bus.port(OTHER)
    assert bus.port(rig.NODE).read(P1) == b"\x0b\x00"


def test_boot_ups_are_counted_and_a_reset_waits_for_one(bus, served):
    port = bus.port(rig.NODE)
    device = Device(port, Catalogue(rig.PROFILE), bus.nmt)
    port.write(P1, b"\x2a\x00")
    device.reset(5.0)
    assert port.boots == 1
    assert device.read(P1) == b"\x0b\x00"
    served.silent = True
    port.timeout_s = 0.02
    with pytest.raises(NoAnswerError, match="no boot-up message"):
        device.reset(0.2)


@pytest.mark.wall
def test_who_answers(bus):
    assert bus.answering(range(1, 20)) == [rig.NODE, OTHER]


def test_silence_is_a_time_out_and_the_wrong_bus_none(bus, served, channel):
    served.silent = True
    start = time.monotonic()
    with pytest.raises(NoAnswerError):
        bus.port(rig.NODE).read(P1)
    assert time.monotonic() - start > 0.4
    with pytest.raises(BusError, match="no bus at"):
        SdoBus("nonsense:x")


def test_a_bus_that_is_closed_takes_nothing_more_and_may_be_closed_again(channel, served):
    bus = SdoBus(f"virtual:{channel}")
    bus.close()
    bus.close()
    with pytest.raises(BusError):
        bus.nmt(NmtCommand.START, 0)


class Broken:
    """An adapter that fails when it is told to."""

    def __init__(self, error):
        self.error, self.fail, self.closed = error, threading.Event(), 0

    def recv(self, timeout):
        if self.fail.wait(timeout):
            raise self.error

    def send(self, message, timeout=None):
        pass

    def shutdown(self):
        self.closed += 1
        raise OSError("it has been pulled out")


@pytest.mark.parametrize(
    "error", [ValueError("invalid literal for int() with base 16: 'zz'"), can.CanOperationError("gone"), OSError("x")]
)
def test_whatever_ends_the_reader_wakes_those_who_wait_and_is_said(error, monkeypatch):
    adapter = Broken(error)
    monkeypatch.setattr(can, "Bus", lambda **settings: adapter)
    with SdoBus("slcan:/dev/x", timeout_s=600.0) as bus:
        timer = threading.Timer(0.1, adapter.fail.set)
        timer.start()
        with pytest.raises(BusError, match="lost"):
            bus.port(rig.NODE).read(P1)
        with pytest.raises(BusError, match="lost"):
            bus.port(OTHER).write(P1, b"\0\0")
        timer.join()
    assert adapter.closed == 1  # and that it cannot be closed hides nothing


def wait_until_shared(port):
    """Return when the reader has heard another client at the node."""
    deadline = time.monotonic() + 10.0
    while not port.is_shared:
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.slow
def test_two_clients_at_one_node_are_called_that(channel, bus, served):
    """One asks; another one's transfers are on the bus; the node's answers do not come."""
    port = bus.port(rig.NODE)
    assert port.read(P1)
    assert not port.is_shared
    served.silent = True
    with pytest.raises(NoAnswerError, match="check its supply"):
        port.read(P1)
    with SdoBus(f"virtual:{channel}", 0.2) as second, pytest.raises(NoAnswerError, match="check its supply"):
        second.port(rig.NODE).read((0x2002, 1))  # the first has not asked anything since the second joined
    wait_until_shared(port)
    with pytest.raises(NoAnswerError, match="another SDO client talks to this node; end the other program"):
        port.read(P1)
    assert not bus.port(OTHER).is_shared


def test_an_abort_of_entangled_transfers_names_the_other_client(channel, bus, served):
    port = bus.port(rig.NODE)
    text = (0x2100, 0)
    assert port.read(text)
    with can.Bus(interface="virtual", channel=channel) as stranger:
        segment = can.Message(arbitration_id=0x600 + rig.NODE, is_extended_id=False, data=bytes(8))
        stranger.send(segment)  # a download segment out of the blue: the node aborts
        wait_until_shared(port)
    served.garbage = (
        can.Message(arbitration_id=0x580 + rig.NODE, is_extended_id=False, data=bytes.fromhex("80 00 21 00 00 00 03 05")),
    )
    with pytest.raises(SdoAbortedError, match=r"Toggle bit not alternated \(another SDO client talks to this node\)"):
        port.read(text)


def test_an_adapter_that_returns_what_it_has_sent_is_no_other_client(channel, served):
    with SdoBus(f"virtual:{channel}", 0.5) as bus, can.Bus(interface="virtual", channel=channel) as echo:
        port, line = bus.port(rig.NODE), bus._lines[rig.NODE]
        asked = b"\x40\x00\x10\x00\x00\x00\x00\x00"
        line.send(0x600 + rig.NODE, asked)
        echo.send(can.Message(arbitration_id=0x600 + rig.NODE, is_extended_id=False, data=asked))
        assert port.read(P1)
        assert not port.is_shared
        echo.send(can.Message(arbitration_id=0x600 + rig.NODE, is_extended_id=False, data=b"\x40\x01" + asked[2:]))
        wait_until_shared(port)
