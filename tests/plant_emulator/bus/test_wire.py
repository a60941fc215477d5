"""The wire: who sends when, and what errors cost."""

import itertools

import pytest

from hil.can.bits import duration_ns, frame_bits, sent_bits
from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, Frame
from plant_emulator.bus.confinement import stuck_steps
from plant_emulator.bus.controller import ErrorState
from plant_emulator.bus.faults import BusFaults, Fault
from plant_emulator.bus.wire import EmulatedWire

BIT = 1_000
SYNC = Frame(0x080, b"")
LOW, HIGH = Frame(0x181, bytes(8)), Frame(0x581, bytes(range(8)))


def wire_of(ports=3, bitrate=1_000_000, **options):
    wire = EmulatedWire(bitrate, **options)
    for _ in range(ports):
        wire.attach()
    return wire


def ends(wire, until=10**9):
    """Every instant at which something happens, until the wire is idle."""
    found = []
    while (due := wire.due) is not None and due <= until:
        wire.advance(due)
        found.append(due)
    return found


def faulty(*faults, seed=0, **options):
    return wire_of(faults=BusFaults(faults, seed), **options)


class TestArbitration:
    def test_a_frame_starts_at_once_on_an_idle_bus_and_ends_with_its_eof(self):
        wire = wire_of()
        assert wire.offer(0, SYNC, 500)
        assert wire.due == 500
        wire.advance(500)
        assert wire.due == 500 + (51 - 3) * BIT
        assert wire.advance(10**6) == [(SYNC, 0, 500, 500 + 48 * BIT)]
        assert wire.due is None

    def test_the_lowest_identifier_of_those_that_wait_at_the_end_goes_first(self):
        wire = wire_of()
        wire.offer(0, SYNC, 0)
        wire.offer(1, HIGH, 10)
        wire.offer(2, LOW, 51 * BIT)  # the very instant at which the bus is idle again
        assert [d.frame for d in wire.advance(10**6)] == [SYNC, LOW, HIGH]

    def test_one_nanosecond_later_is_too_late(self):
        wire = wire_of()
        wire.offer(0, SYNC, 0)
        wire.offer(1, HIGH, 10)
        wire.offer(2, LOW, 51 * BIT + 1)
        assert [d.frame for d in wire.advance(10**6)] == [SYNC, HIGH, LOW]

    def test_an_answer_at_the_end_of_a_frame_is_in_time_for_the_next_start(self):
        wire = wire_of()
        wire.offer(0, SYNC, 0)
        wire.offer(1, HIGH, 0)
        (first,) = wire.advance(wire.due)
        wire.offer(2, LOW, first.end_ns)
        assert [d.frame for d in wire.advance(10**6)] == [LOW, HIGH]

    @pytest.mark.parametrize(
        ("first", "second"),
        [
            (Frame(0x100, b""), Frame(0x100 | CAN_RTR_FLAG, b"")),
            (Frame(0x100 | CAN_RTR_FLAG, b""), Frame(0x100 << 18 | CAN_EFF_FLAG, b"")),
            (Frame(0x0FF << 18 | 0x3FFFF | CAN_EFF_FLAG, b""), Frame(0x100, b"")),
            (Frame(0x100 << 18 | CAN_EFF_FLAG, b""), Frame(0x100 << 18 | CAN_EFF_FLAG | CAN_RTR_FLAG, b"")),
        ],
    )
    def test_requests_and_long_identifiers_are_ordered_as_their_bits_are(self, first, second):
        wire = wire_of()
        wire.offer(0, second, 0)
        wire.offer(1, first, 0)
        assert [d.frame for d in wire.advance(10**6)] == [first, second]

    def test_a_queue_is_first_in_first_out(self):
        wire = wire_of(2)
        wire.offer(1, HIGH, 0)
        wire.offer(1, LOW, 0)
        assert [d.frame for d in wire.advance(10**6)] == [HIGH, LOW]

    def test_without_bit_times_everything_comes_at_once(self):
        wire = wire_of(bitrate=None)
        wire.offer(1, HIGH, 0)
        wire.offer(0, LOW, 0)
        wire.offer(0, SYNC, 7)
        assert wire.due == 0
        assert wire.advance(0) == [(HIGH, 1, 0, 0), (LOW, 0, 0, 0)]
        assert wire.advance(7) == [(SYNC, 0, 7, 7)]


