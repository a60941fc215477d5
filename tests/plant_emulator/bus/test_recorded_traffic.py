"""Random traffic passes the wire as it did when it was recorded: frames, instants, counts and error counters."""

import hashlib
import random

import pytest

from hil.can.frame import CAN_EFF_FLAG, CAN_RTR_FLAG, Frame
from plant_emulator.bus.faults import BusFaults, Fault
from plant_emulator.bus.wire import EmulatedWire

MEGABIT = 1_000_000
SYNC = Frame(0x80, b"")
CLIENT = 1000
ANSWERING = (2, 3, 5, 16)
FAULTS = (
    Fault(kind="corrupt", probability=0.01),
    Fault(kind="drop", probability=0.02),
    Fault(kind="corrupt", probability=0.05, crc=False),
    Fault(kind="delay", probability=0.02, delay_ns=700_000),
    Fault(kind="reorder", probability=0.02, delay_ns=300_000),
    Fault(kind="duplicate", probability=0.02),
    Fault(kind="mute", port=3, from_s=0.1, to_s=0.12),
    Fault(kind="stuck", from_s=0.2, to_s=0.2001),
    Fault(kind="babble", port=2, can_id=0x70, from_s=0.3, to_s=0.305),
    Fault(kind="bus_off", port=5, from_s=0.35, to_s=0.36),
)


class Traffic:
    """Cycles of SYNC and answers, bursts, remote and long frames, bus-off, now and then one identifier from two ports."""

    def __init__(self, seed, rates, collisions, faults):
        self.draw, self.collisions = random.Random(seed), collisions
        self.wire = EmulatedWire(*rates, faults=BusFaults(faults, 7) if faults else None, queue_frames=20)
        self.ports = [*ANSWERING, CLIENT]
        for port in self.ports:
            self.wire.attach(port)
        self.record = hashlib.sha256()

    def note(self, *found):
        wire = self.wire
        counters = [(port, wire.controller(port).tec, wire.controller(port).rec) for port in self.ports]
        self.record.update(repr((found, wire.now, wire.statistics, counters)).encode())

    def data(self, length):
        return bytes(self.draw.choice((0x00, 0xFF, self.draw.getrandbits(8))) for _ in range(length))

    def frame(self, port):
        draw, number = self.draw, self.ports.index(port)
        if draw.random() < self.collisions:
            return Frame(0x123, self.data(draw.choice((1, 8))))
        kind, data = draw.random(), self.data(draw.randrange(9))
        if kind < 0.1:
            return Frame(draw.getrandbits(20) << 5 | number | CAN_EFF_FLAG, data)
        if kind < 0.2:
            return Frame(0x700 | number | CAN_RTR_FLAG, data)
        return Frame(draw.choice((0x000, 0x300, 0x400, 0x600)) | draw.getrandbits(4) << 3 | number, data)

    def offer(self, port, frame, later=0):
        self.note(self.wire.offer(port, frame, self.wire.now + later))

    def pass_time(self, until, *stop_port):
        passed = self.wire.listen(until, *stop_port)
        self.note([each[:4] for each in passed])
        while self.wire.switched:
            port, is_off = self.wire.switched.popleft()
            if is_off and self.draw.random() < 0.7:
                self.wire.restart(port, self.wire.now + self.draw.randrange(3_000_000))
        return passed

    def cycle(self, period):
        """Set-points, SYNC, and answers from where SYNC ends, as on a timed bus."""
        end = self.wire.now + period
        for node in (2, 3, 5):
            self.offer(CLIENT, Frame(0x200 + node, self.data(6)))
        self.offer(CLIENT, SYNC)
        while self.wire.now < end:
            for frame, *_ in self.pass_time(end, CLIENT):
                for node in ANSWERING if frame == SYNC else ():
                    self.offer(node, Frame(0x180 + node, self.data(8)))
                    self.offer(node, Frame(0x280 + node, self.data(5)))

    def some(self):
        kind, draw = self.draw.random(), self.draw
        if kind < 0.3:
            self.cycle(draw.choice((500_000, 1_500_000, 4_000_000)))
        elif kind < 0.6:  # a burst, some of which finds no room
            for _ in range(draw.randrange(40)):
                port = draw.choice(self.ports)
                self.offer(port, self.frame(port), draw.choice((0, 0, 0, 50_000)))
            self.pass_time(self.wire.now + draw.randrange(2_000_000), draw.choice((CLIENT, 16)))
        elif kind < 0.63:
            self.wire.offer(self.wire.attach(7), self.frame(2), self.wire.now)
            self.pass_time(self.wire.now + draw.randrange(200_000))
            self.wire.detach(7)
        elif kind < 0.65 and self.collisions:
            self.wire.switch_off(draw.choice(self.ports))
        elif kind < 0.8:
            self.pass_time(self.wire.now + draw.randrange(20_000_000))
        else:
            port = draw.choice(self.ports)
            self.offer(port, self.frame(port))
            self.pass_time(self.wire.now + draw.randrange(300_000))


RECORDED = {
    (1000000, None, False, 0.0): "6014408a2993922a",
    (1000000, None, False, 0.1): "9839f2480387d2b0",
    (1000000, None, True, 0.0): "d9b2556712eddf90",
    (1000000, None, True, 0.1): "04689623b501b545",
    (125000, None, False, 0.0): "c701147305e1ff0a",
    (125000, None, False, 0.1): "e8413622a033ae99",
    (125000, None, True, 0.0): "d0a002348bd9e5fb",
    (125000, None, True, 0.1): "8e06fd74233985a9",
    (83333, None, False, 0.0): "7f72f69ee069a2bf",
    (83333, None, False, 0.1): "bde0b2d75897f1d1",
    (83333, None, True, 0.0): "c82510c20b8151f4",
    (83333, None, True, 0.1): "e91ba5f926be1fca",
    (1000000, 3000000, False, 0.0): "76262ff68cc5fefa",
    (1000000, 3000000, False, 0.1): "6690b78ccc14b360",
    (1000000, 3000000, True, 0.0): "a0298871ec856146",
    (1000000, 3000000, True, 0.1): "b3527ef380f2da7e",
}
"""Digests by bit rate, bit rate of the data, whether there are faults, and how often two ports use one identifier."""


@pytest.mark.parametrize("collisions", [0.0, 0.1])
@pytest.mark.parametrize("faults", [(), FAULTS], ids=["quiet", "faults"])
@pytest.mark.parametrize("rates", [(MEGABIT, None), (125_000, None), (83_333, None), (MEGABIT, 3_000_000)])
def test_traffic_is_that_of_its_recording(rates, faults, collisions):
    found = hashlib.sha256()
    for seed in range(3):
        traffic = Traffic(seed, rates, collisions, faults)
        for _ in range(60):
            traffic.some()
        assert traffic.wire.statistics.frames > 80
        found.update(traffic.record.digest())
    assert found.hexdigest()[:16] == RECORDED[*rates, bool(faults), collisions]
