"""Ramps within the limits of the bench file, the limit that binds them, or a number that says why there is none."""

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from drive_profiles.errors import FileError
from drive_profiles.files.toml import loads
from hil.bench.bench import REFERENCE, Bench, load_bench
from hil.design.ringing import BEYOND_RESONANCE
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.experiments.ate.ramp import Ramp, RampLimits, plan_ramp, resonance_ramp

BENCH, ARM = load_bench("reference"), load_bench("reference-arm")
LIMITS = RampLimits.of(BENCH, 2)
NARROW = replace(LIMITS, position_rev=5.0)


def through(bench: Bench, arm_hz: float | None, asked_rps_s: float = 4.0, **changes: Any) -> Ramp:
    """A ramp of axis 2 whose acceleration is not raised."""
    limits = replace(RampLimits.of(bench, 2), **changes)
    return resonance_ramp(limits, arm_hz, asked_rps_s, is_raised=False).beyond(arm_hz)


def test_a_known_arm_ends_the_ramp_where_nothing_more_is_to_be_learnt() -> None:
    assert through(BENCH, None).end_rps == 10.0
    assert through(BENCH, 12.0).end_rps == pytest.approx(1.35 * 6.0)
    assert through(BENCH, 12.0).bound == ""


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"position_rev": 5.0}, r"that takes 7\.1 rev at 4 rev/s²; between its position limits there are 5\.0 rev; "
                                r"accelerate with 6\.25 rev/s² or more, or widen them"),
        ({"position_rev": 0.5}, r"between its position limits there are 0\.5 rev; widen them"),
        ({"position_rev": 3.0, "acceleration_rps_s": 10.0}, r"are 3\.0 rev; widen them"),
        ({"position_rev": 3.0, "acceleration_rps_s": 4.0}, r"raise its limit acceleration_rps_s, 4, or widen them"),
        ({"speed_rps": 6.0}, r"its limit speed_rps is 6; at least 7\.26 is needed"),
    ],
)  # fmt: skip
def test_what_keeps_a_ramp_from_the_resonance_is_said_with_what_is_needed(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(NotPossibleError, match=rf"to pass f_a/2 = 6\.00 rev/s, 6\.90 rev/s are needed: .*{message}"):
        through(BENCH, 12.0, **changes)


def test_the_acceleration_that_is_advised_is_enough() -> None:
    least = NARROW.slowest(6.9)
    assert plan_ramp(NARROW, least, 6.9).travel_rev == pytest.approx(NARROW.room_rev)
    assert plan_ramp(NARROW, 1.001 * least, 12.0).end_rps >= 6.9


@pytest.mark.parametrize("acceleration", [0.0, -1.0, math.nan, math.inf])
def test_what_is_no_acceleration_is_refused(acceleration: float) -> None:
    with pytest.raises(NotPossibleError, match="must be above 0"):
        plan_ramp(LIMITS, acceleration, 10.0)


def test_an_acceleration_beyond_its_limit_is_refused() -> None:
    with pytest.raises(UnsafeRequestError, match=r"the acceleration of axis 2 would be 101 rev/s²; the limit is 100"):
        plan_ramp(LIMITS, 101.0, 10.0)


def test_a_ramp_accelerates_and_brakes_within_an_acceleration_limit_below_its_deceleration() -> None:
    limits = replace(LIMITS, acceleration_rps_s=10.0, position_rev=3.0)
    ramp = resonance_ramp(limits, 12.0, 4.0, is_raised=True)
    assert (ramp.acceleration_rps_s, limits.braking_rps_s) == (10.0, 10.0)
    assert ramp.bound == "; the limit is its acceleration limit, 10 rev/s²"


@pytest.mark.parametrize(("changes", "named"), [({"position_rev": 0.0}, "widen them"), ({"speed_rps": 0.4}, "speed_rps is 0.4")])
def test_a_motor_that_may_hardly_move_is_refused_for_the_limit_that_holds_it(changes: dict[str, Any], named: str) -> None:
    with pytest.raises(NotPossibleError, match=rf"0\.50 rev/s are needed: .*{named}"):
        through(BENCH, None, **changes)


def test_an_arm_that_may_turn_too_little_is_told_what_is_needed() -> None:
    narrow = ARM.model_copy(update={"identification_travel_deg": 3.0})
    with pytest.raises(NotPossibleError, match=r"within ±3° of the joint there are 2\.0 rev; .*raise identification_travel_deg"):
        through(narrow, 10.4, 7.0)
    wide = ARM.model_copy(update={"identification_travel_deg": 60.0})
    assert through(wide, 10.4, 7.0).binds == ""
    with pytest.raises(FileError, match="identification_travel_deg needs an arm table"):
        loads(REFERENCE.read_text(encoding="utf-8").replace("settle_s", "identification_travel_deg = 5.0\nsettle_s"), Bench)


def test_on_an_arm_a_low_order_is_passed_by_the_acceleration_that_its_ramp_gets_or_not_at_all() -> None:
    """Twice the first pass' acceleration has room for it, the deceleration, beyond which no ramp is raised, has not."""
    limits = replace(LIMITS, joint_rev=36.0, joint_deg=60.0, speed_rps=50.0)
    assert limits.braking_rps_s < limits.slowest(1.2 * 25.0) < 2.0 * 4.0 * (25.0 / 12.0) ** 2
    assert limits.low_order_end(25.0, 1.0, 4.0) == 0.0
    assert replace(limits, joint_rev=50.0, position_rev=80.0).low_order_end(24.0, 1.0, 4.0) == 1.2 * 24.0


limits_strategy = st.builds(
    RampLimits,
    axis=st.just(2),
    speed_rps=st.floats(0.5, 100.0),
    acceleration_rps_s=st.just(math.inf) | st.floats(1.0, 100.0),
    deceleration_rps_s=st.floats(1.0, 100.0),
    position_rev=st.floats(0.1, 200.0),
    joint_rev=st.just(math.inf) | st.floats(0.1, 200.0),
    joint_deg=st.just(10.0),
)


@st.composite
def planned(draw: st.DrawFn) -> tuple[Ramp, float, float]:
    """A ramp within any limits, with the end speed that was wanted, and the least for which it was to accelerate faster."""
    limits = draw(limits_strategy)
    end = draw(st.floats(0.5, 100.0))
    acceleration = draw(st.floats(0.1, min(limits.acceleration_rps_s, 60.0)))
    least = draw(st.just(0.0) | st.just(end) | st.floats(0.1, end))
    return plan_ramp(limits, acceleration, end, least), end, least


@given(planned())
def test_a_ramp_leaves_no_limit_and_is_no_faster_than_travel_asks(wanted: tuple[Ramp, float, float]) -> None:
    ramp, end, least = wanted
    limits, asked = ramp.limits, ramp.asked_rps_s
    assert 0.0 < ramp.end_rps <= min(end, limits.speed_rps)
    assert ramp.travel_rev <= limits.room_rev * (1.0 + 1e-9)
    assert asked <= ramp.acceleration_rps_s <= max(asked, limits.braking_rps_s) <= limits.acceleration_rps_s
    raised_for = min(least, limits.top_rps)
    assert ramp.acceleration_rps_s <= max(asked, 1.001 * limits.slowest(raised_for))
    assert ramp.end_rps >= raised_for * (1.0 - 1e-9) or ramp.acceleration_rps_s >= limits.braking_rps_s or raised_for == 0.0


@given(planned())
def test_what_binds_a_ramp_relaxed_by_itself_lets_it_end_faster_or_be_gentler(wanted: tuple[Ramp, float, float]) -> None:
    ramp, *ends = wanted
    limits, asked = ramp.limits, ramp.asked_rps_s
    assume(limits.joint_rev != limits.position_rev and ends[0] != limits.top_rps)
    assume(ramp.end_rps < ends[0] or ramp.acceleration_rps_s > asked or not ramp.binds)
    field = {
        "speed": "speed_rps",
        "acceleration": "acceleration_rps_s",
        "joint travel": "joint_rev",
        "position limits": "position_rev",
    }
    if ramp.binds:
        wider: dict[str, Any] = {field[ramp.binds]: 1.1 * getattr(limits, field[ramp.binds])}
        relaxed = plan_ramp(replace(limits, **wider), asked, *ends)
        is_gentler = relaxed.acceleration_rps_s < ramp.acceleration_rps_s and relaxed.end_rps >= ramp.end_rps
        assert relaxed.end_rps > ramp.end_rps or is_gentler
        assert ramp.bound.startswith("; the limit is ")
        return
    none: dict[str, Any] = dict.fromkeys(field.values(), math.inf)
    alone = plan_ramp(replace(limits, **none), asked, *ends)
    assert (alone.end_rps, alone.acceleration_rps_s) == (ramp.end_rps, ramp.acceleration_rps_s)
    assert ramp.bound == ""


@given(limits_strategy, st.floats(2.0, 60.0), st.floats(0.1, 60.0))
def test_a_ramp_passes_the_resonance_or_says_what_keeps_it_from_it(limits: RampLimits, arm_hz: float, asked: float) -> None:
    assume(asked <= limits.acceleration_rps_s)
    ramp, needed = resonance_ramp(limits, arm_hz, asked, is_raised=True), BEYOND_RESONANCE * arm_hz / 2.0
    if ramp.end_rps >= needed:
        assert ramp.beyond(arm_hz) is ramp
        return
    with pytest.raises(NotPossibleError, match=r"are needed: (its limit speed_rps|that takes)"):
        ramp.beyond(arm_hz)
