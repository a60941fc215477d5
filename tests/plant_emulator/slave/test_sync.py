"""SYNC: its identifier, its counter, the first one to count and the window that it opens."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_profiles.standard.cia301 import DataType, NmtCommand, SdoAbortCode
from plant_emulator.slave.dictionary import Access, Entry
from plant_emulator.slave.objects import PdoDefault

MS = 1_000_000
INVALID = 0x80000000
STATUS, CONTROL = ((0x6041, 0, 16),), ((0x6040, 0, 16),)
LENGTH = bytes.fromhex("4082 11")
"""Emergency 8240h with the error register's bits of communication and of any error."""


@pytest.fixture
def counted(make_bench):
    """A running node that counts SYNCs to 10, with one TPDO of each transmission type that is tried."""

    def make(*types, start_value=0, overflow=10):
        bench = make_bench(tpdos=[PdoDefault(STATUS, kind, is_valid=False) for kind in types])
        assert bench.write_value(0x1019, 0, overflow) is None
        for number, kind in enumerate(types):
            assert bench.write_value(0x1800 + number, 6, start_value) is None
            bench.write_value(0x1800 + number, 2, kind)
            assert bench.write_value(0x1800 + number, 1, 0x185 + 0x100 * number) is None
        bench.start()
        return bench

    return make


def sent_at(bench, counters):
    """Which of the SYNCs with these counters let a TPDO go."""
    return [counter for counter in counters if any(f.can_id == 0x185 for f in bench.sync(bytes((counter,))))]


# 1019h, the counter


def test_the_highest_counter_is_0_or_2_to_240(bench):
    for value in range(256):
        code = None if value == 0 or 2 <= value <= 240 else SdoAbortCode.INVALID_VALUE
        assert bench.write_value(0x1019, 0, value) is code
    assert bench.read(0x1019) == bytes((240,))


def test_the_highest_counter_changes_only_while_there_is_no_period(make_bench, make_entries):
    period = Entry(0x1006, 0, "Communication cycle period", DataType.UNSIGNED32, Access.RW, 0)
    bench = make_bench(entries=[*make_entries(), period])
    assert bench.write_value(0x1019, 0, 10) is None
    assert bench.write_value(0x1006, 0, 1000) is None
    assert bench.write_value(0x1019, 0, 20) is SdoAbortCode.DEVICE_STATE  # CiA 301, 7.5.2.22
    assert bench.write_value(0x1019, 0, 1) is SdoAbortCode.INVALID_VALUE
    assert bench.write_value(0x1019, 0, 10) is None  # no change: a master may write its whole configuration again
    assert bench.write_value(0x1006, 0, 0) is None
    assert bench.write_value(0x1019, 0, 0) is None


def test_a_counter_that_does_not_come_is_told_until_it_does(counted):
    bench = counted(1)
    syncs = []
    bench.slave.on_sync = syncs.append
    # CiA 301, 7.2.5.3 and 7.2.7.1: length 1 with a counter; else 8240h, and 0000h with the next right one.
    assert [frame.data[:3] for frame in bench.sync() if frame.can_id == 0x085] == [LENGTH]
    assert bench.sync() == [(0x185, bytes(2))]
    assert bench.sync(b"\1") == [(0x085, bytes(8)), (0x185, bytes(2))]
    assert bench.sync(b"\2") == [(0x185, bytes(2))]
    assert len(syncs) == 4


def test_a_sync_that_is_too_long_is_not_acted_upon_with_a_counter_either(counted):
    bench = counted(1)
    assert [frame.data[:3] for frame in bench.sync(b"\1\2")] == [LENGTH]
    assert bench.sync(b"\1\2") == []
    assert bench.sync() == [(0x185, bytes(2))]  # still wrong, and told already
    assert bench.slave.emergencies.causes == ("SYNC length",)
    assert len(bench.sync(b"\1")) == 2


def test_the_error_ends_with_the_next_sync_that_is_right_by_then(counted):
    bench = counted(1)
    bench.sync()
    assert bench.write_value(0x1019, 0, 0) is None
    assert bench.slave.emergencies.causes == ("SYNC length",)
    assert bench.sync()[0] == (0x085, bytes(8))


