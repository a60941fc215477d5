"""The transmission error found again in simulated ramps, and the arm's response against the closed form."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.control.angles import ARCSEC
from hil.design.ate.identification import identify_one_way
from hil.design.ate.model import Arm, Sensing, Sweep, modelled
from hil.design.frequency import TwoInertia
from hil.design.transmission_error import TransmissionError, shown_error, shown_waves
from hil.robot_tables import Control
from plant_emulator.robots import robot as world
from plant_emulator.studies.simulate import simulate

PERIOD = 0.002
ROBOT = world.load_robot("reference")
NOTHING = TransmissionError({}, {})


def model(axis: int) -> TwoInertia:
    table = ROBOT.axis[axis]
    return TwoInertia(**{name: getattr(table, name) for name in TwoInertia.__dataclass_fields__})


# the P-PI of the reference bench; what the identification must not need to know
GAINS = {2: (0.196, 3.92), 3: (0.0905, 1.81)}


@pytest.fixture(scope="module", params=[2, 3])
def ramp(request):
    """Axis, motor angle, true tip acceleration, rows of the ramp."""
    axis = request.param
    velocity, integral = GAINS[axis]
    control = Control(position_gain_per_s=25.0, velocity_gain_nm_s_rad=velocity, velocity_integral_gain_nm_rad=integral)
    found = simulate(ROBOT, axis, controls={axis: control}, notches={}, sync_period_s=PERIOD)
    angle = found.position_counts[:, 0] * 2.0 * math.pi / ROBOT.axis[axis].encoder_counts_per_rev
    speed = np.gradient(angle, PERIOD) / (2.0 * math.pi)
    rows = (speed > 1.5) & (speed < 9.0) & (found.time_s < 2.6)
    return axis, angle, found.tip_acceleration_m_s2[:, 2], rows


def sensed(tip, seed, noise=0.02):
    return np.round((tip + np.random.default_rng(seed).normal(0.0, noise, len(tip))) / 0.00981) * 0.00981


def apart(first_deg, second_deg):
    return abs((first_deg - second_deg + 180.0) % 360.0 - 180.0)


def fit(ramp, tip, **changes):
    return one_way(ramp, tip, replace(model(ramp[0]), **changes))


def one_way(ramp, tip, plant, lever=None, orders=(2, 4)):
    axis, angle, _, rows = ramp
    sweep = Sweep(angle, tip, PERIOD, rows.astype(np.int8))
    sensing = Sensing(ROBOT.axis[axis].tip_lever_m if lever is None else lever)
    return identify_one_way(sweep, plant.reduction_ratio, sensing, Arm.of(plant), orders)


def response(plant, angle, lever, error):
    return modelled(
        Sweep(angle, angle, PERIOD, np.ones(len(angle), dtype=np.int8)),
        plant.reduction_ratio,
        Sensing(lever),
        Arm.of(plant),
        error,
    )


@pytest.mark.parametrize("seed", range(3))
def test_amplitudes_and_phases_come_back_from_a_noisy_ramp(ramp, seed):
    found, truth = fit(ramp, sensed(ramp[2], seed)), ROBOT.axis[ramp[0]].ate
    for order in (2, 4):
        assert found.error.amplitude_arcsec[order] == pytest.approx(getattr(truth, f"a{order}_arcsec"), rel=0.03)
        assert apart(found.error.phase_deg[order], getattr(truth, f"phi{order}_deg")) < 2.0
    assert found.explained > 0.995
    assert found.arm.resonance_hz == pytest.approx(model(ramp[0]).antiresonance_hz, rel=0.005)


def test_a_wrong_gear_stiffness_is_found_out(ramp):
    plant = model(ramp[0])
    found = fit(ramp, sensed(ramp[2], 1), gear_stiffness_nm_rad=1.15 * plant.gear_stiffness_nm_rad)
    truth = ROBOT.axis[ramp[0]].ate
    assert found.arm.resonance_hz == pytest.approx(plant.antiresonance_hz, rel=0.005)
    assert found.error.amplitude_arcsec[2] == pytest.approx(truth.a2_arcsec, rel=0.03)
    assert apart(found.error.phase_deg[2], truth.phi2_deg) < 2.0


def test_the_standard_errors_are_those_of_the_noise(ramp):
    fits = [fit(ramp, sensed(ramp[2], seed)) for seed in range(24)]
    for order in (2, 4):
        amplitudes = [found.error.amplitude_arcsec[order] for found in fits]
        phases = [found.error.phase_deg[order] for found in fits]
        assert 0.5 < np.mean([f.amplitude_error_arcsec[order] for f in fits]) / np.std(amplitudes) < 2.0
        assert 0.5 < np.mean([f.phase_error_deg[order] for f in fits]) / np.std(phases) < 2.0


def test_order_two_alone_is_worse_than_both(ramp):
    axis, _, tip, _ = ramp
    alone, both = one_way(ramp, tip, model(axis), orders=(2,)), one_way(ramp, tip, model(axis))
    truth = ROBOT.axis[axis].ate.a2_arcsec
    assert abs(alone.error.amplitude_arcsec[2] - truth) > 3.0 * abs(both.error.amplitude_arcsec[2] - truth)


def test_the_model_replays_the_ramp(ramp):
    axis, angle, tip, rows = ramp
    ate = ROBOT.axis[axis].ate
    error = TransmissionError({2: ate.a2_arcsec, 4: ate.a4_arcsec}, {2: ate.phi2_deg, 4: ate.phi4_deg})
    played = response(model(axis), angle, ROBOT.axis[axis].tip_lever_m, error)
    difference = (played - tip)[rows]
    assert np.sqrt(np.mean(difference**2)) < 0.08 * np.std(tip[rows])


def test_a_lever_arm_error_goes_into_the_amplitude(ramp):
    axis, _, tip, _ = ramp
    right, longer = (one_way(ramp, tip, model(axis), times * ROBOT.axis[axis].tip_lever_m) for times in (1.0, 1.1))
    assert longer.error.amplitude_arcsec[2] == pytest.approx(right.error.amplitude_arcsec[2] / 1.1, rel=0.05)


@pytest.mark.parametrize("speed_rps", [2.0, 5.0, 5.92, 8.0])
def test_at_constant_speed_the_response_is_the_closed_form(speed_rps):
    plant, lever = model(2), 0.7
    time = np.arange(0.0, 12.0, PERIOD)
    ramp_s = 1.0
    # rest, a smooth start, then a constant speed; only the transmission error vibrates there
    turned = np.where(
        time < ramp_s, 0.5 * time**2 / ramp_s - ramp_s / (4.0 * np.pi**2) * (1.0 - np.cos(2.0 * np.pi * time)), time - 0.5
    )
    angle = 2.0 * np.pi * speed_rps * turned
    played = response(plant, angle, lever, TransmissionError({2: 5.0}, {2: 40.0}))
    s = 2j * math.pi * 2.0 * speed_rps
    gear = plant.gear_damping_nm_s_rad * s + plant.gear_stiffness_nm_rad
    swing = gear / (plant.arm_inertia_kg_m2 * s**2 + plant.arm_damping_nm_s_rad * s + gear)
    expected = lever * 5.0 * ARCSEC * s**2 * swing * np.exp(1j * (2.0 * angle + math.radians(40.0)))
    steady = (time > 9.0) & (time < 11.5)
    assert np.max(np.abs(played - expected.real)[steady]) < 2e-3 * np.max(np.abs(expected[steady]))


def test_a_rigid_start_gives_the_levers_acceleration():
    time = np.arange(0.0, 3.0, PERIOD)
    played = response(model(2), 0.5 * 25.0 * time**2, 0.7, NOTHING)
    assert np.mean(played[1000:]) == pytest.approx(0.7 * 25.0 / 120.0, rel=0.01)


def test_angle_of_the_error_is_equation_two():
    error = TransmissionError({2: 5.0, 4: 3.0}, {2: 222.0, 4: 126.0})
    theta = np.linspace(0.0, 7.0, 50)
    expected = 5.0 * np.cos(2.0 * theta + math.radians(222.0)) + 3.0 * np.cos(4.0 * theta + math.radians(126.0))
    np.testing.assert_allclose(error.angle_rad(theta) / ARCSEC, expected, atol=1e-12)


def test_what_cannot_be_fitted_is_refused():
    angle, forwards = np.zeros(500), np.ones(500, dtype=np.int8)
    for sweep, words in (
        (Sweep(angle, angle[:-1], PERIOD, forwards), "shapes"),
        (
            Sweep(angle, angle, PERIOD, (np.arange(500) < 10).astype(np.int8)),
            r"0\.02 s of ramps forwards are too short for 7 values",
        ),
    ):
        with pytest.raises(ValueError, match=words):
            identify_one_way(sweep, 120.0, Sensing(0.7), Arm.of(model(2)))


def test_silence_gives_no_amplitude():
    still = np.zeros(2000)
    found = identify_one_way(Sweep(still, still, PERIOD, np.ones(2000, dtype=np.int8)), 120.0, Sensing(0.7), Arm.of(model(2)))
    assert found.error.amplitude_arcsec[2] == 0.0
    assert found.residual == 0.0


def test_waves_are_those_of_the_error_up_to_half_of_the_sampling_rate_and_none_beyond():
    time = PERIOD * np.arange(1000)
    for speed_rps, factor in ((20.0, 1.0), (125.0, 0.0)):  # order 4 at 80 Hz and at 500 Hz; 500 Hz is the sampling rate
        angle = 2.0 * math.pi * speed_rps * time
        found = shown_waves(angle, PERIOD, (4.0,))
        assert found == pytest.approx(factor * np.stack([np.cos(4.0 * angle), -np.sin(4.0 * angle)]))
        error = TransmissionError({4: 10.0}, {4: 30.0})
        assert shown_error(error, angle, PERIOD) == pytest.approx(factor * error.angle_rad(angle))


def test_a_single_sample_has_waves_as_well():
    assert shown_waves(np.zeros(1), PERIOD, (2.0,)) == pytest.approx(np.array([[1.0], [0.0]]))
