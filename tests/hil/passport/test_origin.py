"""Orders of the motor, told from those of the gear by what they do; and never guessed."""

import pytest

from hil.passport.origin import Conditions, Motor, origin_of_order
from hil.passport.store import OrderSides


@pytest.mark.parametrize(
    ("order", "words"),
    [(60.0, "cogging"), (120.0, "cogging"), (5.0, "offset"), (10.0, "unequal"), (30.0, "ripple"), (2.0, None), (4.5, None)],
)
def test_a_motor_of_5_pole_pairs_and_12_slots_makes_its_own_orders(order, words):
    made = Motor(5, 12).makes(order)
    assert made is None if words is None else words in made


def test_an_order_that_changes_with_load_or_direction_is_the_gear_s():
    loads = [0.0, 2.0, 4.0, 0.0, 2.0, 4.0]
    grows = [Conditions(3.0 + 0.2 * load, 0.02, load, None) for load in loads]
    assert origin_of_order(10.0, Motor(5, 12), grows)[0] == "gear"
    assert origin_of_order(10.0, Motor(), grows)[0] == "gear"
    ways = [Conditions(3.0 + (0.5 if i % 2 else 0.0), 0.02, None, ("forward", "backward")[i % 2]) for i in range(8)]
    assert origin_of_order(10.0, Motor(5, 12), ways)[0] == "gear"


def test_that_it_stays_with_the_load_tells_nothing_for_a_stiff_gear_s_order_stays_too():
    stays = [Conditions(3.0 + 0.01 * (-1) ** i, 0.02, float(2 * (i % 3)), None) for i in range(6)]
    for motor in (Motor(5, 12), Motor(), Motor(5)):
        assert origin_of_order(10.0, motor, stays)[0] == "motor or gear"
    assert origin_of_order(2.0, Motor(5, 12), stays)[0] == "gear", "no order of this motor"
    assert origin_of_order(2.0, Motor(5), stays)[0] == "motor or gear", "without slots nobody knows its cogging"


def test_an_order_beside_the_measured_motion_of_the_motor_is_the_gear_s_whatever_the_numbers():
    assert origin_of_order(10.0, Motor(5, 12), [Conditions(3.0, 0.02, None, None, "motion")])[0] == "gear"
    assert origin_of_order(10.0, Motor(5, 12), [Conditions(0.03, 0.02, None, None, "motion")])[0] == "motor or gear", "not seen"
    little = Conditions(0.17, 0.02, None, None, "motion", over_largest=0.03)
    assert origin_of_order(6.0, Motor(), [little])[0] == "motor or gear", "so much of a motor's torque was seen there"


@pytest.mark.parametrize(
    ("turn", "sigmas", "backward", "name"),
    [(-106.0, 7.0, 0.51, "motor"), (-106.0, 2.0, 0.51, "motor or gear"), (-106.0, 7.0, 1.5, "motor or gear"),
     (6.0, 3.0, 0.5, "gear"), (13.0, 2.8, 0.5, "motor or gear"), (30.0, 9.0, 0.5, "motor or gear")],
)  # fmt: skip
def test_in_the_motor_s_torque_cogging_turns_its_phase_with_the_direction(turn, sigmas, backward, name):
    sides = [OrderSides(10.0, 0.5, backward, 1.0, turn, sigmas)]
    assert origin_of_order(10.0, Motor(), [Conditions(0.5, 0.02, None, None, "torque")], sides)[0] == name


def test_what_speaks_for_both_is_not_told():
    found = [Conditions(3.0, 0.02, None, None, "motion")]
    assert origin_of_order(4.0, Motor(2, 12), found, [OrderSides(4.0, 3.0, 3.0, 0.0, 100.0, 9.0)])[0] == "motor or gear"
