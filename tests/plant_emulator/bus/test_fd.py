"""A CAN FD bus: frames of up to 8 bytes whose data go at a higher rate."""

import itertools
import math
import random
from fractions import Fraction

import pytest

from hil.can.bits import arbitration_key, frame_bits
from hil.can.frame import CAN_EFF_FLAG, CAN_RTR_FLAG, Frame
from plant_emulator.bus.faults import BusFaults, Fault
from plant_emulator.bus.wire import EmulatedWire
from tests.oracles.can_fd import counted_fd

MEGABIT = 1_000_000


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
        nominal, fast = counted_fd(can_id & 0x1FFF_FFFF, data, long)
        exact_ns = nominal * Fraction(10**9, rates[0]) + fast * Fraction(10**9, rates[1])
        assert after.start_ns - before.start_ns == math.ceil(exact_ns)
    assert wire.statistics.bits == sum(
        sum(counted_fd(f.can_id & 0x1FFF_FFFF, f.data, bool(f.can_id & CAN_EFF_FLAG))) for f in frames
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
        EmulatedWire(MEGABIT, 5_000_000, faults=BusFaults([Fault(kind="corrupt", count=1)])),
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
