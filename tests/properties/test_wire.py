"""What the wire keeps for every traffic, and its instants against controllers that are simulated bit by bit."""

import itertools
from collections import deque

import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from hil.can.bits import arbitration_key, duration_ns, frame_bits
from hil.can.frame import CAN_EFF_FLAG, CAN_RTR_FLAG, Frame
from plant_emulator.bus.controller import ErrorState
from plant_emulator.bus.faults import BusFaults, Fault
from plant_emulator.bus.wire import QUEUE_FRAMES, EmulatedWire

MEGABIT = 1_000_000
BIT = 1_000
relaxed = settings(max_examples=150)

identifiers = st.one_of(
    st.integers(0, 0x7FF),
    st.sampled_from([0x100, 0x101, 0x0FF]),
    st.sampled_from([0x100 << 18, 0x100 << 18 | 1, 0x101 << 18]).map(lambda i: i | CAN_EFF_FLAG),
    st.integers(0, 0x1FFF_FFFF).map(lambda i: i | CAN_EFF_FLAG),
)
frames = st.builds(
    lambda can_id, data, is_remote: Frame(can_id | CAN_RTR_FLAG * is_remote, data),
    identifiers, st.binary(max_size=8), st.sampled_from([False, False, False, True]),
)  # fmt: skip


# --- controllers, bit by bit ---


class Receiver:
    """Takes bits one by one; `feed` gives "error", "done" or nothing."""

    def __init__(self):
        self.bits, self.last, self.run, self.tail, self.raw = "", "", 0, -1, 0

    def needed(self):
        if len(self.bits) < 14:
            return None
        head = 39 if self.bits[13] == "1" else 19
        if len(self.bits) < head:
            return None
        is_remote = self.bits[32 if head == 39 else 12] == "1"
        return head + (0 if is_remote else 8 * int(self.bits[head - 4 : head], 2)) + 15

    def is_right(self):
        register = 0
        for bit in self.bits:
            carry = register >> 14 ^ int(bit)
            register = (register << 1 & 0x7FFF) ^ (0x4599 if carry & 1 else 0)
        return register == 0  # the CRC of a sequence with its CRC

    @property
    def acknowledges(self):
        return self.tail == 1 and self.is_right()

    def feed(self, bit):
        self.raw += 1
        if self.tail < 0:
            if self.run == 5:
                if bit == self.last:
                    return "error"
            else:
                self.bits += bit
            self.run = self.run + 1 if bit == self.last else 1
            self.last = bit
            if len(self.bits) == self.needed() and self.run < 5:
                self.tail = 0
            return None
        place, self.tail = self.tail, self.tail + 1
        if place != 1 and bit == "0":
            return "error"
        if place == 2 and not self.is_right():
            return "error"
        return "done" if place == 9 else None