class TestErrors:
    def test_a_corrupted_frame_costs_its_bits_up_to_the_ack_slot_and_an_error_frame_and_is_sent_again(self):
        wire = faulty(Fault(kind="corrupt", can_id=0x181, count=1))
        wire.offer(0, LOW, 0)
        (delivered,) = wire.advance(10**6)
        spoilt = frame_bits(LOW) - 11 + 6 + 1 + 8 + 3  # flag, one bit of echo, delimiter, intermission
        assert delivered.start_ns == spoilt * BIT
        assert wire.statistics.errors == 1
        assert wire.statistics.busy_ns == spoilt * BIT + duration_ns(LOW, 1_000_000)
        assert [(wire.controller(p).tec, wire.controller(p).rec) for p in range(3)] == [(7, 0), (0, 0), (0, 0)]

    def test_a_frame_that_nobody_acknowledges_is_repeated_for_ever_but_never_bus_off(self):
        wire = wire_of(ports=1)
        wire.offer(0, SYNC, 0)
        active = (51 - 11 + 6 + 8 + 3) * BIT
        # the first is the start of the first attempt as the due time of the offer
        instants = ends(wire, 20 * active)
        attempts = [e for e in instants if e]
        assert attempts[:15] == [n * active - 3 * BIT for n in range(1, 16)]
        assert wire.controller(0).tec == 128
        later = ends(wire, 60 * active)
        assert {b - a for a, b in itertools.pairwise(later)} == {active + 8 * BIT}  # suspended
        assert wire.controller(0).state is ErrorState.PASSIVE
        assert wire.controller(0).tec == 128
        wire.attach()
        assert [d.frame for d in wire.advance(61 * active + 10**6)] == [SYNC]
        assert (wire.controller(0).tec, wire.controller(0).state) == (127, ErrorState.ACTIVE)

    def test_two_that_send_one_identifier_with_different_data_collide(self):
        wire = wire_of()
        one, other = Frame(0x181, b"\x01"), Frame(0x181, b"\x00")
        wire.offer(0, one, 0)
        wire.offer(1, other, 0)
        texts = sent_bits(one), sent_bits(other)
        at = next(i for i, (a, b) in enumerate(zip(*texts, strict=False)) if a != b)
        wire.advance(1)
        end = wire.due
        assert (at + 1 + 6 + 8) * BIT <= end <= (at + 1 + 12 + 8) * BIT
        wire.advance(end)
        assert wire.statistics.collisions == wire.statistics.errors == 1
        assert [wire.controller(p).tec for p in range(3)] == [8, 8, 0]
        assert wire.controller(2).rec == 1
        delivered = wire.advance(10**8)
        # both are error-passive after 16; then the dominant one is no longer disturbed
        assert [d.frame for d in delivered] == [other, one]
        assert wire.statistics.collisions == 17

    def test_two_that_collide_with_nobody_else_get_apart(self):
        wire = wire_of(ports=2)
        wire.offer(0, Frame(0x181, b"\x01"), 0)
        wire.offer(1, Frame(0x181, b"\x00"), 0)
        assert len(wire.advance(10**8)) == 2

    def test_the_very_same_frame_of_two_is_one(self):
        wire = wire_of()
        wire.offer(2, LOW, 0)
        wire.offer(1, LOW, 0)
        assert wire.advance(10**6) == [(LOW, 1, 0, (frame_bits(LOW) - 3) * BIT)]
        assert wire.statistics.merged == 1
        assert wire.due is None

    def test_bus_off_after_32_failed_attempts_and_no_return_by_itself(self):
        wire = faulty(Fault(kind="corrupt", can_id=0x181, attempts=1000))
        wire.offer(0, LOW, 0)
        wire.offer(0, HIGH, 0)
        assert wire.advance(10**8) == []
        assert wire.controller(0).state is ErrorState.OFF
        assert wire.statistics.errors == 32
        assert wire.statistics.lost == 2
        assert not wire.offer(0, SYNC, 10**8)
        assert wire.statistics.refused == 1
        assert [*wire.switched] == [(0, True)]
        assert wire.due is None

    def test_a_restart_brings_a_port_back_after_128_times_11_bits(self):
        wire = faulty(Fault(kind="bus_off", port=0, from_s=0.0))
        wire.advance(10)
        wire.restart(0)
        wire.restart(0)  # nothing more
        assert [*wire.switched] == [(0, True), (0, False)]
        assert wire.offer(0, SYNC, 10)
        (delivered,) = wire.advance(10**7)
        assert delivered.start_ns == 10 + 1408 * BIT

    def test_receivers_are_error_passive_at_128_and_come_back_with_the_next_good_frame(self):
        wire = faulty(Fault(kind="corrupt", can_id=0x181, attempts=30), Fault(kind="corrupt", can_id=0x182, attempts=30),
                      Fault(kind="corrupt", can_id=0x183, attempts=30), Fault(kind="corrupt", can_id=0x184, attempts=30),
                      Fault(kind="corrupt", can_id=0x185, attempts=30), ports=7)  # fmt: skip
        for port in range(5):
            wire.offer(port, Frame(0x181 + port, b""), 0)
        states = []
        while (due := wire.due) is not None:
            wire.advance(due)
            states.append((wire.controller(6).rec, wire.controller(6).state))
        assert all((state is ErrorState.PASSIVE) is (rec >= 128) for rec, state in states)
        assert max(states, key=lambda each: each[0])[0] >= 128
        assert wire.controller(6).rec < 128

    def test_a_stuck_bus_puts_the_sender_off_and_the_listeners_into_error_passive(self):
        wire = faulty(Fault(kind="stuck", from_s=10e-6, to_s=1e-3))
        wire.offer(0, LOW, 0)
        wire.offer(1, HIGH, 0)
        delivered = wire.advance(10**7)
        assert [d.frame for d in delivered] == [HIGH]
        assert delivered[0].start_ns == 10**6 + 11 * BIT
        assert wire.controller(0).state is ErrorState.OFF
        assert wire.controller(1).rec == 255 or wire.controller(1).rec == 0
        assert wire.controller(2).rec == 120

    def test_a_stuck_bus_is_counted_after_14_bits_and_every_eight(self):
        assert [stuck_steps(bits) for bits in (0, 13, 14, 21, 22, 30)] == [0, 0, 1, 1, 2, 3]


