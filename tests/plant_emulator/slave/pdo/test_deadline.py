"""The event timer of an RPDO: when its deadline starts, what ends it and who hears of it (CiA 301, 7.5.2.35)."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_profiles.standard.cia301 import NmtCommand
from plant_emulator.slave.objects import PdoDefault

MS = 1_000_000
INVALID = 0x80000000
CONTROL = ((0x6040, 0, 16),)
NO_ERROR = (0x085, bytes(8))
LATE = bytes.fromhex("5082 11")
"""Emergency 8250h with the error register's bits of communication and of any error."""


@pytest.fixture
def missing():
    return []


@pytest.fixture
def make_watching(make_bench, missing):
    """A running node whose RPDOs 1 and 2 must come every 10 and every 30 ms."""

    def make(transmission_type=255):
        rpdos = [
            PdoDefault(CONTROL, transmission_type, event_timer_ms=10),
            PdoDefault(((0x607A, 0, 32),), transmission_type, event_timer_ms=30),
        ]
        bench = make_bench(rpdos=rpdos)
        bench.slave.on_rpdo_timeout = missing.append
        bench.start()
        return bench

    return make


@pytest.fixture
def watching(make_watching):
    return make_watching()


def first(bench):
    return bench.send(0x205, bytes(2))


def second(bench):
    return bench.send(0x305, bytes(4))


def emergencies(sent):
    return [(time, frame.data[:2]) for time, frame in sent if frame.can_id == 0x085]


def test_before_the_first_frame_nothing_is_missing(watching, missing):
    assert watching.slave.due is None
    assert watching.wait(1000) == []
    assert missing == []


@pytest.mark.parametrize("transmission_type", [0, 1, 255])
def test_a_frame_that_does_not_come_in_time_is_told_once(make_watching, missing, transmission_type):
    bench = make_watching(transmission_type)
    assert first(bench) == []
    assert bench.slave.due == 10 * MS
    assert [(time, frame.can_id, frame.data[:3]) for time, frame in bench.wait(1000)] == [(10 * MS, 0x085, LATE)]
    assert missing == [1]
    assert bench.slave.emergencies.causes == ("RPDO 1 time-out",)


def test_each_frame_puts_the_deadline_off(watching):
    for _ in range(20):
        first(watching)
        assert watching.wait(9) == []
    assert emergencies(watching.wait(1000)) == [(181 * MS, b"\x50\x82")]


def test_the_next_frame_withdraws_the_emergency_and_starts_the_deadline_anew(watching, missing):
    first(watching)
    watching.wait(50)
    assert first(watching) == [NO_ERROR]
    assert emergencies(watching.wait(50)) == [(60 * MS, b"\x50\x82")]
    assert missing == [1, 1]


def test_one_pdo_that_comes_again_does_not_withdraw_the_emergency_of_another(watching, missing):
    first(watching)
    second(watching)
    assert emergencies(watching.wait(50)) == [(10 * MS, b"\x50\x82"), (30 * MS, b"\x50\x82")]
    assert missing == [1, 2]
    assert first(watching) == []
    assert watching.slave.emergencies.causes == ("RPDO 2 time-out",)
    assert second(watching) == [NO_ERROR]


def test_leaving_operational_withdraws_it_and_waits_for_a_first_frame_again(watching, missing):
    first(watching)
    second(watching)
    watching.wait(20)
    assert watching.nmt(NmtCommand.ENTER_PRE_OPERATIONAL) == [NO_ERROR]
    assert watching.wait(100) == []
    watching.start()
    assert watching.wait(100) == []
    assert missing == [1]


def test_stopped_withdraws_it_in_silence(watching):
    first(watching)
    watching.wait(20)
    assert watching.nmt(NmtCommand.STOP) == []
    assert watching.slave.emergencies.causes == ()


def test_a_reset_ends_it(watching):
    first(watching)
    watching.wait(20)
    watching.nmt(NmtCommand.RESET_COMMUNICATION)
    watching.start()
    assert watching.slave.emergencies.causes == ()
    assert watching.wait(100) == []


@pytest.mark.parametrize("milliseconds", [0, 5])
def test_writing_the_event_timer_withdraws_it_and_waits_for_the_next_frame(watching, milliseconds):
    first(watching)
    watching.wait(20)
    assert watching.write_value(0x1400, 5, milliseconds) is None
    assert watching.slave.emergencies.causes == ()
    assert watching.slave.due is None
    first(watching)
    assert emergencies(watching.wait(100)) == ([(25 * MS, b"\x50\x82")] if milliseconds else [])


def test_a_pdo_that_is_taken_away_is_not_missing(watching):
    first(watching)
    watching.write_value(0x1400, 1, 0x205 | INVALID)
    assert watching.wait(100) == []


def test_a_frame_that_is_too_short_does_not_count_and_one_that_is_too_long_does(watching):
    first(watching)
    watching.wait(8)
    watching.send(0x205, b"\0")
    assert emergencies(watching.wait(2)) == [(10 * MS, b"\x50\x82")]
    watching.send(0x205, bytes(3))
    assert watching.slave.emergencies.causes == ("RPDO 1 length",)
    assert first(watching) == [NO_ERROR]


def test_a_frame_after_the_window_of_sync_does_not_count(make_watching, missing):
    bench = make_watching(1)
    bench.write_value(0x1007, 0, 2000)
    bench.sync()
    first(bench)
    bench.wait(8)
    first(bench)
    assert emergencies(bench.wait(10)) == [(10 * MS, b"\x50\x82")]
    assert missing == [1]


def test_the_owner_may_leave_operational_when_it_hears_of_it(watching):
    heard = []

    def leave(number):
        heard.append(number)
        watching.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)

    watching.slave.on_rpdo_timeout = leave
    first(watching)
    second(watching)
    watching.now = 40 * MS  # both are late by now
    watching.slave.advance(watching.now)
    assert heard == [1, 2]
    assert watching.slave.emergencies.causes == ()
    assert watching.wait(100) == []


def test_a_deadline_that_has_passed_is_told_before_the_frame_that_comes_after_it(watching):
    first(watching)
    watching.now = 10 * MS
    assert [frame.data[:2] for frame in first(watching)] == [b"\x50\x82", b"\0\0"]


def test_a_deadline_and_an_event_timer_run_side_by_side(make_bench):
    bench = make_bench(rpdos=[PdoDefault(CONTROL, event_timer_ms=10)], tpdos=[PdoDefault(((0x6041, 0, 16),), event_timer_ms=25)])
    bench.start()
    first(bench)
    assert [(time, frame.can_id) for time, frame in bench.wait(50)] == [(10 * MS, 0x085), (25 * MS, 0x185), (50 * MS, 0x185)]


def test_what_was_wrong_with_a_frame_is_over_with_operational_too(watching):
    watching.send(0x205, b"")
    assert watching.slave.emergencies.causes == ("RPDO 1 length",)
    assert watching.nmt(NmtCommand.ENTER_PRE_OPERATIONAL) == [NO_ERROR]


@settings(max_examples=60)
@given(st.lists(st.integers(0, 30), max_size=20))
def test_an_emergency_comes_after_each_pause_that_is_too_long_and_no_other(make_bench, pauses):
    bench = make_bench(rpdos=[PdoDefault(CONTROL, event_timer_ms=10)])
    bench.start()
    first(bench)
    for pause in pauses:
        start = bench.now
        told = emergencies(bench.wait(pause))
        assert told == ([(start + 10 * MS, b"\x50\x82")] if pause >= 10 else [])
        assert first(bench) == ([NO_ERROR] if told else [])