class Node:
    """A controller of the standard: sends, listens, flags errors, counts."""

    def __init__(self):
        self.queue, self.mode, self.count = deque(), "idle", 0
        self.tec = self.rec = 0
        self.suspended = 0
        self.log = []
        self.dropped_out = None

    @property
    def is_passive(self):
        return self.tec > 127 or self.rec > 127

    def drive(self, now):
        if self.mode == "idle" and self.queue and self.queue[0][0] <= now and self.suspended <= now:
            self.mode, self.sent, self.listener, self.start = "send", 0, Receiver(), now
            frame = self.queue[0][1]
            self.text = written(frame)
            self.arbitration = 33 if frame.can_id & CAN_EFF_FLAG else 13
        if self.mode == "send":
            return self.text[self.sent]
        if self.mode == "listen":
            return "0" if self.listener.acknowledges else "1"
        return "0" if self.mode == "flag" and not self.flags_passively else "1"

    def fail(self, now, was_sender):
        if was_sender:
            self.tec += 8
        else:
            self.rec += 1
        self.mode, self.count, self.seen = "flag", 0, ""
        self.was_sender = was_sender

    def sample(self, bus, now):
        getattr(self, "_" + self.mode)(bus, now)

    def _idle(self, bus, now):
        if bus == "0":
            self.mode, self.listener = "listen", Receiver()
            self.listener.feed(bus)

    def _send(self, bus, now):
        own, place = self.text[self.sent], self.sent - (len(self.text) - 10)
        in_arbitration = len(self.listener.bits) < self.arbitration
        outcome = self.listener.feed(bus)
        self.sent += 1
        if place == 1:
            if bus == "1":
                was_passive = self.is_passive
                self.fail(now, True)
                self.flags_passively = was_passive
        elif own == "1" and bus == "0":
            if in_arbitration:
                self.mode = "listen"
                return
            was_passive = self.is_passive
            if was_passive and self.dropped_out is None:
                self.dropped_out = now
            self.fail(now, True)
            self.flags_passively = was_passive
        elif outcome == "done":
            _, frame = self.queue.popleft()
            self.log.append((frame, self.start, now + 1))
            self.tec = max(self.tec - 1, 0)
            self.mode, self.count, self.was_sender = "gap", 0, True

    def _listen(self, bus, now):
        outcome = self.listener.feed(bus)
        if outcome == "error":
            was_passive = self.is_passive
            self.fail(now, False)
            self.flags_passively = was_passive
        elif outcome == "done":
            self.rec = max(self.rec - 1, 0) if self.rec < 128 else 120
            self.mode, self.count, self.was_sender = "gap", 0, False

    def _flag(self, bus, now):
        self.count += 1
        if self.flags_passively:
            self.seen = self.seen + bus if self.seen[-1:] in {"", bus} else bus
            if len(self.seen) < 6:
                return
        elif self.count < 6:
            return
        self.mode, self.count = "wait", 0

    def _wait(self, bus, now):
        if bus == "1":
            self.mode, self.count = "delimiter", 1

    def _delimiter(self, bus, now):
        self.count += 1
        if self.count == 8:
            self.mode, self.count = "gap", 0

    def _gap(self, bus, now):
        self.count += 1
        if self.count == 3:
            self.mode = "idle"
            self.suspended = now + 1 + (8 if self.was_sender and self.is_passive else 0)


def written(frame):
    """All bits of a frame that its sender sends."""
    can_id, data = frame
    remote = "1" if can_id & CAN_RTR_FLAG else "0"
    if can_id & CAN_EFF_FLAG:
        name = f"{can_id & 0x1FFF_FFFF:029b}"
        text = "0" + name[:11] + "11" + name[11:] + remote + "00"
    else:
        text = "0" + f"{can_id & 0x7FF:011b}" + remote + "00"
    text += f"{len(data):04b}" + ("" if remote == "1" else "".join(f"{byte:08b}" for byte in data))
    register = 0
    for bit in text:
        carry = register >> 14 ^ int(bit)
        register = (register << 1 & 0x7FFF) ^ (0x4599 if carry & 1 else 0)
    text += f"{register:015b}"
    out = ""
    for bit in text:
        out += bit
        if len(out) >= 5 and out[-5:] in {"00000", "11111"} and stuffed_run(out) == 5:
            out += "1" if bit == "0" else "0"
    return out + "1" * 10


def stuffed_run(out):
    return len(out) - len(out.rstrip(out[-1]))


def bit_by_bit(ports, offers, bits):
    """What `ports` controllers deliver, in order of end, their counters afterwards, and until when this holds.

    A controller that drops out of a collision as error-passive may see the next frames as errors in its delimiter; neither side
    goes into that, so from there on nothing is compared. Offers are (bit time, port, frame).
    """
    nodes = [Node() for _ in range(ports)]
    for at, port, frame in offers:
        nodes[port].queue.append((at, frame))
    for now in range(bits):
        bus = "0" if "0" in [node.drive(now) for node in nodes] else "1"
        for node in nodes:
            node.sample(bus, now)
    log = {}
    for port, node in enumerate(nodes):
        for frame, start, end in node.log:
            log.setdefault((end, start), (frame, port))
    delivered = [(frame, port, start * BIT, end * BIT) for (end, start), (frame, port) in sorted(log.items())]
    end = min((node.dropped_out for node in nodes if node.dropped_out is not None), default=None)
    return delivered, [(node.tec, node.rec) for node in nodes], end


def by_wire(ports, offers, bits):
    wire = EmulatedWire(MEGABIT)
    for _ in range(ports):
        wire.attach()
    for at, port, frame in offers:
        assert wire.offer(port, frame, at * BIT)
    delivered = [tuple(frame) for frame in wire.advance(bits * BIT)]
    return delivered, [(wire.controller(port).tec, wire.controller(port).rec) for port in range(ports)]


