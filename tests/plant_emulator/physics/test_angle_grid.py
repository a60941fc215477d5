"""The form of the equations that runs gives what their plain statement gives; C is held against both elsewhere."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.control.angles import ARCSEC
from plant_emulator.physics.axis import PLANT, PLANT_STATE, hang_at_rest
from plant_emulator.robots.robot import load_robot
from tests.oracles.plant import AxisState, constants, derivatives, grid_point, rates
from tests.oracles.records import plain
from tests.plant_emulator.physics.stepping import plant_step

ROBOT = load_robot("reference")
FIELDS = PLANT_STATE.names[:6]
EVERYTHING = {
    "a1_rad": 20.0 * ARCSEC,
    "phi1_rad": 0.3,
    "a4_rad": 10.0 * ARCSEC,
    "has_more_orders": 1.0,
    "more_orders": (0.5, 3.0, 5.75, 8.0),
    "more_rad": (30.0 * ARCSEC, 20.0 * ARCSEC, 5.0 * ARCSEC, 2.0 * ARCSEC),
    "more_phi_rad": (1.0, -0.7, 2.0, 0.1),
    "is_eccentric": 1.0,
    "joint_orders": (1.0 / 120.0, 2.0 / 120.0, 0.0, 0.0),
    "joint_rad": (40.0 * ARCSEC, 10.0 * ARCSEC, 0.0, 0.0),
    "joint_phi_rad": (0.2, 1.2, 0.0, 0.0),
    "is_cogging": 1.0,
    "cogging_orders": (8.0, 36.0, 72.0, 0.0),
    "cogging_nm": (0.05, 0.02, 0.01, 0.0),
    "cogging_phi_rad": (0.1, 0.7, -1.0, 0.0),
    "gear_reaction": 1.0,
    "wind_up_softness": 0.3,
    "wind_up_torsion_rad": 60.0 * ARCSEC,
    "hysteresis_torque_nm": 3.0,
    "hysteresis_torsion_rad": 20.0 * ARCSEC,
    "current_time_constant_s": 1e-3,
}


def from_grid(p, command, braked, s, away):
    """The rates around grid points that lie so many spacings from the state's own angles."""
    k = constants(p)
    near = grid_point(k)
    for waves, angle in zip(near, (s.motor_angle_rad, s.motor_angle_rad, s.arm_angle_rad), strict=True):
        waves.sums(angle + away * waves.spacing, 0.5)
    at = AxisState(s.motor_angle_rad, s.motor_speed_rad_s, s.arm_angle_rad, s.arm_speed_rad_s, s.hysteresis_nm, s.torque_nm)
    return rates(k, near, command, braked, at, 1.0)


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
    """Within the reach of the polynomials, and beyond it, where another grid point takes over."""
    changes = {
        **EVERYTHING,
        "has_more_orders": float(has_more_orders),
        "is_eccentric": float(has_more_orders),
        "is_cogging": float(has_more_orders),
        "wind_up_softness": softness,
        "hysteresis_torque_nm": hysteresis,
        "current_time_constant_s": lag,
    }
    p, s = records(number, values, **changes)
    got = from_grid(plain(p), command, braked, plain(s), away)
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


def runge_kutta(p, x, command, h):
    """One step of the classical method on `derivatives`; x: θ_m, ω_m, θ_l, ω_l, z, τ."""

    def slopes(x):
        motor, arm, hysteresis, torque = derivatives(p, SimpleNamespace(**dict(zip(FIELDS, x, strict=True))), command, False)
        return np.array([x[1], motor, x[3], arm, hysteresis, torque])

    k1 = slopes(x)
    k2 = slopes(x + 0.5 * h * k1)
    k3 = slopes(x + 0.5 * h * k2)
    return x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + slopes(x + h * k3))


def test_a_run_is_that_of_classical_runge_kutta_on_the_plain_equations():
    """A second with all that an axis can have, by the sines of the library: both differ by roundings alone."""
    p, s = records(2, [0.0] * 6, **EVERYTHING)
    hang_at_rest(p, s)
    axis, reference = plain(p), np.array([float(s[name]) for name in FIELDS])
    for n in range(4000):
        command = 0.3 + 0.5 * math.sin(0.003 * n)
        plant_step(p, s, command, False, 250e-6, 2)
        for _ in range(2):
            reference = runge_kutta(axis, reference, command, 125e-6)
    assert abs(reference[0]) > 20.0
    np.testing.assert_allclose([float(s[name]) for name in FIELDS], reference, rtol=1e-11)
