"""What is known of an axis before its transmission error is identified: where the accelerometer's delay is searched."""

from dataclasses import replace

import pytest

from hil.bench.model import Identified, IdentifiedPlant
from hil.design.ate.model import DELAY_S
from hil.experiments.ate.request import NEARLY, Goal, axis_knowledge, searched_delay_s, sensing_of
from hil.results.ate import AteResult
from hil.robot_tables import PlantTable
from tests.hil.experiments.ate.ate_rig import AXIS, blank_bench, built
from tests.hil.experiments.ate.test_checks import GOOD, values

PLANT = IdentifiedPlant(
    values=PlantTable(
        motor_inertia_kg_m2=2.6e-4, motor_damping_nm_s_rad=0.0, arm_inertia_kg_m2=1.1, arm_damping_nm_s_rad=6.0,
        gear_stiffness_nm_rad=43000.0, gear_damping_nm_s_rad=40.0,
    ),
    standard_error={"accelerometer_delay_s": 5e-5}, antiresonance_hz=31.25, resonance_hz=40.0, damping=0.04,
    accelerometer_delay_s=0.007,
)  # fmt: skip


def plant(**changes):
    return PLANT.model_copy(update=changes)


def test_a_plant_leaves_one_branch_of_the_delay_to_be_searched():
    assert searched_delay_s(PLANT) == pytest.approx((-0.001, 0.015)), "a quarter of a period to either side"
    assert searched_delay_s(plant(antiresonance_hz=5.0)) == pytest.approx((-0.003, 0.017)), "and 10 ms at most"


def test_a_plant_that_does_not_tell_the_delay_bounds_no_search():
    assert searched_delay_s(None) == DELAY_S
    assert searched_delay_s(plant(accelerometer_delay_s=None)) == DELAY_S
    assert searched_delay_s(plant(standard_error={})) == DELAY_S
    assert searched_delay_s(plant(standard_error={"accelerometer_delay_s": 2e-3})) == DELAY_S
    assert searched_delay_s(plant(accelerometer_delay_s=0.045)) == DELAY_S, "beyond what is believed of a sensor"


def test_the_delay_of_the_model_file_reaches_the_fit_of_the_tip_and_not_that_of_the_torque():
    bench = blank_bench(built())
    known = axis_knowledge(bench, AXIS, Identified(robot=bench.name).with_part(AXIS, PLANT), sensorless=False)
    tip, torque = (sensing_of(bench, AXIS, known, sensorless=sensorless) for sensorless in (False, True))
    assert (tip.delay_from_s, tip.delay_to_s) == pytest.approx((-0.001, 0.015))
    assert (torque.delay_from_s, torque.delay_to_s) == DELAY_S


@pytest.mark.parametrize(("sensorless", "fraction"), [(True, 0.02), (False, 0.0)])
def test_the_error_of_the_arms_inertia_goes_into_amplitudes_from_the_torque_alone(sensorless, fraction):
    bench, inertia = blank_bench(built()), PLANT.values.arm_inertia_kg_m2
    known = Identified(robot=bench.name).with_part(AXIS, plant(standard_error={"arm_inertia_kg_m2": 0.02 * inertia}))
    assert axis_knowledge(bench, AXIS, known, sensorless=sensorless).arm_inertia_fraction == pytest.approx(fraction)


@pytest.mark.parametrize(("times", "is_usable"), [(1.5, True), (2.9, True), (3.1, False)])
def test_standard_errors_are_a_result_up_to_three_times_what_is_asked(times, is_usable):
    amplitude, goal = GOOD.error.amplitude_arcsec[2], Goal({2: 0.01}, {2: 90.0})
    found = goal.missed(replace(GOOD, values=values(times * 0.01 * amplitude)))
    assert [miss.is_usable for miss in found if miss.name == "A_2"] == [is_usable]


def test_the_result_says_how_far_the_goal_may_be_missed():
    assert f"at most {NEARLY:g} times what is asked" in " ".join((AteResult.__doc__ or "").split())