short_traffic = st.lists(st.tuples(st.integers(0, 400), st.integers(0, 2), frames), min_size=1, max_size=6).map(
    lambda offers: sorted(offers, key=lambda offer: offer[0])
)


@pytest.mark.slow
@settings(max_examples=200)
@given(short_traffic)
def test_instants_are_those_of_controllers_simulated_bit_by_bit(offers):
    agree(3, offers, 1500)


@settings(max_examples=40)
@given(identifiers, st.binary(max_size=8), st.binary(max_size=8), st.integers(2, 3))
def test_collisions_end_and_go_on_as_bit_by_bit(can_id, one, other, ports):
    agree(ports, [(0, 0, Frame(can_id, one)), (0, 1, Frame(can_id, other))], 3_000)


def agree(ports, offers, bits):
    expected, expected_counters, end = bit_by_bit(ports, offers, bits)
    delivered, counters = by_wire(ports, offers, bits)
    event(f"{len(delivered)} of {len(offers)} delivered, {'all' if end is None else 'part'} compared")
    if end is None:
        assert delivered == expected
        assert counters == expected_counters or len(delivered) < len(offers)
    else:
        assert [d for d in delivered if d[3] <= end * BIT] == [d for d in expected if d[3] <= end * BIT]


# --- whatever comes ---

traffic = st.lists(st.tuples(st.integers(0, 3_000_000), st.integers(0, 3), frames), max_size=40)
bit_rates = st.sampled_from([1_000_000, 500_000, 125_000, 83_333])


def without_collisions(offers):
    """Each identifier belongs to one port, as the standard demands."""
    return [(at, port, Frame((frame.can_id & ~3 if frame.can_id & 3 != port else frame.can_id) & ~3 | port, frame.data))
            for at, port, frame in sorted(offers, key=lambda offer: offer[0])]  # fmt: skip


def run(offers, bitrate=MEGABIT, until=10**9, stops=(), **options):
    wire = EmulatedWire(bitrate, **options)
    for _ in range(4):
        wire.attach()
    delivered = []
    pending = deque(offers)
    for stop in [*sorted({*stops, *(at for at, _, _ in offers)}), until]:
        delivered += wire.advance(stop)
        while pending and pending[0][0] == stop:
            at, port, frame = pending.popleft()
            assert wire.offer(port, frame, at)
    return wire, delivered


@pytest.mark.slow
@relaxed
@given(traffic.map(without_collisions), bit_rates)
def test_without_faults_nothing_is_lost_and_nothing_overlaps(offers, bitrate):
    wire, delivered = run(offers, bitrate)
    assert sorted((d.port, d.frame) for d in delivered) == sorted((port, frame) for _, port, frame in offers)
    for before, after in itertools.pairwise(delivered):
        assert before.end_ns < after.end_ns
        assert before.start_ns + duration_ns(before.frame, bitrate) <= after.start_ns
    statistics = wire.statistics
    assert statistics.busy_ns == sum(duration_ns(d.frame, bitrate) for d in delivered)
    assert statistics.bits == sum(frame_bits(d.frame) for d in delivered)
    assert (statistics.frames, statistics.errors, statistics.refused, statistics.lost) == (len(offers), 0, 0, 0)


@relaxed
@given(traffic.map(without_collisions))
def test_each_port_keeps_its_order_and_the_lowest_of_those_that_wait_goes_first(offers):
    _, delivered = run(offers)
    queues = {port: deque((at, frame) for at, p, frame in offers if p == port) for port in range(4)}
    idle = 0
    for frame, port, start, _ in delivered:
        heads = {p: queue[0] for p, queue in queues.items() if queue}
        assert start == max(idle, min(at for at, _ in heads.values()))
        assert frame == heads[port][1]
        ready = [head for at, head in heads.values() if at <= start]
        assert arbitration_key(frame.can_id) == min(arbitration_key(head.can_id) for head in ready)
        queues[port].popleft()
        idle = start + duration_ns(frame, MEGABIT)


