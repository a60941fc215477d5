"""TIME: the network's time, kept by the node's own clock (CiA 301, 7.2.6)."""

import struct

import pytest
from canopen.timestamp import TimeProducer
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_profiles.standard.cia301 import NmtCommand, SdoAbortCode
from tests.plant_emulator.slave.conftest import MS, PumpedNetwork

TIME = 0x100
DAY_NS = 86_400_000 * MS
NOON = struct.pack("<IH", 43_200_000, 2)


def test_the_time_goes_on_with_the_nodes_own(bench):
    """CiA 301, 7.1.6.5: 28 bits of milliseconds after midnight, 16 bits of days since 1984-01-01."""
    bench.wait(1000)
    assert bench.slave.time_of_day is None
    assert bench.send(TIME, bytes.fromhex("002e9302 0200")) == []
    assert bench.slave.time_of_day == 2.5 * DAY_NS
    bench.wait(250)
    bench.slave.advance(bench.now)
    assert bench.slave.time_of_day == 2.5 * DAY_NS + 250 * MS
    bench.send(TIME, struct.pack("<IH", 0, 1))
    assert bench.slave.time_of_day == DAY_NS


@pytest.mark.parametrize("data", [b"", NOON[:5], NOON + b"\0", struct.pack("<IH", 86_400_000, 2), b"\xff" * 6])
def test_what_is_no_time_of_day_is_ignored(bench, data):
    assert bench.send(TIME, data) == []
    assert bench.slave.time_of_day is None
    bench.send(TIME, NOON)
    bench.send(TIME, data)
    assert bench.slave.time_of_day == 2.5 * DAY_NS


def test_the_four_unused_bits_say_nothing(bench):
    bench.send(TIME, struct.pack("<IH", 43_200_000 | 0xA << 28, 2))
    assert bench.slave.time_of_day == 2.5 * DAY_NS


@pytest.mark.parametrize(
    ("command", "is_heard"),
    [(NmtCommand.START, True), (NmtCommand.ENTER_PRE_OPERATIONAL, True), (NmtCommand.STOP, False)],
)
def test_the_nmt_state_gates_it(bench, command, is_heard):
    bench.nmt(command)
    bench.send(TIME, NOON)
    assert (bench.slave.time_of_day is not None) is is_heard


@pytest.mark.parametrize(("command", "is_kept"), [(NmtCommand.RESET_COMMUNICATION, True), (NmtCommand.RESET_NODE, False)])
def test_a_reset_of_the_node_forgets_it(bench, command, is_kept):
    bench.send(TIME, NOON)
    bench.nmt(command)
    assert (bench.slave.time_of_day is not None) is is_kept


@pytest.mark.parametrize(
    ("values", "code"),
    [
        ((0x0000_0100,), None),
        ((0x0000_0100, 0x8000_0123 - 0x22), SdoAbortCode.INVALID_VALUE),  # 101h is restricted
        ((0x0000_0100, 0x8000_0190), None),
        ((0x8000_0190,), SdoAbortCode.INVALID_VALUE),  # bits 0 to 29 do not change while it is in use
        ((0xC000_0100,), SdoAbortCode.INVALID_VALUE),  # to produce TIME
        ((0x4000_0100,), SdoAbortCode.INVALID_VALUE),
        ((0xA000_0100,), SdoAbortCode.INVALID_VALUE),  # 29 bits
        ((0x0000_0800,), SdoAbortCode.INVALID_VALUE),
    ],
)
def test_the_cob_id_is_taken_or_refused(bench, values, code):
    *before, last = values
    for value in before:
        assert bench.write_value(0x1012, 0, value) is None
    assert bench.write_value(0x1012, 0, last) is code


def test_the_cob_id_decides_where_and_whether_it_is_heard(bench):
    bench.write_value(0x1012, 0, 0x100)
    bench.send(TIME, NOON)
    assert bench.slave.time_of_day is None
    bench.write_value(0x1012, 0, 0x8000_0190)
    bench.send(TIME, NOON)
    assert bench.slave.time_of_day is None
    bench.send(0x190, NOON)
    assert bench.slave.time_of_day is not None


def test_a_kept_cob_id_that_could_not_be_written_is_not_in_force(bench):
    bench.dictionary.stored = {(0x1012, 0): 0xC000_0100}
    bench.nmt(NmtCommand.RESET_COMMUNICATION)
    assert bench.read(0x1012) == struct.pack("<I", 0x8000_0100)
    assert bench.slave.listens(TIME)


@settings(max_examples=30)
@given(st.binary(max_size=8))
def test_any_bytes_leave_a_time_or_none(make_bench, data):
    bench = make_bench()
    bench.send(TIME, data)
    now = bench.slave.time_of_day
    assert now is None or 0 <= now < 65536 * DAY_NS


def test_a_stranger_sets_the_time(bench):
    network = PumpedNetwork(bench)
    TimeProducer(network).transmit(timestamp=441763200 + 2.5 * 86400)  # 1984-01-01 in Unix time
    assert bench.slave.time_of_day == 2.5 * DAY_NS