class TestRoom:
    def test_what_does_not_fit_is_refused_and_counted(self):
        wire = wire_of(queue_frames=2)
        assert [wire.offer(0, LOW, 0) for _ in range(3)] == [True, True, False]
        assert wire.statistics.refused == 1
        wire.advance(10**6)
        assert wire.offer(0, LOW, 10**6)

    def test_a_port_that_leaves_takes_its_queue_with_it(self):
        wire = wire_of()
        wire.offer(0, LOW, 0)
        wire.offer(0, HIGH, 0)
        wire.advance(10)
        wire.detach(0)
        assert [d.frame for d in wire.advance(10**6)] == [LOW]
        assert wire.statistics.lost == 1
        assert wire.attach() == 0


class TestMistakes:
    def test_a_caller_is_told(self):
        wire = wire_of()
        wire.advance(100)
        for call in (lambda: wire.offer(0, LOW, 99), lambda: wire.advance(99), lambda: wire.offer(9, LOW, 100),
                     lambda: wire.offer(0, Frame(CAN_ERR_FLAG, bytes(8)), 100), lambda: wire.attach(0), lambda: wire.detach(9),
                     lambda: EmulatedWire(0), lambda: EmulatedWire(1, queue_frames=0),
                     lambda: wire.controller(9),
                     lambda: EmulatedWire(None, faults=BusFaults([Fault(kind="stuck", to_s=1.0)]))):  # fmt: skip
            with pytest.raises(ValueError, match=r"."):
                call()

    def test_a_frame_of_the_wrong_kind_is_refused_on_a_bus_without_bit_times_too(self):
        with pytest.raises(ValueError, match="wire"):
            wire_of(bitrate=None).offer(0, Frame(CAN_ERR_FLAG, bytes(8)), 0)
