"""Node and life guarding (CiA 301, 7.2.8.2.2): the master asks by remote frames, and the node notices when it stops asking."""

import pytest

from drive_profiles.standard.cia301 import NmtCommand, NmtState
from hil.can.frame import CAN_RTR_FLAG
from tests.plant_emulator.slave.conftest import MS, PumpedNetwork

GUARD = 0x705 | CAN_RTR_FLAG
LOST, FOUND = (0x085, b"\x30\x81\x11" + bytes(5)), (0x085, bytes(8))


def guard(bench):
    return [frame.data for frame in bench.send(GUARD, bytes(1)) if frame.can_id == 0x705]


def guarded(bench, guard_time_ms=50, factor=3):
    assert bench.write_value(0x100C, 0, guard_time_ms) is None
    assert bench.write_value(0x100D, 0, factor) is None
    return bench


@pytest.fixture
def lost(bench):
    nodes = []
    bench.slave.on_heartbeat_lost = nodes.append
    return nodes


def test_the_answer_is_the_state_and_a_bit_that_alternates(bench):
    """CiA 301, 7.2.8.3.2.1: t in bit 7, state in bits 6 to 0; the first answer after the boot-up message has t = 0."""
    transcript = [(NmtCommand.ENTER_PRE_OPERATIONAL, "7f ff"), (NmtCommand.START, "05 85"), (NmtCommand.STOP, "04 84 04")]
    for command, answers in transcript:
        bench.nmt(command)
        for expected in bytes.fromhex(answers):
            assert bench.send(GUARD, bytes(1)) == [(0x705, bytes((expected,)))]


@pytest.mark.parametrize("command", [NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION])
def test_the_bit_begins_anew_with_a_reset(bench, command):
    assert guard(bench) == [b"\x7f"]
    bench.nmt(command)
    assert guard(bench) == [b"\x7f"]


@pytest.mark.parametrize("data", [b"", bytes(1), bytes(8)])
def test_the_length_of_a_request_says_nothing(bench, data):
    assert bench.send(GUARD, data) == [(0x705, b"\x7f")]


def test_requests_to_other_nodes_and_before_power_on_are_not_answered(bench, make_bench):
    assert bench.send(0x706 | CAN_RTR_FLAG) == []
    assert make_bench(power=False).send(GUARD) == []


def test_a_node_that_sends_heartbeats_is_not_guarded(bench, lost):
    guarded(bench)
    guard(bench)
    bench.write_value(0x1017, 0, 1000)
    assert guard(bench) == []
    assert [frame for _, frame in bench.wait(1000)] == [(0x705, b"\x7f")]
    assert lost == []
    bench.write_value(0x1017, 0, 0)
    assert guard(bench) == [b"\xff"]


def test_heartbeats_end_a_life_guarding_error(bench, lost):
    guarded(bench)
    guard(bench)
    bench.wait(150)
    assert bench.slave.emergencies.causes == ("life guarding",)
    frames = bench.send(0x605, b"\x2b\x17\x10\x00\xe8\x03\0\0")
    assert FOUND in frames
    assert bench.slave.emergencies.causes == ()


# -- life guarding -----------------------------------------------------------------------------------------------------


def test_life_guarding_begins_with_the_first_request(bench, lost):
    guarded(bench)
    assert bench.wait(10_000) == []
    guard(bench)
    assert bench.slave.due == bench.now + 150 * MS
    assert bench.wait(149) == []
    assert [frame for _, frame in bench.wait(1)] == [LOST]
    assert lost == [0]
    assert bench.wait(10_000) == []


def test_requests_in_time_keep_it_quiet(bench, lost):
    guarded(bench)
    for _ in range(5):
        guard(bench)
        assert bench.wait(149) == []
    assert lost == []


def test_the_next_request_ends_the_error_and_begins_the_life_time_anew(bench, lost):
    guarded(bench)
    guard(bench)
    bench.wait(200)
    assert bench.send(GUARD) == [FOUND, (0x705, b"\xff")]
    bench.wait(150)
    assert lost == [0, 0]


def test_a_request_that_comes_too_late_is_lost_first_although_nobody_called_in_between(bench, lost):
    guarded(bench)
    guard(bench)
    bench.now += 150 * MS
    assert bench.send(GUARD) == [LOST, FOUND, (0x705, b"\xff")]
    assert lost == [0]


@pytest.mark.parametrize(("guard_time_ms", "factor"), [(0, 3), (50, 0), (0, 0)])
def test_without_a_time_or_a_factor_nothing_is_missed(bench, lost, guard_time_ms, factor):
    guarded(bench, guard_time_ms, factor)
    assert guard(bench) == [b"\x7f"]
    assert bench.wait(100_000) == []
    assert lost == []


def test_a_change_of_the_time_waits_for_a_first_request_anew(bench, lost):
    guarded(bench)
    guard(bench)
    bench.wait(150)
    assert lost == [0]
    bench.write_value(0x100C, 0, 100)
    assert bench.slave.emergencies.causes == ()
    bench.wait(1000)
    assert lost == [0]
    guard(bench)
    bench.wait(299)
    assert lost == [0]
    bench.wait(1)
    assert lost == [0, 0]


@pytest.mark.parametrize("command", [NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION])
def test_a_reset_ends_it(bench, lost, command):
    guarded(bench)
    guard(bench)
    bench.nmt(command)
    assert bench.wait(1000) == []
    assert lost == []


@pytest.mark.parametrize(
    ("behaviour", "before", "after"),
    [
        (0, NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL),
        (1, NmtState.OPERATIONAL, NmtState.OPERATIONAL),
        (2, NmtState.OPERATIONAL, NmtState.STOPPED),
        (0, NmtState.PRE_OPERATIONAL, NmtState.PRE_OPERATIONAL),
        (2, NmtState.PRE_OPERATIONAL, NmtState.STOPPED),
        (0, NmtState.STOPPED, NmtState.STOPPED),
        (2, NmtState.STOPPED, NmtState.STOPPED),
    ],
)
def test_a_lost_master_leads_where_1029h_says(bench, lost, behaviour, before, after):
    bench.write_value(0x1029, 1, behaviour)
    guarded(bench)
    commands = {NmtState.OPERATIONAL: NmtCommand.START, NmtState.STOPPED: NmtCommand.STOP}
    if before in commands:
        bench.nmt(commands[before])
    guard(bench)
    bench.wait(150)
    assert lost == [0]
    assert bench.slave.nmt_state is after


def test_stored_times_are_in_force_after_a_reset(bench, lost):
    guarded(bench)
    bench.dictionary.stored = {(0x100C, 0): 20, (0x100D, 0): 2}
    bench.nmt(NmtCommand.RESET_COMMUNICATION)
    guard(bench)
    bench.wait(39)
    assert lost == []
    bench.wait(1)
    assert lost == [0]


def test_a_stranger_hears_the_answers(stranger, bench):
    network = stranger.network
    assert isinstance(network, PumpedNetwork)
    heard = []
    network.subscribe(0x705, lambda can_id, data, time: heard.append(bytes(data)))
    for _ in range(3):
        network.send_message(0x705, b"", remote=True)
    assert heard == [b"\x7f", b"\xff", b"\x7f"]
    assert stranger.nmt.state == "PRE-OPERATIONAL"
    bench.start()
    network.send_message(0x705, b"", remote=True)
    assert stranger.nmt.state == "OPERATIONAL"
