"""LSS: a node is found by its identity and given a node-ID and a bit rate (CiA 305), by raw frames and by a stranger."""

import struct
from types import SimpleNamespace

import canopen.lss
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_profiles.standard.cia301 import DataType, NmtCommand, NmtState
from drive_profiles.standard.cia305 import BIT_TIMINGS, UNCONFIGURED
from plant_emulator.slave.dictionary import Access, Dictionary, Entry
from plant_emulator.slave.lss import LssSlave, LssState
from plant_emulator.slave.objects import communication_entries
from plant_emulator.slave.store import store_entries
from tests.plant_emulator.slave.conftest import NODE, PumpedNetwork, device_entries

ADDRESS = (0x1234, 0x402, 0x10001, 7)
REQUEST, RESPONSE = 0x7E5, 0x7E4


def lss_entries(synchronous):
    vendor, product, revision, serial = ADDRESS
    own = communication_entries(
        device_type=0x192, name="x", vendor_id=vendor, product_code=product, revision=revision, serial_number=serial
    )
    present = {(entry.index, entry.subindex) for entry in own}
    return [*own, *(e for e in device_entries(**synchronous) if (e.index, e.subindex) not in present), *store_entries()]


@pytest.fixture
def make(make_bench, synchronous):
    return lambda node_id=NODE, **slave: make_bench(node_id=node_id, entries=lss_entries(synchronous), slave=slave)


@pytest.fixture
def bench(make):
    return make()


@pytest.fixture
def new(make):
    """A node as it leaves the factory: without a node-ID."""
    return make(UNCONFIGURED)


def ask(bench, *data):
    """Send a request, padded to 8 bytes; give all frames that come."""
    return bench.send(REQUEST, bytes(data).ljust(8, b"\0"))


def answer(*data):
    return [(RESPONSE, bytes(data).ljust(8, b"\0"))]


def number(service, value):
    return service, *struct.pack("<I", value)


def select(bench, address=ADDRESS):
    return [ask(bench, *number(0x40 + part, value)) for part, value in enumerate(address)]


def switch(bench, mode):
    return ask(bench, 0x04, mode)


@pytest.mark.parametrize(
    ("command", "hears"),
    [(None, True), (NmtCommand.STOP, True), (NmtCommand.ENTER_PRE_OPERATIONAL, True), (NmtCommand.START, False)],
)
def test_every_nmt_state_but_operational_hears_lss(bench, command, hears):
    if command is not None:
        bench.send(0x000, bytes((command, NODE)))
    answers = select(bench)
    assert answers == [[], [], [], answer(0x44) if hears else []]


# -- switch state (CiA 305, 3.9) ---------------------------------------------------------------------------------------


def test_the_state_is_switched_for_all_in_silence(bench):
    assert bench.slave.lss.state is LssState.WAITING
    for mode, state in ((1, LssState.CONFIGURATION), (2, LssState.CONFIGURATION), (0, LssState.WAITING), (0, LssState.WAITING)):
        assert switch(bench, mode) == []
        assert bench.slave.lss.state is state


def test_the_one_with_the_whole_address_is_switched_and_says_so(bench):
    assert select(bench) == [[], [], [], answer(0x44)]
    assert bench.slave.lss.state is LssState.CONFIGURATION


@pytest.mark.parametrize("part", range(4))
def test_an_address_that_differs_in_one_part_switches_nobody(bench, part):
    address = [value + (i == part) for i, value in enumerate(ADDRESS)]
    assert select(bench, address) == [[], [], [], []]
    assert bench.slave.lss.state is LssState.WAITING


@pytest.mark.parametrize("order", [(0x41, 0x42, 0x43), (0x40, 0x42, 0x43), (0x40, 0x41, 0x43), (0x40, 0x41, 0x41, 0x42, 0x43)])
def test_parts_out_of_their_order_switch_nobody(bench, order):
    for service in order:
        assert ask(bench, *number(service, ADDRESS[service - 0x40])) == []
    assert bench.slave.lss.state is LssState.WAITING
    assert select(bench)[-1] == answer(0x44)


