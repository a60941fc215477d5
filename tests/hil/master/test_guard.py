"""What the master watches while an axis moves: pure, values in, reasons out."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.bench.bench import load_bench
from hil.master.guard import AxisGuard

BENCH = load_bench("reference")
AXIS = BENCH.axis[2]
PERIOD_S = 0.002
TURN = 2.0 * math.pi
STEP_RAD = AXIS.limits.speed_rps * TURN * PERIOD_S
ENABLED = 0x0637


def guard() -> AxisGuard:
    return AxisGuard(2, AXIS, BENCH.bus.missing_limit, PERIOD_S)


def reason(watch: AxisGuard, position: float, *, missing: int = 0, word: int = ENABLED, torque: float = 0.0) -> str | None:
    return watch.check(word, position, position, torque, missing)


def test_one_position_that_cannot_be_is_forgotten_and_the_run_goes_on() -> None:
    watch = guard()
    assert watch.accepts(0.0, 0)
    assert not watch.accepts(1000.0, 0)
    assert reason(watch, 0.0) is None
    assert watch.accepts(STEP_RAD, 0)
    assert not watch.accepts(-1000.0, 0)
    assert reason(watch, STEP_RAD) is None
    assert watch.discarded == 2


def test_two_in_a_row_stop_the_run_and_say_how_fast() -> None:
    watch = guard()
    watch.accepts(0.0, 0)
    assert not watch.accepts(10.0 * STEP_RAD, 0)
    assert not watch.accepts(20.0 * STEP_RAD, 0)
    found = reason(watch, 0.0)
    assert found is not None
    assert "axis 2 turns at 120.00 rev/s, the limit is 12 rev/s" in found


def test_an_axis_that_turns_too_fast_is_stopped_in_the_second_cycle() -> None:
    watch = guard()
    for i in range(3):
        accepted = watch.accepts(1.2 * STEP_RAD * i, 0)
        assert accepted == (i == 0)
    assert reason(watch, 0.0) is not None


@pytest.mark.parametrize("missing", [1, 2])
def test_an_answer_that_comes_a_period_late_is_no_jump(missing: int) -> None:
    """p(k) is late: it comes in the place of p(k+1), and the next that comes is two periods away."""
    watch = guard()
    for k in range(4):
        assert watch.accepts(STEP_RAD * k, 0)
    for m in range(missing):
        assert watch.accepts(STEP_RAD * 3, m + 1)
    late = 3 + missing
    assert watch.accepts(STEP_RAD * late, 0)
    for k in range(late + 2, late + 12):
        assert watch.accepts(STEP_RAD * k, 0)


@given(st.lists(st.tuples(st.floats(-1.0, 1.0), st.booleans()), max_size=60))
def test_whatever_the_motor_can_do_is_accepted_whatever_is_lost(cycles: list[tuple[float, bool]]) -> None:
    watch, position, missing = guard(), 0.0, 0
    for share, is_lost in cycles:
        position += share * STEP_RAD
        missing = missing + 1 if is_lost else 0
        assert watch.accepts(position, missing)


def test_a_skipped_cycle_forgets_where_the_axis_was() -> None:
    watch = guard()
    watch.accepts(0.0, 0)
    watch.skip()
    assert watch.accepts(100.0, 0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"word": 0x0618}, "left operation enabled: fault (status word 0618h)"),
        ({"torque": 1.03 * AXIS.limits.torque_nm}, "N·m, the limit is 7.1 N·m"),
        ({"missing": 3}, "has not answered for 3 cycles"),
    ],
)
def test_what_stops_a_run_is_named_with_its_numbers(change: dict[str, float], words: str) -> None:
    found = reason(guard(), 0.0, **change)  # type: ignore[arg-type]
    assert found is not None
    assert words in found


def test_a_position_beyond_its_limit_stops_the_run() -> None:
    found = reason(guard(), 22.1 * TURN)
    assert found is not None
    assert "axis 2 is at 22.100 rev, the limits are -22 and 22 rev" in found


def test_a_following_error_stops_the_run_only_when_it_lasts() -> None:
    watch, limits = guard(), AXIS.limits
    cycles = round(limits.following_error_timeout_s / PERIOD_S)
    behind = (limits.following_error_rev + 0.1) * TURN
    told = [watch.check(ENABLED, 0.0, behind, 0.0, 0) for _ in range(cycles + 4)]
    assert told[: cycles + 1] == [None] * (cycles + 1)
    assert told[-1] is not None
    assert "4.100 rev behind its set-point, the limit is 4 rev" in told[-1]
    again = guard()
    for _ in range(10):
        assert [again.check(ENABLED, 0.0, behind, 0.0, 0) for _ in range(cycles)][-1] is None
        again.check(ENABLED, 0.0, 0.0, 0.0, 0)
