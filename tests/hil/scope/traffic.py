"""A bus whose every number is known: drives that are set up by SDO, and answer each SYNC with a position that counts."""

import struct
import time

import numpy as np

from hil.can.frame import Frame
from hil.can.listening import FRAME_RECORD

COUNTS_PER_REV = 1000
RATED_TORQUE_MNM = 2000
OPERATION_ENABLED, FAULT = 0x1637, 0x1638
FEEDBACK = (0x60410010, 0x60640020, 0x60770010)
COMMAND = (0x60400010, 0x607A0020)


class Traffic:
    """Frames of some drives and a master, with a time each.

    Args:
        nodes: Node-IDs.
        period_ns: Period of SYNC.
    """

    def __init__(self, nodes=(2,), period_ns=1_000_000):
        self.nodes, self.period_ns = nodes, period_ns
        self.now_ns = 0
        self.frames = []
        self.cycle = 0

    def put(self, can_id, data=b""):
        self.frames.append((self.now_ns, can_id, len(data), int.from_bytes(data, "little")))
        self.now_ns += 1000

    def write(self, node, index, subindex, value, size):
        """An SDO download and its answer."""
        address = struct.pack("<HB", index, subindex)
        self.put(0x600 + node, bytes([0x23 | (4 - size) << 2]) + address + value.to_bytes(4, "little"))
        self.put(0x580 + node, b"\x60" + address + bytes(4))

    def read(self, node, index, subindex, value):
        """An SDO upload and its answer."""
        address = struct.pack("<HB", index, subindex)
        self.put(0x600 + node, b"\x40" + address + bytes(4))
        self.put(0x580 + node, b"\x43" + address + value.to_bytes(4, "little"))

    def set_up(self):
        """What a master reads and writes before a run."""
        for node in self.nodes:
            for index, subindex, value in ((0x608F, 1, COUNTS_PER_REV), (0x608F, 2, 1), (0x6076, 0, RATED_TORQUE_MNM)):
                self.read(node, index, subindex, value)
            for communication, mapping, base, objects in ((0x1800, 0x1A00, 0x180, FEEDBACK), (0x1400, 0x1600, 0x200, COMMAND)):
                for subindex, value in enumerate((len(objects), *objects)):
                    self.write(node, mapping, subindex, value, 4 if subindex else 1)
                self.write(node, communication, 2, 1, 1)
                self.write(node, communication, 1, base + node, 4)
            self.put(0x000, bytes([1, node]))
        return self

    def run(self, cycles, *, missing=(), status=OPERATION_ENABLED):
        """Cycles: set-points, SYNC, and the answers; of `missing` pairs (cycle, node) none comes.

        The position in cycle n is n counts, and the set-point that is sent before it n + 11: reached at the next SYNC, the
        following error is 10.
        """
        for _ in range(cycles):
            begin = self.now_ns
            for node in self.nodes:
                self.put(0x200 + node, struct.pack("<Hi", 0x0F, self.cycle + 11))
            self.put(0x080)
            for node in self.nodes:
                if (self.cycle, node) not in missing:
                    self.put(0x180 + node, struct.pack("<Hih", status, self.cycle, 100))
            self.now_ns = begin + self.period_ns
            self.cycle += 1
        return self

    def emergency(self, node, code):
        self.put(0x080 + node, struct.pack("<HB5x", code, 1))
        return self

    def heard(self):
        """The frames since, as a listener gives them."""
        found = np.array(self.frames, FRAME_RECORD)
        self.frames = []
        return found


def played(channel, traffic, real_s):
    """Send frames on a bus at their times, those of a cycle together, for so long."""
    begin, first = time.monotonic(), int(traffic["stamp_ns"][0])
    cycles = np.flatnonzero(np.diff(traffic["stamp_ns"] // 1_000_000)) + 1
    for cycle in np.split(traffic, cycles):
        while (left := begin + 1e-9 * (int(cycle["stamp_ns"][0]) - first) - time.monotonic()) > 0:
            channel.receive(min(left, 0.001))
        frames = [Frame(int(each["can_id"]), int(each["data"]).to_bytes(8, "little")[: each["length"]]) for each in cycle]
        for place in range(0, len(frames), 40):
            channel.send_all(frames[place : place + 40])
        if time.monotonic() - begin > real_s:
            return