def test_a_switch_to_waiting_forgets_a_selection_that_has_begun(bench):
    for service in (0x40, 0x41, 0x42):
        ask(bench, *number(service, ADDRESS[service - 0x40]))
    switch(bench, 0)
    assert ask(bench, *number(0x43, ADDRESS[3])) == []


# -- configuration (CiA 305, 3.10) -------------------------------------------------------------------------------------


def test_configuration_and_questions_are_for_the_configuration_state(bench):
    bit_rates = []
    bench.slave.lss.on_bit_rate = lambda *told: bit_rates.append(told)
    for service in (0x11, 0x13, 0x15, 0x17, 0x5A, 0x5B, 0x5C, 0x5D, 0x5E):
        assert ask(bench, service, 9, 0) == []
    assert bench.slave.lss.pending == NODE
    assert bit_rates == []
    switch(bench, 1)
    for service in (0x40, 0x41, 0x42, 0x43, 0x51):
        assert ask(bench, *number(service, 0)) == []


@pytest.mark.parametrize(("node_id", "error"), [(1, 0), (127, 0), (255, 0), (0, 1), (128, 1), (254, 1)])
def test_a_node_id_is_taken_or_refused(bench, node_id, error):
    switch(bench, 1)
    assert ask(bench, 0x11, node_id) == answer(0x11, error)
    assert bench.slave.lss.pending == (NODE if error else node_id)
    assert ask(bench, 0x5E) == answer(0x5E, NODE)  # the one that is in force


@pytest.mark.parametrize("index", range(11))
def test_a_bit_timing_of_the_standard_table_is_taken_and_activated(bench, index):
    told = []
    bench.slave.lss.on_bit_rate = lambda *what: told.append(what)
    switch(bench, 1)
    assert ask(bench, 0x15, 0x10, 0x27) == []
    assert told == []  # nothing has been configured yet
    assert ask(bench, 0x13, 0, index) == answer(0x13, 0 if index in BIT_TIMINGS else 1)
    assert ask(bench, 0x15, 0x10, 0x27) == []
    assert told == ([(BIT_TIMINGS[index], 10_000)] if index in BIT_TIMINGS else [])


def test_a_bit_timing_of_another_table_is_refused(bench):
    switch(bench, 1)
    assert ask(bench, 0x13, 1, 0) == answer(0x13, 1)
    ask(bench, 0x13, 0, 2)
    ask(bench, 0x15, 0, 0)  # whom nobody listens to, nothing happens
    assert bench.slave.lss.bit_rate == 500_000


def test_a_memory_that_fails_is_told(bench):
    switch(bench, 1)
    ask(bench, 0x11, 9)
    bench.slave.store.fails = True
    assert ask(bench, 0x17) == answer(0x17, 2)
    assert bench.slave.lss.stored == NODE
    bench.slave.store.fails = False
    assert ask(bench, 0x17) == answer(0x17, 0)
    assert bench.slave.lss.stored == 9


# -- questions (CiA 305, 3.11) -----------------------------------------------------------------------------------------


def test_the_address_and_the_node_id_are_told(bench):
    switch(bench, 1)
    for service, value in zip((0x5A, 0x5B, 0x5C, 0x5D), ADDRESS, strict=True):
        assert ask(bench, service) == answer(*number(service, value))
    assert ask(bench, 0x5E) == answer(0x5E, NODE)


def identify(bench, vendor, product, revisions, serials):
    values = (vendor, product, *revisions, *serials)
    return [ask(bench, *number(0x46 + i, value)) for i, value in enumerate(values)][-1]


@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize(
    ("asked", "is_meant"),
    [
        ((0x1234, 0x402, (0x10001, 0x10001), (7, 7)), True),
        ((0x1234, 0x402, (0, 0xFFFFFFFF), (0, 0xFFFFFFFF)), True),
        ((0x1235, 0x402, (0, 0xFFFFFFFF), (0, 0xFFFFFFFF)), False),
        ((0x1234, 0x403, (0, 0xFFFFFFFF), (0, 0xFFFFFFFF)), False),
        ((0x1234, 0x402, (0x10002, 0xFFFFFFFF), (0, 0xFFFFFFFF)), False),
        ((0x1234, 0x402, (0, 0x10000), (0, 0xFFFFFFFF)), False),
        ((0x1234, 0x402, (0, 0xFFFFFFFF), (8, 9)), False),
        ((0x1234, 0x402, (0, 0xFFFFFFFF), (0, 6)), False),
    ],
)
def test_who_lies_in_the_range_identifies_himself(bench, mode, asked, is_meant):
    switch(bench, mode)
    assert identify(bench, *asked) == (answer(0x4F) if is_meant else [])


