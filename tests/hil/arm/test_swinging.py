"""Modes of an arm on its gears: against a pendulum's formula, scipy, and the stiffness that a motor feels far above them."""

import math

import numpy as np
import pytest
from scipy.linalg import eigh

from hil.arm.bodies import Body, Inertia
from hil.arm.kinematics import Kinematics
from hil.arm.masses import mass_matrix
from hil.arm.swinging import mode_shapes
from hil.arm.tables import ArmLink, ArmTable
from hil.bench.model import IdentifiedMode, stiffness_of
from tests.hil.arm.arms import any_arm, planar_arm

STIFFNESS = {1: 60e3, 2: 48950.0, 3: 16170.0, 4: 7e3, 5: 5e3, 6: 4e3}


def test_a_bar_on_a_spring_swings_as_its_formula_says():
    body = Body(mass_kg=3.0, centre_m=(0.4, 0.0, 0.0), inertia_kg_m2=Inertia(xx=0.02, yy=0.2, zz=0.2))
    arm = ArmTable(link=(ArmLink(axis=7, direction=(0.0, 1.0, 0.0), body=body),), tip_m=(0.8, 0.0, 0.0))
    [mode] = mode_shapes(arm, np.zeros(1), {7: 900.0})
    assert mode.frequency_hz == pytest.approx(math.sqrt(900.0 / (0.2 + 3.0 * 0.16)) / (2.0 * math.pi), rel=1e-12)
    assert abs(mode.joints_rad[0]) == pytest.approx(1.0 / 0.8)
    np.testing.assert_allclose(np.abs(mode.tip_m), [0.0, 0.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_all_modes_of_any_arm_are_those_of_scipy_and_pass_the_tip_through_the_jacobian(seed):
    arm = any_arm(seed, 6)
    angles = np.random.default_rng(seed).uniform(-2.0, 2.0, 6)
    modes = mode_shapes(arm, angles, STIFFNESS)
    doubled = mode_shapes(arm, angles, STIFFNESS, 4.0 * mass_matrix(arm, angles))
    assert [mode.frequency_hz for mode in doubled] == pytest.approx([0.5 * mode.frequency_hz for mode in modes])
    stiffness = np.diag([STIFFNESS[axis] for axis in arm.axes])
    values = eigh(stiffness, mass_matrix(arm, angles), eigvals_only=True)
    np.testing.assert_allclose([mode.frequency_hz for mode in modes], np.sqrt(values) / (2.0 * np.pi), rtol=1e-9)
    for mode in modes:
        force = mass_matrix(arm, angles) @ mode.joints_rad * (2.0 * np.pi * mode.frequency_hz) ** 2
        np.testing.assert_allclose(force, stiffness @ mode.joints_rad, rtol=1e-6, atol=1e-6 * np.max(np.abs(force)))
        assert np.linalg.norm(mode.tip_m) == pytest.approx(1.0)
        moved = [Kinematics.of(arm).pose(angles + sign * 1e-5 * mode.joints_rad)[0] for sign in (-1.0, 1.0)]
        np.testing.assert_allclose((moved[1] - moved[0]) / 2e-5, mode.tip_m, atol=1e-6)


def test_a_gear_without_a_stiffness_is_rigid():
    arm = planar_arm()
    known = {axis: STIFFNESS[axis] for axis in arm.axes if axis != 5}
    modes = mode_shapes(arm, arm.home_rad(), known)
    assert len(modes) == len(known) == 2
    assert all(mode.joints_rad[arm.axes.index(5)] == 0.0 for mode in modes)
    stiff = mode_shapes(arm, arm.home_rad(), {**known, 5: 1e12})
    np.testing.assert_allclose([mode.frequency_hz for mode in modes], [mode.frequency_hz for mode in stiff[:2]], rtol=1e-6)


def test_the_modes_that_a_motor_sees_add_up_to_its_gears_stiffness():
    """J_i of a mode is what the motor feels of it while its fellows are held: (K φ_i)²/ω_i⁴, φ_i of unit mass."""
    arm = planar_arm()
    matrix = mass_matrix(arm, arm.home_rad())
    modes = mode_shapes(arm, arm.home_rad(), STIFFNESS)
    for joint, axis in enumerate(arm.axes):
        seen = []
        for mode in modes:
            shape = mode.joints_rad / math.sqrt(mode.joints_rad @ matrix @ mode.joints_rad)
            inertia = (STIFFNESS[axis] * shape[joint]) ** 2 / (2.0 * math.pi * mode.frequency_hz) ** 4
            seen.append(
                IdentifiedMode(antiresonance_hz=mode.frequency_hz, resonance_hz=99.0, damping=0.02, inertia_kg_m2=inertia)
            )
        assert sum(mode.inertia_kg_m2 for mode in seen) == pytest.approx(matrix[joint, joint], rel=1e-9)
        assert stiffness_of(seen) == pytest.approx(STIFFNESS[axis], rel=1e-9)


@pytest.mark.parametrize("stiffness", [{}, {9: 1e4}, {2: 0.0}, {2: -5.0}])
def test_modes_without_a_stiffness_are_refused(stiffness):
    arm = planar_arm()
    with pytest.raises(ValueError, match="stiffness of at least one gear"):
        mode_shapes(arm, arm.home_rad(), stiffness)
