"""The quick way through the wire against the general one: the same frames, instants, counts and logs, whatever comes."""

import itertools
import random

import pytest

from hil.can.bits import arbitration_key, fd_bits, fd_duration_ns, frame_bits
from hil.can.frame import CAN_EFF_FLAG, CAN_RTR_FLAG, Frame
from plant_emulator.bus.faults import BusFaults, Fault
from plant_emulator.bus.rates import Rates
from plant_emulator.bus.wire import EmulatedWire

MEGABIT = 1_000_000
SYNC = Frame(0x80, b"")
CLIENT = 1000
RATES = [(MEGABIT, None), (125_000, None), (83_333, None), (500_000, 2_000_000), (MEGABIT, 5_000_000), (MEGABIT, 3_000_000)]


def wires(rates, **options):
    """Two alike, of which the second never takes the quick way."""
    quick, general = (
        EmulatedWire(*rates, faults=BusFaults(faults, 7) if (faults := options.get("faults")) else None, queue_frames=20)
        for _ in range(2)
    )
    general._error_free = None
    return quick, general


def state(wire):
    ports = {number: (port.controller.tec, port.controller.rec, port.waiting) for number, port in wire._ports.items()}
    return (
        wire.now, wire.statistics, wire.due, wire.oldest_wait_ns, wire.is_overloaded, wire.load(3_000_000), ports,
        wire.take_reports(), wire.is_waiting(wire.mark),
    )  # fmt: skip


def both(pair, do):
    """Do the same to both; what comes of it, which must be the same."""
    quick, general = (do(wire) for wire in pair)
    assert quick == general
    assert state(pair[0]) == state(pair[1])
    return quick


class Traffic:
    """Random traffic: cycles of SYNC and answers, bursts, remote and long frames, now and then one identifier from two ports."""

    def __init__(self, seed, pair, collisions):
        self.draw, self.pair, self.collisions = random.Random(seed), pair, collisions
        self.ports = [2, 3, 5, 16, CLIENT]
        for port in self.ports:
            both(pair, lambda wire, port=port: wire.attach(port))
        self.delivered, self.now, self.quick = [], 0, 0

    def data(self, length=None):
        size = self.draw.randrange(9) if length is None else length
        return bytes(self.draw.choice((0x00, 0xFF, self.draw.getrandbits(8))) for _ in range(size))

    def frame(self, port):
        if self.draw.random() < self.collisions:
            return Frame(0x123, self.data(self.draw.choice((1, 8))))
        kind, number = self.draw.random(), self.ports.index(port)
        if kind < 0.1:
            return Frame(self.draw.getrandbits(20) << 5 | number | CAN_EFF_FLAG, self.data())
        if kind < 0.2:
            return Frame(0x700 | number | CAN_RTR_FLAG, self.data())
        return Frame(self.draw.choice((0x000, 0x300, 0x400, 0x600)) | self.draw.getrandbits(4) << 3 | number, self.data())

    def offer(self, port, frame, later=0):
        at = self.pair[0].now + later
        return both(self.pair, lambda wire: wire.offer(port, frame, at))

    def advance(self, until, stop_port=None):
        passed = both(self.pair, lambda wire: wire.listen(until) if stop_port is None else wire.listen(until, stop_port))
        self.delivered += passed
        self.quick += self.pair[0]._fast is not None
        return passed

    def cycle(self, period):
        """As a timed bus has it: set-points, SYNC, and answers from where SYNC ends."""
        end = self.pair[0].now + period
        for port in (2, 3, 5):
            self.offer(CLIENT, Frame(0x200 + port, self.data(6)))
        self.offer(CLIENT, SYNC)
        while self.pair[0].now < end:
            for frame, *_ in self.advance(end, CLIENT):
                for port in (2, 3, 5, 16) if frame == SYNC else ():
                    self.offer(port, Frame(0x180 + port, self.data(8)))
                    self.offer(port, Frame(0x280 + port, self.data(5)))

    def some(self):
        kind = self.draw.random()
        if kind < 0.3:
            self.cycle(self.draw.choice((500_000, 1_500_000, 4_000_000)))
        elif kind < 0.5:  # a burst, some of which finds no room
            for _ in range(self.draw.randrange(40)):
                port = self.draw.choice(self.ports)
                self.offer(port, self.frame(port), self.draw.choice((0, 0, 0, 50_000)))
        elif kind < 0.6:
            due = self.pair[0].due
            self.advance(self.pair[0].now if due is None else due, self.draw.choice((None, CLIENT, 16)))
        elif kind < 0.63:
            number = both(self.pair, lambda wire: wire.attach())
            self.offer(number, self.frame(self.draw.choice(self.ports)))
            self.advance(self.pair[0].now + self.draw.randrange(200_000))
            both(self.pair, lambda wire: wire.detach(number))
        elif kind < 0.8:
            self.advance(self.pair[0].now + self.draw.randrange(20_000_000))
        else:
            port = self.draw.choice(self.ports)
            self.offer(port, self.frame(port))
            self.advance(self.pair[0].now + self.draw.randrange(300_000))


