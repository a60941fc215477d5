"""Remote requests: which TPDO answers, when, and with the values of which instant (CiA 301, 7.2.2.3 and 7.5.2.37)."""

import struct

import pytest

from drive_profiles.standard.cia301 import NmtCommand
from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from plant_emulator.slave.objects import PdoDefault

MS = 1_000_000
INVALID, NO_RTR = 0x80000000, 0x40000000
STATUS = ((0x6041, 0, 16),)


def status(value):
    return (0x185, struct.pack("<H", value))


def ask(bench, can_id=0x185, length=0):
    return bench.send(can_id | CAN_RTR_FLAG, bytes(length))


@pytest.fixture
def asked(make_bench):
    """A running node whose TPDO 1 has some transmission type."""

    def make(transmission_type, **setting):
        bench = make_bench(tpdos=[PdoDefault(STATUS, transmission_type, **setting)])
        bench.start()
        return bench

    return make


def test_type_253_goes_only_when_it_is_asked_for_with_the_values_of_that_instant(asked):
    bench = asked(253)
    bench.dictionary.set(0x6041, 0, 1)
    assert bench.slave.advance(bench.now) == []
    assert bench.sync() == []
    assert not bench.slave.waits_for_changes
    for value in (2, 3, 3):
        bench.dictionary.set(0x6041, 0, value)
        assert ask(bench) == [status(value)]


def test_type_252_is_sampled_at_sync_and_goes_when_it_is_asked_for(asked):
    bench = asked(252)
    assert ask(bench) == []  # nothing has been sampled
    bench.dictionary.set(0x6041, 0, 1)
    assert bench.sync() == []
    bench.dictionary.set(0x6041, 0, 2)
    assert ask(bench) == [status(1)]
    assert ask(bench) == [status(1)]
    assert bench.sync() == []
    assert ask(bench) == [status(2)]


def test_what_was_sampled_does_not_outlive_operational(asked):
    bench = asked(252)
    bench.sync()
    bench.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert ask(bench) == []
    bench.start()
    assert ask(bench) == []


@pytest.mark.parametrize("transmission_type", [0, 1, 3, 240])
def test_a_synchronous_pdo_answers_beside_its_own_frames(asked, transmission_type):
    bench, other = asked(transmission_type), asked(transmission_type)
    frames = []
    for value in (1, 1, 2, 3, 4, 4):
        for node in (bench, other):
            node.dictionary.set(0x6041, 0, value)
        frames.append(bench.sync())
        assert frames[-1] == other.sync()
        assert ask(bench) == [status(value)]


@pytest.mark.parametrize("transmission_type", [254, 255])
def test_an_event_driven_pdo_answers_with_or_without_a_change(asked, transmission_type):
    bench = asked(transmission_type)
    assert ask(bench) == [status(0)]
    bench.dictionary.set(0x6041, 0, 5)
    assert ask(bench) == [status(5)]
    assert bench.slave.advance(bench.now) == []


def test_the_answer_of_an_event_driven_pdo_keeps_the_inhibit_time(asked):
    bench = asked(255, inhibit_time=50)
    assert ask(bench) == []
    assert bench.slave.due == 5 * MS
    assert ask(bench) == []
    assert bench.wait(20) == [(5 * MS, status(0))]
    assert ask(bench) == [status(0)]


def test_the_event_timer_begins_anew_with_an_answer(asked):
    bench = asked(255, event_timer_ms=10)
    bench.wait(4)
    assert ask(bench) == [status(0)]
    assert bench.wait(15) == [(14 * MS, status(0))]


def test_the_length_of_the_request_is_not_looked_at(asked):
    for length in range(9):
        assert ask(asked(253), length=length) == [status(0)]


@pytest.mark.parametrize("transmission_type", [0, 1, 252, 253, 254, 255])
def test_with_bit_30_no_request_is_answered(asked, transmission_type):
    bench = asked(transmission_type)
    assert bench.write_value(0x1800, 1, 0x185 | NO_RTR) is None
    bench.sync()
    assert ask(bench) == []
    assert not bench.slave.listens(0x185 | CAN_RTR_FLAG)
    assert bench.write_value(0x1800, 1, 0x185) is None  # it may change while the PDO exists
    bench.sync()
    assert ask(bench) == [status(0)]


@pytest.mark.parametrize("command", [NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL, NmtCommand.RESET_NODE])
def test_requests_are_answered_in_operational_only(asked, command):
    bench = asked(253)
    bench.nmt(command)
    assert ask(bench) == []


def test_a_pdo_that_does_not_exist_or_is_empty_answers_nothing(asked):
    bench = asked(253)
    assert ask(bench, 0x285) == []
    bench.write_value(0x1800, 1, 0x185 | INVALID)
    assert ask(bench) == []


@pytest.mark.parametrize("flag", [0, CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_EFF_FLAG | CAN_RTR_FLAG, CAN_ERR_FLAG | CAN_RTR_FLAG])
def test_only_a_remote_frame_of_11_bits_is_a_request(asked, flag):
    assert asked(253).send(0x185 | flag) == []


def test_two_pdos_of_one_identifier_both_answer(make_bench):
    bench = make_bench(tpdos=[PdoDefault(STATUS, 253), PdoDefault(((0x6077, 0, 16),), 253, is_valid=False)])
    bench.write_value(0x1801, 1, 0x185)
    bench.start()
    bench.dictionary.set(0x6077, 0, -1)
    assert ask(bench) == [status(0), (0x185, b"\xff\xff")]


def test_a_stranger_asks_for_a_pdo(stranger, bench):
    pdo = stranger.tpdo[2]
    stranger.tpdo.read()
    pdo.clear()
    pdo.add_variable("Position")
    pdo.trans_type, pdo.enabled, pdo.rtr_allowed = 253, True, True
    pdo.save()
    stranger.nmt.state = "OPERATIONAL"
    bench.dictionary.set(0x6064, 0, -77)
    pdo.remote_request()
    assert pdo["Position"].raw == -77
