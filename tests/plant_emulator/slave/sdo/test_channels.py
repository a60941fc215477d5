"""The SDO channels of a node: the predefined one of 1200h, and the one that 1201h opens (CiA 301, 7.5.2.33)."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_profiles.standard.cia301 import NmtCommand, SdoAbortCode
from hil.can.frame import Frame
from plant_emulator.slave.dictionary import Dictionary, Postponed
from plant_emulator.slave.sdo.channels import SdoChannels
from plant_emulator.slave.sdo.server import SdoServer
from plant_emulator.slave.store import SAVE, store_entries

NODE = 5
MS = 1_000_000
INVALID, DYNAMIC, EXTENDED = 1 << 31, 1 << 30, 1 << 29
REQUEST, RESPONSE = 0x6A0, 0x6A1
READ_LIMITED = bytes((0x40, 0x00, 0x20, 0, 0, 0, 0, 0))
LIMITED_IS_10 = bytes((0x4B, 0x00, 0x20, 0, 10, 0, 0, 0))
READ_LABEL = bytes((0x40, 0x01, 0x20, 0, 0, 0, 0, 0))
REFUSED = SdoAbortCode.INVALID_VALUE


def opened(bench, request_id=REQUEST, response_id=RESPONSE):
    assert bench.write_value(0x1201, 1, request_id) is None
    assert bench.write_value(0x1201, 2, response_id) is None
    return bench


def test_the_predefined_channel_is_that_of_the_connection_set_and_read_only(bench):
    assert [bench.dictionary.get(0x1200, sub) for sub in (0, 1, 2)] == [2, 0x605, 0x585]
    for sub in (1, 2):
        assert bench.write_value(0x1200, sub, 0x6A0) is SdoAbortCode.READ_ONLY


def test_the_second_channel_does_not_exist_before_it_is_opened(bench):
    assert [bench.dictionary.get(0x1201, sub) for sub in (0, 1, 2, 3)] == [3, INVALID, INVALID, 1]
    assert not bench.slave.listens(REQUEST)


def test_a_channel_exists_when_both_identifiers_are_valid(bench):
    heard = []
    bench.slave.on_routes = lambda: heard.append(bench.slave.listens(REQUEST))
    assert bench.write_value(0x1201, 1, REQUEST) is None
    assert bench.send(REQUEST, READ_LIMITED) == []
    assert bench.write_value(0x1201, 2, RESPONSE) is None
    assert bench.send(REQUEST, READ_LIMITED) == [Frame(RESPONSE, LIMITED_IS_10)]
    assert heard == [True]
    assert bench.send(0x605, READ_LIMITED) == [Frame(0x585, LIMITED_IS_10)]


@pytest.mark.parametrize("sub", [1, 2])
def test_a_channel_ends_when_either_identifier_becomes_invalid(bench, sub):
    opened(bench)
    assert bench.write_value(0x1201, sub, INVALID) is None
    assert bench.send(REQUEST, READ_LIMITED) == []
    assert not bench.slave.listens(REQUEST)


def test_a_channel_that_is_closed_through_itself_still_answers(bench):
    opened(bench)
    close = struct.pack("<BHBI", 0x23, 0x1201, 1, INVALID | REQUEST)
    assert bench.send(REQUEST, close) == [Frame(RESPONSE, bytes((0x60, 0x01, 0x12, 1, 0, 0, 0, 0)))]
    assert bench.send(REQUEST, READ_LIMITED) == []


def test_each_channel_has_a_transfer_of_its_own(bench):
    opened(bench)
    bench.write(0x2001, 0, b"a label of 21 letters")
    first = bench.send(0x605, READ_LABEL) + bench.send(0x605, bytes((0x60, *bytes(7))))
    second = bench.send(REQUEST, READ_LABEL) + bench.send(REQUEST, bytes((0x60, *bytes(7))))
    assert [frame.data for frame in first] == [frame.data for frame in second]
    assert bench.send(0x605, bytes((0x70, *bytes(7))))[0].data == b"\x10 of 21 "
    assert bench.send(REQUEST, bytes((0x70, *bytes(7))))[0].data == b"\x10 of 21 "


def test_each_channel_has_a_time_out_of_its_own(bench):
    opened(bench)
    bench.send(0x605, READ_LABEL)
    assert bench.write(0x2001, 0, b"a label of 21 letters") is None
    bench.send(0x605, READ_LABEL)
    bench.now += 1000 * MS
    bench.send(REQUEST, READ_LABEL)
    sent = bench.wait(10_000)
    timed_out = bytes((0x80, 0x01, 0x20, 0, *struct.pack("<I", SdoAbortCode.TIMED_OUT)))
    assert sent == [(5000 * MS, Frame(0x585, timed_out)), (6000 * MS, Frame(RESPONSE, timed_out))]
    assert bench.slave.due is None


def test_both_channels_fall_silent_while_the_node_is_stopped(bench):
    opened(bench)
    bench.send(REQUEST, READ_LABEL)
    bench.nmt(NmtCommand.STOP)
    assert not bench.slave.listens(REQUEST)
    assert bench.wait(10_000) == []
    bench.start()
    assert bench.send(REQUEST, bytes((0x60, *bytes(7))))[0].data[0] == 0x80
    assert bench.send(REQUEST, READ_LIMITED) == [Frame(RESPONSE, LIMITED_IS_10)]


def test_a_channel_that_is_opened_again_remembers_no_transfer(bench):
    opened(bench)
    bench.send(REQUEST, READ_LABEL)
    bench.write_value(0x1201, 2, INVALID)
    assert bench.slave.due is None
    assert bench.write_value(0x1201, 2, 0x6B0) is None
    assert bench.send(REQUEST, bytes((0x60, *bytes(7))))[0] == Frame(
        0x6B0, bytes((0x80, 0, 0, 0, *struct.pack("<I", SdoAbortCode.UNKNOWN_COMMAND)))
    )


# -- what may be written -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sub", [1, 2])
@pytest.mark.parametrize("base", [0x000, 0x07F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x6E0, 0x6FF, 0x701, 0x7FF])
def test_a_restricted_identifier_is_refused_where_it_is_valid(bench, sub, base):
    assert bench.write_value(0x1201, sub, base) is REFUSED
    assert bench.write_value(0x1201, sub, base | INVALID) is None


@pytest.mark.parametrize("sub", [1, 2])
@pytest.mark.parametrize("flag", [EXTENDED, EXTENDED | INVALID, 1 << 11, 1 << 28, 1 << 28 | INVALID])
def test_an_identifier_of_29_bits_is_refused(bench, sub, flag):
    assert bench.write_value(0x1201, sub, REQUEST | flag) is REFUSED
    assert bench.dictionary.get(0x1201, sub) == INVALID


@pytest.mark.parametrize("sub", [1, 2])
def test_an_identifier_does_not_change_while_it_is_valid(bench, sub):
    opened(bench)
    mine = (REQUEST, RESPONSE)[sub - 1]
    assert bench.write_value(0x1201, sub, 0x6B0) is REFUSED
    assert bench.write_value(0x1201, sub, mine) is None
    assert bench.write_value(0x1201, sub, mine | DYNAMIC) is None
    assert bench.send(REQUEST, READ_LIMITED) == [Frame(RESPONSE, LIMITED_IS_10)]
    assert bench.write_value(0x1201, sub, mine | INVALID) is None
    assert bench.write_value(0x1201, sub, 0x6B0) is None


def test_one_identifier_cannot_be_of_both_directions(bench):
    assert bench.write_value(0x1201, 1, REQUEST | DYNAMIC) is None
    assert bench.write_value(0x1201, 2, REQUEST) is SdoAbortCode.PARAMETER_INCOMPATIBLE
    assert bench.write_value(0x1201, 2, REQUEST | INVALID) is None


@pytest.mark.parametrize(("node_id", "code"), [(0, SdoAbortCode.VALUE_TOO_LOW), (128, SdoAbortCode.VALUE_TOO_HIGH), (127, None)])
def test_the_client_is_a_node(bench, node_id, code):
    assert bench.write_value(0x1201, 3, node_id) is code


@settings(max_examples=25)
@given(st.lists(st.tuples(st.sampled_from([1, 2]), st.integers(0, 0x7FF), st.sampled_from([0, INVALID, DYNAMIC])), max_size=12))
def test_no_order_of_writes_locks_the_master_out(make_bench, writes):
    bench = make_bench()
    for sub, can_id, flags in writes:
        assert bench.write_value(0x1201, sub, can_id | flags) in {None, REFUSED, SdoAbortCode.PARAMETER_INCOMPATIBLE}
        cob_ids = [bench.dictionary.get(0x1201, sub) for sub in (1, 2)]
        is_open = not any(cob_id & INVALID for cob_id in cob_ids)
        assert (len(bench.slave._sdo.servers) == 2) == is_open
        if is_open and cob_ids[0] & 0x7FF not in {0x80, 0x100}:  # SYNC and TIME keep theirs
            assert Frame(cob_ids[1] & 0x7FF, LIMITED_IS_10) in bench.send(cob_ids[0] & 0x7FF, READ_LIMITED)
        assert bench.request(*READ_LIMITED) == LIMITED_IS_10


# -- what is kept ------------------------------------------------------------------------------------------------------


@pytest.fixture
def keeping(make_bench, make_entries):
    bench = make_bench(entries=[*make_entries(), *store_entries()])
    opened(bench)
    assert bench.write_value(0x1010, 1, SAVE) is None
    return bench


def test_an_open_channel_that_was_stored_is_there_after_a_loss_of_power(keeping):
    keeping.slave.power_on(keeping.now)
    assert keeping.send(REQUEST, READ_LIMITED) == [Frame(RESPONSE, LIMITED_IS_10)]


def test_one_that_was_not_stored_is_gone_after_a_reset_of_communication(bench):
    opened(bench)
    bench.nmt(NmtCommand.RESET_COMMUNICATION)
    assert not bench.slave.listens(REQUEST)
    assert bench.dictionary.get(0x1201, 1) == INVALID


@pytest.mark.parametrize("value", [0x000, 0x601, REQUEST | EXTENDED, 1 << 20, REQUEST | DYNAMIC, RESPONSE, 0xFFFF_FFFF])
def test_a_kept_identifier_that_the_bus_could_not_have_written_gives_way_to_the_default(keeping, value):
    keeping.dictionary.stored[0x1201, 1] = value
    keeping.dictionary.stored[0x1201, 2] = RESPONSE
    keeping.slave.power_on(keeping.now)
    values = [keeping.dictionary.get(0x1201, sub) for sub in (1, 2)]
    assert values == ([RESPONSE, INVALID] if value == RESPONSE else [INVALID, RESPONSE])
    assert not keeping.slave.listens(REQUEST)
    assert keeping.send(0x605, READ_LIMITED) == [Frame(0x585, LIMITED_IS_10)]


# -- other dictionaries ------------------------------------------------------------------------------------------------


def test_a_node_without_the_records_has_the_predefined_channel(make_bench, make_entries):
    bench = make_bench(entries=[entry for entry in make_entries() if entry.index not in {0x1200, 0x1201}])
    assert bench.request(*READ_LIMITED) == LIMITED_IS_10


def test_an_owner_who_needs_time_for_one_client_does_not_keep_the_other_waiting(make_entries):
    dictionary = Dictionary(make_entries(), node_id=NODE)
    channels = SdoChannels(dictionary, lambda: SdoServer(dictionary), lambda: None)
    channels.load()
    dictionary.cell(0x1201, 1).value, dictionary.cell(0x1201, 2).value = REQUEST, RESPONSE
    channels.load()

    def write(value):
        raise Postponed(MS, lambda: None)

    dictionary.on_write(0x6060, 0, write)
    slow, quick = channels.servers[0x605], channels.servers[REQUEST]
    assert channels.receive(slow, bytes((0x2F, 0x60, 0x60, 0, 8, 0, 0, 0)), 0) == []
    assert channels.receive(quick, READ_LIMITED, 0) == [Frame(RESPONSE, LIMITED_IS_10)]
    assert channels.due == MS
    assert channels.advance(MS - 1) == []
    assert channels.advance(MS) == [Frame(0x585, bytes((0x60, 0x60, 0x60, 0, 0, 0, 0, 0)))]
    assert channels.due is None
