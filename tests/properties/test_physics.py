"""What the axis keeps for every state and every torque."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.control.angles import ARCSEC
from plant_emulator.physics.axis import PLANT, PLANT_STATE, synchronous_error
from plant_emulator.robots.robot import load_robot
from tests.plant_emulator.physics.stepping import plant_step

ROBOT = load_robot("reference")
T = 250e-6
relaxed = settings(max_examples=60)  # the first call compiles

numbers = st.sampled_from([2, 3, 5])
states = st.tuples(st.floats(-20.0, 20.0), st.floats(-60.0, 60.0), st.floats(-0.002, 0.002), st.floats(-0.5, 0.5))
commands = st.lists(st.floats(-7.0, 7.0), min_size=1, max_size=60)


def axis(number, **changes):
    plant = np.zeros(1, PLANT)
    ROBOT.axis[number].write(plant[0], ROBOT.home_angle(number))
    for name, value in changes.items():
        plant[0][name] = value
    return plant


def at(plant, motor_angle, motor_speed, torsion, rate):
    """A state by its torsion, so that the gear is loaded as gears are."""
    p, state = plant[0], np.zeros(1, PLANT_STATE)
    value, slope = synchronous_error(p, motor_angle)
    arm = motor_angle / p["reduction_ratio"] + value - torsion
    arm_speed = motor_speed * (1.0 / p["reduction_ratio"] + slope) - rate
    state[0] = (motor_angle, motor_speed, arm, arm_speed, 0.0, 0.0, 0.0)
    return state


def energy(plant, state):
    p, s = plant[0], state[0]
    torsion = s["motor_angle_rad"] / p["reduction_ratio"] + synchronous_error(p, s["motor_angle_rad"])[0] - s["arm_angle_rad"]
    return 0.5 * (
        p["motor_inertia_kg_m2"] * s["motor_speed_rad_s"] ** 2
        + p["arm_inertia_kg_m2"] * s["arm_speed_rad_s"] ** 2
        + p["gear_stiffness_nm_rad"] * torsion**2
    ) + p["gravity_moment_nm"] * math.sin(s["arm_angle_rad"] + p["home_angle_rad"])


@pytest.mark.slow
@relaxed
@given(numbers, states, st.booleans(), st.floats(0.0, 300.0), st.floats(0.0, 7.0))
def test_energy_never_grows_without_input(number, start, gravity, arcsec, phase):
    changes = {"a2_rad": arcsec * ARCSEC, "phi2_rad": phase, "gear_reaction": 1.0}
    plant = axis(number, **changes, **({} if gravity else {"gravity_moment_nm": 0.0}))
    state = at(plant, *start)
    begin = before = energy(plant, state)
    swing = abs(begin) + plant[0]["gravity_moment_nm"]
    for _ in range(200):
        plant_step(plant[0], state[0], 0.0, False, T, 4)
        now = energy(plant, state)
        # the arithmetic's own error: Runge-Kutta on the friction's turn at standstill
        assert now <= before + 1e-6 * swing + 1e-12
        before = now


@relaxed
@given(numbers, states, commands, st.integers(-20, 20))
def test_whole_motor_revolutions_further_the_motion_is_the_same(number, start, torques, revolutions):
    """Without gravity nothing but the transmission error knows the angle, and that repeats every revolution."""
    plant = axis(number, gravity_moment_nm=0.0, a1_rad=10.0 * ARCSEC)
    here, there = at(plant, *start), at(plant, *start)
    shift = 2.0 * math.pi * revolutions
    there[0]["motor_angle_rad"] += shift
    there[0]["arm_angle_rad"] += shift / plant[0]["reduction_ratio"]
    for torque in torques:
        plant_step(plant[0], here[0], torque, False, T, 4)
        plant_step(plant[0], there[0], torque, False, T, 4)
    scale = 1.0 + np.abs([here[0][name] for name in PLANT_STATE.names])
    wanted = np.array([here[0][name] for name in PLANT_STATE.names])
    got = np.array([there[0][name] for name in PLANT_STATE.names])
    got[0] -= shift
    got[2] -= shift / plant[0]["reduction_ratio"]
    np.testing.assert_allclose((got - wanted) / scale, 0.0, atol=1e-8)


@relaxed
@given(numbers, states, commands)
def test_the_mirrored_torque_gives_the_mirrored_motion_of_an_axis_without_gravity_and_error(number, start, torques):
    plant = axis(number, gravity_moment_nm=0.0, a2_rad=0.0, a4_rad=0.0, hysteresis_torque_nm=0.5)
    plant[0]["hysteresis_torsion_rad"] = 20.0 * ARCSEC
    one, other = at(plant, *start), at(plant, *(-value for value in start))
    for torque in torques:
        plant_step(plant[0], one[0], torque, False, T, 4)
        plant_step(plant[0], other[0], -torque, False, T, 4)
    for name in PLANT_STATE.names:
        assert abs(one[0][name] + other[0][name]) <= 1e-9 * (1.0 + abs(one[0][name])), name


@relaxed
@given(numbers, states, commands)
def test_halving_the_substep_leaves_the_motion_as_it_is(number, start, torques):
    plant = axis(number)
    share = ROBOT.axis[number].torque_limit_nm / 7.0
    coarse, fine = at(plant, *start), at(plant, *start)
    for torque in (share * each for each in torques):
        plant_step(plant[0], coarse[0], torque, False, T, 4)
        plant_step(plant[0], fine[0], torque, False, T, 8)
    # the motor sticks a fraction of a substep earlier or later, at each reversal
    reversals = sum(a * b < 0.0 for a, b in pairwise(torque for torque in torques if torque))
    for name, tolerance in (
        ("motor_angle_rad", 2e-4 * max(1, reversals)),
        ("motor_speed_rad_s", 0.1),
        ("arm_angle_rad", 1e-6),
        ("arm_speed_rad_s", 3e-4),
    ):
        assert abs(coarse[0][name] - fine[0][name]) <= tolerance, name


@relaxed
@given(numbers, states, commands, st.floats(0.0, 0.9), st.floats(0.0, 5.0), st.sampled_from([0.0, 1e-3]), st.booleans())
def test_every_motion_is_finite_and_a_brake_keeps_the_motor_where_it_is(
    number, start, torques, softness, hysteresis, lag, braked
):
    plant = axis(
        number,
        wind_up_softness=softness,
        hysteresis_torque_nm=hysteresis,
        hysteresis_torsion_rad=20.0 * ARCSEC,
        current_time_constant_s=lag,
        gear_reaction=1.0,
    )
    state = at(plant, *start)
    for torque in torques:
        plant_step(plant[0], state[0], torque, braked, T, 4)
    values = np.array([state[0][name] for name in PLANT_STATE.names])
    assert np.all(np.isfinite(values))
    assert abs(state[0]["hysteresis_nm"]) <= hysteresis * (1.0 + 1e-3)
    if braked:
        assert (state[0]["motor_angle_rad"], state[0]["motor_speed_rad_s"], state[0]["torque_nm"]) == (start[0], 0.0, 0.0)
