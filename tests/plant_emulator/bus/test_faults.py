"""Faults: which frames they hit, what they do to them, and what their file may say."""

import itertools

import pytest

from drive_profiles.errors import FileError
from drive_profiles.files import toml as files
from hil.can.bits import duration_ns
from hil.can.frame import CAN_EFF_FLAG, CAN_RTR_FLAG, Frame
from plant_emulator.bus.controller import ErrorState
from plant_emulator.bus.faults import BusFaults, Fault, FaultsFile
from plant_emulator.bus.wire import EmulatedWire

US, MS = 1_000, 1_000_000
TPDO, OTHER = Frame(0x181, bytes(range(8))), Frame(0x281, b"\x01")


def sent(faults, offers, bitrate=1_000_000, seed=0, until=10**9):
    """What is delivered of (time, port, frame)."""
    wire = EmulatedWire(bitrate, faults=BusFaults(faults, seed))
    for _ in range(3):
        wire.attach()
    delivered = []
    for at, port, frame in offers:
        delivered += wire.advance(at)
        wire.offer(port, frame, at)
    return wire, delivered + wire.advance(until)


def periodic(count, frame=TPDO, port=0):
    return [(n * MS, port, frame) for n in range(count)]


def kept(faults, offers, **options):
    """The numbers of the milliseconds of which a frame came."""
    return [round(d.start_ns / MS) for d in sent(faults, offers, **options)[1]]


class TestSelection:
    def test_by_identifier(self):
        _, delivered = sent([Fault(kind="drop", can_id=0x181)], [(0, 0, TPDO), (0, 0, OTHER)])
        assert [d.frame for d in delivered] == [OTHER]

    def test_by_identifier_under_a_mask(self):
        fault = Fault(kind="drop", can_id=0x180, mask=0x780)
        assert [BusFaults([fault]).apply(Frame(i, b""), 0, 0) == () for i in (0x180, 0x1FF, 0x200, 0x180 | CAN_EFF_FLAG)] == [
            True,
            True,
            False,
            False,
        ]

    def test_a_long_identifier_is_another_than_the_short_one_of_its_number(self):
        fault = Fault(kind="drop", can_id=0x12345)
        assert BusFaults([fault]).apply(Frame(0x12345 | CAN_EFF_FLAG, b""), 0, 0) == ()
        assert len(BusFaults([Fault(kind="drop", can_id=0x345)]).apply(Frame(0x345 | CAN_EFF_FLAG, b""), 0, 0)) == 1

    def test_by_port_time_turn_and_count(self):
        assert kept([Fault(kind="drop", port=1)], periodic(2)) == [0, 1]
        assert kept([Fault(kind="drop", from_s=0.002, to_s=0.004)], periodic(6)) == [0, 1, 4, 5]
        assert kept([Fault(kind="drop", every=3)], periodic(7)) == [0, 1, 3, 4, 6]
        assert kept([Fault(kind="drop", every=2, count=2)], periodic(8)) == [0, 2, 4, 5, 6, 7]

    def test_by_chance_as_often_as_said_and_equally_for_equal_seeds(self):
        runs = [kept([Fault(kind="drop", probability=0.3)], periodic(500), seed=seed) for seed in (1, 1, 2)]
        assert runs[0] == runs[1] != runs[2]
        assert 0.6 < len(runs[0]) / 500 < 0.8

    def test_one_fault_more_does_not_change_the_chance_of_the_others(self):
        first = kept([Fault(kind="drop", probability=0.3)], periodic(100))
        assert first == kept(
            [Fault(kind="drop", probability=0.3), Fault(kind="drop", can_id=0x7FF, probability=0.5)], periodic(100)
        )


