"""Moves out of a place beyond the limits: there is room for what the loop lets a load push, and no more."""

import math

import pytest

from hil.bench.bench import AS_FOUND, load_bench
from hil.experiments.move import sag_rev, way_of, with_room

BENCH = load_bench("reference")


def test_an_axis_beyond_its_limits_has_room_for_the_sag_that_its_torque_limit_and_gains_allow() -> None:
    table = BENCH.axis[2]
    assert sag_rev(table) == pytest.approx(7.1 / (25.0 * 0.196) / math.tau)
    wider = with_room(BENCH, 2, 23.0).axis[2].limits
    assert (wider.position_min_rev, wider.position_max_rev) == (-22.0, pytest.approx(23.0 + sag_rev(table)))
    assert with_room(BENCH, 2, 21.0) is BENCH


def test_an_axis_that_stands_at_a_limit_has_the_room_that_its_load_takes_when_the_brake_opens() -> None:
    table = BENCH.axis[2]
    assert with_room(BENCH, 2, 22.0).axis[2].limits.position_max_rev == pytest.approx(22.0 + sag_rev(table))
    assert with_room(BENCH, 2, -22.0).axis[2].limits.position_min_rev == pytest.approx(-22.0 - sag_rev(table))


def test_without_gains_the_room_is_what_the_motor_may_be_behind_its_set_point() -> None:
    limits = BENCH.axis[2].limits.model_copy(update={"following_error_rev": 0.05})
    table = BENCH.axis[2].model_copy(update={"limits": limits})
    assert sag_rev(table) == 0.05
    assert sag_rev(table.model_copy(update={"control": AS_FOUND})) == 0.05


def test_a_slow_way_takes_longer_ramps_where_the_acceleration_limit_asks_for_them() -> None:
    usual, gentle = way_of(2, math.tau, 3.0, 0.002), way_of(2, math.tau, 3.0, 0.002, 4.0)
    assert gentle.time_s[-1] > usual.time_s[-1]
