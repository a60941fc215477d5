"""The NMT automaton, state by command, and the heartbeats in both directions."""

from dataclasses import replace

import pytest

from drive_profiles.standard.cia301 import NmtCommand, NmtState, SdoAbortCode
from hil.can.frame import Frame
from plant_emulator.slave.dictionary import Dictionary, ResetKind
from plant_emulator.slave.nmt import SERVICES, TRANSITIONS, NmtService
from plant_emulator.slave.node import Slave

NODE = 5
BOOT = (0x705, b"\x00")
MS = 1_000_000
PRE, OP, STOP, INIT = NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL, NmtState.STOPPED, NmtState.INITIALISING
LISTENING = (PRE, OP, STOP)
ENTRY = {PRE: NmtCommand.ENTER_PRE_OPERATIONAL, OP: NmtCommand.START, STOP: NmtCommand.STOP}
RESETS = {NmtCommand.RESET_NODE: ResetKind.NODE, NmtCommand.RESET_COMMUNICATION: ResetKind.COMMUNICATION}


@pytest.mark.parametrize("power", [False, True])
def test_power_on_sends_the_boot_up_message_and_leads_to_pre_operational(make_bench, power):
    bench = make_bench(power=power)
    if not power:
        assert bench.slave.nmt_state is INIT
        assert bench.slave.due is None
        assert bench.slave.advance(10**12) == []
        bench.now = 10**12
        bench.boot = bench.slave.power_on(bench.now)
    assert bench.boot == [BOOT]
    assert bench.slave.nmt_state is PRE


def test_before_power_on_nothing_is_heard(make_bench):
    bench = make_bench(power=False)
    assert bench.start() == []
    assert bench.sync() == []
    assert bench.request(0x40, 0x00, 0x10, 0) is None
    assert bench.slave.nmt_state is INIT


@pytest.mark.parametrize("address", [NODE, 0, NODE + 1])
@pytest.mark.parametrize("command", list(NmtCommand))
@pytest.mark.parametrize("state", list(NmtState))
def test_each_command_in_each_state_leads_where_the_standard_says(make_bench, state, command, address):
    bench = make_bench(power=state is not INIT)
    if state is not INIT:
        bench.nmt(ENTRY[state])
    assert bench.slave.nmt_state is state
    frames = bench.nmt(command, address)
    if address == NODE + 1 or state is INIT:
        assert frames == []
        assert bench.slave.nmt_state is state
    elif command in RESETS:
        assert frames == [BOOT]
        assert bench.slave.nmt_state is PRE
    else:
        assert frames == []
        assert bench.slave.nmt_state is next(s for s, c in ENTRY.items() if c is command)


def test_the_table_has_a_row_for_each_command_in_each_listening_state():
    assert set(TRANSITIONS) == {(state, command) for state in LISTENING for command in NmtCommand}
    assert NmtService.PDO in SERVICES[OP]
    assert all(NmtService.PDO not in SERVICES[state] for state in NmtState if state is not OP)


@pytest.mark.parametrize("data", [b"", b"\x01", b"\x01\x05\x00", b"\x00\x05", b"\x03\x05", b"\xff\x00"])
def test_a_malformed_or_unknown_command_is_ignored(bench, data):
    assert bench.send(0x000, data) == []
    assert bench.slave.nmt_state is PRE


@pytest.mark.parametrize("state", LISTENING)
def test_the_state_gates_the_services(bench, state):
    bench.nmt(ENTRY[state])
    syncs = []
    bench.slave.on_sync = syncs.append
    tpdos = bench.sync()
    bench.send(0x205, b"\x0f\x00\x01\x00\x00\x00")
    bench.sync()
    answered = bench.request(0x40, 0x00, 0x10, 0) is not None
    bench.slave.emergencies.raise_cause("test", 0x5000)
    emergencies = bench.slave.take_frames()
    assert answered is (state is not STOP)
    assert bool(emergencies) is (state is not STOP)
    assert len(syncs) == (0 if state is STOP else 2)
    assert bool(tpdos) is (state is OP)
    assert (bench.dictionary.get(0x6040) == 15) is (state is OP)


