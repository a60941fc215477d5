"""Ramps within the limits of the bench file, or a number that says why not."""

import math

import numpy as np
import pytest

from drive_profiles.errors import FileError
from drive_profiles.files.toml import loads
from hil.bench.bench import REFERENCE, Bench, load_bench
from hil.errors import NotPossibleError
from hil.experiments.ate.motion import (
    binding_limit,
    end_speed,
    furthest_end,
    ramps,
    room_rev,
    slowest,
    travel_rev,
    with_room,
)

BENCH = load_bench("reference")


def with_limits(**changes: float) -> Bench:
    table = BENCH.axis[2]
    changed = table.model_copy(update={"limits": table.limits.model_copy(update=changes)})
    return BENCH.model_copy(update={"axis": {**BENCH.axis, 2: changed}})


@pytest.mark.parametrize("start_rev", [-21.0, -3.0, 0.0, 14.5, 21.9])
@pytest.mark.parametrize("acceleration", [1.0, 2.0, 4.0])
def test_a_pass_keeps_all_limits_wherever_it_starts(start_rev: float, acceleration: float) -> None:
    end = end_speed(BENCH, 2, acceleration, 12.4)
    found = ramps(BENCH, 2, start_rev, acceleration, end, 0.002)
    turns = found.motion.motor_angle_rad[:, 0] / (2.0 * math.pi)
    absolute, limits = start_rev + turns, BENCH.axis[2].limits
    assert absolute[0] == pytest.approx(start_rev, abs=1e-9)
    assert limits.position_min_rev + 0.4 < absolute[1:].min() or start_rev < limits.position_min_rev + 1.1
    assert absolute.min() >= limits.position_min_rev
    assert absolute.max() <= limits.position_max_rev
    assert np.max(np.abs(np.diff(turns))) / 0.002 < limits.speed_rps
    assert found.low_rev >= limits.position_min_rev + 0.5 - 1e-9
    assert found.high_rev <= limits.position_max_rev - 0.5 + 1e-9


def test_a_pass_has_a_ramp_in_each_direction_that_counts() -> None:
    found = ramps(BENCH, 2, 0.0, 4.0, 10.0, 0.002)
    speed = np.gradient(found.motion.motor_angle_rad[:, 0], 0.002) / (2.0 * math.pi)
    for sign in (1, -1):
        rows = found.direction() == sign
        assert np.count_nonzero(rows) * 0.002 == pytest.approx(2.5, abs=0.01)
        assert np.all(sign * speed[rows] > -0.05)
        assert np.max(sign * speed[rows]) == pytest.approx(10.0, rel=0.01)
        fewer = found.direction(0.12) == sign
        assert np.min(sign * speed[fewer]) == pytest.approx(1.2, rel=0.05)


def test_a_known_arm_ends_the_ramp_where_nothing_more_is_to_be_learnt() -> None:
    assert end_speed(BENCH, 2, 4.0, None) == 10.0
    assert end_speed(BENCH, 2, 4.0, 12.0) == pytest.approx(1.35 * 6.0)


def test_too_little_travel_is_said_with_what_is_needed() -> None:
    narrow = with_limits(position_min_rev=-3.0, position_max_rev=3.0)
    with pytest.raises(
        NotPossibleError, match=r"to pass f_m2 = 6\.00 rev/s, 6\.90 rev/s are needed: that takes 7\.1 rev at 4 rev/s²"
    ) as error:
        end_speed(narrow, 2, 4.0, 12.0)
    assert "between its position limits there are 5.0 rev; accelerate with 6.25 rev/s² or more" in str(error.value)
    least = slowest(narrow, 2, 6.9)
    assert travel_rev(least, 20.0, 6.9) == pytest.approx(room_rev(narrow, 2))
    assert end_speed(narrow, 2, 1.001 * least, 12.0) >= 6.9


def test_a_speed_limit_below_the_resonance_is_said_with_what_is_needed() -> None:
    with pytest.raises(NotPossibleError, match=r"its limit speed_rps is 6, 7\.26 is needed"):
        end_speed(with_limits(speed_rps=6.0), 2, 4.0, 12.0)


@pytest.mark.parametrize("acceleration", [0.0, -1.0, math.nan, math.inf])
def test_what_is_no_acceleration_is_refused(acceleration: float) -> None:
    with pytest.raises(NotPossibleError, match="must be above 0"):
        end_speed(BENCH, 2, acceleration, None)


def test_no_room_at_all_is_refused() -> None:
    with pytest.raises(NotPossibleError, match="wider position limits are needed"):
        end_speed(with_limits(position_min_rev=-0.5, position_max_rev=0.5), 2, 4.0, None)


ARM = load_bench("reference-arm")


@pytest.mark.parametrize("axis", [2, 3, 5])
@pytest.mark.parametrize("arm_hz", [None, 10.4])
def test_on_an_arm_a_ramp_turns_the_joint_by_ten_degrees_at_most_and_ends_where_it_began(axis: int, arm_hz: float | None) -> None:
    end = furthest_end(ARM, axis, 4.0, arm_hz)
    acceleration = with_room(ARM, axis, 4.0, end)
    found = ramps(ARM, axis, 1.5, acceleration, end, 0.002)
    turns = found.motion.motor_angle_rad[:, 0] / (2.0 * math.pi)
    assert np.max(np.abs(turns)) * 360.0 / ARM.axis[axis].reduction_ratio == pytest.approx(10.0, abs=0.1)
    assert abs(turns[-1]) < 1e-9
    assert np.max(np.abs(np.diff(turns))) / 0.002 < ARM.axis[axis].limits.speed_rps
    assert end >= 1.15 * (arm_hz or 10.0) / 2.0
    assert "±10° (identification_travel_deg)" in binding_limit(ARM, axis, acceleration, end)


def test_an_arm_that_may_turn_too_little_is_told_what_is_needed() -> None:
    narrow = ARM.model_copy(update={"identification_travel_deg": 3.0})
    with pytest.raises(NotPossibleError, match=r"within ±3° of the joint there are 2\.0 rev; .*raise identification_travel_deg"):
        end_speed(narrow, 2, 7.0, 10.4)
    wide = ARM.model_copy(update={"identification_travel_deg": 60.0})
    assert binding_limit(wide, 2, 7.0, 7.0) == ""
    with pytest.raises(FileError, match="identification_travel_deg needs an arm table"):
        loads(REFERENCE.read_text(encoding="utf-8").replace("settle_s", "identification_travel_deg = 5.0\nsettle_s"), Bench)
