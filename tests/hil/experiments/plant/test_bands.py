"""Speeds at which no order of the transmission error rings."""

import math

import pytest

from hil.experiments.plant.bands import BIAS_RPS, fast_speed, quiet_speed
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


def test_no_speed_is_beyond_what_is_allowed() -> None:
    assert fast_speed(9.9, 2.0) <= 2.0
    for f_a in (4.0, 8.0, 13.0):
        assert quiet_speed(f_a, 1.5) <= 1.5
    assert quiet_speed(8.0, 0.1) == BIAS_RPS
