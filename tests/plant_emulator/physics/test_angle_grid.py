"""The form of the equations that runs gives what their plain statement gives; C is held against both elsewhere."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.control.angles import ARCSEC
from plant_emulator.physics.axis import PLANT, PLANT_STATE
from plant_emulator.robots.robot import load_robot
from tests.oracles.plant import ARM_GRID_RAD, MOTOR_GRID_RAD, AxisState, constants, derivatives, grid_point, nearest, rates
from tests.oracles.records import plain

ROBOT = load_robot("reference")
FIELDS = PLANT_STATE.names[:6]


def from_grid(p, command, braked, s, motor_away, arm_away):
    """The rates around a grid point that lies this far from the state's own angles."""
    k = constants(p)
    near = nearest(k, s.motor_angle_rad + motor_away, s.arm_angle_rad + arm_away)
    at = AxisState(s.motor_angle_rad, s.motor_speed_rad_s, s.arm_angle_rad, s.arm_speed_rad_s, s.hysteresis_nm, s.torque_nm)
    return rates(k, near, command, braked, at)


def own_angles(p, motor, arm):
    """Motor and arm angle that a grid point holds."""
    near = grid_point(constants(p), motor, arm)
    return near.motor, near.arm


def records(number, values, **changes):
    plant, state = np.zeros(1, PLANT), np.zeros(1, PLANT_STATE)
    ROBOT.axis[number].write(plant[0], ROBOT.home_angle(number))
    for name, value in changes.items():
        plant[0][name] = value
    for name, value in zip(FIELDS, values, strict=True):
        state[0][name] = value
    return plant[0], state[0]


speeds, torques = st.one_of(st.just(0.0), st.floats(-80.0, 80.0)), st.floats(-5.0, 5.0)
states = st.tuples(st.floats(-1e3, 1e3), speeds, st.floats(-3.0, 3.0), speeds, torques, torques)


@pytest.mark.ci
@settings(max_examples=300)
@given(
    st.sampled_from([2, 3, 5]),
    states,
    torques,
    st.booleans(),
    st.floats(0.0, 0.9),
    st.sampled_from([0.0, 3.0]),
    st.sampled_from([0.0, 1e-3]),
    st.floats(-3.0, 3.0),
    st.booleans(),
)
def test_rates_around_any_grid_point_are_those_of_the_plain_equations(
    number, values, command, braked, softness, hysteresis, lag, away, has_more_orders
):
    """Within the polynomials' bounds, and beyond them, where the library's sine takes over."""
    changes = {
        "a1_rad": 20.0 * ARCSEC,
        "phi1_rad": 0.3,
        "a4_rad": 10.0 * ARCSEC,
        "has_more_orders": float(has_more_orders),
        "more_orders": (0.5, 3.0, 5.75, 8.0),
        "more_rad": (30.0 * ARCSEC, 20.0 * ARCSEC, 5.0 * ARCSEC, 2.0 * ARCSEC),
        "more_phi_rad": (1.0, -0.7, 2.0, 0.1),
        "is_eccentric": float(has_more_orders),
        "joint_orders": (1.0 / 120.0, 2.0 / 120.0, 0.0, 0.0),
        "joint_rad": (40.0 * ARCSEC, 10.0 * ARCSEC, 0.0, 0.0),
        "joint_phi_rad": (0.2, 1.2, 0.0, 0.0),
        "is_cogging": float(has_more_orders),
        "cogging_orders": (8.0, 36.0, 72.0, 0.0),
        "cogging_nm": (0.05, 0.02, 0.01, 0.0),
        "cogging_phi_rad": (0.1, 0.7, -1.0, 0.0),
        "gear_reaction": 1.0,
        "wind_up_softness": softness,
        "wind_up_torsion_rad": 60.0 * ARCSEC,
        "hysteresis_torque_nm": hysteresis,
        "hysteresis_torsion_rad": 20.0 * ARCSEC,
        "current_time_constant_s": lag,
    }
    p, s = records(number, values, **changes)
    got = from_grid(plain(p), command, braked, plain(s), away * MOTOR_GRID_RAD, away * ARM_GRID_RAD)
    expected = derivatives(plain(p), plain(s), command, braked)
    # what the gear carries is the scale: torsions here are far beyond those of a gear, and their last digits with them
    load = p["gear_stiffness_nm_rad"] * (abs(s["motor_angle_rad"]) / p["reduction_ratio"] + abs(s["arm_angle_rad"]) + 1.0)
    turning = p["gear_damping_nm_s_rad"] * (abs(s["motor_speed_rad_s"]) + abs(s["arm_speed_rad_s"]))
    inertias = (p["motor_inertia_kg_m2"] * p["reduction_ratio"], p["arm_inertia_kg_m2"])
    for place, inertia in enumerate(inertias):
        assert abs(got[place] - expected[place]) <= 1e-12 * (load + turning) / inertia
    rate = abs(s["motor_speed_rad_s"]) + abs(s["arm_speed_rad_s"]) + 1.0
    assert abs(got[2] - expected[2]) <= 1e-12 * rate * (hysteresis + abs(s["hysteresis_nm"])) / p["hysteresis_torsion_rad"]
    assert math.isclose(got[3], expected[3], rel_tol=1e-14)


def test_a_grid_point_holds_the_angles_that_it_was_made_for():
    p, _ = records(2, [0.0] * 6)
    assert own_angles(plain(p), 1.25, -0.5) == (1.25, -0.5)
