"""How many modes an arm rings with, from spectra made of a mass matrix: three links on elastic gears, all motors but one held."""

import math

import numpy as np
import pytest

from hil.design.frequency import TwoInertia
from hil.design.modes.fit import fit_modes, resonances_hz
from hil.design.modes.problem import ArmMode, modal_angle, modal_tip
from hil.design.plant_identification import PlantEstimate, fit_plant
from hil.design.plant_problem import SamplingTiming, angle_response, tip_response
from hil.design.plant_spectra import Spectra

MASSES = np.array([[8.00, -1.71, 0.08], [-1.71, 2.80, 0.34], [0.08, 0.34, 0.16]])  # the reference arm's axes 2, 3, 5
GEARS = np.array([48_600.0, 16_170.0, 5_000.0])
LEVERS = np.array([0.466, 0.357, 0.13])
RATIO, MOTOR, VISCOUS, LEVER_M = 100.0, 1.2e-4, 4e-4, 0.357
SYNC_S, PERIODS = 0.002, 6
AXIS = 1


def compliance(frequency_hz: np.ndarray, masses: np.ndarray = MASSES) -> tuple[np.ndarray, np.ndarray]:
    """Motor angle per torque, and tip acceleration per motor angle, from the equations of motion of links and motor."""
    angle, tip = [], []
    joint = np.eye(len(masses))[AXIS]
    for s in 2j * math.pi * frequency_hz:
        gears = np.diag(GEARS[: len(masses)] * (1.0 + 8e-4 * s))
        turned = np.linalg.solve(masses * s**2 + gears, gears @ joint / RATIO)  # joints per motor angle
        load = (gears @ (joint / RATIO - turned))[AXIS] / RATIO
        angle.append(1.0 / (MOTOR * s**2 + VISCOUS * s + load))
        tip.append(s**2 * (LEVERS[: len(masses)] @ turned))
    return np.array(angle), np.array(tip)


def measured(masses: np.ndarray = MASSES, seed: int = 5) -> Spectra:
    lines = np.arange(4, 54) * 1.0
    draw = np.random.default_rng(seed)
    angle, tip = compliance(lines, masses)
    jw = 2j * math.pi * lines
    excitation = 0.05 * np.exp(2j * math.pi * draw.uniform(size=len(lines)))
    late = np.exp(-jw * SYNC_S)
    felt = excitation * (1.0 - late) / (jw * SYNC_S)  # a torque offset that is held, and no loop

    def periods(values: np.ndarray, noise: float) -> np.ndarray:
        scatter = draw.normal(size=(2, PERIODS, len(lines)))
        return values + noise * (scatter[0] + 1j * scatter[1])

    reported = felt - excitation * ((1.0 - late) / (jw * SYNC_S) - late)
    turned = angle * felt
    return Spectra(
        lines, np.tile(excitation, (PERIODS, 1)), periods(turned, 2e-6), periods(reported, 1e-5), periods(tip * turned, 2e-3)
    )


def fitted(data: Spectra) -> tuple[PlantEstimate, PlantEstimate]:
    timing = SamplingTiming(SYNC_S, 250e-6, "torque", None)
    single = fit_plant(data, timing, RATIO, LEVER_M)
    return single, fit_modes(data, timing, RATIO, LEVER_M, 0.0, single)


@pytest.mark.slow
def test_three_links_ring_with_the_modes_of_their_mass_matrix_and_the_motor_is_known() -> None:
    single, found = fitted(measured())
    clamped_hz = np.sort(1.0 / np.sqrt(np.linalg.eigvalsh(MASSES / np.sqrt(np.outer(GEARS, GEARS))))) / (2.0 * math.pi)
    assert len(found.modes) == 3
    for mode, hz in zip(found.modes, clamped_hz, strict=True):
        assert mode.antiresonance_hz.value == pytest.approx(hz, rel=3e-3)
        assert abs(mode.antiresonance_hz.value - hz) < 4.0 * mode.antiresonance_hz.standard_error
    assert found.plant.motor_inertia_kg_m2 == pytest.approx(MOTOR, rel=0.01)
    assert abs(found.plant.motor_inertia_kg_m2 - MOTOR) < 4.0 * found.parameters["motor_inertia_kg_m2"].standard_error
    assert sum(mode.inertia_kg_m2.value for mode in found.modes) == pytest.approx(MASSES[AXIS, AXIS], rel=0.01)
    parts = [mode.tip_part.value for mode in found.modes if mode.tip_part is not None]
    assert sum(parts) == pytest.approx(1.0)
    assert found.parameters["lever_ratio"].value == pytest.approx(1.0, abs=0.02)
    assert found.misfit < 2.0 < single.misfit
    assert found.plant.antiresonance_hz == pytest.approx(clamped_hz[0], rel=3e-3)  # the leading one, as a plant of its own


@pytest.mark.slow
def test_one_link_has_one_mode_and_the_very_same_plant() -> None:
    alone = np.diag(np.diag(MASSES))
    single, found = fitted(measured(alone))
    assert found is single
    assert found.modes == ()
    assert found.plant.motor_inertia_kg_m2 == pytest.approx(MOTOR, rel=0.01)


def test_one_mode_is_motor_and_arm_on_a_gear() -> None:
    frequency, plant = np.geomspace(2.0, 90.0, 60), TwoInertia(RATIO, MOTOR, VISCOUS, 2.8, 0.0, 16_170.0, 13.5)
    damping = 0.5 * 13.5 / math.sqrt(2.8 * 16_170.0)
    mode = ArmMode(2.8, plant.antiresonance_hz, damping, 1.0)
    np.testing.assert_allclose(modal_angle(plant, [mode], frequency), angle_response(plant, frequency), rtol=1e-12)
    expected = tip_response(plant, frequency, LEVER_M, 1e-3)
    np.testing.assert_allclose(modal_tip(plant, [mode], frequency, LEVER_M, 1e-3), expected, rtol=1e-12)
    assert resonances_hz(MOTOR, RATIO, [mode]) == pytest.approx([plant.resonance_hz])