@pytest.mark.parametrize("state", LISTENING)
@pytest.mark.parametrize("command", list(RESETS))
def test_the_owner_sees_every_change_and_every_reset(bench, state, command):
    bench.nmt(ENTRY[state])
    seen = []
    bench.slave.on_nmt = lambda old, new: seen.append((old, new))
    bench.slave.on_reset = seen.append
    bench.nmt(command)
    assert seen == [(state, INIT), RESETS[command], (INIT, PRE)]
    seen.clear()
    bench.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert seen == []


def test_reset_communication_keeps_the_application_and_reset_node_does_not(bench):
    bench.write_value(0x1017, 0, 500)
    bench.write_value(0x2000, 0, 77)
    bench.nmt(NmtCommand.RESET_COMMUNICATION)
    assert (bench.dictionary.get(0x1017), bench.dictionary.get(0x2000)) == (0, 77)
    bench.nmt(NmtCommand.RESET_NODE)
    assert bench.dictionary.get(0x2000) == 10


def test_a_reset_ends_a_transfer_and_the_pdos_begin_anew(running):
    running.request(0x40, 0x08, 0x10, 0)
    running.send(0x205, b"\x0f\x00\x01\x00\x00\x00")
    running.nmt(NmtCommand.RESET_COMMUNICATION)
    assert running.request(0x60)[0] == 0x80
    running.start()
    running.sync()
    assert running.dictionary.get(0x6040) == 0


def test_stopping_ends_a_transfer_in_silence(running):
    running.request(0x40, 0x08, 0x10, 0)
    running.nmt(NmtCommand.STOP)
    assert running.wait(60_000) == []


def test_a_reset_before_the_boot_up_message_was_taken_sends_one_of_its_own(bench):
    """CiA 301, 7.3.2.2: each pass through initialising has its boot-up message, however fast they follow each other."""
    bench.slave.emergencies.raise_cause("hot", 0x4210)
    for _ in range(3):
        assert [f for f in bench.nmt(NmtCommand.RESET_COMMUNICATION) if f.can_id == 0x705] == [BOOT]
    assert bench.slave.take_frames() == []


@pytest.mark.parametrize("command", list(RESETS))
def test_a_reset_reloads_what_was_stored(bench, command):
    bench.dictionary.stored = {(0x1017, 0): 10, (0x1016, 1): 0x0001_0064}
    bench.nmt(command)
    assert [time for time, _ in bench.wait(20)] == [10 * MS, 20 * MS]
    bench.send(0x701, b"\x05")
    assert bench.slave.listens(0x701)


# Heartbeat producer


