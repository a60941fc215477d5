"""Speeds at which no order of the transmission error rings."""

import math

import pytest

from hil.experiments.plant.bands import AWAY, BIAS_RPS, FASTEST_BIAS_RPS, fast_speed, quiet_speed
from hil.experiments.plant.motion import FAST_RPS
from hil.robot_tables import ORDERS


def away(speed_rps: float, f_a: float) -> float:
    return min(math.exp(abs(math.log(order * speed_rps / f_a))) for order in ORDERS)


@pytest.mark.parametrize("f_a", [3.5, 4.9, 7.0, 9.0, 14.0, 20.0, 30.0])
def test_the_turns_for_friction_keep_away_from_speeds_at_which_an_order_rings(f_a: float) -> None:
    """At 3.5 rev/s on an arm of 14 Hz vibration put Coulomb friction off by 18 %."""
    speed = fast_speed(f_a, 10.0)
    assert away(speed, f_a) > 1.15
    assert 0.7 * FAST_RPS <= speed <= FAST_RPS


@pytest.mark.parametrize("f_a", [1.0, 1.6, 2.0, 2.6, 4.4, 6.3, 8.0, 10.3, 11.0, 30.0])
def test_the_bias_is_the_nearest_speed_at_which_no_order_rings(f_a: float) -> None:
    speed, nearer = quiet_speed(f_a, 10.0), 0.999
    assert away(speed, f_a) >= AWAY
    assert abs(math.log(speed / BIAS_RPS)) <= math.log(FASTEST_BIAS_RPS / BIAS_RPS) + 1e-6
    assert speed == BIAS_RPS or away(BIAS_RPS * (speed / BIAS_RPS) ** nearer, f_a) < AWAY


def test_no_speed_is_beyond_what_is_allowed() -> None:
    assert fast_speed(9.9, 2.0) <= 2.0
    for f_a in (4.0, 8.0, 13.0):
        assert quiet_speed(f_a, 1.5) <= 1.5
    assert quiet_speed(8.0, 0.1) <= 0.1
