"""A small device, a master that speaks raw frames to it, and a stranger: the canopen package as master.

Everything is single-threaded and in virtual time: what the master sends is given to the slave, what the slave answers
is given to the master, before the call returns.
"""

import struct

import canopen
import pytest

from drive_profiles.standard.cia301 import DataType, NmtCommand, SdoAbortCode
from hil.can.frame import CAN_RTR_FLAG, Frame
from plant_emulator.slave.dictionary import Access, Dictionary, Entry
from plant_emulator.slave.eds import DeviceInfo, write_eds
from plant_emulator.slave.node import Slave
from plant_emulator.slave.objects import PdoDefault, communication_entries, pdo_entries

NODE = 5
MS = 1_000_000


def device_entries(**pdos):
    u8, u16, i16, i32, text = (
        DataType.UNSIGNED8,
        DataType.UNSIGNED16,
        DataType.INTEGER16,
        DataType.INTEGER32,
        DataType.VISIBLE_STRING,
    )
    record = {"record_name": "Tuning"}
    return [
        *communication_entries(device_type=0x00020192, name="Test device", vendor_id=0x1234, serial_number=7),
        *pdo_entries(**pdos),
        Entry(0x2000, 0, "Limited", i16, Access.RW, 10, low=-100, high=100, mappable=True),
        Entry(0x2001, 0, "Label", text, Access.RW, "label"),
        Entry(0x2002, 0, "Key", u16, Access.WO, 0, mappable=True),
        Entry(0x2003, 1, "Gain", DataType.REAL32, Access.RW, 1.5, low=0.1, high=1e3, mappable=True, **record),
        Entry(0x2003, 2, "Time", DataType.REAL64, Access.RW, 0.25, **record),
        Entry(0x2004, 0, "Blob", DataType.DOMAIN, Access.RW, b""),
        Entry(0x2005, 0, "Wide", DataType.UNSIGNED64, Access.RW, 0, mappable=True),
        Entry(0x2006, 0, "Flag", DataType.BOOLEAN, Access.RW, False, mappable=True),
        Entry(0x6040, 0, "Control word", u16, Access.RWW, 0, mappable=True),
        Entry(0x6041, 0, "Status word", u16, Access.RO, 0, mappable=True),
        Entry(0x6060, 0, "Mode", u8, Access.RW, 0),
        Entry(0x6064, 0, "Position", i32, Access.RO, 0, mappable=True),
        Entry(0x6077, 0, "Torque", i16, Access.RO, 0, mappable=True),
        Entry(0x607A, 0, "Target", i32, Access.RWW, 0, mappable=True),
    ]


SYNCHRONOUS = {
    "rpdos": [PdoDefault(((0x6040, 0, 16), (0x607A, 0, 32)), 1)],
    "tpdos": [PdoDefault(((0x6041, 0, 16), (0x6064, 0, 32), (0x6077, 0, 16)), 1)],
}


class Bench:
    """A slave with a raw master: one line per service, in virtual time."""

    def __init__(self, node_id=NODE, power=True, entries=None, slave=None, **pdos):
        self.now = 0
        self.dictionary = Dictionary(device_entries(**pdos) if entries is None else entries)
        self.slave = Slave(node_id, self.dictionary, **(slave or {}))
        self.boot = self.slave.power_on(self.now) if power else []

    def send(self, can_id, data=b""):
        return self.slave.receive(Frame(can_id, bytes(data)), self.now)

    def wait(self, milliseconds):
        """Let time pass, from deadline to deadline, and give what was sent with its time."""
        end = self.now + round(milliseconds * MS)
        sent = []
        while (due := self.slave.due) is not None and due <= end:
            assert due >= self.now
            self.now = due
            sent += [(self.now, frame) for frame in self.slave.advance(self.now)]
        self.now = end
        return sent

    def nmt(self, command, node_id=NODE):
        return self.send(0x000, (command, node_id))

    def start(self):
        return self.nmt(NmtCommand.START)

    def sync(self, data=b""):
        return self.send(0x080, data)

    def request(self, *data):
        """Send an SDO request, padded to 8 bytes; give the one answer's bytes, or None."""
        frames = [f for f in self.send(0x600 + NODE, bytes(data).ljust(8, b"\0")) if f.can_id == 0x580 + NODE]
        assert len(frames) <= 1
        return frames[0].data if frames else None

    def write(self, index, subindex, data):
        """Download, expedited up to four bytes, else in segments; give the abort code, or None."""
        address = struct.pack("<HB", index, subindex)
        if 0 < len(data) <= 4:
            return code_of(self.request(0x23 | (4 - len(data)) << 2, *address, *data))
        answer = self.request(0x21, *address, *struct.pack("<I", len(data)))
        toggle = 0
        while code_of(answer) is None:
            segment, data = data[:7], data[7:]
            answer = self.request(toggle | (7 - len(segment)) << 1 | (not data), *segment.ljust(7, b"\0"))
            toggle ^= 0x10
            if not data:
                break
        return code_of(answer)

    def write_value(self, index, subindex, value):
        size = self.dictionary.cell(index, subindex).entry.data_type.size
        return self.write(index, subindex, value.to_bytes(size, "little", signed=value < 0))

    def read(self, index, subindex=0):
        """Upload; give the bytes or the abort code."""
        answer = self.request(0x40, *struct.pack("<HB", index, subindex))
        if code_of(answer) is not None:
            return code_of(answer)
        if answer[0] & 0x02:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        data, toggle, is_last = b"", 0, False
        while not is_last:
            answer = self.request(0x60 | toggle)
            data += answer[1 : 8 - (answer[0] >> 1 & 7)]
            is_last, toggle = answer[0] & 1, toggle ^ 0x10
        return data


def code_of(answer):
    """Give the abort code of an SDO answer, or None."""
    if answer is None or answer[0] != 0x80:
        return None
    return SdoAbortCode(int.from_bytes(answer[4:], "little"))


class PumpedNetwork(canopen.Network):
    """The canopen package as master: what it sends goes into the slave, the answers come back at once."""

    def __init__(self, bench):
        super().__init__()
        self.bench = bench

    def send_message(self, can_id, data, remote=False):
        flag = CAN_RTR_FLAG if remote else 0
        self.deliver(self.bench.slave.receive(Frame(can_id | flag, bytes(data)), self.bench.now))

    def deliver(self, frames):
        for frame in frames:
            self.notify(frame.can_id, bytearray(frame.data), self.bench.now * 1e-9)

    def wait(self, milliseconds):
        self.deliver([frame for _, frame in self.bench.wait(milliseconds)])


@pytest.fixture(scope="session")
def make_bench():
    return Bench


@pytest.fixture
def bench():
    return Bench(**SYNCHRONOUS)


@pytest.fixture
def running(bench):
    bench.start()
    return bench


@pytest.fixture(scope="session")
def synchronous():
    return SYNCHRONOUS


@pytest.fixture(scope="session")
def make_entries():
    return device_entries


@pytest.fixture
def stranger(bench, tmp_path):
    """A canopen RemoteNode of the bench's slave, with the object dictionary from the slave's own EDS."""
    path = tmp_path / "device.eds"
    path.write_text(write_eds(bench.dictionary, DeviceInfo("device.eds", "Vendor", "Product")))
    network = PumpedNetwork(bench)
    node = canopen.RemoteNode(NODE, str(path))
    network[NODE] = node
    yield node
    network.disconnect()