@pytest.mark.slow
@pytest.mark.parametrize("collisions", [0.0, 0.1])
@pytest.mark.parametrize("rates", RATES)
def test_random_traffic_passes_both_ways_alike(rates, collisions):
    quick = collided = 0
    for seed in range(3):
        traffic = Traffic(seed, wires(rates), collisions)
        for _ in range(100):
            traffic.some()
        assert traffic.delivered
        collided += traffic.pair[0].statistics.collisions
        quick += traffic.quick
    assert collided or not collisions
    assert bool(quick) == Rates(*rates).is_exact or collisions


@pytest.mark.parametrize("seed", range(5))
def test_with_faults_that_come_and_go_too(seed):
    faults = [
        Fault("corrupt", probability=0.002), Fault("drop", probability=0.02), Fault("corrupt", probability=0.05, crc=False),
        Fault("delay", probability=0.02, delay_ns=700_000), Fault("reorder", probability=0.02, delay_ns=300_000),
        Fault("duplicate", probability=0.02), Fault("mute", port=3, from_s=0.1, to_s=0.12),
        Fault("stuck", from_s=0.2, to_s=0.2001),
        Fault("babble", port=2, can_id=0x70, from_s=0.3, to_s=0.305), Fault("bus_off", port=5, from_s=0.35, to_s=0.36),
    ]  # fmt: skip
    traffic = Traffic(seed, wires((MEGABIT, None), faults=faults), 0.0)
    while traffic.pair[0].now < 500_000_000:
        traffic.some()
    assert traffic.pair[0].statistics.errors
    assert traffic.quick > 10


def test_the_quick_way_is_taken_where_nothing_is_wrong_and_left_where_something_is():
    wire = EmulatedWire(MEGABIT)
    wire.attach()
    wire.advance(0)
    assert wire._fast is None  # nobody would acknowledge
    wire.attach()
    wire.advance(0)
    assert wire._fast is not None
    wire.offer(0, Frame(0x100, b"\0"), 0)
    wire.offer(1, Frame(0x100, b"\1"), 0)
    wire.advance(20_000)
    assert wire._fast is None  # a collision
    wire.advance(10**8)
    wire.offer(0, SYNC, 10**8)
    wire.advance(10**9)
    assert wire.statistics.collisions == 17
    with pytest.raises(ValueError, match="no port"):
        wire.offer(9, SYNC, 10**9)


# --- CAN FD ---


def test_a_fd_bus_delivers_a_frame_after_the_bits_that_are_counted_by_hand():
    wire = EmulatedWire(MEGABIT, 5_000_000)
    for _ in range(2):
        wire.attach()
    # 0x555 alternates, so does 0x55, and nothing is stuffed: SOF 1, identifier 11, RRS, IDE, FDF, res, BRS; then ESI 1, DLC 4,
    # data 64, stuff count 4, CRC 17, fixed stuff bits 6, delimiter 1; then ACK 2, EOF 7
    wire.offer(0, Frame(0x555, b"\x55" * 8), 0)
    [delivered] = wire.advance(10**6)
    assert delivered.end_ns == (17 + 9) * 1000 + (1 + 4 + 64 + 4 + 17 + 6 + 1) * 200
    wire.offer(0, Frame(0x555, b"\x55" * 8), 10**6)
    wire.offer(1, Frame(0x555 | CAN_RTR_FLAG, b""), 10**6)  # a remote frame is a classic one
    first, second = wire.advance(10**7)
    assert second.start_ns == first.end_ns + 3_000
    assert second.end_ns - second.start_ns == 1000 * (frame_bits(second.frame) - 3)


