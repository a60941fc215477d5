"""A gear that depends on the amplitude: its values hold for the torsion that was measured, their errors say how far beyond."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hil.design.estimate import Estimate
from hil.design.estimation import EstimatedParameter
from hil.design.frequency import TwoInertia
from hil.design.plant_identification import PlantEstimate
from hil.experiments.plant.amplitude import D_M, OPEN, VISCOUS, with_amplitude_dependence, with_slow_turns

PLANT = TwoInertia(100.0, 3e-4, 1e-3, 4.0, 1.0, 2e4, 20.0)


def estimate(f_a_hz: float, damping: float, torsion_rad: float) -> PlantEstimate:
    means = dict.fromkeys((*OPEN, "gear_damping_nm_s_rad", D_M, VISCOUS), 1.0) | {
        "motor_inertia_kg_m2": 3e-4,
        "antiresonance_hz": f_a_hz,
        "damping": damping,
    }
    parameters = {name: EstimatedParameter(value, 2e-4 * value) for name, value in means.items()}
    values = Estimate.independent({name: (each.value, each.standard_error) for name, each in parameters.items()})
    response: Any = None
    return PlantEstimate(PLANT, parameters, values, response, None, 1.0, 10, torsion_rad, 0.8 * torsion_rad, np.zeros(8))


def f_a_error(pilot: PlantEstimate) -> float:
    return with_amplitude_dependence(estimate(10.0, 0.03, 1e-3), pilot)[0].parameters["antiresonance_hz"].relative


def zeta_error(main: PlantEstimate, pilot: PlantEstimate) -> float:
    return with_amplitude_dependence(main, pilot)[0].parameters["damping"].standard_error


def test_hysteresis_widens_each_value_by_its_loss() -> None:
    main, pilot = estimate(10.0, 0.03, 1e-3), estimate(10.0, 0.08, 1e-4)
    loss = (0.08 - 0.03) / 9.0  # in inverse proportion to the torsion, ten times as large here
    wide = with_amplitude_dependence(main, pilot)[0].parameters
    assert wide["damping"].standard_error == pytest.approx(OPEN["damping"] * loss, rel=0.05)
    assert wide["antiresonance_hz"].relative == pytest.approx(OPEN["antiresonance_hz"] * loss, rel=0.05)
    assert wide["motor_inertia_kg_m2"].relative == pytest.approx(OPEN["motor_inertia_kg_m2"] * loss, rel=0.05)


def test_hysteresis_opens_the_arms_part_of_the_damping_and_with_it_the_motors() -> None:
    """D_l of a real gear was 0.64 of D_g + D_l too large by a quarter, and stated 0.04."""
    main, pilot = estimate(10.0, 0.03, 1e-3), estimate(10.0, 0.08, 1e-4)
    loss = (0.08 - 0.03) / 9.0
    wide = with_amplitude_dependence(main, pilot)[0].parameters
    share = OPEN["arm_damping_nm_s_rad"] * 2.0 * loss * math.sqrt(PLANT.gear_stiffness_nm_rad * PLANT.arm_inertia_kg_m2)
    assert wide["arm_damping_nm_s_rad"].standard_error == pytest.approx(share, rel=0.05)
    assert wide[D_M].standard_error == pytest.approx(math.hypot(2e-4, share / PLANT.reduction_ratio**2), rel=1e-3)


def with_dampings(viscous: float, motor: float, errors: tuple[float, float], shared: float) -> PlantEstimate:
    """An estimate whose D_m + D_l/N² and D_m have a covariance, as they have with J_m."""
    main = estimate(10.0, 0.03, 1e-3)
    names = (VISCOUS, D_M, "motor_inertia_kg_m2")
    sizes = np.array([*errors, 6e-8])
    found = {VISCOUS: EstimatedParameter(viscous, errors[0]), D_M: EstimatedParameter(motor, errors[1])}
    values = main.values
    for name, each in found.items():
        values = values.replaced(name, each.value, each.standard_error)
    return replace(
        main, parameters={**main.parameters, **found}, values=values.correlated(names, shared * np.outer(sizes, sizes))
    )


def test_slow_turns_that_hysteresis_does_not_touch_correct_the_motors_damping() -> None:
    """On a real gear D_m was three times too large: 2 % of order 2 remained, and 0.8 % with the slow turns."""
    main = with_dampings(2.1e-3, 1.7e-3, (3e-4, 3.2e-4), 0.9)
    after = with_slow_turns(main, EstimatedParameter(9e-4, 1e-4))
    weight = 3e-4**2 / (3e-4**2 + 1e-4**2)
    assert after.parameters[VISCOUS].value == pytest.approx(2.1e-3 - weight * 1.2e-3)
    assert after.parameters[D_M].value == pytest.approx(1.7e-3 - 0.9 * 3.2 / 3.0 * weight * 1.2e-3)
    assert after.plant.motor_damping_nm_s_rad == after.parameters[D_M].value
    assert after.parameters[D_M].standard_error == pytest.approx(3.2e-4 * math.sqrt(1.0 - 0.9**2 * weight))
    assert after.parameters["motor_inertia_kg_m2"] == main.parameters["motor_inertia_kg_m2"]
    assert np.linalg.eigvalsh(after.values.covariance).min() > -1e-12


def test_slow_turns_that_say_nothing_change_nothing() -> None:
    main = with_dampings(2.1e-3, 1.7e-3, (3e-4, 3.2e-4), 0.9)
    after = with_slow_turns(main, EstimatedParameter(0.0, 1.0))
    assert after.parameters[D_M].value == pytest.approx(1.7e-3, rel=1e-4)
    assert after.parameters[D_M].standard_error == pytest.approx(3.2e-4, rel=1e-4)


def test_what_a_pilot_at_nearly_the_same_torsion_cannot_exclude_is_in_the_error_of_the_damping() -> None:
    """With a pilot at 1.6 of the main run's torsion a ζ that was right but for hysteresis was eight standard errors off."""
    main, far, near = estimate(10.0, 0.05, 1e-3), estimate(10.0, 0.05, 1e-4), estimate(10.0, 0.05, 1.001e-3)
    assert zeta_error(main, far) < 0.001 * 0.05
    assert 0.025 * 0.05 < zeta_error(main, near) < 0.1 * 0.05


