"""The histogram against exact percentiles, and the beat on a clock that the test owns."""

import json
import math
import sys
from dataclasses import asdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.can.bits import frame_bits
from hil.can.frame import CAN_ERR_FLAG, Frame
from hil.master.lateness import CycleSchedule, Histogram, WallClockTiming, duration_text, timing_lines
from hil.master.realtime import Measure
from tests.hil.master.virtual_time import VirtualClock

DURATIONS = st.floats(1e-7, 100.0)
SHARES = st.floats(0.001, 1.0)


def filled(values: list[float]) -> Histogram:
    histogram = Histogram()
    for value in values:
        histogram.add(value)
    return histogram


# -- histogram ---------------------------------------------------------------------------------------------------------


@given(st.lists(DURATIONS, min_size=1, max_size=200), SHARES)
def test_a_percentile_is_never_too_small_and_at_most_the_stated_error_too_large(values: list[float], share: float) -> None:
    exact = sorted(values)[max(1, math.ceil(round(share * len(values), 6))) - 1]
    found = filled(values).percentile(share)
    assert found is not None
    assert exact <= found <= exact * (1.0 + Histogram.RELATIVE_ERROR) * (1.0 + 1e-12)
    assert Histogram.RELATIVE_ERROR < 0.024


@given(st.lists(st.floats(-1.0, 1e6), min_size=1, max_size=100))
def test_the_largest_is_exact_and_nothing_is_lost_whatever_comes(values: list[float]) -> None:
    histogram = filled(values)
    assert histogram.percentile(1.0) == histogram.largest_s == max(0.0, *values)
    assert histogram.count == len(values) == sum(number for _, number in histogram.bars())


@given(st.lists(DURATIONS, min_size=2, max_size=100))
def test_percentiles_rise_with_their_share(values: list[float]) -> None:
    found = [filled(values).percentile(share) or 0.0 for share in (0.1, 0.5, 0.9, 0.99, 1.0)]
    assert found == sorted(found)


def test_memory_does_not_grow_with_the_run() -> None:
    histogram = Histogram()
    before = sys.getsizeof(histogram._bins), len(histogram._bins)
    for i in range(100_000):
        histogram.add(1e-9 * 1.7 ** (i % 60))
    assert (sys.getsizeof(histogram._bins), len(histogram._bins)) == before
    assert len(histogram.bars()) <= 20


def test_bars_are_two_a_decade_and_cover_what_is_filled() -> None:
    bars = filled([2e-6, 2e-6, 4e-6, 200.0]).bars()
    assert bars[0] == (pytest.approx(10**-5.5), 2)
    assert bars[1] == (pytest.approx(1e-5), 1)
    assert bars[-1] == (math.inf, 1)
    assert filled([]).bars() == []


def test_without_values_there_is_no_percentile() -> None:
    assert Histogram().percentile(0.5) is None


# -- beat --------------------------------------------------------------------------------------------------------------


def beat_of(clock: VirtualClock, period_s: float = 0.01) -> CycleSchedule:
    return CycleSchedule(clock, period_s, 0.5 * period_s)


def go(beat: CycleSchedule) -> bool:
    """A cycle in which nothing takes time; whether it was sent."""
    beat.wait()
    if beat.gives_up():
        return False
    beat.sync_left()
    return True


def test_deadlines_do_not_drift_whatever_the_cycles_take() -> None:
    clock = VirtualClock()
    beat = beat_of(clock, 0.001)
    go(beat)
    start = beat.deadline_s
    for number in range(1, 10_001):
        clock.sleep_until(clock.now() + 0.0007)  # the work of a cycle
        clock.sleep_until(clock.now() + (0.0004 if number % 3 == 0 else 0.0))  # and now and then it comes too late
        assert go(beat)
        assert beat.deadline_s == pytest.approx(start + number * 0.001, abs=1e-9)
    assert beat.lateness.largest_s == pytest.approx(0.0001, abs=1e-9)
    assert (beat.dropped, beat.late) == (0, 0)


