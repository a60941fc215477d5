"""The true gear at an amplitude: against the equations of motion, and beside what is identified."""

import math

import numpy as np
import pytest

from hil.bench.model import Identified, IdentifiedPlant
from hil.control.angles import ARCSEC
from hil.design.ate.gear import GearLaw
from hil.robot_tables import PlantTable
from plant_emulator.physics.axis import PLANT, PLANT_STATE
from plant_emulator.rehearsal.estimates import quantities_of
from plant_emulator.rehearsal.gear import gear_at, gear_plant
from plant_emulator.robots.fleet import antiresonance_hz, draw
from plant_emulator.robots.robot import RobotAxis
from tests.oracles.plant import derivatives
from tests.oracles.records import plain

REAL = draw(8, kind="real")


def followed(axis: RobotAxis, amplitude: float) -> tuple[float, float]:
    """Stiffness and loss from the emulator's own equations: the arm is led to and fro, and its gear's torque is read."""
    steps = 1500
    rows, states = np.zeros(1, dtype=PLANT), np.zeros(1, dtype=PLANT_STATE)
    axis.write(rows[0], 0.0)
    turn = 2.0 * math.pi / steps
    torques = []
    for step in range(3 * steps):
        phase = (step + 0.5) * turn
        speed = -amplitude * math.cos(phase)
        states[0]["arm_angle_rad"], states[0]["arm_speed_rad_s"] = -amplitude * math.sin(phase), speed
        _, acceleration, z_rate, _ = derivatives(plain(rows[0]), plain(states[0]), 0.0, True)
        damping = (axis.arm_damping_nm_s_rad + axis.gear_damping_nm_s_rad) * speed
        torques.append(acceleration * axis.arm_inertia_kg_m2 + damping)
        states[0]["hysteresis_nm"] += z_rate * turn
    last, phase = np.array(torques[-steps:]), (np.arange(steps) + 0.5) * turn
    per = 2.0 / (steps * amplitude)
    return float(per * last @ np.sin(phase)), float(per * last @ np.cos(phase))


@pytest.mark.parametrize("arcsec", [15.0, 60.0, 300.0])
def test_stiffness_and_loss_at_a_torsion_are_those_of_the_equations_of_motion(arcsec: float) -> None:
    axis = next(iter(REAL.axis.values()))
    still = axis.model_copy(update={"gravity_moment_nm": 0.0, "ate": axis.ate.of({}, {})})
    stiffness, loss = gear_at(still, arcsec * ARCSEC)
    expected = followed(still, arcsec * ARCSEC)
    assert stiffness == pytest.approx(expected[0], rel=2e-3)
    assert loss == pytest.approx(expected[1], rel=2e-2)
    assert loss > 0.0


def test_a_gear_that_is_a_spring_has_its_constants_at_any_torsion() -> None:
    axis = next(iter(draw(7, kind="linear").axis.values()))
    assert gear_plant(axis, 40.0) == gear_plant(axis, None)
    assert gear_plant(axis, None).antiresonance_hz == pytest.approx(antiresonance_hz(axis))


def test_a_soft_gear_is_stiffer_where_the_arm_is_heavier() -> None:
    axis = next(iter(REAL.axis.values()))
    heavy = axis.model_copy(update={
        "hysteresis_torque_nm": 0.0, "wind_up_softness": 0.3, "wind_up_torsion_arcsec": 50.0,
        "gravity_moment_nm": axis.gear_stiffness_nm_rad * 200.0 * ARCSEC,
    })  # fmt: skip
    level, upright = (gear_plant(heavy, 10.0, np.full(3, angle)).stiffness_nm_rad for angle in (0.0, 0.5 * math.pi))
    assert level == pytest.approx(axis.gear_stiffness_nm_rad, rel=1e-3)
    assert upright == pytest.approx(0.7 * axis.gear_stiffness_nm_rad, rel=0.02)


def test_without_an_amplitude_there_is_no_gear_at_it() -> None:
    with pytest.raises(ValueError, match="expected an amplitude above 0"):
        gear_at(next(iter(REAL.axis.values())), 0.0)


def test_the_identified_plant_of_a_real_gear_is_compared_with_the_gear_at_the_stated_torsion() -> None:
    """Against the constants of the robot file a right ζ of such a gear was eighteen standard errors off."""
    number, axis = next(iter(REAL.axis.items()))
    there = gear_plant(axis, 60.0)
    values = PlantTable(**{name: getattr(axis, name) for name in PlantTable.model_fields})
    plant = IdentifiedPlant(
        values=values.model_copy(update={"gear_stiffness_nm_rad": there.stiffness_nm_rad}),
        antiresonance_hz=there.antiresonance_hz,
        resonance_hz=there.resonance_hz,
        damping=there.damping,
        torsion_arcsec=60.0,
        standard_error={"damping": 0.01 * there.damping, "antiresonance_hz": 0.001, "gear_stiffness_nm_rad": 1.0},
    )
    model = Identified(robot=REAL.name).with_part(number, plant)
    found = quantities_of(REAL, number, model, None)
    for name in ("damping", "antiresonance_hz", "gear_stiffness_nm_rad"):
        assert found[name].z() == pytest.approx(0.0, abs=1e-6), name
    untold = quantities_of(
        REAL, number, Identified(robot=REAL.name).with_part(number, plant.model_copy(update={"torsion_arcsec": None})), None
    )
    assert abs(untold["damping"].z() or 0.0) > 4.0


@pytest.mark.parametrize("arcsec", [3.0, 40.0, 300.0])
def test_the_fitted_law_of_a_gear_has_its_resonance_and_damping_at_any_torsion(arcsec: float) -> None:
    axis = next(iter(REAL.axis.values()))
    arm, stiffness = axis.arm_inertia_kg_m2, axis.gear_stiffness_nm_rad
    omega, moment = math.sqrt(stiffness / arm), axis.gravity_moment_nm / arm
    home = 0.7
    law = GearLaw(
        omega / (2.0 * math.pi),
        (axis.gear_damping_nm_s_rad + axis.arm_damping_nm_s_rad) / (2.0 * arm * omega),
        softness=axis.wind_up_softness,
        wind_up_rad=axis.wind_up_torsion_arcsec * ARCSEC,
        hysteresis_rad=axis.hysteresis_torque_nm / stiffness,
        hysteresis_torsion_rad=axis.hysteresis_torsion_arcsec * ARCSEC,
        gravity_rad_s2=(moment * math.cos(home), -moment * math.sin(home)),
    )
    turned = np.linspace(-1.0, 1.5, 400)
    true = gear_plant(axis, arcsec, home + turned)
    stiffer = math.sqrt(1.0 - axis.gravity_moment_nm * float(np.mean(np.sin(home + turned))) / true.stiffness_nm_rad)
    hz, damping = law.arm_at(arcsec * ARCSEC, turned)
    assert hz == pytest.approx(true.antiresonance_hz * stiffer, rel=1e-4)
    assert damping == pytest.approx(true.damping / stiffer, rel=5e-3)