def test_only_a_node_without_a_node_id_says_that_it_has_none(bench, new):
    assert ask(bench, 0x4C) == []
    assert ask(new, 0x4C) == answer(0x50)


# -- a node without a node-ID ------------------------------------------------------------------------------------------


def test_an_unconfigured_node_hears_lss_and_nothing_else(new):
    assert new.boot == []
    assert new.slave.nmt_state is NmtState.INITIALISING
    assert new.slave.node_id == UNCONFIGURED
    assert [can_id for can_id in range(0x800) if new.slave.listens(can_id)] == [REQUEST]
    assert new.slave.due is None
    new.slave.emergencies.raise_cause("hot", 0x4210)
    assert new.slave.take_frames() == []
    assert new.nmt(NmtCommand.START, 0) == []
    assert new.wait(1000) == []


def test_before_power_on_not_even_lss_is_heard(make_bench):
    assert make_bench(node_id=UNCONFIGURED, power=False).send(REQUEST, b"\x4c" + bytes(7)) == []


def test_a_node_that_is_given_its_first_node_id_boots_with_it(new):
    """CiA 305, 3.8: the golden transcript of the usual way."""
    resets = []
    new.slave.on_reset = resets.append
    assert switch(new, 1) == []
    assert ask(new, 0x5E) == answer(0x5E, 0xFF)
    assert ask(new, 0x11, 0x05) == answer(0x11, 0)
    assert ask(new, 0x4C) == []  # it is about to have one
    assert ask(new, 0x17) == answer(0x17, 0)
    assert switch(new, 0) == [(0x705, b"\x00")]
    assert [kind.value for kind in resets] == ["communication"]
    assert new.slave.nmt_state is NmtState.PRE_OPERATIONAL
    assert new.read(0x1014) == b"\x85\0\0\0"
    assert new.slave.power_on(new.now) == [(0x705, b"\x00")]


def test_a_switch_to_waiting_without_a_node_id_starts_nothing(new):
    switch(new, 1)
    assert switch(new, 0) == []
    assert new.slave.nmt_state is NmtState.INITIALISING


def test_what_was_not_stored_is_forgotten_with_the_power(new):
    switch(new, 1)
    ask(new, 0x11, NODE)
    ask(new, 0x13, 0, 3)
    switch(new, 0)
    assert new.nmt(NmtCommand.RESET_COMMUNICATION) == [(0x705, b"\x00")]
    assert new.slave.power_on(new.now) == []
    assert (new.slave.node_id, new.slave.lss.bit_rate) == (UNCONFIGURED, None)


def test_a_node_loses_its_node_id_with_the_next_reset_of_communication(bench):
    bench.write_value(0x1017, 0, 10)
    switch(bench, 1)
    ask(bench, 0x11, 255)
    assert ask(bench, 0x4C) == []
    assert bench.nmt(NmtCommand.RESET_COMMUNICATION) == []
    assert bench.slave.nmt_state is NmtState.INITIALISING
    assert bench.wait(100) == []
    assert ask(bench, 0x4C) == answer(0x50)
    assert bench.slave.power_on(bench.now) == [(0x705, b"\x00")]


# -- another node-ID ---------------------------------------------------------------------------------------------------


def rename(bench, node_id):
    switch(bench, 1)
    ask(bench, 0x11, node_id)
    ask(bench, 0x17)
    return switch(bench, 0)