@pytest.mark.parametrize(
    ("pause_s", "sent", "overdue"), [(0.014, True, 0), (0.016, False, 1), (0.0301, False, 3), (0.051, False, 5)]
)
def test_a_beat_beyond_the_limit_is_given_up_and_counted(pause_s: float, sent: bool, overdue: int) -> None:
    clock = VirtualClock()
    beat = beat_of(clock)
    go(beat)
    clock.sleep_until(clock.now() + pause_s)
    assert go(beat) is sent
    assert beat.dropped == int(not sent)
    assert beat.overdue == overdue
    assert beat.lateness.largest_s == pytest.approx(pause_s - 0.01)


def test_the_beats_after_a_pause_have_their_own_deadlines() -> None:
    clock = VirtualClock()
    beat = beat_of(clock)
    go(beat)
    start = clock.now()
    clock.sleep_until(start + 0.026)  # 10 ms and 20 ms have passed
    assert [go(beat) for _ in range(3)] == [False, False, True]
    assert clock.now() == pytest.approx(start + 0.03)
    assert (beat.dropped, beat.overdue, beat.cycles) == (2, 0, 4)


def test_a_stop_is_never_too_late_and_does_not_work_off_what_has_passed() -> None:
    clock = VirtualClock()
    beat = beat_of(clock)
    go(beat)
    start = clock.now()
    clock.sleep_until(start + 1.005)
    assert not go(beat)
    beat.is_stopping = True
    assert go(beat)
    assert clock.now() == pytest.approx(start + 1.005), "at once"
    assert go(beat)
    assert clock.now() == pytest.approx(start + 1.015), "and a period later again"
    assert beat.dropped == 1 + 98
    assert beat.cycles == 1 + beat.dropped + 2


def test_a_sync_that_leaves_late_in_spite_of_the_last_look_is_counted() -> None:
    clock = VirtualClock()
    beat = beat_of(clock)
    beat.wait()
    assert not beat.gives_up()
    clock.sleep_until(clock.now() + 0.007)
    beat.sync_left()
    assert beat.late == 1


def test_only_frames_that_were_on_the_wire_have_bits() -> None:
    beat = beat_of(VirtualClock())
    good = Frame(0x182, bytes(8))
    for frame in (good, Frame(CAN_ERR_FLAG | 4, bytes(8)), Frame(0x800, b""), Frame(0x80, bytes(9))):
        beat.saw(frame)
    beat.count_bits()
    beat.count_bits()
    assert beat.bits == frame_bits(good)


# -- what a result says ------------------------------------------------------------------------------------------------


def test_a_timing_is_json_and_text() -> None:
    clock = VirtualClock()
    beat = beat_of(clock)
    for _ in range(100):
        go(beat)
        clock.sleep_until(clock.now() + 0.0003)
        beat.answered()
        beat.saw(Frame(0x80, b""))
        beat.count_bits()
    refused = Measure("SCHED_FIFO", False, "Operation not permitted; 'ulimit -r 80'")
    timing = WallClockTiming.of(beat, 2, 1_000_000, 7, (refused,))
    kept = json.loads(json.dumps(asdict(timing), allow_nan=False))
    assert kept["arrivals"]["p99_s"] == pytest.approx(0.0003, rel=0.024)
    assert kept["bus_load"] == pytest.approx(100 * frame_bits(Frame(0x80, b"")) / 1e6 / 0.9903, abs=1e-4)
    text = "\n".join(timing_lines(kept))
    for words in ("100 cycles", "2 with an answer missing", "SYNC after deadline", "ulimit -r 80", "7"):
        assert words in text


def test_what_is_not_known_is_said_to_be_unknown() -> None:
    kept = asdict(WallClockTiming.of(beat_of(VirtualClock()), 0, None, None, ()))
    assert kept["bus_load"] is None
    assert kept["lateness"]["max_s"] is None
    assert "not known" in "\n".join(timing_lines(kept))


@pytest.mark.parametrize(
    ("value", "text"), [(None, "-"), (1.5, "1.5 s"), (0.02, "20 ms"), (1.23e-5, "12.3 µs"), (1e-7, "0.1 µs")]
)
def test_durations_are_said_in_the_unit_that_suits_them(value: float | None, text: str) -> None:
    assert duration_text(value) == text