class TestFrames:
    def test_a_late_frame_lets_others_of_its_port_pass(self):
        _, delivered = sent([Fault(kind="delay", can_id=0x181, delay_ns=500 * US)], [(0, 0, TPDO), (0, 0, OTHER)])
        assert [(d.frame, d.start_ns) for d in delivered] == [(OTHER, 0), (TPDO, 500 * US)]

    def test_a_duplicate_follows_its_original(self):
        _, delivered = sent([Fault(kind="duplicate", copies=2)], [(0, 0, TPDO)])
        assert [d.frame for d in delivered] == [TPDO] * 3
        assert delivered[1].start_ns == duration_ns(TPDO, 1_000_000)

    def test_a_reordered_frame_comes_after_the_next_one(self):
        _, delivered = sent(
            [Fault(kind="reorder", can_id=0x181, delay_ns=10 * MS)], [(0, 0, TPDO), (MS, 1, OTHER), (2 * MS, 0, OTHER)]
        )
        assert [(d.frame, d.port) for d in delivered] == [(OTHER, 1), (OTHER, 0), (TPDO, 0)]
        assert delivered[2].start_ns == 2 * MS + duration_ns(OTHER, 1_000_000)

    def test_a_reordered_frame_without_a_next_one_comes_late(self):
        wire, delivered = sent([Fault(kind="reorder", delay_ns=10 * MS)], [(0, 0, TPDO)])
        assert [d.start_ns for d in delivered] == [10 * MS]
        assert wire.due is None

    def test_a_payload_is_changed_where_it_is_said(self):
        _, delivered = sent([Fault(kind="corrupt", crc=False, bits=(0, 15, 63))], [(0, 0, TPDO), (0, 0, OTHER)])
        assert [d.frame.data for d in delivered] == [b"\x01\x81\x02\x03\x04\x05\x06\x87", b"\x00"]

    def test_or_in_one_bit_by_chance(self):
        _, delivered = sent([Fault(kind="corrupt", crc=False)], periodic(200))
        changed = [int.from_bytes(d.frame.data, "little") ^ int.from_bytes(TPDO.data, "little") for d in delivered]
        assert {bits.bit_count() for bits in changed} == {1}
        assert len(set(changed)) > 40

    @pytest.mark.parametrize("frame", [Frame(0x80, b""), Frame(0x181 | CAN_RTR_FLAG, bytes(8))])
    def test_a_frame_without_payload_stays_as_it_is(self, frame):
        _, delivered = sent([Fault(kind="corrupt", crc=False)], [(0, 0, frame)])
        assert delivered[0].frame == frame

    @pytest.mark.parametrize("bitrate", [1_000_000, None])
    def test_frame_faults_work_on_a_bus_without_bit_times_too(self, bitrate):
        faults = [
            Fault(kind="drop", every=4),
            Fault(kind="duplicate", every=3),
            Fault(kind="reorder", delay_ns=10 * MS, every=5),
            Fault(kind="corrupt"),
        ]
        _, delivered = sent(faults, [(n * MS, 0, Frame(0x181, bytes([n]))) for n in range(1, 9)], bitrate)
        assert [d.frame.data[0] for d in delivered] == [1, 2, 3, 3, 6, 5, 6, 7]


class TestPortsAndBus:
    def test_a_mute_port_sends_nothing_for_a_time_and_what_it_had_is_lost(self):
        assert kept([Fault(kind="mute", port=0, from_s=0.0015, to_s=0.0035)], periodic(6)) == [0, 1, 4, 5]

    def test_a_mute_port_does_not_acknowledge(self):
        wire = EmulatedWire(1_000_000, faults=BusFaults([Fault(kind="mute", port=1)]))
        wire.attach(), wire.attach()
        wire.advance(1)
        wire.offer(0, TPDO, 1)
        assert wire.advance(10 * MS) == []

    def test_a_babbling_port_fills_the_bus_and_only_what_is_more_urgent_passes(self):
        babble = Fault(kind="babble", port=2, can_id=0x100, data="55", from_s=0.001, to_s=0.011)
        wire, delivered = sent([babble], [(2 * MS, 0, TPDO), (2 * MS, 1, Frame(0x80, b""))], until=20 * MS)
        others = [(d.frame.can_id, round(d.start_ns / MS)) for d in delivered if d.port != 2]
        assert others == [(0x80, 2), (0x181, 11)]
        babbled = [d for d in delivered if d.port == 2]
        assert len(babbled) == pytest.approx(10 * MS / duration_ns(babbled[0].frame, 1_000_000), abs=2)
        assert wire.due is None

    def test_a_babbling_stranger_needs_no_port_of_its_own(self):
        wire = EmulatedWire(1_000_000, faults=BusFaults([Fault(kind="babble", port=9, can_id=0)]))
        wire.attach()
        assert len(wire.advance(MS)) > 15
        assert wire.statistics.busy_ns > 0.9 * MS

    def test_a_port_is_put_bus_off_and_comes_back_when_it_is_said(self):
        wire, delivered = sent([Fault(kind="bus_off", port=0, from_s=0.0015, to_s=0.0035)], periodic(8))
        back = 3_500 * US + 1408 * US  # 128 times 11 bits after its restart it sends what it was offered at 4 ms
        assert [d.start_ns for d in delivered] == [0, MS, back, back + duration_ns(TPDO, 1_000_000), 6 * MS, 7 * MS]
        assert wire.statistics.refused == 2
        assert wire.controller(0).state is ErrorState.ACTIVE
        assert [*wire.switched] == [(0, True), (0, False)]

    def test_a_stuck_bus_carries_nothing(self):
        _, delivered = sent([Fault(kind="stuck", from_s=0.0005, to_s=0.0025)], periodic(4), until=50 * MS)
        assert all(not 500 * US <= d.start_ns < 2500 * US for d in delivered)
        assert len(delivered) == 4
        assert all(a.end_ns < b.start_ns for a, b in itertools.pairwise(delivered))