@pytest.mark.parametrize("rates", [(MEGABIT, 5_000_000), (500_000, 2_000_000), (MEGABIT, 3_000_000)])
def test_a_fd_bus_takes_its_times_from_the_counted_bits(rates):
    draw, frames = random.Random(3), []
    for _ in range(200):
        long = CAN_EFF_FLAG if draw.random() < 0.3 else 0
        frames.append(Frame(draw.getrandbits(29 if long else 11) | long, draw.randbytes(draw.randrange(9))))
    wire = EmulatedWire(*rates, queue_frames=200)
    for _ in range(2):
        wire.attach()
    for frame in frames:
        wire.offer(0, frame, 0)
    delivered = wire.advance(10**9)
    assert [d.frame for d in delivered] == frames
    for before, after in itertools.pairwise(delivered):
        can_id, data = before.frame
        long = bool(can_id & CAN_EFF_FLAG)
        expected = fd_duration_ns(can_id & 0x1FFF_FFFF, data, long, bitrate=rates[0], data_bitrate=rates[1])
        assert after.start_ns - before.start_ns == expected
        nominal, fast = fd_bits(can_id & 0x1FFF_FFFF, data, long)
        assert (
            nominal * 1e9 / rates[0] + fast * 1e9 / rates[1] <= expected < nominal * 1e9 / rates[0] + fast * 1e9 / rates[1] + 1.1
        )
    assert wire.statistics.bits == sum(
        sum(fd_bits(f.can_id & 0x1FFF_FFFF, f.data, bool(f.can_id & CAN_EFF_FLAG))) for f in frames
    )


def test_arbitration_on_a_fd_bus_is_as_ever():
    wire = EmulatedWire(MEGABIT, 5_000_000)
    frames = [Frame(can_id, bytes(8)) for can_id in (0x281, 0x181, 0x10 << 18 | CAN_EFF_FLAG, 0x182)]
    for frame in frames:
        wire.offer(wire.attach(), frame, 0)
    assert [d.frame for d in wire.advance(10**7)] == sorted(frames, key=lambda frame: arbitration_key(frame.can_id))


def test_errors_on_a_fd_bus_cost_slow_flags_behind_what_was_sent():
    clean, spoilt = (
        EmulatedWire(MEGABIT, 5_000_000),
        EmulatedWire(MEGABIT, 5_000_000, faults=BusFaults([Fault("corrupt", count=1)])),
    )
    starts = []
    for wire in (clean, spoilt):
        for _ in range(3):
            wire.attach()
        wire.offer(0, Frame(0x555, b"\x55" * 8), 0)
        starts.append(wire.advance(10**6)[0].start_ns)
    # up to the ACK delimiter; flag 6, echo 1, delimiter 8, intermission 3
    assert starts == [0, (17 + 1) * 1000 + 97 * 200 + (6 + 1 + 8 + 3) * 1000]


def test_a_collision_on_a_fd_bus_ends_in_the_fast_part():
    wire = EmulatedWire(MEGABIT, 5_000_000)
    for _ in range(3):
        wire.attach()
    wire.offer(0, Frame(0x555, b"\xaa"), 0)
    wire.offer(1, Frame(0x555, b"\x55"), 0)
    wire.advance(1)
    at = 17 * 1000 + (1 + 4 + 1) * 200  # the first bit of the data differs
    assert at + (6 + 8) * 1000 <= wire.due <= at + 6 * 200 + (6 + 8) * 1000
    wire.advance(10**8)
    assert wire.statistics.frames == 2


@pytest.mark.parametrize("rates", [(None, 5_000_000), (MEGABIT, 500_000), (0, None), (MEGABIT, 0)])
def test_rates_that_cannot_be_are_refused(rates):
    with pytest.raises(ValueError, match="bit rate"):
        EmulatedWire(*rates)