def test_the_error_does_not_outlive_a_reset(counted):
    bench = counted(1)
    bench.sync()
    bench.nmt(NmtCommand.RESET_COMMUNICATION)
    bench.start()
    assert bench.slave.emergencies.causes == ()
    assert bench.sync() == []  # by default this PDO does not exist
    assert bench.slave.emergencies.causes == ()


# Sub-index 6 of a TPDO, the first SYNC to count


@pytest.mark.parametrize(
    ("transmission_type", "start_value", "sent"),
    [
        (1, 0, [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]),
        (1, 4, [4, 5, 6, 7, 8, 9, 10]),
        (3, 0, [3, 6, 9]),
        (3, 1, [3, 6, 9]),
        (3, 2, [4, 7, 10]),  # the SYNC with counter 2 is the first, the one with 4 the third
        (3, 4, [6, 9]),
        (0, 4, [1]),  # only types 1 to 240 count
    ],
)
def test_the_first_sync_is_the_one_with_the_start_value(counted, transmission_type, start_value, sent):
    bench = counted(transmission_type, start_value=start_value)
    assert sent_at(bench, range(1, 11)) == sent


def test_having_begun_a_pdo_counts_on_over_the_highest_counter(counted):
    bench = counted(4, start_value=3, overflow=6)
    assert sent_at(bench, [1, 2, 3, 4, 5, 6]) == [6]
    assert sent_at(bench, [1, 2, 3, 4, 5, 6]) == [4]


def test_pdos_with_different_start_values_share_the_cycles(make_bench):
    bench = make_bench(tpdos=[PdoDefault(STATUS, 2, is_valid=False), PdoDefault(STATUS, 2, is_valid=False)])
    bench.write_value(0x1019, 0, 2)
    for number in (0, 1):
        bench.write_value(0x1800 + number, 6, number + 1)
        bench.write_value(0x1800 + number, 1, 0x185 + 0x100 * number)
    bench.start()
    assert [[f.can_id for f in bench.sync(bytes((1 + n % 2,)))] for n in range(5)] == [[], [0x185], [0x285], [0x185], [0x285]]


def test_a_sync_without_its_counter_is_none_to_a_pdo_with_a_start_value(counted):
    bench = counted(2, start_value=1)
    bench.sync(b"\1")
    assert [frame.can_id for frame in bench.sync()] == [0x085]
    assert [frame.can_id for frame in bench.sync(b"\2")] == [0x085, 0x185]


def test_the_other_pdos_go_without_the_counter_too(counted):
    bench = counted(1)
    bench.write_value(0x1801, 1, 0x285 | INVALID)
    bench.write_value(0x1A01, 1, 0x60770010)
    bench.write_value(0x1A01, 0, 1)
    bench.write_value(0x1801, 2, 1)
    bench.write_value(0x1801, 6, 2)
    bench.write_value(0x1801, 1, 0x285)
    assert [frame.can_id for frame in bench.sync()] == [0x085, 0x185]
    assert [frame.can_id for frame in bench.sync(b"\1")] == [0x085, 0x185]
    assert [frame.can_id for frame in bench.sync(b"\2")] == [0x185, 0x285]


def test_without_a_counter_in_1019h_the_start_value_means_nothing(counted):
    bench = counted(1, start_value=5, overflow=0)
    assert sent_at(bench, [1, 2]) == [1, 2]


def test_the_start_is_waited_for_anew_each_time_the_node_becomes_operational(counted):
    bench = counted(1, start_value=2)
    assert sent_at(bench, [1, 2, 3]) == [2, 3]
    bench.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    bench.start()
    assert sent_at(bench, [1, 2]) == [2]


def test_the_start_value_changes_only_while_the_pdo_does_not_exist(bench):
    assert bench.write_value(0x1800, 6, 3) is SdoAbortCode.INVALID_VALUE
    assert bench.write_value(0x1800, 6, 0) is None
    assert bench.write_value(0x1800, 1, 0x185 | INVALID) is None
    for value in range(256):
        assert bench.write_value(0x1800, 6, value) is (None if value <= 240 else SdoAbortCode.INVALID_VALUE)
    assert bench.read(0x1400, 6) is SdoAbortCode.NO_SUBINDEX
    assert (bench.read(0x1400), bench.read(0x1800)) == (b"\5", b"\6")


