"""Checks of a plant's estimate: each says what binds."""

from types import SimpleNamespace

import numpy as np
import pytest

from hil.design.estimation import EstimatedParameter
from hil.experiments.plant.checks import estimate_checks, travel_check
from hil.experiments.plant.motion import PlantRequest


def checks_of(f_r_hz, f_a_error_hz=0.2, high_hz=None, motor_error=0.07):
    parameters = {
        "antiresonance_hz": EstimatedParameter(30.0, f_a_error_hz),
        "gear_stiffness_nm_rad": EstimatedParameter(1e4, 200.0),
        "resonance_hz": EstimatedParameter(f_r_hz, 1.0),
        "motor_inertia_kg_m2": EstimatedParameter(1.0, motor_error),
    }
    estimate = SimpleNamespace(parameters=parameters, response=SimpleNamespace(frequency_hz=np.array([2.0, 50.0])))
    return estimate_checks(estimate, 0.5, PlantRequest(2, high_hz=high_hz), "speed")


@pytest.mark.parametrize(("high_hz", "advice"), [(None, "a shorter SYNC period carries more"), (50.0, "raise --high-hz")])
def test_a_resonance_beyond_the_band_is_named_and_not_a_standard_error_that_is_small_enough(high_hz, advice):
    failed = [check for check in checks_of(63.8, high_hz=high_hz) if not check.holds]
    assert [check.sentence for check in failed] == [
        f"standard error of J_m, since f_r (63.8 Hz) is beyond the band (50 Hz): 7 % (at most 5 %); {advice}"
    ]


def test_a_resonance_beyond_the_band_will_do_where_the_motors_inertia_is_known():
    assert all(check.holds for check in checks_of(63.8, motor_error=0.04))


@pytest.mark.parametrize("f_r_hz", [45.0, 54.0])
def test_a_resonance_in_the_band_or_just_above_it_is_no_cause(f_r_hz):
    assert all(check.holds for check in checks_of(f_r_hz))
    failed = [check.name for check in checks_of(f_r_hz, f_a_error_hz=0.6) if not check.holds]
    assert failed == ["standard error of f_a from noise alone"]


@pytest.mark.parametrize(
    ("factor", "words"), [(0.5, "0.5 (at least 0.8)"), (0.9, None), (1.2, None), (1.4, "1.4 (at most 1.25)")]
)
def test_a_motor_that_turns_too_little_or_too_far_is_told_the_bound_that_it_misses(factor, words):
    wanted = np.linspace(0.0, 2.0, 50)
    check = travel_check(factor * wanted, wanted, "in slow turns")
    assert check.holds is (words is None)
    assert words is None or f"shows in slow turns: {words}" in check.sentence
