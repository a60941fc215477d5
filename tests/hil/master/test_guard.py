"""What the master watches while an axis moves: pure, values in, reasons out; its specification is `tests.oracles.guard`."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.bench.bench import load_bench
from hil.core.library import CORE
from hil.master.guard import TORQUE_SHARE, AxisGuard
from tests.oracles import guard as specification

BENCH = load_bench("reference")
AXIS = BENCH.axis[2]
PERIOD_S = 0.002
TURN = 2.0 * math.pi
STEP_RAD = AXIS.limits.speed_rps * TURN * PERIOD_S
ENABLED = 0x0637


class Watch(AxisGuard):
    """The checks of the core with the words of Python."""

    def accepts(self, position_rad: float, missing: int) -> bool:
        return bool(CORE.call.guard_accepts(self.data, position_rad, missing))

    def check(self, *values: float) -> str | None:
        found = CORE.call.guard_check(self.data, *values)
        return self.words(found, *values) if found else None  # type: ignore[arg-type]

    def skip(self) -> None:
        CORE.call.guard_skip(self.data)


def guard() -> Watch:
    return Watch(2, AXIS, BENCH.bus.missing_limit, PERIOD_S)


def reason(watch: Watch, position: float, *, missing: int = 0, word: int = ENABLED, torque: float = 0.0) -> str | None:
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
    assert "axis 2 turns at 120.00 rev/s; the limit is 12 rev/s" in found


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
        ({"torque": 1.03 * AXIS.limits.torque_nm}, "N·m; the limit is 7.1 N·m"),
        ({"missing": 3}, "has not answered for 3 cycles: check its supply, its cable and the bus load (hil plan)"),
    ],
)
def test_what_stops_a_run_is_named_with_its_numbers(change: dict[str, float], words: str) -> None:
    found = reason(guard(), 0.0, **change)  # type: ignore[arg-type]
    assert found is not None
    assert words in found


def test_a_position_beyond_its_limit_stops_the_run() -> None:
    found = reason(guard(), 22.1 * TURN)
    assert found is not None
    assert "axis 2 is at 22.100 rev; the limits are -22 and 22 rev" in found


def test_a_following_error_stops_the_run_only_when_it_lasts() -> None:
    watch, limits = guard(), AXIS.limits
    cycles = round(limits.following_error_timeout_s / PERIOD_S)
    behind = (limits.following_error_rev + 0.1) * TURN
    told = [watch.check(ENABLED, 0.0, behind, 0.0, 0) for _ in range(cycles + 4)]
    assert told[: cycles + 1] == [None] * (cycles + 1)
    assert told[-1] is not None
    assert "4.100 rev behind its set-point; the limit is 4 rev" in told[-1]
    again = guard()
    for _ in range(10):
        assert [again.check(ENABLED, 0.0, behind, 0.0, 0) for _ in range(cycles)][-1] is None
        again.check(ENABLED, 0.0, 0.0, 0.0, 0)


REACH_RAD, LIMITS = 1.1 * STEP_RAD, AXIS.limits
WINDOW_RAD, TORQUE_NM = LIMITS.following_error_rev * TURN, 1.02 * LIMITS.torque_nm
STEPS = st.one_of(
    st.sampled_from([n * REACH_RAD for n in (-3, -2, -1, 0, 1, 2, 3)]),
    st.sampled_from([math.nextafter(n * REACH_RAD, math.inf * n) for n in (-2, -1, 1, 2)]),
    st.floats(-2.0 * REACH_RAD, 2.0 * REACH_RAD),
    st.floats(-1e6, 1e6),
)
PLACES = st.sampled_from([LIMITS.position_min_rev * TURN, LIMITS.position_max_rev * TURN])
BEHIND = st.one_of(
    st.just(0.0), st.sampled_from([-1.0, 1.0]).map(WINDOW_RAD.__mul__), st.floats(-3.0 * WINDOW_RAD, 3.0 * WINDOW_RAD)
)
TORQUES = st.one_of(st.sampled_from([0.0, TORQUE_NM, -TORQUE_NM, math.nextafter(TORQUE_NM, math.inf)]), st.floats(-20.0, 20.0))
WORDS = st.one_of(st.just(ENABLED), st.integers(0, 0xFFFF))
CYCLES = st.lists(
    st.tuples(st.one_of(STEPS, PLACES.map(lambda at: (at,))), BEHIND, TORQUES, WORDS, st.sampled_from("aaaaaammd")), max_size=80
)


@pytest.mark.ci
@given(CYCLES, st.sampled_from([1, 3]), st.sampled_from([PERIOD_S, 250e-6, 0.05]))
def test_the_guard_is_its_specification(
    cycles: list[tuple[float | tuple[float], float, float, int, str]], missing_limit: int, period_s: float
) -> None:
    """Every verdict and all that is kept, to the last bit: steps and limits just reached, too far by one bit, and anything."""
    watch = Watch(2, AXIS, missing_limit, period_s)
    plain = specification.Guard(AXIS, missing_limit, period_s)
    position, missing = 0.0, 0
    for step, behind, torque, word, kind in cycles:
        before, missing = position, missing + 1 if kind == "m" else 0
        position = step[0] if isinstance(step, tuple) else position + step
        if kind == "d":
            watch.skip()
            plain.skip()
        else:
            accepted = watch.accepts(position, missing)
            assert accepted == plain.accepts(position, missing)
            position = position if accepted else before
            values = word, position, position - behind, torque, missing
            assert CORE.call.guard_check(watch.data, *values) == plain.check(*values)
        for name, value in plain.state().items():
            assert getattr(watch.data, name) == value, name


def test_every_verdict_of_the_specification_has_its_number() -> None:
    names = ("IN_ORDER", "SILENT", "NOT_IN_OPERATION", "TOO_FAST", "BEYOND_LIMITS", "TOO_MUCH_TORQUE", "TOO_FAR_BEHIND")
    assert [getattr(specification, name) for name in names] == [getattr(CORE.call, name) for name in names]
    assert CORE.constants["WILD_LIMIT"] == specification.WILD_LIMIT


@pytest.mark.parametrize("limit_per_mille", [50.0, 50.4, 123.5, 3000.0])
def test_rounding_in_the_drive_is_no_torque_beyond_the_limit(limit_per_mille: float) -> None:
    """6072h is rounded up by half a step, and the torque that comes of it once more in 6077h."""
    assert (limit_per_mille + 0.5) + 0.5 <= (1.0 + TORQUE_SHARE) * limit_per_mille
