"""Masses of the reference arm from the modes of some postures: dips elsewhere, their standard errors, and too few postures."""

import math

import numpy as np
import pytest
from scipy import linalg

from hil.arm.kinematics import Kinematics
from hil.arm.masses import mass_matrix
from hil.arm.regressor import made_up_masses, regressor, workspace
from hil.design.coupled.masses import FeltMode, TooFewPosturesError, base_of, fit_masses
from plant_emulator.robots.robot import load_robot
from tests.hil.arm.arms import any_arm
from tests.oracles.links import link_masses

ROBOT = load_robot("reference-arm")
ARM = ROBOT.arm
KINEMATICS = Kinematics.of(ARM)
AXES = (2, 3, 5)
ROWS = [ARM.axes.index(axis) for axis in AXES]
GEARS = np.diag([ROBOT.axis[axis].gear_stiffness_nm_rad for axis in AXES])
HOME = ARM.home_rad()
OTHERS = ((0.0, 0.0, 0.0), (35.0, 50.0, -40.0), (-30.0, 20.0, 45.0))
"""Turns of axes 2, 3 and 5 from home in degrees."""


def turned(degrees):
    joints = HOME.copy()
    joints[ROWS] += np.radians(degrees)
    return joints


def of(joints):
    """Y of the three axes, the others standing at home; shape (..., 3, 3, parameters)."""
    return regressor(KINEMATICS, joints)[..., ROWS, :, :][..., :, ROWS, :]


def true_modes(joints):
    inertia = mass_matrix(ARM, joints)[np.ix_(ROWS, ROWS)]
    squares, shapes = linalg.eigh(GEARS, inertia)
    return np.sqrt(squares) / (2.0 * math.pi), (inertia @ shapes) ** 2


def everywhere(count=60):
    low, high = HOME.copy(), HOME.copy()
    low[ROWS] -= np.radians(60.0)
    high[ROWS] += np.radians(60.0)
    return workspace(low, high, count)


def felt_in(postures, seed=None, dip=0.003, inertia=0.01, axes=(0, 1, 2)):
    """What identifications in some postures tell, with relative errors where a seed is given."""
    noise = np.random.default_rng(seed)
    found = []
    for number, posture in enumerate(postures):
        dips, inertias = true_modes(turned(posture))
        for joint in axes:
            whole = float(np.sum(inertias[joint]))
            for hz, size in zip(dips, inertias[joint], strict=True):
                off = noise.standard_normal(2) if seed is not None else np.zeros(2)
                found.append(FeltMode(number, joint, hz * (1.0 + dip * off[0]), 0.0, size + inertia * whole * off[1], 0.0))
    return found


def fitted(postures=OTHERS, **options):
    at = of(np.array([turned(posture) for posture in postures]))
    return fit_masses(at, felt_in(postures, **options), of(everywhere()), made_up_masses(KINEMATICS))


@pytest.mark.parametrize("arm", [ARM, any_arm(3, 5)])
def test_the_mass_matrix_is_linear_in_the_masses_of_the_links(arm):
    joints = np.random.default_rng(5).uniform(-2.0, 2.0, (4, len(arm.link)))
    found = regressor(Kinematics.of(arm), joints) @ link_masses(arm)
    for each, angles in zip(found, joints, strict=True):
        np.testing.assert_allclose(each, mass_matrix(arm, angles), rtol=1e-9, atol=1e-9)


def test_three_parallel_axes_show_seven_combinations_of_their_masses():
    """A planar chain: inertia about each joint, and two first moments of each link but the first."""
    assert base_of(of(everywhere())).shape[1] == 7


def test_three_postures_without_errors_predict_every_other():
    found = fitted()
    assert found.misfit < 1e-3
    joints = everywhere(20)
    np.testing.assert_allclose(found.dips_hz(of(joints))[0], [true_modes(each)[0] for each in joints], rtol=1e-4)
    np.testing.assert_allclose(found.stiffness_nm_rad, np.diag(GEARS), rtol=1e-4)
    matrix = of(joints[0]) @ found.masses
    np.testing.assert_allclose(matrix, mass_matrix(ARM, joints[0])[np.ix_(ROWS, ROWS)], rtol=1e-3, atol=1e-3)


@pytest.mark.slow
def test_what_is_predicted_is_off_by_its_standard_error_no_more_and_no_less():
    """Over seeds: dips 0.3 % and inertias 1 % off; a fourth posture, and postures between."""
    joints = np.array([turned((20.0, -30.0, 10.0)), turned((31.4, 45.9, -14.5)), turned((10.0, 25.0, 5.0))])
    true = np.array([true_modes(each)[0] for each in joints])
    off, sizes = [], []
    for seed in range(8):
        values, errors = fitted(seed=seed).dips_hz(of(joints))
        off.append((values - true) / errors)
        sizes.append(np.abs(values / true - 1.0))
        assert np.all(errors < 0.015 * true)
    assert 0.6 < float(np.sqrt(np.mean(np.square(off)))) < 1.3
    assert float(np.max(sizes)) < 0.02


def test_postures_that_differ_in_one_joint_alone_do_not_do_and_one_more_is_named_that_does():
    alike = ((0.0, 0.0, 0.0), (20.0, 0.0, 0.0), (40.0, 0.0, 0.0))  # the shoulder: the inertias behind it do not change
    with pytest.raises(TooFewPosturesError, match="combinations of masses and gears") as caught:
        fitted(alike)
    error = caught.value
    assert error.known < error.needed == 10
    added = tuple(np.degrees(everywhere()[error.best] - HOME)[ROWS].tolist())
    try:
        found = fitted((*alike, added))
    except TooFewPosturesError as still:
        added_too = tuple(np.degrees(everywhere()[still.best] - HOME)[ROWS].tolist())
        found = fitted((*alike, added, added_too))
    np.testing.assert_allclose(found.dips_hz(of(everywhere(5)))[0], [true_modes(each)[0] for each in everywhere(5)], rtol=1e-3)


def test_a_wrong_measurement_shows_as_misfit_and_enlarges_the_errors():
    right, wrong = fitted(seed=1), felt_in(OTHERS, seed=1)
    first = wrong[0]
    wrong[0] = FeltMode(first.posture, first.joint, 1.1 * first.frequency_hz, 0.0, first.inertia_kg_m2, 0.0)
    at = of(np.array([turned(posture) for posture in OTHERS]))
    found = fit_masses(at, wrong, of(everywhere()), made_up_masses(KINEMATICS))
    assert found.misfit > 2.0 * right.misfit
    joints = everywhere(3)
    assert np.all(found.dips_hz(of(joints))[1] > right.dips_hz(of(joints))[1])