def identifiers(bench, node_id):
    """Every identifier that a node of this number uses by default, seen on the bus."""
    slave = bench.slave
    assert slave.node_id == bench.dictionary.node_id == node_id
    listened = [can_id for can_id in range(0x800) if slave.listens(can_id)]
    assert listened == [0x000, 0x080, 0x100, 0x600 + node_id, REQUEST]
    assert slave.listens(0x4000_0700 + node_id)
    assert [f.can_id for f in bench.send(0x600 + node_id, b"\x40\x00\x10\0\0\0\0\0")] == [0x580 + node_id]
    slave.emergencies.raise_cause("x", 0x1000)
    assert [f.can_id for f in slave.take_frames()] == [0x080 + node_id]
    slave.emergencies.clear_cause("x")
    slave.take_frames()
    bench.nmt(NmtCommand.START, node_id)
    assert slave.listens(0x200 + node_id)
    assert [f.can_id for f in bench.sync()] == [0x180 + node_id]
    bench.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, node_id)
    return [bench.dictionary.get_int(0x1400 + i, 1) for i in range(4)]


def test_another_node_id_is_in_force_with_the_reset_of_communication_and_everywhere(bench):
    assert identifiers(bench, NODE) == [0x205, 0x305, 0x80000405, 0x80000505]
    assert rename(bench, 0x42) == []
    assert identifiers(bench, NODE) == [0x205, 0x305, 0x80000405, 0x80000505]
    assert bench.nmt(NmtCommand.RESET_COMMUNICATION, 0x42) == []  # which is not yet its own
    assert bench.nmt(NmtCommand.RESET_COMMUNICATION) == [(0x742, b"\x00")]
    assert identifiers(bench, 0x42) == [0x242, 0x342, 0x80000442, 0x80000542]
    assert bench.slave.power_on(bench.now) == [(0x742, b"\x00")]


def test_stored_cob_ids_follow_the_node_id_where_they_are_its_own(bench):
    bench.write_value(0x1400 + 2, 1, 0x405)  # a PDO that the factory has switched off
    bench.write_value(0x1800, 1, 0x8000_0185)
    bench.write_value(0x1800, 1, 0x1AA)
    bench.slave.store.time_ns = 0
    assert bench.write(0x1010, 1, b"save") is None
    rename(bench, 0x42)
    bench.nmt(NmtCommand.RESET_NODE)
    values = [bench.dictionary.get(*address) for address in ((0x1014, 0), (0x1400, 1), (0x1402, 1), (0x1403, 1), (0x1800, 1))]
    assert values == [0xC2, 0x242, 0x442, 0x80000542, 0x1AA]


# -- in which NMT states -----------------------------------------------------------------------------------------------


def test_a_node_at_work_is_not_reconfigured(bench):
    switch(bench, 1)
    bench.start()
    assert bench.slave.lss.state is LssState.WAITING
    assert switch(bench, 1) == ask(bench, 0x5E) == []
    bench.nmt(NmtCommand.STOP)
    assert ask(bench, 0x5E) == []
    switch(bench, 1)
    assert ask(bench, 0x5E) == answer(0x5E, NODE)


# -- fast scan ---------------------------------------------------------------------------------------------------------


def scan(bench, value, bit, part, following):
    return ask(bench, 0x51, *struct.pack("<I", value), bit, part, following)


def test_a_fast_scan_finds_the_address_bit_by_bit(new):
    """CiA 305, LSS fastscan: each 0 that is confirmed is a 0; at the end of a part the slave goes on to the next."""
    assert scan(new, 0, 0x80, 0, 0) == answer(0x4F)
    found = []
    for part in range(4):
        value = 0
        for bit in range(31, -1, -1):
            if not scan(new, value, bit, part, part):
                value |= 1 << bit
        found.append(value)
        assert scan(new, value, 0, part, (part + 1) % 4) == answer(0x4F)
    assert tuple(found) == ADDRESS
    assert new.slave.lss.state is LssState.CONFIGURATION


def test_a_fast_scan_of_a_configured_node_is_not_answered(bench):
    assert scan(bench, 0, 0x80, 0, 0) == []