@pytest.mark.parametrize("offset_ms", [0, 0.3, 9.999999, 10, 25])
def test_heartbeats_come_at_whole_multiples_of_the_period(bench, offset_ms):
    bench.wait(offset_ms)
    start = bench.now
    bench.write_value(0x1017, 0, 10)
    times = [time for time, frame in bench.wait(35) if frame == (0x705, b"\x7f")]
    first = (start // (10 * MS) + 1) * 10 * MS
    assert times == [first, first + 10 * MS, first + 20 * MS] + ([first + 30 * MS] if first + 30 * MS <= bench.now else [])


def test_a_caller_who_comes_late_gets_one_heartbeat_and_the_next_at_a_multiple(bench):
    bench.write_value(0x1017, 0, 10)
    assert bench.slave.advance(57 * MS) == [(0x705, b"\x7f")]
    assert bench.slave.due == 60 * MS


def test_a_passed_deadline_is_served_before_the_frame(bench):
    bench.write_value(0x1017, 0, 10)
    bench.now = 15 * MS
    frames = bench.send(0x605, bytes((0x40, 0x00, 0x10, 0, 0, 0, 0, 0)))
    assert [frame.can_id for frame in frames] == [0x705, 0x585]


@pytest.mark.parametrize("state", LISTENING)
def test_the_heartbeat_carries_the_state_in_every_state(bench, state):
    bench.write_value(0x1017, 0, 10)
    bench.nmt(ENTRY[state])
    assert [frame for _, frame in bench.wait(10) if frame.can_id == 0x705] == [(0x705, bytes((state,)))]


def test_heartbeats_end_with_period_0_and_with_the_reset(bench):
    bench.write_value(0x1017, 0, 10)
    bench.write_value(0x1017, 0, 0)
    assert bench.wait(100) == []
    bench.write_value(0x1017, 0, 10)
    assert bench.nmt(NmtCommand.RESET_COMMUNICATION) == [BOOT]
    assert bench.wait(100) == []


def test_a_default_period_starts_at_power_on_and_after_a_reset(make_entries):
    entries = [e for e in make_entries() if e.index != 0x1017]
    heartbeat = next(e for e in make_entries() if e.index == 0x1017)
    slave = Slave(NODE, Dictionary([*entries, replace(heartbeat, default=10)]))
    slave.power_on(3 * MS)
    assert slave.due == 10 * MS
    slave.receive(Frame(0, b"\x82\x00"), 14 * MS)
    assert slave.due == 20 * MS


# Heartbeat consumer


def watch(bench, node_id=1, period_ms=100, subindex=1):
    return bench.write_value(0x1016, subindex, node_id << 16 | period_ms)


@pytest.fixture
def lost(bench):
    nodes = []
    bench.slave.on_heartbeat_lost = nodes.append
    return nodes


def test_a_watch_starts_with_the_first_heartbeat(bench, lost):
    assert watch(bench) is None
    assert bench.wait(1000) == []
    bench.send(0x701, b"\x05")
    assert bench.slave.due == bench.now + 100 * MS
    bench.wait(99)
    assert lost == []
    bench.wait(1)
    assert lost == [1]


def test_heartbeats_in_time_keep_the_watch_quiet(bench, lost):
    watch(bench)
    for _ in range(10):
        bench.send(0x701, b"\x05")
        bench.wait(99)
    assert lost == []


def test_a_lost_node_is_told_once_and_comes_back(bench, lost):
    watch(bench)
    bench.send(0x701, b"\x05")
    frames = [frame for _, frame in bench.wait(1000)]
    assert frames == [(0x085, b"\x30\x81\x11" + bytes(5))]
    assert lost == [1]
    assert bench.send(0x701, b"\x05") == [(0x085, bytes(8))]
    bench.wait(100)
    assert lost == [1, 1]


def test_a_heartbeat_that_comes_too_late_is_lost_first_although_nobody_called_in_between(bench, lost):
    watch(bench)
    bench.send(0x701, b"\x05")
    bench.now += 100 * MS
    frames = bench.send(0x701, b"\x05")
    assert lost == [1]
    assert [frame.data[:2] for frame in frames] == [b"\x30\x81", b"\x00\x00"]


@pytest.mark.parametrize("data", [b"", b"\x05\x05", b"\x00", b"\x80"])
def test_a_boot_up_message_or_a_malformed_one_is_no_heartbeat(bench, lost, data):
    watch(bench)
    bench.send(0x701, data)
    assert bench.wait(1000) == []
    bench.send(0x701, b"\x05")
    bench.wait(50)
    bench.send(0x701, data)
    bench.wait(50)
    assert lost == [1]


def test_other_nodes_do_not_feed_a_watch(bench, lost):
    watch(bench)
    bench.send(0x701, b"\x05")
    bench.wait(50)
    bench.send(0x702, b"\x05")
    bench.wait(50)
    assert lost == [1]


def test_four_nodes_are_watched_each_with_its_time(bench, lost):
    for subindex in (1, 2, 3, 4):
        assert watch(bench, 10 + subindex, 100 * subindex, subindex) is None
        bench.send(0x70A + subindex, b"\x05")
    bench.wait(250)
    assert lost == [11, 12]
    bench.wait(250)
    assert lost == [11, 12, 13, 14]


def test_one_node_cannot_be_watched_twice(bench):
    assert watch(bench, 1, 100, 1) is None
    assert watch(bench, 1, 200, 2) is SdoAbortCode.PARAMETER_INCOMPATIBLE
    assert watch(bench, 1, 200, 1) is None
    assert watch(bench, 1, 0, 2) is None


def test_kept_watches_of_one_node_are_taken_once(bench, lost):
    bench.dictionary.stored = {(0x1016, 1): 0x0001_0064, (0x1016, 2): 0x0001_0032, (0x1016, 3): 0xFF02_0032}
    bench.nmt(NmtCommand.RESET_COMMUNICATION)
    assert [bench.dictionary.get(0x1016, subindex) for subindex in (1, 2, 3)] == [0x0001_0064, 0, 0]
    bench.send(0x701, b"\x05")
    bench.wait(99)
    assert lost == []
    bench.wait(1)
    assert lost == [1]


def test_writing_a_watch_again_waits_for_a_first_heartbeat_anew(bench, lost):
    watch(bench)
    bench.send(0x701, b"\x05")
    bench.wait(50)
    watch(bench)
    bench.wait(1000)
    assert lost == []
    bench.send(0x701, b"\x05")
    bench.wait(100)
    assert lost == [1]


def test_a_watch_of_the_node_itself_never_starts(bench, lost):
    """The standard does not forbid it; a node does not hear itself, and a watch begins with a first heartbeat."""
    assert watch(bench, NODE) is None
    bench.write_value(0x1017, 0, 10)
    assert len(bench.wait(1000)) == 100
    assert lost == []


def test_reserved_bits_of_a_watch_are_refused(bench):
    assert bench.write_value(0x1016, 1, 0x01010064) is SdoAbortCode.INVALID_VALUE


@pytest.mark.parametrize("value", [0x00010000, 0x00000064, 0x00800064, 0])
def test_an_entry_without_node_or_time_watches_nothing(bench, lost, value):
    watch(bench)
    bench.send(0x701, b"\x05")
    assert bench.write_value(0x1016, 1, value) is None
    assert bench.wait(1000) == []
    assert lost == []


def test_a_lost_node_that_is_no_longer_watched_is_no_error(bench, lost):
    watch(bench)
    bench.send(0x701, b"\x05")
    bench.wait(100)
    assert bench.slave.emergencies.causes == ("heartbeat 1",)
    watch(bench, 1, 0)
    assert bench.slave.emergencies.causes == ()


@pytest.mark.parametrize(("behaviour", "state"), [(0, PRE), (1, OP), (2, STOP)])
def test_a_lost_heartbeat_leads_an_operational_node_where_1029h_says(bench, lost, behaviour, state):
    assert bench.write_value(0x1029, 1, behaviour) is None
    watch(bench)
    bench.start()
    bench.send(0x701, b"\x05")
    bench.wait(100)
    assert lost == [1]
    assert bench.slave.nmt_state is state


@pytest.mark.parametrize(("behaviour", "state"), [(0, PRE), (1, PRE), (2, STOP)])
def test_a_lost_heartbeat_stops_a_pre_operational_node_where_1029h_says_so(bench, lost, behaviour, state):
    assert bench.write_value(0x1029, 1, behaviour) is None
    watch(bench)
    bench.send(0x701, b"\x05")
    bench.wait(100)
    assert bench.slave.nmt_state is state


def test_1029h_knows_three_behaviours(bench):
    assert bench.write_value(0x1029, 1, 3) is SdoAbortCode.VALUE_TOO_HIGH


def test_a_watch_works_in_the_stopped_state(bench, lost):
    watch(bench)
    bench.nmt(NmtCommand.STOP)
    bench.send(0x701, b"\x05")
    assert bench.wait(200) == []
    assert lost == [1]


# The stranger


def test_a_stranger_commands_and_awaits_the_states(stranger, bench):
    network = stranger.network
    stranger.sdo[0x1017].raw = 10
    for name in ("OPERATIONAL", "STOPPED", "PRE-OPERATIONAL"):
        stranger.nmt.state = name
        network.wait(10)
        assert stranger.nmt.state == name
    assert bench.slave.nmt_state is PRE
    heard = []
    network.subscribe(0x705, lambda can_id, data, time: heard.append(bytes(data)))
    stranger.nmt.state = "RESET"
    assert heard == [b"\x00"]