def test_inertias_in_which_two_runs_disagree_are_open_by_that() -> None:
    """No torsion changes them: one of the runs is wrong, and none says which."""
    main, pilot = estimate(10.0, 0.03, 1e-3), estimate(10.0, 0.03, 1e-4)
    other = EstimatedParameter(2.4e-4, 1e-6)
    pilot = replace(pilot, parameters={**pilot.parameters, "motor_inertia_kg_m2": other})
    wide, _ = with_amplitude_dependence(main, pilot)
    assert wide.parameters["motor_inertia_kg_m2"].standard_error > 10.0 * main.parameters["motor_inertia_kg_m2"].standard_error
    assert wide.parameters["resonance_hz"].standard_error > main.parameters["resonance_hz"].standard_error
    assert wide.parameters["gear_stiffness_nm_rad"].relative == pytest.approx(2e-4, rel=0.1)


def test_a_linear_gear_keeps_its_errors() -> None:
    assert f_a_error(estimate(10.0, 0.03, 1e-4)) == pytest.approx(2e-4, rel=1e-3)


def test_a_stiffness_that_changes_with_the_torsion_is_open_by_the_sine_that_stands_for_a_noise() -> None:
    """Three soft gears had K_g 1 to 3 % off and stated 0.3 %: a spring's sine is another than a friction's."""
    main, pilot = estimate(10.0, 0.03, 1e-3), estimate(10.1, 0.03, 5e-4)
    for ratio in (0.8, 1.25):
        wide = with_amplitude_dependence(replace(main, spring_torsion_rad=ratio * main.torsion_rad), pilot)[0].parameters
        change = math.log(1.25) * 2.0 * math.log(10.1 / 10.0) / math.log(2.0)
        assert wide["gear_stiffness_nm_rad"].relative == pytest.approx(change, rel=0.05)
        assert wide["antiresonance_hz"].relative == pytest.approx(0.5 * change, rel=0.05)


def test_a_spring_whose_sine_is_that_of_friction_has_no_error_by_its_slope() -> None:
    """On drawn gears f_r lies well above f_a, and the torsion of most runs meets both alike to 15 %."""
    main, pilot = estimate(10.0, 0.03, 1e-3), estimate(10.1, 0.03, 5e-4)
    wide = with_amplitude_dependence(replace(main, spring_torsion_rad=main.torsion_rad), pilot)[0].parameters
    assert wide["antiresonance_hz"].relative == pytest.approx(2e-4, rel=0.01)


def test_a_lag_is_open_by_what_the_motor_inertia_is() -> None:
    main = estimate(10.0, 0.03, 1e-3)
    names, size = ["motor_inertia_kg_m2", "torque_lag_s"], np.array([6e-8, 1e-6])
    values = main.values.with_others({"torque_lag_s": (2e-4, 1e-6)}).correlated(names, 0.9 * np.outer(size, size))
    main = replace(main, values=values, parameters={**main.parameters, "torque_lag_s": EstimatedParameter(2e-4, 1e-6)})
    wide = with_amplitude_dependence(main, estimate(10.0, 0.08, 1e-4))[0].parameters
    widening = wide["motor_inertia_kg_m2"].standard_error / 6e-8
    assert wide["torque_lag_s"].standard_error == pytest.approx(0.9 * widening * 1e-6, rel=0.01)