FAULTS = (
    Fault(kind="drop", probability=0.1),
    Fault(kind="delay", delay_ns=300_000, probability=0.2),
    Fault(kind="duplicate", every=5),
    Fault(kind="reorder", delay_ns=500_000, probability=0.2),
    Fault(kind="corrupt", probability=0.2, attempts=2),
    Fault(kind="corrupt", probability=0.2, crc=False),
    Fault(kind="mute", port=1, from_s=0.001, to_s=0.0015),
    Fault(kind="babble", port=2, can_id=0x7F, from_s=0.0005, to_s=0.0008),
    Fault(kind="stuck", from_s=0.002, to_s=0.00202),
    Fault(kind="bus_off", port=3, from_s=0.0022, to_s=0.0026),
)


def outcome(offers, stops, seed, look=False):
    faults = BusFaults(FAULTS, seed)
    wire = EmulatedWire(MEGABIT, faults=faults)
    for _ in range(4):
        wire.attach()
    delivered, pending, accepted = [], deque(offers), 0
    for stop in [*sorted({*stops, *(at for at, _, _ in offers)}), 10**9]:
        delivered += wire.advance(stop)
        while pending and pending[0][0] == stop:
            at, port, frame = pending.popleft()
            accepted += wire.offer(port, frame, at)
            if look:
                assert wire.due is None or wire.due >= stop
    assert wire.due is None
    return delivered, [*wire.switched], wire.statistics, accepted


@pytest.mark.ci
@relaxed
@given(traffic, st.lists(st.integers(0, 4_000_000), max_size=20), st.integers(0, 3))
def test_equal_seeds_give_equal_results_however_time_is_cut_and_looked_at(offers, stops, seed):
    offers = sorted(offers, key=lambda offer: offer[0])
    assert outcome(offers, (), seed) == outcome(offers, stops, seed, look=True)


@pytest.mark.ci
@relaxed
@given(traffic, st.integers(0, 3))
def test_faults_never_make_frames_overlap_nor_the_bus_busier_than_time(offers, seed):
    delivered, _, statistics, _ = outcome(sorted(offers, key=lambda offer: offer[0]), (), seed)
    for before, after in itertools.pairwise(delivered):
        assert before.end_ns < after.end_ns
        assert before.start_ns + duration_ns(before.frame, MEGABIT) <= after.start_ns
    assert statistics.frames == len(delivered)
    assert statistics.busy_ns >= sum(duration_ns(d.frame, MEGABIT) for d in delivered)


@pytest.mark.ci
@relaxed
@given(traffic.map(without_collisions))
def test_without_bit_times_frames_come_at_their_instant_in_order_of_offers(offers):
    _, delivered = run(offers, None)
    assert [(d.end_ns, d.port, d.frame) for d in delivered] == offers
    assert all(d.start_ns == d.end_ns for d in delivered)


def loaded(part, periods=1000):
    """Eight senders with one period each that together ask for this part of a bus, for a second."""
    wire = EmulatedWire(MEGABIT)
    senders = [wire.attach() for _ in range(8)]
    content = [Frame(0x181 + port, bytes([0xA5 + port] * 8)) for port in senders]
    period = round(sum(duration_ns(frame, MEGABIT) for frame in content) / part)
    worst = 0
    for at in range(0, 1_000_000_000, period):
        for port in senders:
            wire.offer(port, content[port], at)
        for delivered in wire.advance(at + period):
            worst = max(worst, delivered.end_ns - delivered.start_ns)
    return wire, period


def test_at_95_percent_nothing_is_lost_and_delays_stay_below_a_period():
    wire, period = loaded(0.95)
    assert wire.statistics.refused == 0
    assert wire.statistics.longest_wait_ns < period
    assert abs(wire.statistics.busy_ns / wire.now - 0.95) < 0.01


def test_at_105_percent_frames_wait_longer_than_a_period_within_a_second():
    wire, period = loaded(1.05)
    assert wire.statistics.longest_wait_ns > period
    assert wire.statistics.busy_ns > 0.999 * wire.now
    assert wire.statistics.longest_queue <= QUEUE_FRAMES


@relaxed
@given(st.lists(st.tuples(st.integers(0, 2), frames), min_size=1, max_size=60))
def test_memory_is_bounded_and_what_does_not_fit_is_refused_with_a_count(offers):
    wire = EmulatedWire(MEGABIT, queue_frames=5)
    for _ in range(4):
        wire.attach()
    accepted = [wire.offer(port, frame, 0) for port, frame in offers]
    assert accepted.count(False) == wire.statistics.refused
    assert wire.statistics.longest_queue <= 5
    assert wire.controller(0).state is ErrorState.ACTIVE
