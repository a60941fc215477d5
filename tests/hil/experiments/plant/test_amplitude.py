"""A gear that depends on the amplitude: its values hold for the torsion that was measured, their errors say how far beyond."""

from typing import Any

import numpy as np
import pytest

from hil.design.estimation import EstimatedParameter
from hil.design.frequency import TwoInertia
from hil.design.plant_identification import PlantEstimate
from hil.experiments.plant.amplitude import PART, with_amplitude_dependence

PLANT = TwoInertia(100.0, 3e-4, 1e-3, 4.0, 1.0, 2e4, 20.0)


def estimate(f_a_hz: float, damping: float, torsion_rad: float) -> PlantEstimate:
    values = dict.fromkeys(PART, 1.0) | {"motor_inertia_kg_m2": 3e-4, "antiresonance_hz": f_a_hz, "damping": damping}
    parameters = {name: EstimatedParameter(value, 2e-4 * value) for name, value in values.items()}
    response: Any = None
    return PlantEstimate(PLANT, parameters, response, None, 1.0, 10, torsion_rad, np.zeros(8))


def f_a_error(pilot: PlantEstimate) -> float:
    return with_amplitude_dependence(estimate(10.0, 0.03, 1e-3), pilot)[0].parameters["antiresonance_hz"].relative


def test_hysteresis_that_a_soft_wind_up_hides_from_f_a_widens_it_by_its_loss() -> None:
    assert f_a_error(estimate(10.0, 0.08, 1e-4)) == pytest.approx(np.hypot(0.002, 0.1 * 0.05), rel=0.01)


def test_f_a_of_a_gear_that_is_softer_at_small_torsions_is_open_by_its_operating_point() -> None:
    assert f_a_error(estimate(9.95, 0.03, 1e-4)) >= 0.002


def test_a_linear_gear_keeps_its_errors() -> None:
    assert f_a_error(estimate(10.0, 0.03, 1e-4)) == pytest.approx(2e-4)