@settings(max_examples=60)
@given(st.integers(1, 5), st.integers(0, 5), st.lists(st.none() | st.integers(0, 6), max_size=25))
def test_any_row_of_counters_lets_the_pdo_go_as_often_as_a_clerk_would(make_bench, every, start_value, counters):
    bench = make_bench(tpdos=[PdoDefault(STATUS, every, is_valid=False)])
    bench.write_value(0x1019, 0, 5)
    bench.write_value(0x1800, 6, start_value)
    bench.write_value(0x1800, 1, 0x185)
    bench.start()
    heard = [counter for counter in counters if counter is not None or not start_value]
    if start_value:
        heard = heard[heard.index(start_value) :] if start_value in heard else []
    sent = [bench.sync(b"" if counter is None else bytes((counter,))) for counter in counters]
    assert sum(frame.can_id == 0x185 for frames in sent for frame in frames) == len(heard) // every


# 1007h, the window


@pytest.fixture
def windowed(make_bench):
    """A running node whose synchronous RPDO 1 is heard up to 2 ms after a SYNC; RPDO 2 is event-driven."""
    bench = make_bench(rpdos=[PdoDefault(CONTROL, 1), PdoDefault(((0x607A, 0, 32),))])
    assert bench.write_value(0x1007, 0, 2000) is None
    bench.start()
    return bench


def control(bench, value, at_ms):
    bench.now = round(at_ms * MS)
    bench.send(0x205, struct.pack("<H", value))


def test_what_comes_after_the_window_is_dropped(windowed):
    windowed.sync()
    control(windowed, 1, 2)
    control(windowed, 2, 2.001)
    windowed.now = 10 * MS
    windowed.sync()
    assert windowed.dictionary.get(0x6040) == 1
    control(windowed, 3, 12)
    windowed.sync()
    assert windowed.dictionary.get(0x6040) == 3


def test_the_window_is_open_until_a_first_sync(windowed):
    control(windowed, 7, 50)
    windowed.sync()
    assert windowed.dictionary.get(0x6040) == 7


def test_event_driven_pdos_know_no_window(windowed):
    windowed.sync()
    windowed.now = 50 * MS
    windowed.send(0x305, struct.pack("<i", -9))
    assert windowed.dictionary.get(0x607A) == -9


def test_without_a_window_nothing_comes_too_late(windowed):
    windowed.sync()
    assert windowed.write_value(0x1007, 0, 0) is None
    control(windowed, 5, 900)
    windowed.sync()
    assert windowed.dictionary.get(0x6040) == 5


def test_a_new_window_begins_with_the_next_sync(windowed):
    windowed.sync()
    control(windowed, 1, 3)
    assert windowed.write_value(0x1007, 0, 1000) is None
    control(windowed, 2, 4)
    windowed.sync()
    assert windowed.dictionary.get(0x6040) == 2
    control(windowed, 3, 5.5)
    windowed.sync()
    assert windowed.dictionary.get(0x6040) == 2
    control(windowed, 4, 6)
    windowed.sync()
    assert windowed.dictionary.get(0x6040) == 4


# From the memory


def test_what_could_not_have_been_written_is_not_taken_from_the_memory_either(bench):
    bench.dictionary.stored = {(0x1005, 0): 0x605, (0x1019, 0): 1, (0x1007, 0): 700}
    bench.slave.power_on(bench.now)
    assert [bench.dictionary.get(index) for index in (0x1005, 0x1019, 0x1007)] == [0x80, 0, 700]
    bench.start()
    assert len(bench.sync()) == 1


def test_counter_and_window_are_kept(bench):
    bench.dictionary.stored = {(0x1005, 0): 0x90, (0x1019, 0): 4}
    bench.slave.power_on(bench.now)
    bench.start()
    assert [frame.can_id for frame in bench.send(0x90)] == [0x085, 0x185]
