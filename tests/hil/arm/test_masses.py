"""Mass matrix, gravity and levers against pinocchio, and arms that cannot be moved."""

import numpy as np
import pinocchio
import pytest
from scipy.linalg import eigh

from hil.arm.bodies import Body
from hil.arm.masses import check_masses, levers, mass_matrix
from tests.hil.arm.arms import any_arm, body, planar_arm
from tests.hil.arm.oracles import pinocchio_model
from tests.oracles.links import gravity_torques

ARMS = {"planar": planar_arm(), "six": any_arm(1, 6), "twelve": any_arm(2, 12)}


@pytest.mark.parametrize("name", ARMS)
def test_mass_matrix_and_gravity_are_those_of_pinocchio(name):
    arm = ARMS[name]
    model = pinocchio_model(arm)
    data, rng = model.createData(), np.random.default_rng(1)
    for _ in range(20):
        q = rng.uniform(-3.0, 3.0, model.nq)
        upper = np.triu(pinocchio.crba(model, data, q))
        want = upper + np.triu(upper, 1).T
        np.testing.assert_allclose(mass_matrix(arm, q), want, atol=1e-12 * np.max(want))
        want = pinocchio.computeGeneralizedGravity(model, data, q)
        np.testing.assert_allclose(gravity_torques(arm, q), want, atol=1e-12 * np.max(np.abs(want)))


def test_levers_are_the_tips_distances_from_the_axes():
    arm = planar_arm()
    np.testing.assert_allclose(levers(arm, arm.home_rad()), [0.465725, 0.492370, 0.13], atol=1e-6)


def test_the_planar_arm_has_the_inertias_of_the_reference_robot_and_rings_with_three_modes():
    arm = planar_arm()
    matrix = mass_matrix(arm, arm.home_rad())
    np.testing.assert_allclose(np.diag(matrix), [8.0, 2.8, 0.16], rtol=1e-6)
    np.testing.assert_allclose([matrix[0, 1], matrix[0, 2], matrix[1, 2]], [-1.71, 0.08, 0.34], atol=0.005)
    np.testing.assert_allclose(gravity_torques(arm, arm.home_rad()), [-68.0, 49.0, 0.0], atol=0.3)
    modes_hz = np.sqrt(eigh(np.diag([48950.0, 16170.0, 5000.0]), matrix, eigvals_only=True)) / (2.0 * np.pi)
    np.testing.assert_allclose(modes_hz, [10.44, 14.73, 36.00], atol=0.005)


def test_an_arm_that_turns_nothing_at_a_joint_is_refused_with_the_link():
    arm = any_arm(1, 3)
    check_masses(arm)
    bare = arm.link[2].model_copy(update={"body": None, "name": "flange"})
    without = arm.model_copy(update={"link": (*arm.link[:2], bare), "payload": None})
    with pytest.raises(ValueError, match=r"link 'flange' \(axis 3\) turns no mass"):
        check_masses(without)
    check_masses(without.model_copy(update={"payload": arm.payload}))
    on_axis = arm.link[2].model_copy(update={"direction": (1.0, 0.0, 0.0), "body": Body(mass_kg=1.0, centre_m=(0.3, 0.0, 0.0))})
    with pytest.raises(ValueError, match="the link of axis 3 turns nothing"):
        check_masses(arm.model_copy(update={"link": (*arm.link[:2], on_axis), "payload": None}))
    twin = arm.link[1].model_copy(update={"axis": 3, "origin_m": (0.0, 0.0, 0.0), "rpy_deg": (0.0, 0.0, 0.0)})
    weightless = arm.link[1].model_copy(update={"body": None})
    alike = arm.model_copy(update={"link": (arm.link[0], weightless, twin), "payload": body(np.random.default_rng(1), 2.0)})
    with pytest.raises(ValueError, match="the link of axis 2 turns nothing at home"):
        check_masses(alike)