@pytest.mark.parametrize("request_of", [(0, 32, 0, 0), (0, 31, 0, 4), (0, 31, 1, 0), (0xFFFFFFFF, 31, 0, 0), (0, 0x81, 0, 0)])
def test_a_scan_that_does_not_fit_is_not_answered(new, request_of):
    scan(new, 0, 0x80, 0, 0)
    assert scan(new, *request_of) == []
    assert scan(new, 0, 31, 0, 0) == answer(0x4F)


# -- whatever comes ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("data", [b"", b"\x04\x01", bytes(7)])
def test_a_frame_that_is_not_8_bytes_long_is_no_lss(bench, data):
    assert bench.send(REQUEST, data) == []
    assert bench.slave.lss.state is LssState.WAITING


requests = st.builds(
    lambda service, value, rest: bytes((service, *struct.pack("<I", value), *rest)),
    st.sampled_from([0x04, 0x11, 0x13, 0x15, 0x17, *range(0x40, 0x53), *range(0x5A, 0x60)]) | st.integers(0, 255),
    st.sampled_from([0, 1, 5, 255, *ADDRESS]) | st.integers(0, 2**32 - 1),
    st.tuples(st.sampled_from([0, 31, 128]), st.integers(0, 5), st.integers(0, 5)),
)


@settings(max_examples=60)
@given(st.sampled_from([NODE, UNCONFIGURED]), st.lists(requests | st.binary(max_size=8), max_size=60))
def test_any_requests_get_at_most_one_answer_and_the_node_ids_stay_possible(make_bench, node_id, datas):
    bench = make_bench(node_id=node_id, entries=communication_entries(device_type=0, name="x", vendor_id=1))
    for data in datas:
        frames = bench.send(REQUEST, data)
        assert len(frames) <= 1
        assert all(len(f.data) == 8 for f in frames if f.can_id == RESPONSE)
        lss = bench.slave.lss
        assert {lss.stored, lss.pending, lss.active} <= {*range(1, 128), UNCONFIGURED}
        assert (bench.slave.nmt_state is NmtState.INITIALISING) == (lss.active == UNCONFIGURED)
        assert len(lss._selection) < 4
        assert len(lss._identification) < 6


def test_parts_of_the_identity_that_are_not_there_are_0():
    dictionary = Dictionary([Entry(0x1018, 1, "Vendor-ID", DataType.UNSIGNED32, Access.RO, 99)])
    assert LssSlave(dictionary, 1, lambda: True, lambda: None).address == [99, 0, 0, 0]


# -- the stranger: the canopen package as LSS master -------------------------------------------------------------------


@pytest.fixture
def master(monkeypatch):
    """Gives the LSS master of the canopen package on a bench; it does not wait for what cannot come any more."""
    monkeypatch.setattr(canopen.lss, "time", SimpleNamespace(sleep=lambda seconds: None))
    monkeypatch.setattr(canopen.lss.LssMaster, "RESPONSE_TIMEOUT", 0)
    return lambda bench: PumpedNetwork(bench).lss


def test_a_stranger_scans_configures_and_stores(new, master):
    lss = master(new)
    assert lss.fast_scan() == (True, list(ADDRESS))
    assert [lss.inquire_lss_address(service) for service in range(0x5A, 0x5E)] == list(ADDRESS)
    assert lss.inquire_node_id() == 255
    lss.configure_node_id(NODE)
    lss.configure_bit_timing(2)
    lss.activate_bit_timing(100)
    lss.store_configuration()
    lss.send_switch_state_global(lss.WAITING_STATE)
    assert new.slave.node_id == NODE
    assert new.slave.nmt_state is NmtState.PRE_OPERATIONAL
    assert lss.fast_scan() == (False, None)


def test_a_stranger_selects_by_address(bench, master):
    lss = master(bench)
    assert lss.send_switch_state_selective(*ADDRESS)
    with pytest.raises(canopen.lss.LssError, match="LSS Error: 1"):
        lss.configure_node_id(0)
    with pytest.raises(canopen.lss.LssError, match="LSS Error: 1"):
        lss.configure_bit_timing(5)
    lss.configure_node_id(9)
    lss.send_switch_state_global(lss.WAITING_STATE)
    with pytest.raises(canopen.lss.LssError, match="No LSS response"):
        lss.inquire_node_id()