FILE = """
seed = 7
[[fault]]
kind = "drop"
can_id = 0x181
every = 3
from_s = 2.0
to_s = 3.0
[[fault]]
kind = "babble"
port = 4
can_id = 0x18FF0001
data = "DEadBE"
[[fault]]
kind = "corrupt"
crc = false
bits = [0, 9]
[[fault]]
kind = "delay"
delay_ns = 1000
"""


class TestFile:
    def test_a_file_gives_the_faults_that_it_names(self):
        faults = files.loads(FILE, FaultsFile).faults()
        assert faults.faults == (
            Fault(kind="drop", can_id=0x181, every=3, from_s=2.0, to_s=3.0),
            Fault(kind="babble", port=4, can_id=0x18FF0001, data="DEadBE"),
            Fault(kind="corrupt", crc=False, bits=(0, 9)),
            Fault(kind="delay", delay_ns=1000),
        )
        assert faults.events[0].frame == Frame(0x18FF0001 | CAN_EFF_FLAG, b"\xde\xad\xbe")

    @pytest.mark.parametrize(
        ("table", "words"),
        [
            ('kind = "smash"', "one of"),
            ('kind = "drop"\nports = 1', "did you mean port"),
            ('kind = "drop"\ndelay_ns = 1', "has no effect on a fault of kind drop"),
            ('kind = "stuck"\nto_s = 1.0\nevery = 2', "has no effect"),
            ('kind = "stuck"', "needs to_s"),
            ('kind = "babble"\nport = 1', "needs can_id"),
            ('kind = "mute"', "needs port"),
            ('kind = "delay"', "needs delay_ns"),
            ('kind = "drop"\nfrom_s = 2.0\nto_s = 2.0', "not after"),
            ('kind = "drop"\nprobability = 1.5', "at most 1"),
            ('kind = "drop"\nevery = 0', "at least 1"),
            ('kind = "drop"\ncan_id = 0x20000000', "at most"),
            ('kind = "corrupt"\nbits = [64]\ncrc = false', "less than 64"),
            ('kind = "corrupt"\nbits = [1]', "crc = false"),
            ('kind = "babble"\nport = 1\ncan_id = 1\ndata = "123"', "pattern"),
        ],
    )
    def test_a_mistake_is_told_with_its_line(self, table, words):
        with pytest.raises(FileError, match=words) as caught:
            files.loads(f"[[fault]]\n{table}\n", FaultsFile)
        assert caught.value.problems[0].line >= 1


def test_a_fault_at_the_port_of_no_node_is_refused_and_a_stranger_or_a_client_is_not():
    def at(port, kind="bus_off", **more):
        return FaultsFile(fault=(Fault(kind="drop"), Fault(kind=kind, port=port, **more)))

    for file in (at(2), at(1000), at(99, "babble", can_id=0)):
        file.check_ports([2, 3], 1000)
    with pytest.raises(ValueError, match=r"fault\[1\]: port 99 is of no node; the robot has nodes 2, 3"):
        at(99).check_ports([2, 3], 1000)
