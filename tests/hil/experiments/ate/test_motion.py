"""Motions of a pass: within the limits of the bench file, with a ramp in each direction."""

import math

import numpy as np
import pytest

from hil.bench.bench import load_bench
from hil.experiments.ate.motion import ramps
from hil.experiments.ate.ramp import RampLimits, plan_ramp, resonance_ramp
from hil.master.request import check_set_points

BENCH, ARM = load_bench("reference"), load_bench("reference-arm")


@pytest.mark.parametrize("start_rev", [-21.0, -3.0, 0.0, 14.5, 21.9])
@pytest.mark.parametrize("acceleration", [1.0, 2.0, 4.0])
def test_a_pass_keeps_all_limits_wherever_it_starts(start_rev: float, acceleration: float) -> None:
    ramp = resonance_ramp(RampLimits.of(BENCH, 2), 12.4, acceleration, is_raised=False)
    found = ramps(BENCH, start_rev, ramp)
    turns = found.motion.motor_angle_rad[:, 0] / (2.0 * math.pi)
    absolute, limits = start_rev + turns, BENCH.axis[2].limits
    assert absolute[0] == pytest.approx(start_rev, abs=1e-9)
    assert limits.position_min_rev + 0.4 < absolute[1:].min() or start_rev < limits.position_min_rev + 1.1
    assert absolute.min() >= limits.position_min_rev
    assert absolute.max() <= limits.position_max_rev
    assert np.max(np.abs(np.diff(turns))) / 0.002 < limits.speed_rps
    assert found.low_rev >= limits.position_min_rev + 0.5 - 1e-9
    assert found.high_rev <= limits.position_max_rev - 0.5 + 1e-9


@pytest.mark.parametrize("period_s", [0.001, 0.004])
def test_the_master_takes_the_set_points_of_an_axis_whose_acceleration_limit_is_below_the_deceleration(period_s: float) -> None:
    table = BENCH.axis[2]
    limits = table.limits.model_copy(update={"acceleration_rps_s": 6.0, "position_min_rev": -4.0, "position_max_rev": 4.0})
    bus = BENCH.bus.model_copy(update={"sync_period_s": period_s})
    bench = BENCH.model_copy(update={"bus": bus, "axis": {2: table.model_copy(update={"limits": limits})}})
    ramp = resonance_ramp(RampLimits.of(bench, 2), 12.0, 4.0, is_raised=True)
    assert ramp.acceleration_rps_s == 6.0
    check_set_points(2, limits, ramps(bench, 2.0, ramp).motion.motor_angle_rad[:, 0], period_s)


def test_a_pass_has_a_ramp_in_each_direction_that_counts() -> None:
    found = ramps(BENCH, 0.0, plan_ramp(RampLimits.of(BENCH, 2), 4.0, 10.0))
    speed = np.gradient(found.motion.motor_angle_rad[:, 0], 0.002) / (2.0 * math.pi)
    for sign in (1, -1):
        rows = found.direction() == sign
        assert np.count_nonzero(rows) * 0.002 == pytest.approx(2.5, abs=0.01)
        assert np.all(sign * speed[rows] > -0.05)
        assert np.max(sign * speed[rows]) == pytest.approx(10.0, rel=0.01)
        fewer = found.direction(0.12) == sign
        assert np.min(sign * speed[fewer]) == pytest.approx(1.2, rel=0.05)


@pytest.mark.parametrize("axis", [2, 3, 5])
@pytest.mark.parametrize("arm_hz", [None, 10.4])
def test_on_an_arm_a_ramp_turns_the_joint_by_ten_degrees_at_most_and_ends_where_it_began(axis: int, arm_hz: float | None) -> None:
    ramp = resonance_ramp(RampLimits.of(ARM, axis), arm_hz, 4.0, is_raised=True)
    found = ramps(ARM, 1.5, ramp)
    turns = found.motion.motor_angle_rad[:, 0] / (2.0 * math.pi)
    assert np.max(np.abs(turns)) * 360.0 / ARM.axis[axis].reduction_ratio == pytest.approx(10.0, abs=0.1)
    assert abs(turns[-1]) < 1e-9
    assert np.max(np.abs(np.diff(turns))) / 0.002 < ARM.axis[axis].limits.speed_rps
    assert ramp.end_rps >= 1.15 * (arm_hz or 10.0) / 2.0
    assert ramp.bound == "; the limit is the travel of the arm's joint, ±10° (identification_travel_deg)"
